"""Repeats: what differs from pass to pass of one motion, or between two records of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ...record import Record
from ..fit import Fit
from ..rules import DEEPEST, LEAST_PAIRS, LEAST_PERIOD, MOST_PERIODS, NO_MOTION, PERIODIC, SOME

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def reference_period(record: Record) -> float | None:
    """Return the period of the reference, s, if it repeats itself at least once."""
    assert record.q_ref is not None
    x = record.q_ref[:, 0] - np.mean(record.q_ref[:, 0])
    n, least = len(x), max(LEAST_PERIOD, len(x) // MOST_PERIODS)
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(x, size)
    product = np.fft.irfft(np.abs(spectrum) ** 2, size)[: n // 2 + 1]
    total = np.cumsum(x**2)
    lags = np.arange(n // 2 + 1)
    energy = total[n - 1 - lags] + total[-1] - np.concatenate([[0.0], total[: n // 2]])
    mismatch = 1.0 - 2.0 * product / np.maximum(energy, 1e-300)
    away = np.flatnonzero(mismatch > SOME)
    if not len(away):
        return None
    start = max(away[0], least)
    good = np.flatnonzero(mismatch[start:] < PERIODIC)
    if not len(good):
        return None
    at = start + good[0]
    return float((at + int(np.argmin(mismatch[at : at + DEEPEST]))) * record.dt)


def passes(raw: Array, keep: Mask, period: float | None, dt: float) -> float | None:
    """Return the pass-to-pass difference over sqrt(2), detrended, N or N m."""
    if period is None:
        return None
    lag = round(period / dt)
    return _difference(raw[lag:], raw[:-lag], keep[lag:] & keep[:-lag])


def between(one: Fit, two: Fit) -> float | None:
    """Return the difference of the force errors of two records of the same motion, over sqrt(2).

    None if reference, known inputs or length differ.
    """
    a, b = one.fold, two.fold
    if not _same(a.record, b.record):
        return None
    return _difference(one.whole_error, two.whole_error, a.keep & b.keep)


def _same(one: Record, two: Record) -> bool:
    if one.n_samples != two.n_samples:
        return False
    pairs = [(one.q_ref, two.q_ref), (one.added, two.added)]
    filled = [[np.zeros(1) if x is None else x for x in pair] for pair in pairs]
    return all(bool(np.max(np.abs(x - y)) <= NO_MOTION * np.max(np.abs(x))) for x, y in filled)


def _difference(x: Array, y: Array, keep: Mask) -> float | None:
    """Return the rms of a detrended difference over sqrt(2); None if it is too short."""
    difference = (x - y)[keep]
    if len(difference) < LEAST_PAIRS:
        return None
    return float(np.std(signal.detrend(difference)) / np.sqrt(2.0))
