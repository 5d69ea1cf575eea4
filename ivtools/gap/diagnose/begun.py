"""Begun: base model and floor of a diagnosis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from ...errors import IVToolsError
from ...loop import ClosedLoop
from ...record import Record
from ...workers import one_blas_thread, threaded
from .. import floor, parity, preflight, quantify
from ..diagnosis import Diagnosis
from ..fit import Fit, common, cost
from ..floor import Measured, Ready, audible, beside_silent, masked, measure, prepared
from ..parity import Parity
from ..preflight import Finding
from ..rules import HARDLY_ANY, MOST, PARITY_POOR, SATURATED, TOLERANCE, Rules
from .input import Input, bounded, readied
from .refused import refused
from .task import Inspected, Say, Task, mute


@dataclass(frozen=True, eq=False)
class Begun:
    """A diagnosis whose base model is fitted, and nothing named yet.

    Parameters
    ----------
    task : Task
    loop : ClosedLoop
    measured : tuple of Measured
    third : Measured, optional
        The judge.
    rules : Rules
    found : list of Finding
    inspected : Inspected
    strangers : tuple of Finding
        What the records say against being of one axis, unless a second mass explains it: a record
        that is faster than that one swings shows the inertia of the drive alone.
    """

    task: Task
    loop: ClosedLoop
    measured: tuple[Measured, ...]
    third: Measured | None
    rules: Rules
    found: list[Finding]
    inspected: Inspected
    strangers: tuple[Finding, ...] = ()

    @property
    def eventful(self) -> bool:
        """Whether stretches stand out."""
        return any(m.floor.isolated for m in self.measured)

    @cached_property
    def folds(self) -> tuple[Fit, ...]:
        """The base model on two folds."""
        return floor.folds(self.measured)

    @cached_property
    def calm(self) -> tuple[Measured, ...]:
        """The records without the stretches that stand out, or as they are."""
        return tuple(masked(m) for m in self.measured)

    @cached_property
    def calm_folds(self) -> tuple[Fit, ...]:
        """The same of those."""
        return floor.folds(self.calm) if self.eventful else self.folds

    @property
    def left(self) -> float:
        """Whitened energy that the base model leaves where both records have been, their mean."""
        return cost(common(self.calm_folds))


@one_blas_thread()
def begin(task: Task, progress: Say | None = None) -> Begun | Diagnosis:
    """Fit the base model and measure the floor; return the diagnosis if the input is refused."""
    say = progress or mute
    if not 0.0 <= task.tolerance < math.inf:
        asked = f"a tolerance of {task.tolerance} % of the force"
        raise IVToolsError(f"{asked} tells nothing; give a number, 0 or more")
    for one in task.given.values():
        preflight.require(one)
    now = bounded(task)
    if preflight.lawless(now.task.record, task.loop):
        text = "no reference is in the record, so no control law can be read from it; for the "
        remedy = 'force over the motion alone write [controller] kind = "none"'
        return refused(now.task.record, task.loop, (), [Finding(text + remedy), *now.said])
    say("controller parity")
    now = readied(now)
    known = task.inspected
    inspected = _inspected(now) if known is None else known.under(now.loop)
    found = list(inspected.found)
    if not any(f.fatal for f in found):
        say("base model and floor")
        try:
            loop, every = _measured(now, inspected, found)
        except IVToolsError as error:
            found.append(Finding(str(error)))
        else:
            return _begun(now, inspected, found, loop, every)
    found += [*_shown(now, inspected.checked, inspected.checked), *now.said]
    checked = inspected.checked[: len(now.task.records)]
    return refused(now.task.record, now.loop, checked, found)


def _measured(
    now: Input, inspected: Inspected, found: list[Finding]
) -> tuple[ClosedLoop, tuple[Measured, ...]]:
    """Fit the base model to each record, and measure its floor; add to what is found."""
    task, records = now.task, now.task.records
    links = task.links or [None] * len(now.records)
    ready = [
        prepared(one, p, records)._replace(link=link)
        for one, p, link in zip(now.records, inspected.checked, links, strict=True)
    ]
    if now.loop.controller.kind != "none" and any(r.driven for r in ready):
        found.append(preflight.HELD)
    loop = preflight.identifiable(records, now.loop)
    if ready[0].driven:  # compared as it is pulled to its motion
        loop = replace(loop, controller=ready[0].loop.controller)
    every = tuple(threaded(measure, ready))
    return loop, (*_confirmed(loop, every[: len(records)]), *every[len(records) :])


def _begun(
    now: Input,
    inspected: Inspected,
    found: list[Finding],
    loop: ClosedLoop,
    every: tuple[Measured, ...],
) -> Begun:
    """Compare the records with each other."""
    task, rules, count = now.task, now.task.rules, len(now.task.records)
    measured = every[:count]
    shown = _shown(now, inspected.checked, [m.parity for m in measured])
    if any(p.clipped > SATURATED for p in inspected.checked[:count]):
        rules = replace(rules, most=0)  # the gap tells nothing of the axis
    fine = min(task.tolerance, TOLERANCE)  # above the default it changes the words only
    rules = replace(rules, worth=rules.worth * fine / TOLERANCE)
    least = MOST * fine / 100.0
    strangers: tuple[Finding, ...] = ()
    if count == 2:
        strangers = tuple(preflight.same_axis([m.base for m in measured]))
        level = floor.between(*(m.base for m in measured))
        measured = tuple(replace(m, floor=replace(m.floor, between=level)) for m in measured)
    measured = tuple(audible(m, least) for m in measured)
    if count == 2:
        a, b = measured
        measured = beside_silent(a, b, least), beside_silent(b, a, least)
    third = None if task.judge is None else every[-1]
    found = [*found, *shown, *now.said]
    return Begun(task, loop, measured, third, rules, found, inspected, strangers)


def _inspected(now: Input) -> Inspected:
    """Return what is wrong with the records, or worth a word, by the record's name."""
    task, loop, records = now.task, now.loop, now.records
    identified = task.loop.controller.kind == "identify"

    def known(record: Record, p: Parity) -> Parity:
        """Ask the record for its own law where it has another one.

        What a law leaves that was read from one may be a little more, on that one as well: where
        that is noisy the law was read below some frequency. So may that of a record whose reference
        is not the logged one.
        """
        inexact = identified or record.name in now.inexact
        poor = p.after > PARITY_POOR and p.below is None and p.oversampling == 1
        doubted = poor if inexact else parity.doubted(record, p)
        return parity.check(record, loop, oversampling=1) if doubted else p

    checked = tuple(threaded(known, records, now.compared))
    found = preflight.by_record(
        records, threaded(lambda r, p: preflight.inspect(r, loop, p), records, checked)
    )
    if task.holdout is not None:
        found += preflight.overlap(task.record, task.holdout)
    if task.judge is not None:
        found += [f for r in task.records for f in preflight.overlap(r, task.judge, "judge")]
    if identified:  # no axis file has it wrong
        checked = tuple(map(parity.as_read, checked))
    return Inspected(checked, tuple(found))


def _shown(now: Input, found: Sequence[Parity], kept: Sequence[Parity]) -> list[Finding]:
    """Return what is said of other laws that records show, taken or not."""
    task = now.task
    read = task.record.name if task.loop.controller.kind == "identify" else ""
    pairs = zip(found, kept, strict=False)
    same = [(p, (k.taken, k.mismatch) == (p.taken, p.mismatch)) for p, k in pairs]
    said = [preflight.other_law(p, kept, read) for p, kept in same]
    return preflight.by_record(now.records, said)


def _confirmed(loop: ClosedLoop, measured: tuple[Measured, ...]) -> tuple[Measured, ...]:
    """Take back a correction of the controller that hardly lowers the force error.

    By an energy that is nothing beside the noise: beside a large gap the noise counts, not the gap.
    A model that is driven by the recorded command knows no controller.
    """
    kept = []
    for m in measured:
        p = m.parity
        least = m.base.force_rms**2 + HARDLY_ANY * m.floor.noise**2
        corrected = (p.mismatch or p.taken) and not m.driven
        shown = p.loop.controller
        given = replace(loop, controller=replace(loop.controller, limit=shown.limit))
        if corrected and quantify.declared(given, m, m.fold).force_rms ** 2 <= least:
            declared = replace(loop.controller, delay=shown.delay, limit=shown.limit)
            plain = replace(m.base.loop, controller=declared)
            p = replace(p, loop=plain, mismatch={}, after=p.before, taken=False)
            again = Ready(m.logged, plain, p, m.fold.place, link=m.fold.link)
            m = measure(again)
        kept.append(m)
    return tuple(kept)
