"""Preflight: whether records and axis file are fit to be judged, before any effect is looked for.

The first fault that spoils everything behind it is said, with the value, the rule and the remedy,
and with what it looks like: a unit, another control law, another axis.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ... import checks
from ...errors import RecordError
from ...loop import ClosedLoop, Controller
from ...loop.axis_file import controller_table, toml
from ...loop.rough_inertia import shown_inertia
from ...record import Record
from ...units import JOINTS
from ..fit import Fit
from ..fold import usable
from ..parity import SUMMED, Parity, beyond
from ..rules import (
    ABSURD,
    FOLLOWS,
    GAIN_ERROR,
    GROSS_GAIN,
    LEAST_SAMPLES,
    LEAST_TIME,
    LOOK_WIDTH,
    LOOKS,
    MOST,
    NEARLY_ALL,
    NO_MOTION,
    ONE_WAY,
    OTHER_VALUE,
    PARITY_POOR,
    SAME_AXIS,
    SATURATED,
    SOME,
    WRONG_UNIT,
)
from .plausible import looks_like, wrong_unit

Array = NDArray[np.float64]


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
    for look in (_reference, _at_limit, _law, _short, _direction, _mechanics):
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
    text = f"{law}; it was fitted to this record, which therefore cannot confirm it"
    return [Finding(text, fatal=False)]


def named(found: Sequence[Finding], record: Record) -> list[Finding]:
    """Return findings that say of which record they speak."""
    return [replace(f, text=f"{record.name}: {f.text}") for f in found]


def by_record(given: Collection[Record], found: Iterable[list[Finding]]) -> list[Finding]:
    """Return what is said of each record, with its name if there are several."""
    if len(given) == 1:
        return [f for each in found for f in each]
    pairs = zip(given, found, strict=False)
    return [f for record, each in pairs for f in named(each, record)]


def _reference(record: Record, loop: ClosedLoop, parity: Parity | None = None) -> list[Finding]:
    assert record.q_ref is not None
    asked, done = (float(np.ptp(x)) for x in (record.q_ref, record.q))
    if asked <= NO_MOTION * max(float(np.max(np.abs(record.q))), 1e-12):
        return [
            Finding(
                "the reference does not move: a record at standstill says nothing about "
                "the model; record a motion over the stroke, in both directions"
            )
        ]
    along = float(np.corrcoef(record.q[:, 0], record.q_ref[:, 0])[0, 1])
    if along < -NEARLY_ALL:
        return [Finding("q moves against its reference; check the signs of q and q_ref")]
    unit = JOINTS[loop.joint].length
    # a soft loop against a strong spring
    weak = along > NEARLY_ALL and parity is not None and parity.after < PARITY_POOR
    if FOLLOWS[0] < done / asked < FOLLOWS[1] or weak:
        return []
    factor, signal = (asked / done, "q") if done > asked else (done / asked, "q_ref")
    remedy = looks_like(factor, loop.joint, signal) if along > NEARLY_ALL else ""
    remedy = remedy or "was the axis blocked or not enabled?"
    return [
        Finding(f"q moves {done:.3g} {unit} where its reference moves {asked:.3g} {unit}; {remedy}")
    ]


def too_short(record: Record, loop: ClosedLoop) -> list[Finding]:
    """Say that a record that follows its reference has too little motion to compare."""
    return [] if _reference(record, loop) else _short(record, loop)


def _short(record: Record, loop: ClosedLoop, parity: Parity | None = None) -> list[Finding]:
    samples = int(usable(record, loop).sum())
    kept, whole = samples * record.dt, record.n_samples * record.dt
    if kept < LEAST_TIME:
        less = math.floor(100.0 * kept) / 100.0  # not rounded to what is enough
        return [
            Finding(
                f"only {less:g} s of the record's {whole:.1f} s show motion to compare; "
                f"give at least {LEAST_TIME:g} s, better 20 s, with several reversals"
            )
        ]
    if samples >= LEAST_SAMPLES:
        return []
    needed = math.ceil(LEAST_SAMPLES * record.dt * whole / kept)
    return [
        Finding(
            f"only {samples} samples show motion to compare, and the noise needs "
            f"{LEAST_SAMPLES} to be known: at {record.sampling_hz:.4g} Hz record {needed} s or "
            "more of such motion, or sample faster"
        )
    ]


def _direction(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    if not one_way(record):
        return []
    both = "offset" in loop.names or "viscous_pos" in loop.names
    return [only_one_way(" and count as one here" if both else "")]


def only_one_way(then: str = "") -> Finding:
    """Return what to say of a record that moves in one direction only, and what follows."""
    text = "the reference moves in one direction only: Coulomb friction and offset cannot be told "
    return Finding(f"{text}apart{then}; record the way back as well", fatal=False)


def one_way(record: Record) -> bool:
    """Whether the reference moves in one direction only, by its time and by its way.

    One that moves in steps hardly takes any time, in either.
    """
    assert record.q_ref is not None
    dq = np.gradient(record.q_ref[:, 0])
    time = min(np.mean(dq > 0), np.mean(dq < 0))
    way = min(np.sum(dq[dq > 0]), -np.sum(dq[dq < 0]))
    return bool(time < ONE_WAY and way < ONE_WAY * np.sum(np.abs(dq)))


def identifiable(records: Sequence[Record], loop: ClosedLoop) -> ClosedLoop:
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
    if beyond(size, limit):
        text = f"the recorded command reaches {top:.4g}, the axis file says that it is limited to "
        remedy = "check the unit of nu, and [controller] limit"
        if top <= WRONG_UNIT * limit:
            remedy = "correct [controller] limit"
        return [Finding(f"{text}{limit:g}; {remedy}")]
    if parity.clipped <= SATURATED:
        return []
    share = f"in {100 * parity.clipped:.0f} % of the samples"
    if parity.limit is not None:
        stated = "which the axis file does not say"
        if np.isfinite(limit):
            stated = f"the axis file says {limit:.4g}"
        text = f"the command is cut at {parity.limit:.4g} {share}, {stated}"
        remedy = "put it in [controller] limit, use gentler references"
        return [Finding(f"{text}; {remedy}", parity.clipped > NEARLY_ALL)]
    text = f"the command sits at its limit {share}; the loop is open there"
    return [Finding(f"{text}: use gentler references")]


def _law(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    """Refuse a unit, a sign, or a command without law; another law is said when it is taken."""
    if parity.oversampling > 1 or not (_gross(parity) or parity.taken or not parity.trustworthy):
        return []
    unit = "; ".join(checks.doubts(record)) or wrong_unit(record, loop)
    if unit:
        return [Finding(unit)]
    return [] if parity.trustworthy else [Finding(explain_command(parity))]


def _gross(parity: Parity) -> dict[str, float]:
    """Return the settings that are so wrong that they are said; none where the rate explains it."""
    large = {n: v for n, v in parity.mismatch.items() if abs(v) > GROSS_GAIN}
    return large if parity.oversampling == 1 else {}


def other_law(parity: Parity, taken: bool = True, read: str = "") -> list[Finding]:
    """Say which other law the record shows, and whether the diagnosis goes on with it.

    Parameters
    ----------
    parity : Parity
    taken : bool
    read : str, optional
        Name of the record that the law was read from, where no axis file declares it.
    """
    gross = _gross(parity)
    if not parity.trustworthy or not (gross or parity.taken):
        return []
    file = f"the law read from {read}" if read else "the axis file"
    on = f"the diagnosis goes on with the record's{'' if read else '; correct [controller]'}"
    if not taken:
        on = f"the simulated force is no nearer with it, so that of {file} is kept"
    shown, declared = parity.loop.controller, parity.declared
    if shown.kind != declared.kind:
        text = f"the record shows {described(shown)}; {file} says kind {declared.kind}"
        return [Finding(f"{text}: {on}{_remains(parity)}", fatal=False)]
    own = {k: v for k, v in parity.mismatch.items() if k != "added"}
    if "added" in gross and not own and not parity.taken:
        text = f"the added input acts with {1.0 + gross['added']:.3g} times its recorded size"
        wrong = "unit" if gross["added"] > -1.0 else "sign"
        on = f"the diagnosis goes on with that: check its {wrong}" if taken else on
        return [Finding(f"{text}; {on}", fatal=False)]
    text = f" ({described(shown) if parity.taken else _changes(declared, own)})"
    text = f"the record shows other controller settings than {file}{text}; {on}"
    return [Finding(f"{text}{_remains(parity)}", fatal=False)]


def limited(declared: Controller, shown: Controller, before: float, after: float) -> Finding:
    """Return what to say of a command that is limited as the axis file does not say.

    Parameters
    ----------
    declared, shown : Controller
    before, after : float
        Relative parity error with each.
    """
    how = []
    if shown.anti_windup != declared.anti_windup:
        how.append(f'the integrator has anti_windup = "{shown.anti_windup}"')
    if SUMMED in shown.feedforward:
        how.append(
            f"the added input goes through the limit too, as feedforward = {{{SUMMED} = 1.0}} does "
            f"with a column {SUMMED} in the place of added"
        )
    text = (
        f"where the command is limited, {' and '.join(how)}: so the law leaves {100 * after:.2g} % "
        f"of the command, as declared {100 * before:.2g} %; state it in [controller]"
    )
    return Finding(text, fatal=False)


def _changes(controller: Controller, mismatch: Mapping[str, float]) -> str:
    settings = controller.settings
    return ", ".join(
        f"{n} {100 * v:+.0f} %"
        + (f": {(1 + v) * settings[n]:.4g}, not {settings[n]:.4g}" if n in settings else "")
        for n, v in mismatch.items()
    )


def _remains(parity: Parity) -> str:
    return "".join(f"; {text}" for text in parity.read.remains) if parity.read else ""


def _mechanics(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    """Look at the sign and size of the inertia that the record itself suggests."""
    shown = shown_inertia(loop, record)[1]
    inertia, unit = shown.inertia, JOINTS[loop.joint].inertia
    if shown.negative:
        return [
            Finding(
                f"the record suggests an inertia of {inertia:.3g} {unit}: the force does not "
                "accelerate the axis; check the sign of the command and of [drive] gain"
            )
        ]
    start = loop.start.get("inertia")
    ratio = inertia / start if start else 1.0
    # no unit makes it negative: a link that swings against its drive does
    if shown.clear and ratio > 0.0 and not 1.0 / ABSURD < ratio < ABSURD:
        return _astray([record]) or [
            Finding(
                f"the record suggests an inertia of {inertia:.3g} {unit}, the axis file starts "
                f"from {start:g}; check units and [drive] gain"
            )
        ]
    return []


def overlap(record: Record, other: Record, role: str = "hold-out") -> list[Finding]:
    """Return what a hold-out, or a judge, has in common with a record that it should not."""
    share, said = _shared(record, other), f"the {role} {other.name}"
    if share > NEARLY_ALL:
        text = f"{said} holds the same samples as {record.name}"
        return [Finding(f"{text}; give another record of the axis, or none")]
    if share > SOME:
        text = f"{said} shares {100 * share:.0f} % of its samples with {record.name}"
        return [Finding(f"{text}; give a record that was not fitted to")]
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
        if float(np.mean(error**2)) < OTHER_VALUE * fit.cost:
            return []
    unit = JOINTS[bases[0].loop.joint].inertia
    records = [fit.fold.record for fit in bases]
    if lost := _astray(records):
        return lost
    names = [r.name for r in records]
    shown = " and ".join(f"{n} {m:.4g} {unit}" for n, m in zip(names, inertias, strict=True))
    return [
        Finding(
            f"the records show different inertias ({shown}): another axis, payload or unit; hold "
            "out a record of the same axis and load"
        )
    ]


def _astray(records: Sequence[Record]) -> list[Finding]:
    """Return what to say of axes that do not follow: they do not show their inertia."""
    off = {r.name: _off(r) for r in records}
    said = [f"{name} by {100.0 * x:.0f} % of its motion" for name, x in off.items() if x > MOST]
    if not said:
        return []
    return [
        Finding(
            f"the axis does not follow its reference ({' and '.join(said)}): the drive delivers "
            "less than the command, or something holds it; record a motion that it follows"
        )
    ]


def _off(record: Record) -> float:
    """Return how far the axis is from its reference, of how far that moves, rms."""
    if record.q_ref is None:
        return 0.0
    error, motion = (float(np.std(x)) for x in (record.q - record.q_ref, record.q_ref))
    return error / max(motion, 1e-300)


def explain_command(parity: Parity) -> str:
    """Say that no law gives the recorded command, and which were tried."""
    tried = ""
    if parity.read is not None:
        best = sorted(parity.read.kinds.items(), key=lambda kind: -kind[1])
        listed = ", ".join(f"{kind} {r2:.2f}" for kind, r2 in best)
        tried = f"; no kind of law gives all of it either; R2 of each where it was fitted: {listed}"
        tried += f"{_remains(parity)}; matrices of a state-space law are read only where every "
        tried += "sample is just what the controller saw: state them if it is one"
    left = 100.0 * parity.after
    if parity.at is not None:
        return (
            f"the control law does not give the recorded command around {parity.at:.6g} s: it "
            f"differs by {left:.0f} % of it, nearly all of that there; look at the log there, and "
            "cut it out if a row is wrong"
        )
    return (
        f"the control law does not give the recorded command: it differs by {left:.0f} % of it; "
        "check kind, gains and velocity_filter in [controller], that q, q_ref and nu belong "
        f"together, and whether every signal and sample that the controller uses is logged{tried}"
    )


def described(controller: Controller) -> str:
    """Return what an axis file would say of a law, in a line; of matrices how many states."""
    if controller.kind == "state-space":
        what = "as with a filter of the reference, or two in a row"
        law = f"a linear law with {controller.words[0]}"
        return f"{law}, {what} (`ivtools axis new`, or `robot new`, has its matrices)"
    plain = Controller("none", {})
    if all(abs(w) < GAIN_ERROR for w in controller.velocity_filter[1:]):
        controller = replace(controller, velocity_filter=plain.velocity_filter)
    said, usual = (controller_table(c) for c in (replace(controller, limit=plain.limit), plain))
    settings = {k: v for k, v in said.items() if k != "kind" and v != usual.get(k)}
    listed = ", ".join(f"{k} = {toml(v, digits=4)}" for k, v in settings.items())
    return f"kind {controller.kind}, {listed}"


def _shared(record: Record, holdout: Record) -> float:
    """Return the share of the moving stretches of either record that the other one holds.

    If one has a multiple of the samples of the other, of those that the other may have.
    """
    fine, coarse = sorted((record, holdout), key=lambda r: r.dt)
    one, two, step = _columns(fine), _columns(coarse), round(coarse.dt / fine.dt)
    parts = [part for k in range(step) if len(part := one[k::step]) >= LOOK_WIDTH]
    return max(_held(one, two, step), *(_held(two, part) for part in parts), 0.0)


def _held(one: Array, two: Array, step: int = 1) -> float:
    """Return the share of the stretches of `two` that `one` holds, sample for sample.

    Of `one` each `step` of them count. Only stretches in which the position moves and the command
    does all the time: standing still is the same in any record.
    """
    starts = np.linspace(0, len(two) - LOOK_WIDTH, LOOKS).astype(int)
    parts = [two[s : s + LOOK_WIDTH] for s in starts]
    moving = [p for p in parts if np.ptp(p[:, 0]) and len(np.unique(p[:, 1])) >= MOST * LOOK_WIDTH]
    return float(np.mean([_holds(one, p, step) for p in moving])) if moving else 0.0


def _columns(record: Record) -> Array:
    """Return position and command, (n_samples, 2)."""
    force = record.nu if record.nu is not None else record.tau
    assert force is not None  # a record has one of them
    return np.column_stack([record.q[:, 0], force[:, 0]])


def _holds(x: Array, part: Array, step: int) -> bool:
    span = step * (len(part) - 1) + 1
    at = np.arange(len(x) - span + 1)
    for column, first in enumerate(part[0]):
        at = at[x[at, column] == first]
    return any(np.array_equal(x[i : i + span : step], part) for i in at)
