"""Starts: where the fit of an effect begins; the multimodal ones get a dense scan."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..physics import Term
from .candidates import DENSE, scans
from .fit import Fit
from .fold import Fold
from .screen import Score
from .side import Side

Array = NDArray[np.float64]

#: Nuisance parameters that stay at their usual value.
FIXED = (
    "backlash.load_offset",
    "backlash.damping",
    "presliding.damping",
)

_SCANNED = 8.0  # s of the record that a dense scan looks at
_POLISHED = 2  # of its best points
_WIDE, _ROUNDS = 1.25, 4  # of the search around them


def starts(side: Side, fit: Fit, score: Score) -> list[dict[str, float]]:
    """Return the values from which an effect is fitted, by short name.

    Parameters
    ----------
    side : Side
    fit : Fit
        The model without the effect.
    score : Score
        Its screening.
    """
    if score.term.name in DENSE:
        return [_densest(side, fit, score.term, list(scans(score.term, side.scales)))]
    if score.term.name == "drive-timing":
        dt = side.fold.record.dt
        return [{"delay": 0.5 * dt, "lag": 0.0}, {"delay": 0.0, "lag": 0.5 * dt}]
    return [score.start]


def _densest(side: Side, fit: Fit, term: Term, points: list[dict[str, float]]) -> dict[str, float]:
    """Return the point of a scan with the least error, polished by a search around it.

    The valley of a backlash is too narrow for gradients, and as narrow in a part of the record as
    in all of it: the stretch with the largest error is enough for the scan.
    """
    rows = _worst(side.fold, fit.e)
    part = side.fold.stretch(rows.start, rows.stop)
    J = fit.J[rows.start - np.sum(~side.fold.keep[: rows.start]) :][: part.n_kept]
    Q = np.linalg.qr(J / np.maximum(np.linalg.norm(J, axis=0), 1e-300))[0]
    loop = fit.loop.with_effect(term, **points[0])

    def cost(point: dict[str, float]) -> float:
        """Return the cost after a linear step of the base."""
        named = {f"{term.name}.{k}": v for k, v in point.items()}
        e = part.error(loop, {**loop.values(fit.values), **named})
        return float(e @ e - np.sum((Q.T @ e) ** 2))

    costs = np.array([cost(p) for p in points])
    ends = [_polished(term, points[i], costs[i], cost) for i in np.argsort(costs)[:_POLISHED]]
    return min(ends, key=cost)


def _worst(fold: Fold, e: Array) -> slice:
    """Return the stretch of the record with the largest energy of the error."""
    n = min(round(_SCANNED / fold.record.dt), fold.record.n_samples)
    energy = np.zeros(fold.record.n_samples + 1)
    energy[1:][fold.keep] = e**2
    energy = np.cumsum(energy)
    start = int(np.argmax(energy[n:] - energy[:-n]))
    return slice(start, start + n)


def _polished(
    term: Term, point: dict[str, float], least: float, cost: Callable[[dict[str, float]], float]
) -> dict[str, float]:
    """Return the point moved along one parameter at a time as long as the cost falls."""
    moving = [p for p in term.parameters if f"{term.name}.{p.name}" not in FIXED]
    size = 1.0
    for _ in range(_ROUNDS):
        before = least
        for p, factor in ((p, f) for p in moving for f in (_WIDE**size, _WIDE**-size)):
            near = {**point, p.name: float(np.clip(point[p.name] * factor, p.lower, p.upper))}
            new = cost(near)
            if new < least:
                point, least = near, new
        size *= 0.5 if least == before else 1.0
    return point
