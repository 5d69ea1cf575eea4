"""A controller: its kind, its settings, and what surrounds the law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from ...errors import AxisError
from ...record import Record
from ...units import plural
from .filters import LoopFilter
from .kinds import KINDS, UNKNOWN, Kind
from .law import LinearLaw
from .seen import DERIVATIVES, FEEDFORWARDS
from .velocity import AT_THE_SAMPLE, WAYS, backward_difference, shown

_SHOWN: WeakKeyDictionary[Record, tuple[float, ...] | None] = WeakKeyDictionary()
ANTI_WINDUP = ("clamp", "back-calculation", "none")
COMMON = (
    "kind",
    "velocity_filter",
    "velocity",
    "delay",
    "limit",
    "anti_windup",
    "filter",
    "feedforward",
    "feedback",
    "reference_derivative",
)


@dataclass(frozen=True)
class Controller:
    """A digital position or velocity controller.

    Parameters
    ----------
    kind : str
        One of `KINDS`, whose equations docs/axis-file.md has; ``"none"``: no controller, the
        recorded command is the input; ``"identify"``: whatever the record shows, found by
        `ClosedLoop.identify_controller`.
    settings : mapping
        The gains of that kind.
    velocity_filter : tuple of float
        FIR filter that the position passes before the backward difference.
    delay : int
        Whole samples from the measured position to the recorded command.
    limit : float
        The command is clipped to +- limit.
    velocity : {"differences", "logged"}
        Where the law has its velocity from: differences of the position, or the record's dq. A
        simulation, which has no log, differentiates as the record shows that the drive did.
    filter : LoopFilter or mapping, optional
        Between the law and its limit: ``{"kind": "lowpass", "hz": 300.0}``.
    feedforward : mapping
        Gains, in command units, on ``velocity``, ``acceleration``, ``coulomb`` (the sign of the
        velocity), ``gravity`` and ``gravity_cos`` (sine and cosine of a revolute joint) of the
        reference, and on further columns of the record.
    feedback : mapping
        Gains on further measured columns. In a simulation they are known inputs, as recorded.
    anti_windup : {"clamp", "back-calculation", "none"}
        Whether an integrator stays while the command is clipped and it would drive it further;
        takes back what is beyond the limit, within its own integral time; or goes on.
    reference_derivative : {"central", "backward"}
        The differences by which derivatives of the reference are made that are not logged.

    Raises
    ------
    AxisError
        If a setting is missing, unknown or not a finite number.

    Examples
    --------
    >>> Controller("pd", {"kp": 2.0, "kd": 0.1}).law(dt=0.001).D
    array([ 2. ,  0.1,  1. , -2. , -0.1])
    """

    kind: str
    settings: Mapping[str, Any]
    velocity_filter: tuple[float, ...] = (1.0,)
    delay: int = 0
    limit: float = np.inf
    velocity: str = "differences"
    filter: LoopFilter | None = None
    feedforward: Mapping[str, float] = field(default_factory=dict)
    feedback: Mapping[str, float] = field(default_factory=dict)
    anti_windup: str = "clamp"
    reference_derivative: str = field(default="central", metadata={"later": True})

    def __post_init__(self) -> None:
        if self.kind not in (*KINDS, UNKNOWN):
            kinds = ", ".join([*KINDS, UNKNOWN])
            raise AxisError(f"controller kind {self.kind!r} is not known; known kinds: {kinds}")
        object.__setattr__(self, "filter", LoopFilter.of(self.filter))
        needs = self._of.needs if self._of else ()
        known = self._of.settings if self._of else ()
        for key in needs:
            if key not in self.settings:
                raise AxisError(
                    f"controller {self.kind} lacks {key!r}; it needs {', '.join(needs)}"
                )
        for key, value in self.settings.items():
            if key not in known:
                listed = ", ".join(sorted({*known, *COMMON}))
                raise AxisError(f"controller {self.kind} does not know {key!r}; it knows: {listed}")
            _finite(key, value, scalar=self.kind != "state-space")
        self._check_surroundings()
        if self.kind == "state-space":
            KINDS[self.kind].law(self.settings, 1.0, np.zeros(1))  # its matrices must fit

    def _check_surroundings(self) -> None:
        """Check what every kind has beside its settings."""
        if not self.velocity_filter:
            raise AxisError("velocity_filter is empty; [1.0] is the filter that changes nothing")
        for weight in self.velocity_filter:
            _finite("velocity_filter", weight, scalar=True)
        whole = isinstance(self.delay, int) and not isinstance(self.delay, bool)
        if not (whole and 0 <= self.delay <= 1000):
            raise AxisError(f"delay is {self.delay!r}; it counts whole samples, 0 to 1000")
        if self.kind == "none" and (self.delay or self.filter):
            raise AxisError(
                "controller none has neither delay nor filter: the command is what was recorded; "
                "[drive] delay says how late it acts"
            )
        if not self.limit > 0:
            raise AxisError(f"limit is {self.limit!r}; the command is clipped to +- limit > 0")
        for name, way, ways in (
            ("velocity", self.velocity, WAYS),
            ("anti_windup", self.anti_windup, ANTI_WINDUP),
            ("reference_derivative", self.reference_derivative, DERIVATIVES),
        ):
            if way not in ways:
                raise AxisError(f"{name} is {way!r}; it is {' or '.join(map(repr, ways))}")
        for name, gains in (("feedforward", self.feedforward), ("feedback", self.feedback)):
            if not isinstance(gains, Mapping):
                raise AxisError(f"{name} is {gains!r}; give gains by name, {{name = gain}}")
            for key, value in gains.items():
                _finite(f"{name}.{key}", value, scalar=True)

    @property
    def _of(self) -> Kind | None:
        return KINDS.get(self.kind)

    @property
    def needs_position(self) -> bool:
        """Whether the law follows a position reference."""
        return self._of.position if self._of else True

    @property
    def columns(self) -> tuple[str, ...]:
        """Further columns of a record that the law needs."""
        forward = [name for name in self.feedforward if name not in FEEDFORWARDS]
        return tuple(dict.fromkeys([*forward, *self.feedback]))

    @property
    def mismatches(self) -> tuple[str, ...]:
        """What can be wrong with the settings, by name."""
        if self._of is None:
            return ()
        names = self._of.mismatch
        given = {k for k, v in self.full.items() if k not in self._of.optional or v != 0.0}
        keep = given | {"kp"} if self.kind == "state-space" else given
        own = tuple(n for n in names if n in keep)
        differs = "velocity_filter" in names and self.velocity == "differences"
        fed = tuple(f"{k}.{n}" for k in ("feedforward", "feedback") for n in getattr(self, k))
        return (*own, *(("velocity_filter",) if differs else ()), *fed)

    @property
    def words(self) -> list[str]:
        """The settings in words; of matrices how many states they have."""
        if "A" in self.settings:
            return [plural(len(self.settings["A"]), "state")]
        return [f"{name} {value:.4g}" for name, value in self.settings.items()]

    @cached_property
    def full(self) -> dict[str, Any]:
        """The settings, with the values of those that were not given."""
        return {**(self._of.optional if self._of else {}), **self.settings}

    def law(self, dt: float) -> LinearLaw:
        """Return the linear law at the sampling step dt (s).

        A velocity that is logged is, here, that of the motion; `known` takes what a record shows.

        Raises
        ------
        AxisError
            If the law is still to be identified from a record.
        """
        if self._of is None:
            raise AxisError(
                'controller kind "identify" has no law yet; fit it from a record with '
                "loop.identify_controller(record)"
            )
        weights = self.velocity_filter if self.velocity == "differences" else AT_THE_SAMPLE
        taps = backward_difference(weights, dt) if self._of.velocity else np.zeros(1)
        law = self._of.law(self.full, dt, taps)
        law = replace(law, sensed=self._of.velocity and self.velocity == "logged")
        law = self.filter.behind(law, dt) if self.filter else law
        if self.anti_windup == "back-calculation" and self._of.tracking:
            back = np.where(law.hold, dt * self._of.tracking(self.full), 0.0)
            return replace(law, back=back, hold=np.zeros_like(law.hold))
        return law if self.anti_windup == "clamp" else replace(law, hold=np.zeros_like(law.hold))

    def shown(self, dt: float) -> Controller:
        """Return what a log with this sampling step (s) can show of it: no filter beyond that."""
        return self if self.filter is None or self.filter.fits(dt) else replace(self, filter=None)

    def known(self, record: Record) -> Controller:
        """Return this controller as it can be simulated: with the velocity that a record shows."""
        if self.velocity == "differences" or not (self._of and self._of.velocity):
            return self
        if record.dq is None:
            return self
        if record not in _SHOWN:
            _SHOWN[record] = shown(record.q[:, 0], record.dq[:, 0], record.dt)
        taps = _SHOWN[record]
        return self if taps is None else replace(self, velocity="differences", velocity_filter=taps)

    def with_mismatch(self, **changes: float) -> Controller:
        """Return this controller with relative errors of its settings.

        Parameters
        ----------
        **changes : float
            By the names of `mismatches`; what the kind does not have is ignored. A relative change
            of a gain, of which ``kp`` scales the output of a `state-space` law; the weight of one
            more, older, tap of the velocity filter (``velocity_filter``), by which the others
            shrink so that the sum stays; ``feedforward.NAME`` and ``feedback.NAME``.
        """
        settings = self._of.changed(self.settings, changes) if self._of else self.settings
        share = changes.get("velocity_filter", 0.0)
        taps = np.array([*self.velocity_filter, 0.0] if share else self.velocity_filter)
        if share:
            total = taps.sum()
            taps = (1.0 - share) * taps
            taps[-1] += share * total

        def fed(name: str, gains: Mapping[str, float]) -> dict[str, float]:
            return {k: v * (1.0 + changes.get(f"{name}.{k}", 0.0)) for k, v in gains.items()}

        return replace(
            self,
            settings=settings,
            velocity_filter=tuple(taps.tolist()),
            feedforward=fed("feedforward", self.feedforward),
            feedback=fed("feedback", self.feedback),
        )

    def scaled(self, ratio: float) -> Controller:
        """Return this controller with its output multiplied by `ratio`.

        Multiplying the gain by M/M0 keeps the bandwidth of a loop whose inertia is thought to be
        M instead of M0 (Janot, Vandanjon, Gautier, IEEE Trans. Control Systems Technology 22(1),
        2014).
        """
        settings = self._of.scaled(self.settings, ratio) if self._of else self.settings
        return replace(
            self,
            settings=settings,
            feedforward={k: v * ratio for k, v in self.feedforward.items()},
            feedback={k: v * ratio for k, v in self.feedback.items()},
        )


def _finite(key: str, value: Any, scalar: bool = False) -> None:
    try:
        array = np.asarray(value)
        good = array.dtype.kind in "iuf" and bool(np.isfinite(array).all())
    except (TypeError, ValueError):
        good = False
    if not good:
        raise AxisError(f"controller setting {key} = {value!r} is not a finite number")
    if scalar and array.ndim:
        raise AxisError(f"controller setting {key} = {value!r} is a list; give one number")
