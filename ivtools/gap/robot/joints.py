"""Joints: a robot is diagnosed joint by joint, what the others ask of each one as a known load."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import AxisError, EstimationError, IVToolsError
from ...estimators.instrumental import IDIMIV
from ...estimators.least_squares import IDIMWLS
from ...linalg.columns import fir, projection
from ...loop import ClosedLoop, RobotLoop
from ...physics import find
from ...problem import Problem
from ...record import Record
from ...results import FitResults
from ...workers import one_blas_thread
from .. import response
from ..diagnose import Begun, Task, begin, finish
from ..diagnosis import Diagnosis
from ..fit import of_effect
from ..floor import autoregression
from ..fold import Doubt, Link, threaded
from ..rules import ADEQUATE, FAINT, POSES, ROUNDS, SMALL_SWING, SWING_IN, SWUNG
from ..verdict import lowers
from .behind import TWO_MASSES, Alone, follow
from .diagnosis import Coupled, RobotDiagnosis
from .links import Links, measure

Array = NDArray[np.float64]


@one_blas_thread()
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
    swing as that joint by itself says. So the joint that leaves most goes first, and in the second
    round that with the largest gain; no joint is diagnosed again under loads that are the same.
    Where a joint beside a swinging link is not explained, or swings as well, it may be the other
    way round, and both orders are compared.

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
    numbers = [loop.robot.joint(name) for name in (joints or loop.joints)]
    loop = loop.known(record)
    say("identifying the robot")
    plain, notes = identified(record, loop)
    records = [one for one in (record, holdout) if one is not None]
    loads = rigid = _Loads.of(plain, records, [None] * len(records))
    every = threaded(lambda j: _Joint(j, loop.joints[j], rigid, settings), numbers)
    joints_by = {one.name: one for one in every}
    wanted = list(joints_by)
    named: dict[str, Diagnosis] = {}
    better = plain
    for again in range(ROUNDS):
        if better is not plain:
            loads = _Loads.of(better, records, [loads.told[one] for one in records])
        soft: dict[str, Diagnosis] = {}
        for name in sorted(wanted, key=lambda name: -joints_by[name].turn):
            one = joints_by[name]
            say(f"joint {name}" + (", beside the other joints' effects" if again else ""))
            own = named[name].effects if name in named and better is not plain else ()
            one.diagnosed(loads if better is not plain else rigid, own, soft)
            if not again:
                joints_by |= _other_way_round(one, [joints_by[n] for n in soft], soft)
            swinging = {n: joints_by[n].found for n in (*soft, name)}
            soft = {n: d for n, d in swinging.items() if d is not None and _swings(d, again)}
        last, named = named, {}
        for name, one in joints_by.items():
            assert one.found is not None
            told_of = one.found if again + 1 == ROUNDS else assumed(one.found)
            if told_of.effects:
                named[name] = told_of
        if plain.problem is None or _effects(named) == _effects(last):
            break
        fuller = with_effects(loop, named)
        if fuller.held == loop.held:  # it can have none of them
            better = plain
        else:
            better, more = identified(record, fuller, plain.problem.pipeline)
            notes = (*notes, *more)
        wanted = [name for name in wanted if joints_by[name].open]
    found = {name: one.found for name, one in joints_by.items() if one.found is not None}
    answers = {name: found[name] for name in loop.joints if name in found}
    say("the coupled simulation")
    other = record if holdout is None else holdout
    coupled = Coupled(*(errors(fit, other) for fit in (plain, better)))
    return RobotDiagnosis(record.name, loop.name, answers, plain, better, coupled, notes)


class _Loads(NamedTuple):
    """What the links put on the joints by a fit, and what each record tells of them."""

    fit: FitResults
    told: Mapping[Record, Links | None]

    @classmethod
    def of(
        cls, fit: FitResults, records: Sequence[Record], before: Sequence[Links | None]
    ) -> _Loads:
        """Return those of a fit; what another fit told of each record spares some of the work."""
        told = threaded(lambda one, known: measure(fit, one, known), records, before)
        return cls(fit, dict(zip(records, told, strict=True)))


class _Joint:
    """One joint, from round to round.

    Parameters
    ----------
    j : int
        Counted from 0.
    name : str
    rigid : _Loads
        By the fit without any effect.
    settings : mapping
        As for `diagnose`.
    """

    def __init__(self, j: int, name: str, rigid: _Loads, settings: Mapping[str, Any]):
        self.j, self.name, self.rigid, self.settings = j, name, rigid, settings
        self.stiff = _begun(j, rigid, settings)
        self.found: Diagnosis | None = None
        self._begun_under: Any = None  # which loads: these very objects
        self._found_under: Any = None
        self._leads = False  # before those that leave more
        self._places: Mapping[str, Any] = {}  # where its second mass was found

    @property
    def turn(self) -> float:
        """What the joints are diagnosed in the order of, the largest first.

        That is the energy that the rigid joint leaves, and later the gain of its two masses.
        """
        if self.found is not None:
            return np.inf if self._leads else _swing(self.found)
        return self.stiff.left if isinstance(self.stiff, Begun) else 0.0

    @property
    def open(self) -> bool:
        """Whether links that are estimated with what is named may change what is said of it."""
        return self.found is not None and self.found.verdict != "adequate"

    @property
    def unsettled(self) -> bool:
        """Whether what is said of it may be the swing of another joint's link, or lack it."""
        assert self.found is not None
        swings = any(e in TWO_MASSES for e in self.found.effects)
        return swings or self.found.verdict in ("partial", "unexplained")

    def first(self, leads: bool) -> _Joint:
        """Return the same joint, of which nothing is said yet."""
        one = copy(self)
        one.found = one._begun_under = one._found_under = None
        one._leads, one._places = leads, {}
        return one

    def diagnosed(
        self, loads: _Loads, own: tuple[str, ...], soft: Mapping[str, Diagnosis]
    ) -> Diagnosis:
        """Return what is found under these loads, which is not looked for again under the same.

        Parameters
        ----------
        loads : _Loads
        own : tuple of str
            Effects of this joint that the links were estimated with.
        soft : mapping of str to Diagnosis
            Joints that have two masses.
        """
        known = self.found
        itself = known is not None and not known.effects and _swing(known) > 0.0
        link = {self.name: known} if known is not None and itself else {}
        under = loads.fit, own, {**soft, **link}
        if known is not None and under == self._begun_under:
            return known
        self._begun_under, begun = under, self._begin(loads, own, soft)
        swung = _swung(self.stiff, begun) if soft else 0.0
        beside = {**(soft if swung > 0.0 else {}), **link}
        under = loads.fit, own, beside
        if known is not None and under == self._found_under:
            return known
        self._found_under = under
        if beside.keys() != soft.keys():
            begun = self._begin(loads, own, beside)
        self.found = heard(finish(begun), SWUNG * max(swung, 0.0))
        self._places = begun.places if isinstance(begun, Begun) else {}
        return self.found

    def _begin(
        self, loads: _Loads, own: tuple[str, ...], beside: Mapping[str, Diagnosis]
    ) -> Begun | Diagnosis:
        if loads is self.rigid and not beside:
            return self.stiff
        settings = {**self.settings, "places": self._places}
        return _begun(self.j, loads, settings, own, beside)


def _other_way_round(
    one: _Joint, others: Sequence[_Joint], soft: Mapping[str, Diagnosis]
) -> dict[str, _Joint]:
    """Return two joints as they are diagnosed the other way round, if that explains more.

    The link of either swings along with that of the other, and the one that leaves more by itself
    need not be the one that is soft. Fewer names that leave fewer joints unexplained are the
    better explanation, then the smaller force error of both.

    Parameters
    ----------
    one : _Joint
        Diagnosed beside the others.
    others : sequence of _Joint
        They have two masses.
    soft : mapping of str to Diagnosis
        What was found of those.
    """
    if not (one.unsettled and isinstance(one.stiff, Begun) and one.stiff.left > ADEQUATE):
        return {}
    first = one.first(leads=True)
    for last in others[:1]:
        beside = {n: d for n, d in soft.items() if n != last.name}
        found = first.diagnosed(one.rigid, (), beside)
        second = last.first(leads=False)
        if _swings(found) and _better(
            (found, second.diagnosed(one.rigid, (), {**beside, one.name: found})),
            (last.found, one.found),
        ):
            return {one.name: first, last.name: second}
    return {}


def _better(these: Sequence[Diagnosis | None], those: Sequence[Diagnosis | None]) -> bool:
    """Whether diagnoses of two joints explain more than others of the same, in any order."""

    def rank(found: Sequence[Diagnosis | None]) -> tuple[int, float]:
        """Return how much they take to explain what they do, and what they leave."""
        some = [d for d in found if d is not None]
        taken = sum(len(d.effects) + (d.verdict in ("partial", "unexplained")) for d in some)
        return taken, float(np.prod([d.shrink.after if d.shrink else np.inf for d in some]))

    return rank(these) < rank(those)


def _swings(diagnosis: Diagnosis, again: int = 0) -> bool:
    """Whether a joint's link swings, as far as others are to know.

    What is supposed, or named after another effect, may be the swing of another joint's link: that
    waits for the second round.
    """
    first = any(e in TWO_MASSES for e in diagnosis.effects[:1])
    return _swing(diagnosis) > 0.0 and (first or again > 0)


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
        return one.gain if one.effect in TWO_MASSES else 0.0
    both = (e for e in diagnosis.effects if e in TWO_MASSES and e in diagnosis.evidence)
    return max((diagnosis.evidence[e].gain for e in both), default=0.0)


def _effects(found: Mapping[str, Diagnosis]) -> dict[str, tuple[str, ...]]:
    return {name: d.effects for name, d in found.items()}


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


def _begun(
    j: int,
    loads: _Loads,
    settings: Mapping[str, Any],
    without: Sequence[str] = (),
    soft: Mapping[str, Diagnosis] | None = None,
) -> Begun | Diagnosis:
    """Begin to diagnose one joint under the loads that the links of a fit put on it."""
    fit, told = loads
    name = fit.problem.loop.joints[j]  # type: ignore[union-attr]
    soft = {n: assumed(d) for n, d in soft.items()} if soft else None
    parts = [alone(j, one, fit, without, soft) for one in told]
    other = parts[1].record if len(parts) > 1 else None
    behind = [
        Link(part.record.t, part.link, _doubt(name, links, part))
        for links, part in zip(told.values(), parts, strict=True)
    ]
    return begin(Task(parts[0].record, parts[0].loop, other, links=behind, **settings))


def _doubt(joint: str, links: Links | None, part: Alone) -> Doubt:
    """Return what is not known of a joint's load: of the links, and of how the record began."""
    record = part.record
    answers = response.measure(part.loop, record, part.loop.start)(part.unknown)
    none = np.zeros((record.n_samples, 0))
    told = Doubt(record.t, none, np.zeros(0), np.zeros((0, 0)))
    return (told if links is None else links.doubt(joint)).beside(record, answers)


def _swung(stiff: Begun | Diagnosis, begun: Begun | Diagnosis) -> float:
    """Return how much energy a rigid joint leaves beyond the same one beside swinging links.

    In N2 or (N m)2; NaN where one of them is refused, and nothing where its error is the likelier
    one. Each has a noise of its own, for that of the rigid one is learnt where links swing: what is
    new in an error from sample to sample says which is likelier. How much more is left is judged by
    the noise of the second, but for what its parameters may stand for.
    """
    if isinstance(stiff, Diagnosis) or isinstance(begun, Diagnosis):
        return float("nan")
    likelier, more = 0.0, 0.0
    for rigid, beside in zip(stiff.measured, begun.measured, strict=True):
        errors = [m.fold.force_error(m.base.loop, m.base.values) for m in (rigid, beside)]
        new = [_new(e, beside.fold.keep) for e in errors]
        likelier += float(np.log(new[0] / new[1]))
        e = beside.fold.white(errors[0])
        e -= projection(beside.base.J, e)
        more += float(e @ e) / len(e) - beside.base.cost
    return more / len(begun.measured) * _surprise(begun) if likelier > 0.0 else 0.0


def _new(e: Array, keep: NDArray[np.bool_]) -> float:
    """Return the energy of what is new in an error from sample to sample."""
    return float(np.mean(fir(autoregression(e, keep), e)[keep] ** 2))


def _surprise(diagnosis: Diagnosis | Begun) -> float:
    """Return the energy of what is new in a joint's noise, N2 or (N m)2."""
    return sum(floor.whitener[0] ** -2 for floor in diagnosis.floors)


def heard(diagnosis: Diagnosis, swung: float = 0.0) -> Diagnosis:
    """Return a diagnosis without names that hardly lower the error.

    The load comes from the measured motion and estimated links, so it is a little wrong; an effect
    that lowers the joint's error by less than `FAINT` may be that. The swing of other joints' links
    is known to a share of it: what removes less energy than `swung`, N2 or (N m)2, may be the rest.
    """
    s, removed = diagnosis.shrink, diagnosis.chi[0] - diagnosis.chi[1]
    if not diagnosis.effects or s is None:
        return diagnosis
    names = ", ".join(diagnosis.effects)
    if removed * _surprise(diagnosis) < swung:
        said = f"{names} would remove less than the links of other joints may have left: not named"
    elif not lowers(s, True, removed):
        said = f"{names} would lower the force error by less than {100 * FAINT:g} %: not named"
    else:
        return diagnosis
    return replace(
        diagnosis,
        verdict="adequate" if diagnosis.negligible else "unexplained",
        effects=(),
        advice=(*diagnosis.advice, said),
    )


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
    motion.dq[:2] = motion.ddq[:2] = 0.0  # links hang where they do at rest when a record begins
    places, ddqs, loose = motion.q.copy(), motion.ddq.copy(), []
    for name, diagnosis in (soft or {}).items():
        i = loop.joints.index(name)
        ours = (n for n in loop.joint_values(i, values) if n not in diagnosis.theta)
        its = alone(i, record, fit, [n.partition(".")[0] for n in ours])  # not what it lost again
        rows = slice(0, its.record.n_samples)
        link = follow(diagnosis, its, motion.dq[rows, i], ddqs[rows, i])
        places[rows, i], ddqs[rows, i] = link.q, link.ddq
        loose += [(rows, i, *x) for x in link.unknown]

    def asks(places: Array, ddqs: Array) -> Array:
        """Return what the links ask of the drives, N or N m, (n_samples, n)."""
        q, dq, ddq = (loop._to_joints(x) for x in (places, motion.dq, ddqs))
        asked = loop.robot.torques(q, dq, ddq, loop.inertias(values))
        return np.asarray(asked if loop.transmission is None else asked @ loop._T)

    asked = asks(places, ddqs)
    unknown = [_blows(record.n_samples, problem.pipeline.trim[0])]
    for rows, i, x, ddx in loose:
        size = SMALL_SWING / max(float(np.max(np.abs(x))), 1e-300)
        turned, jerked = places.copy(), ddqs.copy()
        turned[rows, i] += size * x
        jerked[rows, i] += size * ddx
        unknown.append((asks(turned, jerked) - asked)[:, [j]])
    poses = problem.motion.q[:: max(len(problem.motion.q) // POSES, 1)]  # of the fit's own record
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
    axis = _axis(j, loop, inertia, own, without)
    return Alone(part, axis, both[:end, 1:], np.hstack(unknown)[:end])


def _blows(n: int, head: int) -> Array:
    """Return unit forces at the start of a record whose head is trimmed, (n, 3)."""
    blows = np.zeros((n, 3))
    blows[[0, head // 2, head], range(3)] = 1.0
    return blows


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
            if effect in TWO_MASSES:
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
    skipped = gap[record.n_samples // SWING_IN :]
    rms = np.sqrt(np.mean(skipped**2, axis=0))
    return dict(zip(loop.joints, rms.tolist(), strict=True))
