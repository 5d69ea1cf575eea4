"""Named: on which records effects get a name.

On both, on one of them alone, or on what is left of them without the stretches that stand out.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from ..attribute import Attribution, attribute, upheld
from ..candidate import frozen
from ..floor import Measured, folds
from ..fold import Fold
from ..library import library
from ..preflight import Finding
from ..rules import ADEQUATE, ALONE, RATTLES
from .begun import Begun


class Named(NamedTuple):
    """What is named.

    Attributes
    ----------
    begun : Begun
        Of the records that say so.
    fold : Fold
        On which the gap is quantified.
    result : Attribution
    """

    begun: Begun
    fold: Fold
    result: Attribution


def named(begun: Begun) -> Named:
    """Attribute; if nothing qualifies, once more without the stretches that stand out.

    What qualifies with them and gets no name falls to a force without one, which they are not.
    """
    measured, (sides, base), asked = begun.measured, begun.folds, begun.task
    more = (begun.rules, tuple(asked.extra), tuple(asked.without))
    result = attribute(sides, base, *more)
    if not result.named and (alone := _alone(begun, result)) is not None:
        return alone
    fell = any(r.qualified for r in result.rounds)
    if begun.eventful and not (result.named or fell):
        measured, whole = begun.calm, (sides, base)
        sides, base = begun.calm_folds
        again = upheld(*whole, attribute(sides, base, *more))
        result = replace(again, supposed=again.supposed or result.supposed)
    return Named(begun, (measured if len(measured) == 2 else sides)[-1].fold, result)


def _alone(begun: Begun, both: Attribution) -> Named | None:
    """Return what one of two records shows by itself, the clearer one first.

    A load may rattle in one of two motions only, or at other moments in each, so that nothing
    replicates between them: alternating stretches of one record tell it from what came once, if a
    second mass that was looked for in both explained something of that record by itself. So
    may any effect that the other motion does not show: then it changes nothing there, and the model
    of that record is as good with it as without.
    """
    task, pair = begun.task, begun.measured
    if len(pair) < 2:
        return None
    extra = tuple(task.extra)
    others = tuple(t.name for t in library(begun.loop, extra) if not t.second_mass)
    for k in sorted(range(2), key=lambda k: -pair[k].base.cost):
        one, other = pair[k], pair[1 - k]
        silent = other.base.cost < ADEQUATE
        if one.base.cost < ALONE or not (silent or any(m.floor.isolated for m in pair)):
            continue
        name, unmoved = one.fold.record.name, other.fold.record.name
        ways, out = [], tuple(task.without)
        if any(t.term.second_mass and t.explained[k] > RATTLES for t in both.trials):
            but = "nothing replicates between the records"
            ways.append((f"stretches of {name}", but, (*out, *others), False))
        if silent and one.fold.link is None:
            ways.append((name, f"the motion of {unmoved} does not show it", out, True))
        for where, but, left_out, hidden in ways:
            sides, base = folds((one,))
            result = attribute(sides, base, begun.rules, extra, left_out)
            if not result.named or (hidden and not _hidden(other, result)):
                continue
            who = f"judged on {where} alone"
            said = f"{', '.join(result.named)}: {who}, {but}; record one motion twice to be sure"
            single = replace(task, record=one.fold.record, holdout=None)
            own = replace(one, floor=replace(one.floor, between=None))  # they differ by the effect
            found = [*begun.found, Finding(said, fatal=False)]
            alone = replace(begun, task=single, measured=(own,), found=found)
            return Named(alone, sides[-1].fold, result)
    return None


def _hidden(other: Measured, result: Attribution) -> bool:
    """Whether a record that shows no gap shows none with the effects of another one either."""
    sides = (other.side, other.side)
    return frozen(sides, (other.base, result.fits[0]))[0].cost < ADEQUATE
