"""Links: what the other joints of a robot say of the load that its links put on one of them.

A joint by itself knows its load up to the parameters of the links. Those are not free to explain
whatever the joint lacks: the other joints feel them too. Along one simulation of all joints the
command of each answers to every parameter; what the others' errors say of the parameters is a
normal distribution, and the joint is diagnosed in the metric in which noise and that doubt are
white. It is the coupled fit of the parameters and of the joint's effect, seen from the joint.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import IVToolsError
from ...linalg import block_covariance, fir
from ...loop import robot_sensitivity
from ...record import Record
from ...results import FitResults
from .. import response
from ..floor import autoregression
from ..fold import Doubt
from ..rules import BLOCK, DEPENDENT, LEAST_BLOCK, LINKED_TRANSIENT, OWN

Array = NDArray[np.float64]


class Links(NamedTuple):
    """What the joints of a robot say of its parameters, each by itself.

    Attributes
    ----------
    names : tuple of str, (p,)
        The parameters.
    answers : ndarray, (n, n_samples, p)
        Of each joint's command, N or N m, to a unit of each parameter.
    precision, pull : ndarray, (n, p, p) and (n, p)
        Of each joint: the normal equations of a change of the parameters.
    t : ndarray, (n_samples,)
        s.
    inertia : ndarray, (n_samples, n)
        What the command of each joint answers to a unit of inertia of its own.
    joints : tuple of str, (n,)
    """

    names: tuple[str, ...]
    answers: Array
    precision: Array
    pull: Array
    t: Array
    inertia: Array
    joints: tuple[str, ...]

    def doubt(self, joint: str) -> Doubt:
        """Return what the others leave in doubt of the load of a joint.

        A mean inertia and frictions are the axis's own to fit.
        """
        j, number = self.joints.index(joint), np.arange(len(self.names))
        A = self.answers[j]
        own = [k for k, name in enumerate(self.names) if name.startswith(f"{joint}.")]
        links = np.array([k for k, name in enumerate(self.names) if "." not in name])
        axis = np.column_stack([A[:, own], self.inertia[:, j]])
        axis = axis / np.maximum(np.linalg.norm(axis, axis=0), 1e-300)
        as_own = axis @ np.linalg.lstsq(axis, A[:, links])[0]
        rest = A[:, links] - as_own
        size = np.linalg.norm(A[:, links], axis=0)
        share = np.linalg.norm(rest, axis=0) / np.maximum(size, 1e-300)
        felt = share > OWN
        drive = any(self.names[k].startswith(f"{joint}.inertia") for k in own)  # grouped or not
        if not drive and felt.any():
            share[~felt] = np.inf
            felt[np.argmin(share)] = False  # with it the inertia of the drive is regrouped
        kept, free = links[felt], np.setdiff1d(number, links[felt])
        others = np.arange(len(self.joints)) != j
        P, g = self.precision[others].sum(axis=0), self.pull[others].sum(axis=0)
        # what is left when all other parameters are free: their Schur complement
        by = P[np.ix_(kept, free)] @ np.linalg.pinv(P[np.ix_(free, free)], rcond=DEPENDENT)
        precision = P[np.ix_(kept, kept)] - by @ P[np.ix_(free, kept)]
        mean = np.linalg.pinv(precision, rcond=DEPENDENT) @ (g[kept] - by @ g[free])
        precision = 0.5 * (precision + precision.T)
        return Doubt(self.t, rest[:, felt], mean, precision, as_own[:, felt])


def possible(fit: FitResults, record: Record) -> dict[str, float]:
    """Return the parameters of a robot's fit, or the nearest that a record can be simulated with.

    Raises
    ------
    MissingExtraError
        If that takes cvxpy and it is not installed.
    """
    assert fit.problem is not None
    loop: Any = fit.problem.loop
    return dict(loop.possible(loop.values(fit.params), record, lambda: fit.X))


def measure(fit: FitResults, record: Record, before: Links | None = None) -> Links | None:
    """Return what the joints say along a simulation with these parameters; None if it diverges.

    Parameters
    ----------
    fit : FitResults
        Of the robot.
    record : Record
    before : Links, optional
        Of the same record without some effects: its answers are near enough.
    """
    assert fit.problem is not None
    loop: Any = fit.problem.loop
    try:
        values = possible(fit, record)
        simulation = loop.simulate(record, values)
        now = simulation.tau
        if before is None:
            answers = robot_sensitivity.answers(loop, record, values, simulation)
    except IVToolsError:
        return None
    names, answers = (tuple(loop.names), answers) if before is None else before[:2]
    gap = loop.force(record) - now
    if not (np.isfinite(answers).all() and np.isfinite(gap).all()):
        return None
    own = [loop.axis(j, record, values) for j in range(loop.n_joints)]
    heard = [response.measure(a, record.joint(j), a.start) for j, a in enumerate(own)]
    inertia = np.column_stack([h(x) for h, x in zip(heard, simulation.ddq.T, strict=True)])
    first = max(round(LINKED_TRANSIENT / record.dt), 1)
    both = [_normal(A, e, first, record.dt) for A, e in zip(answers, gap.T, strict=True)]
    P, g = (np.array(x) for x in zip(*both, strict=True))
    return Links(names, answers, P, g, record.t, inertia, tuple(loop.joints))


def _normal(A: Array, e: Array, first: int, dt: float) -> tuple[Array, Array]:
    """Return the normal equations (p, p), (p,) of a joint, its error whitened.

    Where its blocks differ by more than noise lets them, because it lacks something itself, it
    says less: by the ratio of the block-robust to the plain variance of the scores.
    """
    whitener = autoregression(e[first:], np.ones(len(e) - first, dtype=bool))
    white = fir(whitener, np.column_stack([A, e]))[first:]
    white /= np.std(white[:, -1])
    A, e = white[:, :-1], white[:, -1]
    P = A.T @ A
    size = np.maximum(np.sqrt(np.diag(P)), 1e-300)
    unit = P / size / size[:, np.newaxis]
    inverse = np.linalg.pinv(unit, rcond=DEPENDENT)
    width = max(round(BLOCK / dt), LEAST_BLOCK)
    meat = block_covariance(A / size * e[:, np.newaxis], np.arange(0, len(e), width))
    excess = max(float(np.sum(meat * inverse) / np.sum(unit * inverse)), 1.0)
    return P / excess, A.T @ e / excess
