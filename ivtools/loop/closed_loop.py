"""The closed loop that should behave like the axis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import ceil, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import AxisError, RecordError, ShapeError
from ..physics import Parameter, Term, find
from ..pipeline import Motion, Pipeline
from ..record import Record
from .controllers import Controller
from .simulation import Simulation

if TYPE_CHECKING:
    import control

Array = NDArray[np.float64]
Theta = Mapping[str, float] | ArrayLike
Initial = Literal["record", "rest"] | tuple[float, float]


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """An axis and its controller: what can be identified, and simulated.

    Parameters
    ----------
    controller : Controller
        The control law.
    gain : float
        Drive gain, N/V or N m/V.
    terms : tuple of Term or str
        The terms of the dynamic model, in the order of the observation matrix.
    name : str
    joint : str
        ``"prismatic"`` or ``"revolute"``.
    delay : float
        Delay of the drive, from the recorded command to the force, s.
    start : mapping
        Starting values of parameters, and values of shape parameters, by full name.
    columns : mapping
        Names of the columns of a record file, ``{"q": "position"}``.

    Raises
    ------
    AxisError
        If a term is unknown or given twice, or a number is not usable.

    Examples
    --------
    >>> import ivtools as iv
    >>> loop = iv.axes.emps()
    >>> loop.names
    ('inertia', 'viscous', 'coulomb', 'offset')
    >>> loop.with_effect("stribeck", force=5.0, speed=0.01).names[-1]
    'stribeck.force'
    """

    controller: Controller
    gain: float
    terms: tuple[Term, ...]
    name: str = "axis"
    joint: str = "prismatic"
    delay: float = 0.0
    start: Mapping[str, float] = field(default_factory=dict)
    columns: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", find(self.terms))
        names = [term.name for term in self.terms]
        for name in names:
            if names.count(name) > 1:
                raise AxisError(f"term {name!r} is given twice; a model holds each term once")
        if self.joint not in ("prismatic", "revolute"):
            raise AxisError(f"joint is {self.joint!r}; it is 'prismatic' or 'revolute'")
        if not (isfinite(self.gain) and self.gain != 0.0):
            raise AxisError(f"drive gain is {self.gain}; it must be finite and not 0")
        if not (isfinite(self.delay) and self.delay >= 0.0):
            raise AxisError(f"drive delay is {self.delay} s; it must be finite and not negative")
        for key in self.start:
            if key not in self.parameters:
                known = ", ".join(self.parameters)
                raise AxisError(f"start value {key!r} is not a parameter; parameters: {known}")

    @classmethod
    def from_file(cls, path: str | Path) -> ClosedLoop:
        """Read an axis file (TOML).

        Raises
        ------
        AxisError
            If the file cannot be read, or says something that is not understood.
        """
        from .axis_file import read

        return read(path)

    # --- parameters -------------------------------------------------------------------------

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Every parameter by its full name."""
        return {n: p for t in self.terms for n, p in zip(t.names, t.parameters, strict=True)}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns of the observation matrix: what the force is linear in."""
        return tuple(
            n
            for t in self.terms
            if t.law is not None
            for n, p in zip(t.names, t.parameters, strict=True)
            if p.linear
        )

    @property
    def units(self) -> dict[str, str]:
        """Unit of every parameter."""
        return {name: p.unit_for(self.joint) for name, p in self.parameters.items()}

    def values(self, theta: Theta | None = None) -> dict[str, float]:
        """Return the value of every parameter.

        Parameters
        ----------
        theta : mapping, Series or array_like, optional
            Values by name, or in the order of `names`. What it lacks comes from `start`; the
            parameters of an effect, and shape parameters, may also keep their neutral values.

        Raises
        ------
        AxisError
            If a name is unknown, a value missing or not finite.
        ShapeError
            If an array has the wrong length.
        """
        if theta is None:
            given: dict[str, float] = {}
        elif hasattr(theta, "items"):
            given = {str(k): float(v) for k, v in theta.items()}
        else:
            array = np.ravel(np.asarray(theta, dtype=float))
            if len(array) != len(self.names):
                raise ShapeError(
                    f"theta has {len(array)} values and the model {len(self.names)} parameters: "
                    f"{', '.join(self.names)}"
                )
            given = dict(zip(self.names, array.tolist(), strict=True))
        for key, value in given.items():
            if key not in self.parameters:
                known = ", ".join(self.parameters)
                raise AxisError(f"parameter {key!r} is not in the model, whose are: {known}")
            if not isfinite(value):
                raise AxisError(f"parameter {key} is {value}; it must be finite")
        return {n: self._value(n, p, given) for n, p in self.parameters.items()}

    def _value(self, name: str, parameter: Parameter, given: Mapping[str, float]) -> float:
        if name in given:
            return given[name]
        if name in self.start:
            return float(self.start[name])
        if name in self.names and any(t.base and name in t.names for t in self.terms):
            raise AxisError(
                f"parameter {name!r} has no value; give theta, or a starting value in [model.start]"
            )
        return parameter.neutral

    def with_terms(self, *terms: str | Term) -> ClosedLoop:
        """Return this loop with another model; starting values that still apply are kept."""
        found = find(terms)
        known = {n for t in found for n in t.names}
        start = {k: v for k, v in self.start.items() if k in known}
        return replace(self, terms=found, start=start)

    def with_effect(self, effect: str | Term, **values: float) -> ClosedLoop:
        """Return this loop with one more effect in it.

        Parameters
        ----------
        effect : str or Term
            Identifier (``ivtools effects`` lists them) or a term of your own.
        **values : float
            Values of the effect's parameters, by their name within the effect.

        Examples
        --------
        >>> import ivtools as iv
        >>> loop = iv.axes.emps().with_effect("drive-timing", delay=0.0005)
        >>> loop.values({"inertia": 95, "viscous": 200, "coulomb": 20, "offset": 0})[
        ...     "drive-timing.delay"]
        0.0005
        """
        (term,) = find([effect])
        names = dict(zip((p.name for p in term.parameters), term.names, strict=True))
        for key in values:
            if key not in names:
                raise AxisError(f"{term.name} has no parameter {key!r}; it has {', '.join(names)}")
        start = {**self.start, **{names[k]: float(v) for k, v in values.items()}}
        return replace(self, terms=(*self.terms, term), start=start)

    # --- the inverse dynamic model ------------------------------------------------------------

    def force(self, record: Record) -> Array:
        """Return the measured force, N or N m, (n_samples, n_joints): tau, or gain times nu."""
        if record.tau is not None:
            return record.tau
        if record.nu is None:
            raise RecordError("the record has neither nu nor tau; one of them is needed")
        return self.gain * record.nu

    def command(self, record: Record) -> Array:
        """Return the recorded command, (n_samples, n_joints): nu, or tau over the gain."""
        return record.nu if record.nu is not None else self.force(record) / self.gain

    def regressor(self, motion: Motion, tau: ArrayLike = 0.0, t: ArrayLike = 0.0) -> Array:
        """Return the observation matrix along a trajectory, (n_samples, n_parameters).

        Parameters
        ----------
        motion : Motion
            Position, velocity, acceleration of the joint.
        tau, t : array_like, optional
            Drive force and time, for terms that depend on them.
        """
        q, dq, ddq = (np.ravel(a) for a in motion)
        blocks = [
            term.columns(q, dq, ddq, np.ravel(tau), np.ravel(t), self.start)
            for term in self.terms
            if term.law is not None
        ]
        return np.hstack(blocks)

    # --- the closed loop ------------------------------------------------------------------------

    def simulate(
        self,
        record: Record,
        theta: Theta | None = None,
        *,
        initial: Initial = "record",
        substeps: int | None = None,
        position_noise: ArrayLike | None = None,
        force_noise: ArrayLike | None = None,
        quantum: float = 0.0,
        ramp: bool = False,
        stiction: bool = True,
    ) -> Simulation:
        """Simulate the closed loop, driven by the record's reference and added input.

        Parameters
        ----------
        record : Record
            Gives q_ref, dq_ref, added, the sampling step and the initial state.
        theta : mapping, Series or array_like, optional
            Parameters; default: the starting values.
        initial : {"record", "rest"} or (q, dq)
            Start in the record's own state, at rest on its first reference, or as given.
        substeps : int, optional
            Integration steps per sample; default: what the terms need.
        position_noise, force_noise : array_like, (n_samples,), optional
            Added to the measured position (m or rad) and to the drive force (N or N m).
        quantum : float
            Resolution of the encoder, m or rad; 0 is none.
        ramp : bool
            Interpolate the added input between samples instead of holding it.
        stiction : bool
            Locate reversals and hold the axis while friction can; False takes sign(dq) as it
            comes, which chatters at standstill, as simulations without zero-crossing
            detection do.

        Returns
        -------
        Simulation

        Raises
        ------
        RecordError
            If the record has no reference.
        AxisError
            If a parameter is missing, or the inertia is not positive.
        """
        from .engine import simulate

        return simulate(
            self,
            record,
            self.values(theta),
            initial=initial,
            substeps=substeps,
            position_noise=position_noise,
            force_noise=force_noise,
            quantum=quantum,
            ramp=ramp,
            stiction=stiction,
        )

    def system(
        self,
        theta: Theta | None = None,
        *,
        dt: float = 1e-3,
        substeps: int | None = None,
    ) -> control.InterconnectedSystem:
        """Return the closed loop as a discrete python-control system with named signals.

        Parameters
        ----------
        theta : mapping, Series or array_like, optional
            Parameters; default: the starting values.
        dt : float
            Sampling step, s.
        substeps : int, optional
            Integration steps per sample.

        Returns
        -------
        control.InterconnectedSystem
            Inputs q_ref, dq_ref, added; outputs q, dq, nu, tau.
        """
        from .system import system

        return system(self, self.values(theta), dt, substeps or self.substeps)

    @property
    def substeps(self) -> int:
        """Integration steps per sample that the terms need."""
        return max(term.substeps for term in self.terms)

    def natural_frequency_hz(self, dt: float, inertia: float | None = None) -> float:
        """Return the natural frequency of the loop's dominant mode, Hz.

        It is that of the linearised rigid loop without dry friction.

        Parameters
        ----------
        dt : float
            Sampling step, s.
        inertia : float, optional
            In kg or kg m2; default: the starting value.
        """
        from .mode import dominant_mode_hz

        inertia = self.values()["inertia"] if inertia is None else inertia
        viscous = self.start.get("viscous", self.start.get("viscous_pos", 0.0))
        return dominant_mode_hz(self, inertia, viscous, dt)

    def pipeline(self, record: Record, **settings: Any) -> Pipeline:
        """Return the pipeline that this loop's bandwidth asks for.

        The natural frequency is taken to one significant digit, as the EMPS report does, then its
        rules apply: cut-off at 5 times, decimation to 2 times that frequency.
        """
        inertia = self.start.get("inertia") or rough_inertia(self, record)
        natural = self.natural_frequency_hz(record.dt, inertia)
        if not natural > 0.0:
            raise AxisError(
                "the closed loop has no mode of its own; check the controller's gains, or give a "
                "Pipeline"
            )
        return Pipeline.from_bandwidth(float(f"{natural:.0e}"), record.sampling_hz, **settings)


def rough_inertia(loop: ClosedLoop, record: Record) -> float:
    """Return a first guess of the inertia from the record alone, kg or kg m2.

    The filters need a bandwidth before anything is identified; a least-squares fit behind a
    low-pass at a fiftieth of the sampling rate is enough for one significant digit of it.
    """
    from ..linalg import solve_iv

    width = max(10, ceil(50 / 5))
    pipeline = Pipeline(record.sampling_hz / 50.0, width, trim=(5 * width, 5 * width))
    motion = pipeline.differentiate(record.q, record.dt)
    rigid = loop.with_terms("inertia", "viscous", "coulomb", "offset")
    rows = pipeline.rows(np.hstack([rigid.regressor(motion), loop.force(record)]))
    inertia = float(solve_iv(rows[:, :-1], rows[:, -1])[0])
    if not inertia > 0.0:
        raise AxisError(
            f"the record suggests an inertia of {inertia:.3g}; check units and the sign of the "
            "command, or give [model.start] inertia in the axis file"
        )
    return inertia
