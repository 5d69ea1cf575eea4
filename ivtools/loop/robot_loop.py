"""The closed loop of a robot: its joints' controllers and drives, and the mechanics they share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import AxisError, ShapeError
from ..physics import Parameter, Term, find
from ..pipeline import Motion
from ..pipelines import Pipelines
from ..record import Record
from ..record_format import RecordFormat
from ..robot.base import Base, group, preference, random_motion
from ..robot.robot import Robot
from .closed_loop import ClosedLoop
from .model import Array, Model, Theta
from .robot_masses import consistent, felt_inertias, possible
from .robot_pipelines import band_pipelines, first_guess, robot_pipelines
from .simulation import Simulation, over_stretches
from .standing import holding

if TYPE_CHECKING:
    from .closed_loop import Initial

_UNITS = {1: "kg", 2: "kg m", 3: "kg m2"}  # by the power of the length, plus one


@dataclass(frozen=True, eq=False)
class RobotLoop(Model):
    """A robot and the controllers of its joints: what can be identified, and simulated.

    Parameters
    ----------
    robot : Robot
        Geometry, and the standard parameters that starting values come from.
    axes : sequence of ClosedLoop
        Per joint its controller, its drive and its terms beside the links: frictions, offset,
        ``inertia`` for that of the drive, effects. Their starting values count.
    name : str
    transmission : (n, n) array_like, optional
        Joint positions are ``transmission @ q`` where q are the drives', as in a coupled wrist.
        Records, controllers and frictions then belong to the drives; so do the torques.
    start : mapping
        Starting values by full name, before those of `axes` and `robot`.
    log : RecordFormat
        How the columns of a record file become signals.
    notes : tuple of str
        What to say with every result.
    held : tuple of str
        Base parameters that keep their starting values, for a record does not tell them.

    Raises
    ------
    AxisError
        If the axes do not fit the joints, or an axis has an effect that a robot cannot have.

    Examples
    --------
    >>> import ivtools as iv
    >>> axis = iv.ClosedLoop(iv.loop.Controller("pd", {"kp": 2000.0, "kd": 100.0}), 1.0,
    ...     ("viscous", "coulomb", "offset"), joint="revolute",
    ...     start={"viscous": 5.0, "coulomb": 4.0, "offset": 0.0})
    >>> loop = iv.RobotLoop(iv.Robot.six_axis(), [axis] * 6)
    >>> len(loop.names), loop.names[0], loop.names[-1]
    (54, 'ZZ1R', 'joint_6.offset')
    """

    robot: Robot
    axes: Sequence[ClosedLoop]
    name: str = "robot"
    transmission: ArrayLike | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    log: RecordFormat = field(default_factory=RecordFormat)
    notes: tuple[str, ...] = ()
    held: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = self.robot.n_joints
        axes = tuple(self.axes)
        if len(axes) != n:
            raise AxisError(f"{len(axes)} axes for {n} joints ({', '.join(self.robot.names)})")
        kinds = [
            "prismatic" if joint.kind == "prismatic" else "revolute" for joint in self.robot.joints
        ]
        axes = tuple(replace(a, joint=kind) for a, kind in zip(axes, kinds, strict=True))
        for axis, joint in zip(axes, self.robot.names, strict=True):
            for term in axis.terms:
                if term.name in ("flexibility", "backlash"):
                    raise AxisError(
                        f"joint {joint}: {term.name} makes two masses of a joint, which only a "
                        "loop of one axis has"
                    )
        object.__setattr__(self, "axes", axes)
        if self.transmission is not None:
            object.__setattr__(self, "transmission", _transmission(self.transmission, n))
        for key in self.start:
            if key not in self.parameters:
                raise AxisError(f"start value {key!r} is not a parameter of robot {self.name!r}")

    @classmethod
    def from_file(cls, path: str | Path) -> RobotLoop:
        """Read a robot file (TOML).

        Raises
        ------
        AxisError
            If the file or the model that it names cannot be read, or says what is not understood.
        """
        from .robot_file import read

        return read(path)

    def to_toml(self, model: str) -> str:
        """Return the robot file of this loop, `model` being its URDF or MJCF file."""
        from .robot_file import write

        return write(self, model)

    # --- the model -------------------------------------------------------------------------------

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return self.robot.n_joints

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints."""
        return self.robot.names

    def kind_of(self, joint: int) -> str:
        """Return whether a joint, counted from 0, is prismatic or revolute."""
        return self.axes[joint].joint

    @property
    def terms(self) -> tuple[Term, ...]:  # type: ignore[override]
        """The terms of all joints, each once."""
        return tuple(dict.fromkeys(term for axis in self.axes for term in axis.terms))

    @cached_property
    def base(self) -> Base:
        """Base parameters: of links and of the joints' terms that the force is linear in."""
        q, dq, ddq = random_motion(self.robot)
        tau, t = np.random.default_rng(1).uniform(-1.0, 1.0, (2, *q.shape))
        motion = Motion(*(self._from_joints(x) for x in (q, dq, ddq)))
        links = self._links(motion, None).reshape(-1, 10 * self.n_joints)
        blocks = [links]
        for j, axis in enumerate(self.axes):
            part = Motion(*(x[:, j] for x in motion))
            own = axis.regressor(part, tau[:, j], t[:, j]) if axis.names else np.zeros((len(q), 0))
            rows = np.zeros((self.n_joints, *own.shape))
            rows[j] = own
            blocks.append(rows.reshape(-1, own.shape[1]))
        names = [*self.robot.standard_names, *self._own_names]
        order = preference(self.n_joints)
        return group(np.hstack(blocks), names, [*order, *range(len(order), len(names))])

    @property
    def _own_names(self) -> tuple[str, ...]:
        """Full names of the linear parameters of the joints' terms."""
        return tuple(
            f"{joint}.{name}"
            for joint, axis in zip(self.joints, self.axes, strict=True)
            for name in axis.names
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns of the observation matrix: base parameters that are not held."""
        return tuple(name for name in self.base.names if name not in self.held)

    @property
    def free(self) -> NDArray[np.intp]:
        """Which of the base parameters are not held."""
        return np.array([k for k, n in enumerate(self.base.names) if n not in self.held], np.intp)

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        """Every parameter by its full name: base parameters, then shapes of the joints' terms."""
        own = self._own_parameters
        found = {}
        for name, column in zip(self.base.names, self.base.columns.tolist(), strict=True):
            if column < 10 * self.n_joints:
                found[name] = Parameter(name, _unit(self.robot.standard_names[column]))
            else:
                found[name] = own[self.base.standard[column]]
        return found | {n: p for n, p in own.items() if n not in self._own_names}

    @cached_property
    def _own_parameters(self) -> dict[str, Parameter]:
        found = {}
        for joint, axis in zip(self.joints, self.axes, strict=True):
            for name, p in axis.parameters.items():
                found[f"{joint}.{name}"] = replace(p, unit=p.unit_for(axis.joint))
        return found

    @property
    def columns(self) -> Mapping[str, str]:
        """Names of the columns of a record file, ours = theirs."""
        return self.log.columns

    @property
    def units(self) -> dict[str, str]:
        """Unit of every parameter."""
        return {name: p.unit for name, p in self.parameters.items()}

    def _value(self, name: str, parameter: Parameter, given: Mapping[str, float]) -> float:
        if name in given:
            return given[name]
        return float(self._starts[name])

    @cached_property
    def _starts(self) -> dict[str, float]:
        """Starting values: stated, else those of robot and axes."""
        full = np.concatenate([self.robot.inertias.ravel(), self._own_starts()])
        found = dict(zip(self.base.names, (self.base.matrix @ full).tolist(), strict=True))
        for joint, axis in zip(self.joints, self.axes, strict=True):
            for name, p in axis.parameters.items():
                if (key := f"{joint}.{name}") in self.parameters and key not in found:
                    found[key] = axis.start.get(name, p.neutral)
        return {**found, **self.start}

    def _own_starts(self) -> Array:
        """Return starting values of the joints' linear parameters: the axis's, else the robot's."""
        known = {"viscous": "damping", "coulomb": "friction", "inertia": "armature"}
        values = [
            axis.start.get(name, getattr(joint, known.get(name, ""), axis.parameters[name].neutral))
            for joint, axis in zip(self.robot.joints, self.axes, strict=True)
            for name in axis.names
        ]
        return np.array(values, dtype=float)

    def with_terms(self, *terms: str | Term) -> RobotLoop:
        """Return this loop with these terms on every joint, beside the links."""
        return replace(self, axes=[a.with_terms(*terms) for a in self.axes], start={})

    def with_effect(self, joint: str, effect: str | Term, **values: float) -> RobotLoop:
        """Return this loop with one more effect in a joint; see `ClosedLoop.with_effect`."""
        j = self.robot.joint(joint)
        axes = list(self.axes)
        axes[j] = axes[j].with_effect(effect, **values)
        return replace(self, axes=axes)

    # --- signals ---------------------------------------------------------------------------------

    def force(self, record: Record) -> Array:
        """Return the measured force, (n_samples, n_joints), N or N m: tau, or gain times nu."""
        self._check(record)
        if record.tau is not None:
            return record.tau
        return self.command(record) * [axis.gain for axis in self.axes]

    def command(self, record: Record) -> Array:
        """Return the recorded command, (n_samples, n_joints): nu, or tau over the gain."""
        self._check(record)
        if record.nu is not None:
            return record.nu
        return self.force(record) / [axis.gain for axis in self.axes]

    def _check(self, record: Record) -> None:
        if record.n_joints != self.n_joints:
            raise ShapeError(
                f"the record has {record.n_joints} joints and robot {self.name!r} "
                f"{self.n_joints} ({', '.join(self.joints)}); one column per joint is needed"
            )

    def regressor(self, motion: Motion, tau: ArrayLike = 0.0, t: ArrayLike = 0.0) -> Array:
        """Return the observation matrix, (n_joints, n_samples, n_parameters).

        Parameters
        ----------
        motion : Motion
            Positions, velocities, accelerations, (n_samples, n_joints) each, of the drives.
        tau : (n_samples, n_joints) array_like, optional
            Drive forces, for terms that depend on them.
        t : (n_samples,) array_like, optional
            Time, s.
        """
        X = self._regressor(motion, tau, t)
        return X[:, :, self.free] if self.held else X

    def held_force(self, motion: Motion, tau: ArrayLike = 0.0, t: ArrayLike = 0.0) -> Array:
        """Return the force of the parameters that are held, (n_samples, n_joints), N or N m."""
        if not self.held:
            return np.broadcast_to(0.0, motion.q.shape)
        values, X = self.values(), self._regressor(motion, tau, t)
        theta = [values[n] if n in self.held else 0.0 for n in self.base.names]
        return np.asarray((X @ theta).T, dtype=float)

    def _regressor(self, motion: Motion, tau: ArrayLike, t: ArrayLike) -> Array:
        base, n = self.base, self.n_joints
        place = np.full(base.matrix.shape[1], -1)
        place[base.columns] = np.arange(len(base.columns))
        out = self._links(motion, np.ascontiguousarray(place[: 10 * n].reshape(n, 10)))
        tau = np.broadcast_to(np.asarray(tau, dtype=float), motion.q.shape)
        first = 10 * n
        for j, axis in enumerate(self.axes):
            last = first + len(axis.names)
            kept = np.flatnonzero(place[first:last] >= 0)
            if len(kept):
                part = Motion(*(x[:, j] for x in motion))
                own = axis.regressor(part, tau[:, j], t)
                out[j][:, place[first:last][kept]] = own[:, kept]
            first = last
        return out

    def _links(self, motion: Motion, columns: NDArray[np.int64] | None) -> Array:
        """Return the links' part of the observation matrix, (n_joints, n_samples, n_columns)."""
        q, dq, ddq = (self._to_joints(x) for x in motion)
        n_columns = 0 if columns is None else len(self.base.names)
        X = self.robot.regressor(q, dq, ddq, columns, n_columns).transpose(1, 0, 2)
        if self.transmission is not None:
            X = np.einsum("ji,jsk->isk", self._T, X)
        return np.asarray(X, dtype=float)

    @property
    def _T(self) -> Array:
        T = np.eye(self.n_joints) if self.transmission is None else self.transmission
        return np.asarray(T, dtype=float)

    def _to_joints(self, x: Array) -> Array:
        return x if self.transmission is None else x @ self._T.T

    def _from_joints(self, x: Array) -> Array:
        if self.transmission is None:
            return x
        return np.asarray(np.linalg.solve(self._T, x.T).T, dtype=float)

    def inertias(self, theta: Theta | None = None) -> Array:
        """Return standard parameters, (n, 10), that have these base parameters.

        They move as the robot does, but they are only one choice of many: parameters that are
        regrouped are 0. `ivtools.robot.consistent.nearest` chooses those that can exist.
        """
        values, n = self.values(theta), self.n_joints
        phi = np.zeros(10 * n)
        for name, column in zip(self.base.names, self.base.columns, strict=True):
            if column < 10 * n:
                phi[column] = values[name]
        return phi.reshape(n, 10)

    def joint_values(self, joint: int, values: Mapping[str, float]) -> dict[str, float]:
        """Return the values of a joint's own parameters, by their names on one axis."""
        axis, name = self.axes[joint], self.joints[joint]
        own = {key: f"{name}.{key}" for key in axis.parameters}
        return {key: values.get(self._kept.get(n, n), 0.0) for key, n in own.items()}

    @cached_property
    def _kept(self) -> dict[str, str]:
        """The base parameter as which each standard one that is kept is grouped, by name."""
        kept = (self.base.standard[column] for column in self.base.columns)
        return dict(zip(kept, self.base.names, strict=True))

    def mass_matrix(self, q: ArrayLike, theta: Theta | None = None) -> Array:
        """Return the mass matrix that the drives feel, (n_samples, n, n), kg m2 (kg, kg m)."""
        values = self.values(theta)
        M = self.robot.mass_matrix(self._to_joints(np.atleast_2d(q)), self.inertias(values))
        if self.transmission is not None:
            M = self._T.T @ M @ self._T
        own = [self.joint_values(j, values).get("inertia", 0.0) for j in range(self.n_joints)]
        return M + np.diag(own)

    def axis(self, joint: int, record: Record, theta: Theta | None = None) -> ClosedLoop:
        """Return the loop of one joint alone, with the inertia that its drive feels.

        That is 1/diag(inv(M)), the other joints left to move as they will, at the mean of M over
        the record.

        Parameters
        ----------
        joint : int
        record : Record
            Says where the robot moves.
        theta : mapping, Series or array_like, optional
            Parameters; default: the first guess of the record.
        """
        values = self.first_guess(record) if theta is None else self.values(theta)
        own, axis = self.joint_values(joint, values), self.axes[joint]
        terms = [t for t in axis.terms if t.name != "inertia"]
        start = {name: own[name] for t in terms for name in t.names}
        start["inertia"] = float(self.felt_inertias(record, values)[joint])
        name = f"{self.name}, {self.joints[joint]}"
        return replace(axis, terms=find(["inertia", *terms]), start=start, name=name)

    def felt_inertias(self, record: Record, theta: Theta | None = None) -> Array:
        """Return the inertia that each drive feels on a record, (n,); see `robot_masses`."""
        return felt_inertias(self, record, theta)

    def possible(
        self, values: Mapping[str, float], record: Record, rows: Callable[[], Array]
    ) -> dict[str, float]:
        """Return the nearest values that can be simulated on a record; see `robot_masses`."""
        return possible(self, values, record, rows)

    def consistent(
        self,
        theta: Theta,
        X: Array | None = None,
        pull: float = 1e-6,
        deviation: Array | None = None,
    ) -> Array:
        """Return parameters of links that can exist, (10 n + k,), nearest to these.

        Parameters
        ----------
        theta : mapping, Series or array_like
        X : (N, p) ndarray, optional
            Observation matrix, whose force measures distances; default: relative ones.
        pull : float
            Weight of the robot's own parameters, which decide what theta does not.
        deviation : (10 n + k,) ndarray, optional
            Their standard deviations in place of that weight; the rows of X have unit noise then.

        Returns
        -------
        ndarray
            Standard parameters, link by link, then the joints' own, in the order of
            ``base.standard``.
        """
        return consistent(self, theta, X, pull, deviation)

    def scaled(
        self, values: Mapping[str, float], measured: Mapping[str, float], record: Record
    ) -> RobotLoop:
        """Return the loop that keeps its bandwidths with the inertia of other values.

        What counts is the inertia that a drive feels, 1/diag(inv(M)); see `ClosedLoop.scaled`.
        """
        felt = [self.felt_inertias(record, v) for v in (values, measured)]
        axes = [
            replace(axis, controller=replace(axis.controller.scaled(float(r)), limit=np.inf))
            for axis, r in zip(self.axes, felt[0] / felt[1], strict=True)
        ]
        return replace(self, axes=axes)

    # --- the closed loop -------------------------------------------------------------------------

    def known(self, record: Record) -> RobotLoop:
        """Return this loop as far as a record tells it.

        Controllers that are to be identified are fitted; what joints that stand still do not show
        is held.
        """
        return holding(self._controlled(record), record)

    def _controlled(self, record: Record) -> RobotLoop:
        if all(axis.controller.kind != "identify" for axis in self.axes):
            return self
        self._check(record)
        axes = [axis.known(record.joint(j)) for j, axis in enumerate(self.axes)]
        said = [
            f"{joint}: {note}"
            for joint, axis, was in zip(self.joints, axes, self.axes, strict=True)
            for note in axis.notes[len(was.notes) :]
        ]
        return replace(self, axes=axes, notes=(*self.notes, *said))

    def simulate(
        self,
        record: Record,
        theta: Theta | None = None,
        *,
        initial: Initial = "record",
        substeps: int | None = None,
        position_noise: ArrayLike | None = None,
        force_noise: ArrayLike | None = None,
        quantum: ArrayLike = 0.0,
    ) -> Simulation:
        """Simulate the closed loop, driven by the record's references, added inputs and loads.

        A record without references is open loop: its commands drive the robot.

        Parameters
        ----------
        record : Record
        theta : mapping, Series or array_like, optional
            Parameters; default: the starting values.
        initial : {"record", "rest"} or (q, dq)
            Start in the record's own state, at rest on its first reference, or as given, (n,) each.
        substeps : int, optional
            Integration steps per sample; default: one per millisecond, or what the terms need.
        position_noise, force_noise : (n_samples, n_joints) array_like, optional
            Added to the measured positions (m or rad) and to the drive forces (N or N m).
        quantum : float or (n_joints,) array_like
            Resolution of the encoders, m or rad; 0 is none.

        Raises
        ------
        AxisError
            If the mass matrix of these parameters is not positive definite.
        """
        from .robot_engine import simulate

        if record.breaks:
            noises = {"position_noise": position_noise, "force_noise": force_noise}
            options = {"initial": initial, "substeps": substeps, "quantum": quantum}
            return over_stretches(self, record, theta, noises, **options)
        return simulate(
            self._controlled(record),
            record,
            self.values(theta),
            initial=initial,
            substeps=substeps,
            position_noise=position_noise,
            force_noise=force_noise,
            quantum=quantum,
        )

    def pipeline(self, record: Record, **settings: Any) -> Pipelines:
        """Return the pipelines of the joints: those of `ClosedLoop.pipeline`, at one decimation.

        A sequence among the settings has one value per joint.
        """
        return robot_pipelines(self, record, **settings)

    def first_guess(self, record: Record) -> dict[str, float]:
        """Return least squares in the band that the references move in, made possible."""
        return first_guess(self, record)

    def band_pipelines(self, record: Record) -> Pipelines:
        """Return pipelines that keep a few times the band in which each joint moves."""
        return band_pipelines(self, record)


def _unit(name: str) -> str:
    """Return the unit of a standard parameter by its name, ``XX1``."""
    return _UNITS[len(name.rstrip("0123456789"))] if name[0] == "M" else "kg m2"


def _transmission(matrix: ArrayLike, n: int) -> Array:
    T = np.asarray(matrix, dtype=float)
    if T.shape != (n, n) or not np.isfinite(T).all() or np.linalg.cond(T) > 1e8:
        raise AxisError(
            f"transmission is {T.shape}; {n} joints need an invertible ({n}, {n}) matrix"
        )
    return T
