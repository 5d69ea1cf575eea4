"""Pull: what the simulated loop follows, and what holds it where nothing else does.

A position loop follows its reference. A velocity loop, or an axis without a controller, drifts
away by itself; driven by its own command and pulled to its motion, the pull is the missing force.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...errors import RecordError
from ...loop import ClosedLoop, Controller
from ...loop.bandwidth import margin_deg
from ...loop.controllers.filters import LoopFilter
from ...loop.observer import driven_by
from ...loop.rough_inertia import shown_inertia
from ...record import Record
from ..rules import MARGIN, PULL_DAMPING, PULL_FILTER, PULL_HZ, PULL_RATE
from .findings import Finding

_HELD = (
    "the model is driven by the recorded command, and a soft spring and damper hold it to the "
    "measured motion: their force is the gap"
)
#: Of a velocity loop that `rings`.
HELD = Finding(
    f"the velocity loop hardly has a phase margin, so that small errors would ring on: {_HELD}",
    fatal=False,
)


def followed(record: Record, loop: ClosedLoop) -> tuple[Record, list[Finding]]:
    """Return a record with a position to follow, and what to say of it.

    A velocity loop's is the integral of its reference; without a controller it is the motion.

    Raises
    ------
    RecordError
        If the law follows a position and the record has none.
    """
    if loop.controller.kind == "none":
        return record.replace(q_ref=record.q), [Finding(f"no controller: {_HELD}", fatal=False)]
    if record.q_ref is not None:
        return record, []
    if loop.controller.needs_position or record.dq_ref is None:
        raise RecordError(f"{record.name} has no q_ref; the simulated loop is driven by it")
    q_ref = record.q[0] + np.cumsum(record.dq_ref, axis=0) * record.dt
    return record.replace(q_ref=q_ref), []


def lawless(record: Record, loop: ClosedLoop) -> bool:
    """Whether a law is to be read from a record without any reference."""
    unknown = loop.controller.kind == "identify"
    return unknown and record.q_ref is None and record.dq_ref is None


def adrift(loop: ClosedLoop) -> bool:
    """Whether nothing in a loop holds its position: a velocity loop, or none.

    Simulated by itself it drifts away, and loses the phase of whatever repeats over the position
    within some periods.
    """
    return loop.controller.kind in ("none", "p-velocity", "pi-velocity")


def rings(record: Record, loop: ClosedLoop, oversampling: int = 1) -> bool:
    """Whether a velocity loop hardly has a phase margin, so that none but the axis itself follows.

    What little the model, or the timing of the log, is wrong by rings on and covers the gap.

    Parameters
    ----------
    record : Record
    loop : ClosedLoop
    oversampling : int, optional
        Samples of the controller from one sample of the log to the next.
    """
    if not adrift(loop) or loop.controller.kind == "none":
        return loop.controller.kind == "none"
    own = loop.controller.known(record)
    inertia = _inertia(record, loop)
    margin = margin_deg(replace(loop, controller=own), inertia, 0.0, record.dt / oversampling)
    return bool(margin < MARGIN)


def pulled(record: Record, loop: ClosedLoop) -> tuple[Record, ClosedLoop]:
    """Return a record driven by its own command, and the loop that is pulled to its motion.

    What the pull has to give is the force that the model lacks.
    """
    inertia = _inertia(record, loop)
    hz = _pull_hz(record, loop, inertia)
    unit = inertia * 2.0 * np.pi * hz / loop.gain
    gains = {"kp": unit * 2.0 * np.pi * hz, "kd": 2.0 * PULL_DAMPING * unit}
    # else the noise of the encoder, differentiated, would move the model, and laws explain it
    pull = Controller("pd", gains, filter=LoopFilter("lowpass", PULL_FILTER * hz))
    driven = driven_by(loop.command(record), record.q, record)  # smoothed, it would pull by itself
    sensed = replace(pull, velocity="logged")
    if record.dq is not None and sensed.known(record) is sensed:  # steps of the encoder are not it
        return driven.replace(dq_ref=record.dq), replace(loop, controller=sensed)
    return driven, replace(loop, controller=pull)


def _inertia(record: Record, loop: ClosedLoop) -> float:
    """Return the inertia that a record shows, kg or kg m2, else that of the axis file."""
    return abs(shown_inertia(loop, record)[1].inertia) or loop.start.get("inertia", 1.0)


def _pull_hz(record: Record, loop: ClosedLoop, inertia: float) -> float:
    """Return the natural frequency of the pull, Hz: that of a velocity loop's own."""
    own = loop.controller.settings.get("kv")
    hz = PULL_HZ if own is None else abs(loop.gain * own) / inertia / (2.0 * np.pi)
    return float(min(hz, PULL_RATE * record.sampling_hz))
