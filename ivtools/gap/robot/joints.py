"""Joints: a robot is diagnosed joint by joint, what the others ask of each one as a known load."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ...errors import AxisError, IVToolsError
from ...estimators.instrumental import IDIMIV
from ...estimators.least_squares import IDIMWLS
from ...loop import RobotLoop
from ...problem import Problem
from ...record import Record
from ...results import FitResults
from ...workers import one_blas_thread, threaded
from ..diagnosis import Diagnosis
from ..rules import ROUNDS, SWING_IN
from .behind import TWO_MASSES
from .diagnosis import Coupled, RobotDiagnosis
from .joint import Joint, Loads, assumed, other_way_round, swings
from .links import possible

_OF_LINKS = ("gravity",)  # effects that the links of a robot have among their parameters


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
    if any(loop.robot.gravity):
        settings["without"] = (*settings.get("without", ()), *_OF_LINKS)
    say("identifying the robot")
    plain, notes = identified(record, loop)
    records = [one for one in (record, holdout) if one is not None]
    loads = rigid = Loads.of(plain, records, [None] * len(records))
    every = threaded(lambda j: Joint(j, loop.joints[j], rigid, settings), numbers)
    by_name = {one.name: one for one in every}
    wanted = list(by_name)
    named: dict[str, Diagnosis] = {}
    better = plain
    for again in range(ROUNDS):
        if better is not plain:
            loads = Loads.of(better, records, [loads.links[one] for one in records])
        soft: dict[str, Diagnosis] = {}
        for name in sorted(wanted, key=lambda name: -by_name[name].turn):
            one = by_name[name]
            say(f"joint {name}" + (", beside the other joints' effects" if again else ""))
            own = named[name].effects if name in named and better is not plain else ()
            one.diagnosed(loads if better is not plain else rigid, own, soft)
            if not again:
                by_name |= other_way_round(one, [by_name[n] for n in soft])
            swinging = {n: by_name[n].found for n in (*soft, name)}
            soft = {n: d for n, d in swinging.items() if d is not None and swings(d, again)}
        last, named = named, {}
        for name, one in by_name.items():
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
        wanted = [name for name in wanted if by_name[name].open]
    found = {name: one.found for name, one in by_name.items() if one.found is not None}
    answers = {name: found[name] for name in loop.joints if name in found}
    say("the coupled simulation")
    other = record if holdout is None else holdout
    coupled = Coupled(*(errors(fit, other) for fit in (plain, better)))
    return RobotDiagnosis(record.name, loop.name, answers, plain, better, coupled, notes)


def _effects(found: Mapping[str, Diagnosis]) -> dict[str, tuple[str, ...]]:
    return {name: d.effects for name, d in found.items()}


def identified(
    record: Record, loop: RobotLoop, pipeline: Any = None
) -> tuple[FitResults, tuple[str, ...]]:
    """Return the robot's parameters by instruments, or by least squares if that fails.

    It does where they do not converge, or to links that cannot be.
    """
    problem = Problem(record, loop, pipeline)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = IDIMIV().fit(problem)
        if fit.converged and _can_be(fit, record):
            return fit, ()
        what = "lead to links that cannot be" if fit.converged else "did not converge"
        said = f"the instruments {what}: the links are those of weighted least squares"
        return IDIMWLS().fit(problem), (said,)


def _can_be(fit: FitResults, record: Record) -> bool:
    """Whether the links of a fit have a mass wherever a record has them."""
    assert fit.problem is not None
    loop: Any = fit.problem.loop
    try:
        loop.felt_inertias(record, fit.params)
    except AxisError:
        return False
    return True


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
    try:
        simulation = loop.simulate(record, possible(fit, record))
    except IVToolsError:
        return dict.fromkeys(loop.joints, float("nan"))
    gap = loop.force(record) - simulation.tau
    skipped = gap[record.n_samples // SWING_IN :]
    rms = np.sqrt(np.mean(skipped**2, axis=0))
    return dict(zip(loop.joints, rms.tolist(), strict=True))
