"""The velocity as a controller has it: differences of the position, or a logged signal."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

WAYS = ("differences", "logged")
AT_THE_SAMPLE = (1.5, -0.5)  # weights of differences: the velocity at the sample, to second order
_LENGTHS = (1, 2, 3, 4, 6, 8)
_WORTH = 0.9  # of the residual that a longer filter may leave
_LONGEST = 200  # taps that stand for a low-pass filter
_REACH = 1e-5  # of a low-pass's answer that is cut off
_ROUNDING = 1e-9  # of the velocity: what is left below this is no reason for more taps
_AROUND = 4  # samples before and behind, whose differences a sensor's velocity resembles
_WAYS = (1, 8, 64, 256, 1024, 4096)  # samples
_NO_LATER, _NO_LARGER = 0.1, 0.02  # samples, and share, by which such a one may differ from them


def backward_difference(velocity_filter: ArrayLike, dt: float) -> Array:
    """Return the taps, 1/s, of the velocity as a controller forms it.

    The position passes an FIR filter, then a backward difference over one sample.

    Examples
    --------
    >>> backward_difference([0.5, 0.5], 0.001)
    array([ 500.,    0., -500.])
    """
    return np.convolve(np.asarray(velocity_filter, dtype=float), [1.0, -1.0]) / dt


def shown(q: Array, dq: Array, dt: float) -> tuple[float, ...] | None:
    """Return the FIR filter by which a logged velocity follows from differences of the position.

    A simulation has no log to take the velocity from. Its position has, and what the drive made of
    the measured one tells how: by an FIR filter of a few taps, or by a first-order low-pass, which
    is an FIR filter of many. None if it is a sensor's, or that of a simulator's state: positions
    that come later tell it as well as those which came before, and it is neither late, as all is
    that is made of past ones, nor of another size. None also where the steps of a coarse encoder
    hide it: then the weights do not sum to what the velocity is over long ways, which no step
    hides; what is made of positions with steps has these steps, and its weights are exact.

    Parameters
    ----------
    q, dq : (n_samples,) ndarray
        Measured position, and the velocity logged beside it.
    dt : float
        Sampling step, s.

    Examples
    --------
    >>> q = np.random.default_rng(0).normal(size=900).cumsum() * 1e-3
    >>> speed = np.convolve(np.diff(q, prepend=q[0]), [0.7, 0.3])[:900] / 0.01
    >>> np.round(shown(q, speed, 0.01), 6).tolist()
    [0.7, 0.3]
    """
    speed = np.diff(q, prepend=q[0]) / dt
    lags = [np.concatenate([np.zeros(i), speed[: len(speed) - i]]) for i in range(max(_LENGTHS))]
    best: tuple[float, ...]
    best, least = AT_THE_SAMPLE, np.inf
    rows = slice(max(_LENGTHS), None)
    rounding = _ROUNDING * float(np.linalg.norm(dq[rows]))
    for n in _LENGTHS:
        X = np.column_stack(lags[:n])[rows]
        weights = np.linalg.lstsq(X.T @ X, X.T @ dq[rows], rcond=1e-12)[0]
        left = float(np.linalg.norm(dq[rows] - X @ weights))
        if rounding + left < _WORTH * least:
            best, least = tuple(weights.tolist()), left
    slow, left = _low_pass(speed, dq, rows)
    if rounding + left < _WORTH * least:
        best, least = slow, left
    hidden = abs(sum(best) - _size(speed, dq)) > _NO_LARGER
    return None if hidden or _sensed(speed, dq, rows, least - rounding) else best


def _size(speed: Array, dq: Array) -> float:
    """Return how large a velocity is over ways as long as the axis makes, of differences, 1."""
    ways = [np.cumsum(x) for x in (speed, dq)]
    far = [[way[n:] - way[:-n] for way in ways] for n in _WAYS if n < len(speed)]
    true, said = max(far, key=lambda pair: float(np.mean(pair[0] ** 2)))
    return float(true @ said) / max(float(true @ true), 1e-300)


def _sensed(speed: Array, dq: Array, rows: slice, least: float) -> bool:
    """Whether a velocity is that at the sample, of which a filter of past positions leaves more.

    Each difference is the velocity half a sample before.
    """
    around = np.arange(1 - _AROUND, _AROUND + 1)
    X = np.column_stack([np.roll(speed, -i) for i in around])[rows][:-_AROUND]
    y = dq[rows][:-_AROUND]
    weights = np.linalg.lstsq(X.T @ X, X.T @ y, rcond=1e-12)[0]
    early = float(weights @ (around - 0.5))
    same = abs(weights.sum() - 1.0) < _NO_LARGER and early > -_NO_LATER
    return bool(same and _WORTH * np.linalg.norm(y - X @ weights) < least)


def _low_pass(speed: Array, dq: Array, rows: slice) -> tuple[tuple[float, ...], float]:
    """Return the taps of the first-order low-pass nearest to a velocity, and what it leaves."""
    X = np.column_stack([dq[:-1], speed[1:], speed[:-1]])[rows]
    pole, *gains = np.linalg.lstsq(X.T @ X, X.T @ dq[1:][rows], rcond=1e-12)[0]
    if not 0.0 < pole < 1.0:
        return AT_THE_SAMPLE, np.inf
    n = min(int(np.ceil(np.log(_REACH) / np.log(pole))) + 2, _LONGEST)
    taps = np.convolve(gains, pole ** np.arange(n - 1))[:n]
    left = dq - np.convolve(speed, taps)[: len(dq)]
    return tuple(taps.tolist()), float(np.linalg.norm(left[rows]))
