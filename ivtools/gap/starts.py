"""Starts: where the fit of an effect begins."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, differential_evolution

from ..physics import Term
from .candidates import Box, alternatives
from .fit import Fit
from .fold import Fold
from .screen import Score
from .side import Side

Array = NDArray[np.float64]
Point = dict[str, float]

_SEARCHED = 4.0  # s of each fold that a search for valleys looks at
_CROWD, _GENERATIONS = 6, 30  # points per dimension, and how often they move at most
_MUTATION, _RECOMBINATION = (0.4, 0.9), 0.9


def starts(
    sides: tuple[Side, ...], fits: tuple[Fit, ...], scores: list[Score]
) -> tuple[list[Point], ...]:
    """Return, per fold, the values from which an effect is fitted, by short name.

    Parameters
    ----------
    sides : tuple of Side
    fits : tuple of Fit
        The model without the effect, on each fold.
    scores : list of Score
        Its screening on each.
    """
    term = scores[0].term
    if term.search == "valleys":
        return ([_deepest(sides, fits, term)],) * len(sides)
    if term.search == "either":
        return tuple(alternatives(term, s.scales) for s in sides)
    return tuple(s.starts for s in scores)


def _deepest(sides: tuple[Side, ...], fits: tuple[Fit, ...], term: Term) -> Point:
    """Return the point with the least error on both folds together, by differential evolution.

    A valley that is too narrow for gradients is at the same place in both folds, and the false
    ones are not; it is as narrow in a part of the record as in all of it, and wider the shorter
    the part is. Only the place is shared: the fits that start there see one fold each.

    R. Storn, K. Price, "Differential evolution", J. Global Optimization 11, 1997.
    """
    box = Box(term, sides[0].scales)
    costs = [_cost(s.fold, f, term) for s, f in zip(sides, fits, strict=True)]

    def cost(x: Array) -> float:
        """Return the cost of a point of the unit cube."""
        return sum(c(box.point(x)) for c in costs)

    with ThreadPoolExecutor(2) as pool:
        found = differential_evolution(
            cost,
            Bounds(np.zeros(box.dimensions), np.ones(box.dimensions)),
            init="sobol",
            popsize=_CROWD,
            maxiter=_GENERATIONS,
            mutation=_MUTATION,
            recombination=_RECOMBINATION,
            polish=False,
            updating="deferred",
            workers=pool.map,
            rng=1,
        )
    return box.point(found.x)


def _cost(fold: Fold, fit: Fit, term: Term) -> Callable[[Point], float]:
    """Return the cost of a point on the worst stretch of a fold, the base tuned to first order."""
    rows = _worst(fold, fit.e)
    part = fold.stretch(rows.start, rows.stop)
    J = fit.J[np.sum(fold.keep[: rows.start]) :][: part.n_kept]
    Q = np.linalg.qr(J / np.maximum(np.linalg.norm(J, axis=0), 1e-300))[0]
    loop = fit.loop.with_effect(term)
    base = loop.values(fit.values)

    def cost(point: Point) -> float:
        """Return the mean square of the whitened error."""
        e = part.error(loop, {**base, **{f"{term.name}.{k}": v for k, v in point.items()}})
        return float(e @ e - np.sum((Q.T @ e) ** 2)) / len(e)

    return cost


def _worst(fold: Fold, e: Array) -> slice:
    """Return the stretch of the record with the largest energy of the error."""
    n = min(round(_SEARCHED / fold.record.dt), fold.record.n_samples)
    energy = np.zeros(fold.record.n_samples + 1)
    energy[1:][fold.keep] = e**2
    energy = np.cumsum(energy)
    start = int(np.argmax(energy[n:] - energy[:-n]))
    return slice(start, start + n)
