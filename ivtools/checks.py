"""What a record must obey, and what about it is worth telling."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ivtools.clock import Clock
from ivtools.columns import column_name
from ivtools.errors import RecordError, ShapeError
from ivtools.limits import LARGEST

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ivtools.record import Record

__all__ = ["check", "doubts", "findings"]

MIN_SAMPLES = 200
MAX_JITTER = 0.01  # of the step
SLOWEST_HZ, FASTEST_HZ = 20.0, 1e6  # sampling outside suggests that t is not in s
FASTEST_MOTION = 1000.0  # m/s or rad/s
LOGGERS = 0.35  # of the step; what jitters less, around a steady clock, is the logger and not it
MUST_VARY = ("q", "q_ref", "nu", "tau", "dq")
COUNTED = "rows of data count from 0"


def check(record: Record) -> None:
    """Refuse a record that breaks a rule.

    Raises
    ------
    ShapeError
        Signals of different lengths or numbers of joints.
    RecordError
        Too few samples, NaN, infinity, time that does not run evenly, a dead signal.
    """
    _check_shapes(record)
    _check_values(record)
    _check_time(record)
    _check_motion(record)


def findings(record: Record) -> tuple[str, ...]:
    """Return facts worth telling: jitter that was accepted, joints that stand still."""
    found = []
    rounding = 4 * np.spacing(np.abs(record.t).max())
    if record.jitter > 1e-9 and record.jitter * record.dt > rounding:
        found.append(f"t jitters by {100 * record.jitter:.2g} % of its step: accepted")
    still = np.flatnonzero(np.ptp(record.q, axis=0) == 0)
    found += [f"{column_name('q', int(j), record.n_joints)} stands still throughout" for j in still]
    return tuple(found)


def doubts(record: Record) -> tuple[str, ...]:
    """Return signs of a wrong unit that the record alone gives away."""
    signs = []
    if not SLOWEST_HZ <= record.sampling_hz <= FASTEST_HZ:
        signs.append(f"t implies a sampling rate of {record.sampling_hz:.3g} Hz; is it in s?")
    speed = np.abs(np.diff(record.q, axis=0)).max(axis=0) / record.dt
    for joint in np.flatnonzero(speed > FASTEST_MOTION):
        column = column_name("q", int(joint), record.n_joints)
        signs.append(f"{column} implies a speed of {speed[joint]:.3g} per s; is it in m or rad?")
    return tuple(signs)


def _check_shapes(record: Record) -> None:
    n = record.n_samples
    for signal, values in record.signals.items():
        if len(values) != n:
            raise ShapeError(f"{signal} has {len(values)} samples and t {n}; both must match")
        if values.shape[1] != record.n_joints:
            raise ShapeError(
                f"{signal} has {values.shape[1]} joints and q {record.n_joints}; both must match"
            )
    for name, column in record.extra.items():
        if len(column) != n:
            raise ShapeError(f"{name} has {len(column)} samples and t {n}; both must match")
    if n < MIN_SAMPLES:
        raise RecordError(f"t has {n} samples, fewer than {MIN_SAMPLES}; log a longer record")
    if not record.n_joints:
        raise ShapeError("q has no column; give one per joint")
    if record.nu is None and record.tau is None:
        raise RecordError("columns nu and tau are missing; log the command or the force")


def _check_values(record: Record) -> None:
    further = {name: column[:, None] for name, column in record.extra.items()}
    for signal, values in {"t": record.t[:, None], **record.signals, **further}.items():
        broken = ~np.isfinite(values)
        if broken.any():
            row, joint = (int(i) for i in np.argwhere(broken)[0])
            kind = "NaN" if np.isnan(values[row, joint]) else "infinite"
            own = signal in record.signals
            column = column_name(signal, joint, record.n_joints) if own else signal
            raise RecordError(
                f"{column} is {kind} at row {row} ({COUNTED}); keep a part without it"
            )
        if signal != "t":
            _check_size(signal, values, record.n_joints)


def _check_time(record: Record) -> None:
    t, step = record.t, np.diff(record.t)
    _check_breaks(record)
    if step.min() <= 0:
        row = int(np.argmax(step <= 0)) + 1
        what = "goes back" if step[row - 1] < 0 else "stands still"
        raise RecordError(
            f"t {what} at row {row} ({COUNTED}), {t[row - 1]:.9g} s and then {t[row]:.9g} s; "
            "keep one run in the order of time"
        )
    if not record.jitter <= MAX_JITTER:
        off = ~(np.abs(step - record.dt) <= MAX_JITTER * record.dt)
        off[np.array(record.breaks, dtype=int) - 1] = False
        row = int(np.argmax(off)) + 1
        raise RecordError(
            f"t jitters by {100 * record.jitter:.3g} % of its step, more than 1 %, first at row "
            f"{row} ({COUNTED}); {_jitter_remedy(t)}"
        )
    if not 1.0 / LARGEST < record.dt < LARGEST:
        raise RecordError(f"t has steps of {record.dt:.3g} s, which is not plausible; give s")


def _check_breaks(record: Record) -> None:
    edges = np.diff([0, *record.breaks, record.n_samples])
    if record.breaks and edges.min() < MIN_SAMPLES:
        raise RecordError(
            f"breaks = {record.breaks} leave a stretch of {edges.min()} samples, fewer than "
            f"{MIN_SAMPLES}; leave it out"
        )


def _jitter_remedy(t: NDArray[np.float64]) -> str:
    """Say what the stamps look like, and what to write in the axis file for that."""
    try:
        clock = Clock.of(t)
    except (ValueError, ArithmeticError, np.linalg.LinAlgError):
        return "keep a part without lost samples or resample to a constant rate"
    if len(clock.missing):
        return (
            f"samples are missing {len(clock.missing)} times, first before row "
            f'{clock.missing[0]}: write [record] gaps = "longest" to use the longest stretch, or '
            '"all"'
        )
    if clock.jitter <= LOGGERS:
        return (
            f"the stamps lie around a steady {clock.rate:g} Hz: if the logger is late and not the "
            f"controller, write [record] rate = {clock.rate:.10g}, if the stamps are right, "
            "resample = true as well"
        )
    return (
        f"if the stamps are wrong and the controller's clock is steady, write [record] rate = "
        f"{clock.rate:.10g}; if they are right, resample = true as well"
    )


def _check_size(signal: str, values: NDArray[np.float64], n_joints: int) -> None:
    """Refuse numbers that no axis can make."""
    size = np.abs(values).max(axis=1) if len(values) else np.zeros(1)
    if size.max() < LARGEST:
        return
    row = int(np.argmax(size >= LARGEST))
    joint = int(np.argmax(np.abs(values[row])))
    raise RecordError(
        f"{column_name(signal, joint, n_joints)} is {values[row, joint]:.3g} at row {row} "
        f"({COUNTED}), which is not plausible; mend the file or keep a part without it"
    )


def _check_motion(record: Record) -> None:
    # A position may be held while something else excites the axis; unused channels may be zero.
    excited = any(x is not None and np.ptp(x) > 0 for x in (record.added, record.dq_ref))
    for signal in MUST_VARY:
        values = getattr(record, signal)
        varies = values is None or bool((np.ptp(values, axis=0) > 1.0 / LARGEST).any())
        if varies or (signal == "q_ref" and excited):
            continue
        remedy = "log a moving axis" if signal == "q" else f"log {signal} or leave it out"
        column = column_name(signal, 0, record.n_joints)
        raise RecordError(
            f"{column} is constant, {values[0, 0]:g} from row 0 to the end ({COUNTED}); {remedy}"
        )
