"""Standing: what a record does not tell of a robot, because a joint stands still."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..linalg import norms_of
from ..record import Record
from ..robot.base import independent

if TYPE_CHECKING:
    from .robot_loop import RobotLoop

Array = NDArray[np.float64]


def holding(loop: RobotLoop, record: Record) -> RobotLoop:
    """Return the loop with the parameters held that joints standing still do not show.

    Parameters
    ----------
    loop : RobotLoop
    record : Record

    Returns
    -------
    RobotLoop
        As it was where every joint moves; else with a note that says what keeps its value.
    """
    if record.n_joints != loop.n_joints or loop.held:
        return loop
    still = np.flatnonzero(at_rest(record))
    if not len(still) or len(still) == loop.n_joints:
        return loop
    names = unseen(loop, record)
    joints = ", ".join(loop.joints[j] for j in still)
    verb = "stands" if len(still) == 1 else "stand"
    note = (
        f"{joints} {verb} still: this record does not tell {', '.join(names)} from the others; "
        "they keep their starting values, and the rest is estimated"
    )
    return replace(loop, held=tuple(names), notes=(*loop.notes, note))


def at_rest(record: Record) -> NDArray[np.bool_]:
    """Return which joints stand still throughout, (n_joints,)."""
    return np.ptp(record.q, axis=0) == 0.0


def unseen(loop: RobotLoop, record: Record) -> list[str]:
    """Return the base parameters whose columns vanish on a record, or depend on those before."""
    pipelines = loop.band_pipelines(record)
    motion = pipelines.differentiate(record.q, record.dt)
    still = at_rest(record)
    for signal in (motion.dq, motion.ddq):
        signal[:, still] = 0.0  # and not what is left by rounding
    X = loop.regressor(motion, loop.force(record), record.t - record.t[0])
    moving = X[~still].reshape(-1, X.shape[2])  # at rest, stiction takes what it takes
    kept = independent(np.asarray(np.linalg.qr(moving / norms_of(moving), mode="r")))
    return [name for k, name in enumerate(loop.names) if k not in kept]
