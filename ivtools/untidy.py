"""What loggers leave in a table that is no sample: rows said twice, spoilt, or of nothing.

And angles that jump by a turn. Nothing of it is mended unless the [record] table of the axis file
asks for it, and notes tell of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["TURN", "continuous", "usable", "wraps"]

Array = NDArray[np.float64]

TURN = 2.0 * np.pi
_SPAN = 0.9  # of a turn that a wrapped angle's jump is, and of its range at least
_NEAR = 0.1  # relative: how near a jump must come to a turn
_BEYOND = 5.0  # times the other steps by which a jump exceeds them


def usable(table: Mapping[str, Array], time: str | None) -> tuple[NDArray[np.bool_], list[str]]:
    """Return which rows of a table are samples, (n,), and what the others are.

    Parameters
    ----------
    table : mapping of str to ndarray, (n,)
        The columns that make up the record, as they were read; no number is NaN.
    time : str or None
        The column of the stamps.

    Examples
    --------
    >>> t = np.array([0.0, 1.0, 1.0, 2.0, 0.0, 0.0])
    >>> q = np.array([5.0, 6.0, 6.0, np.nan, 0.0, 0.0])
    >>> keep, told = usable({"t": t, "q": q}, "t")
    >>> keep.tolist()
    [True, True, False, False, False, False]
    >>> told
    ['1 rows with a cell that is no number', '2 rows of zeros at the end', '1 rows said twice']
    """
    columns = np.column_stack([np.asarray(x, dtype=float) for x in table.values()])
    keep, told = np.isfinite(columns).all(axis=1), []

    def drop(rows: NDArray[np.bool_], what: str) -> None:
        gone = int((keep & rows).sum())
        if gone:
            told.append(f"{gone} rows {what}")
        keep[rows] = False

    if not keep.all():
        told.append(f"{int((~keep).sum())} rows with a cell that is no number")
    moving = np.flatnonzero(keep & (columns != 0.0).any(axis=1))
    tail = np.zeros(len(keep), dtype=bool)
    if time is not None and len(moving):
        tail[moving[-1] + 1 :] = True
        drop(tail, "of zeros at the end")
    if time is not None:
        rows = np.flatnonzero(keep)
        again = np.zeros(len(keep), dtype=bool)
        again[rows[1:]] = (np.diff(columns[rows], axis=0) == 0.0).all(axis=1)
        drop(again, "said twice")
    return keep, told


def wraps(angle: Array, turns: Sequence[float] = (TURN, 360.0)) -> float:
    """Return the turn by which an angle jumps, of some, in its own unit; 0 if it does not.

    Examples
    --------
    >>> wraps(np.linspace(0.0, 900.0, 400) % 360.0), wraps(np.linspace(0.0, 900.0, 400))
    (360.0, 0.0)
    """
    angle = angle[np.isfinite(angle)]
    steps = np.abs(np.diff(angle))
    if len(steps) < 3 or not steps.max() > 0.0:
        return 0.0
    far = steps > 0.5 * steps.max()
    rest = float(steps[~far].max()) if (~far).any() else 0.0
    jump, span = float(np.median(steps[far])), float(np.ptp(angle))
    if jump < _BEYOND * rest or jump < _SPAN * span:
        return 0.0
    return next((t for t in turns if abs(jump / t - 1.0) < _NEAR and span < (1 + _NEAR) * t), 0.0)


def continuous(q: Array, q_ref: Array | None) -> tuple[Array, Array | None]:
    """Return angles, rad, (n,) or (n, n_joints), without jumps by a turn, the reference beside q.

    Examples
    --------
    >>> q, _ = continuous(np.array([3.0, 3.1, -3.1, -3.0]), None)
    >>> np.round(q, 2).tolist()
    [3.0, 3.1, 3.18, 3.28]
    """
    q = np.unwrap(q, axis=0)
    if q_ref is None:
        return q, None
    q_ref = np.unwrap(q_ref, axis=0)
    return q, q_ref - TURN * np.round(np.median(q_ref - q, axis=0) / TURN)
