"""Metric: errors in which noise is white, and what is in doubt is discounted.

A diagnosis asks for it thousands of times on two threads, so each answer is one call of compiled
code: Python's lock, which goes from thread to thread with every call, takes longer than the sums.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numba import float64, int64, types, void
from numpy.typing import NDArray

from ivtools.compiled import cached, compiled
from ivtools.linalg.columns import filtered

Array = NDArray[np.float64]

_NO_ROWS, _NO_SHARES = np.zeros((0, 0)), np.zeros(0)


@dataclass(frozen=True, eq=False)
class Metric:
    """How large an error is.

    Parameters
    ----------
    taps : ndarray, (order + 1,)
        Polynomial that whitens the noise.
    at : ndarray of int, (n,)
        Samples that count.
    doubted : ndarray, (m, n), optional
        Orthonormal whitened errors that may be something else.
    shares : ndarray, (m,), optional
        By which share each of them is discounted.

    Examples
    --------
    >>> import numpy as np
    >>> metric = Metric(np.array([1.0, -0.5]), np.array([1, 2]))
    >>> metric(np.array([1.0, 1.0, 1.0])).tolist()
    [0.5, 0.5]
    >>> metric.left(np.array([1.0, 1.0, 1.0]), np.array([[1.0, 0.0]]))
    0.125
    """

    taps: Array
    at: NDArray[np.int64]
    doubted: Array = field(default_factory=lambda: _NO_ROWS)
    shares: Array = field(default_factory=lambda: _NO_SHARES)

    def __post_init__(self) -> None:
        for name in ("taps", "doubted", "shares"):  # compiled code takes them as they are
            one = np.ascontiguousarray(getattr(self, name), dtype=float)
            object.__setattr__(self, name, one)
        object.__setattr__(self, "at", np.ascontiguousarray(self.at, dtype=np.int64))

    def __call__(self, x: Array) -> Array:
        """Return signals (n_samples, ...) as they count, (n, ...)."""
        rows = np.ascontiguousarray(np.asarray(x, dtype=float).T).reshape(-1, len(x))
        white = _whitened(self.taps, rows, self.at, self.doubted, self.shares)
        return white.reshape(*x.T.shape[:-1], len(self.at)).T

    def discounted(self, white: Array) -> Array:
        """Return signals that are whitened and cut to what counts, (n, ...), discounted."""
        if not len(self.shares):
            return white
        rows = np.array(white.T, dtype=float, order="C").reshape(-1, len(white))
        _discounted(rows, self.doubted, self.shares)
        return rows.reshape(white.T.shape).T

    def left(self, x: Array, rows: Array) -> float:
        """Return the mean square of what orthonormal rows (k, n) leave of a whitened signal."""
        return float(_left(self.taps, np.ascontiguousarray(x[np.newaxis]), self.at, rows))


_INDICES = types.Array(int64, 1, "C", readonly=True)


@compiled
def _kept(taps: Array, x: Array, at: NDArray[np.int64]) -> Array:
    """Filter rows, (k, N), and return them at the samples that count, (k, n)."""
    white = filtered(taps, x)
    out = np.empty((x.shape[0], at.size))
    for j in range(x.shape[0]):
        for i in range(at.size):
            out[j, i] = white[j, at[i]]
    return out


@compiled
def _discount(white: Array, doubted: Array, shares: Array) -> None:
    """Discount rows, (k, n), in place."""
    for j in range(white.shape[0]):
        part = np.dot(doubted, white[j])
        part *= shares
        white[j] -= np.dot(part, doubted)


@cached(float64[:, ::1](float64[::1], float64[:, ::1], _INDICES, float64[:, ::1], float64[::1]))
def _whitened(taps: Array, x: Array, at: NDArray[np.int64], doubted: Array, shares: Array) -> Array:
    white = _kept(taps, x, at)
    if shares.size:
        _discount(white, doubted, shares)
    return white


@cached(void(float64[:, ::1], float64[:, ::1], float64[::1]))
def _discounted(white: Array, doubted: Array, shares: Array) -> None:
    _discount(white, doubted, shares)


@cached(float64(float64[::1], float64[:, ::1], _INDICES, float64[:, ::1]))
def _left(taps: Array, x: Array, at: NDArray[np.int64], rows: Array) -> float:
    white = _kept(taps, x, at)[0]
    parts = np.dot(rows, white)
    return float(np.dot(white, white) - np.dot(parts, parts)) / white.size
