"""Rounds: one more effect is looked for, among all that the screening leaves in question.

What passes on held-out data qualifies, in both directions; the largest gain gets the
name, and what is not distinguishable from it is said to be so.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...physics import EFFECTS, Term
from ...workers import threaded
from ..candidate import Trial, attempt
from ..fit import Fit, cost, of_effect
from ..fold import Fold
from ..rules import (
    ADEQUATE,
    AT_FIRST,
    CLEAN,
    DISCREPANCY_T,
    DRAWS,
    HARDLY_ANY,
    LITTLE,
    MOST,
    RIVAL,
    SOME,
    SWUNG,
    Rules,
)
from ..screen import Score, screen

Array = NDArray[np.float64]

#: Parameters by short name, by the name of an effect.
Places = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the forward selection.

    Parameters
    ----------
    rules : Rules
    gains : mapping
        R2 gain of each effect in the screening, mean of the folds, largest first.
    trials : tuple of Trial
        Everything that was fitted.
    scores : tuple of ndarray, (n_effects, n_blocks)
        Per fold, what each block says against each effect that was screened, and that was fitted.
    qualified : tuple of Trial
        What passes, and comes near the largest gain of those, which gets the name.
    sensed : str
        The effect that a further sensor in the law speaks for: it gets the name where its gain is
        within a margin of the largest.
    vain : mapping
        Effects of which no valley was found, and what one may remove at most that was missed.
    """

    rules: Rules
    gains: dict[str, float]
    trials: tuple[Trial, ...]
    scores: tuple[Array, ...] = ()
    qualified: tuple[Trial, ...] = ()
    sensed: str = ""
    vain: dict[str, float] = field(default_factory=dict)

    @cached_property
    def best(self) -> Trial | None:
        """What is named in this round: of equals the one with fewest parameters."""
        best = max(self.qualified, key=lambda t: t.gain, default=None)
        if best is None:
            return None
        sensed = next((t for t in self.qualified if t.name == self.sensed), None)
        if sensed is not None and sensed.gain >= (1.0 - self.rules.equivalence_open) * best.gain:
            return sensed
        equal = [t for t in self.qualified if _equal(t, best)]
        order = [*EFFECTS, *(t.name for t in equal)]
        return min(equal, key=lambda t: (len(t.term.parameters), order.index(t.name)), default=best)

    def twins(self, left: float) -> tuple[Trial, ...]:
        """Return what is not distinguishable from the best: the same change, as large.

        Where a gap is left in the end, whatever makes it may decide between them: the margin is
        wider, and a t value decides nothing. Nor does it between two that do all but equally
        well, as a spring and gravity do over a short stroke.

        Parameters
        ----------
        left : float
            Whitened energy that all named effects leave; 1 is the floor.
        """
        best, rules, clean = self.best, self.rules, left < CLEAN
        if best is None:
            return ()
        margin = rules.equivalence if clean else rules.equivalence_open
        least = (1.0 - margin) * best.gain
        near = [t for t in self.trials if t is not best and t.gain >= least and t.sound]
        twins = [t for t in near if best.correlation(t) > rules.correlation]
        if clean:
            twins = [t for t in twins if best.advantage(t) < DISCREPANCY_T or _equal(t, best)]
        return tuple(twins)

    def ending(self, trial: Trial) -> Round:
        """Return the round as if this effect got the name."""
        return replace(self, qualified=(trial,), sensed="")

    @property
    def removed(self) -> dict[str, float]:
        """Energy that each effect which was tried removes, or might."""
        return {**self.vain, **{t.name: t.removed for t in self.trials}}

    @property
    def valleys(self) -> dict[str, dict[str, float]]:
        """Where the valleys of effects that help were found: their parameters by short name."""
        tried = (t for t in self.trials if t.term.search == "valleys" and t.gain > 0.0)
        return {t.name: of_effect(t.fits[0].values, t.name) for t in tried}

    def similar(self) -> set[str]:
        """Return the effects with most of the best one's gain."""
        assert self.best is not None
        tried = {t.name: max(t.gain, self.gains[t.name]) for t in self.trials}
        sizes = {**self.gains, **tried}
        least = MOST * sizes.get(self.best.name, self.best.gain)
        return {n for n, size in sizes.items() if size >= least}


def _equal(trial: Trial, best: Trial) -> bool:
    """Whether an effect gains nearly as much as the best one, and leaves hardly more.

    Of a gap that is far above the noise the two leave what tells them apart.
    """
    left = cost(trial.held) <= (1.0 + LITTLE) * cost(best.held)
    return trial.gain >= (1.0 - HARDLY_ANY) * best.gain and left


def play(
    base: tuple[Fit, ...], rounds: Sequence[Round], terms: list[Term], rules: Rules, places: Places
) -> Round:
    """Look for one more effect.

    Parameters
    ----------
    base : tuple of Fit
        The model without any effect, fitted on two folds.
    rounds : sequence of Round
        The rounds before, each with a best effect.
    terms : list of Term
        What is tried.
    rules : Rules
    places : mapping
        Where valleys of effects are known to be.
    """
    last = rounds[-1].best if rounds else None
    fits, held = (last.fits, last.held) if last else (base, base)
    found = tuple(threaded(lambda f: screen(f, terms), fits))
    removed = {n: size for r in rounds for n, size in r.removed.items()}
    measured = all(f.fold.scales.second_body for f in base)
    sensed = next((t.name for t in terms if t.sensed and measured), "")
    tried = _Tries(fits, held, found, rules, removed, sensed, places).all()
    trials = tuple(t for t in tried.values() if t is not None)
    vain = {n: SOME * cost(held) for n, t in tried.items() if t is None}
    named = [r.best.term for r in rounds if r.best is not None]
    similar = set().union(*(r.similar() for r in rounds))
    least = LITTLE * max(cost(base) - 1.0, 0.0)
    alike = set()
    if any(t.of_speed for t in named):  # whose form is never quite the axis's
        alike = {t.name for t in terms if t.everywhere and not t.second_mass}
    new = [t for t in trials if t.name not in similar | alike or t.removed > least or t.apart]
    if cost(held) < ADEQUATE:
        new = [t for t in new if t.name not in alike]
    if any(t.second_mass for t in named):
        least = SWUNG if base[0].fold.link is not None else 0.0
        new = [t for t in new if t.removed > least * (cost(base) - cost(held))]
    near = (1.0 - rules.equivalence_open) * _largest(new, rules)
    qualified = tuple(t for t in new if 0.0 < near <= t.gain and t.passes(rules))
    scores = tuple(
        _scores(fit.fold, f, [(t.before[i], t.held[i]) for t in trials])
        for i, (fit, f) in enumerate(zip(fits, found, strict=True))
    )
    return Round(rules, _gains(found), trials, scores, qualified, sensed, vain)


def _largest(trials: Sequence[Trial], rules: Rules) -> float:
    """Return the largest gain of what passes; what is smaller is not looked at."""
    by_gain = sorted((t for t in trials if t.gain > 0.0), key=lambda t: -t.gain)
    return next((t.gain for t in by_gain if t.passes(rules)), 0.0)


def _gains(found: tuple[dict[str, Score], ...]) -> dict[str, float]:
    """Return the gain of each effect in the screening, mean of the folds, largest first."""
    names = [n for n in found[0] if n in found[1]]
    mean = {n: float(np.mean([f[n].gain for f in found])) for n in names}
    return dict(sorted(mean.items(), key=lambda item: -item[1]))


@dataclass(eq=False)
class _Tries:
    """What is fitted in a round, some effects after the others.

    Parameters
    ----------
    fits, held : tuple of Fit
        The model of the round before, fitted to each fold, and as the other one has it.
    found : tuple of dict
        The screening of each fold.
    rules : Rules
    removed : mapping
        What effects removed in earlier rounds.
    sensed : str
        The effect that a further sensor in the law speaks for.
    places : mapping
        Where valleys of effects are known to be.
    made : dict
        What was fitted so far; None of what has no place to begin.
    best : float
        The largest gain of what passes so far; what is too little for a name counts as well.
    """

    fits: tuple[Fit, ...]
    held: tuple[Fit, ...]
    found: tuple[dict[str, Score], ...]
    rules: Rules
    removed: Mapping[str, float]
    sensed: str
    places: Places
    made: dict[str, Trial | None] = field(default_factory=dict, init=False)
    best: float = field(default=0.0, init=False)

    @cached_property
    def gains(self) -> dict[str, float]:
        """Gain of each effect in the screening, largest first."""
        return _gains(self.found)

    @cached_property
    def terms(self) -> dict[str, Term]:
        """The effects, in that order."""
        return {n: self.found[0][n].term for n in self.gains}

    @property
    def fitted(self) -> list[Trial]:
        """What had a place to begin."""
        return [t for t in self.made.values() if t is not None]

    @property
    def left(self) -> float:
        """Whitened energy that the best of them leaves."""
        return (1.0 - self.best) * cost(self.held)

    def closed(self, share: float) -> bool:
        """Whether the best of them closes so much of the gap."""
        return self.best * cost(self.held) >= share * max(cost(self.held) - 1.0, 1e-9)

    def fit(self, names: Sequence[str]) -> None:
        """Fit some effects."""
        left = self.left

        def tried(name: str) -> Trial | None:
            """Return the trial of one of them."""
            scores = [f[name] for f in self.found]
            return attempt(self.fits, self.held, scores, left, self.places.get(name))

        self.made.update(zip(names, threaded(tried, names), strict=True))
        self.best = _largest(self.fitted, replace(self.rules, worth=0.0))

    def all(self) -> dict[str, Trial | None]:
        """Fit the best of the screening, and what that does not see.

        It is of first order, and sees no narrow valley. Effects with many are searched as well
        where everything else leaves a gap, and smooth laws of the state leave many stretches of the
        record unexplained, as masses that move on their own do; not again where what they `removed`
        says that they would not be most of what is left. What closes nearly all of the gap is named
        first: the search for the rest then sees the rest.
        """
        self.screened()
        self.of_speed()
        if cost(self.held) > ADEQUATE and not self.closed(MOST):
            # first order does not see what takes the place of dry friction, where that is bent
            bent = (n for n, t in self.terms.items() if t.search == "scan" and t.replaces)
            self.fit(self.hopeful(bent))
        rough = max(f.fold.rough for f in self.fits) > SOME
        if rough and self.left > ADEQUATE and not self.closed(1.0 - LITTLE):
            valleys = (n for n, t in self.terms.items() if t.search == "valleys")
            self.fit(self.hopeful(valleys))
        return self.made

    def screened(self) -> None:
        """Fit the best of the screening, and what is `sensed`."""
        gains, refit = self.gains, self.rules.refit
        # four sizes flatter a drift in the screening: it takes no other effect's place
        lasting = [n for n in gains if not self.terms[n].of_time]
        first = {*list(gains)[:refit], *lasting[:refit]}
        chosen = [n for n in gains if n in first and gains[n] > HARDLY_ANY]
        chosen += [n for n in gains if n == self.sensed and n not in chosen]
        self.fit(chosen[:AT_FIRST])
        best = self.best
        least = min([best, *(gains[t.name] for t in self.fitted if t.gain >= best > 0.0)])
        self.fit([n for n in chosen[AT_FIRST:] if gains[n] > RIVAL * least or n == self.sensed])

    def of_speed(self) -> None:
        """Fit all laws of the speed, where one leads: what else is there bends its form."""
        leader = max(self.fitted, key=lambda t: t.gain, default=None)
        if leader is not None and leader.term.of_speed and self.left > CLEAN:
            self.fit([n for n, t in self.terms.items() if t.of_speed and n not in self.made])

    def hopeful(self, names: Iterable[str]) -> list[str]:
        """Return those that are not fitted yet, and might be most of what is left."""
        most = MOST * (self.left - 1.0)
        hopeless = {n for n, size in self.removed.items() if size < most}
        return sorted({*names} - {*self.made} - hopeless)


def pvalues(first: Round) -> dict[str, float]:
    """Return p values of no gain, by the bootstrap of the largest t over all that was screened.

    Of what raises the error as it was fitted there is no doubt, though some of it may be there.
    """
    if not first.trials:
        return {}
    rng = np.random.default_rng(np.random.SeedSequence(list(b"max-t")))
    worst = np.zeros(DRAWS)
    for scores in first.scores:
        signs = rng.choice([-1.0, 1.0], size=(DRAWS, scores.shape[1]))
        size = np.maximum(np.linalg.norm(scores, axis=1), 1e-300)
        worst = np.maximum(worst, np.max(np.abs(signs @ scores.T) / size, axis=1))
    shown = {t.name: max(float(np.min(t.t)), 0.0) * (t.gain > 0.0) for t in first.trials}
    return {name: float(np.mean(worst >= t)) for name, t in shown.items()}


def _scores(fold: Fold, screened: dict[str, Score], pairs: Iterable[tuple[Fit, Fit]]) -> Array:
    """Return what each block of a fold says against what was screened, and against what was fitted.

    Of the latter, fits without and with an effect, on all of the fold or a part of it.
    """
    found = [s.scores for s in screened.values()]
    for before, held in pairs:
        against = np.zeros(len(fold.keep))
        against[held.fold.keep] = (before.e - held.e) * held.e
        found.append(fold.block_sums(against[fold.keep]))
    return np.array(found)
