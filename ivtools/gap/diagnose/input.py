"""Input: records and control law, as they can be compared.

Step by step: what is diagnosed of each record, where its positions are counted from, which
reference the law follows, and how the controller acted: at which rate, and when.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import Any

import numpy as np

from ...errors import IVToolsError
from ...loop import ClosedLoop
from ...record import Record
from ...workers import threaded
from .. import parity, preflight
from ..floor import fitted, prepared
from ..parity import Parity
from ..preflight import Finding
from ..rules import NEARLY_ALL
from .task import Task


@dataclass(frozen=True, eq=False)
class Input:
    """Records and loop as they are by now.

    Parameters
    ----------
    task : Task
        What is asked, of these records.
    loop : ClosedLoop
    compared : sequence of Parity
        How the law compares with each record, once it was asked.
    said : tuple of Finding
        What was done to the records and the law, and why.
    inexact : frozenset of str
        Names of records whose reference is not the logged one, which was rounded: no law repeats
        their commands to the last digit.
    """

    task: Task
    loop: ClosedLoop
    compared: Sequence[Parity] = ()
    said: tuple[Finding, ...] = ()
    inexact: frozenset[str] = frozenset()

    @property
    def records(self) -> tuple[Record, ...]:
        """Every record that there is."""
        return tuple(self.task.given.values())

    def then(
        self, said: Iterable[Finding] = (), task: Mapping[str, Any] | None = None, **changed: Any
    ) -> Input:
        """Return it after a step: what is said of that, and what changed of the task and of it."""
        changed["task"] = replace(self.task, **(task or {}))
        return replace(self, said=(*self.said, *said), **changed)


def readied(now: Input) -> Input:
    """Return an input that can be compared.

    Raises
    ------
    IVToolsError
        If a law that is to be identified cannot be, or no position can be followed.
    """
    steps = (_near, _finer, _followed, _telling, _as_it_acted)
    return reduce(lambda now, step: step(now), steps, now)


def bounded(task: Task) -> Input:
    """Return the input of a task: one stretch of each record, not too long."""
    now, samples = Input(task, task.loop), task.rules.samples
    for role, one in now.task.given.items():
        said = [f"{one.name}: {note}" for note in one.reading_notes]
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
        now = now.then([Finding(line, fatal=False) for line in said], {role: part})
    return now


def _near(now: Input) -> Input:
    """Count positions from near.

    A robot's have their origin from its links, and a simulator that is run asks for its own.
    """
    task = now.task
    if task.links or task.whole:
        return now
    origin = preflight.origin(task.record, (*task.loop.terms, *task.extra), task.loop)
    if not origin:
        return now
    counted = {role: preflight.counted(one, origin) for role, one in task.given.items()}
    return now.then([preflight.near(origin, task.loop)], counted)


def _finer(now: Input) -> Input:
    """Take references as the controller had them."""
    for role, one in now.task.given.items():
        finer, said = preflight.finer(one, now.loop)
        inexact = now.inexact | {one.name} if said else now.inexact
        now = now.then(preflight.named(said, one), {role: finer}, inexact=inexact)
    return now


def _followed(now: Input) -> Input:
    """Take positions that a law follows, and the law itself, which may be read from a record."""
    task = now.task
    law = preflight.identified(task.record, task.loop)
    known = task.loop.known(task.record)
    followed = {role: preflight.followed(one, known) for role, one in task.given.items()}
    said = [*law, *followed["record"][1]]
    return now.then(said, {role: one for role, (one, _) in followed.items()}, loop=known)


def _telling(now: Input) -> Input:
    """Leave out a record that tells too little of the axis, where the other one tells enough.

    The model would lack on the other one what a record in one direction only cannot tell from
    Coulomb friction; and one that hardly moves judges nothing.
    """
    records = now.task.records
    free = replace(now.loop, controller=replace(now.loop.controller, limit=np.inf))
    short = [preflight.too_short(r, free) for r in records]  # a wrong unit may be above the limit
    found = short
    if not any(short):
        lost = {*now.loop.names} - {*preflight.identifiable(records, now.loop).names}
        found = [
            [preflight.only_one_way()] if lost and preflight.one_way(r) else [] for r in records
        ]
    if all(found) or not any(found):
        return now
    at = next(k for k, said in enumerate(found) if said)
    left, kept = records[at], records[1 - at]
    links = [link for k, link in enumerate(now.task.links) if k != at]
    said = [Finding(f"{f.text}; {kept.name} is diagnosed alone", fatal=False) for f in found[at]]
    alone = {"record": kept, "holdout": None, "links": links}
    return now.then(preflight.named(said, left), alone)


def _as_it_acted(now: Input) -> Input:
    """Take records and law as the controller acted.

    Joints of a robot have one log, and one controller: what another joint showed holds.
    """
    if now.task.inspected is not None:
        return now
    now = _rate_said(_derived(now))
    beyond = any(p.oversampling > 1 or p.below for p in now.compared)  # what the log can show
    if beyond or now.task.links or now.loop.controller.kind == "none":
        return now
    return _on_time(_at_limit(_in_place(now)))


def _compared(now: Input, loop: ClosedLoop) -> list[Parity]:
    """Return how a law compares with each record, at the rate of its controller.

    A controller has one rate, and one law, whatever its logs have, and noise may hide it in some of
    them: a log with all of its samples tells it best. Where another one has moved the axis the law
    gives the command at the rate that the log itself shows, and only there.
    """

    def at(one: Record, count: int, law: ClosedLoop = loop) -> Parity:
        """Return how it compares with one of them, at so many samples for each of the log."""
        return parity.at_motion(one, law, parity.check(one, law, False, count), count)

    def at_the_rate(one: Record, own: Parity, hz: float, surest: Parity) -> Parity:
        """Return how it compares at the rate that another one shows, with the law that does."""
        count = parity.multiple(hz, one)
        if own is surest or own.whole or not count:
            return own
        known = own if own.oversampling == count else at(one, count)
        left = known.before
        if surest.whole and surest.mismatch and "added" not in surest.mismatch:
            law = replace(surest.loop.controller, limit=loop.controller.limit)
            right = at(one, count, replace(loop, controller=law))
            known, left = parity.by_another(known, right, surest), right.before
        another = own.trustworthy and not own.mismatch and own.before < NEARLY_ALL * left
        return own if another else known

    count = parity.known_oversampling(now.task.loop)
    checked = threaded(at, now.records, [count] * len(now.records))
    pairs = list(zip(now.records, checked, strict=True))
    shown = parity.rates(pairs) if loop.controller.kind != "none" else []
    return [at_the_rate(*pair, *shown[0]) for pair in pairs] if shown else checked


def _derived(now: Input) -> Input:
    """Derive the reference as records show."""
    loop, compared = now.loop, _compared(now, now.loop)
    compare = partial(_compared, now)
    again = parity.otherwise_derived(now.task.record, loop, compared, compare)
    if not again:
        return now.then(compared=compared)
    other = replace(loop, controller=again[0].declared)
    before, after = (max(p.after for p in each) for each in (compared, again))
    said = preflight.derived(other.controller, before, after)
    return now.then([said], loop=other, compared=again)


def _rate_said(now: Input) -> Input:
    """Say at which rate the controller acted, and leave out a filter that the log's cannot have."""
    pairs = zip(now.records, now.compared, strict=True)
    slow = [f for r, p in pairs if p.below for f in preflight.named([preflight.noisy(p)], r)]
    now = now.then(slow)
    if any(p.oversampling > 1 for p in now.compared):
        said = [[preflight.faster(p)] * (p.oversampling > 1) for p in now.compared]
        alike = all(each == said[0] for each in said)
        return now.then(said[0] if alike else preflight.by_record(now.records, said))
    loop, dt = now.loop, now.task.record.dt
    beyond = loop.controller.filter
    if beyond is None or beyond.fits(dt):
        return now
    shown = replace(loop, controller=loop.controller.shown(dt))
    return now.then([preflight.beyond_the_log(beyond.hz, 1.0 / dt)], loop=shown)


def _in_place(now: Input) -> Input:
    """Take references where the control law takes them, and how it compares then."""
    loop, checked = now.loop, now.compared
    roles = tuple(now.task.given)
    pairs = zip(now.records, checked, strict=True)
    moved = [preflight.misplaced(one, loop, p) for one, p in pairs]
    if not any(moved):
        return now
    known = min(filter(None, moved), key=lambda one: one.checked.after).samples
    found, said, placed = list(checked), [], {}
    for k, one in enumerate(now.records):
        if own := moved[k] or preflight.misplaced(one, loop, checked[k], known):
            placed[roles[k]], found[k] = own.record, own.checked
            text = preflight.elsewhere(own.samples, checked[k].after, own.checked.after)
            said += preflight.named([text], one)
    return now.then(said, placed, compared=found)


def _at_limit(now: Input) -> Input:
    """Take what an integrator does at a limit, and whether an added input goes through that."""
    loop, compared = now.loop, now.compared
    records, other, checked = parity.at_limit(now.records, loop, compared)
    if other is loop:
        return now
    before, after = (max(p.after for p in each) for each in (compared, checked))
    said = preflight.limited(loop.controller, other.controller, before, after)
    limited = dict(zip(now.task.given, records, strict=True))
    return now.then([said], limited, loop=other, compared=checked)


def _on_time(now: Input) -> Input:
    """Take commands as they acted where the log has them late.

    A command that follows the position by other samples than the axis file says was given at
    another time, or logged at another time: the simulated loop tells, for only the first turns its
    phase. Logged it is if the base model leaves less then (training: all but one of 147 logs that
    are late or early do, and one of 40 whose axis file has another delay).
    """
    logged, loop = now.records, now.loop
    roles = tuple(now.task.given)
    late = threaded(preflight.lateness, logged, [loop] * len(logged), now.compared)
    for samples in sorted({one.samples for one in late if one}):
        moved = {k: one for k, one in enumerate(late) if one and one.samples == samples}
        acted = [(one.record, one.checked) for one in moved.values()]
        found = threaded(lambda m: preflight.inspect(m.record, loop, m.checked), moved.values())
        if any(f.fatal for each in found for f in each):
            continue
        before = [(logged[k], now.compared[k]) for k in moved]
        with suppress(IVToolsError):  # which the diagnosis will say
            left = _left(acted, now.task.records) / _left(before, now.task.records)
            if left < 1.0:
                records = {roles[k]: one.record for k, one in moved.items()}
                pairs = enumerate(now.compared)
                checked = [moved[k].checked if k in moved else p for k, p in pairs]
                text = preflight.late(samples, left)
                said = [f for one, _ in before for f in preflight.named([text], one)]
                now = now.then(said, records, compared=checked)
    return now


def _left(compared: Sequence[tuple[Record, Parity]], records: Sequence[Record]) -> float:
    """Return what the base model leaves of the force of some records, rms of all."""
    ready = [prepared(one, checked, records) for one, checked in compared]
    return float(np.linalg.norm([f.fit.force_rms for f in threaded(fitted, ready)]))
