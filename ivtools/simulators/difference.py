"""What separates an axis from its simulator, as a record of its own.

A model fitted to the simulator's log is simulated along the simulator's reference; what the real
axis did otherwise than the simulator is added to that. The control law is linear, so the result
still obeys it; what both share, known to us or not, cancels to first order. A diagnosis of this
record says what the simulator lacks.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ivtools.checks import MIN_SAMPLES
from ivtools.errors import ConvergenceWarning, EstimationError, IVToolsError, RecordError
from ivtools.estimators.input_error import CLIE, DIDIM
from ivtools.estimators.least_squares import IDIMLS
from ivtools.linalg import rms
from ivtools.linalg.swing import Swings
from ivtools.loop.controllers import Seen
from ivtools.problem import Problem
from ivtools.record import Record
from ivtools.units import JOINTS, quantity

if TYPE_CHECKING:
    from ivtools.loop import ClosedLoop, Controller, Simulation
    from ivtools.results import FitResults

Array = NDArray[np.float64]

CREEPS = "regularised-coulomb"  # the friction of simulators that regularise it
SWINGS = "flexibility"  # what hangs from the axis, as far as it swings little
_SHIPPED_RATE, _SHIPPED_HOLD = 105.0, 0.9  # 1/s and 1, of MuJoCo's defaults: where a fit begins
_CREEPS = 0.9  # of the jumps that a model leaves of a simulator's log: what creeping may leave
_DRY = 0.5  # of its friction: what may still be dry where a simulator's friction creeps
_SWINGS = 0.5  # of what a model leaves of a simulator's log: what a swinging load may leave
_LEAVES = 0.01  # of the command: a model that leaves less needs no load
_SEEN = 0.4  # of what a rigid model leaves: what a resonance must explain to be tried
_LOAD = 0.1  # share of the inertia from which its fit begins
_SAME = 0.01  # of the stroke: references that differ by less are one
_OTHER_UNIT = 10.0  # ratio of the commands beyond which they have different units
_OF_GAIN = 0.2  # of the drive's gain: a ratio of commands as near to it is this gain
_IN_STEP = 0.01  # of a sample: by which two clocks may part over the record
_SLOWEST = 0.45  # of the record's rate: a held command is late by half a sample
_HOMED = 0.25  # of the energy that the law leaves of a command: what a shift must leave at most
_SHARED = 0.5  # of the record that the simulator must cover
_NEAR = 0.02  # relative: a ratio as near to that of a unit is this unit
_SLIPS = {1e3: "mm", 1e-3: "km", 180.0 / np.pi: "degrees", np.pi / 180.0: "radians", 1e6: "µm"}


@dataclass(frozen=True)
class Difference:
    """A record that holds what the real axis does beyond its simulator.

    Attributes
    ----------
    record : Record
        Model plus real minus simulated: position, velocity if both have it, and command.
    real, simulated : Record
        Both logs, at the same instants.
    base : FitResults
        The simulator seen through our model.
    second_order : float
        What that model leaves of the simulator's command, as a share of it, times the share by
        which the axis has another command: as much of the force does not cancel.
    notes : tuple of str
        What was done to bring the logs together.
    """

    record: Record
    real: Record
    simulated: Record
    base: FitResults
    second_order: float
    notes: tuple[str, ...] = ()


def difference(
    real: Record,
    simulated: Record,
    loop: ClosedLoop,
    notes: tuple[str, ...] = (),
    base: FitResults | None = None,
) -> Difference:
    """Return the record that shows what the real axis does beyond its simulator.

    Parameters
    ----------
    real, simulated : Record
        Logs of the same reference at the same instants, as `together` makes them.
    loop : ClosedLoop
        The axis, with its rigid model.
    notes : tuple of str, optional
        What was done to bring the logs together.
    base : FitResults, optional
        The simulator seen through the loop's model, where it is known.

    Raises
    ------
    EstimationError
        If no model fits the simulator's log.
    """
    base = base or _seen(simulated, loop)
    model = base_simulation(loop, simulated, base)
    signals: dict[str, Any] = {
        "q": model.q + real.q - simulated.q,
        "nu": model.nu + loop.command(real) - loop.command(simulated),
    }
    if real.dq is not None and simulated.dq is not None:
        law = loop.controller.known(simulated).law(simulated.dt)
        own = model.dq if law.sensed else law.velocity(model.q[:, 0])[:, np.newaxis]
        signals["dq"] = own + real.dq - simulated.dq
    kept = {k: v for k in ("q_ref", "dq_ref", "added") if (v := getattr(real, k)) is not None}
    record = Record(
        t=real.t, **signals, **kept, name=real.name, notes=(*real.notes, *notes), extra=real.extra
    )
    theirs, own = loop.command(simulated), loop.command(real)
    size = max(rms(theirs), 1e-300)
    second_order = rms(model.nu - theirs) / size * min(rms(own - theirs) / size, 1.0)
    return Difference(record, real, simulated, base, second_order, notes)


def as_simulated(loop: ClosedLoop, simulated: Record) -> tuple[ClosedLoop, FitResults]:
    """Return the loop as its simulator computes it, and the simulator seen through it.

    What both logs share cancels only as far as the model moves as the simulator does. So the model
    takes what the simulator's log alone shows: friction that creeps, a load that swings.

    Parameters
    ----------
    loop : ClosedLoop
        The axis, with its rigid model.
    simulated : Record
    """
    rigid, base = _creeping(simulated, loop, _seen(simulated, loop))
    heavy, seen = _swinging(simulated, rigid, base)
    return (rigid, base) if heavy is rigid else _creeping(simulated, heavy, seen)


def _creeping(
    simulated: Record, loop: ClosedLoop, base: FitResults
) -> tuple[ClosedLoop, FitResults]:
    """Return the loop with friction that creeps, and the simulator seen through it, if it does.

    Many simulators regularise dry friction: with creeping friction a model then comes nearer to
    their log around reversals, and most of the friction creeps; where other joints swing, more than
    all of it. Where the real axis moves otherwise, friction changes at once.
    """
    friction = base.params.get("coulomb", 0.0)
    if min(friction, base.params["inertia"]) <= 0.0 or CREEPS in (t.name for t in loop.terms):
        return loop, base
    speed = friction / (_SHIPPED_RATE * _SHIPPED_HOLD * base.params["inertia"])
    soft = replace(loop, start={**_values(loop, base), "coulomb": 0.0}).with_effect(
        CREEPS, force=friction, speed=speed, hold=_SHIPPED_HOLD / friction
    )
    fit, left = _tried(simulated, soft)
    jumps, before = (np.diff(x, axis=0) for x in (left, _left(simulated, loop, base)))
    if fit is None or rms(jumps) >= _CREEPS * rms(before):
        return loop, base  # from sample to sample what friction does at a reversal counts
    found = _values(soft, fit)
    if dry(found) >= _DRY:
        return loop, base
    whole = {"coulomb": 0.0, f"{CREEPS}.force": found["coulomb"] + found[f"{CREEPS}.force"]}
    return replace(soft, start={**found, **whole}), fit


def _swinging(
    simulated: Record, loop: ClosedLoop, base: FitResults
) -> tuple[ClosedLoop, FitResults]:
    """Return the loop with a load that swings, and the simulator seen through it, if one does.

    What hangs from a cart, and swings little, is a second mass on a spring.
    """
    left = _left(simulated, loop, base)
    if any(t.second_mass for t in loop.terms) or (
        rms(left) < _LEAVES * rms(loop.command(simulated))
    ):
        return loop, base
    dt = simulated.dt
    dq = np.gradient(simulated.q[:, 0], dt)
    ddq = np.gradient(dq, dt)
    rigid = np.column_stack([ddq, dq, np.sign(dq), np.ones(len(dq))])
    beyond = left[:, 0] - rigid @ np.linalg.lstsq(rigid, left[:, 0], rcond=None)[0]
    found = Swings(ddq, np.ones(len(dq), dtype=bool), dt).strongest(beyond)
    if found.share < _SEEN:
        return loop, base
    load = {"frequency_hz": found.swing.hz, "damping": found.swing.damping, "load_share": _LOAD}
    start = replace(loop, start=_values(loop, base))
    heavy = start.with_effect(SWINGS, **load, load_friction=0.0)
    fit, rest = _tried(simulated, heavy)
    if fit is None or rms(rest) >= _SWINGS * rms(left):
        return loop, base
    return replace(heavy, start=_values(heavy, fit)), fit


def _values(loop: ClosedLoop, fit: FitResults) -> dict[str, float]:
    """Return a loop's start with what was fitted."""
    return {**loop.start, **{str(name): float(value) for name, value in fit.params.items()}}


def _tried(simulated: Record, loop: ClosedLoop) -> tuple[FitResults | None, Array]:
    """Return a loop fitted from its start to the simulator's log, and the command that it leaves.

    It is a trial, and judged by what it leaves: that it has not converged is no reason to warn.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            fit = CLIE(start="axis").fit(Problem(simulated, loop))
        return fit, _left(simulated, loop, fit)
    except IVToolsError:
        return None, np.empty((0, 1))


def dry(values: Mapping[str, float]) -> float:
    """Return the share of dry friction that holds an axis at standstill."""
    whole = values["coulomb"] + values[f"{CREEPS}.force"]
    return values["coulomb"] / whole if whole > 0.0 else 1.0


def _left(simulated: Record, loop: ClosedLoop, fit: FitResults) -> Array:
    """Return what a fitted model leaves of the simulator's command, (n_samples, 1)."""
    return base_simulation(loop, simulated, fit).nu - loop.command(simulated)


def base_simulation(loop: ClosedLoop, simulated: Record, base: FitResults) -> Simulation:
    """Return the fitted model along the simulator's reference, from the simulator's state."""
    done = loop.simulate(simulated, base.params)
    if not done.finite:
        raise EstimationError("the model that was fitted to the simulator's log is unstable")
    return done


def _seen(simulated: Record, loop: ClosedLoop) -> FitResults:
    """Return the simulator's parameters, seen through the loop's model."""
    problem = Problem(simulated, loop)
    known = any(not p.linear for p in loop.parameters.values())  # not by linear regression
    for estimator in (CLIE(start="axis"),) if known else (DIDIM(), CLIE()):
        fit = estimator.fit(problem)
        if fit.converged and fit.params["inertia"] > 0.0:
            return fit
    return IDIMLS().fit(problem)


# --- two logs of one reference ------------------------------------------------------------------


def brought(
    real: Record, simulated: Record, loop: ClosedLoop
) -> tuple[Record, Record, tuple[str, ...]]:
    """Return both logs at the same instants and from the same place, and what was done for it.

    Raises
    ------
    RecordError
        If they are not of the same reference or units, or share too little time.
    """
    real, simulated, notes = together(real, simulated)
    own, theirs = (float(np.sqrt(np.mean(loop.command(r) ** 2))) for r in (real, simulated))
    ratio = theirs / max(own, 1e-300)
    if not 1.0 / _OTHER_UNIT < ratio < _OTHER_UNIT:
        force = "; that is the drive's gain: it is a force, name its column tau"
        raise RecordError(
            f"the simulator's command is {ratio:.3g} times the record's: it looks like another "
            f"unit{force if abs(ratio / loop.gain - 1.0) < _OF_GAIN else ''}"
        )
    simulated, more = homed(real, simulated, loop.known(real))
    return real, simulated, (*notes, *more)


def together(real: Record, simulated: Record) -> tuple[Record, Record, tuple[str, ...]]:
    """Return both logs at the real one's instants, and what had to be done for it.

    Raises
    ------
    RecordError
        If they are not of the same reference, or share too little time.
    """
    if real.n_joints != 1 or simulated.n_joints != 1:
        raise RecordError("the logs have several joints; compare one at a time")
    notes = []
    if simulated.n_samples != real.n_samples or not _same_step(real, simulated):
        real, simulated, note = _resampled(real, simulated)
        notes.append(note)
    _same_unit("q", float(np.ptp(real.q)), float(np.ptp(simulated.q)))
    if simulated.q_ref is None and real.q_ref is not None:
        simulated = simulated.replace(q_ref=real.q_ref)
        notes.append("the simulator's log has no reference; it is taken to be the record's")
    _same_reference(real, simulated)
    return real, simulated, tuple(notes)


def homed(real: Record, simulated: Record, loop: ClosedLoop) -> tuple[Record, tuple[str, ...]]:
    """Return the simulator's log with its position counted from where the record's is.

    A position that is off by a constant that the logged command knows nothing of is one that was
    counted from elsewhere.

    Parameters
    ----------
    real, simulated : Record
        At the same instants.
    loop : ClosedLoop
        The axis, for its controller.
    """
    controller = loop.controller.known(simulated)
    if simulated.q_ref is None or not controller.needs_position:
        return simulated, ()
    away = float(np.median(simulated.q - real.q))
    moved = simulated.replace(q=simulated.q - away)
    left = [_left_by_law(s, loop, controller) for s in (simulated, moved)]
    if left[1] >= _HOMED * left[0]:
        return simulated, ()
    unit = JOINTS[loop.joint].length
    return moved, (
        f"the simulator's position is counted from {quantity(away, unit)} away from the record's; "
        "it was brought there",
    )


def _left_by_law(simulated: Record, loop: ClosedLoop, controller: Controller) -> float:
    """Return the mean square of what a control law leaves of a record's command."""
    seen = Seen.of(controller, simulated, loop.command(simulated), loop.joint)
    limit = controller.limit
    nu = seen.expected(controller.law(simulated.dt), controller.delay, limit, limit)
    return float(np.mean((seen.command - np.clip(nu, -limit, limit)) ** 2))


def _same_step(real: Record, simulated: Record) -> bool:
    return abs(simulated.dt - real.dt) * real.n_samples < _IN_STEP * real.dt


def _resampled(real: Record, simulated: Record) -> tuple[Record, Record, str]:
    """Bring the simulator's log to the record's instants, both counted from their first sample."""
    from scipy.interpolate import CubicSpline

    t, own = real.t - real.t[0], simulated.t - simulated.t[0]
    n = int(np.searchsorted(t, own[-1] + 0.5 * real.dt))
    if simulated.sampling_hz < _SLOWEST * real.sampling_hz:
        raise RecordError(
            f"the simulator's log has {simulated.sampling_hz:.4g} Hz, the record "
            f"{real.sampling_hz:.4g} Hz: what the command did between cannot be told; log the "
            "simulator at the record's rate"
        )
    if n * real.dt < _SHARED * t[-1] or n < MIN_SAMPLES:
        raise RecordError(
            f"the logs share {n * real.dt:.3g} s of {t[-1]:.3g} s; simulate the whole record"
        )
    at = np.minimum(t[:n], own[-1])
    held = ("nu", "tau", "added")  # a command is held between samples, not interpolated
    rows = np.clip(np.searchsorted(own, at + 1e-9 * real.dt, side="right") - 1, 0, len(own) - 1)
    signals: dict[str, Any] = {
        name: x[rows] if name in held else CubicSpline(own, x)(at)
        for name, x in simulated.signals.items()
    }
    extra = {name: CubicSpline(own, x)(at) for name, x in simulated.extra.items()}
    brought = Record(t=real.t[:n], **signals, extra=extra, name=simulated.name)
    note = (
        f"the simulator's log ({simulated.n_samples} samples at {simulated.sampling_hz:g} Hz) was "
        f"brought to the record's instants ({n} at {real.sampling_hz:g} Hz)"
    )
    return real if n == real.n_samples else real.slice(0, n), brought, note


def _same_reference(real: Record, simulated: Record) -> None:
    """Refuse logs of different references, and say if it is a matter of units."""
    if real.q_ref is None or simulated.q_ref is None:
        return
    one, two = real.q_ref[:, 0], simulated.q_ref[:, 0]
    stroke = float(np.ptp(one))
    if float(np.sqrt(np.mean((one - two) ** 2))) <= _SAME * stroke:
        return
    _same_unit("q_ref", stroke, float(np.ptp(two)))
    raise RecordError(
        "the simulator followed another reference than the record (rms difference "
        f"{float(np.sqrt(np.mean((one - two) ** 2))):.3g}, stroke {stroke:.3g}); simulate the "
        "record's own q_ref from its first sample"
    )


def _same_unit(name: str, one: float, two: float) -> None:
    """Refuse a simulator's signal whose range says that it is in another unit."""
    ratio = two / one if one else np.inf
    for factor, unit in _SLIPS.items():
        if abs(ratio / factor - 1.0) < _NEAR:
            raise RecordError(
                f"the simulator's {name} is {ratio:.4g} times the record's: it looks like {unit}; "
                "convert it, or name its unit"
            )
