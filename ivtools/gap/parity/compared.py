"""Compared: the recorded command against the law, as declared, as corrected, and as it is read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...errors import IVToolsError
from ...loop import ClosedLoop, Controller
from ...loop.controllers import ANTI_WINDUP, other_derivative
from ...loop.identification import ControllerFit, least
from ...record import Record
from ..band import motion_hz
from ..between import interpolated
from ..rules import (
    DIGITS,
    FASTER,
    FASTER_EXPLAINS,
    FASTER_LATE,
    FASTER_LEAVES,
    GAIN_ERROR,
    GAIN_NEEDED,
    GROSS_GAIN,
    HARDLY_ANY,
    LAW_ERROR,
    LAW_TOLD,
    LITTLE,
    MOST,
    NEARLY_ALL,
    PARITY_HEAD,
    PARITY_POOR,
    ROUNDING,
)
from .gains import best_delay, corrected
from .limit import beyond, limit_of
from .signals import Signals

Array = NDArray[np.float64]

SUMMED = "pulses"  # name of a column: an added input that goes through the limit


@dataclass(frozen=True)
class Parity:
    """What the controller shows.

    Parameters
    ----------
    loop : ClosedLoop
        The loop with the controller that the record shows.
    before, after : float
        Relative parity error as declared and as found, 1: that of all, or of what is `below`.
    declared : Controller
        The controller of the axis file.
    mismatch : mapping
        Relative errors of the settings, those that are significant.
    clipped : float
        Share of the samples in which the command sits at its limit.
    read : ControllerFit or None
        The law that the record shows, looked for where the declared one, its settings put right,
        leaves more than `PARITY_POOR`.
    taken : bool
        Whether it is taken instead: it explains the command, and much better.
    at : float or None
        Time, s, around which nearly all of the error lies that is left; None if there is none such.
    oversampling : int
        Samples of the controller from one sample of the log to the next.
    below : float or None
        Frequency, Hz, below which they are compared, where command and logged position have noise
        that is not the other's; None: all of the command.
    """

    loop: ClosedLoop
    before: float
    after: float
    declared: Controller
    mismatch: dict[str, float]
    clipped: float
    read: ControllerFit | None = None
    taken: bool = False
    at: float | None = None
    oversampling: int = 1
    below: float | None = None

    @property
    def delay(self) -> int:
        """Samples from the measured position to the recorded command."""
        return self.loop.controller.delay

    @property
    def limit(self) -> float | None:
        """A limit of the command below the declared one, if there is one."""
        limit = self.loop.controller.limit
        return limit if limit < self.declared.limit else None

    @property
    def whole(self) -> bool:
        """Whether the log has all samples of its controller: then the law gives the command."""
        return self.oversampling == 1 and self.below is None and self.after <= DIGITS

    @property
    def trustworthy(self) -> bool:
        """Whether the law, as corrected or read from the record, reproduces the command."""
        return self.after < LAW_ERROR or self.taken

    @property
    def found(self) -> dict[str, float]:
        """What the axis file has not: relative errors, feed-forwards, a filter, or another law."""
        if not self.taken:
            return self.mismatch
        law = self.loop.controller
        fed = {f"feedforward.{k}": v for k, v in law.feedforward.items()}
        fed |= {f"feedback.{k}": v for k, v in law.feedback.items()}
        if self._filtered_otherwise:
            fed["filter.hz"] = law.filter.hz if law.filter is not None else 0.0
        if law.kind == self.declared.kind:
            known = {*self.declared.mismatches}
            return {**self.mismatch, **{k: v for k, v in fed.items() if k not in known}}
        own = {f"law.{k}": float(v) for k, v in law.settings.items() if np.ndim(v) == 0}
        return own | fed

    @property
    def _filtered_otherwise(self) -> bool:
        """Whether the filter of the law that was read is not the declared one."""
        own, declared = self.loop.controller.filter, self.declared.filter
        if own is None or declared is None or own.kind != declared.kind:
            return own is not declared
        return abs(own.hz / declared.hz - 1.0) > _told(self.read)


def otherwise_derived(
    record: Record,
    loop: ClosedLoop,
    compared: Sequence[Parity],
    compare: Callable[[ClosedLoop], Sequence[Parity]],
) -> list[Parity]:
    """Return how a law compares that derives its reference in the other way, if that is the law's.

    A reference is known whenever its controller has it: derivatives that are not logged may be made
    of samples on both sides, or of the last ones, half a sample late. Empty where the law takes
    none, or explains no more so.

    Parameters
    ----------
    record : Record
        One of those that were compared.
    loop : ClosedLoop
        As it is declared.
    compared : sequence of Parity
        How it compares.
    compare : callable
        Compares the same records with another loop.
    """
    law = loop.controller
    if law.kind == "none" or max(p.before for p in compared) <= DIGITS:
        return []
    way = other_derivative(law.reference_derivative)
    other = replace(loop, controller=replace(law, reference_derivative=way))
    part = record.liveliest(LAW_TOLD)
    here, there = (Signals(part, one).fed(one.controller.shown(part.dt)) for one in (loop, other))
    if np.array_equal(here, there):
        return []
    found = list(compare(other))
    excused, other_excused = (any(p.below for p in each) for each in (compared, found))
    if excused != other_excused:  # the one that needs no excuse
        return found if excused and all(p.trustworthy for p in found) else []
    return found if _explain_more(found, compared) else []


def _explain_more(found: Sequence[Parity], other: Sequence[Parity]) -> bool:
    """Whether laws explain much more of their records' commands than others.

    As they are declared, or with settings put right; with wrong settings a wrong one may explain
    more, but not as it is declared.
    """
    declared, put_right = (
        max(float(np.linalg.norm([getattr(p, name) for p in found])), ROUNDING)
        / max(float(np.linalg.norm([getattr(p, name) for p in other])), ROUNDING)
        for name in ("before", "after")
    )
    limited = any(p.limit is not None for p in found)  # of which the declared law knows nothing
    no_worse = put_right < GAIN_NEEDED and (limited or declared < 1.0)
    return no_worse and min(declared, put_right) < MOST**0.5


def check(record: Record, loop: ClosedLoop, read: bool = True, oversampling: int = 0) -> Parity:
    """Compare the recorded command with the law fed with the measured position.

    Parameters
    ----------
    record : Record
        With a reference.
    loop : ClosedLoop
        Its controller is the one declared.
    read : bool
        Whether the record is asked for its own law where the declared one explains little.
    oversampling : int
        Samples of the controller per sample of the log; 0: as the record shows.

    Returns
    -------
    Parity
    """
    found = _compared(record, loop, read, oversampling)
    extra = 0.0 if found.taken else found.mismatch.get("added", 0.0)
    if abs(extra) <= GROSS_GAIN:
        return found
    # of another size or sign, it hides where the law sits at its limit: as it acts, once more
    assert record.added is not None
    known = replace(record, added=(1.0 + extra) * record.added)
    again = _compared(known, loop, read, oversampling)
    more = again.mismatch.get("added", 0.0)
    return replace(
        again,
        before=found.before,
        mismatch={**again.mismatch, "added": (1.0 + extra) * (1.0 + more) - 1.0},
    )


def at_motion(record: Record, loop: ClosedLoop, found: Parity, oversampling: int = 0) -> Parity:
    """Return how a law that explains little compares at the frequencies of the motion, if it can.

    What a controller saw between the samples of a log, or before they were rounded, has noise that
    is not logged, and a log may have noise of its own: in the command it may be more than the
    motion asks for. A law that gives the command below it, as it is declared, is taken if no other
    one gives all of it, and an added input acts as it was recorded.

    Parameters
    ----------
    record : Record
    loop : ClosedLoop
    found : Parity
        What `check` says of them.
    oversampling : int, optional
        As it was asked there.
    """
    hz = _motion_hz(record)
    if found.trustworthy or not hz or "added" in found.mismatch or another(record, found):
        return found
    if oversampling > 1:
        slow = _at_rate(record, loop, oversampling, hz)
        return slow if slow.after <= LAW_ERROR else found
    shown = replace(loop, controller=loop.controller.shown(record.dt))
    slow, signals = _checked(record, shown, hz)
    slow = slow if oversampling else _between(record, loop, slow)
    if slow.oversampling == 1:  # so slow a signal tells no delay of a sample, nor a few per cent
        law = replace(shown.controller, limit=slow.loop.controller.limit)
        left = signals.share(signals.error(law, law.delay, 0.0))
        slow = replace(slow, loop=replace(loop, controller=law), mismatch={}, after=left)
    return slow if slow.after <= LAW_ERROR else found


def _motion_hz(record: Record) -> float:
    """Return the frequency below which the reference moves, Hz; 0 if it does not."""
    if record.q_ref is not None:
        return motion_hz(record.q_ref[:, 0], record.dt)
    if record.dq_ref is not None:
        return motion_hz(np.cumsum(record.dq_ref[:, 0]) * record.dt, record.dt)
    return 0.0


def _compared(record: Record, loop: ClosedLoop, read: bool, oversampling: int) -> Parity:
    """Compare them, the added input being what was recorded; read another law if that is asked."""
    if oversampling > 1:
        return _at_rate(record, loop, oversampling)
    shown = replace(loop, controller=loop.controller.shown(record.dt))
    found, signals = _checked(record, shown)
    found = found if oversampling else _between(record, loop, found)
    limited = found.limit is not None and found.after**2 < HARDLY_ANY  # behind it it is right
    known = not read or limited or not doubted(record, found)
    return found if known else _read(found, signals, record, shown)


def doubted(record: Record, found: Parity) -> bool:
    """Whether a record is asked for its own law.

    Where another one, whatever it is, may explain all but everything of the command, or much more
    where the declared one explains little; and where that one cannot be gone on with.
    """
    if found.oversampling > 1 or found.below or found.after <= DIGITS:
        return False
    there, better = _others(record, found)
    return there or not found.trustworthy or (better and found.after > PARITY_POOR)


def another(record: Record, found: Parity) -> bool:
    """Whether there is a law that explains all but everything of the command, whatever it is."""
    return found.after > DIGITS and _others(record, found)[0]


def _others(record: Record, found: Parity) -> tuple[bool, bool]:
    """Whether a law explains all but everything, and whether one may be enough better.

    A law of a few samples, which takes what is logged, when it is logged or later; where a record
    cannot be asked for one, `identify` says so.
    """
    try:
        left, alone = least(found.loop, record.liveliest(LAW_TOLD))
    except IVToolsError:
        return False, True
    return left < LITTLE * min(found.after, alone), left**2 < MOST * found.after**2


def _noise_share(record: Record, loop: ClosedLoop) -> float:
    """Return the share of the command's energy that no law of a few samples explains, if known."""
    try:
        return least(loop, record)[0] ** 2
    except IVToolsError:  # then all of it counts as told
        return 0.0


def _checked(
    record: Record, loop: ClosedLoop, below: float | None = None
) -> tuple[Parity, Signals]:
    """Return how the declared law compares, and the signals, which know their limit."""
    whole = Signals(record, loop)
    declared = whole.below(below).error(loop.controller, loop.controller.delay, 0.0)
    signals, limit, clipped = limit_of(whole, loop.controller)
    signals = signals.below(below)
    free = ~clipped
    if signals.share(declared) > ROUNDING:
        kept, delay = best_delay(signals, loop.controller, free)
    else:
        kept, delay = {}, loop.controller.delay
    controller = corrected(loop.controller, delay, kept, limit)
    error = signals.error(controller, delay, kept.get("added", 0.0))
    found = Parity(
        loop=replace(loop, controller=controller),
        before=signals.share(declared),
        after=signals.share(error),
        declared=loop.controller,
        mismatch=kept,
        clipped=float(np.mean(clipped)),
        at=_once(error, record.t),
        below=below,
    )
    return found, signals


def _between(record: Record, loop: ClosedLoop, found: Parity) -> Parity:
    """Return how the law compares if its controller takes several samples for each of the log.

    It does if the law explains as much between the samples, with all its settings as declared, as
    it does with others at the samples, or nearly. With none it must leave no more there than the
    command's noise, which no law of a few samples explains either. The log alone cannot have a
    filter beyond it.
    """
    declared = loop.controller.delay
    whole = found.declared == loop.controller
    alone = whole and not found.mismatch and found.delay == declared
    if found.after <= (DIGITS if alone else ROUNDING):
        return found
    limited = replace(loop.controller, limit=found.loop.controller.limit)
    part = record.liveliest(LAW_TOLD)
    here = Signals(part, loop).below(found.below)
    stays = _left(here.error(limited.shown(part.dt), declared, 0.0))
    if not alone:
        added = found.mismatch.get("added", 0.0)
        left = _left(here.error(found.loop.controller, found.delay, added))
    else:
        left = 0.0 if found.below else _noise_share(part, loop) * _left(here.command)
    tried = {}
    for count in FASTER:
        fine = Signals(interpolated(part, count), loop).below(found.below)
        if limited.shown(fine.dt) != limited:
            continue
        tried[count] = _left(fine.error(limited, declared, 0.0), count)
    count = min(tried, key=lambda n: tried[n], default=0)
    most = LAW_ERROR**2 * _left(here.slow(here.command))
    if not count or tried[count] > most or not _takes(stays, tried[count], left):
        return found
    if alone and tried[count] > FASTER_LEAVES * stays:
        return found
    one = _at_rate(record, loop, count, found.below)
    late = abs(one.delay - declared) >= FASTER_LATE * count
    if one.mismatch or (late and not _takes(found.before**2, one.before**2, one.after**2)):
        return found
    law = replace(one.loop.controller, delay=declared)
    return replace(one, loop=replace(loop, controller=law))


def _at_rate(record: Record, loop: ClosedLoop, count: int, below: float | None = None) -> Parity:
    """Return how the law compares that takes so many samples for each of the log.

    What a controller saw between them is not logged: other settings must take most of the error.
    """
    found, _ = _checked(interpolated(record, count), loop, below)
    found = replace(found, oversampling=count)
    if not found.mismatch or _takes(found.before**2, found.after**2, 0.0):
        return found
    law = replace(loop.controller, limit=found.loop.controller.limit)
    return replace(found, loop=replace(loop, controller=law), mismatch={}, after=found.before)


def _left(error: Array, count: int = 1) -> float:
    """Return the energy of an error at the samples of a log, of `count` as many."""
    return float(np.sum(error[count * PARITY_HEAD :: count] ** 2))


def _takes(stays: float, left: float, other: float) -> bool:
    """Whether what is left of an error is nearly as much less as another law leaves less."""
    return stays - left > FASTER_EXPLAINS * (stays - other)


def _once(error: Array, t: Array) -> float | None:
    """Return the time around which nearly all of an error lies, s, if there is one."""
    energy = np.append(0.0, np.cumsum(error[PARITY_HEAD:] ** 2))
    k = int(np.argmax(np.abs(error[PARITY_HEAD:])))
    near = energy[min(k + PARITY_HEAD, len(energy) - 1)] - energy[max(k - PARITY_HEAD, 0)]
    return float(t[PARITY_HEAD + k]) if near > (1.0 - HARDLY_ANY) * energy[-1] else None


def _read(found: Parity, signals: Signals, record: Record, loop: ClosedLoop) -> Parity:
    """Return the parity with the law that the record shows, if that explains more."""
    try:
        fit = loop.identify_controller(record)[1]
    except IVToolsError:
        return found
    law, after, clipped = _limited(fit.controller, found, signals, loop)
    left = 1.0 - fit.r2 if fit.low_pass else after**2
    better = left < MOST * found.after**2
    if not better or fit.r2 < NEARLY_ALL:
        return replace(found, read=fit)
    same = law.kind == loop.controller.kind
    mismatch = _differences(loop.controller, law, fit) if same else {}
    return replace(
        found,
        loop=replace(loop, controller=law),
        after=after,
        mismatch=mismatch,
        clipped=clipped,
        read=fit,
        taken=True,
    )


def _limited(
    law: Controller, found: Parity, signals: Signals, loop: ClosedLoop
) -> tuple[Controller, float, float]:
    """Return a law that was read with its limit, its parity error, and how often it is there.

    A limit that the declared law seemed to have goes if this one explains all without.
    """
    free = replace(law, limit=loop.controller.limit)
    plain = Signals(signals.record, loop)
    left = plain.share(plain.error(free, law.delay, 0.0))
    if found.limit is None:
        return free, left, found.clipped
    limited = replace(law, limit=found.limit)
    after = signals.share(signals.error(limited, law.delay, 0.0))
    return (free, left, 0.0) if left <= ROUNDING else (limited, after, found.clipped)


def _differences(declared: Controller, law: Controller, fit: ControllerFit) -> dict[str, float]:
    """Return relative errors of the settings that two laws of a kind have in common."""
    pairs = {
        k: (float(declared.full[k]), float(law.full[k]))
        for k in declared.mismatches
        if k in declared.full and k in law.full
    }
    found = {k: new / old - 1.0 for k, (old, new) in pairs.items() if old}
    return {k: v for k, v in found.items() if abs(v) > _told(fit)}


def _told(fit: ControllerFit | None) -> float:
    """Return the relative error of a setting that a law tells which was read from a record."""
    return LITTLE if fit is not None and fit.low_pass else GAIN_ERROR


def at_limit(
    records: Sequence[Record], loop: ClosedLoop, checked: Sequence[Parity]
) -> tuple[list[Record], ClosedLoop, list[Parity]]:
    """Return how records show that the command was limited: they, the loop, and their parity.

    Whoever has not stated a limit has not stated what an integrator does there either, nor whether
    an added input goes through it: if so, it is a feed-forward, `SUMMED`. What is declared stays
    where it explains the command, or nothing else does much better.
    """
    law, dt = loop.controller, records[0].dt
    declared = list(records), loop, list(checked)
    if max(p.after for p in checked) <= PARITY_POOR:
        return declared
    clamped = replace(law, anti_windup="clamp")
    ends = ANTI_WINDUP if clamped.law(dt).hold.any() else (law.anti_windup,)
    laws = [replace(law, anti_windup=end) for end in ends]
    ways = [(list(records), one) for one in laws if one != law]
    added = any(r.added is not None and r.added.any() for r in records)
    if added and not any(beyond(loop.command(r), law.limit) for r in records):
        summed = [_summed(r, law.delay) for r in records]
        fed = {**law.feedforward, SUMMED: 1.0}
        ways += [(summed, replace(one, feedforward=fed)) for one in laws]

    def left(tried: tuple[list[Record], ClosedLoop, list[Parity]]) -> float:
        """Return the share of the commands' energy that a law leaves, of all records."""
        return sum(p.after**2 for p in tried[2])

    tried = []
    for given, one in ways:
        other = replace(loop, controller=one)
        found = [check(r, other, read=False, oversampling=1) for r in given]
        tried.append((given, other, found))
    best = min(tried, key=left, default=declared)
    limited = any(p.clipped for p in best[2])
    return best if limited and left(best) < MOST * left(declared) else declared


def _summed(record: Record, delay: int) -> Record:
    """Return a record whose added input is one that the law itself adds, as early as it is late."""
    n = record.n_samples
    added = np.zeros(n) if record.added is None else record.added[:, 0]
    column = np.concatenate([added[delay:], np.zeros(min(delay, n))])
    return record.replace(added=None, extra={**record.extra, SUMMED: column})


def as_read(checked: Parity) -> Parity:
    """Return the parity of a law that was read from another record: a little off is no mistake."""
    law, declared = checked.loop.controller, checked.declared
    if law.kind != declared.kind or any(abs(v) > GROSS_GAIN for v in checked.mismatch.values()):
        return checked
    added = {k: v for k, v in checked.mismatch.items() if k == "added"}
    return replace(
        checked,
        before=checked.after,
        declared=replace(law, limit=declared.limit),
        mismatch=added,
        taken=False,
    )


def relative(checked: Sequence[Parity], setting: str) -> bool:
    """Whether what records show of a setting is the relative error of one that was declared."""
    shown = [p for p in checked if setting in p.found]
    return bool(shown) and all(setting in (*p.mismatch, "added") for p in shown)


def unit(checked: Sequence[Parity], setting: str) -> str:
    """Return the unit in which a setting is said that records show."""
    return "%" if relative(checked, setting) else "Hz" if setting == "filter.hz" else ""


def effects(checked: tuple[Parity, ...]) -> tuple[list[str], dict[str, dict[str, float]]]:
    """Return what the controller itself shows, decided at parity level."""
    effects, values = [], {}
    limits = [p.limit for p in checked if p.limit is not None]
    if limits:
        effects.append("saturation")
        values["saturation"] = {"limit": float(np.mean(limits))}
    found = [p.found for p in checked]
    names = {n for values in found for n in values}
    if names:
        effects.append("controller-mismatch")
        values["controller-mismatch"] = {
            n: float(np.mean([values[n] for values in found if n in values])) for n in sorted(names)
        }
    return effects, values
