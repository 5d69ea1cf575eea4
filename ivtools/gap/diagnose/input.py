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
    """

    task: Task
    loop: ClosedLoop
    compared: Sequence[Parity] = ()
    said: tuple[Finding, ...] = ()

    @property
    def given(self) -> tuple[Record, ...]:
        """Every record that there is."""
        return tuple(self.task.given.values())

    def then(
        self, said: Iterable[Finding] = (), asked: Mapping[str, Any] | None = None, **changed: Any
    ) -> Input:
        """Return it after a step: what is said of that, and what changed of the task and of it."""
        task = replace(self.task, **(asked or {}))
        return replace(self, task=task, said=(*self.said, *said), **changed)


def readied(task: Task) -> Input:
    """Return the input of a task.

    Raises
    ------
    IVToolsError
        If a law that is to be identified cannot be, or no position can be followed.
    """
    steps = (_bounded, _near, _finer, _followed, _both_ways, _as_it_acted)
    given = Input(task, task.loop)
    return reduce(lambda given, step: step(given), steps, given)


def _bounded(given: Input) -> Input:
    """Take one stretch of each record, not too long."""
    samples = given.task.rules.samples
    for role, one in given.task.given.items():
        said = []
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
        given = given.then([Finding(line, fatal=False) for line in said], {role: part})
    return given


def _near(given: Input) -> Input:
    """Count positions from near.

    A robot's have their origin from its links, and a simulator that is run asks for its own.
    """
    task = given.task
    if task.links or task.whole:
        return given
    origin = preflight.origin(task.record, (*task.loop.terms, *task.extra), task.loop)
    if not origin:
        return given
    counted = {role: preflight.counted(one, origin) for role, one in task.given.items()}
    return given.then([preflight.near(origin, task.loop)], counted)


def _finer(given: Input) -> Input:
    """Take references as the controller had them."""
    for role, one in given.task.given.items():
        finer, said = preflight.finer(one, given.loop)
        given = given.then(preflight.named(said, one), {role: finer})
    return given


def _followed(given: Input) -> Input:
    """Take positions that a law follows, and the law itself, which may be read from a record."""
    task = given.task
    law = preflight.identified(task.record, task.loop)
    known = task.loop.known(task.record)
    followed = {role: preflight.followed(one, known) for role, one in task.given.items()}
    said = [*law, *followed["record"][1]]
    return given.then(said, {role: one for role, (one, _) in followed.items()}, loop=known)


def _both_ways(given: Input) -> Input:
    """Leave out a record that moves in one direction only.

    The model would lack on the other one what such a record cannot tell from Coulomb friction.
    """
    records = given.task.records
    oneway = [preflight.one_way(r) for r in records]
    lost = {*given.loop.names} - {*preflight.identifiable(records, given.loop).names}
    if all(oneway) or not lost:
        return given
    at = oneway.index(True)
    left, kept = records[at], records[1 - at]
    links = [link for k, link in enumerate(given.task.links) if k != at]
    said = preflight.only_one_way(f", so {kept.name} is diagnosed alone")
    alone = {"record": kept, "holdout": None, "links": links}
    return given.then(preflight.named([said], left), alone)


def _as_it_acted(given: Input) -> Input:
    """Take records and law as the controller acted.

    Joints of a robot have one log, and one controller: what another joint showed holds.
    """
    if given.task.inspected is not None:
        return given
    given = _at_rate(_derived(given))
    fast = any(p.oversampling > 1 for p in given.compared)
    if fast or given.task.links or given.loop.controller.kind == "none":
        return given
    return _on_time(_at_limit(_in_place(given)))


def _compared(given: Input, loop: ClosedLoop) -> list[Parity]:
    """Return how a law compares with each record, at the rate of its controller."""
    rate = parity.at_rate(given.task.loop)
    checked = threaded(lambda one: parity.check(one, loop, False, rate), given.given)
    fast = [p for p in checked if p.oversampling > 1]
    if not fast:
        return checked
    rate = min(fast, key=lambda p: p.after).oversampling  # noise hides it in the others
    pairs = zip(given.given, checked, strict=True)
    return [p if p.oversampling == rate else parity.check(r, loop, False, rate) for r, p in pairs]


def _derived(given: Input) -> Input:
    """Derive the reference as records show."""
    loop, compared = given.loop, _compared(given, given.loop)
    compare = partial(_compared, given)
    again = parity.otherwise_derived(given.task.record, loop, compared, compare)
    if not again:
        return given.then(compared=compared)
    other = replace(loop, controller=again[0].declared)
    before, after = (max(p.after for p in each) for each in (compared, again))
    said = preflight.derived(other.controller, before, after)
    return given.then([said], loop=other, compared=again)


def _at_rate(given: Input) -> Input:
    """Say at which rate the controller acted, and leave out a filter that the log's cannot have."""
    rate = max(p.oversampling for p in given.compared)
    if rate > 1:
        return given.then([preflight.faster(rate)])
    loop, dt = given.loop, given.task.record.dt
    beyond = loop.controller.filter
    if beyond is None or beyond.fits(dt):
        return given
    shown = replace(loop, controller=loop.controller.shown(dt))
    return given.then([preflight.beyond_the_log(beyond.hz, 1.0 / dt)], loop=shown)


def _in_place(given: Input) -> Input:
    """Take references where the control law takes them, and how it compares then."""
    loop, checked = given.loop, given.compared
    roles = tuple(given.task.given)
    pairs = zip(given.given, checked, strict=True)
    moved = [preflight.misplaced(one, loop, p) for one, p in pairs]
    if not any(moved):
        return given
    known = min(filter(None, moved), key=lambda one: one.checked.after).samples
    found, said, placed = list(checked), [], {}
    for k, one in enumerate(given.given):
        if own := moved[k] or preflight.misplaced(one, loop, checked[k], known):
            placed[roles[k]], found[k] = own.record, own.checked
            text = preflight.elsewhere(own.samples, checked[k].after, own.checked.after)
            said += preflight.named([text], one)
    return given.then(said, placed, compared=found)


def _at_limit(given: Input) -> Input:
    """Take the limit of the command that records show."""
    loop, compared = given.loop, given.compared
    records, other, checked = parity.at_limit(given.given, loop, compared)
    if other is loop:
        return given
    before, after = (max(p.after for p in each) for each in (compared, checked))
    said = preflight.limited(loop.controller, other.controller, before, after)
    limited = dict(zip(given.task.given, records, strict=True))
    return given.then([said], limited, loop=other, compared=checked)


def _on_time(given: Input) -> Input:
    """Take commands as they acted where the log has them late.

    A command that follows the position by other samples than the axis file says was given at
    another time, or logged at another time: the simulated loop tells, for only the first turns its
    phase. Logged it is if the base model leaves less then (training: all but one of 147 logs that
    are late or early do, and one of 40 whose axis file has another delay).
    """
    logged, loop = given.given, given.loop
    roles = tuple(given.task.given)
    late = threaded(preflight.lateness, logged, [loop] * len(logged), given.compared)
    for samples in sorted({one.samples for one in late if one}):
        moved = {k: one for k, one in enumerate(late) if one and one.samples == samples}
        acted = [(one.record, one.checked) for one in moved.values()]
        if any(f.fatal for one, p in acted for f in preflight.inspect(one, loop, p)):
            continue
        before = [(logged[k], given.compared[k]) for k in moved]
        with suppress(IVToolsError):  # which the diagnosis will say
            left = _left(acted, given.task.records) / _left(before, given.task.records)
            if left < 1.0:
                records = {roles[k]: one.record for k, one in moved.items()}
                pairs = enumerate(given.compared)
                checked = [moved[k].checked if k in moved else p for k, p in pairs]
                text = preflight.late(samples, left)
                said = [f for one, _ in before for f in preflight.named([text], one)]
                given = given.then(said, records, compared=checked)
    return given


def _left(compared: Sequence[tuple[Record, Parity]], records: Sequence[Record]) -> float:
    """Return what the base model leaves of the force of some records, rms of all."""
    ready = [prepared(one, checked, records) for one, checked in compared]
    return float(np.linalg.norm([f.fit.force_rms for f in threaded(fitted, ready)]))
