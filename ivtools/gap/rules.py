"""Rules: what a name takes."""

from __future__ import annotations

from dataclasses import dataclass

from ..physics import Term

#: Whitened energy over the floor below which nothing is missing.
ADEQUATE = 1.12


@dataclass(frozen=True)
class Bar:
    """What an effect must reach to be named.

    Parameters
    ----------
    share : float
        Least share of the whitened energy that it removes on held-out data.
    t : float
        Least block-robust t value of the frozen effect's amplitude on held-out data.
    ratio : float
        Largest factor between that amplitude and what the other fold found.
    part : float
        Least part of the reducible gap, energy above the floor, that it removes.
    """

    share: float
    t: float
    ratio: float
    part: float = 0.0


@dataclass(frozen=True)
class Rules:
    """What a name takes; the defaults are calibrated on withheld effects.

    Parameters
    ----------
    everywhere : Bar
        For the effects that any axis shows a little of: they must be a good part of the gap.
    line : Bar
        For lines over position: many periods are tried, so they must stand out.
    other : Bar
        For all others.
    sure : Bar
        An effect that is as steady as this needs a smaller share.
    margin : float
        Effects within this fraction of the best, or within
    doubt : float
        this one where a gap is left beside them,
    overlap : float
        which change the error in a way this much correlated, are not told from it, unless
    told : float
        the block-robust t value of the difference is larger and nothing else is left, or
    several : float
        larger than this, where there are several such effects.
    refit : int
        Effects of the screening that are fitted.
    most : int
        Most effects in a combination.
    alike : float
        Share of what the best effect removes from which another one is alike to it.
    further : float
        Least part of the whole gap that an effect alike to a named one removes.
    rest : float
        Least part of what is left that makes a search for valleys worth while once more.
    """

    everywhere: Bar = Bar(0.035, 5.0, 1.67, 0.15)
    line: Bar = Bar(0.015, 12.0, 1.3)
    other: Bar = Bar(0.02, 6.5, 1.67)
    sure: Bar = Bar(0.012, 20.0, 1.25)
    margin: float = 0.12
    doubt: float = 0.25
    overlap: float = 0.6
    told: float = 3.0
    several: float = 2.3
    refit: int = 4
    most: int = 4
    alike: float = 0.5
    further: float = 0.05
    rest: float = 0.5

    def bar(self, term: Term) -> Bar:
        """Return what this effect must reach."""
        if term.everywhere:
            return self.everywhere
        return self.line if term.search == "lines" else self.other
