"""Ranking: every effect that was tried, and how much of the gap each closes by itself."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from ..attribute import Attribution
from ..rules import DRAWS, Rules

#: What the word in the ranking means.
SCREENED = "screened: estimated to first order, and not fitted"


@dataclass(frozen=True)
class Ranked:
    """One effect in the ranking.

    Parameters
    ----------
    effect : str
    closed : float
        Fraction of the reducible energy of the gap that it closes alone.
    p_value : float
        Of no gain on held-out data, corrected for all effects tried; 1 if it was not fitted.
    held_out : bool
        Whether `closed` was judged on held-out data; else it is the screening's estimate.
    replicates : bool
        Whether it passes the rules for a name.
    """

    effect: str
    closed: float
    p_value: float
    held_out: bool
    replicates: bool

    @property
    def chance(self) -> str:
        """The p value as it is printed."""
        if not self.held_out:
            return "screened"
        return f"{self.p_value:.3f}" if self.p_value > 0.0 else f"< {1.0 / DRAWS:g}"

    def to_dict(self) -> dict[str, object]:
        """Return the JSON of the entry."""
        return asdict(self)


def ranking(result: Attribution, rules: Rules, energy: float) -> tuple[Ranked, ...]:
    """Return every effect that was tried, those that were fitted first."""
    gap = energy / (1.0 + energy)  # the reducible part of the whitened energy
    fitted = {t.name: t for t in result.trials}
    ranked = []
    for name, gain in result.screened.items():
        trial = fitted.get(name)
        closed = float(np.clip((trial.gain if trial else gain) / gap, 0.0, 1.0))
        p = result.pvalues.get(name, 1.0)
        ranked.append(
            Ranked(name, closed, p, trial is not None, bool(trial and trial.passes(rules)))
        )
    return tuple(sorted(ranked, key=lambda r: (not r.held_out, -r.closed)))
