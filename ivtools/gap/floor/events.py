"""Events: stretches of a record that stand far above its noise, in short or in long windows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..rules import EVENT, EVENT_SPREAD, LASTING, LASTING_EVENT, LEAST_WINDOW, LITTLE, WINDOW

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def windows(
    x: Array, keep: Mask, dt: float, seconds: float = WINDOW
) -> tuple[Array, NDArray[np.int_], int]:
    """Return the mean of each window, how many samples of it count, and its width."""
    values, counts = _cut(x, keep, dt, seconds)
    return values.sum(axis=1) / np.maximum(counts, 1), counts, values.shape[1]


def _cut(x: Array, keep: Mask, dt: float, seconds: float) -> tuple[Array, NDArray[np.int_]]:
    """Return the samples of each window, 0 where they do not count, and how many of them do."""
    width = max(round(seconds / dt), LEAST_WINDOW)
    shape = len(x) // width, width
    used = slice(shape[0] * width)
    return np.where(keep, x, 0.0)[used].reshape(shape), keep[used].reshape(shape).sum(axis=1)


def unchanged(q: Array) -> Mask:
    """Return the samples at which the sensor shows what it showed before, (n_samples,).

    There its rounding is no noise: it follows the motion, and comes slower than that.
    """
    return np.diff(q, prepend=np.nan) == 0.0


def events(white: Array, keep: Mask, dt: float, rounded: Mask) -> Mask:
    """Return the samples of windows far above the floor, (n_samples,).

    Parameters
    ----------
    white : ndarray, (n_samples,)
        Whitened error.
    keep : ndarray of bool, (n_samples,)
        Samples that count.
    dt : float
    rounded : ndarray of bool, (n_samples,)
        `unchanged` samples: the more of a window, the further it may be off.
    """
    energy, counts, width = _energy(white, keep, dt, WINDOW)
    off = _deviation(energy, counts >= (1.0 - LITTLE) * width) / _allowed(rounded, dt, WINDOW)
    return _around(off > EVENT, width, keep)


def lasting(white: Array, keep: Mask, dt: float, rounded: Mask) -> Mask:
    """Return the samples of longer windows above the floor or off zero, (n_samples,).

    A weak force that acts for a while shows in no short window: in a longer one its energy or its
    mean does. Parameters are those of `events`.
    """
    energy, counts, width = _energy(white, keep, dt, LASTING)
    full = counts >= (1.0 - LITTLE) * width
    means, *_ = windows(white, keep, dt, LASTING)
    off = np.abs(_deviation(means * np.sqrt(counts), full, 1.0))  # noise has variance 1
    off = np.maximum(_deviation(energy, full), off) / _allowed(rounded, dt, LASTING)
    return _around(off > LASTING_EVENT, width, keep)


def _allowed(rounded: Mask, dt: float, seconds: float) -> Array:
    """Return by how much each window may be further off for the rounding of the sensor, (n,)."""
    still, *_ = windows(rounded.astype(float), np.ones(len(rounded), dtype=bool), dt, seconds)
    return 1.0 + still


def _energy(
    white: Array, keep: Mask, dt: float, seconds: float
) -> tuple[Array, NDArray[np.int_], int]:
    """Return what `windows` does of the energy, but without the largest samples of each window.

    Noise with heavy tails has a few that are far off; what pushes the axis lasts longer.
    """
    values, counts = _cut(white**2, keep, dt, seconds)
    width = values.shape[1]
    rest = width - max(round(LITTLE * width), 1)
    small = np.partition(values, rest, axis=1)[:, :rest]
    return small.sum(axis=1) / np.maximum(counts + rest - width, 1), counts, width


def _deviation(x: Array, full: Mask, least: float | None = None) -> Array:
    """Return how far each window that counts is from the median, in robust deviations, (n,).

    Parameters
    ----------
    x : ndarray, (n,)
    full : ndarray of bool, (n,)
        Which windows count.
    least : float, optional
        Least deviation; `EVENT_SPREAD` of the median without.
    """
    if not full.any():
        return np.zeros(len(x))
    middle = float(np.median(x[full]))
    least = EVENT_SPREAD * middle if least is None else least
    spread = max(1.4826 * float(np.median(np.abs(x[full] - middle))), least)
    return np.where(full, (x - middle) / max(spread, 1e-300), 0.0)


def _around(bad: Mask, width: int, keep: Mask) -> Mask:
    """Return the samples of windows, of those beside them, and of no others, (n_samples,)."""
    mask = np.zeros(len(keep), dtype=bool)
    mask[: len(bad) * width] = np.repeat(ndimage.binary_dilation(bad), width)
    return mask & keep


def stretches(mask: Mask, t: Array) -> tuple[tuple[float, float], ...]:
    """Return start and end, s, of every run of a mask."""
    edges = np.flatnonzero(np.diff(np.r_[False, mask, False].astype(int)))
    return tuple(
        (float(t[a]), float(t[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)
    )
