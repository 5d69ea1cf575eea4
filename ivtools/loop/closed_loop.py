"""The closed loop that should behave like the axis."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from math import inf, isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal
from weakref import WeakKeyDictionary

from numpy.typing import ArrayLike

from ..errors import AxisError, RecordError
from ..limits import LARGEST
from ..physics import Term, find
from ..pipeline import Pipeline
from ..record import Record
from ..record_format import RecordFormat
from .controllers import Controller
from .model import Array, Model, Theta
from .simulation import Simulation, over_stretches

if TYPE_CHECKING:
    import control

    from .default_pipeline import Rule
    from .identification import ControllerFit

_LONGEST_DELAY = 10.0  # s; what is longer is a slip of the unit
Initial = Literal["record", "rest"] | tuple[float, float]


@dataclass(frozen=True, eq=False, repr=False)
class ClosedLoop(Model):
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
    log : RecordFormat
        How the columns of a record file become signals: their names, units and rate.
    rows : mapping
        What the default `Pipeline` is to be like: its `rule`, and settings instead of the rule's.
    notes : tuple of str
        What to say with every result, such as where the controller comes from.

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
    log: RecordFormat = field(default_factory=RecordFormat)
    rows: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", find(self.terms))
        names = [term.name for term in self.terms]
        for name in names:
            if names.count(name) > 1:
                raise AxisError(f"term {name!r} is given twice; a model holds each term once")
        if self.joint not in ("prismatic", "revolute"):
            raise AxisError(f"joint is {self.joint!r}; it is 'prismatic' or 'revolute'")
        if not 1.0 / LARGEST <= abs(self.gain) <= LARGEST:
            raise AxisError(
                f"drive gain is {self.gain}; it must be finite and not 0: {1.0 / LARGEST:g} to "
                f"{LARGEST:g} in size"
            )
        if not 0.0 <= self.delay <= _LONGEST_DELAY:
            raise AxisError(
                f"drive delay is {self.delay} s; it lies between 0 and {_LONGEST_DELAY} s"
            )
        for key in self.start:
            if key not in self.parameters:
                known = ", ".join(self.parameters)
                raise AxisError(f"start value {key!r} is not a parameter; parameters: {known}")
            if isnan(self.start[key]):
                raise AxisError(f"start value {key} is nan; give a number")
        known_rows = ["rule", *(f.name for f in fields(Pipeline) if f.name != "breaks")]
        for key in self.rows:
            if key not in known_rows:
                raise AxisError(f"[pipeline] has no {key!r}; it has {', '.join(known_rows)}")

    def __reduce__(self) -> tuple[Any, ...]:
        return ClosedLoop, tuple(getattr(self, f.name) for f in fields(self))  # nothing cached

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

    @classmethod
    def from_mjcf(
        cls,
        path: str | Path,
        joint: str,
        actuator: str | None = None,
        keyframe: str | None = None,
    ) -> ClosedLoop:
        """Read one joint of a MuJoCo model, with what the model says of it as starting values.

        A `<position>` actuator is its controller too; with a `<motor>` the controller is to be
        identified, or given with `replace`.

        Parameters
        ----------
        path : str or Path
        joint : str
            A slide or a hinge.
        actuator : str, optional
            Default: the only one that drives the joint.
        keyframe : str, optional
            Where the other joints are; default: the model's reference pose.

        Raises
        ------
        AxisError
            The model cannot be read, or lacks the joint, actuator or keyframe.
        MissingExtraError
            MuJoCo is not installed.
        """
        from ..simulators.mjcf import closed_loop

        return closed_loop(path, joint, actuator, keyframe)

    def to_toml(self) -> str:
        """Return the axis file of this loop, such as one whose controller was identified.

        Raises
        ------
        AxisError
            If the model has a term of your own, which a file cannot hold.

        Examples
        --------
        >>> import ivtools as iv
        >>> iv.axes.emps().to_toml().splitlines()[:2]
        ['[axis]', 'name = "EMPS"']
        """
        from .axis_file import write

        return write(self)

    # --- the model -----------------------------------------------------------------------------

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

    @property
    def columns(self) -> Mapping[str, str]:
        """Names of the columns of a record file, ours = theirs."""
        return self.log.columns

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints: the axis."""
        return (self.name,)

    def kind_of(self, joint: int) -> str:
        """Return whether a joint, counted from 0, is prismatic or revolute."""
        return self.joint

    def axis(self, joint: int, record: Record, theta: Theta | None = None) -> ClosedLoop:
        """Return the loop of a joint alone, as a robot's does: this one."""
        return self

    def possible(
        self, values: Mapping[str, float], record: Record, rows: Callable[[], Array]
    ) -> dict[str, float]:
        """Return the nearest values that can be simulated, as a robot's loop does: these."""
        return dict(values)

    def scaled(
        self, values: Mapping[str, float], measured: Mapping[str, float], record: Record
    ) -> ClosedLoop:
        """Return the loop that keeps its bandwidth with the inertia of other values.

        The controller's output is multiplied by the inertia over the one measured, and has no
        limit, so that the axis follows its reference with any parameters.
        """
        controller = self.controller.scaled(values["inertia"] / measured["inertia"])
        return replace(self, controller=replace(controller, limit=inf))

    # --- signals ------------------------------------------------------------------------------

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

    # --- the controller, from a record ----------------------------------------------------------

    def identify_controller(self, record: Record) -> tuple[ClosedLoop, ControllerFit]:
        """Fit the control law to a record.

        The command is regressed on reference, reference velocity and present and past positions,
        for every structure (cascade-pd, pd, p-velocity; velocity filters of 1 to 3 taps; delays of
        0 to 3 samples); samples at the limit are left out. The structure is the one with the
        least log residual power plus a price per setting: a setting more must remove a fifth of
        the residual, however long the record. Of more than 500,000 samples, those in which the
        axis moves most are used. Where the controller saw just what is logged, 5,000 of them are
        enough, and a linear law that has none of these structures is read as the matrices of a
        state-space controller.

        Returns
        -------
        loop : ClosedLoop
            This loop with that controller; its `notes` say how certain it is.
        report : ControllerFit
            Gains with standard errors, residual, and the structures tried.

        Raises
        ------
        RecordError
            If the record has no position reference, or too few samples below the limit.

        Examples
        --------
        >>> import ivtools as iv
        >>> loop, report = iv.axes.emps().identify_controller(iv.datasets.twin())
        >>> loop.controller.kind, round(report.estimates["kp"], 1)
        ('cascade-pd', 160.2)
        """
        from .identification import identify

        report = identify(self, record)
        return replace(self, controller=report.controller, notes=(*self.notes, report.note)), report

    def known(self, record: Record) -> ClosedLoop:
        """Return this loop, or, if its controller is to be identified, the loop fitted to a record.

        The fit is made once per loop and record.
        """
        if self.controller.kind != "identify":
            return self
        found = _IDENTIFIED.setdefault(record, {})
        key = (self.gain, self.controller.limit)
        if key not in found:
            found[key] = self.identify_controller(record)[1]
        fit = found[key]
        return replace(self, controller=fit.controller, notes=(*self.notes, fit.note))

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
        place: ArrayLike | None = None,
        link: ArrayLike | None = None,
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
        place : array_like, (n_samples,), optional
            Where forces and errors of the encoder that depend on the position are taken from, m or
            rad; default: the simulated position. A velocity loop holds no position, and would lose
            the phase of what repeats over it: there, give the measured one.
        link : array_like, (n_samples, 2), optional
            Of a robot's joint: the known load without what the link's inertia has beyond its mean,
            N or N m, and that inertia, kg or kg m2, which turns with the pose; it accelerates as
            the second mass does, or the only one. Default: the record's load, and none.
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

        if record.breaks:
            noises = {"position_noise": position_noise, "force_noise": force_noise, "place": place}
            noises |= {"link": link}
            options = {"substeps": substeps, "quantum": quantum, "ramp": ramp, "stiction": stiction}
            return over_stretches(self, record, theta, noises, initial=initial, **options)
        return simulate(
            self.known(record),
            record,
            self.values(theta),
            initial=initial,
            substeps=substeps,
            position_noise=position_noise,
            force_noise=force_noise,
            place=place,
            link=link,
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
        linear: bool = False,
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
        linear : bool
            Inertia and viscous friction alone, from q_ref to q with dq_ref at 0, off stiction and
            limit: a `control.StateSpace` for ``bode_plot`` and ``step_response``.

        Returns
        -------
        control.InterconnectedSystem
            Inputs q_ref, dq_ref, added, and feed if the controller has feed-forwards or further
            measured columns, whose sum in command units it is; outputs q, dq, nu, tau.
        """
        from .system import linearised, system

        make = linearised if linear else system
        return make(self, self.values(theta), dt, substeps or self.substeps)

    def __repr__(self) -> str:
        terms = ", ".join(term.name for term in self.terms)
        return f"ClosedLoop {self.name!r}: {self.joint}, {self.controller.kind}, {terms}"

    def _repr_html_(self) -> str:
        from html import escape

        return f"<p>{escape(repr(self))}</p><pre>{escape(self.to_toml())}</pre>"

    def natural_frequency_hz(self, dt: float, inertia: float | None = None) -> float:
        """Return the bandwidth of the rigid loop without dry friction, Hz.

        It is the gain crossover, between the natural frequency of the loop's highest mode and its
        -3 dB bandwidth; see `ivtools.loop.bandwidth`.

        Parameters
        ----------
        dt : float
            Sampling step, s.
        inertia : float, optional
            In kg or kg m2; default: the starting value.
        """
        from .bandwidth import bandwidth_hz

        inertia = self.values()["inertia"] if inertia is None else inertia
        viscous = self.start.get("viscous", self.start.get("viscous_pos", 0.0))
        return bandwidth_hz(self, inertia, viscous, dt)

    def pipeline(self, record: Record, rule: Rule | None = None, **settings: Any) -> Pipeline:
        """Return the pipeline that this loop's bandwidth and the record ask for.

        The bandwidth is taken to one significant digit, as the EMPS report does, then its rules
        apply: cut-off at 5 times, decimation to 2 times that frequency.

        Parameters
        ----------
        record : Record
        rule : {"record", "report"}, optional
            "report" is that and no more. "record" also trims both ends, puts the force at the time
            of the position, and masks what moves too slowly to have a direction: less than 0.5 %
            of the highest speed, or than 3 standard deviations of the velocity's noise, and half a
            period of the cut-off on either side; a model with an effect that shows there
            (Stribeck's) keeps every row. Default: that of the axis file, else "record".
        **settings
            Any parameter of `Pipeline`, used instead of the rule's and the axis file's. One of
            `min_speed` and `guard` switches the rule of both off.

        Raises
        ------
        AxisError
            If the loop has no bandwidth, or the rule is unknown.

        Examples
        --------
        >>> import ivtools as iv
        >>> iv.axes.emps().pipeline(iv.datasets.twin()).cutoff_hz
        100.0
        """
        from .default_pipeline import default_pipeline

        given = {**self.rows, **settings}
        asked = given.pop("rule", "record")
        return default_pipeline(self, record, rule or asked, **given)


_IDENTIFIED: WeakKeyDictionary[Record, dict[tuple[float, float], ControllerFit]] = (
    WeakKeyDictionary()
)
