"""Rounds: one more effect on top of those that are named, the best of all that could be."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from ..physics import Term
from .fit import Fit
from .rules import ADEQUATE, Rules
from .screen import Score, screen
from .side import Side
from .trial import Trial, attempt

_CLEAN = 1.05  # whitened energy over the floor at which nothing is left
_FAR = 0.35  # of the best share: an effect whose screening is below is not its rival
_ROUGH = 0.1  # share of a record that smooth laws do not explain


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the forward selection.

    Parameters
    ----------
    shares : mapping
        Share of each effect in the screening, mean of the folds, largest first.
    trials : tuple of Trial
        Everything that was fitted.
    good : tuple of Trial
        What would earn a name; the largest share gets it.
    """

    shares: dict[str, float]
    trials: tuple[Trial, ...]
    good: tuple[Trial, ...] = ()

    @property
    def best(self) -> Trial | None:
        """What earns a name."""
        return max(self.good, key=lambda t: t.share, default=None)

    def rivals(self, rules: Rules, left: float) -> tuple[Trial, ...]:
        """Return what the data do not tell from the best: effects that change the same, as well.

        One rival stays in doubt longer than several: the form of a law is never quite that of the
        axis, which moves a single pair of curves apart that are the same in kind; of several at
        once the better form is the likelier one. Where a gap is left in the end, whatever makes
        it may decide between a pair: the margin is wider, and no t value tells them apart.

        Parameters
        ----------
        rules : Rules
        left : float
            Whitened energy that all named effects leave; 1 is the floor.
        """
        best, clean = self.best, left < _CLEAN
        if best is None:
            return ()
        least = (1.0 - (rules.margin if clean else rules.doubt)) * best.share
        near = [t for t in self.good if t is not best and t.share >= least]
        rivals = [t for t in near if best.overlap(t) > rules.overlap]
        if clean:
            rivals = [t for t in rivals if best.tells(t) < rules.told]
        if len(rivals) > 1:
            rivals = [t for t in rivals if best.tells(t) < rules.several]
        return tuple(rivals)

    def alike(self, least: float) -> set[str]:
        """Return the effects that remove at least this part of what the best one removes."""
        if self.best is None:
            return set()
        sizes = {**self.shares}
        sizes |= {t.name: max(t.share, self.shares[t.name]) for t in self.trials}
        return {n for n, size in sizes.items() if size >= least * sizes[self.best.name]}


def play(
    sides: tuple[Side, ...],
    base: tuple[Fit, ...],
    rounds: Sequence[Round],
    terms: list[Term],
    rules: Rules,
) -> Round:
    """Look for one more effect.

    Parameters
    ----------
    sides : tuple of Side
        Two folds.
    base : tuple of Fit
        The model without any effect, fitted on each.
    rounds : sequence of Round
        The rounds before, each with a best effect.
    terms : list of Term
        What is tried.
    rules : Rules
    """
    last = rounds[-1].best if rounds else None
    fits, held = (last.fits, last.held) if last else (base, base)
    found = _screened(sides, fits, terms)
    gains = {t.name: t.gain for r in rounds for t in r.trials}
    trials = tuple(_tried(sides, fits, held, found, rules, gains))
    alike = set().union(*(r.alike(rules.alike) for r in rounds))
    least = rules.further * max(cost(base) - 1.0, 0.0)
    good = (t for t in trials if t.passes(rules) and (t.name not in alike or t.gain > least))
    return Round(_shares(found), trials, tuple(good))


def cost(fits: tuple[Fit, ...]) -> float:
    """Return the mean square of the whitened error, mean of the folds."""
    return float(np.mean([f.cost for f in fits]))


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

    The screening, of first order, does not see a narrow valley. Effects with many are searched as
    well where everything else leaves a gap, and smooth laws of the state leave many
    stretches of the record unexplained, as masses that move on their own do; not again where the
    `gains` of an earlier round say that they would not be most of what is left.
    """
    shares = _shares(found)
    valleys = {n for n in shares if found[0][n].term.search == "valleys"}
    chosen = [n for n in list(shares)[: rules.refit] if shares[n] > 0.4 * rules.sure.share]
    tried: list[Trial] = []

    def fit(names: list[str]) -> float:
        """Try some effects; return the largest share that passes so far."""
        with ThreadPoolExecutor(2) as pool:
            tasks = [[f[n] for f in found] for n in names]
            tried.extend(pool.map(lambda scores: attempt(sides, fits, held, scores), tasks))
        return max([0.0, *(t.share for t in tried if t.passes(rules))])

    best = fit(chosen[:2])
    best = fit([n for n in chosen[2:] if shares[n] > _FAR * best or n in valleys])
    rough, left = max(s.rough for s in sides) > _ROUGH, (1.0 - best) * cost(held)
    if rough and left > ADEQUATE:
        hopeless = {n for n, gain in gains.items() if gain < rules.rest * (left - 1.0)}
        fit(sorted(valleys - {*chosen} - hopeless))
    return tried
