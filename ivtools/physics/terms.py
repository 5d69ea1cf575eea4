"""Terms: one physical effect, stated once.

A *law* is an ordinary function ``law(q, dq, ddq, sign, tau, t, *parameters)`` that returns the
force opposing the motion. It is written with NumPy functions only, so the same source serves
three masters: arrays give the columns of the observation matrix, scalars compiled by Numba give
the force inside the simulated loop, and a reader gets the equation. ``sign`` is the direction of
motion, an argument of its own because at standstill the velocity does not know it.

Effects that are not a force (a delay, a second mass, an encoder error) have no law; the loop's
kernel knows them by name and calls the function that stands beside their term.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from math import inf
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import AxisError

Law = Callable[..., "NDArray[np.float64]"]
Weight = Callable[["NDArray[np.float64]", "NDArray[np.float64]"], "NDArray[np.float64]"]
Search = Literal["scan", "valleys", "lines", "either", "elsewhere"]

_SYMBOLS = {
    "prismatic": {"F": "N", "L": "m", "M": "kg"},
    "revolute": {"F": "N m", "L": "rad", "M": "kg m2"},
}


#: Parameters of a line over position that have its phase: what they are in one record says nothing
#: of another.
PHASES = ("cosine", "sine")


@dataclass(frozen=True)
class Parameter:
    """A parameter of a term.

    Parameters
    ----------
    name : str
        Name within the term.
    unit : str
        Unit, with ``{F}`` for the joint's force unit, ``{L}`` for its length, ``{M}`` for inertia.
    lower, upper : float
        Physical bounds, in SI.
    neutral : float
        The value that makes the effect vanish, or the usual value of a shape parameter.
    scale : str
        What the parameter is measured in when a search needs a starting value: ``"force"``,
        ``"peak"`` (the largest force), ``"per force"``, ``"speed"``, ``"stroke"``, ``"time"`` (the
        record's length), ``"step"`` (the sampling step), ``"command"``, ``"stiffness"`` (friction
        over a small part of the stroke), ``"damping"`` (over the highest speed) or ``"one"``.
    scan : tuple of float
        Starting values for a search, in multiples of `scale`; empty where the force is linear in
        the parameter, which needs none.
    nuisance : bool
        Whether a record says next to nothing about it: it stays where a search began.
    wide : tuple of float
        The same where a large gap is left that those do not explain; empty if they are all.
    least, most : float
        Smallest and largest value, in multiples of `scale`, at which the effect still is what its
        name says.
    turn : bool
        Whether it may be one turn of a revolute joint, whatever `most` is of a stroke.
    rigid : float
        Oscillations in a sample from which more is as good as rigid where a load is known: of a
        frequency; what is stiffer is not told from it, and costs many steps.
    """

    name: str
    unit: str
    lower: float = -inf
    upper: float = inf
    neutral: float = 0.0
    scale: str = "force"
    scan: tuple[float, ...] = ()
    wide: tuple[float, ...] = ()
    nuisance: bool = False
    least: float = -inf
    most: float = inf
    turn: bool = False
    rigid: float = inf

    @property
    def linear(self) -> bool:
        """Whether the force is linear in this parameter."""
        return not self.scan

    def unit_for(self, joint: str) -> str:
        """Return the unit on a ``"prismatic"`` or ``"revolute"`` joint."""
        return self.unit.format(**_SYMBOLS[joint])


@dataclass(frozen=True)
class Term:
    """A physical effect: its parameters, its force law and where it comes from.

    Parameters
    ----------
    name : str
        Identifier, as on the command line and in axis files.
    block : str
        ``"mechanics"``, ``"drive"``, ``"sensor"``, ``"controller"`` or ``"outside"``.
    parameters : tuple of Parameter
    equation : str
        The force, or the changed block, as people write it.
    source : str
        Where the model comes from.
    law : callable, optional
        ``law(q, dq, ddq, sign, tau, t, *parameters)``: the force opposing the motion, N or N m.
        None for an effect that is not a force.
    base : bool
        Whether the term belongs to the rigid model, whose parameters carry no prefix.
    substeps : int
        Integration steps per sample that the effect needs.
    search : str
        How a diagnosis looks for it: ``"scan"`` tries the starting values of its parameters;
        ``"valleys"`` searches the box they span, for the error has many minima (that of a force law
        in the inverse model, which knows the motion however far the loop strays); ``"lines"`` takes
        its period, the only parameter with starting values, from the spectrum over position, and
        its phase, which its `PHASES` have, is a matter of each record; ``"either"`` takes one
        parameter at a time, for they do the same; ``"elsewhere"`` decides at the controller or in
        time, not by simulation.
    everywhere : bool
        Whether any axis shows a little of it, as around reversals: it must be a good part of the
        gap to be named.
    sensed : bool
        Whether it is what a further sensor in the control law, on a second body, measures.
    net : bool
        Whether its law takes, for `tau`, what all other laws leave of the drive force.
    slot : str
        The place in the loop that it takes, if only one effect can have it.
    joint : str
        The only kind of joint that a diagnosis tries it on, ``"revolute"``; empty is any.
    weight : callable, optional
        Of an effect that is periodic over position: ``weight(dq, tau)``, what a wave over position
        is multiplied by to act as this effect does, up to a factor; None is 1.
    as_force : callable, optional
        Of an effect without a law: ``as_force(q, dt, inertia, *shape)``, the forces (N or N m) that
        change the command as it does to first order, one column per linear parameter.
    instead : callable, optional
        Of an effect that takes the place of dry friction: ``instead(coulomb, inertia)``, parameters
        with which it is all of it, (n, n_parameters); the first of them is its force.
    """

    name: str
    block: str
    parameters: tuple[Parameter, ...]
    equation: str
    source: str
    law: Law | None = field(default=None, compare=False)
    base: bool = False
    substeps: int = 1
    search: Search = "scan"
    everywhere: bool = False
    sensed: bool = False
    net: bool = False
    slot: str = ""
    joint: str = ""
    weight: Weight | None = field(default=None, compare=False)
    as_force: Law | None = field(default=None, compare=False)
    instead: Law | None = field(default=None, compare=False)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle a term of ours as its name, and one of the user's with its functions' code."""
        import cloudpickle

        from . import TERMS

        if TERMS.get(self.name) is self:
            return _ours, (self.name,)
        return _unpacked, (cloudpickle.dumps([getattr(self, f.name) for f in fields(self)]),)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Full names of the parameters, unique across terms."""
        prefix = "" if self.base else f"{self.name}."
        return tuple(prefix + p.name for p in self.parameters)

    @cached_property
    def by_name(self) -> dict[str, Parameter]:
        """Each parameter by its full name."""
        return dict(zip(self.names, self.parameters, strict=True))

    @cached_property
    def linear(self) -> tuple[str, ...]:
        """Full names of the parameters that the force is linear in."""
        return tuple(n for n, p in self.by_name.items() if p.linear)

    @property
    def replaces(self) -> bool:
        """Whether it takes the place of something in the rigid loop rather than add a force."""
        return self.law is None or self.instead is not None

    @property
    def by_inverse(self) -> bool:
        """Whether its valley is searched in the inverse model: that of a force law."""
        return self.search == "valleys" and self.law is not None

    @property
    def gaps(self) -> tuple[str, ...]:
        """Parameters that are the width of a gap before a second mass."""
        pairs = self.by_name.items()
        return tuple(n for n, p in pairs if self.second_mass and p.scale == "stroke")

    @property
    def second_mass(self) -> bool:
        """Whether a second mass is behind the motor with it."""
        return self.slot == "second mass"

    @cached_property
    def phases(self) -> tuple[str, ...]:
        """Full names of what has the phase of a line over position; none if it is no line."""
        pairs = self.by_name.items()
        return tuple(n for n, p in pairs if self.search == "lines" and p.name in PHASES)

    @cached_property
    def period(self) -> str:
        """Name, within the term, of the period of a line over position; empty if it is no line."""
        return next((p.name for p in self.parameters if self.search == "lines" and p.scan), "")

    @cached_property
    def local(self) -> bool:
        """Whether what it does depends on where the axis is, or on the time.

        A record says nothing of such an effect where, or when, it has not been. A law is asked
        along a small motion, and the same elsewhere and later. A line over position is as large
        everywhere, and its phase is a matter of each record.
        """
        return self._along(q=0.1) or self.of_time

    @cached_property
    def of_time(self) -> bool:
        """Whether its law changes with the time."""
        return self._along(later=1.0)

    def _along(self, **other: float) -> bool:
        """Whether the law is another one along another motion; a line is as large everywhere."""
        if self.law is None or self.search == "lines":
            return False
        return self._changes(
            [float(np.clip(0.5, p.lower, p.upper)) for p in self.parameters], **other
        )

    @cached_property
    def of_speed(self) -> bool:
        """Whether it is a law of the speed alone, the same in both directions.

        Where what else it may have, as a drive that holds, is neutral.
        """
        if self.law is None or self.search == "lines":
            return False
        values = [0.5 if p.linear else p.neutral for p in self.parameters]
        others = ({"q": 0.1}, {"later": 1.0}, {"ddq": 1.0}, {"tau": 6.0})
        alone = not any(self._changes(values, **other) for other in others)
        dq = np.linspace(-2.0, 2.0, 50)
        force = self.force(0.0 * dq, dq, 0.0 * dq, values)
        return alone and bool(force.any()) and np.allclose(force, -force[::-1])

    @cached_property
    def of_place(self) -> bool:
        """Whether it is dry friction that depends on the position, and on nothing else."""
        if not self._along(q=0.1):
            return False
        values = [0.5 if p.linear else p.neutral for p in self.parameters]
        others = ({"later": 1.0}, {"ddq": 1.0}, {"tau": 6.0})
        q = np.linspace(-1.0, 1.0, 50)
        ahead, faster, back = (
            self.force(q, np.full(50, dq), 0.0 * q, values) for dq in (1.0, 2.0, -1.0)
        )
        alone = not any(self._changes(values, **other) for other in others)
        return alone and np.allclose(ahead, faster) and np.allclose(ahead, -back)

    @cached_property
    def dry(self) -> bool:
        """Whether its law depends on the direction of motion at standstill, as dry friction does.

        What takes the net force may do so by that.
        """
        if self.law is None:
            return False
        values = [float(np.clip(0.5, p.lower, p.upper)) for p in self.parameters]
        ahead, back = (self.law(0.1, 0.0, 0.0, s, 3.0, 0.5, *values) for s in (1.0, -1.0))
        return self.net or bool(ahead != back)

    def _changes(self, values: Iterable[float], later: float = 0.0, **more: float) -> bool:
        """Whether the force along a small motion is another one later, or with more of a signal."""
        t = np.linspace(0.0, 1.0, 50)
        signals = {
            "q": 0.3 * np.sin(7.0 * t),
            "dq": 2.1 * np.cos(7.0 * t),
            "ddq": -14.7 * np.sin(7.0 * t),
            "tau": 3.0 + np.sin(4.0 * t),
        }
        here = self.force(**signals, values=values, t=t)
        moved = {name: x + more.get(name, 0.0) for name, x in signals.items()}
        return not np.allclose(
            here, self.force(**moved, values=values, t=t + later), equal_nan=True
        )

    def force(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        values: Iterable[float],
        tau: ArrayLike = 0.0,
        t: ArrayLike = 0.0,
    ) -> NDArray[np.float64]:
        """Return the force opposing the motion along a trajectory, N or N m.

        Parameters
        ----------
        q, dq, ddq : array_like
            Position, velocity, acceleration, (n_samples,).
        values : iterable of float
            One value per parameter.
        tau, t : array_like, optional
            Drive force (N or N m) and time (s), for laws that depend on them.

        Raises
        ------
        AxisError
            If the effect is not a force.
        """
        if self.law is None:
            raise AxisError(
                f"{self.name} changes the {self.block}, it is not a force law; "
                "use it in a simulation with loop.with_effect"
            )
        x = [np.asarray(a, dtype=float) for a in (q, dq, ddq, np.sign(dq), tau, t)]
        return np.broadcast_to(self.law(*x, *values), x[0].shape)

    def columns(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        tau: ArrayLike = 0.0,
        t: ArrayLike = 0.0,
        shape: Mapping[str, float] | None = None,
    ) -> NDArray[np.float64]:
        """Return the observation matrix of the term, one column per linear parameter.

        The law is linear in those parameters, so a column is the law at a unit vector: the
        equation is written once and columns and force cannot disagree.

        Parameters
        ----------
        q, dq, ddq, tau, t : array_like
            As for `force`.
        shape : mapping, optional
            Values of the parameters that the law is not linear in, by full name; else their
            neutral values.

        Returns
        -------
        ndarray, (n_samples, number of linear parameters)
        """
        given = {n.partition(".")[2]: value for n, value in (shape or {}).items()}
        linear = [i for i, p in enumerate(self.parameters) if p.linear]
        out = np.empty((np.size(q), len(linear)))
        for column, i in enumerate(linear):
            out[:, column] = self.force(q, dq, ddq, self.unit(i, given), tau, t)
        return out

    def unit(self, index: int, shape: Mapping[str, float]) -> list[float]:
        """Return its parameters with a unit of one that its force is linear in.

        Parameters
        ----------
        index : int
            Of that parameter; all other such are zero.
        shape : mapping
            The parameters that the force is not linear in, by short name; the rest is neutral.
        """
        return [
            float(i == index) if p.linear else shape.get(p.name, p.neutral)
            for i, p in enumerate(self.parameters)
        ]


def _ours(name: str) -> Term:
    """Return a term by name: what knows it by identity still does after pickling."""
    from . import TERMS

    return TERMS[name]


def _unpacked(state: bytes) -> Term:
    """Return a pickled term of the user's."""
    import pickle

    return Term(*pickle.loads(state))
