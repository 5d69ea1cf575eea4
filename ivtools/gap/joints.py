"""Joints: a robot is diagnosed joint by joint, what the others ask of each one as a known load."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ..errors import AxisError, EstimationError, IVToolsError
from ..estimators.instrumental import IDIMIV
from ..estimators.least_squares import IDIMWLS
from ..loop import ClosedLoop, RobotLoop
from ..loop.mechanics import LIGHTEST
from ..physics import find
from ..problem import Problem
from ..record import Record
from ..results import FitResults
from .diagnose import diagnose
from .diagnosis import Diagnosis
from .fit import of_effect
from .links import Links, measure
from .robot_diagnosis import Coupled, RobotDiagnosis
from .rules import FAINT, ROUNDS, Rules
from .verdict import lowers

Array = NDArray[np.float64]

_POSES = 50  # at which the mean inertia of a joint is taken
_TWO_MASSES = ("flexibility", "backlash")  # which a RobotLoop cannot have


def diagnose_robot(
    record: Record,
    loop: RobotLoop,
    holdout: Record | None = None,
    *,
    joints: Sequence[str] | None = None,
    progress: Callable[[str], None] | None = None,
    **settings: Any,
) -> RobotDiagnosis:
    """Say joint by joint what a robot's model lacks, and how far that closes the gap of the whole.

    The robot is identified; the force that the links ask of a joint, beyond its own inertia, is
    computed from the measured motion and is a known load of that joint, whose axis is then
    diagnosed as any other. An effect of one joint biases the links, and so shows in others: the
    robot is fitted again with all that was named, and every joint that named something is
    diagnosed again with the loads of those links. What it then no longer names was not its own.
    Under loads that are a little wrong an effect may explain most of a gap and still not be told
    from what they lack: the links are then estimated, and the joint is diagnosed again, as if it
    had been named.
    A robot's joints have one mass each; the links behind a flexible joint, or one with backlash,
    swing as that joint by itself says, the joint with the largest gain first.

    Parameters
    ----------
    record : Record
        Of all joints, with references.
    loop : RobotLoop
    holdout : Record, optional
        Another record of the same robot, which judges.
    joints : sequence of str, optional
        Those to diagnose; default: all.
    progress : callable, optional
        Called with a line of text at each stage.
    **settings
        As for `diagnose`.

    Raises
    ------
    AxisError
        If there is no such joint.
    """
    say = progress or (lambda _: None)
    wanted = [loop.robot.joint(name) for name in (joints or loop.joints)]
    loop = loop.known(record)
    say("identifying the robot")
    plain, notes = identified(record, loop)
    found: dict[str, Diagnosis] = {}
    named: dict[str, Diagnosis] = {}
    better, records = plain, [one for one in (record, holdout) if one is not None]
    told: dict[Record, Links | None] = {}
    for again in range(ROUNDS):
        told = {one: measure(better, one, told.get(one)) for one in records}
        soft: dict[str, Diagnosis] = {}
        for j in sorted(wanted, key=lambda j: -_swing(found.get(loop.joints[j]))):
            name = loop.joints[j]
            say(f"joint {name}" + (", beside the other joints' effects" if again else ""))
            own = named[name].effects if name in named else ()
            less = soft and _bends(j, told, better, settings, own, soft, found[name].chi[0])
            beside = {**soft} if less else {}
            if again and not found[name].effects and _swing(found[name]) > 0.0:
                beside[name] = assumed(found[name])
            if not again or beside or better is not plain:  # else nothing is new
                found[name] = _joint(j, told, better, settings, own, beside)
            if again and _swing(found[name]) > 0.0:
                soft[name] = assumed(found[name])
        told_of = found if again + 1 == ROUNDS else {n: assumed(d) for n, d in found.items()}
        last, named = named, {name: d for name, d in told_of.items() if d.effects}
        if plain.problem is None or _effects(named) == _effects(last):
            break
        fuller = with_effects(loop, named)
        if fuller.held == loop.held:  # it can have none of them
            better = plain
        else:
            better, more = identified(record, fuller, plain.problem.pipeline)
            notes = (*notes, *more)
        wanted = [j for j in wanted if _open(loop.joints[j], found)]
    say("the coupled simulation")
    other = record if holdout is None else holdout
    coupled = Coupled(*(errors(fit, other) for fit in (plain, better)))
    return RobotDiagnosis(record.name, loop.name, found, plain, better, coupled, notes)


def assumed(diagnosis: Diagnosis) -> Diagnosis:
    """Return a diagnosis that has what it supposes for an effect, where it names nothing."""
    one = diagnosis.supposed
    if diagnosis.effects or one is None:
        return diagnosis
    parameters = {one.effect: of_effect(one.values, one.effect)}
    return replace(diagnosis, effects=(one.effect,), parameters=parameters, theta=one.values)


def _swing(diagnosis: Diagnosis | None) -> float:
    """Return the gain of a joint's two masses, on data that they were not fitted to; else 0."""
    if diagnosis is None:
        return 0.0
    if not diagnosis.effects and diagnosis.supposed is not None:
        one = diagnosis.supposed
        return one.gain if one.effect in _TWO_MASSES else 0.0
    both = (e for e in diagnosis.effects if e in _TWO_MASSES and e in diagnosis.evidence)
    return max((diagnosis.evidence[e].gain for e in both), default=0.0)


def _effects(found: Mapping[str, Diagnosis]) -> dict[str, tuple[str, ...]]:
    return {name: d.effects for name, d in found.items()}


def _open(joint: str, found: Mapping[str, Diagnosis]) -> bool:
    """Whether links that were estimated with what is named may change what is said of a joint."""
    return found[joint].verdict != "adequate"


def identified(
    record: Record, loop: RobotLoop, pipeline: Any = None
) -> tuple[FitResults, tuple[str, ...]]:
    """Return the robot's parameters by instruments, or by least squares if that fails."""
    problem = Problem(record, loop, pipeline)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = IDIMIV().fit(problem)
        if fit.converged:
            return fit, ()
        said = "the instruments did not converge: the links are those of weighted least squares"
        return IDIMWLS().fit(problem), (said,)


def _joint(
    j: int,
    told: Mapping[Record, Links | None],
    fit: FitResults,
    settings: Mapping[str, Any],
    without: Sequence[str] = (),
    soft: Mapping[str, Diagnosis] | None = None,
) -> Diagnosis:
    """Diagnose one joint under the loads that the links of a fit put on it."""
    name = fit.problem.loop.joints[j]  # type: ignore[union-attr]
    parts = [alone(j, one, fit, without, soft) for one in told]
    other = parts[1].record if len(parts) > 1 else None
    doubts = [
        None if links is None else replace(links.doubt(name), link=part.link)
        for links, part in zip(told.values(), parts, strict=True)
    ]
    return heard(diagnose(parts[0].record, parts[0].loop, other, doubts=doubts, **settings))


def _bends(
    j: int,
    told: Mapping[Record, Links | None],
    fit: FitResults,
    settings: Mapping[str, Any],
    without: Sequence[str],
    soft: Mapping[str, Diagnosis],
    before: float,
) -> bool:
    """Whether the gap of a joint is smaller where other joints have their two masses.

    Then some of it was the swing of their links.
    """
    bare = {**settings, "rules": replace(settings.get("rules") or Rules(), most=0)}
    return _joint(j, told, fit, bare, without, soft).chi[0] < before


def heard(diagnosis: Diagnosis) -> Diagnosis:
    """Return a diagnosis without names that hardly lower the error.

    The load comes from the measured motion and estimated links, so it is a little wrong; an effect
    that lowers the joint's error by less than `FAINT` may be that.
    """
    s = diagnosis.shrink
    if not diagnosis.effects or s is None or lowers(s, True, diagnosis.chi[0] - diagnosis.chi[1]):
        return diagnosis
    names = ", ".join(diagnosis.effects)
    said = f"{names} would lower the force error by less than {100 * FAINT:g} %: not named"
    return replace(
        diagnosis,
        verdict="adequate" if diagnosis.negligible else "unexplained",
        effects=(),
        advice=(*diagnosis.advice, said),
    )


class Alone(NamedTuple):
    """One joint of a robot as an axis.

    Attributes
    ----------
    record : Record
        With the load of the others.
    loop : ClosedLoop
    link : ndarray, (n_samples, 2)
        That load without what the inertia of its link has beyond the mean, and that inertia.
    """

    record: Record
    loop: ClosedLoop
    link: Array


def alone(
    j: int,
    record: Record,
    fit: FitResults,
    without: Sequence[str] = (),
    soft: Mapping[str, Diagnosis] | None = None,
) -> Alone:
    """Return a joint as an axis, with the load that a fit's links put on it.

    Parameters
    ----------
    j : int
        Joint, counted from 0.
    record : Record
        Of all joints.
    fit : FitResults
        Of the robot.
    without : sequence of str
        Effects of this joint that its axis is not to have.
    soft : mapping of str to Diagnosis, optional
        Joints with two masses: their links are not where their drives are.
    """
    problem = fit.problem
    assert problem is not None
    loop: Any = problem.loop
    values = loop.values({str(k): float(v) for k, v in fit.params.items()})
    motion = problem.pipeline.differentiate(record.q, record.dt)
    places, ddqs = motion.q.copy(), motion.ddq.copy()
    for name, diagnosis in (soft or {}).items():
        i = loop.joints.index(name)
        its = alone(i, record, fit)
        rows = slice(0, its.record.n_samples)
        places[rows, i], ddqs[rows, i] = _link(diagnosis, its, motion.dq[rows, i])
    q, dq, ddq = (loop._to_joints(x) for x in (places, motion.dq, ddqs))
    asked = loop.robot.torques(q, dq, ddq, loop.inertias(values))
    if loop.transmission is not None:
        asked = asked @ loop._T
    poses = problem.motion.q[:: max(len(problem.motion.q) // _POSES, 1)]  # of the fit's own record
    inertia = float(loop.mass_matrix(poses, values)[:, j, j].mean())
    own = loop.joint_values(j, values)
    load = asked[:, j] - (inertia - own.get("inertia", 0.0)) * ddqs[:, j]
    more = loop.mass_matrix(places, values)[:, j, j] - inertia
    both = np.column_stack([load, load - more * ddqs[:, j], more])
    both = 0.5 * (both + np.vstack([both[1:], both[-1:]]))  # held over the sample that it follows
    end = record.n_samples - problem.pipeline.trim[1]  # behind it derivatives are the filter's
    part = record.joint(j)
    if part.load is not None:
        both[:, :2] += part.load
    part = part.slice(0, end).replace(load=both[:end, :1])
    return Alone(part, _axis(j, loop, inertia, own, without), both[:end, 1:])


def _link(diagnosis: Diagnosis, part: Alone, dq: Array) -> tuple[Array, Array]:
    """Return position and acceleration of the link of a joint with two masses, (n_samples,) each.

    Under its load it swings behind the drive; a gap lies on the side to which it is pulled, and the
    link behind it is jerked when a simulation of that joint says.

    Parameters
    ----------
    diagnosis : Diagnosis
        Has the values of its flexibility or backlash.
    part : Alone
        That joint.
    dq : ndarray, (n_samples,)
        Velocity of the drive.
    """
    record = part.record
    assert record.load is not None
    values, q = diagnosis.theta, record.q[:, 0]
    effect = next(e for e in _TWO_MASSES if e in diagnosis.effects)
    hz = values["backlash.contact_hz" if effect == "backlash" else "flexibility.frequency_hz"]
    share = values[f"{effect}.load_share"]
    w = 2.0 * np.pi * hz
    drag, pull = 2.0 * values[f"{effect}.damping"] * w * (1.0 - share), w * w * (1.0 - share)
    pulled = record.load[:, 0] / (share * values["inertia"])

    def swung(x: Array, top: Sequence[float]) -> Array:
        """Return a signal behind the spring and the mass of the link, as if it had been steady."""
        b, a = signal.bilinear(top, [1.0, drag, pull], 1.0 / record.dt)
        steady = signal.lfilter_zi(b, a) * x[0]
        return np.asarray(signal.lfilter(b, a, x, zi=steady)[0], dtype=float)

    twice = (1.0, 0.0, 0.0)  # derived
    ahead = swung(q, twice)
    behind = ahead + swung(pulled, (1.0,))
    ddq = pull * ahead + drag * swung(dq, twice) - swung(pulled, twice)
    gap = 0.5 * values.get("backlash.gap", 0.0) * np.sign(pulled + ddq)
    jerked = _jerked(diagnosis, part) if effect == "backlash" else ddq
    return q - behind - gap, jerked if np.isfinite(jerked).all() else ddq


def _jerked(diagnosis: Diagnosis, part: Alone) -> Array:
    """Return the acceleration of a link behind a gap, (n_samples,).

    Of the forces on the joint as it is simulated, those that accelerate neither drive nor load.
    """
    loop = part.loop.with_effect("backlash", **of_effect(diagnosis.theta, "backlash"))
    values = loop.values({n: v for n, v in diagnosis.theta.items() if n in loop.names})
    load, more = part.link.T
    sim = loop.simulate(part.record, values, link=part.link)
    q, dq, ddq, tau = sim.q[:, 0], sim.dq[:, 0], sim.ddq[:, 0], sim.tau[:, 0]
    against = sum(
        t.force(q, dq, ddq, [values[n] for n in t.names], tau, sim.t - sim.t[0])
        for t in loop.terms
        if t.law is not None and t.name != "inertia"
    )
    heavy = values["backlash.load_share"] * values["inertia"]
    drive = values["inertia"] - heavy
    own = np.maximum(heavy + more, LIGHTEST * heavy)
    return np.asarray((tau - against - drive * ddq - load) / own)


def _axis(
    j: int, loop: RobotLoop, inertia: float, own: Mapping[str, float], without: Sequence[str]
) -> ClosedLoop:
    axis = loop.axes[j]
    terms = [t for t in axis.terms if t.name != "inertia" and t.name not in without]
    start = {name: own[name] for t in terms for name in t.names}
    name = f"{loop.name}, {loop.joints[j]}"
    return replace(
        axis, terms=find(["inertia", *terms]), start={**start, "inertia": inertia}, name=name
    )


def with_effects(loop: RobotLoop, named: Mapping[str, Diagnosis]) -> RobotLoop:
    """Return the robot with what its joints' diagnoses named, as far as a robot can have it.

    The effects keep the values that the diagnoses found, on all samples; a robot is identified
    from those that move, where a friction at slow speed hardly shows.
    """
    held = list(loop.held)
    for joint, diagnosis in named.items():
        for effect in diagnosis.effects:
            if effect in _TWO_MASSES:
                continue
            values = diagnosis.parameters.get(effect, {})
            try:
                loop = loop.with_effect(joint, effect, **values)
            except (AxisError, KeyError, TypeError):  # a fault of the controller, say
                continue
            held += [n for n in loop.base.names if n.startswith(f"{joint}.{effect}.")]
    return replace(loop, held=tuple(held))


def errors(fit: FitResults, record: Record) -> dict[str, float]:
    """Return the rms of measured less simulated force per joint, N or N m; NaN if it diverges."""
    assert fit.problem is not None
    loop: Any = fit.problem.loop
    values = loop.values({str(k): float(v) for k, v in fit.params.items()})
    try:
        values = loop.possible(values, record, lambda: fit.X)
        simulation = loop.simulate(record, values)
    except (IVToolsError, EstimationError):
        return dict.fromkeys(loop.joints, float("nan"))
    gap = loop.force(record) - simulation.tau
    skipped = gap[record.n_samples // 20 :]
    rms = np.sqrt(np.mean(skipped**2, axis=0))
    return dict(zip(loop.joints, rms.tolist(), strict=True))
