"""A diagnosis that is finished: what is named, where the gap is, and how far it closes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...loop import ClosedLoop
from ...workers import one_blas_thread
from .. import advice, discrepancy, locate, parity, quantify, verdict
from ..attribute import Attribution, probability
from ..diagnosis import Diagnosis
from ..discrepancy import Discrepancy
from ..fit import Fit, common, cost
from ..floor import Measured, come_again, masked
from ..fold import Fold
from ..preflight import Finding
from ..rules import AT_CONTROLLER, CLEAN, GOOD_PART
from .begun import Begun
from .named import named
from .refused import refused
from .task import Say, mute

Array = NDArray[np.float64]


@one_blas_thread()
def finish(begun: Begun | Diagnosis, progress: Say | None = None, swung: float = 0.0) -> Diagnosis:
    """Finish a diagnosis that has begun; one that was refused is finished.

    Parameters
    ----------
    begun : Begun or Diagnosis
    progress : callable, optional
    swung : float
        Energy of the force error, N2 or (N m)2, that the swing of other joints' links may have left
        in this one: what removes less gets no name.
    """
    if isinstance(begun, Diagnosis):
        return begun
    say = progress or mute
    say("screening and fitting the effects")
    begun, fold, result = named(begun)
    say("where and how far")
    return _answer(begun, result, fold, swung)


def _answer(begun: Begun, result: Attribution, fold: Fold, swung: float) -> Diagnosis:
    """Put the diagnosis together."""
    task, loop, measured = begun.task, begun.loop, begun.measured
    checked, held_out = tuple(m.parity for m in measured), task.holdout is not None
    shown = parity.effects(checked)
    places = result.places
    outcome = _that_lower(loop, measured, result, fold, shown, held_out, swung)
    effects, result, traces = outcome.effects, outcome.result, outcome.traces
    if begun.strangers and not any(t.second_mass for t in result.fits[0].loop.terms):
        return refused(task.record, loop, checked, [*begun.strangers, *begun.found])
    judged = _judged(begun, outcome, fold)
    before, after = cost(result.base), cost(result.held)
    given = len(begun.inspected.checked) - (task.judge is not None)
    remark = [judged.remark] if judged.remark else []
    apart = any(m.floor.isolated for m in measured)
    likely = dict.fromkeys(shown[0], AT_CONTROLLER)
    likely |= {n: probability(proof) for n, proof in result.evidence.items()}
    return Diagnosis(
        verdict=judged.verdict,
        effects=effects,
        ambiguous_with={e: result.ambiguous.get(e, []) for e in effects},
        parameters={e: v for e, v in {**shown[1], **result.parameters}.items() if e in effects},
        block=locate.block(
            effects,
            controller=any(p.delay != p.declared.delay for p in checked),
            events=apart and not (judged.bent or come_again(measured)),
            gap=judged.verdict != "adequate",
            outside=judged.remark is verdict.OUTSIDE,
        ),
        regions=locate.regions(traces.record, traces.keep, traces.before, traces.after),
        shrink=judged.shrink,
        ranking=verdict.ranking(result, begun.rules, max(before, CLEAN) - 1.0),
        advice=(*advice.motions(result), *advice.remarks(measured, result, held_out, given)),
        findings=(*begun.found, *outcome.said, *remark),
        parity=checked,
        floors=tuple(m.floor for m in measured),
        loop=result.fits[0].loop,
        theta=result.fits[0].values,
        chi=(before, after),
        name=task.record.name,
        replication=result.replication,
        replicas=verdict.replicate(effects, result, checked),
        evidence=result.evidence,
        probability={e: p for e, p in likely.items() if e in effects},
        traces=traces,
        changed=judged.changed,
        discrepancy=judged.left,
        tolerance=task.tolerance,
        whole=_whole(measured[0], result) if task.whole else None,
        alternatives=result.alternatives if task.whole else (),
        supposed=None if effects else result.supposed,
        places=places,
    )


class _Judged(NamedTuple):
    """The verdict and what it rests on; whether a force without a name bends the parameters."""

    verdict: str
    changed: dict[str, verdict.Setting]
    left: Discrepancy | None
    shrink: quantify.Shrink
    bent: bool
    remark: Finding | None


def _judged(begun: Begun, outcome: _Outcome, fold: Fold) -> _Judged:
    """Return the verdict, once what is left is described and a third record has judged."""
    task, measured, result, shrink = begun.task, begun.measured, outcome.result, outcome.shrink
    if begun.third is not None:
        shrink = replace(shrink, judged=quantify.judge(begun.loop, begun.third, result))
    after = cost(result.held)
    tell = task.described and after > CLEAN
    left = _left(begun, result, fold) if tell else None
    if left is not None and measured[-1].floor.between is None:
        shrink = shrink.reaching(left.after / max(left.before, 1e-300))
    repeats = 0.0 if left is None else left.gain * after / max(after - 1.0, 1e-9)
    bent = repeats >= GOOD_PART and not shrink.slight(task.tolerance)
    changed = {} if bent else verdict.changes(result, task.tolerance)
    word = verdict.decide(
        outcome.effects, measured, result, shrink, changed, repeats, task.tolerance
    )
    nameless = word == "unexplained" and tell
    remark = verdict.remainder(result, shrink, left is not None) if nameless else None
    return _Judged(word, changed, left, shrink, bent, remark)


def _left(begun: Begun, result: Attribution, fold: Fold) -> Discrepancy | None:
    """Return the force that repeats in what is left; it is judged where both records have been."""
    both = begun.folds[-1].fold.both

    def judged(force: Array) -> tuple[float, float]:
        """Return the force error without and with such a force."""
        return quantify.beside(begun.measured, result, fold, force, both)

    return discrepancy.describe(common(result.held), judged, result.laws)


class _Outcome(NamedTuple):
    """What is named, how far the gap shrinks with it, and what is to be said of names that fell."""

    effects: tuple[str, ...]
    result: Attribution
    shrink: quantify.Shrink
    traces: quantify.Traces
    said: tuple[Finding, ...] = ()


def _that_lower(
    loop: ClosedLoop,
    measured: tuple[Measured, ...],
    result: Attribution,
    fold: Fold,
    parity_shows: tuple[Sequence[str], Mapping[str, Mapping[str, float]]],
    held_out: bool,
    swung: float,
) -> _Outcome:
    """Return the names that lower the force error, by more than links may; if they do not, none."""
    at_controller, values = parity_shows
    last, effects = measured[-1], (*at_controller, *result.named)
    plain = quantify.declared(loop, last, last.fold.at_limit_too)
    shrink, traces = quantify.how_far(plain, measured, result, fold, held_out, bool(effects))
    tried = result.named if measured[-1].driven else effects  # its controller changes nothing
    removed = cost(result.base) - cost(result.held)
    faint = swung > 0.0 and removed * sum(m.floor.surprise for m in measured) < swung
    if not tried or (not faint and verdict.lowers(shrink, not at_controller, removed)):
        return _Outcome(effects, result, shrink, traces)
    said = verdict.may_swing(effects) if faint else verdict.no_better(effects, values, shrink)
    nothing = replace(result, fits=result.base, held=result.base, named=())
    again = quantify.how_far(plain, measured, nothing, fold, held_out, named=False)
    return _Outcome((), nothing, *again, (said,))


def _whole(m: Measured, result: Attribution) -> Fit:
    """Return the final model, fitted to all that counts of the first record."""
    return result.fits[0].refit(masked(m).fold)
