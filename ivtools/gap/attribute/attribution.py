"""Attribution: the outcome of the selection, and what speaks for each name in it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..candidate import Trial
from ..discrepancy import Laws
from ..fit import Fit, common, cost, of_effect
from ..rules import DISCREPANCY_T, GOOD_PART, LIKELY, Rules
from .evidence import Evidence, probability, weigh
from .rounds import Round, pvalues


class Supposed(NamedTuple):
    """An effect that removes most of a gap by itself and yet has no name.

    Attributes
    ----------
    effect : str
    values : mapping
        Of every parameter of the model with it, on the first fold.
    gain : float
        Share of the whitened energy that it removes on held-out data.
    eventful : bool
        Whether stretches that stand out are part of it; the ranking is then without them.
    """

    effect: str
    values: dict[str, float]
    gain: float
    eventful: bool = False


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
    laws : Laws, optional
        Forces without a name along the motion of the base model, if something is left.
    surpassed : frozenset of str
        Effects without which such a force predicts better than with them.
    certain : frozenset of str
        Effects that are no guess: what a further sensor in the law has measured, and what such a
        force is itself.
    full : tuple of Fit
        As `held`, with the effects that were taken back because their names were doubtful.
    supposed : Supposed, optional
        An effect that removes most of the gap and yet has no name, where nothing has one.
    """

    base: tuple[Fit, ...]
    fits: tuple[Fit, ...]
    held: tuple[Fit, ...]
    named: tuple[str, ...]
    rules: Rules
    rounds: tuple[Round, ...] = ()
    laws: Laws | None = None
    surpassed: frozenset[str] = frozenset()
    certain: frozenset[str] = frozenset()
    full: tuple[Fit, ...] = ()
    supposed: Supposed | None = None

    @property
    def trials(self) -> tuple[Trial, ...]:
        """Everything that was fitted in the first round."""
        return self.rounds[0].trials if self.rounds else ()

    @property
    def places(self) -> dict[str, dict[str, float]]:
        """Where the valleys of effects were found, if one of them got a name: their parameters."""
        found = self.rounds[0].valleys if self.rounds else {}
        return found if {*found} & {*self.named} else {}

    @property
    def screened(self) -> dict[str, float]:
        """R2 gain of every effect in the first screening, mean of the folds."""
        return self.rounds[0].gains if self.rounds else {}

    @property
    def parameters(self) -> dict[str, dict[str, float]]:
        """Per named effect, its parameters as the first fold has them."""
        return {e: of_effect(self.fits[0].values, e) for e in self.named}

    @property
    def replication(self) -> dict[str, tuple[float, float]]:
        """Per parameter of a named effect, its value on either fold."""
        one, two = (f.values for f in self.fits)
        return {n: (v, two[n]) for n, v in one.items() if "." in n and n in two}

    @cached_property
    def winners(self) -> dict[str, tuple[Round, Trial]]:
        """Round and trial of every effect that is named."""
        pairs = ((r, r.best) for r in self.rounds if r.best is not None)
        return {best.name: (r, best) for r, best in pairs if best.name in self.named}

    @cached_property
    def ambiguous(self) -> dict[str, list[str]]:
        """Per named effect, those that are not distinguishable from it."""
        return {
            name: [t.name for t in self.twins(r) if t.name not in self.named]
            for name, (r, _) in self.winners.items()
        }

    @property
    def alternatives(self) -> tuple[dict[str, float], ...]:
        """Parameters on the first fold with each effect that helps and has no name."""
        helps = (
            t.fits[0]
            for r in self.rounds
            for t in r.trials
            if t.name not in self.named and np.min(t.t) > DISCREPANCY_T and t.gain > 0.0
        )
        own = {t.name for t in self.fits[0].loop.terms}
        return tuple(f.values for f in helps if own <= {t.name for t in f.loop.terms})

    def twins(self, r: Round) -> tuple[Trial, ...]:
        """Return what is not distinguishable from the best effect of a round."""
        return r.twins(cost(self.held))

    @cached_property
    def doubtful(self) -> tuple[str, ...]:
        """Names that are not `LIKELY`, further ones that remove little, and empty ones.

        What removes little beside what all of them leave may be more of that. What was found beside
        a name that falls must stand beside a force without one, which takes its place.
        """
        likely = [n for n, proof in self.evidence.items() if probability(proof) >= LIKELY]
        least = GOOD_PART * (cost(self.held) - 1.0)
        slight = {n for n in likely[1:] if self.winners[n][1].removed < least}
        names = [*self.evidence]
        falls = [n for n in names if n in slight | self._empty or n not in likely]
        after = names[names.index(falls[0]) :] if falls else []
        if beside := [n for n in after if n not in falls]:
            laws = Laws.of(common(self.base))
            falls += [n for n in beside if not self.winners[n][1].stands(laws)]
        return tuple(n for n in names if n in falls)

    @cached_property
    def _empty(self) -> set[str]:
        """Names of effects that are not what these say any more.

        Once another one was added or dropped, an effect may fit best at its bounds.
        """
        return {n for n, (_, t) in self.winners.items() if not replace(t, fits=self.fits).meant}

    @cached_property
    def evidence(self) -> dict[str, Evidence]:
        """Per named effect, what speaks for it."""
        return {n: self.proof(r, best) for n, (r, best) in self.winners.items()}

    def proof(self, r: Round, trial: Trial) -> Evidence:
        """Return what speaks for one of the effects that were tried in a round."""
        others = [t for t in r.trials if t not in (trial, *self.twins(r))]
        found = weigh(trial, others, self.base, self.full or self.held)
        if trial.name in self.certain:
            return replace(found, certain=True)
        return replace(found, surpassed=trial.name in self.surpassed)

    @cached_property
    def pvalues(self) -> dict[str, float]:
        """Of no gain on held-out data, corrected for everything screened in the first round."""
        return pvalues(self.rounds[0]) if self.rounds else {}
