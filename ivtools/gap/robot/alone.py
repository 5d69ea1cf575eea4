"""Alone: a robot's joint as an axis, what its links ask of it as a known load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...loop import ClosedLoop, RobotLoop
from ...physics import find
from ...record import Record
from ...results import FitResults
from ..diagnosis import Diagnosis
from ..rules import POSES, SMALL_SWING
from .behind import Alone, follow

Array = NDArray[np.float64]


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
    values = loop.values(fit.params)
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
