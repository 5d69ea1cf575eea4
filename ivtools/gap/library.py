"""Library: the effects that may be missing, and where a search for each starts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from ..linalg import rms
from ..loop import ClosedLoop
from ..physics import EFFECTS, Term
from ..physics.sizes import sizes
from ..record import Record
from .rules import BEHIND, LINKED, NEARLY_ALL, TURN

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scales:
    """Natural sizes of an axis: what a search measures parameters in.

    Those of its reference, with the dry friction that the axis states.
    """

    record: Record
    loop: ClosedLoop

    @cached_property
    def trajectory(self) -> tuple[Array, ...]:
        """Reference position, velocity, acceleration, and measured force, (n_samples,) each."""
        assert self.record.q_ref is not None
        q, dt = self.record.q_ref[:, 0], self.record.dt
        dq = np.gradient(q, dt)
        return q, dq, np.gradient(dq, dt), self.loop.force(self.record)[:, 0]

    @cached_property
    def second_body(self) -> bool:
        """Whether the law sees a second body: a deflection, a strain, an encoder on the load.

        A column that goes with the command, as a measured current does, is of the drive.
        """
        command, seen = self.loop.command(self.record)[:, 0], self.loop.controller.feedback
        columns = [self.record.extra[name] for name in seen if name in self.record.extra]
        moving = [c for c in columns if np.ptp(c) > 0.0]
        return any(abs(np.corrcoef(c, command)[0, 1]) < NEARLY_ALL for c in moving)

    @cached_property
    def sizes(self) -> dict[str, float]:
        """Size of each kind of scale, SI."""
        q, dq, _, tau = self.trajectory
        command = self.loop.command(self.record)
        return sizes(self.record, q, dq, tau, command, self.loop.start.get("coulomb", 0.0))

    @property
    def turns(self) -> tuple[float, ...]:
        """One turn of a revolute joint, rad, if the stroke holds it."""
        whole = 2.0 * np.pi
        holds = self.loop.joint == "revolute" and self.sizes["stroke"] >= whole
        return (whole,) if holds else ()

    def a_turn(self, period: float) -> bool:
        """Whether a period, m or rad, is one turn of an encoder, or as near as nobody can tell."""
        return any(abs(period - turn) < TURN * turn for turn in self.turns)

    def column(self, term: Term, index: int, shape: dict[str, float]) -> Array:
        """Return the force per unit of one linear parameter along the reference, (n_samples,)."""
        q, dq, ddq, tau = self.trajectory
        unit = term.unit(index, shape)
        return term.force(q, dq, ddq, unit, tau, self.record.t - self.record.t[0])

    def natural(self, term: Term, index: int, shape: dict[str, float]) -> float:
        """Return the value of a parameter whose effect is of the size of the force."""
        parameter = term.parameters[index]
        if not parameter.linear or term.law is None:
            return self.sizes[parameter.scale]
        size = rms(self.column(term, index, shape))
        return self.sizes["force"] / size if size > 0.0 else self.sizes["force"]


@dataclass(frozen=True, eq=False)
class Box:
    """What the starting values of an effect span: the unit cube, stretched.

    A side goes from the least to the largest of them, in logarithms unless it begins at zero; of a
    nuisance the values themselves are the choice.

    Parameters
    ----------
    term : Term
    grids : mapping
        Starting values of each parameter the force is not linear in, by short name.
    """

    term: Term
    grids: Mapping[str, list[float]]

    @classmethod
    def of(cls, term: Term, scales: Scales) -> list[Box]:
        """Return the boxes of an effect: where zero is one of several values, one for it alone.

        A load without friction moves otherwise than one with very little, and a search that has to
        hit it by chance ends in the valleys of the others.
        """
        return cls._of(term, _grids(term, scales))

    @classmethod
    def wider(cls, term: Term, scales: Scales) -> list[Box]:
        """Return the boxes that reach further, for a gap that is left; none if none does."""
        usual, wide = _grids(term, scales), _grids(term, scales, wide=True)
        return [] if wide == usual else cls._of(term, wide)

    @classmethod
    def _of(cls, term: Term, grids: dict[str, list[float]]) -> list[Box]:
        absent = {n: [0.0] for n, g in grids.items() if len(g) > 2 and min(g) == 0.0}
        present = {n: [x for x in grids[n] if x > 0.0] for n in absent}
        return [cls(term, {**grids, **part}) for part in ([absent, present] if absent else [{}])]

    @cached_property
    def _sides(self) -> dict[str, Callable[[float], float]]:
        """What makes a value of a number between 0 and 1, by short name."""
        nuisances = {p.name for p in self.term.parameters if p.nuisance}
        grids = self.grids.items()
        return {n: _choice(g) if n in nuisances else _span(g) for n, g in grids if len(g) > 1}

    @property
    def dimensions(self) -> int:
        """Number of sides."""
        return len(self._sides)

    def point(self, x: Array) -> dict[str, float]:
        """Return the parameters at a point of the unit cube, (dimensions,)."""
        moved = {n: side(u) for (n, side), u in zip(self._sides.items(), x.tolist(), strict=True)}
        return {n: moved.get(n, g[0]) for n, g in self.grids.items()}

    def points(self, power: int) -> list[dict[str, float]]:
        """Return 2^power points that fill the box evenly."""
        return [self.point(x) for x in qmc.Sobol(self.dimensions, rng=1).random_base2(power)]


def _choice(grid: list[float]) -> Callable[[float], float]:
    return lambda u: grid[min(int(u * len(grid)), len(grid) - 1)]


def _span(grid: list[float]) -> Callable[[float], float]:
    low, high = min(grid), max(grid)
    if low > 0.0:
        return lambda u: low * (high / low) ** u
    return lambda u: low + u * (high - low)


def library(
    loop: ClosedLoop, extra: tuple[Term, ...] = (), without: tuple[str, ...] = ()
) -> list[Term]:
    """Return the effects that a diagnosis tries on a loop."""
    present = {term.name for term in loop.terms}
    taken = {term.slot for term in loop.terms if term.slot}
    return [
        t
        for t in (*EFFECTS.values(), *extra)
        if t.name not in present
        and t.name not in without
        and t.slot not in taken
        and t.joint in ("", loop.joint)
        and t.search != "elsewhere"
    ]


def scans(term: Term, scales: Scales) -> list[dict[str, float]]:
    """Return starting values of the parameters the force is not linear in, by short name.

    Of one effect that may be missing; `estimators.sensitivities.scans` has those of a whole loop.
    """
    grids = _grids(term, scales)
    return [dict(zip(grids, point, strict=True)) for point in product(*grids.values())]


def alternatives(term: Term, scales: Scales) -> list[dict[str, float]]:
    """Return starting values at which one parameter acts and the others do not."""
    grids = _grids(term, scales)
    neutral = {p.name: p.neutral for p in term.parameters}
    return [{**neutral, name: grid[0]} for name, grid in grids.items()]


def _grids(term: Term, scales: Scales, wide: bool = False) -> dict[str, list[float]]:
    known = LINKED if scales.record.load is not None else BEHIND if scales.second_body else {}
    own = known.get(term.name, {})
    return {
        p.name: [x * scales.sizes[p.scale] for x in own.get(p.name, (wide and p.wide) or p.scan)]
        for p in term.parameters
        if not p.linear
    }
