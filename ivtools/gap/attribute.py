"""Attribute: which of the effects are named, judged on data they were not fitted to.

An effect is fitted on one fold, frozen, and the base parameters are tuned again on the other fold.
It is named when it removes a material share of the gap there, in both directions, in most of the
blocks, and does there nearly what its own fit would do: an effect that replicates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..loop import ClosedLoop
from ..physics import Term
from .candidates import library
from .confidence import Evidence, evidence
from .fit import Fit, gauss_newton, steps
from .rounds import Round, cost, play
from .rules import Rules
from .side import Side
from .trial import Trial, frozen

Array = NDArray[np.float64]


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
    rules : Rules
    rounds : tuple of Round
        The forward selection; the first names nothing if there is nothing to name.
    """

    base: tuple[Fit, ...]
    fits: tuple[Fit, ...]
    held: tuple[Fit, ...]
    named: tuple[str, ...]
    rules: Rules
    rounds: tuple[Round, ...] = ()

    @property
    def trials(self) -> tuple[Trial, ...]:
        """Everything that was fitted in the first round."""
        return self.rounds[0].trials if self.rounds else ()

    @property
    def scores(self) -> dict[str, float]:
        """Share of every effect in the first screening, mean of the folds."""
        return self.rounds[0].shares if self.rounds else {}

    @cached_property
    def _winners(self) -> dict[str, tuple[Round, Trial]]:
        """Round and trial of every effect that is named."""
        pairs = ((r, r.best) for r in self.rounds if r.best is not None)
        return {best.name: (r, best) for r, best in pairs if best.name in self.named}

    @cached_property
    def ambiguous(self) -> dict[str, list[str]]:
        """Per named effect, those that the data cannot tell from it."""
        return {
            name: [t.name for t in self._rivals(r) if t.name not in self.named]
            for name, (r, _) in self._winners.items()
        }

    def _rivals(self, r: Round) -> tuple[Trial, ...]:
        return r.rivals(self.rules, cost(self.held))

    @cached_property
    def evidence(self) -> dict[str, Evidence]:
        """Per named effect, what speaks for it."""
        return {
            n: evidence(b, [t for t in r.trials if t not in (b, *self._rivals(r))], self.base)
            for n, (r, b) in self._winners.items()
        }

    @cached_property
    def pvalues(self) -> dict[str, float]:
        """Of no gain on held-out data, corrected for everything tried in the first round."""
        return _pvalues(self.trials)


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
    rounds: list[Round] = []
    best: list[Trial] = []
    while len(best) < rules.most:
        loop = best[-1].fits[0].loop if best else base[0].loop
        rounds.append(play(sides, base, rounds, library(loop, extra, without), rules))
        if (winner := rounds[-1].best) is None:
            break
        best.append(winner)
    fits, held = (best[-1].fits, best[-1].held) if best else (base, base)
    kept, fits, held = _backward(sides, base, fits, held, [t.name for t in best])
    return Attribution(base, fits, held, tuple(kept), rules, tuple(rounds))


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
