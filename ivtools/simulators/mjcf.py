"""MuJoCo models: what a joint and its actuator say as a closed loop of ours."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, expm1, pi, sin
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ivtools.errors import AxisError
from ivtools.loop import ClosedLoop
from ivtools.loop.controllers import Controller
from ivtools.robot.mjcf import engine
from ivtools.xml_file import check_counts

if TYPE_CHECKING:
    import mujoco

_SILENCE = 1e-9  # N per unit of command
_TURNS = 24  # poses at which a hinge's gravity is asked for


@dataclass(frozen=True)
class Axis:
    """One joint of a MuJoCo model with the actuator that drives it.

    Attributes
    ----------
    model : mujoco.MjModel
    joint, dof, position : int
        Identifier of the joint, and where its velocity and its position stand in the state.
    actuator : int
        Identifier of the actuator, -1 if none drives the joint.
    pose : ndarray, (nq,)
        Where the other joints are, m or rad.
    """

    model: mujoco.MjModel
    joint: int
    dof: int
    position: int
    actuator: int
    pose: np.ndarray

    @classmethod
    def of(
        cls, path: str | Path, joint: str, actuator: str | None, keyframe: str | None = None
    ) -> Axis:
        """Read a model and find its joint and actuator.

        Raises
        ------
        AxisError
            The file cannot be read, or has no such joint, actuator or keyframe.
        MissingExtraError
            MuJoCo is not installed.
        """
        mujoco = engine()
        try:
            check_counts(Path(path))
            model = mujoco.MjModel.from_xml_path(str(path))
        except (ValueError, OSError) as error:
            reason = " ".join(str(error).split())[:200]
            raise AxisError(f"MuJoCo cannot read {path}: {reason}") from error
        number = _identifier(model, "joint", joint)
        kind = mujoco.mjtJoint(model.jnt_type[number])
        if kind not in (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE):
            raise AxisError(
                f"joint {joint!r} is a {kind.name[6:].lower()}; give a slide or a hinge"
            )
        drive = _actuator(model, number, joint, actuator)
        pose = model.qpos0 if keyframe is None else _key(model, keyframe)
        return cls(
            model,
            number,
            int(model.jnt_dofadr[number]),
            int(model.jnt_qposadr[number]),
            drive,
            np.array(pose, dtype=float),
        )

    @property
    def revolute(self) -> bool:
        """Whether the joint turns."""
        return bool(self.model.jnt_type[self.joint] == engine().mjtJoint.mjJNT_HINGE)

    @property
    def gear(self) -> float:
        """Joint force per actuator force."""
        return 1.0 if self.actuator < 0 else float(self.model.actuator_gear[self.actuator, 0])

    @property
    def kp(self) -> float:
        """Position gain of a `<position>` actuator, N/m or N m/rad of the actuator; else 0."""
        return -float(self.model.actuator_biasprm[self.actuator, 1]) if self.actuator >= 0 else 0.0

    @property
    def kv(self) -> float:
        """Velocity gain of a `<position>` or `<velocity>` actuator; else 0."""
        return -float(self.model.actuator_biasprm[self.actuator, 2]) if self.actuator >= 0 else 0.0

    def data(self) -> Any:
        """Return the state of the model at its pose."""
        mujoco = engine()
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.pose
        mujoco.mj_forward(self.model, data)
        return data

    def inertia(self) -> float:
        """Return what the joint moves at the pose, armature included, kg or kg m2.

        It is the inertia that the joint feels with all others held: what a log of this joint
        alone shows.
        """
        mujoco = engine()
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data(), full)
        return float(full[self.dof, self.dof])

    def load(self, q: float) -> float:
        """Return the force of gravity against the joint at a position, N or N m."""
        mujoco = engine()
        data = mujoco.MjData(self.model)
        data.qpos[:] = self.pose
        data.qpos[self.position] = q
        mujoco.mj_forward(self.model, data)
        return float(data.qfrc_bias[self.dof])


def _identifier(model: Any, kind: str, name: str) -> int:
    """Return the number of a named thing of a model."""
    mujoco = engine()
    number = mujoco.mj_name2id(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name)
    if number < 0:
        count = {"joint": model.njnt, "actuator": model.nu, "key": model.nkey}[kind]
        names = [getattr(model, kind)(k).name for k in range(count)]
        known = ", ".join(n for n in names if n) or "none has a name"
        raise AxisError(f"the model has no {kind} {name!r}; it has: {known}")
    return int(number)


def _key(model: Any, name: str) -> Any:
    return model.key_qpos[_identifier(model, "key", name)]


def _actuator(model: Any, joint: int, name: str, wanted: str | None) -> int:
    """Return the actuator that drives a joint; -1 if none does and none is named."""
    mujoco = engine()
    drives = [
        k
        for k in range(model.nu)
        if model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT
        and model.actuator_trnid[k, 0] == joint
        and _pushes(model, k)
    ]
    if wanted is not None:
        found = _identifier(model, "actuator", wanted)
        if found not in drives:
            raise AxisError(f"actuator {wanted!r} does not drive joint {name!r}")
        return found
    if len(drives) > 1:
        names = ", ".join(model.actuator(k).name or str(k) for k in drives)
        raise AxisError(f"joint {name!r} has {len(drives)} actuators ({names}); name one")
    return drives[0] if drives else -1


def _pushes(model: Any, actuator: int) -> bool:
    """Whether an actuator answers a command; one that only holds a bias or cogging does not."""
    mujoco = engine()
    data, force = mujoco.MjData(model), []
    for command in (0.0, 1.0):
        data.ctrl[actuator] = command
        mujoco.mj_forward(model, data)
        force.append(float(data.actuator_force[actuator]))
    lags = model.actuator_actnum[actuator] > 0
    late = model.actuator_delay[actuator] > 0.0
    return lags or late or abs(force[1] - force[0]) > _SILENCE


def closed_loop(
    path: str | Path,
    joint: str,
    actuator: str | None = None,
    keyframe: str | None = None,
    controller: Controller | None = None,
) -> ClosedLoop:
    """Read a joint of a MuJoCo model as a closed loop; see `ClosedLoop.from_mjcf`."""
    axis = Axis.of(path, joint, actuator, keyframe)
    terms, start = _mechanics(axis)
    notes = [f"from {Path(path).name}, joint {joint}", *_warnings(axis)]
    delay, lag = _timing(axis)
    if lag:
        terms.append("drive-timing")
        start["drive-timing.lag"] = lag
    law = controller or _law(axis)
    if law.kind == "identify":
        notes.append(
            "the model's actuator has no controller of its own; give yours under [controller]"
        )
    return ClosedLoop(
        controller=law,
        gain=axis.gear,
        terms=tuple(terms),
        name=f"{Path(path).stem} {joint}",
        joint="revolute" if axis.revolute else "prismatic",
        delay=delay,
        start=start,
        notes=tuple(notes),
    )


def _mechanics(axis: Axis) -> tuple[list[Any], dict[str, float]]:
    """Return the terms of the joint, and the values that the model gives them."""
    model, joint, dof = axis.model, axis.joint, axis.dof
    viscous = float(model.dof_damping[dof]) + axis.gear**2 * _own_damping(axis)
    start = {
        "inertia": axis.inertia(),
        "viscous": viscous,
        "coulomb": float(model.dof_frictionloss[dof]),
    }
    terms = ["inertia", "viscous", "coulomb", "offset"]
    quadratic, cubic = (float(x) for x in model.dof_dampingpoly[dof][:2])
    if quadratic or cubic:
        terms.append("polynomial-viscous")
        start |= {"polynomial-viscous.quadratic": quadratic, "polynomial-viscous.cubic": cubic}
    start["offset"], gravity = _gravity(axis)
    if any(gravity.values()):
        terms.append("gravity")
        start |= gravity
    k1, k2 = float(model.jnt_stiffness[joint]), float(model.jnt_stiffnesspoly[joint][0])
    if k1 or k2:
        at = float(model.qpos_spring[axis.position])
        terms.append("spring")
        start |= {"spring.stiffness": k1 - 2.0 * k2 * at, "spring.curvature": k2}
        start["offset"] += (k2 * at - k1) * at
    return terms, start


def _gravity(axis: Axis) -> tuple[float, dict[str, float]]:
    """Return the constant force of gravity, and its sine and cosine over the angle of a hinge."""
    if not axis.revolute:
        return axis.load(float(axis.pose[axis.position])), {}
    turns = 2.0 * pi * np.arange(_TURNS) / _TURNS
    load = np.array([axis.load(q) for q in turns])
    waves = {"gravity.sin": sin, "gravity.cos": cos}
    parts = {
        name: float(2.0 * np.mean(load * [wave(q) for q in turns])) for name, wave in waves.items()
    }
    floor = 1e-9 * float(np.max(np.abs(load), initial=0.0))
    return float(np.mean(load)), {k: v if abs(v) > floor else 0.0 for k, v in parts.items()}


def _own_damping(axis: Axis) -> float:
    """Return the damping of the actuator itself, N s/m or N m s/rad at the actuator."""
    return float(axis.model.actuator_damping[axis.actuator]) if axis.actuator >= 0 else 0.0


def _timing(axis: Axis) -> tuple[float, float]:
    """Return delay and lag of the actuator, s."""
    mujoco, k = engine(), axis.actuator
    if k < 0 or axis.kp or axis.kv:  # then the reference is late, not the force
        return 0.0, 0.0
    step, kind = float(axis.model.opt.timestep), axis.model.actuator_dyntype[k]
    delay, lag = float(axis.model.actuator_delay[k]), float(axis.model.actuator_dynprm[k, 0])
    whole = max(delay, step) if delay > 0.0 else 0.0
    if kind not in (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT) or lag <= 0.0:
        return whole, 0.0
    # how late a ramp comes through the filter in steps of time, a step earlier if it acts early
    late = lag if kind == mujoco.mjtDyn.mjDYN_FILTER else -step / expm1(-step / lag)
    return whole, max(late - step * bool(axis.model.actuator_actearly[k]), 0.0)


def _law(axis: Axis) -> Controller:
    """Return the controller that a `<position>` or `<velocity>` actuator is."""
    kp, kv, gear = axis.kp, axis.kv, axis.gear
    limit = _limit(axis)
    if kp and kv:
        return Controller(
            "cascade-pd", {"kp": kp / kv, "kv": kv * gear}, limit=limit, velocity="logged"
        )
    if kp:
        return Controller("pd", {"kp": kp * gear, "kd": 0.0}, limit=limit)
    if kv:
        return Controller("p-velocity", {"kv": kv * gear}, limit=limit, velocity="logged")
    return Controller("identify", {}, limit=limit)


def _limit(axis: Axis) -> float:
    """Return the largest force of the actuator; the smaller of both directions."""
    if axis.actuator < 0 or not axis.model.actuator_forcelimited[axis.actuator]:
        return float("inf")
    return float(np.min(np.abs(axis.model.actuator_forcerange[axis.actuator])))


def _warnings(axis: Axis) -> list[str]:
    """Return what a reader must know before comparing the numbers."""
    mujoco, model = engine(), axis.model
    out = []
    implicit = (mujoco.mjtIntegrator.mjINT_IMPLICITFAST, mujoco.mjtIntegrator.mjINT_IMPLICIT)
    if model.opt.integrator in implicit:
        extra = model.opt.timestep * (axis.kv * axis.gear**2 + float(model.dof_damping[axis.dof]))
        out.append(
            f"the model's implicit integrator adds about {extra:.3g} to the inertia that its logs "
            "show (time step times damping)"
        )
    if model.dof_frictionloss[axis.dof]:
        out.append(
            "MuJoCo's frictionloss creeps at standstill unless solreffriction and solimpfriction "
            "are stiff; as shipped its logs look like regularised Coulomb friction"
        )
    if model.nv > 1:
        out.append("the other joints are held at their pose; what they do is an outside force")
    return out
