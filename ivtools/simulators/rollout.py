"""MuJoCo as a simulator of one axis: the model's own physics under the axis' own controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import AxisError, RecordError
from ivtools.loop import ClosedLoop
from ivtools.physics import Term
from ivtools.record import Record
from ivtools.robot.mjcf import engine
from ivtools.simulators.digital import DigitalLaw
from ivtools.simulators.mjcf import Axis, closed_loop

Array = NDArray[np.float64]

_LIMIT = 1e6  # strokes: a joint that is further away has diverged


@dataclass(frozen=True, eq=False)
class MujocoSimulator:
    """One joint of a MuJoCo model in closed loop.

    A `<position>` or `<velocity>` actuator is its own controller and gets the reference; a
    `<motor>` gets the command of the axis' controller, computed from the joint's position at the
    record's rate and held between.

    Parameters
    ----------
    path : str or Path
        MJCF, or anything else that MuJoCo reads.
    joint : str
    actuator : str, optional
        Default: the only one that drives the joint.
    loop : ClosedLoop, optional
        The axis, for its controller; needed where the actuator has none.
    keyframe : str, optional
        Where the other joints are.
    sensor : str, optional
        Joint whose position the controller reads, if it is another one (a motor before a
        flexible transmission).
    beside : mapping of Term to sequence of float, optional
        Forces that the model cannot hold, applied to the joint at each of MuJoCo's steps: values
        of each term's parameters.

    Raises
    ------
    AxisError
        The model cannot be read, or lacks what is named.
    MissingExtraError
        MuJoCo is not installed.
    """

    path: str | Path
    joint: str
    actuator: str | None = None
    loop: ClosedLoop | None = None
    keyframe: str | None = None
    sensor: str | None = None
    beside: Mapping[Term, tuple[float, ...]] = field(default_factory=dict)

    @cached_property
    def axis(self) -> Axis:
        """The joint and its actuator in the compiled model."""
        axis = Axis.of(self.path, self.joint, self.actuator, self.keyframe)
        if axis.actuator < 0:
            raise AxisError(f"no actuator drives joint {self.joint!r}; add one to the model")
        return axis

    @cached_property
    def model(self) -> ClosedLoop:
        """The joint as a closed loop of ours, with the values that the model states."""
        law = None if self.loop is None else self.loop.controller
        return closed_loop(self.path, self.joint, self.actuator, self.keyframe, law)

    @property
    def parameters(self) -> dict[str, float]:
        """What the model states: inertia, friction, stiffness, by our names."""
        return dict(self.model.start)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each parameter."""
        return self.model.units

    @property
    def reads(self) -> Axis:
        """The joint that the controller reads."""
        if self.sensor is None:
            return self.axis
        return Axis.of(self.path, self.sensor, None, self.keyframe)

    @cached_property
    def _moving(self) -> list[Axis]:
        """The joints that begin as the record does: the joint, its sensor, an exported load."""
        mujoco, load = engine(), f"{self.joint}-load"
        exported = mujoco.mj_name2id(self.axis.model, mujoco.mjtObj.mjOBJ_JOINT, load) >= 0
        more = [Axis.of(self.path, load, None, self.keyframe)] if exported else []
        return [self.axis, self.reads, *more]

    def simulate(self, record: Record) -> Record:
        """Return what the model does on the record's reference, from its first position.

        Raises
        ------
        RecordError
            If the record has no reference, its step is no multiple of the model's, or the
            simulation diverges.
        """
        if record.q_ref is None:
            raise RecordError("q_ref is missing; the simulator follows the position reference")
        steps = self._steps(record.dt)
        own = bool(self.axis.kp or self.axis.kv)
        q, dq, force = (self._follow if own else self._drive)(record, steps)
        if not np.isfinite(q).all() or np.ptp(q) > _LIMIT * np.ptp(record.q_ref):
            raise RecordError("the MuJoCo simulation diverges; check gains, gear and time step")
        kept = {k: getattr(record, k) for k in ("q_ref", "dq_ref", "added")}
        return Record(
            t=record.t,
            q=q,
            dq=dq,
            nu=force,
            name=f"{record.name}, {Path(self.path).stem}",
            **{k: v for k, v in kept.items() if v is not None},
        )

    def simulate_changed(self, record: Record, found: Any) -> Record:
        """Return what the model does with a `Diagnosis` in it.

        Raises
        ------
        RecordError
            As `simulate` does.
        OSError
            If the model's folder cannot be written.
        """
        made = found.to_mjcf(self.path, self.joint, self.actuator)
        folder = Path(self.path).parent  # the files that a model refers to are found from there
        with NamedTemporaryFile("w", suffix=".xml", dir=folder, encoding="utf-8") as file:
            file.write(made.xml)
            file.flush()
            changed = replace(self, path=file.name, beside={**self.beside, **made.beside})
            return changed.simulate(record).replace(name=f"{record.name}, {Path(self.path).stem}")

    def _steps(self, dt: float) -> int:
        """Return MuJoCo's steps per sample."""
        own = float(self.axis.model.opt.timestep)
        steps = round(dt / own)
        if steps < 1 or abs(steps * own - dt) > 1e-6 * dt:
            raise RecordError(
                f"the record's step of {dt:g} s is no multiple of the model's {own:g} s; set "
                "<option timestep> to a whole part of it"
            )
        return steps

    def _begin(self, record: Record) -> Any:
        """Return the state at the record's first sample."""
        mujoco = engine()
        data = self.axis.data()
        speed = float(np.polyfit(record.t[:20] - record.t[0], record.q[:20, 0], 1)[0])
        for axis in self._moving:
            data.qpos[axis.position] = record.q[0, 0]
            data.qvel[axis.dof] = speed
        mujoco.mj_forward(self.axis.model, data)
        return data

    def _follow(self, record: Record, steps: int) -> tuple[Array, Array, Array]:
        """Run a model whose actuator is the controller."""
        axis = self.axis
        signal = record.q_ref if axis.kp else record.dq_ref
        if signal is None:
            signal = np.gradient(record.q_ref, record.dt, axis=0)  # type: ignore[arg-type]
        wanted = axis.gear * signal[:, 0]
        return self._run(record, steps, lambda k, q, dq: wanted[k], own=True)

    def _drive(self, record: Record, steps: int) -> tuple[Array, Array, Array]:
        """Run a model whose actuator gets the command of the axis' controller."""
        if self.loop is None:
            raise AxisError(
                "the model's actuator has no controller; give loop=, the axis whose controller "
                "drives it"
            )
        return self._run(record, steps, DigitalLaw(self.loop, record), own=False)

    def _run(
        self, record: Record, steps: int, command: Any, own: bool
    ) -> tuple[Array, Array, Array]:
        """Step the model; return position, velocity and command at each sample, (n_samples,)."""
        mujoco, axis, reads, data = engine(), self.axis, self.reads, self._begin(record)
        model, n = axis.model, record.n_samples
        out = np.empty((3, n))
        for k in range(n):
            q = float(data.qpos[reads.position])
            out[:2, k] = q, data.qvel[reads.dof]
            value = command(k, q, float(data.qvel[reads.dof]))
            data.ctrl[axis.actuator] = value
            if own:
                mujoco.mj_forward(model, data)
                value = float(data.actuator_force[axis.actuator])
            out[2, k] = value
            for _ in range(steps):
                if self.beside:
                    data.qfrc_applied[axis.dof] = -self._forces(data)
                mujoco.mj_step(model, data)
            if not np.isfinite(q):
                out[:, k:] = np.nan
                break
        return out[0], out[1], out[2]

    def _forces(self, data: Any) -> float:
        """Return what the terms beside the model hold against the joint, N or N m."""
        q, v = float(data.qpos[self.axis.position]), float(data.qvel[self.axis.dof])
        tau = float(data.qfrc_actuator[self.axis.dof])
        others = float(data.qfrc_passive[self.axis.dof] - data.qfrc_bias[self.axis.dof])
        total = 0.0
        for term, values in sorted(self.beside.items(), key=lambda item: item[0].net):
            if term.law is not None:
                drives = tau + others - total if term.net else tau
                state = (q, v, 0.0, float(np.sign(v)), drives, float(data.time))
                total += float(term.law(*state, *values))
        return total
