"""Trial: what an attempt gives: fits of one effect on each fold, and how it does on the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...physics import Term
from ..discrepancy import (
    Laws,
    a_line,
    friction_waves,
    further_waves,
    smooth_rest,
    stands,
    unlike_smooth,
)
from ..fit import Fit, common, cost, costs
from ..fold import Fold, better_t
from ..rules import (
    AGREES,
    DISCREPANCY_T,
    DOMINANT_T,
    GOOD_PART,
    HARDLY_ANY,
    LITTLE,
    MOST,
    NEARLY_ALL,
    STANDARD_ERRORS,
    Rules,
)

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
        return 1.0 - costs(self.held) / costs(self.before)

    @property
    def gain(self) -> float:
        """R2 gain on held-out data, mean of the folds."""
        return float(np.mean(self.gains))

    @property
    def removed(self) -> float:
        """Whitened energy removed on held-out data, mean of the folds; the floor is 1."""
        return cost(self.before) - cost(self.held)

    @property
    def explained(self) -> Array:
        """Share of the whitened energy that it removes from the fold it was fitted to, per fold."""
        return 1.0 - costs(self.fits) / costs(self.before)

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
        before = costs(self.before)
        return (before - costs(self.held)) / np.maximum(before - 1.0, 1e-9)

    @property
    def disagreement(self) -> float:
        """Factor by which the folds disagree in the amplitude; 1 is agreement."""
        return float(np.exp(np.max(np.abs(np.log(np.clip(self.amplitudes[:, 0], 1e-9, None))))))

    @property
    def acts(self) -> bool:
        """Whether it does anything, on both folds: else its gain is that of a fit gone on with."""
        sizes = self.term.linear or self.term.names
        return all(any(fit.values[n] != 0.0 for n in sizes) for fit in self.fits)

    @property
    def inside(self) -> bool:
        """Whether no parameter is at a bound; 0 and 1 are the natural ends of a share.

        Bounds are where a model stops to mean what its name says: a second mass without inertia, or
        one that creeps instead of ringing, or a line that does not come twice, mimics something
        else.
        """
        if self._beyond:
            return False
        at_bound = (
            fit.values[name] == bound
            for fit in self.fits
            for name, p in self.term.by_name.items()
            for bound in (p.lower, p.upper)
            if bound not in (0.0, 1.0) and not p.nuisance
        )
        return not any(at_bound)

    @property
    def same_backlash(self) -> bool:
        """Whether the gap before a second mass is as wide on both folds: else it never opens.

        A spring looks like a contact that is soft, in a gap of any width that is small.
        """
        sizes = ([fit.values[n] for fit in self.fits] for n in self.term.gaps)
        return all(max(s) <= AGREES * min(s) for s in sizes)

    @property
    def _beyond(self) -> bool:
        """Whether a parameter is smaller or larger than the effect's name allows on this axis.

        Sizes are those of the record where they are larger: a line comes twice in one of them. Of
        two parameters of which either does it one is enough: the other may be nothing, or hardly
        anything.
        """
        found = [fit.fold.scales.sizes for fit in self.fits]
        sizes = {k: max(size[k] for size in found) for k in found[0]}
        pairs = [(n, p) for n, p in self.term.by_name.items() if not (p.turn and self._one_turn)]
        small = any if self.term.search != "either" else all

        def beyond(fit: Fit) -> bool:
            """Whether that holds of one fold."""
            sized = [(fit.values[n] / sizes[p.scale], p) for n, p in pairs]
            return any(v > p.most for v, p in sized) or small(v < p.least for v, p in sized)

        return any(map(beyond, self.fits))

    @cached_property
    def _one_turn(self) -> bool:
        """Whether it is one turn of an encoder, which need come once in one of the records."""
        periods = [n for n, p in self.term.by_name.items() if p.turn]
        scales = [fit.fold.scales for fit in self.fits]
        turns = (any(s.a_turn(fit.values[n]) for s in scales) for fit in self.fits for n in periods)
        return bool(periods) and all(turns)

    @cached_property
    def lowered(self) -> float:
        """By how much, in energy, of that of the force."""
        before, after = (sum(f.force_rms**2 for f in fits) for fits in (self.before, self.held))
        return (before - after) / max(sum(f.fold.force_rms(f.loop) ** 2 for f in self.held), 1e-300)

    @cached_property
    def unlike(self) -> float:
        """Share of its gain that no smooth law of the state could have, 0 to 1."""
        if self.term.search == "lines":
            period = max(self._periods(self.fits))
            return float(np.clip(a_line(self.before, self.held, period), 0.0, 1.0))
        return float(np.clip(unlike_smooth(self.before, self.held), 0.0, 1.0))

    @cached_property
    def apart(self) -> bool:
        """Whether it is the motion of a second mass, of which no smooth law could have most."""
        return self.term.second_mass and self.unlike > NEARLY_ALL

    def stands(self, laws: Laws | None) -> bool:
        """Whether it is as large beside a force without a name as by itself.

        What changes with use changes with time as well, which is judged by itself.
        """
        if laws is not None and self.term.of_time:
            laws = laws.without_use
        return stands(common(self.before), common(self.held), laws)

    @cached_property
    def distinct(self) -> bool:
        """Whether a line over position is no smooth law of the state, and no other wave.

        Most of what it and smooth laws remove together must be what only the line can: bumps look
        like one where they are many, and leave most of themselves. Of two or three periods a smooth
        law has most, and does not add a thing where they are the line that they look like; to one
        turn of an encoder, whose period is known, hardly a thing.
        """
        if self.term.search != "lines":
            return True
        if self.further or not all(t > STANDARD_ERRORS for t in self._over(friction_waves)):
            return False
        rest = max(smooth_rest(self.before, self.held), 0.0)
        exact = LITTLE if self._one_turn else HARDLY_ANY
        return self.unlike > MOST * (1.0 + rest) or rest < exact

    @cached_property
    def further(self) -> bool:
        """Whether it is hardly more than a further wave of a line that is named already."""
        lines = self.term.search == "lines"
        return lines and any(t <= STANDARD_ERRORS for t in self._over(further_waves))

    def _over(
        self, waves: Callable[[Sequence[Fit], list[float]], list[list[Array]]]
    ) -> Iterator[float]:
        """Yield by how many standard errors it is better than each of some waves of its periods."""
        folds, own = [h.fold for h in self.held], [h.e for h in self.held]
        for wave in waves(self.before, self._periods(self.held)):
            yield better_t(folds, wave, own)

    def _periods(self, fits: Sequence[Fit]) -> list[float]:
        """Return the period of a line over position in each fit, m or rad."""
        return [f.values[f"{self.name}.{self.term.period}"] for f in fits]

    @cached_property
    def meant(self) -> bool:
        """Whether its parameters mean what its name says: none is nothing or at a bound."""
        return self.acts and self.inside and self.same_backlash

    @property
    def sound(self) -> bool:
        """Whether it does what its name says, and the force error is smaller for it."""
        return self.meant and self.lowered > 0.0 and self.distinct

    def passes(self, rules: Rules) -> bool:
        """Whether the effect replicates, and the force error is smaller for it by enough."""
        share = rules.share if self.term.everywhere else 0.0
        shown, least = float(np.min(self.shares)), rules.t
        if shown > GOOD_PART or self.apart:  # few blocks show what others hide, or a rattle
            least = DISCREPANCY_T
        if shown > MOST and self.apart:
            least = DOMINANT_T
        if np.min(self.t) < least or shown <= share:
            return False
        return self.lowered > rules.worth**2 and self.sound

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
        folds, errors = zip(*self._both(other), strict=True)
        _, own, _, others = zip(*errors, strict=True)
        return better_t(folds, others, own)

    def _both(self, other: Trial) -> Iterator[tuple[Fold, list[Array]]]:
        """Yield, per fold, the samples that count for both effects, and the errors there.

        Those without and with this one, and without and with the other.
        """
        for fits in zip(self.before, self.held, other.before, other.held, strict=True):
            keep = fits[0].fold.keep & fits[2].fold.keep
            fold = fits[0].fold.only(keep)
            yield fold, [f.e[keep[f.fold.keep]] for f in fits]


def _amplitude(before: Fit, held: Fit) -> tuple[float, float]:
    """Return the best multiple of the frozen change, and its block-robust t value."""
    change = before.e - held.e
    energy = float(change @ change)
    if not energy > 0.0:
        return 0.0, 0.0
    amplitude = float(change @ before.e) / energy
    scores = held.fold.block_sums(change * (before.e - amplitude * change))
    return amplitude, amplitude * energy / max(float(np.sqrt(scores @ scores)), 1e-300)
