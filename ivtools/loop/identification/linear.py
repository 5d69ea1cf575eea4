"""Any linear law: what one that remembers a few samples leaves, and its matrices if it is no kind.

Two filters in a row, or one of the reference, are in no kind of law; a regression of the command on
its own past and on what the law sees has them all.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..controllers import Controller
from .data import HEAD, Data

Array = NDArray[np.float64]

_OWN, _PAST = 5, HEAD  # samples of its own, and of what it sees, that a law remembers
_SAME = 1e-14  # of the largest singular value, from which a past sample tells something
_TELLS = 0.05  # of what the command's own past leaves, that what a law sees leaves at most
_EXACT = 3e-4  # share of the command, rms, that a law leaves of a log of just what it saw, at most
_ALIKE = 0.02  # share by which a law takes reference and position otherwise at rest, at most
_UNSTABLE = 1e-6  # by which a pole of it may be larger than 1
_NO_MORE = 10.0  # times what most past samples leave, that fewer may


def least(data: Data) -> tuple[float, float]:
    """Return the shares of the command, rms, that no law explains which remembers a few samples.

    Whatever its kind and its filters: the command is regressed on its own past, on what the law
    sees, past and present, and on what may be fed forward. The second is what its own past alone
    leaves, as of any smooth command.
    """
    record, rows = data.record, data.rows.nonzero()[0]
    signals = (record.q, record.dq, record.q_ref, record.dq_ref)
    own = [data.command[rows - late] for late in range(1, _OWN + 1)]
    seen = [x[rows - late, 0] for x in signals if x is not None for late in range(_PAST)]
    fed = [x[rows] for x in data.further.values()]
    whole = data.command[rows]
    return _told([*own, *seen, *fed], whole)[0], _told(own, whole)[0]


def just_logged(data: Data) -> bool:
    """Whether the controller saw what is logged: a law of few samples then explains the command."""
    left, alone = least(data)
    return left < min(_EXACT, _TELLS * alone)


def state_space(data: Data) -> Controller | None:
    """Return the linear law of position and reference in the fewest states, if there is one.

    In the observer's canonical form, as the regression has it. It drives the axis to its reference:
    at rest both weigh the same, and the position pushes back.
    """
    record, rows = data.record, data.rows.nonzero()[0]
    if record.q_ref is None or data.logged:
        return None
    whole = data.command[rows]
    signals = (record.q_ref[:, 0] - record.q[0, 0], record.q[:, 0] - record.q[0, 0])

    def solved(order: int) -> tuple[float, Array]:
        """Return what a law with so many states leaves, and its coefficients."""
        own = [data.command[rows - late] for late in range(1, order + 1)]
        seen = [x[rows - late] for x in signals for late in range(order + 1)]
        return _told([*own, *seen], whole)

    laws = [solved(order) for order in range(1, HEAD)]
    least_left = min(left for left, _ in laws)
    if least_left > _EXACT:
        return None
    order = next(n for n, (left, _) in enumerate(laws, 1) if left <= _NO_MORE * least_left)
    own, ref, q = np.split(laws[order - 1][1], [order, 2 * order + 1])
    A = np.eye(order, k=1)
    A[:, 0] = own
    forward, back = data.sign * float(ref.sum()), data.sign * float(q.sum())
    stable = np.max(np.abs(np.linalg.eigvals(A))) < 1.0 + _UNSTABLE
    if not (stable and forward > 0.0 and abs(forward + back) < _ALIKE * forward):
        return None
    B = np.column_stack([x[1:] + own * x[0] for x in (ref, q)])
    C = np.eye(1, order)
    settings = {
        "A": A.tolist(),
        "B": B.tolist(),
        "C": C.tolist(),
        "D": [[float(ref[0]), float(q[0])]],
    }
    return Controller("state-space", settings, limit=data.limit)


def _told(columns: list[Array], whole: Array) -> tuple[float, Array]:
    """Return what of a command no sum of columns and a constant explains, rms, and the sum."""
    regressors = np.column_stack(columns)
    regressors = regressors - regressors.mean(axis=0)
    size = np.maximum(np.linalg.norm(regressors, axis=0), 1e-300)
    regressors /= size
    sought = whole - whole.mean()
    found = np.linalg.lstsq(regressors, sought, rcond=_SAME)[0]
    left = float(np.linalg.norm(sought - regressors @ found))
    return left / max(float(np.linalg.norm(whole)), 1e-300), found / size
