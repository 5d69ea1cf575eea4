"""Kept: which names stay beside a force without a name, which may be any smooth law.

Every smooth law is close to some effect. So such a force describes what is left, after each number
of names and without any, and held-out data judge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

from ...workers import threaded
from ..candidate import Trial
from ..discrepancy import Laws, Spline, advantage, least_t, nothing
from ..fit import Fit, cost
from ..rules import CLEAN, DISCREPANCY_T, HARDLY_ANY, MOST, SEVERAL, SOME, STANDARD_ERRORS, Rules


class Kept(NamedTuple):
    """How many names are kept, in their order.

    Attributes
    ----------
    most : int
        That may be given at all.
    unsurpassed : int
        Of these, those that tell more than a force without a name does.
    certain : frozenset of str
        Names that are no guess: of what a further sensor in the law has measured, and of friction
        over position where such a force is just that.
    """

    most: int
    unsurpassed: int
    certain: frozenset[str] = frozenset()


def names_kept(
    models: Sequence[tuple[Fit, ...]],
    laws: Laws | None,
    groups: Sequence[Sequence[Trial]],
    rules: Rules,
    sensed: str = "",
) -> Kept:
    """Return how many names are kept, and how many of them tell more than a force without a name.

    That force is fitted to what each number of names leaves. The largest number is taken that
    predicts held-out data as well as the best one, within a standard error, unless the force does
    better by itself. Names beyond it need better evidence than the others, and fall if the force is
    a law of one signal. A first name that is no guess is never beyond it.

    Parameters
    ----------
    models : sequence of tuple of Fit
        Without names, with the first one, and so on.
    laws : Laws, optional
        Where nothing is left, there is no such force.
    groups : sequence of sequence of Trial
        What gets each name, or two at once. One that has what no smooth law could have, or stands
        beside one, is not outdone by such a law.
    rules : Rules
    sensed : str
        The effect that a further sensor in the law speaks for.

    L. Breiman, J. H. Friedman, R. A. Olshen, C. J. Stone, "Classification and Regression Trees",
    1984, section 3.4.3: the one-standard-error rule.
    """
    left = [] if laws is None else threaded(laws.fitted, models)
    most = _lasting(models, groups, left)
    if laws is not None and any(map(_timed, groups[:most])):  # time and not use: judged already
        left = threaded(laws.without_use.fitted, models)
    certain = _certain(groups, left, sensed)
    least = min(int(any(t.name in certain for group in groups[:1] for t in group)), most)

    def own(group: Sequence[Trial]) -> bool:
        """Whether one of these effects has what a force without a name has not."""
        return any(t.unlike > MOST or t.stands(laws) for t in group)

    def better(fewer: Spline, more: Spline) -> bool:
        """Whether fewer names predict better, and by more than equals differ."""
        same = more.cost - fewer.cost <= HARDLY_ANY * (cost(models[0]) - fewer.cost)
        return not same and _worth(models[0], fewer, more) < -STANDARD_ERRORS

    def tell(k: int) -> bool:
        """Whether so many names tell more than a force without a name."""
        if not left:
            return True
        if any(better(other, left[k]) for other in left[least:k]):
            return False
        alone = not least and outmatched(models[0], models[k], left[0], left[k], rules)
        return not alone or any(map(own, groups[:k]))

    unsurpassed = next((k for k in range(most, least, -1) if tell(k)), least)
    if left and left[unsurpassed].single:  # it is no law that may be like anything
        most = unsurpassed
    return Kept(most, unsurpassed, certain)


def _timed(group: Sequence[Trial]) -> bool:
    """Whether one of these effects is a function of time."""
    return any(t.term.of_time for t in group)


def _lasting(
    models: Sequence[tuple[Fit, ...]], groups: Sequence[Sequence[Trial]], left: Sequence[Spline]
) -> int:
    """Return how many names there are before one that may be a matter of use.

    What changes with use changes with time as well, and falls with the speed of late. So an effect
    of time or of the speed has no name unless it does better than friction that warms up, nor has
    one of what such friction describes best; that may be the effect of a later name.
    """

    @cache
    def not_use(k: int) -> bool:
        """Whether what gets the k-th name does better than friction that warms up.

        If all names leave nothing, beside the others: else what is theirs would be left.
        """
        own = models[k], models[k + 1]
        if cost(models[-1]) < CLEAN:
            own = _all_but(k, models), models[-1]
        return _not_use(*own, Laws.of(models[0]))

    def lasts(k: int) -> bool:
        """Whether what gets the k-th name is none of use, if it may be one."""
        alike = _timed(groups[k]) or any(t.term.of_speed for t in groups[k])
        if not (alike or (left and left[k].of_use)):
            return True
        later = () if alike else range(k + 1, len(groups))
        return any(_timed(groups[j]) and not_use(j) for j in later) or not_use(k)

    return next((k for k in range(len(groups)) if not lasts(k)), len(groups))


def _all_but(k: int, models: Sequence[tuple[Fit, ...]]) -> tuple[Fit, ...]:
    """Return the model with all names but the k-th, to first order."""
    last, own = models[-1], zip(models[k], models[k + 1], strict=True)
    changes = (before.e - after.e for before, after in own)
    return tuple(replace(f, e=f.e + x) for f, x in zip(last, changes, strict=True))


def _certain(
    groups: Sequence[Sequence[Trial]], left: Sequence[Spline], sensed: str
) -> frozenset[str]:
    """Return the names that are no guess.

    What a further sensor in the law has measured; and a first name of friction over position, where
    the force without a name is just that, whatever its curve.
    """
    names = {t.name for group in groups for t in group} & {sensed}
    if left and left[0].of_place:
        names |= {t.name for group in groups[:1] for t in group if t.term.of_place}
    return frozenset(names)


def _not_use(before: tuple[Fit, ...], after: tuple[Fit, ...], laws: Laws | None) -> bool:
    """Whether effects do better than friction that warms up, by a standard error.

    Parameters
    ----------
    before, after : tuple of Fit
        Without and with them, on each fold.
    laws : Laws, optional
        Along the motion of a model much like them; without them nothing does better.
    """
    if laws is None:
        return True
    return advantage(before, laws.of_use(before), nothing(after)) >= STANDARD_ERRORS


def _short(base: tuple[Fit, ...], held: tuple[Fit, ...], law: Spline, rules: Rules) -> bool:
    """Whether names remove less than a force without a name, by more than equals differ.

    One law alone leaves names less room than several, which may describe anything.
    """
    margin = rules.equivalence_law if len(law.over) == 1 else rules.equivalence_open
    return cost(held) - law.cost > margin * (cost(base) - law.cost)


def _worth(base: tuple[Fit, ...], plain: Spline, both: Spline) -> float:
    """Return the block t value by which a force without a name is better with names before it.

    Infinite where they spare it some of the signals that it needs without them, and it is hardly
    worse: what needs several may be like anything, so it may be a little better and yet not what is
    there.
    """
    most = SOME * (cost(base) - plain.cost)
    if len(both.over) < len(plain.over) >= SEVERAL and both.cost - plain.cost <= most:
        return float("inf")
    return advantage(base, plain, both)


def outmatched(
    base: tuple[Fit, ...], held: tuple[Fit, ...], plain: Spline, both: Spline, rules: Rules
) -> bool:
    """Whether a force without a name explains what names do, and significantly more.

    Unless the names have something that it has not: then both are there.

    Parameters
    ----------
    base, held : tuple of Fit
        The model without effects, and with those that are named.
    plain, both : Spline
        Of what either leaves.
    """
    saved = cost(held) - plain.cost
    return (
        _short(base, held, plain, rules)
        and advantage(base, nothing(held), plain) > least_t(saved / cost(held))
        and _worth(base, plain, both) < DISCREPANCY_T
    )
