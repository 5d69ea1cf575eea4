"""Preflight: whether records and axis file are fit to be judged, before any effect is looked for.

The first fault that spoils everything behind it is said, with the value, the rule and the remedy,
and with what it looks like: a unit, another control law, another axis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .. import checks
from ..errors import IVToolsError, RecordError
from ..loop import ClosedLoop, Controller
from ..loop.bandwidth import margin_deg
from ..loop.observer import driven_by
from ..loop.rough_inertia import beside_position, shown_inertia
from ..record import Record
from .fit import Fit
from .fold import usable
from .parity import Parity, Signals
from .rules import (
    ABSURD,
    ALONG,
    FOLLOWS,
    GROSS_GAIN,
    INERTIA_RANGE,
    LEAST_SAMPLES,
    LEAST_TIME,
    LIMIT_SAMPLES,
    LOOK_WIDTH,
    LOOKS,
    MARGIN,
    MOVING,
    ONE_WAY,
    OPEN_LOOP,
    OPPOSITE,
    OTHER_INERTIA,
    OVER_LIMIT,
    OVERLAP,
    PARITY_POOR,
    PULL_HZ,
    PULL_RATE,
    SAME_AXIS,
    SAME_RECORD,
    SATURATED,
    UNIT_NEAR,
    UNIT_R2,
    UNIT_SAMPLES,
    WRONG_UNIT,
)

Array = NDArray[np.float64]

_UNITS = {
    "prismatic": {"mm": 1e3, "µm": 1e6, "cm": 100.0, "inches": 39.37},
    "revolute": {"degrees": 180.0 / np.pi, "turns": 0.5 / np.pi, "mrad": 1e3},
}


@dataclass(frozen=True)
class Finding:
    """Something that a person must look at.

    Parameters
    ----------
    text : str
        What is wrong, and what to do.
    fatal : bool
        Whether it keeps effects from being named.
    """

    text: str
    fatal: bool = True


def inspect(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    """Return what is wrong with a record, or with the axis file that goes with it.

    The first cause that spoils everything behind it ends the search: a position in millimetres
    makes the inertia wrong too, and saying so would only mislead.
    """
    found: list[Finding] = []
    for look in (_reference, _at_limit, _law, _length, _direction, _mechanics):
        found += look(record, loop, parity)
        if any(f.fatal for f in found):
            break
    return found


def require(record: Record) -> None:
    """Refuse a record that a closed loop of one joint cannot be compared with.

    Raises
    ------
    RecordError
        If the record has more than one joint.
    """
    if record.n_joints != 1:
        raise RecordError(
            f"{record.name} has {record.n_joints} joints; a diagnosis takes one at a time"
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
        text = (
            "no controller: the model is driven by the recorded command and pulled to the measured "
            "motion, softly; the gap is the force of the pull"
        )
        return record.replace(q_ref=record.q), [Finding(text, fatal=False)]
    if record.q_ref is not None:
        return record, []
    if loop.controller.needs_position or record.dq_ref is None:
        raise RecordError(f"{record.name} has no q_ref; the simulated loop is driven by it")
    q_ref = record.q[0] + np.cumsum(record.dq_ref, axis=0) * record.dt
    return record.replace(q_ref=q_ref), []


def adrift(loop: ClosedLoop) -> bool:
    """Whether nothing in a loop holds its position: a velocity loop, or none.

    Simulated by itself it drifts away, and loses the phase of whatever repeats over the position
    within some periods.
    """
    return loop.controller.kind in ("none", "p-velocity", "pi-velocity")


def rings(record: Record, loop: ClosedLoop) -> bool:
    """Whether a velocity loop hardly has a phase margin, so that none but the axis itself follows.

    What little the model, or the timing of the log, is wrong by rings on and covers the gap.
    """
    if not adrift(loop) or loop.controller.kind == "none":
        return loop.controller.kind == "none"
    own = loop.controller.known(record)
    inertia = abs(shown_inertia(loop, record)[1].inertia) or loop.start.get("inertia", 1.0)
    margin = margin_deg(replace(loop, controller=own), inertia, 0.0, record.dt)
    return bool(margin < MARGIN)


def pulled(record: Record, loop: ClosedLoop) -> tuple[Record, ClosedLoop]:
    """Return a record driven by its own command, and the loop that is pulled to its motion.

    What the pull has to give is the force that the model lacks.
    """
    inertia = abs(shown_inertia(loop, record)[1].inertia) or loop.start.get("inertia", 1.0)
    hz = _pull_hz(record, loop, inertia)
    unit = inertia * 2.0 * np.pi * hz / loop.gain
    pull = Controller("pd", {"kp": unit * 2.0 * np.pi * hz, "kd": 1.4 * unit})
    driven = driven_by(loop.command(record), record.q, record)  # smoothed, it would pull by itself
    return driven, replace(loop, controller=pull)


def _pull_hz(record: Record, loop: ClosedLoop, inertia: float) -> float:
    """Return the natural frequency of the pull, Hz: that of a velocity loop's own."""
    own = loop.controller.settings.get("kv")
    hz = PULL_HZ if own is None else abs(loop.gain * own) / inertia / (2.0 * np.pi)
    return float(min(hz, PULL_RATE * record.sampling_hz))


def lawless(record: Record, loop: ClosedLoop) -> bool:
    """Whether a law is to be read from a record without any reference."""
    unknown = loop.controller.kind == "identify"
    return unknown and record.q_ref is None and record.dq_ref is None


def identified(record: Record, loop: ClosedLoop) -> list[Finding]:
    """Say which control law is taken, if the axis file leaves it to the record.

    Raises
    ------
    RecordError
        If no law can be fitted to the record.
    """
    if loop.controller.kind != "identify":
        return []
    law = loop.known(record).notes[-1]
    text = f"{law}; the record that a law was fitted to cannot say whether it is the right one"
    return [Finding(text, fatal=False)]


def named(found: Sequence[Finding], record: Record) -> list[Finding]:
    """Return findings that say of which record they speak."""
    return [replace(f, text=f"{record.name}: {f.text}") for f in found]


def _reference(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    assert record.q_ref is not None
    asked, done = (float(np.ptp(x)) for x in (record.q_ref, record.q))
    if asked <= 1e-9 * max(float(np.max(np.abs(record.q))), 1e-12):
        return [
            Finding(
                "the reference does not move: a record at standstill says nothing about "
                "the model; record a motion over the stroke, in both directions"
            )
        ]
    along = float(np.corrcoef(record.q[:, 0], record.q_ref[:, 0])[0, 1])
    if along < -ALONG:
        return [Finding("q moves against its reference; check the signs of q and q_ref")]
    unit = "m" if loop.joint == "prismatic" else "rad"
    weak = along > ALONG and parity.after < PARITY_POOR  # a soft loop against a strong spring
    if FOLLOWS[0] < done / asked < FOLLOWS[1] or weak:
        return []
    factor, signal = (asked / done, "q") if done > asked else (done / asked, "q_ref")
    remedy = looks_like(factor, loop.joint, signal) if along > ALONG else ""
    remedy = remedy or "was the axis blocked or not enabled?"
    return [
        Finding(f"q moves {done:.3g} {unit} where its reference moves {asked:.3g} {unit}; {remedy}")
    ]


def _length(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    samples = int(usable(record, loop).sum())
    kept, whole = samples * record.dt, record.n_samples * record.dt
    if kept < LEAST_TIME:
        return [
            Finding(
                f"only {kept:.1f} s of the record's {whole:.1f} s show motion that can be "
                f"compared; give at least {LEAST_TIME:g} s, better 20 s, with several reversals"
            )
        ]
    if samples >= LEAST_SAMPLES:
        return []
    needed = LEAST_SAMPLES * record.dt * whole / kept
    return [
        Finding(
            f"only {samples} samples show motion that can be compared, and the noise needs "
            f"{LEAST_SAMPLES} to be known: at {record.sampling_hz:.4g} Hz record {needed:.0f} s or "
            "more, or sample faster"
        )
    ]


def _direction(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    if not one_way(record):
        return []
    both = "offset" in loop.names or "viscous_pos" in loop.names
    text = "the reference moves in one direction only: Coulomb friction and offset cannot be told "
    rest = "apart and count as one here" if both else "apart"
    return [Finding(f"{text}{rest}; add the way back", fatal=False)]


def one_way(record: Record) -> bool:
    """Whether the reference moves in one direction only."""
    assert record.q_ref is not None
    dq = np.gradient(record.q_ref[:, 0])
    return bool(min(np.mean(dq > 0), np.mean(dq < 0)) < ONE_WAY)


def told_apart(records: Sequence[Record], loop: ClosedLoop) -> ClosedLoop:
    """Return the model without what motion in one direction cannot tell from Coulomb friction."""
    if not any(one_way(r) for r in records):
        return loop
    names = [t.name for t in loop.terms if t.name not in ("offset", "asymmetric-friction")]
    return loop.with_terms(*dict.fromkeys([*names, "viscous", "coulomb"]))


def _at_limit(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    whole, limit = np.abs(loop.command(record)), loop.controller.limit
    own = np.abs(loop.command(record) - (record.added if record.added is not None else 0.0))
    size = np.minimum(whole, own)  # whether the added input is in the command or not
    top = float(np.max(size))
    if np.sum(size > OVER_LIMIT * limit) >= LIMIT_SAMPLES:
        text = f"the recorded command reaches {top:.4g}, the axis file says that it is limited to "
        remedy = "check the unit of nu, and [controller] limit"
        if top <= WRONG_UNIT * limit:
            remedy = "correct [controller] limit"
        return [Finding(f"{text}{limit:g}; {remedy}")]
    if parity.clipped <= SATURATED:
        return []
    share = f"in {100 * parity.clipped:.0f} % of the samples"
    if parity.limit is not None:
        text = f"the command is cut at {parity.limit:.4g} {share}, which the axis file does not say"
        remedy = "put it in [controller] limit, use gentler references"
        return [Finding(f"{text}; {remedy}", parity.clipped > OPEN_LOOP)]
    text = f"the command sits at its limit {share}; the loop is open there"
    return [Finding(f"{text}: use gentler references")]


def _law(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    """Say which law the record shows; only a unit, a sign, or a command without law is fatal."""
    gross = {n: v for n, v in parity.mismatch.items() if abs(v) > GROSS_GAIN}
    if parity.trustworthy and not gross and not parity.taken:
        return []
    unit = "; ".join(checks.doubts(record)) or _unit(record, loop, parity)
    if unit:
        return [Finding(unit)]
    on = "the diagnosis goes on with the record's; correct [controller]"
    if parity.taken and parity.loop.controller.kind != loop.controller.kind:
        text = f"the record shows {described(parity.loop.controller)}; the axis file says kind "
        return [Finding(f"{text}{loop.controller.kind}: {on}{_remains(parity)}", fatal=False)]
    if parity.trustworthy:
        text = _changes(loop.controller, {k: v for k, v in parity.mismatch.items() if k != "added"})
        text = f" ({text})" if text else f" ({described(parity.loop.controller)})"
        text = f"the record shows other controller settings than the axis file{text}; {on}"
        return [Finding(f"{text}{_remains(parity)}", fatal=False)]
    return [Finding(explain_command(parity))]


def _changes(controller: Controller, mismatch: Mapping[str, float]) -> str:
    settings = controller.settings
    return ", ".join(
        f"{n} {100 * v:+.0f} %"
        + (f": {(1 + v) * settings[n]:.4g}, not {settings[n]:.4g}" if n in settings else "")
        for n, v in mismatch.items()
    )


def _remains(parity: Parity) -> str:
    return "".join(f"; {text}" for text in parity.read.remains) if parity.read else ""


def _unit(record: Record, loop: ClosedLoop, parity: Parity) -> str:
    """Say which unit or sign the command has, if it is the declared law times a factor."""
    factor, rest = _factor(record, loop, parity.delay)
    if rest**2 > 1.0 - UNIT_R2:
        return ""
    if factor < 0.0:
        text = "the recorded command has the opposite sign of what the controller gives"
        return f"{text}; check the sign of nu, or of q and q_ref"
    guess = looks_like(factor, loop.joint, "q and q_ref") if factor < 1.0 else ""
    if abs(factor / 1000.0 - 1.0) < UNIT_NEAR:
        guess = "as if nu were in mV; give V"
    absurd = not 1.0 / ABSURD < factor < ABSURD
    if not guess and not absurd:
        return ""
    guess = f"{guess}, else " if guess else ""
    return (
        f"the recorded command is {factor:.3g} times what the controller gives for the recorded "
        f"position: {guess}check the units of q, q_ref and nu, and the gains in [controller]"
    )


def _mechanics(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    """Look at the sign and size of the inertia that the record itself suggests."""
    shown = shown_inertia(loop, record)[1]
    inertia, unit = shown.inertia, "kg" if loop.joint == "prismatic" else "kg m2"
    if shown.negative:
        return [
            Finding(
                f"the record suggests an inertia of {inertia:.3g} {unit}: the force does not "
                "accelerate the axis; check the sign of the command and of [drive] gain"
            )
        ]
    start = loop.start.get("inertia")
    if start and shown.clear and not INERTIA_RANGE[0] < inertia / start < INERTIA_RANGE[1]:
        return [
            Finding(
                f"the record suggests an inertia of {inertia:.3g} {unit}, the axis file starts "
                f"from {start:g}; check units and [drive] gain"
            )
        ]
    return []


def overlap(record: Record, holdout: Record) -> list[Finding]:
    """Return what a hold-out has in common with the record that it should not."""
    share = _shared(record, holdout)
    if share > SAME_RECORD:
        text = f"the hold-out {holdout.name} holds the same samples as {record.name}"
        return [Finding(f"{text}; give another record of the axis, or none")]
    if share > OVERLAP:
        text = f"the hold-out {holdout.name} shares {100 * share:.0f} % of its samples with "
        return [Finding(f"{text}{record.name}; give a record that was not fitted to")]
    return []


def same_axis(bases: Sequence[Fit]) -> list[Finding]:
    """Return what two records say against being of one axis.

    Their inertias differ, and neither record can be simulated with the other's.
    """
    inertias = [fit.values.get("inertia", 1.0) for fit in bases]
    if max(inertias) < SAME_AXIS * min(inertias):
        return []
    for fit, other in zip(bases, inertias[::-1], strict=True):
        error = fit.fold.error(fit.loop, {**fit.values, "inertia": other})
        if float(np.mean(error**2)) < OTHER_INERTIA * fit.cost:
            return []
    unit = "kg" if bases[0].loop.joint == "prismatic" else "kg m2"
    names = [fit.fold.record.name for fit in bases]
    shown = " and ".join(f"{n} {m:.4g} {unit}" for n, m in zip(names, inertias, strict=True))
    return [
        Finding(
            f"the records show different inertias ({shown}): another axis, payload or unit; hold "
            "out a record of the same axis and load"
        )
    ]


def _shared(record: Record, holdout: Record) -> float:
    """Return the share of the moving stretches of either record that the other one holds."""
    one, two = (_columns(r) for r in (record, holdout))
    return max(_held(one, two), _held(two, one))


def _held(one: Array, two: Array, windows: int = LOOKS, width: int = LOOK_WIDTH) -> float:
    """Return the share of the stretches of `two` that `one` holds, sample for sample.

    Only stretches in which the position moves and the command does all the time: standing still is
    the same in any record.
    """
    starts = np.linspace(0, len(two) - width, windows).astype(int)
    parts = [two[s : s + width] for s in starts]
    moving = [p for p in parts if np.ptp(p[:, 0]) and len(np.unique(p[:, 1])) >= MOVING * width]
    return float(np.mean([_holds(one, p) for p in moving])) if moving else 0.0


def _columns(record: Record) -> Array:
    """Return position and command, (n_samples, 2)."""
    force = record.nu if record.nu is not None else record.tau
    assert force is not None  # a record has one of them
    return np.column_stack([record.q[:, 0], force[:, 0]])


def _holds(x: Array, part: Array) -> bool:
    width = len(part)
    at = np.flatnonzero((x[: len(x) - width + 1] == part[0]).all(axis=1))
    return any(np.array_equal(x[i : i + width], part) for i in at)


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
    unit = "m" if joint == "prismatic" else "rad"
    for name, times in _UNITS[joint].items():
        if abs(factor * times - 1.0) < UNIT_NEAR:
            return f"as if {signal} were in {name}; give {unit}"
    return ""


def explain_command(parity: Parity) -> str:
    """Say that no law gives the recorded command, and which were tried."""
    tried = ""
    if parity.read is not None:
        best = sorted(parity.read.kinds.items(), key=lambda kind: -kind[1])
        listed = ", ".join(f"{kind} {r2:.2f}" for kind, r2 in best)
        tried = f"; no kind of law explains it either, R2: {listed}{_remains(parity)}; matrices of "
        tried += "a state-space law are not looked for: state them if it is one"
    left = 100.0 * parity.after
    return (
        f"the control law does not give the recorded command: it differs by {left:.0f} % of it; "
        "check kind, gains and velocity_filter in [controller], that q, q_ref and nu belong "
        f"together, and whether every signal that the controller uses is in the log{tried}"
    )


def _factor(record: Record, loop: ClosedLoop, delay: int) -> tuple[float, float]:
    """Return the recorded command per command of the declared law, and what that leaves."""
    signals = Signals(record, loop)
    nu = signals.command[delay:]
    columns = [signals.fed(loop.controller)[: len(nu)], np.ones(len(nu))]
    if signals.added.any():
        columns.append(signals.added[delay:])
    X = np.column_stack(columns)
    size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    whole = max(float(np.linalg.norm(nu)), 1e-300)
    weights = np.linalg.lstsq(X / size, nu, rcond=None)[0] / size
    return float(weights[0]), float(np.linalg.norm(nu - X @ weights)) / whole


def described(controller: Controller) -> str:
    """Return kind and gains as text."""
    gains = ", ".join(f"{k} = {v:.4g}" for k, v in controller.settings.items())
    return f"kind {controller.kind}, {gains}"


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
    >>> "1e+03 times" in doubts(record.replace(q=1e3 * record.q, q_ref=1e3 * record.q_ref), loop)[0]
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
            f"the controller of the axis file would command {ratio:.2g} times what was recorded; "
            f"check the units of q ({units}) and of the command, and the gains",
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
    recorded = (signals.command - signals.added)[delay:]
    usable = np.isfinite(expected).all() and np.ptp(recorded) > 0.0 and np.ptp(expected) > 0.0
    if not usable:
        return None
    commands = np.column_stack([expected, recorded])
    left = beside_position(commands, record.q[delay:, 0], loop.joint)
    return (left[:, 0], left[:, 1]) if np.ptp(left, axis=0).all() else None
