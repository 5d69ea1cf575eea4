"""Answer: what was attributed, in one word."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle

import numpy as np

from ...units import percent, plural, quantity
from ..attribute import Attribution
from ..fit import Fit, common, cost
from ..floor import Measured, come_again
from ..preflight import Finding
from ..quantify import Shrink
from ..rules import (
    ADEQUATE,
    GOOD_PART,
    HARDLY_ANY,
    LITTLE,
    MOST,
    NEARLY_ALL,
    OTHER_VALUE,
    OVER_FLOOR,
    SHORT,
    SURE_T,
    UNSEEN,
)

VERDICTS = {
    "adequate": "the model is as good as the measurement is repeatable, or lacks next to nothing",
    "explained": "the named effects close the gap",
    "partial": "the named effects close part of the gap; a significant part remains",
    "unexplained": "there is a gap, and no effect is sure enough to be named",
    "non-repeatable": "the gap comes and goes: something from outside, or a changed setting",
}

#: Of a gap that no law of the axis's own motion describes.
OUTSIDE = Finding(
    "no force over position, speed or load of this axis describes what is left: something outside "
    "may make it, as another joint's motion or a hand does, or a second mass that was not found; "
    "log what acts from outside as load, and diagnose a joint with its whole robot (--robot)",
    fatal=False,
)
#: Of a gap that the other record cannot judge.
ELSEWHERE = Finding(
    "most of what is left is at positions or times that only one of the records covers, so that "
    "the other one cannot judge it; record both along the same stroke, and as long",
    fatal=False,
)


@dataclass(frozen=True)
class Setting:
    """A base parameter that differs between two records.

    Parameters
    ----------
    record, holdout : float
        Its values.
    t : float
        Difference over its block-robust standard error.
    unit : str
    sure : bool
        Whether the model reproduces one of the records: else what it lacks may bend the parameter.
    """

    record: float
    holdout: float
    t: float
    unit: str
    sure: bool = True

    @property
    def text(self) -> str:
        """The values, with units."""
        one, two = (quantity(x, self.unit, 3) for x in (self.record, self.holdout))
        return f"{one} -> {two}"

    def said(self, name: str) -> str:
        """Return what to say of it, as a sentence."""
        but = "not" if self.sure else "or the work of"
        return f"{name} {self.text} between the records: a changed setting, {but} a missing effect"

    def to_dict(self) -> dict[str, float]:
        """Return the JSON of the change."""
        return {"record": self.record, "holdout": self.holdout, "t": self.t}


def changes(result: Attribution, tolerance: float) -> dict[str, Setting]:
    """Return the base parameters that differ between two records, whatever is named.

    Only where the model reproduces both, or errs by far more with the other record's value: a force
    that it lacks bends the parameters along other motions otherwise.
    """
    if result.fits[0].fold.record is result.fits[1].fold.record:
        return {}
    one, two = (_own_parameters(fit) for fit in common(result.fits))
    found = {}
    force = one.fold.force_rms(one.loop)
    for name in (n for n in one.free if "." not in n and n in two.free):
        a, b = one.values[name], two.values[name]
        t = abs(a - b) / max(np.hypot(one.deviation([name]), two.deviation([name])), 1e-300)
        p = one.loop.parameters[name]
        size = 0.5 * abs(a + b) if p.lower >= 0.0 else tolerance / 100.0 * force / LITTLE
        large = t > SURE_T and abs(a - b) > LITTLE * size
        if large and _needed(one, name, b) and _needed(two, name, a):
            sure = min(one.cost, two.cost) <= 1.0 + GOOD_PART
            found[name] = Setting(a, b, t, p.unit_for(one.loop.joint), sure)
    return found


def _own_parameters(fit: Fit) -> Fit:
    """Return a fit whose base parameters are the axis's own, whatever is not known of its load.

    What an axis cannot tell from a change of its own parameters counts as one while it is
    diagnosed; along another motion it is another one.
    """
    link = fit.fold.link
    if link is None or link.doubt is None:
        return fit
    fold = replace(fit.fold, link=replace(link, doubt=link.doubt.whole))
    return fit.refit(fold)


def _needed(fit: Fit, name: str, value: float) -> bool:
    """Whether no other base parameter makes up for the other record's value of this one."""
    moved = fit.refit(values={name: value}, free=[n for n in fit.free if n != name])
    clear = fit.cost <= 1.0 + GOOD_PART or moved.cost > OTHER_VALUE * fit.cost
    return clear and (moved.cost - fit.cost) * len(fit.e) > SURE_T**2


def decide(
    effects: Sequence[str],
    measured: Sequence[Measured],
    result: Attribution,
    shrink: Shrink,
    changed: Mapping[str, Setting],
    repeats: float,
    tolerance: float,
) -> str:
    """Return the verdict, a key of `VERDICTS`.

    Parameters
    ----------
    effects : sequence of str
        What is named.
    measured : sequence of Measured
    result : Attribution
    shrink : Shrink
    changed : mapping
        Base parameters that differ between the records.
    repeats : float
        Share of what is left above the floor that comes again without having a name.
    tolerance : float
        Per cent of the force below which a gap is negligible.
    """
    small = shrink.slight(tolerance)
    if effects:
        return "explained" if small or shrink.closed >= NEARLY_ALL else "partial"
    few = min(m.fold.n_kept for m in measured)
    allowed = ADEQUATE + (SHORT / few) ** 2
    left = cost(result.held)
    unseen = UNSEEN * tolerance
    pairs = zip(result.held, cycle(measured), strict=False)  # of one record, both parts are its own
    slight = any(100.0 * m.beyond(h) < unseen * m.force for h, m in pairs)
    silent = slight or min(h.cost for h in result.held) <= allowed
    apart = any(_stands_apart(m, left, allowed, silent) for m in measured)
    again = apart and come_again(measured)
    if changed or (apart and not again and (repeats < GOOD_PART or slight)):
        return "non-repeatable"
    between = measured[-1].floor.between
    above = between is not None and shrink.after > OVER_FLOOR * between and not small
    above = above or repeats >= GOOD_PART
    errors = [(shrink.after_frozen, shrink.force), *((m.base.force_rms, m.force) for m in measured)]
    faint = all(e < 0.01 * tolerance * force for e, force in errors)  # floor and all
    enough = (faint and shrink.slight(unseen)) or (left <= allowed and not above)
    return "adequate" if enough and not again else "unexplained"


def _stands_apart(m: Measured, left: float, allowed: float, one_silent: bool) -> bool:
    """Whether stretches of a record stand out, and are all that the model lacks.

    If they are, one record at least shows nothing without them. Where both do, a law of the state
    may be behind all of it: friction over position stands out where the other record has not been.
    The load of a robot's joint is wrong now and then, where its links are hardly known or
    another joint's link swings: there the stretches must be the gap, and all of it.

    Parameters
    ----------
    m : Measured
    left : float
        Whitened energy without those stretches, mean of the records.
    allowed : float
        Energy of a model that is adequate.
    one_silent : bool
        Whether one of the records shows nothing without them.
    """
    if m.fold.link is None:
        return m.floor.isolated and one_silent
    return m.floor.isolated and left <= allowed < m.base.cost


def lowers(shrink: Shrink, simulated: bool, removed: float) -> bool:
    """Whether effects lower the held-out force error, by enough to be worth a name.

    Parameters
    ----------
    shrink : Shrink
    simulated : bool
        Whether all were named by simulation, and not at the controller, which a wrong setting of
        may change the force little.
    removed : float
        Whitened energy that they remove; 1 is the floor. Where fast noise is most of the force
        error, no effect lowers it by much, and an energy that stands out of the noise is enough.
    """
    least = HARDLY_ANY if simulated and removed <= LITTLE else 0.0
    return shrink.after < (1.0 - least) * shrink.before


def no_better(
    effects: Sequence[str], values: Mapping[str, Mapping[str, float]], shrink: Shrink
) -> Finding:
    """Return what to say of effects that do not lower the force error, with what is known of them.

    Parameters
    ----------
    effects : sequence of str
    values : mapping of str to mapping
        Parameters of those that the controller shows: of a limit its value is said.
    shrink : Shrink
        With them.
    """
    limit = values.get("saturation", {}).get("limit", 0.0)  # in the unit of the command
    limited = {"saturation": f"saturation (at {limit:.4g})"}
    names = ", ".join(limited.get(e, e) for e in effects)
    errors = [quantity(x, shrink.unit) for x in (shrink.before, shrink.after)]
    rises = shrink.after > shrink.before
    how = f"goes from {' to '.join(errors)}, which is {'a rise' if rises else 'too little'}"
    if errors[0] == errors[1]:
        how = f"stays at {errors[0]}"
    text = f"with {names} in the model the held-out force error {how}: nothing is named"
    return Finding(text, fatal=False)


def tally(what: str, verdicts: Iterable[str]) -> str:
    """Return how many of some things have which verdict, the most frequent first, as a sentence."""
    counts = Counter(verdicts)
    each = ", ".join(f"{count} {verdict}" for verdict, count in counts.most_common())
    return f"{plural(counts.total(), what)}: {each}."


def may_swing(effects: Sequence[str]) -> Finding:
    """Return what to say of effects that remove less than other joints' links may have left."""
    text = (
        f"{', '.join(effects)} would remove no more than swinging links of other joints may leave"
    )
    return Finding(f"{text}: nothing is named", fatal=False)


def remainder(result: Attribution, shrink: Shrink, described: bool) -> Finding | None:
    """Return what to say of a gap that no name explains; None if that is hardly above the floor.

    An effect that removes most of it and has no name is told also where what is left is described:
    the ranking shows how far it closes.

    Parameters
    ----------
    result : Attribution
    shrink : Shrink
    described : bool
        Whether a force that repeats describes it.
    """
    if (supposed := result.supposed) is not None:
        removed = f"{supposed.effect} by itself removes {percent(supposed.gain)} of the error's "
        where = ", the stretches that stand out included" * supposed.eventful
        why = f"energy on held-out data{where}; too little else speaks for it to be named"
        return Finding(removed + why, fatal=False)
    if described:
        return None
    if cost(common(result.held)) - 1.0 < MOST * (cost(result.held) - 1.0):
        return ELSEWHERE
    return OUTSIDE if shrink.after > OVER_FLOOR * shrink.floor else None
