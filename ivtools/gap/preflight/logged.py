"""Logged: what a log has made of the signals that the controller had.

A reference with fewer digits: a law that follows the speed differentiates it, and a step of the log
becomes a speed of a step per sample that nobody asked for. Positions that are counted from far
away. A command, or a reference, some samples late or early, or one of several.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from ...errors import IVToolsError
from ...loop import ClosedLoop, Controller
from ...loop.controllers import other_derivative, reference_response, references
from ...physics import TERMS, Term
from ...record import Record
from ...units import JOINTS, percent, plural, quantity
from .. import parity
from ..parity import Parity
from ..rules import (
    DEPENDENT,
    EDGES,
    ENDS,
    GAIN_NEEDED,
    IMPLIED,
    LATENESS,
    LAW_ERROR,
    LEAST_RESPONSE,
    LITTLE,
    MISPLACED,
    MOST,
    PARITY_HEAD,
    PARITY_POOR,
    ROUGHNESS,
    ROUND,
    ROUNDING,
    SMOOTHED,
    SMOOTHEST,
)
from .findings import Finding

Array = NDArray[np.float64]

COMMANDS, REFERENCES = ("nu", "tau"), ("q_ref", "dq_ref")


def finer(record: Record, loop: ClosedLoop) -> tuple[Record, list[Finding]]:
    """Return a record with its reference before that was rounded, and what to say.

    It is as it was where the controller had the rounded one, or it makes no difference. Taken is
    the one that the commands tell, if rounding it may give the logged one; else a smooth one.
    """
    if record.q_ref is None or loop.controller.kind == "none":
        return record, []
    step = parity.grid(record.q_ref[:, 0])
    if not step:
        return record, []
    other = record.replace(q_ref=smoothed(record.q_ref[:, 0], step))
    before, after = (_checked(r, loop) for r in (record, other))
    if before is None or after is None or not after.after < MOST**0.5 * before.after:
        return record, []
    told = _told(record.q_ref[:, 0], step, other, after)
    which = "a smooth one" if told is None else "the one that the commands tell"
    other, left = (other, after.after) if told is None else told
    text = (
        f"q_ref is rounded to {quantity(step, JOINTS[loop.joint].length, 3)}, and the controller "
        f"had a finer one: with it the law is off the command by {percent(before.after)}, with "
        f"{which}, which is taken, by {percent(left)}; log more digits"
    )
    return other, [Finding(text, fatal=False)]


def _checked(record: Record, loop: ClosedLoop) -> Parity | None:
    """Return how the law compares, None if there is none."""
    try:
        return parity.check(record, loop.known(record), read=False)
    except IVToolsError:
        return None


def _told(
    rounded: Array, step: float, smooth: Record, checked: Parity
) -> tuple[Record, float] | None:
    """Return a record with the reference that its commands tell, and the parity error with that.

    None if no law, as declared or as found with a `smooth` reference, tells one that rounding makes
    the logged one, (n_samples,).
    """
    for loop in _may_be(checked):
        reference = implied(rounded, smooth, loop)
        if reference is not None and _rounds(reference, rounded, step):
            record, law = smooth.replace(q_ref=reference), loop.controller
            signals = parity.Signals(record, loop)
            return record, signals.share(signals.error(law, law.delay, 0.0))
    return None


def _may_be(checked: Parity) -> list[ClosedLoop]:
    """Return the loops whose reference a smooth one may stand for: as declared, and as found.

    None of a controller that takes several samples for each of the log.
    """
    if checked.oversampling > 1:
        return []
    found = checked.loop.controller
    stated = replace(checked.declared, limit=found.limit)
    way = other_derivative(stated.reference_derivative)
    laws = [stated, replace(stated, reference_derivative=way)]
    laws += [found] if found != stated else []
    return [replace(checked.loop, controller=law) for law in laws]


def implied(rounded: Array, record: Record, loop: ClosedLoop) -> Array | None:
    """Return the reference with which the loop's law gives its commands, (n_samples,), if any.

    By the inverse of the law's response to its reference. What the commands do not tell, before the
    record, after it, and while the velocity is a guess, is such that the reference is smooth there,
    and near to what was logged, (n_samples,).
    """
    controller, n = loop.controller, record.n_samples
    size = fft.next_fast_len(2 * n, real=True)
    z = np.exp(2j * np.pi * fft.rfftfreq(size))
    z[0] = z[1]  # at rest an integrator answers without end
    forward = reference_response(controller, z, record)
    least = LEAST_RESPONSE * np.median(np.abs(forward))
    if not least:
        return None
    inverse = forward.conj() / (np.abs(forward) ** 2 + least**2)
    first, last = len(controller.law(record.dt).taps) - 1, n - controller.delay - 1
    unknown = [*range(-PARITY_HEAD, first), *range(last, last + PARITY_HEAD)]
    asked = fft.irfft(inverse, size)  # of the reference, by one sample of the error
    free = np.column_stack([np.roll(asked, k)[:n] for k in unknown])
    reference = references(record, controller)[0]
    for _ in range(IMPLIED):
        known = record.replace(q_ref=reference)
        error = parity.Signals(known, loop).error(controller, controller.delay, 0.0)
        told = np.append(np.zeros(first), error[controller.delay :][first:last])
        reference = reference + fft.irfft(inverse * fft.rfft(told, size), size)[:n]
        left = np.append(_ends(reference - rounded), _ends(reference, ROUGHNESS))
        ways = np.vstack([_ends(free), _ends(free, ROUGHNESS)])
        reference -= free @ np.linalg.lstsq(ways, left, rcond=DEPENDENT)[0]
    return reference


def _ends(x: Array, order: int = 0) -> Array:
    """Return signals, (n_samples, ...), near their ends, or their differences of an order."""
    return np.concatenate([np.diff(part, order, axis=0) for part in (x[:ENDS], x[-ENDS:])])


def _rounds(x: Array, rounded: Array, step: float) -> bool:
    """Whether rounding a signal to a step may give another one."""
    off = (rounded - x) / step
    return bool(np.mean(off**2) < SMOOTHED[0] and np.max(np.abs(off)) < SMOOTHED[1])


def smoothed(x: Array, step: float) -> Array:
    """Return a rounded signal, (n_samples,), as smooth as its step allows.

    By the lowest of the cut-offs, without delay, that leaves no more than rounding does: a
    twelfth of a step's square.
    """
    for cutoff in np.geomspace(*SMOOTHEST):
        sos = signal.butter(3, cutoff, output="sos")
        y = signal.sosfiltfilt(sos, x, padlen=min(len(x) - 1, int(EDGES / cutoff)))
        if _rounds(y, x, step):
            return np.asarray(y)
    return x


def origin(record: Record, terms: Iterable[Term], loop: ClosedLoop) -> float:
    """Return from where positions are better counted, m or rad; 0 if from where they are.

    A stroke away the period of what repeats over them decides its phase. It is a round number, of
    turns if they are enough or gravity turns with the angle; where a law of one's own, or a
    controller, may know the position itself, it stays.

    Parameters
    ----------
    record : Record
    terms : iterable of Term
        That act on the axis, or may.
    loop : ClosedLoop
    """
    law, own = loop.controller, any(TERMS.get(t.name) is not t for t in terms)
    if own or law.kind == "state-space" or {"q", "q_ref"} & {*law.columns}:
        return 0.0
    q = record.q[:, 0]
    stroke, middle = float(np.ptp(q)), 0.5 * float(np.max(q) + np.min(q))
    if abs(middle) < stroke:
        return 0.0
    turns = 2.0 * np.pi * float(np.round(middle / (2.0 * np.pi)))
    hangs = any(name.startswith("gravity") for name in (*loop.names, *law.feedforward))
    if loop.joint == "revolute" and (hangs or abs(middle - turns) < stroke):
        return turns
    unit = ROUND ** float(np.floor(np.log10(stroke)))
    return float(unit * np.round(middle / unit))


def counted(record: Record, start: float) -> Record:
    """Return a record with its positions counted from another one, m or rad."""
    q_ref = None if record.q_ref is None else record.q_ref - start
    return record.replace(q=record.q - start, q_ref=q_ref)


def near(start: float, loop: ClosedLoop) -> Finding:
    """Return what to say of positions that are counted from another one."""
    turns = start / (2.0 * np.pi)
    whole = loop.joint == "revolute" and abs(turns - round(turns)) < ROUNDING
    where = f"{turns:.0f} turns" if whole else f"{start:.9g} {JOINTS[loop.joint].length}"
    text = (
        "the axis moves more than its stroke away from the zero of its positions: in this answer, "
        f"and in the parameters of what is named, it is counted from {where}"
    )
    return Finding(text, fatal=False)


class Moved(NamedTuple):
    """A record whose command, or reference, was some samples before it was logged.

    Attributes
    ----------
    samples : int
        After it if negative.
    record : Record
    checked : Parity
    """

    samples: int
    record: Record
    checked: Parity

    @classmethod
    def by(
        cls, samples: int, record: Record, loop: ClosedLoop, names: Iterable[str] = COMMANDS
    ) -> Moved:
        """Move the command of a record, or signals of other names."""
        other = earlier(record, samples, names)
        return cls(samples, other, parity.check(other, loop, read=False, oversampling=1))


def lateness(record: Record, loop: ClosedLoop, checked: Parity) -> Moved | None:
    """Return a record with its command by as many samples earlier as it may have been logged late.

    By how many more than the axis file says it follows the position; ahead of the position no law
    can be, but a log can. None if it is by none, or the law explains little at any time, or another
    law, which the record is asked for, explains it as logged.
    """
    poor = checked.after > PARITY_POOR
    if poor and parity.another(record, checked):
        return None
    ahead = checked.delay == 0 and checked.after > ROUNDING
    tried = {}
    for samples in LATENESS if poor else LATENESS[:1] if ahead else ():
        tried[samples] = one = Moved.by(samples, record, loop)
        better = one.checked.after < MOST * checked.after
        if better and one.checked.delay == loop.controller.delay:
            return one
    late = checked.delay - loop.controller.delay
    return None if poor or not late else tried.get(late) or Moved.by(late, record, loop)


def misplaced(record: Record, loop: ClosedLoop, checked: Parity, known: int = 0) -> Moved | None:
    """Return a record with its reference by as many samples elsewhere as it may have been logged.

    Before or after the controller takes it, or late as the position is, which it need not be. It is
    if the law explains the command so with all its settings as declared, better than with others,
    or much better than it does as logged; where another record of the axis has it, as `known`,
    noise may hide it, and as well is enough.
    """
    if not checked.mismatch and checked.after <= PARITY_POOR:
        return None
    law = replace(loop.controller, limit=checked.loop.controller.limit)

    def left(samples: int) -> float:
        """Return the relative parity error of the law as declared, with the reference moved."""
        signals = parity.Signals(earlier(record, samples, REFERENCES), loop)
        return signals.share(signals.error(law, law.delay, 0.0))

    samples = known or min(MISPLACED, key=left)
    much = GAIN_NEEDED if known else 1.0 / GAIN_NEEDED if checked.mismatch else MOST**0.5
    if parity.another(record, checked):  # there is a law that explains all, as logged or so
        much = LITTLE
    most = min(much * checked.after, LAW_ERROR)
    if not left(samples) < GAIN_NEEDED * most:  # with no setting changed it will not be less
        return None
    moved = Moved.by(samples, record, loop, REFERENCES)
    right = not moved.checked.mismatch and moved.checked.delay == law.delay
    return moved if right and moved.checked.after < most else None


def earlier(record: Record, samples: int, names: Iterable[str]) -> Record:
    """Return a record whose signals of some names were samples before; later if negative."""
    start, stop = max(-samples, 0), record.n_samples - max(samples, 0)
    part, signals = record.slice(start, stop), {}
    for name in names:
        if (whole := getattr(record, name)) is not None:
            signals[name] = whole[start + samples : stop + samples]
    return part.replace(**signals)


def late(samples: int, left: float) -> Finding:
    """Return what to say of a command that was logged late, or early.

    Parameters
    ----------
    samples : int
        By which; early if negative.
    left : float
        Share of the base model's force error with a controller of that delay that is left.
    """
    count = plural(abs(samples), "sample")
    text = (
        f"the command is logged {count} {'after' if samples > 0 else 'before'} it acts: with the "
        f"log put right the base model's force error is {percent(left)} of what it is with a "
        "controller of that delay"
    )
    return Finding(text, fatal=False)


def elsewhere(samples: int, before: float, after: float) -> Finding:
    """Return what to say of a reference that was logged before or after the controller takes it.

    Parameters
    ----------
    samples : int
        After it; before it if negative.
    before, after : float
        Relative parity error with other settings, and with the reference put right.
    """
    count = plural(abs(samples), "sample")
    text = (
        f"the reference is logged {count} {'after' if samples > 0 else 'before'} the control law "
        f"takes it: put right, the law with its settings as declared leaves {100 * after:.2g} % of "
        f"the command, at best {100 * before:.2g} % as logged"
    )
    return Finding(text, fatal=False)


def derived(controller: Controller, before: float, after: float) -> Finding:
    """Return what to say of a controller that derives its reference otherwise than the axis file.

    Parameters
    ----------
    controller : Controller
        As the records show it.
    before, after : float
        Relative parity error with the reference derived as the axis file says, and so.
    """
    way = controller.reference_derivative
    text = (
        f"the controller makes derivatives of its reference by {way} differences: so the law "
        f"leaves {100 * after:.2g} % of the command, otherwise {100 * before:.2g} % at best; state "
        f'reference_derivative = "{way}" in [controller]'
    )
    return Finding(text, fatal=False)


def faster(found: Parity) -> Finding:
    """Return what to say of a controller that takes several samples for each of the log."""
    why = (
        "at that rate the settings of the axis file explain the command, at the rate of the log "
        "only other settings would"
    )
    if found.mismatch:
        why = "another log shows its rate"
    text = (
        f"the controller takes {found.oversampling} samples for each of the log: {why}; it is "
        "simulated at its own rate, and the log is interpolated"
    )
    return Finding(text, fatal=False)


def noisy(found: Parity) -> Finding:
    """Return what to say of a law that gives the command at the frequencies of the motion alone."""
    text = (
        f"below {found.below:.2g} Hz, where the motion is, the law gives the command to "
        f"{percent(found.after)}; above it command and logged position have noise that is not the "
        "other's: of a sensor, of rounding, or of what a controller that is faster than the log "
        "saw between its samples"
    )
    return Finding(text, fatal=False)


def beyond_the_log(hz: float, rate: float) -> Finding:
    """Return what to say of a filter at `hz` that a log of this rate, Hz, cannot show."""
    text = (
        f"the filter in [controller] at {hz:g} Hz is not below half of the log's rate ({rate:g} "
        "Hz), and the command shows no faster controller: the diagnosis goes on without the filter"
    )
    return Finding(text, fatal=False)
