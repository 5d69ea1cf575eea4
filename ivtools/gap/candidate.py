"""Trial: one effect, fitted on each fold and judged on the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, OptimizeResult, differential_evolution, minimize
from scipy.stats import qmc

from ..loop import ClosedLoop
from ..physics import Term
from .discrepancy import a_line, other_waves, unlike_smooth
from .fit import Fit, common, gauss_newton, steps
from .fold import Fold, Side, block_t, settling, threaded
from .library import Box, Scales, alternatives
from .rules import (
    CROWD,
    DELIVERED_POINTS,
    FIRST_CROWD,
    GENERATIONS,
    HOPELESS,
    LARGE,
    MUTATION,
    NARROW,
    OTHER_WAVE_T,
    RECOMBINATION,
    RETUNED,
    SECOND_CROWD,
    UNLIKE_SMOOTH,
    VALLEY_DEPTH,
    VALLEY_SAMPLES,
    VALLEY_STEPS,
    VALLEY_TIME,
    Rules,
    Threshold,
)
from .screen import Score

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trial:
    """An effect, fitted on each fold and judged on the other.

    Parameters
    ----------
    term : Term
    fits : tuple of Fit
        On each fold.
    held : tuple of Fit
        On each fold, with the effects of the other one frozen.
    before : tuple of Fit
        Held fits of the model without the effect.
    """

    term: Term
    fits: tuple[Fit, ...]
    held: tuple[Fit, ...]
    before: tuple[Fit, ...]

    @property
    def name(self) -> str:
        """Identifier of the effect."""
        return self.term.name

    @property
    def gains(self) -> Array:
        """R2 gain: share of the energy removed on held-out data, per fold."""
        return np.array(
            [1.0 - h.cost / b.cost for h, b in zip(self.held, self.before, strict=True)]
        )

    @property
    def gain(self) -> float:
        """R2 gain on held-out data, mean of the folds."""
        return float(np.mean(self.gains))

    @property
    def removed(self) -> float:
        """Whitened energy removed on held-out data, mean of the folds; the floor is 1."""
        both = zip(self.before, self.held, strict=True)
        return float(np.mean([b.cost - h.cost for b, h in both]))

    @cached_property
    def amplitudes(self) -> Array:
        """Amplitude of the frozen effect on each held-out fold and its block t value, (2, 2)."""
        return np.array([_amplitude(b, h) for b, h in zip(self.before, self.held, strict=True)])

    @property
    def t(self) -> Array:
        """Block t value of the amplitude, per fold."""
        return self.amplitudes[:, 1]

    def evenness(self, last: Sequence[Fit]) -> float:
        """Return the standard error of the amplitude in noise alone over the block-robust one.

        1 where the blocks agree as well as noise lets them; an effect that only resembles what is
        there fits some blocks better than others (H. White, Econometrica 50(1), 1982: where both
        differ, the model is wrong).

        Parameters
        ----------
        last : sequence of Fit
            The model with all that is named, on each fold.
        """
        found = []
        for b, h, end in zip(self.before, self.held, last, strict=True):
            change = b.e - h.e
            spread = float(np.linalg.norm(h.fold.block_sums(change * end.e)))
            found.append(float(np.linalg.norm(change)) / max(spread, 1e-300))
        return min(found)

    @property
    def shares(self) -> Array:
        """Share of the reducible gap removed on held-out data, per fold; the floor is 1."""
        return self._removed_of([1.0 for _ in self.before])

    @property
    def closable(self) -> Array:
        """Share of the energy that smooth laws of the state could remove, per fold."""
        return self._removed_of([max(b.fold.smooth, 1.0) for b in self.before])

    def _removed_of(self, floors: Sequence[float]) -> Array:
        """Return the share removed of the energy above a floor, per fold."""
        folds = zip(self.held, self.before, floors, strict=True)
        return np.array([(b.cost - h.cost) / max(b.cost - f, 1e-9) for h, b, f in folds])

    @property
    def disagreement(self) -> float:
        """Factor by which the folds disagree in the amplitude; 1 is agreement."""
        return float(np.exp(np.max(np.abs(np.log(np.clip(self.amplitudes[:, 0], 1e-9, None))))))

    @property
    def inside(self) -> bool:
        """Whether no parameter is at a bound; 0 and 1 are the natural ends of a share.

        Bounds are where a model stops to mean what its name says: a second mass without inertia, or
        one that creeps instead of ringing, or a line that does not come twice, mimics something
        else.
        """
        if any(self._beyond(fit) for fit in self.fits):
            return False
        at_bound = (
            fit.values[name] == bound
            for fit in self.fits
            for name, p in zip(self.term.names, self.term.parameters, strict=True)
            for bound in (p.lower, p.upper)
            if bound not in (0.0, 1.0) and not p.nuisance
        )
        return not any(at_bound)

    def _beyond(self, fit: Fit) -> bool:
        """Whether a parameter is smaller or larger than the effect's name allows on this axis."""
        sizes = Scales(fit.fold.record, fit.loop).sizes
        pairs = zip(self.term.names, self.term.parameters, strict=True)
        values = ((fit.values[n] / sizes[p.scale], p) for n, p in pairs)
        return not all(p.least <= value <= p.most for value, p in values)

    @cached_property
    def lowers(self) -> bool:
        """Whether the plain force error on held-out data, of both folds, is smaller with it."""
        before, after = (sum(f.force_rms**2 for f in fits) for fits in (self.before, self.held))
        return after < before

    @cached_property
    def unlike(self) -> float:
        """Share of its gain that no smooth law of the state could have, 0 to 1."""
        if self.term.search == "lines":
            period = max(f.values[f"{self.name}.period"] for f in self.fits)
            return float(np.clip(a_line(self.before, self.held, period), 0.0, 1.0))
        return float(np.clip(unlike_smooth(self.before, self.held), 0.0, 1.0))

    @cached_property
    def distinct(self) -> bool:
        """Whether a line over position is no smooth law of the state, and no other wave."""
        if self.term.search != "lines":
            return True
        waves = other_waves(self.before, [f.values[f"{self.name}.period"] for f in self.held])
        better = all(block_t(self._over(w)) > OTHER_WAVE_T for w in waves)
        return better and self.unlike > UNLIKE_SMOOTH  # the latter costs more

    def _over(self, errors: Sequence[Array]) -> Array:
        """Return by how much it does better than what leaves these errors, by block."""
        both = zip(self.held, errors, strict=True)
        return np.concatenate([h.fold.block_sums(e**2 - h.e**2) for h, e in both])

    def passes(self, rules: Rules) -> bool:
        """Whether the effect replicates, and the force error is smaller for it."""
        least = rules.threshold(self.term)
        enough = bool(np.min(self.shares) >= least.share)
        thorough = bool(np.min(self.closable) >= rules.thorough.share)
        reached = any(self._reaches(x) for x in (least, rules.steady, rules.dominant))
        reached |= thorough and self._reaches(rules.thorough)
        dominates = bool(np.max(self.gains) >= rules.dominant.gain)
        reached |= dominates and self._reaches(rules.one_sided)
        return enough and reached and self.inside and self.lowers and self.distinct

    def _reaches(self, least: Threshold) -> bool:
        gain, t = np.min(self.gains), np.min(self.t)
        return bool(gain >= least.gain and t >= least.t and self.disagreement <= least.agreement)

    def correlation(self, other: Trial) -> float:
        """Return the correlation of what both change on held-out data; 1 for twins."""
        cosines = []
        for _, (b, h, plain, o) in self._both(other):
            x, y = b - h, plain - o
            cosines.append(float(x @ y) / max(float(np.linalg.norm(x) * np.linalg.norm(y)), 1e-300))
        return min(cosines)

    def advantage(self, other: Trial) -> float:
        """Return the block t value by which this effect does better on held-out data.

        Of both folds together: better on one and worse on the other is no difference.
        """
        both = self._both(other)
        return block_t(np.concatenate([f.block_sums(o**2 - h**2) for f, (_, h, _, o) in both]))

    def _both(self, other: Trial) -> Iterator[tuple[Fold, list[Array]]]:
        """Yield, per fold, the samples that count for both effects, and the errors there.

        Those without and with this one, and without and with the other.
        """
        for fits in zip(self.before, self.held, other.before, other.held, strict=True):
            keep = fits[0].fold.keep & fits[2].fold.keep
            fold = fits[0].fold.only(keep, fits[0].fold.label)
            yield fold, [f.e[keep[f.fold.keep]] for f in fits]


def attempt(
    sides: tuple[Side, ...], fits: tuple[Fit, ...], before: tuple[Fit, ...], scores: list[Score]
) -> Trial | None:
    """Fit an effect on each fold, and judge it on the other; None if there is nothing to fit.

    One that depends on the position is fitted and judged where both folds have been.
    """
    term = scores[0].term
    if term.local:
        sides = tuple(s.common for s in sides)
        fits, before = common(fits), common(before)
    begin = starts(sides, fits, scores)
    if not all(begin):
        return None
    new = tuple(threaded(lambda s, f, b: _extended(s, f, term, b), sides, fits, begin))
    deep = any(n.cost < VALLEY_DEPTH * f.cost for n, f in zip(new, fits, strict=True))
    if term.search == "valleys" and deep:  # either side may have come deeper
        new = tuple(threaded(lambda s, n, o: _deeper(s, term, n, o), sides, new, new[::-1]))
    held = frozen(sides, new)
    if any(
        h.cost < n.cost for n, h in zip(new, held, strict=True)
    ):  # stuck: the other knows better
        new = tuple(threaded(_onwards, sides, new, held))
        held = frozen(sides, new)
    return Trial(term, new, held, before)


def _onwards(side: Side, own: Fit, held: Fit) -> Fit:
    """Return a fit, or the one that goes on from the other fold's effect where that is better."""
    if own.cost <= held.cost:
        return own
    step = steps(side.fold, own.loop, side.scales)
    return gauss_newton(side.fold, own.loop, held.values, own.free, step)


def _deeper(side: Side, term: Term, own: Fit, other: Fit) -> Fit:
    """Return the better of a fit that goes on, and one that starts with the other fold's effect.

    A nuisance between its bounds, which the search chose of a few values, is fitted as well: what
    it should have been would be in all others. Contacts are rough: differences that are wide enough
    to look across what is rough lose sight of the bottom, so the last steps take narrow ones.
    """
    step = steps(side.fold, own.loop, side.scales)
    from_other = {**own.values, **{n: other.values[n] for n in term.names}}
    pairs = zip(term.names, term.parameters, strict=True)
    loose = (n for n, p in pairs if p.nuisance and p.lower < own.values[n] < p.upper)
    free = [*own.free, *loose]
    both = (
        gauss_newton(side.fold, own.loop, start, free, step, VALLEY_STEPS)
        for start in (own.values, from_other)
    )
    best = min(both, key=lambda f: f.cost)
    narrow = {n: step[n] * NARROW if n in term.names else step[n] for n in step}
    return gauss_newton(side.fold, own.loop, best.values, free, narrow, VALLEY_STEPS)


def frozen(sides: tuple[Side, ...], fits: tuple[Fit, ...]) -> tuple[Fit, ...]:
    """Tune the base parameters on each fold, with the effects that the other fold found."""
    return tuple(threaded(_retuned, sides, fits[::-1], fits))


def _retuned(side: Side, fit: Fit, own: Fit) -> Fit:
    turned = phases(fit.loop)
    base = side.scales.loop.parameters  # as declared, its own effects with it
    free = [n for n in fit.free if n in base or n in turned]
    start = {**fit.values, **{n: own.values[n] for n in turned}}
    step = steps(side.fold, fit.loop, side.scales)
    return gauss_newton(side.fold, fit.loop, start, free, step, RETUNED)


def phases(loop: ClosedLoop) -> set[str]:
    """Return the parameters that are a matter of each record: an encoder is homed anew."""
    lines = (t for t in loop.terms if t.search == "lines")
    return {f"{t.name}.{n}" for t in lines for n in ("cosine", "sine")}


def _extended(side: Side, fit: Fit, term: Term, begin: list[dict[str, float]]) -> Fit:
    """Fit the model with one more effect, from its best starting values."""
    found = []
    for values in begin:
        base = _beginning(fit, term, values)
        loop = fit.loop.with_effect(term, **values)
        step = steps(side.fold, loop, side.scales)
        free = [*fit.free, *_free(term, values)]
        new = gauss_newton(side.fold, loop, loop.values(base), free, step)
        if new.cost > fit.cost:  # the base parameters must give way first: begin without it
            plain = {**loop.values(fit.values), **_absent(term)}
            new = gauss_newton(side.fold, loop, plain, free, step)
        found.append(new)
    return min(found, key=lambda f: f.cost)


def _beginning(fit: Fit, term: Term, values: Point | None = None) -> dict[str, float]:
    """Return the parameters of a model beside which the search for one more effect begins.

    Beside a drive that does not deliver what is asked of it, those that the force which it delivers
    shows: without the effect they are bent as far as the loop strays.

    A rigid joint that rattles is as heavy as it takes to be jerked; the robot, identified in the
    band of its motion, knows better what it weighs.
    """
    if term.search == "valleys" and term.law is not None:
        return {**fit.values, **fit.inverse.values(term, values)}
    if term.search == "valleys" and fit.fold.link is not None:
        return {**fit.values, **{n: v for n, v in fit.loop.start.items() if "." not in n}}
    return fit.values


def _absent(term: Term) -> dict[str, float]:
    """Return what makes an effect vanish, its shape as it is."""
    pairs = zip(term.names, term.parameters, strict=True)
    return {name: p.neutral for name, p in pairs if p.linear}


def _free(term: Term, values: Mapping[str, float]) -> list[str]:
    own = [p for p in term.parameters if not p.nuisance]
    if term.search == "valleys":  # none of it is another motion than little: no way leads there
        own = [p for p in own if values[p.name] != 0.0]
    if term.search in ("either", "scan"):  # a shape that starts without effect stays there
        own = [p for p in own if p.linear or values[p.name] != p.neutral]
    return [f"{term.name}.{p.name}" for p in own]


def _amplitude(before: Fit, held: Fit) -> tuple[float, float]:
    """Return the best multiple of the frozen change, and its block-robust t value."""
    change = before.e - held.e
    energy = float(change @ change)
    if not energy > 0.0:
        return 0.0, 0.0
    amplitude = float(change @ before.e) / energy
    scores = held.fold.block_sums(change * (before.e - amplitude * change))
    return amplitude, amplitude * energy / max(float(np.sqrt(scores @ scores)), 1e-300)


Point = dict[str, float]


def starts(
    sides: tuple[Side, ...], fits: tuple[Fit, ...], scores: list[Score]
) -> tuple[list[Point], ...]:
    """Return, per fold, the values from which an effect is fitted, by short name; or none.

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
        search = _deepest if term.law is None else _delivered
        return (search(sides, fits, term),) * len(sides)
    if term.search == "either":
        return tuple(alternatives(term, s.scales) for s in sides)
    return tuple(s.starts for s in scores)


def _deepest(sides: tuple[Side, ...], fits: tuple[Fit, ...], term: Term) -> list[Point]:
    """Return the point with the least error on both folds together, by differential evolution.

    None where each is worse than no effect at all; that which is known where it is not.

    A valley that is too narrow for gradients is at the same place in both folds, and the false
    ones are not; it is as narrow in a part of the record as in all of it, and wider the shorter
    the part is. Only the place is shared: the fits that start there see one fold each.

    R. Storn, K. Price, "Differential evolution", J. Global Optimization 11, 1997.
    """
    costs = [_cost(s.fold, f, term) for s, f in zip(sides, fits, strict=True)]
    rigid = [c(None) for c in costs]
    costs = [costs[k] for k in np.argsort(rigid)[::-1]]  # the one that shows most first
    plain, known = sum(rigid), dict(sides[0].places.get(term.name, {}))
    if known and sum(c(known) for c in costs) < HOPELESS * plain:
        return [known]
    boxes, cost, best = Box.of(term, sides[0].scales), np.inf, Point()
    large = plain > LARGE * len(sides)
    for crowd in (FIRST_CROWD, SECOND_CROWD)[: 1 + large]:  # a valley may lie between few points
        if cost > HOPELESS * plain:
            found = (_evolved(costs, plain, box, crowd) for box in boxes)
            cost, best = min(found, key=lambda pair: pair[0])
    return [best] if cost <= plain else []


def _evolved(
    costs: Sequence[Callable[[Point | None], float]], plain: float, box: Box, crowd: int
) -> tuple[float, Point]:
    """Return the least cost in a box, of all folds together, and where it is.

    It begins with the best of the points that fill the box, two to the power of its dimensions and
    `crowd`, and ends early where that is nothing better than no effect at all. A point that costs
    more on one fold than any that the search keeps is not tried on the other, which can only add
    to it.
    """
    most = [plain]

    def cost(x: Array) -> float:
        """Return the cost of a point of the unit cube, or a part of it that is too much."""
        point, total = box.point(x), 0.0
        for c in costs:
            total += c(point)
            if total > most[0]:
                break
        return total

    def ends(intermediate_result: OptimizeResult) -> None:
        """End a search that begins with nothing better than no effect at all."""
        if intermediate_result.fun > HOPELESS * plain:
            raise StopIteration
        most[0] = float(np.max(intermediate_result.population_energies))

    with ThreadPoolExecutor(2) as pool:
        drawn = qmc.Sobol(box.dimensions, rng=1).random_base2(box.dimensions + crowd)
        order = np.argsort(list(pool.map(cost, drawn)), kind="stable")
        found = differential_evolution(
            cost,
            Bounds(np.zeros(box.dimensions), np.ones(box.dimensions)),
            init=drawn[order[: CROWD * box.dimensions]],
            maxiter=GENERATIONS,
            mutation=MUTATION,
            recombination=RECOMBINATION,
            polish=False,
            updating="deferred",
            workers=pool.map,
            callback=ends,
            rng=1,
        )
    return float(found.fun), box.point(found.x)


def _delivered(sides: tuple[Side, ...], fits: tuple[Fit, ...], term: Term) -> list[Point]:
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

    return [min(map(best, Box.of(term, sides[0].scales)), key=lambda pair: pair[0])[1]]


def _cost(fold: Fold, fit: Fit, term: Term) -> Callable[[Point | None], float]:
    """Return the cost of a point on the worst stretch of a fold, the base tuned to first order.

    That of no point is what there is without the effect.
    """
    rows, settled = _worst(fold, fit.e)
    part = fold.stretch(rows.start, rows.stop)
    part = part.only(np.arange(rows.start, rows.stop) >= settled, fold.label)
    J = fit.J[np.sum(fold.keep[:settled]) :][: part.n_kept]
    Q = np.linalg.qr(J / np.maximum(np.linalg.norm(J, axis=0), 1e-300))[0]
    loop = fit.loop.with_effect(term)
    base = loop.values(_beginning(fit, term))

    def cost(point: Point | None) -> float:
        """Return the mean square of the whitened error."""
        if point is None:
            e = part.error(fit.loop, fit.values)
        else:
            e = part.error(loop, {**base, **{f"{term.name}.{k}": v for k, v in point.items()}})
        return float(e @ e - np.sum((Q.T @ e) ** 2)) / len(e)

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
