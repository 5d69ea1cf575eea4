"""Encoders: whether a record's angles count as the robot's model does; gravity tells."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..pipeline import Motion
from ..record import Record
from ..units import JOINTS
from .standing import at_rest

if TYPE_CHECKING:
    from .robot_loop import RobotLoop

Array = NDArray[np.float64]

MARGIN = 0.02  # of the range of a joint, by which it may be passed
OVER = 0.05  # of a limit of speed or force, by which it may be passed
BETTER = 0.75  # share of what is left that another direction or zero position may leave at most
POOR = 0.02  # share of the force's variance that a model in doubt leaves
_LEAST = 1e-3  # share below which a joint is explained
_ROWS = 1500  # of the record, at which hypotheses are compared
_TURNS = {"+90": 0.5 * np.pi, "-90": -0.5 * np.pi, "180": np.pi}


class Told(NamedTuple):
    """What a hypothesis leaves of the force.

    Attributes
    ----------
    left : float
        Share of the variance, geometric mean over the joints.
    scale : (n_joints,) ndarray
        Of the links' force, as the robot's file has them.
    """

    left: float
    scale: Array


def doubts(loop: RobotLoop, record: Record) -> list[str]:
    """Return what speaks against the zero positions, directions and limits of a record's joints.

    The force of the links, as the robot's file states them, is compared with the measured one,
    friction apart. Where another direction or zero position of one joint explains much more, that
    joint is named; one at a time, the most telling first. Of a wrist the forces are small, and of
    an upright first joint nothing but its direction shows at all: their faults can go unsaid.

    Parameters
    ----------
    loop : RobotLoop
        Without coupled wrists: for those nothing is said.
    record : Record
    """
    found = list(_beyond(loop, record))
    if loop.transmission is not None or at_rest(record).all():
        return found
    motion, force = _sampled(loop, record)
    found += _over(loop, motion, force)
    now = _told(loop, motion, force)
    options = {
        (j, name): _told(loop, _changed(motion, j, name), force)
        for j, joint in enumerate(loop.robot.joints)
        for name in ("other way", *(_TURNS if joint.kind == "revolute" else ()))
    }
    (j, name), best = min(options.items(), key=lambda pair: pair[1].left)
    if now.left > POOR and best.left < BETTER * now.left:
        turned = f"had its zero position turned by {name} degrees"
        how = "counted the other way" if name == "other way" else turned
        found.append(
            f"{loop.joints[j]}: the model leaves {100 * best.left:.2g} % instead of "
            f"{100 * now.left:.2g} % of the forces' variance if its encoder {how}; put the log or "
            "the model right"
        )
        now = best
    opposite = (now.scale < 0.0) & ~at_rest(record) & (now.left < POOR)
    return found + [
        f"{name}: its torque and its encoder have opposite signs"
        for name, wrong in zip(loop.joints, opposite.tolist(), strict=True)
        if wrong
    ]


def _beyond(loop: RobotLoop, record: Record) -> list[str]:
    """Return which joints are beyond the range of the robot's file."""
    found = []
    q = loop._to_joints(record.q)
    for joint, x in zip(loop.robot.joints, q.T, strict=True):
        low, high, unit = joint.lower, joint.upper, JOINTS[joint.kind].length
        room = MARGIN * (high - low) if np.isfinite(high - low) else 0.0
        if x.min() < low - room or x.max() > high + room:
            found.append(
                f"{joint.name}: positions {x.min():.3g} to {x.max():.3g} {unit} are beyond its "
                f"range, {low:.3g} to {high:.3g} {unit}: another zero position, or unit?"
            )
    return found


def _over(loop: RobotLoop, motion: Motion, force: Array) -> list[str]:
    """Return which joints are faster, or pushed harder, than the robot's file allows."""
    found = []
    for j, (joint, axis) in enumerate(zip(loop.robot.joints, loop.axes, strict=True)):
        slides = joint.kind == "prismatic"
        for what, signal, most, unit in (
            ("speeds", motion.dq, joint.speed, "m/s" if slides else "rad/s"),
            ("forces", force, joint.effort, "N" if slides else "N m"),
        ):
            largest = float(np.abs(signal[:, j]).max())
            if largest > (1.0 + OVER) * most:
                also = " or gain" if what == "forces" and axis.gain != 1.0 else ""
                found.append(
                    f"{joint.name}: {what} up to {largest:.3g} {unit} are beyond its limit, "
                    f"{most:.3g} {unit}: another unit{also}, or is the limit stale?"
                )
    return found


def _sampled(loop: RobotLoop, record: Record) -> tuple[Motion, Array]:
    """Return motion and force, less known loads, at some samples, (n_rows, n_joints) each."""
    pipelines = loop.band_pipelines(record)
    motion = pipelines.differentiate(record.q, record.dt)
    force = pipelines.align(loop.force(record) - (0.0 if record.load is None else record.load))
    head, tail = pipelines.trim
    rows = np.linspace(head, record.n_samples - 1 - tail, _ROWS).astype(int)
    return Motion(*(signal[rows] for signal in motion)), force[rows]


def _changed(motion: Motion, j: int, name: str) -> Motion:
    """Return the motion with the angle of a joint counted in another way."""
    q, dq, ddq = (signal.copy() for signal in motion)
    if name == "other way":
        q[:, j], dq[:, j], ddq[:, j] = -q[:, j], -dq[:, j], -ddq[:, j]
    else:
        q[:, j] += _TURNS[name]
    return Motion(q, dq, ddq)


def _told(loop: RobotLoop, motion: Motion, force: Array) -> Told:
    """Compare the forces with those of the links, frictions and drives, joint by joint."""
    q, dq, ddq = motion
    asked, left, scale = loop.robot.torques(q, dq, ddq), [], np.ones(force.shape[1])
    for j in range(force.shape[1]):
        own = [dq[:, j], np.sign(dq[:, j]), ddq[:, j], np.ones(len(dq))]
        X = np.column_stack([asked[:, j], *own])
        size = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
        theta = np.linalg.lstsq(X / size, force[:, j], rcond=1e-9)[0]
        error = force[:, j] - X / size @ theta
        left.append(float(np.var(error) / max(float(np.var(force[:, j])), 1e-300)))
        scale[j] = theta[0] / size[0]
    return Told(float(np.exp(np.mean(np.log(np.maximum(left, _LEAST))))), scale)
