"""Joints: a robot is diagnosed joint by joint, what the others ask of each one as a known load."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import AxisError, EstimationError, IVToolsError
from ..estimators.instrumental import IDIMIV
from ..estimators.least_squares import IDIMWLS
from ..loop import ClosedLoop, RobotLoop
from ..physics import find
from ..problem import Problem
from ..record import Record
from ..results import FitResults
from .diagnose import diagnose
from .diagnosis import Diagnosis
from .robot_diagnosis import Coupled, RobotDiagnosis
from .rules import FAINT

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
    for j in wanted:
        say(f"joint {loop.joints[j]}")
        found[loop.joints[j]] = _joint(j, record, holdout, plain, settings)
    named = {name: d for name, d in found.items() if d.effects}
    better, problem = plain, plain.problem
    if named and problem is not None:
        better, more = identified(record, with_effects(loop, named), problem.pipeline)
        notes = (*notes, *more)
        for name in named if len(named) > 1 else ():
            say(f"joint {name}, beside the other joints' effects")
            j = loop.robot.joint(name)
            found[name] = _joint(j, record, holdout, better, settings, without=named[name].effects)
        kept = {name: found[name] for name in named if found[name].effects}
        if {n: d.effects for n, d in kept.items()} != {n: d.effects for n, d in named.items()}:
            better, more = identified(record, with_effects(loop, kept), problem.pipeline)
            notes = (*notes, *more)
    say("the coupled simulation")
    other = record if holdout is None else holdout
    coupled = Coupled(*(errors(fit, other) for fit in (plain, better)))
    return RobotDiagnosis(record.name, loop.name, found, plain, better, coupled, notes)


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
    record: Record,
    holdout: Record | None,
    fit: FitResults,
    settings: Mapping[str, Any],
    without: Sequence[str] = (),
) -> Diagnosis:
    """Diagnose one joint under the loads that the links of a fit put on it."""
    loaded = [
        None if one is None else alone(j, one, fit, without).record for one in (record, holdout)
    ]
    first = loaded[0]
    assert first is not None
    return heard(diagnose(first, alone(j, record, fit, without).loop, loaded[1], **settings))


def heard(diagnosis: Diagnosis) -> Diagnosis:
    """Return a diagnosis without names that hardly lower the error.

    The load comes from the measured motion and estimated links, so it is a little wrong; an effect
    that lowers the joint's error by less than `FAINT` may be that.
    """
    s = diagnosis.shrink
    if not diagnosis.effects or s is None or s.after < (1.0 - FAINT) * s.before:
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
    """One joint of a robot as an axis: its record with the others' load, and its loop."""

    record: Record
    loop: ClosedLoop


def alone(j: int, record: Record, fit: FitResults, without: Sequence[str] = ()) -> Alone:
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
    """
    problem = fit.problem
    assert problem is not None
    loop: Any = problem.loop
    values = loop.values({str(k): float(v) for k, v in fit.params.items()})
    motion = problem.pipeline.differentiate(record.q, record.dt)
    q, dq, ddq = (loop._to_joints(x) for x in motion)
    asked = loop.robot.torques(q, dq, ddq, loop.inertias(values))
    if loop.transmission is not None:
        asked = asked @ loop._T
    poses = problem.motion.q[:: max(len(problem.motion.q) // _POSES, 1)]  # of the fit's own record
    inertia = float(loop.mass_matrix(poses, values)[:, j, j].mean())
    own = loop.joint_values(j, values)
    load = asked[:, j] - (inertia - own.get("inertia", 0.0)) * motion.ddq[:, j]
    load = 0.5 * (load + np.append(load[1:], load[-1:]))  # held over the sample that it follows
    end = record.n_samples - problem.pipeline.trim[1]  # behind it derivatives are the filter's
    part, load = record.joint(j).slice(0, end), load[:end]
    outside = load if part.load is None else load + part.load[:, 0]
    return Alone(part.replace(load=outside[:, np.newaxis]), _axis(j, loop, inertia, own, without))


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
    """Return the robot with what its joints' diagnoses named, as far as a robot can have it."""
    for joint, diagnosis in named.items():
        for effect in diagnosis.effects:
            if effect in _TWO_MASSES:
                continue
            values = diagnosis.parameters.get(effect, {})
            try:
                loop = loop.with_effect(joint, effect, **values)
            except (AxisError, KeyError, TypeError):  # a fault of the controller, say
                continue
    return loop


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
