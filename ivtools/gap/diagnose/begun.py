"""Begun: base model and floor of a diagnosis."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from ...errors import IVToolsError
from ...loop import ClosedLoop
from ...physics import Term
from ...record import Record
from ...workers import one_blas_thread, threaded
from .. import floor, parity, preflight, quantify
from ..diagnosis import Diagnosis
from ..fit import Fit, common, cost
from ..floor import (
    Measured,
    Ready,
    audible,
    beside_silent,
    fitted,
    masked,
    measure,
    prepared,
)
from ..fold import Link
from ..parity import Parity
from ..preflight import Finding
from ..rules import AUDIBLE, FAINT, SATURATED, TOLERANCE, Rules
from .refused import refused


class Inspected(NamedTuple):
    """What records and their control law show, whatever loads the axis.

    Attributes
    ----------
    checked : tuple of Parity
        Of each record that is given.
    found : tuple of Finding
    """

    checked: tuple[Parity, ...]
    found: tuple[Finding, ...]

    def under(self, loop: ClosedLoop) -> Inspected:
        """Return the same of another model of the axis, with that law."""
        laws = (replace(loop, controller=p.loop.controller) for p in self.checked)
        pairs = zip(self.checked, laws, strict=True)
        return self._replace(checked=tuple(replace(p, loop=law) for p, law in pairs))


Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Task:
    """What a diagnosis is asked: as for `diagnose`, and what its callers inside the toolkit add.

    Parameters
    ----------
    whole : bool, optional
        Whether the final model is fitted to all of the record.
    described : bool, optional
        Whether a force without a name is described.
    links : sequence of Link or None, optional
        What the links of a robot leave unknown of the load, of each record that is given.
    places : mapping of str to mapping, optional
        Where valleys of an effect are known to be: a search that begins in one ends there.
    inspected : Inspected, optional
        What another diagnosis of the same records found, under other loads.
    """

    record: Record
    loop: ClosedLoop
    holdout: Record | None = None
    judge: Record | None = None
    tolerance: float = TOLERANCE
    rules: Rules | None = None
    extra: Sequence[Term] = ()
    without: Sequence[str] = ()
    links: Sequence[Link | None] = ()
    whole: bool = False
    described: bool = True
    places: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    inspected: Inspected | None = None

    @property
    def records(self) -> tuple[Record, ...]:
        """The record, and the holdout if there is one."""
        return (self.record,) if self.holdout is None else (self.record, self.holdout)

    def with_records(self, changed: Mapping[str, Any]) -> Task:
        """Return it with other records, by the names of their attributes."""
        return replace(self, **changed)

    @property
    def given(self) -> dict[str, Any]:
        """Every record that there is, by the name of its attribute."""
        named = {"record": self.record, "holdout": self.holdout, "judge": self.judge}
        return {role: one for role, one in named.items() if one is not None}


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
def begin(task: Task, progress: Progress | None = None) -> Begun | Diagnosis:
    """Fit the base model and measure the floor; return the diagnosis if the input is refused."""
    say = progress or mute
    if not 0.0 <= task.tolerance < math.inf:
        asked = f"a tolerance of {task.tolerance} % of the force"
        raise IVToolsError(f"{asked} tells nothing; give a number, 0 or more")
    for one in task.given.values():
        preflight.require(one)
    say("controller parity")
    rules = task.rules or Rules()
    fine = min(task.tolerance, TOLERANCE)  # above the default it changes the words only
    rules = replace(rules, worth=rules.worth * fine / TOLERANCE)
    task, parts = _bounded(task, rules.samples)
    if preflight.lawless(task.record, task.loop):
        text = "no reference is in the record, so no control law can be read from it; for the "
        remedy = 'force over the motion alone write [controller] kind = "none"'
        return refused(task.record, task.loop, (), [Finding(text + remedy), *parts])
    task, near = _near(task)
    task, rounded = _finer(task)
    law = preflight.identified(task.record, task.loop)
    task, loop, note = _followed(task)
    task, alone = _both_ways(task, loop)
    if task.inspected is None:
        task, loop, compared, logged = _as_it_acted(task, loop)
        inspected = _inspected(task, loop, compared)
    else:
        inspected, logged = task.inspected.under(loop), []
    record, records, given = task.record, task.records, task.given.values()
    checked, found = inspected.checked[: len(records)], list(inspected.found)
    law = [*near, *rounded, *law, *note, *alone, *logged, *parts]
    shown = _shown(task, inspected.checked, inspected.checked)
    if any(f.fatal for f in found):
        return refused(record, loop, checked, [*found, *shown, *law])
    say("base model and floor")
    try:
        unlinked = [None] * len(given)
        ready = [
            prepared(r, p, records)._replace(link=link)
            for r, p, link in zip(given, inspected.checked, task.links or unlinked, strict=True)
        ]
        if loop.controller.kind != "none" and any(r.driven for r in ready):
            found.append(preflight.HELD)
        loop = _comparable(preflight.identifiable(records, loop), ready[0])
        every = tuple(threaded(measure, ready))
        measured = _confirmed(loop, every[: len(records)])
    except IVToolsError as error:
        return refused(record, loop, checked, [*found, *shown, Finding(str(error)), *law])
    law = [*_shown(task, inspected.checked, [m.parity for m in measured]), *law]
    strangers: tuple[Finding, ...] = ()
    if len(records) == 2:
        strangers = tuple(preflight.same_axis([m.base for m in measured]))
        level = floor.between(*(m.base for m in measured))
        measured = tuple(replace(m, floor=replace(m.floor, between=level)) for m in measured)
    if any(p.clipped > SATURATED for p in checked):  # the gap tells nothing of the axis
        rules = replace(rules, most=0)
    least = AUDIBLE * fine / 100.0
    measured = tuple(audible(m, least) for m in measured)
    if len(records) == 2:
        a, b = measured
        measured = beside_silent(a, b, least), beside_silent(b, a, least)
    third = None if task.judge is None else every[-1]
    return Begun(task, loop, measured, third, rules, [*found, *law], inspected, strangers)


def mute(text: str) -> None:
    """Show no progress."""


def _near(task: Task) -> tuple[Task, list[Finding]]:
    """Return the task with positions that are counted from near, and what to say.

    A robot's have their origin from its links, and a simulator that is run asks for its own.
    """
    if task.links or task.whole:
        return task, []
    origin = preflight.origin(task.record, (*task.loop.terms, *task.extra), task.loop)
    if not origin:
        return task, []
    counted = {role: preflight.counted(one, origin) for role, one in task.given.items()}
    return task.with_records(counted), [preflight.near(origin, task.loop)]


def _finer(task: Task) -> tuple[Task, list[Finding]]:
    """Return the task with references as the controller had them, and what to say."""
    found = []
    for role, one in task.given.items():
        finer, said = preflight.finer(one, task.loop)
        found += preflight.named(said, one)
        task = task.with_records({role: finer})
    return task, found


def _followed(task: Task) -> tuple[Task, ClosedLoop, list[Finding]]:
    """Return the task with positions to follow, the loop that follows them, and what to say."""
    known = task.loop.known(task.record)
    followed = {role: preflight.followed(one, known) for role, one in task.given.items()}
    note = followed["record"][1]
    return task.with_records({role: one for role, (one, _) in followed.items()}), known, note


def _compared(task: Task, loop: ClosedLoop) -> list[Parity]:
    """Return how the declared law compares with each record, at the rate of its controller."""
    given = list(task.given.values())
    rate = parity.at_rate(task.loop)
    checked = threaded(lambda one: parity.check(one, loop, False, rate), given)
    fast = [p for p in checked if p.oversampling > 1]
    if not fast:
        return checked
    rate = min(fast, key=lambda p: p.after).oversampling  # noise hides it in the others
    pairs = zip(given, checked, strict=True)
    return [p if p.oversampling == rate else parity.check(r, loop, False, rate) for r, p in pairs]


def _derived(task: Task, loop: ClosedLoop) -> tuple[ClosedLoop, list[Parity], list[Finding]]:
    """Return the loop that derives its reference as records show, how it compares, what to say."""
    compared = _compared(task, loop)
    again = parity.otherwise_derived(task.record, loop, compared, partial(_compared, task))
    if not again:
        return loop, compared, []
    other = replace(loop, controller=again[0].declared)
    before, after = (max(p.after for p in each) for each in (compared, again))
    return other, again, [preflight.derived(other.controller, before, after)]


def _as_it_acted(
    task: Task, loop: ClosedLoop
) -> tuple[Task, ClosedLoop, list[Parity], list[Finding]]:
    """Return the task and the loop as the controller acted, how they compare, and what to say.

    Joints of a robot have one log, and one controller.
    """
    loop, compared, said = _derived(task, loop)
    rate = max(p.oversampling for p in compared)
    said += [preflight.faster(rate)] if rate > 1 else []
    beyond = loop.controller.filter
    if rate == 1 and beyond is not None and not beyond.fits(task.record.dt):
        loop = replace(loop, controller=loop.controller.shown(task.record.dt))
        said += [preflight.beyond_the_log(beyond.hz, task.record.sampling_hz)]
    if rate > 1 or task.links or loop.controller.kind == "none":
        return task, loop, compared, said
    task, compared, put = _in_place(task, loop, compared)
    task, loop, compared, limited = _at_limit(task, loop, compared)
    task, compared, late = _on_time(task, loop, compared)
    return task, loop, compared, [*said, *put, *limited, *late]


def _in_place(
    task: Task, loop: ClosedLoop, checked: list[Parity]
) -> tuple[Task, list[Parity], list[Finding]]:
    """Return the task with references where the control law takes them, and what to say.

    And how the law compares with each record then.
    """
    roles, given = zip(*task.given.items(), strict=True)
    moved = [preflight.misplaced(one, loop, p) for one, p in zip(given, checked, strict=True)]
    if not any(moved):
        return task, checked, []
    known = min(filter(None, moved), key=lambda one: one.checked.after).samples
    found, said = list(checked), []
    for k, (role, one) in enumerate(zip(roles, given, strict=True)):
        if own := moved[k] or preflight.misplaced(one, loop, checked[k], known):
            task, found[k] = task.with_records({role: own.record}), own.checked
            text = preflight.elsewhere(own.samples, checked[k].after, own.checked.after)
            said += preflight.named([text], one)
    return task, found, said


def _at_limit(
    task: Task, loop: ClosedLoop, compared: list[Parity]
) -> tuple[Task, ClosedLoop, list[Parity], list[Finding]]:
    """Return the task and the loop as the records show their command limited, and what to say."""
    roles, given = zip(*task.given.items(), strict=True)
    records, other, checked = parity.at_limit(given, loop, compared)
    if other is loop:
        return task, loop, compared, []
    before, after = (max(p.after for p in each) for each in (compared, checked))
    said = preflight.limited(loop.controller, other.controller, before, after)
    return task.with_records(dict(zip(roles, records, strict=True))), other, checked, [said]


def _on_time(
    task: Task, loop: ClosedLoop, checked: list[Parity]
) -> tuple[Task, list[Parity], list[Finding]]:
    """Return the task with commands as they acted where the log has them late, and what to say.

    Between them how the law compares with each record then.

    A command that follows the position by other samples than the axis file says was given at
    another time, or logged at another time: the simulated loop tells, for only the first turns its
    phase. Logged it is if the base model leaves less then (training: all but one of 147 logs that
    are late or early do, and one of 40 whose axis file has another delay).
    """
    roles, given = zip(*task.given.items(), strict=True)
    said: list[Finding] = []
    late = threaded(preflight.lateness, given, [loop] * len(given), checked)
    for samples in sorted({one.samples for one in late if one}):
        moved = {k: one for k, one in enumerate(late) if one and one.samples == samples}
        acted = [(one.record, one.checked) for one in moved.values()]
        if any(f.fatal for one, p in acted for f in preflight.inspect(one, loop, p)):
            continue
        logged = [(given[k], checked[k]) for k in moved]
        with suppress(IVToolsError):  # which the diagnosis will say
            left = _left(acted, task.records) / _left(logged, task.records)
            if left < 1.0:
                task = task.with_records({roles[k]: one.record for k, one in moved.items()})
                checked = [moved[k].checked if k in moved else p for k, p in enumerate(checked)]
                text = preflight.late(samples, left)
                said += [f for one, _ in logged for f in preflight.named([text], one)]
    return task, checked, said


def _left(compared: Sequence[tuple[Record, Parity]], records: Sequence[Record]) -> float:
    """Return what the base model leaves of the force of some records, rms of all."""
    ready = [prepared(one, checked, records) for one, checked in compared]
    return float(np.linalg.norm([f.fit.force_rms for f in threaded(fitted, ready)]))


def _both_ways(task: Task, loop: ClosedLoop) -> tuple[Task, list[Finding]]:
    """Return the task without a record that moves in one direction only, and what to say of that.

    The model would lack on the other one what such a record cannot tell from Coulomb friction.
    """
    oneway = [preflight.one_way(r) for r in task.records]
    lost = {*loop.names} - {*preflight.identifiable(task.records, loop).names}
    if all(oneway) or not lost:
        return task, []
    at = oneway.index(True)
    left, kept = task.records[at], task.records[1 - at]
    links = [link for k, link in enumerate(task.links) if k != at]
    said = preflight.only_one_way(f", so {kept.name} is diagnosed alone")
    task = replace(task, record=kept, holdout=None, links=links)
    return task, preflight.named([said], left)


def _bounded(task: Task, samples: int) -> tuple[Task, list[Finding]]:
    """Return the task with one stretch of each record, not too long, and what to say of that."""
    said = []
    for role, one in task.given.items():
        if one.breaks:
            said.append(
                f"{one.name} has {len(one.parts)} stretches: the longest, "
                f"{one.longest.n_samples} samples, is diagnosed"
            )
        part = one.longest.liveliest(samples)
        if part.n_samples < one.longest.n_samples:
            said.append(
                f"{one.name} has {one.longest.n_samples} samples: the {part.n_samples} in which "
                f"it moves most, from {part.t[0]:.6g} to {part.t[-1]:.6g} s, are diagnosed"
            )
        task = task.with_records({role: part})
    return task, [Finding(line, fatal=False) for line in said]


def _inspected(task: Task, loop: ClosedLoop, compared: Sequence[Parity]) -> Inspected:
    """Return what is wrong with the records, or worth a word, by the record's name."""
    records = list(task.given.values())

    def known(record: Record, p: Parity) -> Parity:
        """Ask the record for its own law where it has another one."""
        return parity.check(record, loop, oversampling=1) if parity.doubted(record, p) else p

    checked = tuple(threaded(known, records, compared))
    found = _by_record(
        records, threaded(lambda r, p: preflight.inspect(r, loop, p), records, checked)
    )
    if task.holdout is not None:
        found += preflight.overlap(task.record, task.holdout)
    if task.judge is not None:
        found += [f for r in task.records for f in preflight.overlap(r, task.judge, "judge")]
    if task.loop.controller.kind == "identify":  # no axis file has it wrong
        checked = tuple(map(parity.as_read, checked))
    return Inspected(checked, tuple(found))


def _shown(task: Task, found: Sequence[Parity], kept: Sequence[Parity]) -> list[Finding]:
    """Return what is said of other laws that records show, taken or not."""
    read = task.record.name if task.loop.controller.kind == "identify" else ""
    pairs = zip(found, kept, strict=False)
    same = [(p, (k.taken, k.mismatch) == (p.taken, p.mismatch)) for p, k in pairs]
    said = [preflight.other_law(p, kept, read) for p, kept in same]
    return _by_record(task.given.values(), said)


def _by_record(given: Collection[Record], found: Iterable[list[Finding]]) -> list[Finding]:
    """Return what is said of each record, with its name if there are several."""
    if len(given) == 1:
        return [f for each in found for f in each]
    pairs = zip(given, found, strict=False)
    return [f for record, each in pairs for f in preflight.named(each, record)]


def _comparable(loop: ClosedLoop, one: Ready) -> ClosedLoop:
    """Return the declared loop as it can be compared with a record's: pulled, where that is."""
    return loop if not one.driven else replace(loop, controller=one.loop.controller)


def _confirmed(loop: ClosedLoop, measured: tuple[Measured, ...]) -> tuple[Measured, ...]:
    """Take back a correction of the controller that hardly lowers the force error.

    By an energy that is nothing beside the noise: beside a large gap the noise counts, not the gap.
    A model that is driven by the recorded command knows no controller.
    """
    kept = []
    for m in measured:
        p = m.parity
        least = m.base.force_rms**2 + 2.0 * FAINT * m.floor.noise**2
        corrected = (p.mismatch or p.taken) and not m.driven
        if corrected and quantify.declared(loop, (m,)).force_rms ** 2 <= least:
            shown = p.loop.controller
            declared = replace(loop.controller, delay=shown.delay, limit=shown.limit)
            plain = replace(m.base.loop, controller=declared)
            p = replace(p, loop=plain, mismatch={}, after=p.before, taken=False)
            again = Ready(m.logged, plain, p, m.fold.place, link=m.fold.link)
            m = measure(again)
        kept.append(m)
    return tuple(kept)
