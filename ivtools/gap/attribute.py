"""Attribute: which of the effects are named, judged on data they were not fitted to.

An effect is fitted on one fold, frozen, and the base parameters are tuned again on the other fold.
It is named when it removes a material share of the gap there, in both directions, in most of the
blocks, and does there nearly what its own fit would do: an effect that replicates.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ..loop import ClosedLoop
from ..physics import Term
from .candidates import DENSE, library
from .confidence import Evidence, evidence
from .fit import Fit, gauss_newton, steps
from .rules import ADEQUATE, Rules
from .screen import Score, screen
from .side import Side
from .trial import Trial, attempt, frozen

Array = NDArray[np.float64]

_FAR = 0.35  # of the best share: an effect whose screening is below is not its rival
_ROUGH = 0.1  # share of a record that smooth laws do not explain


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
    pvalues : mapping
        Per effect of the first round.
    evidence : mapping
        What speaks for each named effect.
    """

    base: tuple[Fit, ...]
    fits: tuple[Fit, ...]
    held: tuple[Fit, ...]
    named: tuple[str, ...]
    ambiguous: dict[str, list[str]]
    trials: tuple[Trial, ...]
    scores: dict[str, float]
    pvalues: dict[str, float] = field(default_factory=dict)
    evidence: dict[str, Evidence] = field(default_factory=dict)


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
    alike: set[str] = set()
    gains: dict[str, float] = {}
    ambiguous: dict[str, list[str]] = {}
    rounds: dict[str, tuple[Trial, list[Trial]]] = {}
    first: tuple[Trial, ...] = ()
    scores: dict[str, float] = {}
    while len(named) < rules.most:
        found = _screened(sides, fits, library(fits[0].loop, extra, without))
        tried = _tried(sides, fits, held, found, rules, gains)
        gains |= {t.name: t.gain for t in tried}
        shares = _shares(found)
        first, scores = (first, scores) if named else (tuple(tried), shares)
        least = rules.further * max(_cost(base) - 1.0, 0.0)
        good = [t for t in tried if t.passes(rules) and (t.name not in alike or t.gain > least)]
        if not good:
            break
        best = max(good, key=lambda t: t.share)
        named.append(best.name)
        sizes = {**shares, **{t.name: max(t.share, shares[t.name]) for t in tried}}
        alike |= {n for n, size in sizes.items() if size >= rules.alike * sizes[best.name]}
        ambiguous[best.name] = [t.name for t in _untold(best, good, rules)]
        told = [t for t in tried if t is not best and t.name not in ambiguous[best.name]]
        rounds[best.name] = (best, told)
        fits, held = best.fits, best.held
    kept, fits, held = _backward(sides, base, fits, held, named)
    taken = {n: [a for a in ambiguous[n] if a not in kept] for n in kept}
    proof = {n: evidence(*rounds[n], base, _cost(held)) for n in kept}
    return Attribution(base, fits, held, tuple(kept), taken, first, scores, _pvalues(first), proof)


def _screened(
    sides: tuple[Side, ...], fits: tuple[Fit, ...], terms: list[Term]
) -> tuple[dict[str, Score], ...]:
    """Return the score of every effect on either side."""
    with ThreadPoolExecutor(2) as pool:
        return tuple(pool.map(lambda s, f: screen(s, f, terms), sides, fits))


def _shares(found: tuple[dict[str, Score], ...]) -> dict[str, float]:
    """Return the share of each effect in the screening, mean of the sides, largest first."""
    names = [n for n in found[0] if n in found[1]]
    mean = {n: float(np.mean([f[n].share for f in found])) for n in names}
    return dict(sorted(mean.items(), key=lambda item: -item[1]))


def _tried(
    sides: tuple[Side, ...],
    fits: tuple[Fit, ...],
    held: tuple[Fit, ...],
    found: tuple[dict[str, Score], ...],
    rules: Rules,
    gains: dict[str, float],
) -> list[Trial]:
    """Fit the best of the screening.

    The screening, of first order, does not see the narrow valley of a `DENSE` effect. Those are
    searched as well where everything else leaves a gap, and smooth laws of the state leave many
    stretches of the record unexplained, as masses that move on their own do; not again where the
    `gains` of an earlier round say that they would not be most of what is left.
    """
    shares = _shares(found)
    chosen = [n for n in list(shares)[: rules.refit] if shares[n] > 0.4 * rules.sure.share]
    tried: list[Trial] = []

    def fit(names: list[str]) -> float:
        """Try some effects; return the largest share that passes so far."""
        with ThreadPoolExecutor(2) as pool:
            tasks = [[f[n] for f in found] for n in names]
            tried.extend(pool.map(lambda scores: attempt(sides, fits, held, scores), tasks))
        return max([0.0, *(t.share for t in tried if t.passes(rules))])

    best = fit(chosen[:2])
    best = fit([n for n in chosen[2:] if shares[n] > _FAR * best or n in DENSE])
    rough, left = max(s.rough for s in sides) > _ROUGH, (1.0 - best) * _cost(held)
    if rough and left > ADEQUATE:
        hopeless = {n for n, gain in gains.items() if gain < rules.rest * (left - 1.0)}
        fit([n for n in DENSE if n in shares and n not in chosen and n not in hopeless])
    return tried


def _untold(best: Trial, good: list[Trial], rules: Rules) -> list[Trial]:
    """Return the effects that the data do not tell from the best.

    One rival stays in doubt longer than several: the form of a law is never quite that of the
    axis, which moves a single pair of curves apart that are the same in kind; of several at once
    the better form is the likelier one.
    """
    near = [t for t in good if t is not best and t.share >= (1.0 - rules.margin) * best.share]
    rivals = [t for t in near if best.tells(t) < rules.told]
    return rivals if len(rivals) < 2 else [t for t in rivals if best.tells(t) < rules.several]


def _cost(fits: tuple[Fit, ...]) -> float:
    return float(np.mean([f.cost for f in fits]))


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
    return {t.name: float(np.mean(worst >= max(np.min(t.t), 0.0))) for t in trials}


def _scores(before: Fit, held: Fit) -> Array:
    change = before.e - held.e
    return held.fold.block_sums(change * held.e)
