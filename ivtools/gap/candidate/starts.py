"""Starts: from which values an effect is fitted, and how its valleys are found."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, OptimizeResult, differential_evolution, minimize
from scipy.stats import qmc

from ...linalg import orthonormal
from ...physics import Term
from ...workers import threaded
from ..fit import Fit, gauss_newton, heavy_enough
from ..fold import Fold, settling
from ..library import Box, alternatives
from ..rules import (
    ADEQUATE,
    AGAIN,
    CROWD,
    DELIVERED_POINTS,
    FIRST_CROWD,
    GENERATIONS,
    GOOD_PART,
    LARGE,
    LEAST_CROWD,
    LITTLE,
    MOST,
    MUTATION,
    NEARLY_ALL,
    RECOMBINATION,
    SECOND_CROWD,
    VALLEY_SAMPLES,
    VALLEY_TIME,
)
from ..screen import Score

Array = NDArray[np.float64]

#: Values of an effect's parameters, by short name.
Point = dict[str, float]

#: Effects of which no valley was found beside a model, by its fit where both folds have been, and
#: the whitened energy that everything else left: where it is large, points were denser.
_NOTHING: WeakKeyDictionary[Fit, dict[str, float]] = WeakKeyDictionary()


def starts(
    fits: tuple[Fit, ...], scores: list[Score], left: float, place: Mapping[str, float] | None
) -> tuple[list[Point], ...]:
    """Return, per fold, the values from which an effect is fitted, by short name; or none.

    Parameters
    ----------
    fits : tuple of Fit
        The model without the effect, on each fold.
    scores : list of Score
        Its screening on each.
    left : float
        Whitened energy that everything else leaves.
    place : mapping, optional
        Where its valley is known to be.
    """
    term = scores[0].term
    if term.by_inverse:
        return (_delivered(fits, term),) * len(fits)
    if term.search == "valleys":
        return (_deepest(fits, term, left, place),) * len(fits)
    if term.search == "either":
        return tuple(alternatives(term, f.fold.scales) for f in fits)
    return tuple([*s.starts, *instead(f, term)] for s, f in zip(scores, fits, strict=True))


def beginning(fit: Fit, term: Term, values: Point | None = None) -> dict[str, float]:
    """Return the parameters of a model beside which the search for one more effect begins.

    Beside a drive that does not deliver what is asked of it, those that the inverse model shows of
    the force which it delivers: fitted without the effect they are biased.

    A rigid joint that rattles is as heavy as it takes to be jerked; the robot, identified in the
    band of its motion, knows better what it weighs.
    """
    if term.by_inverse:
        shown = fit.inverse.values(term, values)
        return {**fit.values, **shown} if shown.get("inertia", 1.0) > 0.0 else fit.values
    if term.search == "valleys" and fit.fold.link is not None:
        return {**fit.values, **{n: v for n, v in fit.loop.start.items() if "." not in n}}
    if term.instead is not None and values and "coulomb" in fit.values:
        dry = fit.values["coulomb"] - values[term.parameters[0].name]
        return {**fit.values, "coulomb": max(dry, 0.0)}
    return fit.values


def instead(fit: Fit, term: Term) -> list[Point]:
    """Return the point at which an effect is best in the place of all dry friction, if any is.

    To first order, which the screening is of, it is only a part of it.
    """
    coulomb, inertia = (fit.values.get(name, 0.0) for name in ("coulomb", "inertia"))
    if term.instead is None or min(coulomb, inertia) <= 0.0:
        return []
    names = [p.name for p in term.parameters]
    points = [dict(zip(names, row.tolist(), strict=True)) for row in term.instead(coulomb, inertia)]

    def cost(point: Point) -> float:
        """Return the energy of the whitened error."""
        loop = fit.loop.with_effect(term, **point)
        e = fit.fold.error(loop, loop.values(beginning(fit, term, point)))
        return float(e @ e)

    return [min(points, key=cost)]


def _deepest(
    fits: tuple[Fit, ...], term: Term, left: float, place: Mapping[str, float] | None
) -> list[Point]:
    """Return the point with the least error on both folds together, by differential evolution.

    None where each is worse than no effect at all; that which is known where it is not. Where there
    is nothing beside a model, there is nothing beside it where both folds have been.

    A valley that is too narrow for gradients is at the same place in both folds, and the false
    ones are not; it is as narrow in a part of the record as in all of it, and wider the shorter
    the part is. Only the place is shared: the fits that start there see one fold each.

    R. Storn, K. Price, "Differential evolution", J. Global Optimization 11, 1997.
    """
    before = _NOTHING.get(fits[0], {}).get(term.name)
    if before is not None and (left <= LARGE or before > LARGE):
        return []
    costs = [_cost(f, term) for f in fits]
    rigid = [c(None) for c in costs]
    order = np.argsort(rigid)[::-1]  # the one that shows more first
    costs = [costs[k] for k in order]
    plain, known = sum(rigid), dict(place or {})
    if known and sum(c(known) for c in costs) < (1.0 - LITTLE) * plain:
        return [known]
    more, less = (fits[k].fold.scales for k in (order[0], order[-1]))
    found = [_evolved(costs, plain, b, FIRST_CROWD) for b in Box.of(term, less)]
    least = min(found, key=_cheapest)[0]
    if left > LARGE and least > GOOD_PART * plain:
        # a valley may lie between few points, and they in a shallow one
        denser = [b for b in Box.of(term, more) if _power(b, SECOND_CROWD) > LEAST_CROWD]
        found += [_evolved(costs, plain, b, SECOND_CROWD) for b in denser]
    if left > ADEQUATE and least > MOST * plain:
        found += [_evolved(costs, plain, b, SECOND_CROWD) for b in Box.wider(term, more)]
    least, best = min(found, key=_cheapest)
    if least > (1.0 - LITTLE) * plain:
        _NOTHING.setdefault(fits[0].common, {})[term.name] = left
    return [best] if least <= plain else []


def beside(fits: Sequence[Fit], term: Term, first: Point) -> tuple[list[Point], ...]:
    """Return, per fold, the point with the least error if the base is as it is beside a first one.

    Fitted without the effect it is so far off that the true point may leave more than others. None
    where the first one is no valley.

    Parameters
    ----------
    fits : sequence of Fit
        The model without the effect, on each fold.
    term : Term
    first : dict
        The point with the least error beside the base that was fitted without it.
    """
    if term.search != "valleys" or term.by_inverse:
        return ([],) * len(fits)
    rigid = [_cost(f, term) for f in fits]
    if sum(c(first) for c in rigid) > NEARLY_ALL * sum(c(None) for c in rigid):
        return ([],) * len(fits)

    def tuned(fit: Fit) -> Fit:
        """Return the base as it is beside the first one."""
        loop = fit.loop.with_effect(term, **first)
        return gauss_newton(fit.fold, loop, loop.values(beginning(fit, term)), fit.free, AGAIN)

    costs = [_cost(f, term, one) for f, one in zip(fits, threaded(tuned, fits), strict=True)]
    shown = [c(None) for c in costs]
    plain, boxes = sum(shown), Box.of(term, fits[int(np.argmax(shown))].fold.scales)
    each = [_evolved(costs, plain, b, FIRST_CROWD) for b in boxes]
    return ([min(each, key=_cheapest)[1]],) * len(fits)


def _cheapest(found: tuple[float, Point]) -> float:
    return found[0]


def _power(box: Box, crowd: int) -> int:
    """Return the power of two of points that fill a box before a search in it."""
    return max(box.dimensions + crowd, LEAST_CROWD)


def _evolved(
    costs: Sequence[Callable[[Point | None], float]], plain: float, box: Box, crowd: int
) -> tuple[float, Point]:
    """Return the least cost in a box, of all folds together, and where it is.

    It begins with the best of a `crowd` of points that fill the box, and ends early where they are
    nothing better than no effect at all. A point that costs more on one fold than any that the
    search keeps is not tried on the other, which can only add to it.
    """
    most, known = [plain], dict[bytes, float]()

    def cost(x: Array) -> float:
        """Return the cost of a point of the unit cube, or a part of it that is too much."""
        if (seen := known.get(_key(x))) is not None:
            return seen
        point, total = box.point(x), 0.0
        for c in costs:
            total += c(point)
            if total > most[0]:
                break
        return total

    def ends(intermediate_result: OptimizeResult) -> None:
        """End a search that begins with nothing better than no effect at all."""
        if intermediate_result.fun > (1.0 - LITTLE) * plain:
            raise StopIteration
        most[0] = float(np.max(intermediate_result.population_energies))

    drawn = qmc.Sobol(box.dimensions, rng=1).random_base2(_power(box, crowd))
    found = threaded(cost, drawn)
    known |= {_key(x): c for x, c in zip(drawn, found, strict=True)}
    order = np.argsort(found, kind="stable")
    best = differential_evolution(
        cost,
        Bounds(np.zeros(box.dimensions), np.ones(box.dimensions)),
        init=drawn[order[: CROWD * box.dimensions]],
        maxiter=GENERATIONS,
        mutation=MUTATION,
        recombination=RECOMBINATION,
        polish=False,
        updating="deferred",
        workers=threaded,
        callback=ends,
        rng=1,
    )
    return float(best.fun), box.point(best.x)


def _key(x: Array) -> bytes:
    """Return what tells a point of the unit cube, which the search scales to and fro."""
    return x.round(9).tobytes()


def _delivered(fits: tuple[Fit, ...], term: Term) -> list[Point]:
    """Return the point with which the inverse model explains the motion of both folds best.

    What a drive delivers moves the axis as any force does, however far the loop has strayed from
    what it does without the effect; the error of its simulation, and the base parameters, say
    nothing there.
    """
    models = [f.inverse for f in fits]

    def best(box: Box) -> tuple[float, Point]:
        """Return the least cost in a box, and where it is."""

        def cost(x: Array) -> float:
            """Return the cost of a point of the unit cube."""
            return sum(m.left(term, box.point(x)) for m in models)

        begin = min(qmc.Sobol(box.dimensions, rng=1).random_base2(DELIVERED_POINTS), key=cost)
        found = minimize(cost, begin, method="Nelder-Mead", bounds=[(0.0, 1.0)] * box.dimensions)
        return float(found.fun), box.point(found.x)

    return [min(map(best, Box.of(term, fits[0].fold.scales)), key=_cheapest)[1]]


def _cost(fit: Fit, term: Term, tuned: Fit | None = None) -> Callable[[Point | None], float]:
    """Return the cost of a point on the worst stretch of a fold, the base tuned to first order.

    That of no point is what there is without the effect; a link that would have no inertia left in
    some pose costs infinitely much. The base is that of the fit, or as it was `tuned` beside the
    effect.
    """
    fold = fit.fold
    rows, settled = _worst(fold, fit.e)
    part = fold.stretch(rows.start, rows.stop)
    part = part.only(np.arange(rows.start, rows.stop) >= settled)
    J = (tuned or fit).J[np.sum(fold.keep[:settled]) :][: part.n_kept]
    left, loop = part.cost_beside(orthonormal(J)), fit.loop.with_effect(term)
    base = tuned.values if tuned is not None else loop.values(beginning(fit, term))

    def cost(point: Point | None) -> float:
        """Return the mean square of the whitened error."""
        if point is None:
            return left(fit.loop, fit.values)
        values = {**base, **{f"{term.name}.{k}": v for k, v in point.items()}}
        return left(loop, values) if heavy_enough(fold, loop, values) is values else float("inf")

    return cost


def _worst(fold: Fold, e: Array) -> tuple[slice, int]:
    """Return the stretch of the record with the largest energy of the error, and where it counts.

    Where it starts, the axis may be in the midst of a jerk, and the simulation knows its state by
    derivatives only: so its first samples are not judged, as those of a record are not.
    """
    count = fold.record.n_samples
    n = min(round(VALLEY_TIME / fold.record.dt), VALLEY_SAMPLES, count)
    lead = min(settling(fold.record), n // 2)
    energy = np.zeros(count + 1)
    energy[1:][fold.keep] = e**2
    energy = np.cumsum(energy)
    start = int(np.argmax(energy[n:] - energy[lead : lead + count - n + 1]))
    return slice(start, start + n), start + lead
