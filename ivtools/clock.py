"""The clock of a log: its rate, jitter and missing samples, and what is done about them."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, log10

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import RecordError

__all__ = ["Clock", "nice_rate", "regular"]

Array = NDArray[np.float64]
Signals = dict[tuple[str, str], Array]

_MISSING = 0.75  # of a step; stamps that stay later by more have a sample missing between them
_AROUND = 12  # stamps on either side that say how late they are; twice a long step more behind it
_EARLY, _FARTHEST = 0.25, 500  # quantile of them that counts, and the most of them
_AT_ONCE, _RARE = 8, 0.04  # rows over which a step is measured, if gaps are rarer than this
_LOOK_AT, _MOST = 20_000, 1000  # long steps looked at, and gaps told
_STRETCH = 200  # rows of the shortest stretch that is used beside others
_STEADY = 0.45  # of a step; stamps that stay this near to a steady clock are those of a logger
_SLIP = 0.02  # relative; a nominal rate that is this far from that of the stamps is another rate
_NICE = (3e-4, 1e-4, 3e-5, 1e-5, 1e-6)  # relative, by digits: how near a simple rate must be


@dataclass(frozen=True)
class Clock:
    """What the stamps of a log say.

    Attributes
    ----------
    rate : float
        Sampling rate, Hz: a whole or simple number where the stamps are that near to one.
    jitter : float
        Largest departure of a stamp from the steady clock, in steps.
    missing : ndarray of int, (k,)
        Rows before which samples are missing.
    """

    rate: float
    jitter: float
    missing: NDArray[np.intp]

    @property
    def steady(self) -> bool:
        """Whether only the stamps jitter, around a clock that does not."""
        return self.jitter <= _STEADY and not len(self.missing)

    @classmethod
    def of(cls, t: Array, rate: float | None = None) -> Clock:
        """Look at the stamps t, (n,), s, which do not go back; rate is the nominal one, Hz."""
        step = 1.0 / rate if rate else _typical_step(t)
        late = (t - t[0]) / step - np.arange(len(t))  # in steps
        missing = _jumps(late, t, step)
        slope = np.polyfit(np.arange(len(t)), late, 1)[0] if rate is None else 0.0
        rest = late - slope * np.arange(len(t))
        found = rate or nice_rate(1.0 / (step * (1.0 + slope)))
        return cls(found, float(np.max(np.abs(rest - np.median(rest)))), missing)


def _typical_step(t: Array) -> float:
    """Return the step of the clock, s: over some rows at once, so that what is late averages out.

    Where samples are missing all over it is the mean of the steps that are no gaps.
    """
    steps = np.diff(t)
    near = steps[steps < 1.6 * np.median(steps)] if np.median(steps) > 0 else steps
    if len(near) > (1.0 - _RARE) * len(steps) and len(t) > 2 * _AT_ONCE:
        return float(np.median(t[_AT_ONCE:] - t[:-_AT_ONCE])) / _AT_ONCE
    return float(near.mean()) if near.mean() > 0 else float(np.median(steps[steps > 0]))


def _shift(late: Array, row: int, length: float) -> float:
    """Return how much later the stamps are from a row on, behind a step of a length, in steps.

    A loop that was held up catches up by shorter steps and is then no later than before, so the
    earliest stamps behind the step count, some way behind a long one.
    """
    behind = min(_AROUND + int(2.0 * length), _FARTHEST)
    before, after = late[max(row - _AROUND, 0) : row], late[row : row + behind]
    return float(np.quantile(after, _EARLY) - np.quantile(before, _EARLY))


def _jumps(late: Array, t: Array, step: float) -> NDArray[np.intp]:
    """Return the rows before which samples are missing, and take those out of `late`.

    Such stamps are later, and stay so. The largest come first: beside one, a step that only
    jitters looks like another.
    """
    steps = np.diff(t)
    rows = np.flatnonzero(steps > (1.0 + 0.5 * _MISSING) * step) + 1
    rows = rows[np.argsort(-steps[rows - 1], kind="stable")][:_LOOK_AT]
    found: list[int] = []
    for row in rows.tolist():
        shift = _shift(late, row, steps[row - 1] / step)
        if shift > _MISSING and len(found) < _MOST:
            late[row:] -= max(round(shift), 1)
            found.append(row)
    return np.sort(np.array(found, dtype=np.intp))


def nice_rate(rate: float) -> float:
    """Return the simplest rate, or that of the simplest period, that a clock may mean.

    Examples
    --------
    >>> nice_rate(999.97), nice_rate(333.3)
    (1000.0, 333.3333333)
    """
    for digits, near in enumerate(_NICE, start=1):
        for simple in (_rounded(rate, digits), 1.0 / _rounded(1.0 / rate, digits)):
            if abs(simple / rate - 1.0) < near:
                return float(f"{simple:.10g}")
    return float(f"{rate:.10g}")


def _rounded(x: float, digits: int) -> float:
    return round(x, digits - 1 - floor(log10(x)))


def regular(
    t: Array | None, signals: Signals, rate: float | None, resample: bool, gaps: str
) -> tuple[Array, Signals, tuple[int, ...], tuple[str, ...]]:
    """Return time and signals at a steady rate, rows that begin behind a gap, and what was done.

    Parameters
    ----------
    t : ndarray, (n,), or None
        Stamps, s; without any the rate makes them.
    signals : dict of ndarray, (n,) or (n, n_joints)
        By any key.
    rate, resample, gaps
        As in `RecordFormat`.

    Raises
    ------
    RecordError
        Stamps go back, samples are missing, or the stamps have another rate.
    """
    if t is None:
        assert rate is not None  # the caller has looked
        n = len(next(iter(signals.values())))
        note = f"no time was logged: rows are 1/{rate:g} s apart"
        return np.arange(n) / rate, signals, (), (note,)
    if len(t) < 10 or not np.isfinite(t).all() or t[-1] <= t[0] or np.diff(t).min() < 0:
        return t, signals, (), ()  # the rules of a record say what is wrong
    clock = Clock.of(t, None if resample else rate)
    stretches, notes = _stretches(t, clock, gaps)
    parts = []
    for rows in stretches:
        own = {name: x[rows] for name, x in signals.items()}
        steady, own, told = _steady(t[rows], own, rate, resample)
        parts.append((steady, own))
        notes += [note for note in told if note not in notes]
    if len(parts) == 1:
        return (*parts[0], (), tuple(notes))
    breaks = np.cumsum([len(x) for x, _ in parts[:-1]])
    joined = {name: np.concatenate([own[name] for _, own in parts]) for name in signals}
    return np.concatenate([x for x, _ in parts]), joined, tuple(breaks.tolist()), tuple(notes)


def _steady(
    t: Array, signals: Signals, rate: float | None, resample: bool
) -> tuple[Array, Signals, list[str]]:
    """Return a stretch at a steady rate, and what was done."""
    notes: list[str] = []
    if rate is None or len(t) < 10:
        return t, signals, notes
    if resample:
        return *_resampled(t, signals, rate), [f"resampled to {rate:g} Hz, band-limited"]
    mean = (len(t) - 1) / (t[-1] - t[0])
    if abs(mean / rate - 1.0) > max(_SLIP, 2.0 / len(t)):
        raise RecordError(
            f"the stamps of t run at {mean:.6g} Hz and [record] rate = {rate:g}; write rate = "
            f"{nice_rate(mean):g}, or resample = true with it, or check the unit of t"
        )
    steps = np.diff(t)
    off = float(np.max(np.abs(steps * rate - 1.0)))
    if off > 1e-6:
        notes.append(f"t jitters by {100 * off:.2g} % around {rate:g} Hz: stamps were replaced")
    return t[0] + np.arange(len(t)) / rate, signals, notes


def _stretches(t: Array, clock: Clock, gaps: str) -> tuple[list[slice], list[str]]:
    """Return the rows of the stretches without missing samples that are used."""
    if not len(clock.missing):
        return [slice(0, len(t))], []
    if gaps == "refuse":
        row = clock.missing[0]
        raise RecordError(
            f"samples are missing {len(clock.missing)} times, first before row {row} (rows of data "
            f"count from 0), where t goes from {t[row - 1]:.9g} to {t[row]:.9g} s; write "
            '[record] gaps = "longest" to use the longest stretch, or "all"'
        )
    edges = np.concatenate([[0], clock.missing, [len(t)]])
    stretches = [slice(int(a), int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    long = [s for s in stretches if s.stop - s.start >= _STRETCH]
    told = f"samples are missing {len(clock.missing)} times:"
    if gaps == "all" and len(long) > 1:
        rows = sum(s.stop - s.start for s in long)
        return long, [f"{told} {len(long)} stretches are used, {rows} rows of {len(t)}"]
    most = max(stretches, key=lambda s: s.stop - s.start)
    where = f"rows {most.start} to {most.stop - 1} of {len(t)}"
    return [most], [f"{told} the longest stretch is used, {where}"]


def _resampled(t: Array, signals: Signals, rate: float) -> tuple[Array, Signals]:
    """Interpolate by splines to a grid fine enough, low-pass, and thin it to the rate."""
    from scipy.interpolate import CubicSpline
    from scipy.signal import resample_poly

    keep = np.concatenate([[True], np.diff(t) > 0])
    fine = max(1, int(np.ceil(2.0 * (len(t) - 1) / (t[-1] - t[0]) / rate)))
    steps = (t[-1] - t[0]) * rate * (1 + 1e-12)  # whole ones stay whole
    n = int(steps) + 1
    grid = t[0] + np.arange(max(int(steps * fine), (n - 1) * fine) + 1) / (rate * fine)

    def one(x: Array) -> Array:
        smooth = CubicSpline(t[keep], x[keep])(grid)
        mean = (len(t) - 1) / (t[-1] - t[0])
        if rate < mean * (1 - 1e-9):
            return np.asarray(resample_poly(smooth, 1, fine, axis=0, padtype="line"))[:n]
        return np.asarray(smooth[::fine][:n])

    return t[0] + np.arange(n) / rate, {name: one(x) for name, x in signals.items()}
