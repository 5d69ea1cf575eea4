"""The identification problem: a record and the loop that should behave like it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .errors import AxisError, EstimationError, IVToolsError, RecordError, ShapeError
from .linalg import solve_iv
from .loop import ClosedLoop, RobotLoop, Simulation
from .loop.model import Theta
from .loop.observer import driven_by, observed_velocity
from .loop.rough_inertia import position_columns, rough_inertia, start_values
from .pipeline import Motion, Pipeline
from .pipelines import Pipelines
from .record import Record

Array = NDArray[np.float64]

_SHORT = 400  # samples, enough to load the compiled loop
_LONG = 2_000_000  # samples, from which on memory counts more than time
ABSURD = 3.0  # ratio of inertias: a force that the model lacks decides
PULL = 0.12  # natural frequency of the observer, in that of the loop
_SLOW = 0.0012  # of the sampling rate, for a loop without a mode of its own
_OBSERVER_OPTIONS = ("initial", "substeps", "stiction")


class Pair(NamedTuple):
    """Rows of the measured and of the simulated trajectory.

    Attributes
    ----------
    X, y : (N, p), (N,) ndarray
        Measured: observation matrix, and force in N or N m.
    X_s, y_s : (N, p), (N,) ndarray
        Simulated: the instruments, and their force.
    """

    X: Array
    y: Array
    X_s: Array
    y_s: Array


@dataclass(frozen=True, eq=False, repr=False)
class Problem:
    """What an estimator works on: y = X theta + e, and the loop that makes instruments.

    Parameters
    ----------
    record : Record
        The measured record.
    loop : ClosedLoop or RobotLoop
        Its model; ``loop.names`` are the parameters. Rows are stacked joint by joint.
    pipeline : Pipeline or Pipelines, optional
        Default: the one that the loop's bandwidth asks for; of a robot, one per joint.
    simulation : mapping
        Options of `ClosedLoop.simulate` for every simulation, such as ``{"stiction": False}``.
    chosen_by : (n_samples, n_joints) ndarray, optional
        Velocity that decides which rows the pipeline masks, m/s or rad/s; default: the measured
        one (see `masked_by`).

    Examples
    --------
    >>> import ivtools as iv
    >>> problem = iv.Problem(iv.datasets.twin(), iv.axes.emps())
    >>> problem.X.shape[1] == len(problem.names)
    True
    """

    record: Record
    loop: ClosedLoop | Any  # or RobotLoop, which has the same face
    pipeline: Pipeline | Any = None  # filled in below
    simulation: Mapping[str, Any] = field(default_factory=dict)
    chosen_by: Array | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.record, Record) or not hasattr(self.loop, "joints"):
            given = f"{type(self.record).__name__} and {type(self.loop).__name__}"
            raise EstimationError(
                f"Problem was given a {given}; give a Record and a ClosedLoop or RobotLoop, in "
                "this order (Record.read and ClosedLoop.from_file read files)"
            )
        if self.record.n_joints != len(self.loop.joints):
            raise ShapeError(
                f"the record has {self.record.n_joints} joints and the loop "
                f"{len(self.loop.joints)} ({', '.join(self.loop.joints)}); a RobotLoop has several"
            )
        object.__setattr__(self, "loop", self.loop.known(self.record))
        if self.pipeline is None:
            object.__setattr__(self, "pipeline", self.loop.pipeline(self.record))
        object.__setattr__(self, "pipeline", self.pipeline.broken(self.record.breaks))

    def __repr__(self) -> str:
        return f"Problem: {', '.join(self.names)} of {self.loop!r} from {self.record!r}"

    def _repr_html_(self) -> str:
        from html import escape

        return f"<p>{escape(repr(self))}</p>"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of the columns of X."""
        return self.loop.names

    @property
    def units(self) -> dict[str, str]:
        """Unit of each parameter."""
        return self.loop.units

    @property
    def notes(self) -> tuple[str, ...]:
        """What the loop says about itself, such as that its controller was identified."""
        return self.loop.notes

    @cached_property
    def motion(self) -> Motion:
        """Band-passed position, velocity and acceleration of the record, (n_samples, 1) each."""
        return self.pipeline.differentiate(self.record.q, self.record.dt)

    @cached_property
    def force(self) -> Array:
        """Measured force at the sampling rate, aligned, N or N m, (n_samples, n_joints)."""
        return self.pipeline.align(self.loop.force(self.record))

    @cached_property
    def load(self) -> Array:
        """Known load, aligned as the force that meets it, N or N m, (n_samples, n_joints)."""
        if self.record.load is None:
            return np.broadcast_to(0.0, self.record.q.shape)
        return self.pipeline.align(self.record.load)

    @cached_property
    def _rows(self) -> Array:
        if self.record.n_samples <= _LONG:
            return self._through(self.motion, self.force)
        motion = self.pipeline.differentiate(self.record.q, self.record.dt)  # and not kept
        return self._through(motion, self.pipeline.align(self.loop.force(self.record)))

    @property
    def X(self) -> Array:
        """Observation matrix, (N, p)."""
        return self._rows[:, :-1]

    @property
    def y(self) -> Array:
        """Measurement vector, N or N m, (N,)."""
        return self._rows[:, -1]

    @property
    def t(self) -> Array:
        """Time of the rows, s, (N,)."""
        rows = self.pipeline.samples(self.record.n_samples, self.speed)
        return self.record.t[rows]

    @cached_property
    def row_joints(self) -> NDArray[np.int_]:
        """Joint that each row belongs to, (N,)."""
        if isinstance(self.pipeline, Pipelines):
            return self.pipeline.row_joints(self.record.n_samples, self.speed)
        return np.zeros(len(self.y), dtype=int)

    @property
    def speed(self) -> Array | None:
        """Velocity that decides which rows are masked, (n_samples, n_joints), if any are."""
        if not self.masked:
            return None
        return self.motion.dq if self.chosen_by is None else self.chosen_by

    @property
    def _from_zero(self) -> Array:
        """Time from the first sample, s; the record's own where that is 0, to save a copy."""
        t = self.record.t
        return t - t[0] if t[0] != 0.0 else t

    def _through(self, motion: Motion, force: Array) -> Array:
        """Return the rows (regressor, force less load) of a trajectory, measured or simulated."""
        t = self._from_zero
        if isinstance(self.pipeline, Pipelines):
            loop: Any = self.loop
            known = self.load + loop.held_force(motion, force, t)
            columns = beside(loop.regressor(motion, force, t), force - known)
            return self.pipeline.rows(columns, self.speed)
        rows = self._regressor_rows(motion, force, t)
        return beside(rows, self.pipeline.rows(force - self.load, self.speed))

    def _regressor_rows(self, motion: Motion, force: Array, t: Array) -> Array:
        """Return the rows of the regressor; those of a long record term by term, to save memory."""
        if len(t) <= _LONG or isinstance(self.pipeline, Pipelines):
            return self.pipeline.rows(self.loop.regressor(motion, force, t), self.speed)
        loop: Any = self.loop
        blocks = loop.blocks(motion, force, t)
        rows = np.hstack([self.pipeline.rows(block, self.speed) for block in blocks])
        return np.asfortranarray(rows)  # as all at once, so that results are the same

    def prepare(self) -> None:
        """Make what all methods share, so that no method's time has it: rows, start, compiled loop.

        What cannot be made is left to the method that needs it, which says why.
        """
        with suppress(IVToolsError):
            short = self.record.slice(0, min(self.record.n_samples, _SHORT))
            self.loop.simulate(short, self.start, **self.simulation)

    # --- simulated -----------------------------------------------------------------------------

    def simulate(self, theta: Theta | None = None) -> Simulation:
        """Simulate the closed loop on this record's reference; see `ClosedLoop.simulate`."""
        return self.loop.simulate(self.record, theta, **self.simulation)

    def simulated_rows(
        self, theta: Theta | None, *, filtered: bool = True, scale_gain: bool = False
    ) -> tuple[Array, Array]:
        """Return the regressor and the force of the simulated loop.

        Simulated signals take the same way through the pipeline as measured ones.

        Parameters
        ----------
        theta : mapping, Series or array_like
            Parameters of the simulation.
        filtered : bool
            Band-pass the simulated position as the measured one is; False takes the simulated
            velocity and acceleration as they are, as much of the literature does.
        scale_gain : bool
            Simulate `scaled_loop`, which stays near the record however wrong theta is. It is a
            way to a good start and not the loop of the record: finish without it.

        Returns
        -------
        Z : ndarray, (N, p)
        y_s : ndarray, (N,)

        Raises
        ------
        EstimationError
            If the simulated loop is unstable.
        """
        rows = self._through(*self._simulated(theta, filtered, scale_gain))
        return rows[:, :-1], rows[:, -1]

    def paired_rows(
        self, theta: Theta | None, *, filtered: bool = True, scale_gain: bool = False
    ) -> Pair:
        """Return measured and simulated rows, the direction of motion observed on both sides.

        Around standstill the sign of the measured velocity is noise, and friction multiplies it.
        That of the simulated one is no better where the encoder's noise shakes the axis through
        the controller. An observer knows both (`ivtools.loop.observer`): where its direction
        differs, its velocity is used. A sample with a reversal counts for either direction by its
        share (`share_behind`). What the observer gets wrong of a motion without noise, it gets
        wrong on the simulated side as well. A pipeline that masks what is slow needs none of
        that: the rows are then the plain ones.

        Parameters
        ----------
        theta, filtered, scale_gain
            As for `simulated_rows`.

        Raises
        ------
        EstimationError
            If the simulated loop is unstable.
        """
        X_s, y_s = self.paired_instruments(theta, filtered=filtered, scale_gain=scale_gain)
        return Pair(self.observed_rows(theta), self.y, X_s, y_s)

    def observed_rows(self, theta: Theta | None) -> Array:
        """Return the measured rows of `paired_rows`, (N, p)."""
        if self.masked:
            return self.X
        return self._directed(self.motion, self.force, self._driven, theta)[:, :-1]

    def paired_instruments(
        self, theta: Theta | None, *, filtered: bool = True, scale_gain: bool = False
    ) -> tuple[Array, Array]:
        """Return the simulated rows of `paired_rows` and their force, (N, p) and (N,)."""
        if self.masked:
            return self.simulated_rows(theta, filtered=filtered, scale_gain=scale_gain)
        simulation, motion = self._trajectory(theta, filtered, scale_gain)
        try:
            driven = driven_by(simulation.nu, motion.q, self.record)
        except RecordError as error:
            raise EstimationError(f"the simulated motion is no record: {error}") from error
        rows = self._directed(motion, self.pipeline.align(simulation.tau), driven, theta)
        return rows[:, :-1], rows[:, -1]

    @property
    def masked(self) -> bool:
        """Whether the pipeline leaves out where the direction of motion is in doubt."""
        return self.pipeline.min_speed > 0.0

    def masked_by(self, theta: Theta | None) -> Problem:
        """Return the problem with the rows in which the loop simulated at theta moves.

        Noise has its say in when an axis that sticks comes to rest and breaks away. Where the
        measured velocity chooses the rows, it keeps those that noise has pushed along and drops
        those that noise has stopped: the noise of the rows that stay has a mean, along the
        motion, and friction comes out too small. A simulation from the reference chooses without
        knowing the noise, as it makes the instruments.

        Parameters
        ----------
        theta : mapping, Series or array_like

        References
        ----------
        J. J. Heckman, "Sample selection bias as a specification error", Econometrica 47, 1979.

        Raises
        ------
        EstimationError
            If the simulated loop is unstable, or rests throughout.
        """
        motion = self._trajectory(theta, filtered=True, scale_gain=False)[1]
        if not self.pipeline.moving(len(motion.dq), motion.dq).any():
            raise EstimationError("the simulated loop rests throughout at these parameters")
        return replace(self, chosen_by=motion.dq)

    @cached_property
    def _driven(self) -> Record:
        return driven_by(self.loop.command(self.record), self.motion.q, self.record)

    def _observed(self, driven: Record, theta: Theta | None) -> Array:
        """Return the observed velocity, (n_samples, 1)."""
        options = {k: v for k, v in self.simulation.items() if k in _OBSERVER_OPTIONS}
        return observed_velocity(self.loop, driven, theta, self._pull_hz, **options)

    @cached_property
    def _pull_hz(self) -> float:
        """Natural frequency of the observer: well below the loop's, which follows the noise."""
        natural = self.loop.natural_frequency_hz(self.record.dt, self.start["inertia"])
        return PULL * natural if natural > 0.0 else _SLOW * self.record.sampling_hz

    def _directed(self, motion: Motion, force: Array, driven: Record, theta: Theta | None) -> Array:
        """Return the rows of a trajectory in the direction that the observer finds for it."""
        values = self.loop.values(theta)
        t, dq = self.record.t - self.record.t[0], self._observed(driven, values)
        columns = self.loop.regressor(_turned(motion, dq), force, t)  # (n_samples, p)
        later = np.append(dq[1:], dq[-1:], axis=0)
        k = np.flatnonzero(np.sign(dq) * np.sign(later) < (later != 0.0))  # a reversal follows
        part = Motion(*(signal[k] for signal in motion))
        change = self.loop.regressor(_turned(part, later[k]), force[k], t[k]) - columns[k]
        jump = change @ [values[name] for name in self.names]  # of the friction, N or N m
        kick = np.abs(jump)[:, np.newaxis] * self.record.dt / values["inertia"]  # m/s or rad/s
        columns[k] += share_behind(np.abs(dq[k]), np.abs(later[k]), kick) * change
        return self.pipeline.rows(beside(columns, force - self.load), self.speed)

    def _simulated(
        self, theta: Theta | None, filtered: bool, scale_gain: bool
    ) -> tuple[Motion, Array]:
        """Return motion and aligned force of the simulated loop, (n_samples, 1) each."""
        simulation, motion = self._trajectory(theta, filtered, scale_gain)
        force = self.pipeline.align(simulation.tau)
        if len(force) > _LONG:
            force = force.copy()  # a view would keep all signals of the simulation
        return motion, force

    def _trajectory(
        self, theta: Theta | None, filtered: bool, scale_gain: bool
    ) -> tuple[Simulation, Motion]:
        """Simulate the loop; also return its motion, band-passed if asked for."""
        values = self.loop.possible(self.loop.values(theta), self.record, lambda: self.X)
        loop = self.scaled_loop(values) if scale_gain else self.loop
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable loop is told below
            try:
                simulation = loop.simulate(self.record, values, **self.simulation)
            except AxisError as error:  # without inertia, or of links that cannot be
                raise EstimationError(str(error)) from error
        if not simulation.finite:
            raise EstimationError("the simulated loop is unstable at these parameters")
        if not filtered:
            return simulation, simulation.motion
        return simulation, self.pipeline.differentiate(simulation.q, self.record.dt)

    def scaled_loop(self, theta: Theta) -> ClosedLoop | Any:
        """Return the loop that keeps the real bandwidth whatever the inertia; see `loop.scaled`."""
        return self.loop.scaled(self.loop.values(theta), self._least_squares, self.record)

    def instruments(
        self, theta: Theta | None, *, filtered: bool = True, scale_gain: bool = False
    ) -> Array:
        """Return the instruments: the regressor of the loop simulated at theta, (N, p).

        The same as `simulated_rows` without its force, which saves a fifth of the time.
        """
        motion, force = self._simulated(theta, filtered, scale_gain)
        return self._regressor_rows(motion, force, self._from_zero)

    @cached_property
    def start(self) -> dict[str, float]:
        """Starting values: the axis file's where it gives them, else least squares."""
        ls = self._least_squares
        return {**ls, **{k: v for k, v in self.loop.start.items() if k in ls}}

    @cached_property
    def _least_squares(self) -> dict[str, float]:
        """Least squares of the model's terms, or, if its inertia is absurd, beside others."""
        if isinstance(self.loop, RobotLoop):
            guess = self.loop.first_guess(self.record)
            return {name: guess[name] for name in self.names}
        theta = solve_iv(self.X, self.y, names=self.names)
        if "inertia" in self.names and not self._plausible(theta[self.names.index("inertia")]):
            places = position_columns(self.motion.q[:, 0], self.loop.joint)
            places = self.pipeline.rows(places, self.speed)
            theta = start_values(self.X, self.y, places)
        return dict(zip(self.names, theta.tolist(), strict=True))

    def _plausible(self, inertia: float) -> bool:
        """Whether an inertia is near the one of the axis file, or else of the record."""
        rough = self.loop.start.get("inertia") or rough_inertia(self.loop, self.record)
        return rough / ABSURD < inertia < rough * ABSURD

    def select(self, names: Sequence[str]) -> Problem:
        """Return the problem with the terms of these parameters only."""
        terms = [t for t in self.loop.terms if t.law is None or set(t.names) & set(names)]
        return replace(self, loop=self.loop.with_terms(*terms))


def _turned(motion: Motion, dq: Array) -> Motion:
    """Return the motion with the velocity dq where it has another direction."""
    return motion._replace(dq=np.where(np.sign(motion.dq) == np.sign(dq), motion.dq, dq))


def beside(columns: Array, force: Array) -> Array:
    """Return columns (..., n_samples, p) with the force (n_samples, n_joints) as one more."""
    if columns.ndim == 2:
        return np.hstack([columns, force])
    return np.concatenate([columns, force.T[:, :, np.newaxis]], axis=2)


def share_behind(before: Array, after: Array, kick: Array) -> Array:
    """Return the share of a sample that lies behind a reversal within it.

    Friction brakes before a reversal, and behind it as well, where the force must overcome it:
    the speed falls faster than it rises. With a the speed that a whole sample would gain behind
    the reversal, it would lose a + kick before; so before/(a + kick) + after/a = 1, the shares of
    the sample, gives a. Straight on, as if kick were 0, the friction would be wrong on average.

    Parameters
    ----------
    before, after : (k, 1) ndarray
        Speed at the sample before the reversal and at the one behind it, m/s or rad/s.
    kick : (k, 1) ndarray
        Change of the friction force over a sample by the inertia, m/s or rad/s.

    Examples
    --------
    >>> share_behind(np.array([1.0, 0.75]), np.array([1.0, 0.25]), np.array([0.0, 1.0]))
    array([0.5, 0.5])
    """
    twice = before + after - kick
    gained = 0.5 * (twice + np.sqrt(twice**2 + 4.0 * after * kick))
    return after / np.maximum(gained, after)
