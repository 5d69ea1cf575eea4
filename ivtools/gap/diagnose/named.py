"""Named: on which records effects get a name.

On both, on one of them alone, or on what is left of them without the stretches that stand out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ...loop import ClosedLoop
from .. import quantify
from ..attribute import Attribution, attribute, upheld
from ..candidate import retuned
from ..floor import Measured, folds
from ..fold import Fold
from ..library import library
from ..preflight import Finding
from ..rules import ADEQUATE, GOOD_PART, HARDLY_ANY, LARGE
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
    """Attribute; if nothing is named, once more without the stretches that stand out.

    Not where what qualifies with them falls to a force without a name: they are no such force.
    """
    measured, base, asked = begun.measured, begun.folds, begun.task
    more = (begun.rules, tuple(asked.extra), tuple(asked.without), asked.places)
    result = attribute(base, *more)
    if not result.named and (alone := _alone(begun, result)) is not None:
        return alone
    fell = any(r.qualified for r in result.rounds) and not result.full
    if begun.eventful and not (result.named or fell):
        measured, whole, base = begun.calm, base, begun.calm_folds
        again = upheld(whole, attribute(base, *more))
        before = result.supposed and result.supposed._replace(eventful=True)
        result = replace(again, supposed=again.supposed or before)
    return Named(begun, (measured if len(measured) == 2 else base)[-1].fold, result)


class _Way(NamedTuple):
    """A way in which one of two records may show something by itself.

    Attributes
    ----------
    where, why : str
        What judges, and what keeps the other record from it.
    known : tuple of str
        Effects that its command shows without simulation.
    without : tuple of str
        Effects that are not looked for.
    hidden : bool
        Whether the other record must be as good with what is found as without.
    """

    where: str
    why: str
    known: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    hidden: bool = False


def _ways(begun: Begun, both: Attribution, k: int) -> Iterator[_Way]:
    """Yield the ways in which the k-th record may show something by itself.

    Its command shows a limit that changes nothing in the other one, which judges. A load may rattle
    in one of two motions only, or at other moments in each, so that nothing replicates between
    them: alternating stretches of one record tell it from what came once, if a second mass that was
    looked for in both explained something of that record by itself. So may any effect that the
    other motion does not show.
    """
    one, other = begun.measured[k], begun.measured[1 - k]
    name, unmoved = one.fold.record.name, other.fold.record.name
    loop, judges = begun.loop, k == 1
    if not judges and one.parity.limit and _limits(loop, one) and not _limits(loop, other):
        yield _Way(name, f"the command of {unmoved} hardly reaches its limit", ("saturation",))
    silent = other.base.cost < ADEQUATE
    if one.base.cost < LARGE or not (silent or begun.eventful):
        return
    if any(t.term.second_mass and t.explained[k] > GOOD_PART for t in both.trials):
        terms = library(begun.loop, tuple(begun.task.extra))
        others = tuple(t.name for t in terms if not t.second_mass)
        why = "nothing replicates between the records"
        yield _Way(f"stretches of {name}", why, without=others)
    if silent and one.fold.link is None:
        yield _Way(name, f"the motion of {unmoved} does not show it", hidden=True)


def _alone(begun: Begun, both: Attribution) -> Named | None:
    """Return what one of two records shows by itself, the clearer one first."""
    task, pair = begun.task, begun.measured
    if len(pair) < 2:
        return None
    for k in sorted(range(2), key=lambda k: -pair[k].base.cost):
        own = replace(pair[k], floor=replace(pair[k].floor, between=None))  # the effect differs
        for way in _ways(begun, both, k):
            base = folds((own,))
            without = (*task.without, *way.without)
            result = attribute(base, begun.rules, tuple(task.extra), without, task.places)
            effects = (*way.known, *result.named)
            if not effects or (way.hidden and not _hidden(pair[1 - k], result)):
                continue
            who = f"judged on {way.where} alone, {way.why}"
            said = f"{', '.join(effects)}: {who}; record one motion twice to be sure"
            single = replace(task, record=own.fold.record, holdout=None)
            found = [*begun.found, Finding(said, fatal=False)]
            alone = replace(begun, task=single, measured=(own,), found=found)
            return Named(alone, base[-1].fold, result)
    return None


def _limits(loop: ClosedLoop, one: Measured) -> bool:
    """Whether what was put right of the controller lowers the force error of a record."""
    fold = one.fold.at_limit_too
    right, given = replace(one.base, fold=fold), quantify.declared(loop, one, fold)
    return right.force_rms < (1.0 - HARDLY_ANY) * given.force_rms


def _hidden(other: Measured, result: Attribution) -> bool:
    """Whether a record that shows no gap shows none with the effects of another one either.

    Of a line over position with the phase that suits it best; all are as large as there.
    """
    there = result.fits[0]
    here = retuned(other.fold, there, other.base)
    drifts = [n for t in here.loop.terms if t.of_time for n in t.names]
    values = {**here.values, **{n: there.values[n] for n in drifts}}
    for names in (t.phases for t in here.loop.terms if t.phases):
        size, own = (float(np.linalg.norm([f.values[n] for n in names])) for f in (there, here))
        values |= {n: here.values[n] * size / max(own, 1e-300) for n in names}
    return float(np.mean(here.fold.error(here.loop, values) ** 2)) < ADEQUATE
