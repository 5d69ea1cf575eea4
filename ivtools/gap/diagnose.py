"""Process: from records and a loop to a diagnosis."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from threading import Lock
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from ..errors import IVToolsError, RecordError
from ..loop import ClosedLoop
from ..physics import Term
from ..record import Record
from ..simulators.protocol import Simulator
from ..workers import share_heap
from . import (
    advice,
    discrepancy,
    floor,
    locate,
    parity,
    preflight,
    quantify,
    verdict,
)
from .attribute import Attribution, attribute, cost, probability, upheld
from .diagnosis import Diagnosis
from .fit import Fit, common, gauss_newton, of_effect, steps
from .floor import Floor, Measured, Ready, folds, masked, measure, prepared
from .fold import Fold, Link, Side, threaded
from .parity import Parity
from .preflight import Finding, hanging
from .rules import (
    AT_CONTROLLER,
    DESCRIBED,
    OVER_FLOOR,
    REPEATS,
    SATURATED,
    TOLERANCE,
    Rules,
)
from .simulator import against, confirm, run

Array = NDArray[np.float64]


Progress = Callable[[str], None]


def diagnose(
    record: Record,
    loop: ClosedLoop,
    holdout: Record | None = None,
    *,
    simulated: Record | Simulator | None = None,
    simulated_holdout: Record | None = None,
    judge: Record | None = None,
    tolerance: float = TOLERANCE,
    rules: Rules | None = None,
    extra: Sequence[Term] = (),
    without: Sequence[str] = (),
    links: Sequence[Link | None] = (),
    progress: Progress | None = None,
) -> Diagnosis:
    """Say where a simulation parts from a record, which effect it lacks, and how far that closes.

    Parameters
    ----------
    record : Record
        Measured on the axis; with a reference.
    loop : ClosedLoop
        The model that is meant to be its twin.
    holdout : Record, optional
        Another record of the same axis, which judges. Without it, stretches of the record judge
        each other, which is weaker: an effect that drifts from record to record cannot show. It
        takes part in the choice of effects, so its figures are a little too good.
    simulated, simulated_holdout : Record, optional
        What a simulator of your own did on the reference of the record, and of the holdout. Then
        the question is what *it* lacks, and `Diagnosis.changes` says what to change in it. Instead
        of the logs a `Simulator` may be given: it is run on both references, and once more with the
        changes, where it can; `Diagnosis.confirmed` has the errors.
    judge : Record, optional
        A third record of the same axis that takes part in nothing: its figures are clean.
    tolerance : float
        Per cent of the force below which a gap is negligible.
    rules : Rules, optional
        What a name takes.
    extra : sequence of Term
        Effects of your own that take part.
    without : sequence of str
        Effects to leave out of the library.
    links : sequence of Link or None
        Of the record, the holdout and the judge, where the axis is a joint of a robot.
    progress : callable, optional
        Called with a line of text at each stage.

    Returns
    -------
    Diagnosis

    Raises
    ------
    RecordError
        If a record has no reference, or several joints.

    Examples
    --------
    >>> import ivtools as iv
    >>> gap = iv.diagnose(iv.datasets.twin(), iv.axes.emps())
    >>> gap.effects
    ('asymmetric-viscous',)
    """

    def found(
        one: Record,
        other: Record | None,
        loop: ClosedLoop = loop,
        named: bool = True,
        described: bool = True,
    ) -> Diagnosis:
        third = judge if simulated is None else None  # of the axis itself, not of a difference
        whole = simulated is not None
        more = (tolerance, tuple(extra), tuple(without), tuple(links), whole, described)
        task = _Task(one, loop, other, third, *more)
        kept = rules or Rules()
        return _diagnose(task, kept if named else replace(kept, most=0), progress or _mute)

    with _one_blas_thread():
        if simulated is None:
            return found(record, holdout)
        if not isinstance(simulated, Simulator):
            return against(record, loop, holdout, simulated, simulated_holdout, found)
        if simulated_holdout is not None:
            raise RecordError(
                "simulated is a simulator, which is run on the holdout as well; "
                "leave simulated_holdout out"
            )
        other = None if holdout is None else run(simulated, holdout)
        lacks = against(record, loop, holdout, run(simulated, record), other, found)
        return replace(lacks, confirmed=confirm(lacks, simulated, holdout or record))


_Folds = tuple[tuple[Side, ...], tuple[Fit, ...]]


class _Task(NamedTuple):
    """What a diagnosis is asked."""

    record: Record
    loop: ClosedLoop
    holdout: Record | None
    judge: Record | None
    tolerance: float
    extra: tuple[Term, ...]
    without: tuple[str, ...]
    links: tuple[Link | None, ...] = ()
    whole: bool = False  # whether the final model is fitted to all of the record
    described: bool = True  # whether a force without a name is described
    places: Mapping[str, Mapping[str, float]] = {}  # where valleys are known to be


_CALM, _RUNNING = Lock(), ExitStack()
_DEPTH = [0]


@contextmanager
def _one_blas_thread() -> Iterator[None]:
    """Give BLAS one thread for as long as any diagnosis of this process runs.

    For many small products, threads of its own only wait, and sums in another order round
    otherwise. The limit is the process's: the first diagnosis sets it, and the last one lifts it.
    """
    share_heap()
    with _CALM:
        if _DEPTH[0] == 0:
            _RUNNING.enter_context(threadpool_limits(1, "blas"))
        _DEPTH[0] += 1
    try:
        yield
    finally:
        with _CALM:
            _DEPTH[0] -= 1
            if _DEPTH[0] == 0:
                _RUNNING.close()


def _mute(text: str) -> None:
    """Show no progress."""


def _followed(task: _Task) -> tuple[_Task, ClosedLoop, list[Finding]]:
    """Return the task with positions to follow, the loop that follows them, and what to say."""
    known = task.loop.known(task.record)
    record, note = preflight.followed(task.record, known)

    def other(one: Record | None) -> Record | None:
        return None if one is None else preflight.followed(one, known)[0]

    task = task._replace(record=record, holdout=other(task.holdout), judge=other(task.judge))
    return task, known, note


def _bounded(task: _Task, samples: int) -> tuple[_Task, list[Finding]]:
    """Return the task with one stretch of each record, not too long, and what to say of that."""
    told = []
    for name in ("record", "holdout", "judge"):
        one = getattr(task, name)
        if one is None:
            continue
        if one.breaks:
            told.append(
                f"{one.name} has {len(one.parts)} stretches: the longest, "
                f"{one.longest.n_samples} samples, is diagnosed"
            )
        part = one.longest.liveliest(samples)
        if part.n_samples < one.longest.n_samples:
            told.append(
                f"{one.name} has {one.longest.n_samples} samples: the {part.n_samples} in which "
                f"it moves most, from {part.t[0]:.6g} to {part.t[-1]:.6g} s, are diagnosed"
            )
        task = task._replace(**{name: part})
    return task, [Finding(line, fatal=False) for line in told]


def _diagnose(task: _Task, rules: Rules, say: Progress) -> Diagnosis:
    begun = _begun(task, rules, say)
    return begun if isinstance(begun, Diagnosis) else _finished(begun, say)


@dataclass(frozen=True, eq=False)
class Begun:
    """A diagnosis whose base model is fitted, and nothing named yet."""

    task: _Task
    loop: ClosedLoop
    measured: tuple[Measured, ...]
    third: Measured | None
    rules: Rules
    found: list[Finding]

    @cached_property
    def whole(self) -> _Folds:
        """The folds that are judged."""
        return folds(self.measured)

    @cached_property
    def calm(self) -> tuple[Measured, ...]:
        """The records without the stretches that stand out, or as they are."""
        return tuple(masked(m) for m in self.measured)

    @cached_property
    def quiet(self) -> _Folds:
        """Their folds."""
        stands_out = any(m.floor.isolated for m in self.measured)
        return folds(self.calm) if stands_out else self.whole

    @cached_property
    def attributed(self) -> tuple[Fold, Attribution]:
        """What is named, and the fold on which the gap is quantified."""
        return _attributed(self)

    @property
    def places(self) -> dict[str, dict[str, float]]:
        """Where the valleys of effects were found, if one of them got a name."""
        result = self.attributed[1]
        tried = [t for t in result.trials if t.term.search == "valleys" and t.gain > 0.0]
        if not any(t.name in result.named for t in tried):
            return {}
        return {t.name: of_effect(t.fits[0].values, t.name) for t in tried}

    @property
    def left(self) -> float:
        """Whitened energy that the base model leaves where both records have been, their mean."""
        return cost(common(self.quiet[1]))

    @property
    def floors(self) -> tuple[Floor, ...]:
        """Floor of each record."""
        return tuple(m.floor for m in self.measured)


def begin(
    record: Record,
    loop: ClosedLoop,
    holdout: Record | None = None,
    *,
    judge: Record | None = None,
    tolerance: float = TOLERANCE,
    rules: Rules | None = None,
    extra: Sequence[Term] = (),
    without: Sequence[str] = (),
    links: Sequence[Link | None] = (),
    places: Mapping[str, Mapping[str, float]] | None = None,
    progress: Progress | None = None,
) -> Begun | Diagnosis:
    """Begin a diagnosis, as `diagnose` does; return it all where the input is refused.

    Where a search begins in a valley of known `places`, it ends there.
    """
    more = (tolerance, tuple(extra), tuple(without), tuple(links), False, True, places or {})
    with _one_blas_thread():
        return _begun(
            _Task(record, loop, holdout, judge, *more), rules or Rules(), progress or _mute
        )


def finish(begun: Begun | Diagnosis, progress: Progress | None = None) -> Diagnosis:
    """Finish a diagnosis that was begun."""
    if isinstance(begun, Diagnosis):
        return begun
    with _one_blas_thread():
        return _finished(begun, progress or _mute)


def _begun(task: _Task, rules: Rules, say: Progress) -> Begun | Diagnosis:
    for one in (r for r in (task.record, task.holdout, task.judge) if r is not None):
        preflight.require(one)
    say("controller parity")
    task, parts = _bounded(task, rules.samples)
    if preflight.lawless(task.record, task.loop):
        text = "no reference is in the record, so no control law can be read from it; for the "
        remedy = 'force over the motion alone write [controller] kind = "none"'
        return _refused(task.record, task.loop, (), [Finding(text + remedy), *parts])
    law = preflight.identified(task.record, task.loop)
    task, loop, note = _followed(task)
    record, holdout, law = task.record, task.holdout, [*law, *note, *parts]
    records: tuple[Record, ...] = (record,) if holdout is None else (record, holdout)
    checked = tuple(parity.check(one, loop) for one in records)
    found = _inspected(records, loop, checked)
    if any(f.fatal for f in found):
        return _refused(record, loop, checked, [*found, *law])
    say("base model and floor")
    try:
        links = [*task.links, *[None] * 3]
        ready = [
            prepared(r, p, records)._replace(link=link)
            for r, p, link in zip(records, checked, links, strict=False)
        ]
        third = None if task.judge is None else _judging(task.judge, loop, records, links[2])
        loop = _alike(preflight.told_apart(records, loop), ready[0])
        measured = _confirmed(loop, _measured(ready))
    except IVToolsError as error:
        return _refused(record, loop, checked, [*found, Finding(str(error)), *law])
    if holdout is not None:
        found += preflight.same_axis([m.base for m in measured])
        level = floor.between(*(m.base for m in measured))
        measured = tuple(replace(m, floor=replace(m.floor, between=level)) for m in measured)
    if any(f.fatal for f in found):
        return _refused(record, loop, checked, [*found, *law])
    if any(p.clipped > SATURATED for p in checked):
        rules = replace(rules, most=0)  # an open loop: its command names nothing behind it
    measured = tuple(replace(m, side=replace(m.side, places=task.places)) for m in measured)
    return Begun(task, loop, measured, third, rules, [*found, *law])


def _finished(begun: Begun, say: Progress) -> Diagnosis:
    say("screening and fitting the effects")
    fold, result = begun.attributed
    say("where and how far")
    return _answer(begun, result, fold)


def _inspected(
    records: Sequence[Record], loop: ClosedLoop, checked: Sequence[Parity]
) -> list[Finding]:
    """Return what is wrong with the records, or worth a word, by the record's name."""
    seen = [preflight.inspect(r, loop, p) for r, p in zip(records, checked, strict=True)]
    if len(records) == 1:
        return seen[0]
    named = [preflight.named(s, r) for s, r in zip(seen, records, strict=True)]
    return [*named[0], *named[1], *preflight.overlap(*records)]


def _judging(
    judge: Record, loop: ClosedLoop, records: Sequence[Record], link: Link | None
) -> Measured:
    """Return the record that takes part in nothing, measured as the others are."""
    ready = prepared(judge, parity.check(judge, loop), records)
    return measure(ready._replace(link=link))


def _alike(loop: ClosedLoop, one: Ready) -> ClosedLoop:
    """Return the declared loop as it can be compared with a record's: pulled, where that is."""
    return loop if not one.driven else replace(loop, controller=one.loop.controller)


def _measured(ready: Sequence[Ready]) -> tuple[Measured, ...]:
    return tuple(threaded(measure, ready))


def _confirmed(loop: ClosedLoop, measured: tuple[Measured, ...]) -> tuple[Measured, ...]:
    """Take back a correction of the controller that does not lower the force error.

    A model that is driven by the recorded command knows no controller.
    """
    kept = []
    for m in measured:
        p = m.parity
        if (
            p.mismatch
            and not m.driven
            and quantify.declared(loop, (m,)).force_rms <= m.base.force_rms
        ):
            plain = replace(m.base.loop, controller=replace(loop.controller, delay=p.delay))
            p = replace(p, loop=plain, mismatch={}, tvalues={}, after=p.before, taken=False)
            again = Ready(_as_recorded(m), plain, p, m.fold.place, link=m.fold.link)
            m = measure(again)
        kept.append(m)
    return tuple(kept)


def _as_recorded(m: Measured) -> Record:
    """Return the record with its added input as it was logged."""
    record, extra = m.fold.record, m.parity.mismatch.get("added", 0.0)
    return record if record.added is None else replace(record, added=record.added / (1.0 + extra))


def _answer(begun: Begun, result: Attribution, fold: Fold) -> Diagnosis:
    """Put the diagnosis together."""
    task, loop, measured, rules = begun.task, begun.loop, begun.measured, begun.rules
    checked, held_out = tuple(m.parity for m in measured), task.holdout is not None
    (at_controller, values), declared = parity.effects(checked), loop.controller.delay
    lowered = _lowered(loop, measured, result, fold, at_controller, held_out)
    effects, result, shrink, traces, said = lowered
    if begun.third is not None:
        shrink = replace(shrink, judged=quantify.judge(loop, begun.third, result))
    before, after = cost(result.base), cost(result.held)
    tell = task.described and after > DESCRIBED
    left = discrepancy.describe(common(result.held), result.laws) if tell else None
    repeats = 0.0 if left is None else left.gain * after / max(after - 1.0, 1e-9)
    changed = verdict.changes(result, task.tolerance) if repeats < REPEATS else {}
    word = verdict.decide(effects, measured, result, shrink, changed, repeats, task.tolerance)
    nameless = word == "unexplained" and tell and left is None
    outside = nameless and shrink.after > OVER_FLOOR * shrink.floor
    return Diagnosis(
        verdict=word,
        effects=effects,
        ambiguous_with={e: result.ambiguous.get(e, []) for e in effects},
        parameters={e: v for e, v in {**values, **result.parameters}.items() if e in effects},
        block=locate.block(
            effects,
            controller=any(p.delay != declared for p in checked),
            events=any(m.floor.isolated for m in measured),
            gap=word != "adequate",
            outside=outside,
        ),
        regions=locate.regions(fold.record, fold.keep, traces.before, traces.after),
        shrink=shrink,
        ranking=verdict.ranking(result, rules, max(before - 1.0, 1e-9)),
        advice=(*advice.motions(result), *advice.remarks(loop, measured, result, held_out)),
        findings=(*begun.found, *said, *([verdict.outside()] if outside else [])),
        parity=checked,
        floors=tuple(m.floor for m in measured),
        loop=result.fits[0].loop,
        theta=result.fits[0].values,
        chi=(before, after),
        name=task.record.name,
        replication=result.replication,
        replicas=verdict.replicate(effects, result, checked, rules),
        evidence=result.evidence,
        probability=dict.fromkeys(at_controller, AT_CONTROLLER)
        | {n: probability(proof) for n, proof in result.evidence.items()},
        traces=traces,
        changed=changed,
        discrepancy=left,
        tolerance=task.tolerance,
        whole=_whole(measured[0], result) if task.whole else None,
        alternatives=result.alternatives if task.whole else (),
        supposed=None if effects else result.supposed,
    )


class _Lowered(NamedTuple):
    """What is named, how far the gap shrinks with it, and what is to be said of names that fell."""

    effects: tuple[str, ...]
    result: Attribution
    shrink: quantify.Shrink
    traces: quantify.Traces
    said: tuple[Finding, ...] = ()


def _lowered(
    loop: ClosedLoop,
    measured: tuple[Measured, ...],
    result: Attribution,
    fold: Fold,
    at_controller: Sequence[str],
    held_out: bool,
) -> _Lowered:
    """Return the names that lower the force error; if they do not, none."""
    plain, effects = quantify.declared(loop, measured), (*at_controller, *result.named)
    shrink, traces = quantify.how_far(plain, measured, result, fold, held_out)
    tried = result.named if measured[-1].driven else effects  # its controller changes nothing
    removed = cost(result.base) - cost(result.held)
    if not tried or verdict.lowers(shrink, not at_controller, removed):
        return _Lowered(effects, result, shrink, traces)
    nothing = replace(result, fits=result.base, held=result.base, named=())
    again = quantify.how_far(plain, measured, nothing, fold, held_out)
    return _Lowered((), nothing, *again, (verdict.no_better(effects, shrink),))


def _whole(m: Measured, result: Attribution) -> Fit:
    """Return the final model, fitted to all that counts of the first record."""
    fit, fold = result.fits[0], masked(m).fold
    step = steps(fold, fit.loop, m.side.scales)
    return gauss_newton(fold, fit.loop, fit.values, fit.free, step)


def _attributed(begun: Begun) -> tuple[Fold, Attribution]:
    """Attribute; if nothing is named, once more without the stretches that stand out.

    Returns the fold on which the gap is quantified as well.
    """
    measured, (sides, base), asked = begun.measured, begun.whole, begun.task
    more = (begun.rules, asked.extra, asked.without)
    result = attribute(sides, base, *more)
    if not result.named and any(m.floor.isolated for m in measured):
        measured, whole = begun.calm, (sides, base)
        sides, base = begun.quiet
        again = upheld(*whole, attribute(sides, base, *more))
        result = replace(again, supposed=again.supposed or result.supposed)
    return (measured if len(measured) == 2 else sides)[-1].fold, result


def _refused(
    record: Record, loop: ClosedLoop, checked: tuple[Parity, ...], found: list[Finding]
) -> Diagnosis:
    """Report what is wrong with the input instead of naming an effect simulated.

    Without a control law gravity shows all the same.
    """
    controller = any(not p.trustworthy for p in checked)
    own = hanging(record, loop) if controller or not checked else None
    if own is not None:
        found = [*found, Finding(own.text, fatal=False)]
        loop = loop.with_terms(*(t.name for t in loop.terms), "gravity")
    return Diagnosis(
        verdict="unexplained" if own is None else "partial",
        effects=() if own is None else ("gravity",),
        ambiguous_with={} if own is None else {"gravity": []},
        parameters={} if own is None else {"gravity": {"sin": own.sin, "cos": own.cos}},
        block="controller" if controller else None if own is None else "mechanics",
        regions=(),
        shrink=None,
        ranking=(),
        advice=(),
        findings=tuple(found),
        parity=checked,
        floors=(),
        loop=loop,
        theta={},
        chi=(float("nan"), float("nan")),
        name=record.name,
    )
