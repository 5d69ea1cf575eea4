"""Attribute: which of the effects are named, judged on data they were not fitted to.

An effect is fitted on one fold, frozen, and the base parameters are tuned again on the other fold.
It passes when it removes some of the gap there, in both directions, by more than its blocks differ,
and is named when all that speaks for it together makes it likely. Rounds of a forward selection add
one effect each; a backward pass drops what a later one made superfluous.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...loop import ClosedLoop
from ...physics import Term
from ...workers import threaded
from ..candidate import Trial, deeper, frozen
from ..discrepancy import Laws
from ..fit import Fit, common, cost, gauss_newton, normal
from ..library import library
from ..rules import CLEAN, LIKELY, LITTLE, MOST, PAIR_ROUNDS, SURELY_NEEDED, Rules
from .attribution import Attribution, Supposed
from .evidence import evidence, left_by_smooth_laws, probability, weigh
from .kept import names_kept
from .rounds import Places, Round, play


def attribute(
    base: tuple[Fit, ...],
    rules: Rules,
    extra: tuple[Term, ...] = (),
    without: tuple[str, ...] = (),
    places: Places | None = None,
) -> Attribution:
    """Name the effects by forward selection and backward elimination.

    As soon as one of them depends on the position, all are judged where both folds have been. The
    search goes on at the floor, too: that was learnt beside the base model, and may have some of
    what a second effect does in it.

    Parameters
    ----------
    base : tuple of Fit
        The model as it is, fitted on two folds.
    rules : Rules
    extra : tuple of Term
        Effects of the user's own.
    without : tuple of str
        Effects left out of the library.
    places : mapping, optional
        Where valleys of effects are known to be: a search that begins in one ends there.
    """
    selection = _Selection(base, rules, extra, without, places or {})
    rounds, groups, local = selection.forward()
    if local:
        known = {name: at for r in rounds for name, at in r.valleys.items()}
        return attribute(common(base), rules, extra, without, {**selection.places, **known})
    ends = [group[-1] for group in groups]
    models = [common(fits) for fits in (base, *(t.held for t in ends))] if ends else []
    left = bool(ends) and _unexplained(base, ends[-1].held)  # to describe
    laws = Laws.of(models[0]) if left else None
    sensed = rounds[0].sensed if rounds else ""
    most, unsurpassed, certain = names_kept(models, laws, groups, rules, sensed)
    fits, held = (ends[most - 1].fits, ends[most - 1].held) if most else (base, base)
    won = [t for group in groups[:most] for t in group]
    names = [t.name for t in won]
    surpassed = frozenset(t.name for group in groups[unsurpassed:most] for t in group)
    kept, fits, held = _backward(base, fits, held, won)
    found = Attribution(base, fits, held, tuple(kept), rules, rounds, laws, surpassed, certain)
    found = selection.beside_others(found)
    ended = {tuple(names[: names.index(t.name) + 1]): t for t in ends[:most]}
    found = _withdrawn(found, ended)
    first = rounds[0].best if rounds else None
    if found.named or first is None or first.removed < MOST * (cost(base) - 1.0):
        return found
    return replace(found, supposed=Supposed(first.name, first.fits[0].values, first.gain))


@dataclass(frozen=True, eq=False)
class _Selection:
    """The rounds of a selection; parameters as for `attribute`."""

    base: tuple[Fit, ...]
    rules: Rules
    extra: tuple[Term, ...]
    without: tuple[str, ...]
    places: Places

    def play(self, earlier: Sequence[Round], only: Collection[str] = ()) -> Round:
        """Return the round that comes after some others, of all effects or these."""
        last = earlier[-1].best if earlier else None
        loop = last.fits[0].loop if last else self.base[0].loop
        terms = library(loop, self.extra, self.without)
        chosen = [t for t in terms if t.name in only or not only]
        return play(self.base, earlier, chosen, self.rules, self.places)

    def forward(self) -> tuple[tuple[Round, ...], list[tuple[Trial, ...]], bool]:
        """Look for one effect after the other.

        Returns the rounds, what gets a name in each of them, one effect or a pair, and whether the
        last one depends on positions or times that the other record has not seen: then all are
        looked for once more where both have been.
        """
        rounds: list[Round] = []
        groups: list[tuple[Trial, ...]] = []
        room = self.rules.most
        while room:
            rounds.append(self.play(rounds))
            group, more = self._next(rounds, room)
            rounds += more
            if not group:
                break
            if self._beyond(group):
                return tuple(rounds), groups, True
            groups.append(group)
            room -= len(group)
        return tuple(rounds), groups, False

    def _next(self, rounds: Sequence[Round], room: int) -> tuple[tuple[Trial, ...], list[Round]]:
        """Return what gets a name after the last round, and further rounds that this took.

        Parameters
        ----------
        rounds : sequence of Round
        room : int
            Names that may still be given.
        """
        last = rounds[-1]
        best = last.best
        if best is None:
            return (), []
        if self._beyond((best,)) or not self._doubtful(best, last):
            return (best,), []
        more = self._pair(rounds) if room > 1 else []
        if more:
            return tuple(r.best for r in more[-2:] if r.best is not None), more
        return (() if self._doubtful(best, last, asked=True) else (best,)), []

    def _pair(self, rounds: Sequence[Round]) -> list[Round]:
        """Return further rounds that end with either of two effects beside the other, or nothing.

        Where two of them share the gap, neither explains most of it alone, and a force that only
        resembles one may do better than both. So the round's best is followed by the next one,
        beside which the first is chosen anew. Both get a name if they leave the floor together, and
        either is sure beside the other. An effect that depends on a position which the other fold
        has not seen ends the search by itself: it begins again where both have been.

        Parameters
        ----------
        rounds : sequence of Round
            The last one has the best effect that is doubtful by itself.

        P. Pudil, J. Novovicova, J. Kittler, Pattern Recognition Letters 15(11), 1994: a search that
        floats.
        """
        earlier, first = list(rounds[:-1]), rounds[-1]

        def beside(name: str) -> Round | None:
            """Return the round that comes after a first one with this effect."""
            if first.best is not None and first.best.name == name:
                return self.play(rounds)
            known = [t for t in first.trials if t.name == name]
            known = known or list(self.play(earlier, [name]).trials)
            return self.play([*earlier, first.ending(known[0])]) if known else None

        assert first.best is not None
        names = [first.best.name]
        found: list[Round] = []
        while len(found) < PAIR_ROUNDS:
            last = beside(names[-1])
            if last is None or last.best is None or self._doubtful(last.best, last):
                return []
            found.append(last)
            if self._beyond((last.best,)):
                return found
            names.append(last.best.name)
            if len(found) > 1 and names[-1] == names[-3]:  # either is the best beside the other
                return found if cost(last.best.held) < CLEAN else []
        return []

    def beside_others(self, result: Attribution) -> Attribution:
        """Judge what is doubtful once more, beside all other names, if together they leave nothing.

        Where it was found the gap held what the later ones explain, which makes any effect uneven.
        """
        if len(result.named) < 2 or cost(result.held) >= CLEAN:
            return result
        anew = []
        for name in result.doubtful:
            other = next(t for n, (_, t) in result.winners.items() if n != name)
            fewer = _without(result.fits, name)
            held = frozen(fewer)
            others = replace(other, fits=fewer, held=held, before=result.base)
            twins = (t.name for t in result.twins(result.winners[name][0]))
            last = self.play([result.rounds[0].ending(others)], [name, *twins])
            anew += [last] if last.best is not None and last.best.name == name else []
        return replace(result, rounds=(*result.rounds, *anew))

    def _beyond(self, group: Sequence[Trial]) -> bool:
        """Whether one depends on positions or times that the other record has not seen."""
        elsewhere = any(f.fold.both is not None for f in self.base)
        return elsewhere and any(t.term.local for t in group)

    def _doubtful(self, best: Trial, last: Round, asked: bool = False) -> bool:
        """Whether names with such evidence were hardly more often right than wrong.

        If `asked`, that the effect stands is evidence as well: two that leave nothing come first.
        What a further sensor in the law has measured is no guess.
        """
        if best.name == last.sensed:
            return False
        twins = last.twins(cost(best.held))
        others = [t for t in last.trials if t not in (best, *twins)]
        found = (weigh if asked else evidence)(best, others, self.base)
        return probability(found) < LIKELY


def upheld(base: tuple[Fit, ...], found: Attribution) -> Attribution:
    """Return what was named on part of the records, if it also tells something on all of them.

    A force without a name must not do better there: of what stands out an effect may show the
    part that is like it. What a further sensor in the law has measured is no guess.

    Parameters
    ----------
    base : tuple of Fit
        The model without effects, on two folds with the stretches that stand out.
    found : Attribution
        On the folds without those stretches.
    """
    if not found.named or found.certain & {*found.named}:
        return found
    before, held = map(common, (base, frozen(found.fits, [f.fold for f in base])))
    laws = Laws.of(before)
    whole = tuple(replace(t, before=before, held=held) for _, t in found.winners.values())
    if laws is None or names_kept((before, held), laws, [whole], found.rules).unsurpassed:
        return found
    return replace(found, fits=found.base, held=found.base, named=(), full=found.held)


def _withdrawn(result: Attribution, known: Mapping[tuple[str, ...], Trial]) -> Attribution:
    """Take back the names that what is left in the end makes doubtful.

    A model with those that stay is fitted anew, unless it is `known`, by its names in their order:
    from where it was beside the others it may not find back.
    """
    doubtful, fits = result.doubtful, result.fits
    if not doubtful:
        return result
    named = tuple(n for n in result.named if n not in doubtful)
    if not named:
        fits = held = result.base
    elif (trial := known.get(named)) is not None:
        fits, held = trial.fits, trial.held
    else:
        for name in doubtful:
            fits = _without(fits, name)
        held = frozen(fits)
    return replace(result, fits=fits, held=held, named=named, full=result.held)


def _backward(
    base: tuple[Fit, ...], fits: tuple[Fit, ...], held: tuple[Fit, ...], won: Sequence[Trial]
) -> tuple[list[str], tuple[Fit, ...], tuple[Fit, ...]]:
    """Drop effects that a later one made superfluous, or that stand for a descent that ended early.

    The last one may stand for the descent of those before it: where hardly anything is lost without
    it of what it removed. What is far from superfluous to first order is not fitted without, unless
    it was found beside a valley: that may go deeper without it, from where both are.
    """
    valleys = {t.name for t in fits[0].loop.terms if t.search == "valleys"}
    named = found = [t.name for t in won]
    for k, name in enumerate(found if len(found) > 1 else []):
        least = LITTLE * (won[k].removed if name == found[-1] else cost(base) - cost(held))
        sure = min(_lost(f, name) for f in fits) > SURELY_NEEDED * least
        if sure and not valleys & {*found[:k]}:
            continue
        fewer = _without(fits, name)
        judged = frozen(fewer)
        if cost(judged) - cost(held) < least:
            named, fits, held = [n for n in named if n != name], fewer, judged
    return named, fits, held


def _lost(fit: Fit, name: str) -> float:
    """Return the cost of doing without an effect, to first order; 0 of one that is not linear."""
    term = next(t for t in fit.loop.terms if t.name == name)
    linear = term.linear if term.search != "valleys" else ()
    sizes = np.array([fit.values[n] if n in linear else 0.0 for n in fit.free])
    others = fit.J[:, [n not in term.names for n in fit.free]]
    change = fit.J @ sizes
    rest = change - others @ normal(others, change)
    return float(rest @ rest) / len(rest)


def _unexplained(base: tuple[Fit, ...], held: tuple[Fit, ...]) -> bool:
    """Whether names leave so much that a force without one may explain more.

    Much for the noise, or for what smooth laws leave.
    """
    return cost(held) >= CLEAN * min(1.0, left_by_smooth_laws(base))


def _without(fits: tuple[Fit, ...], name: str) -> tuple[Fit, ...]:
    """Return the model without one of its effects, fitted to each fold from where it was.

    In the valley of another one it goes on.
    """

    def one(fit: Fit) -> Fit:
        """Return that of one fold."""
        terms = tuple(t for t in fit.loop.terms if t.name != name)
        known = {n for t in terms for n in t.names}
        start = {k: v for k, v in fit.loop.start.items() if k in known}
        loop: ClosedLoop = replace(fit.loop, terms=terms, start=start)
        values = {n: v for n, v in fit.values.items() if n in known}
        free = [n for n in fit.free if n in known]
        return gauss_newton(fit.fold, loop, values, free)

    found = tuple(threaded(one, fits))
    for term in found[0].loop.terms:
        found = deeper(found, term)
    return found
