"""Attribute: which of the effects are named, judged on data they were not fitted to.

An effect is fitted on one fold, frozen, and the base parameters are tuned again on the other fold.
It is named when it removes a material share of the gap there, in both directions, in most of the
blocks, and does there nearly what its own fit would do: an effect that replicates.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..loop import ClosedLoop
from ..physics import Term
from .candidates import PERIODIC, Scales, library, scans
from .fit import Fit, gauss_newton, steps
from .fold import Fold
from .response import Response
from .screen import Score, screen

Array = NDArray[np.float64]

#: Nuisance parameters that stay at their usual value.
FIXED = ("backlash.contact_hz", "backlash.damping", "presliding.damping")


@dataclass(frozen=True)
class Rules:
    """What a name takes; the defaults are calibrated on withheld effects.

    Parameters
    ----------
    share : float
        Least share of the whitened energy that an effect removes on held-out data.
    t : float
        Least block-robust t value of the frozen effect's amplitude on held-out data.
    amplitude : tuple of float
        Range of that amplitude, in units of what the other fold found.
    margin : float
        Effects within this fraction of the best are not told from it.
    refit : int
        Effects of the screening that are fitted.
    most : int
        Most effects in a combination.
    """

    share: float = 0.035
    t: float = 5.0
    amplitude: tuple[float, float] = (0.6, 1.67)
    margin: float = 0.08
    refit: int = 4
    most: int = 3
    further: float = 0.05


@dataclass(frozen=True, eq=False)
class Side:
    """One fold with what the attribution needs of it."""

    fold: Fold
    response: Response
    scales: Scales


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
    own_before: tuple[Fit, ...]
    before: tuple[Fit, ...]

    @property
    def shares(self) -> Array:
        """Share of the energy removed on held-out data, per fold."""
        return np.array(
            [1.0 - h.cost / b.cost for h, b in zip(self.held, self.before, strict=True)]
        )

    @property
    def own(self) -> Array:
        """Share of the energy removed where it was fitted, per fold."""
        return np.array(
            [1.0 - f.cost / b.cost for f, b in zip(self.fits, self.own_before, strict=True)]
        )

    @property
    def share(self) -> float:
        """Mean share on held-out data."""
        return float(np.mean(self.shares))

    @cached_property
    def amplitudes(self) -> Array:
        """Amplitude of the frozen effect on each held-out fold and its block t value, (2, 2)."""
        return np.array([_amplitude(b, h) for b, h in zip(self.before, self.held, strict=True)])

    @property
    def t(self) -> Array:
        """Block t value of the amplitude, per fold."""
        return self.amplitudes[:, 1]

    def passes(self, rules: Rules) -> bool:
        """Whether the effect replicates."""
        return bool(
            np.min(self.shares) >= rules.share
            and np.min(self.t) >= rules.t
            and rules.amplitude[0] <= np.min(self.amplitudes[:, 0])
            and np.max(self.amplitudes[:, 0]) <= rules.amplitude[1]
        )


@dataclass(frozen=True, eq=False)
class Attribution:
    """What was named.

    Parameters
    ----------
    base : tuple of Fit
        The model without effects, on each fold.
    fits : tuple of Fit
        The model with the named effects, on each fold.
    held : tuple of Fit
        On each fold, with the effects as the other fold has them.
    named : tuple of str
    ambiguous : mapping
        Per named effect, those that the data cannot tell from it.
    trials : tuple of Trial
        Everything that was fitted in the first round.
    scores : mapping
        Share of the screening per effect, mean of the folds.
    """

    base: tuple[Fit, ...]
    fits: tuple[Fit, ...]
    held: tuple[Fit, ...]
    named: tuple[str, ...]
    ambiguous: dict[str, list[str]]
    trials: tuple[Trial, ...]
    scores: dict[str, float]
    pvalues: dict[str, float] = field(default_factory=dict)


def attribute(
    sides: tuple[Side, ...],
    base: tuple[Fit, ...],
    rules: Rules,
    extra: tuple[Term, ...] = (),
    without: tuple[str, ...] = (),
) -> Attribution:
    """Name the effects by forward selection and backward elimination.

    Parameters
    ----------
    sides : tuple of Side
        Two folds.
    base : tuple of Fit
        The model as it is, fitted on each.
    rules : Rules
    extra : tuple of Term
        Effects of the user's own.
    without : tuple of str
        Effects left out of the library.
    """
    fits, held = base, base
    named: list[str] = []
    ambiguous: dict[str, list[str]] = {}
    first: tuple[Trial, ...] = ()
    scores: dict[str, float] = {}
    while len(named) < rules.most:
        tried, round_scores = _round(sides, fits, held, rules, extra, without)
        first, scores = (first, scores) if named else (tuple(tried), round_scores)
        good = [t for t in tried if t.passes(rules) and (not named or _worth(t, base, rules))]
        if not good:
            break
        best = max(good, key=lambda t: t.share)
        named.append(best.term.name)
        ambiguous[best.term.name] = [
            t.term.name
            for t in good
            if t is not best and t.share >= (1.0 - rules.margin) * best.share
        ]
        fits, held = best.fits, best.held
    kept, fits, held = _backward(sides, base, fits, held, named)
    taken = {n: [a for a in ambiguous[n] if a not in kept] for n in kept}
    return Attribution(base, fits, held, tuple(kept), taken, first, scores, _pvalues(first))


def _worth(trial: Trial, base: tuple[Fit, ...], rules: Rules) -> bool:
    """Whether a further effect removes a material part of the whole gap."""
    gain = np.mean([b.cost - h.cost for b, h in zip(trial.before, trial.held, strict=True)])
    gap = np.mean([max(b.cost - 1.0, 0.0) for b in base])
    return bool(gain > rules.further * gap)


def _round(
    sides: tuple[Side, ...],
    fits: tuple[Fit, ...],
    held: tuple[Fit, ...],
    rules: Rules,
    extra: tuple[Term, ...],
    without: tuple[str, ...],
) -> tuple[list[Trial], dict[str, float]]:
    """Screen everything, and try the best."""
    terms = library(fits[0].loop, extra, without)
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(lambda f, s: screen(f, s.response, terms, s.scales), fits, sides))
    names = [n for n in found[0] if n in found[1]]
    mean = {n: float(np.mean([f[n].share for f in found])) for n in names}
    order = sorted(names, key=lambda n: -mean[n])
    chosen = [n for n in order[: rules.refit] if mean[n] > 0.4 * rules.share]
    with ThreadPoolExecutor(2) as pool:
        tasks = [[f[n] for f in found] for n in chosen]
        return list(pool.map(lambda scores: _trial(sides, fits, held, scores), tasks)), mean


def _trial(
    sides: tuple[Side, ...], fits: tuple[Fit, ...], before: tuple[Fit, ...], scores: list[Score]
) -> Trial:
    new = tuple(_extended(s, f, score) for s, f, score in zip(sides, fits, scores, strict=True))
    return Trial(scores[0].term, new, frozen(sides, new), fits, before)


def frozen(sides: tuple[Side, ...], fits: tuple[Fit, ...]) -> tuple[Fit, ...]:
    """Tune the base parameters on each fold, with the effects that the other fold found."""
    return (_retuned(sides[0], fits[1]), _retuned(sides[1], fits[0]))


def _retuned(side: Side, fit: Fit) -> Fit:
    free = [n for n in fit.free if "." not in n or _phase(n)]
    step = steps(side.fold, fit.loop, side.scales)
    return gauss_newton(side.fold, fit.loop, fit.values, free, step, iterations=3)


def _phase(name: str) -> bool:
    """Whether a parameter is a nuisance of its record: an encoder is homed anew."""
    effect, _, parameter = name.partition(".")
    return effect in PERIODIC and parameter in ("cosine", "sine")


def _extended(side: Side, fit: Fit, score: Score) -> Fit:
    """Fit the model with one more effect, from its best starting values."""
    best: Fit | None = None
    for values in _starts(side, fit, score):
        loop = fit.loop.with_effect(score.term, **values)
        free = _free(fit, score.term, values)
        new = gauss_newton(
            side.fold, loop, loop.values(fit.values), free, steps(side.fold, loop, side.scales)
        )
        best = new if best is None or new.cost < best.cost else best
    assert best is not None
    return best


def _free(fit: Fit, term: Term, values: Mapping[str, float]) -> list[str]:
    own = [n for n in term.names if n not in FIXED]
    if term.name == "drive-timing":  # twins: one of the two is enough
        own = [n for n in own if values[n.partition(".")[2]] != 0.0]
    return [*fit.free, *own]


def _starts(side: Side, fit: Fit, score: Score) -> list[dict[str, float]]:
    """Return starting values; the multimodal effects get a dense scan."""
    if score.term.name == "backlash":
        return [_densest(side, fit, score.term, list(scans(score.term, side.scales)))]
    if score.term.name == "drive-timing":
        dt = side.fold.record.dt
        return [{"delay": 0.5 * dt, "lag": 0.0}, {"delay": 0.0, "lag": 0.5 * dt}]
    return [score.start]


def _densest(side: Side, fit: Fit, term: Term, points: list[dict[str, float]]) -> dict[str, float]:
    """Return the point of a scan with the least error after a linear step of the base.

    Every third gap first, then the gaps beside the best one: the valley is narrow in the gap, and
    wide in the masses.
    """
    Q = np.linalg.qr(fit.J / np.maximum(np.linalg.norm(fit.J, axis=0), 1e-300))[0]
    loop = fit.loop.with_effect(term, **points[0])
    gaps = sorted({p["gap"] for p in points})
    cost: dict[int, float] = {}

    def judge(index: int) -> None:
        named = {f"{term.name}.{k}": v for k, v in points[index].items()}
        e = side.fold.error(loop, {**loop.values(fit.values), **named})
        cost[index] = float(e @ e - np.sum((Q.T @ e) ** 2))

    for i, point in enumerate(points):
        if gaps.index(point["gap"]) % 3 == 1:
            judge(i)
    best = points[min(cost, key=lambda i: cost[i])]
    near = gaps.index(best["gap"])
    for i, point in enumerate(points):
        if (
            point["load_share"] == best["load_share"]
            and 0 < abs(gaps.index(point["gap"]) - near) < 3
        ):
            judge(i)
    return points[min(cost, key=lambda i: cost[i])]


def _backward(
    sides: tuple[Side, ...],
    base: tuple[Fit, ...],
    fits: tuple[Fit, ...],
    held: tuple[Fit, ...],
    named: list[str],
) -> tuple[list[str], tuple[Fit, ...], tuple[Fit, ...]]:
    """Drop effects that a later one made superfluous."""
    for name in list(named[:-1]):
        fewer = tuple(_without(s, f, name) for s, f in zip(sides, fits, strict=True))
        judged = frozen(sides, fewer)
        loss = np.mean([j.cost - h.cost for j, h in zip(judged, held, strict=True)])
        gap = np.mean([b.cost - h.cost for b, h in zip(base, held, strict=True)])
        if loss < 0.05 * gap:
            named, fits, held = [n for n in named if n != name], fewer, judged
    return named, fits, held


def _without(side: Side, fit: Fit, name: str) -> Fit:
    terms = tuple(t for t in fit.loop.terms if t.name != name)
    known = {n for t in terms for n in t.names}
    start = {k: v for k, v in fit.loop.start.items() if k in known}
    loop: ClosedLoop = replace(fit.loop, terms=terms, start=start)
    values = {n: v for n, v in fit.values.items() if n in known}
    free = [n for n in fit.free if n in known]
    return gauss_newton(side.fold, loop, values, free, steps(side.fold, loop, side.scales))


def _amplitude(before: Fit, held: Fit) -> tuple[float, float]:
    """Return the best multiple of the frozen change, and its block-robust t value."""
    change = before.e - held.e
    energy = float(change @ change)
    if not energy > 0.0:
        return 0.0, 0.0
    amplitude = float(change @ before.e) / energy
    scores = held.fold.block_sums(change * (before.e - amplitude * change))
    return amplitude, amplitude * energy / max(float(np.sqrt(scores @ scores)), 1e-300)


def _pvalues(trials: tuple[Trial, ...], draws: int = 500) -> dict[str, float]:
    """Return p values by the bootstrap of the largest t over all that was tried."""
    if not trials:
        return {}
    rng = np.random.default_rng(np.random.SeedSequence(list(b"max-t")))
    worst = np.zeros(draws)
    for side in (0, 1):
        scores = np.array([_scores(t.before[side], t.held[side]) for t in trials])
        signs = rng.choice([-1.0, 1.0], size=(draws, scores.shape[1]))
        size = np.maximum(np.linalg.norm(scores, axis=1), 1e-300)
        worst = np.maximum(worst, np.max(np.abs(signs @ scores.T) / size, axis=1))
    return {t.term.name: float(np.mean(worst >= max(np.min(t.t), 0.0))) for t in trials}


def _scores(before: Fit, held: Fit) -> Array:
    change = before.e - held.e
    return held.fold.block_sums(change * held.e)
