"""Plausible: units and signs that give themselves away.

The declared control law, fed with the recorded positions, is compared with the recorded command.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...errors import IVToolsError
from ...loop import ClosedLoop
from ...loop.rough_inertia import beside_position
from ...record import Record
from ...units import JOINTS, parse, plain_number
from ..parity import Signals
from ..rules import ABSURD, LITTLE, MAX_DELAY, OPPOSITE, UNIT_NEAR, UNIT_SAMPLES

Array = NDArray[np.float64]

_UNITS = {"prismatic": ("mm", "µm", "cm", "inches"), "revolute": ("degrees", "turns", "mrad")}


def doubts(record: Record, loop: ClosedLoop) -> tuple[str, ...]:
    """Return what is absurd about a record on this axis, one line each.

    The control law of the axis file, fed with the recorded positions, is compared with the
    recorded command: a position in millimetres makes it a thousand times too large. What depends
    on the position is left out of both, for a compensation of gravity may be all of the command.

    Parameters
    ----------
    record : Record
    loop : ClosedLoop

    Examples
    --------
    >>> import ivtools as iv
    >>> record, loop = iv.datasets.twin(), iv.axes.emps()
    >>> doubts(record, loop)
    ()
    >>> "1000 times" in doubts(record.replace(q=1e3 * record.q, q_ref=1e3 * record.q_ref), loop)[0]
    True
    """
    commands = _commands(record, loop)
    if commands is None:
        return ()
    expected, recorded = commands
    ratio = float(np.std(expected) / np.std(recorded))
    units = "m? mm?" if loop.joint == "prismatic" else "rad? degrees?"
    if not 1.0 / ABSURD < ratio < ABSURD:
        return (
            f"the controller of the axis file would command {plain_number(ratio, 2)} times what "
            f"was recorded; check the units of q ({units}) and of the command, and the gains",
        )
    if np.corrcoef(expected, recorded)[0, 1] < OPPOSITE:
        return (
            "the recorded command has the opposite sign of the axis file's controller; check the "
            "sign of the command and of the position",
        )
    return ()


def _commands(record: Record, loop: ClosedLoop) -> tuple[Array, Array] | None:
    """Return the command by the control law and the recorded one, (n,) each; None without."""
    if record.n_joints != 1:
        return None
    try:
        if record.n_samples > UNIT_SAMPLES:
            record = record.slice(0, UNIT_SAMPLES)
        signals = Signals(record, loop)
        with np.errstate(over="ignore", invalid="ignore"):
            expected = signals.fed(loop.controller)
    except IVToolsError:  # a law that is still to be identified, a signal that is missing or dead
        return None
    delay = loop.controller.delay
    expected = expected[: len(expected) - delay]
    recorded = signals.own[delay:]
    usable = np.isfinite(expected).all() and np.ptp(recorded) > 0.0 and np.ptp(expected) > 0.0
    if not usable:
        return None
    commands = np.column_stack([expected, recorded])
    left = beside_position(commands, record.q[delay:, 0], loop.joint)
    return (left[:, 0], left[:, 1]) if np.ptp(left, axis=0).all() else None


def wrong_unit(record: Record, loop: ClosedLoop) -> str:
    """Say which unit or sign the command has, if it is the declared law times a factor."""
    signals = Signals(record, loop)
    fed = signals.fed(loop.controller)
    most = max(MAX_DELAY, loop.controller.delay)
    each = (_factor(signals, fed, delay) for delay in range(most + 1))
    factor, rest = min(each, key=lambda one: one[1])
    if rest**2 > LITTLE:
        return ""
    if factor < 0.0:
        text = "the recorded command has the opposite sign of what the controller gives"
        return f"{text}; check the sign of nu, or of q and q_ref"
    guess = looks_like(factor, loop.joint, "q and q_ref")
    if guess and loop.log.units:
        guess += " (iv.Record.read(path, loop.log) takes the units that the axis file has)"
    if abs(factor * parse("mV").factor - 1.0) < UNIT_NEAR:
        guess = "as if nu were in mV; give V"
    absurd = not 1.0 / ABSURD < factor < ABSURD
    if not guess and not absurd:
        return ""
    guess = f"{guess}, else " if guess else ""
    return (
        f"the recorded command is {plain_number(factor)} times what the controller gives for the "
        f"recorded position: {guess}check the units of q, q_ref and nu, and the gains in "
        "[controller]"
    )


def _factor(signals: Signals, fed: Array, delay: int) -> tuple[float, float]:
    """Return the recorded command per command of the law, (n,), and what that leaves."""
    nu = signals.command[delay:]
    columns = [fed[: len(nu)], np.ones(len(nu))]
    if signals.added.any():
        columns.append(signals.added[delay:])
    X = np.column_stack(columns)
    size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    whole = max(float(np.linalg.norm(nu)), 1e-300)
    weights = np.linalg.lstsq(X / size, nu, rcond=None)[0] / size
    return float(weights[0]), float(np.linalg.norm(nu - X @ weights)) / whole


def looks_like(factor: float, joint: str, signal: str) -> str:
    """Say which unit a factor looks like: 0.001 of what should be is a signal in mm.

    Examples
    --------
    >>> looks_like(0.00101, "prismatic", "q")
    'as if q were in mm; give m'
    >>> looks_like(0.0175, "revolute", "q and q_ref")
    'as if q and q_ref were in degrees; give rad'
    >>> looks_like(1.7, "prismatic", "q")
    ''
    """
    unit = JOINTS[joint].length
    for name in _UNITS[joint]:
        if abs(factor / parse(name).factor - 1.0) < UNIT_NEAR:
            return f"as if {signal} were in {name}; give {unit}"
    return ""
