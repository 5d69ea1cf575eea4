"""Candidates: the effects that may be missing, and where a search for each starts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..loop import ClosedLoop
from ..physics import EFFECTS, Parameter, Term
from ..record import Record

Array = NDArray[np.float64]

#: Effects decided at the controller, or seen in time: not fitted by simulation.
ELSEWHERE = ("saturation", "controller-mismatch", "disturbance")
#: Effects with a second mass: many local minima, which take a dense scan; a loop has one of them.
DENSE = ("flexibility", "backlash")
#: Effects that nothing in this kind of record can separate share a name.
PERIODIC = ("cogging", "torque-ripple", "encoder-eccentricity")


@dataclass(frozen=True, eq=False)
class Scales:
    """Natural sizes of an axis, from its record: what a search measures parameters in."""

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
    def sizes(self) -> dict[str, float]:
        """Size of each kind of scale, SI."""
        q, dq, _, tau = self.trajectory
        force, stroke = float(np.sqrt(np.mean(tau**2))), float(np.ptp(q))
        friction = abs(self.loop.start.get("coulomb", 0.2 * force)) or 0.2 * force
        return {
            "force": force,
            "speed": float(np.max(np.abs(dq))),
            "stroke": stroke,
            "time": float(np.ptp(self.record.t)),
            "step": self.record.dt,
            "command": float(np.max(np.abs(self.loop.command(self.record)))),
            "stiffness": friction / (5e-4 * stroke),
            "one": 1.0,
        }

    def column(self, term: Term, index: int, shape: dict[str, float]) -> Array:
        """Return the force per unit of one linear parameter along the reference, (n_samples,)."""
        q, dq, ddq, tau = self.trajectory
        unit = [
            shape.get(p.name, p.neutral) if not p.linear else float(i == index)
            for i, p in enumerate(term.parameters)
        ]
        return term.force(q, dq, ddq, unit, tau, self.record.t - self.record.t[0])

    def natural(self, term: Term, index: int, shape: dict[str, float]) -> float:
        """Return the value of a parameter whose effect is of the size of the force."""
        parameter = term.parameters[index]
        if not parameter.linear:
            return self.sizes[parameter.scale]
        if term.law is None:
            return self.sizes[parameter.scale]
        rms = float(np.sqrt(np.mean(self.column(term, index, shape) ** 2)))
        return self.sizes["force"] / rms if rms > 0.0 else self.sizes["force"]


def library(
    loop: ClosedLoop, extra: tuple[Term, ...] = (), without: tuple[str, ...] = ()
) -> list[Term]:
    """Return the effects that a diagnosis tries on a loop."""
    present = {term.name for term in loop.terms}
    if "asymmetric-friction" in present:
        present.add("asymmetric-viscous")
    if present & {*DENSE}:
        present |= {*DENSE}
    terms = [*EFFECTS.values(), *extra]
    return [t for t in terms if t.name not in present and t.name not in (*ELSEWHERE, *without)]


def scans(term: Term, scales: Scales, limit: int = 400) -> Iterator[dict[str, float]]:
    """Yield starting values of the parameters the force is not linear in, by short name."""
    shapes = [p for p in term.parameters if not p.linear]
    grids = [[x * _unit(p, scales) for x in p.scan] for p in shapes]
    for number, point in enumerate(product(*grids)):
        if number >= limit:
            return
        yield {p.name: v for p, v in zip(shapes, point, strict=True)}


def _unit(parameter: Parameter, scales: Scales) -> float:
    return scales.sizes[parameter.scale]
