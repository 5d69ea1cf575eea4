"""Autocovariance of a residual in segments, and what a fit takes from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def autocovariance(e: Array, lags: int, starts: NDArray[np.intp]) -> Array:
    """Return the autocovariances (lags + 1,) of e (N,), of pairs within a segment only.

    Examples
    --------
    >>> autocovariance(np.array([1.0, -1.0, 1.0, 1.0]), 1, np.array([0, 2])).tolist()
    [1.0, 0.0]
    """
    total = np.zeros(lags + 1)
    for part in np.split(e, starts[1:]):
        top = min(lags, len(part) - 1)
        size = 1 << (2 * len(part) - 1).bit_length()
        power = np.abs(np.fft.rfft(part, size)) ** 2
        total[: top + 1] += np.fft.irfft(power)[: top + 1]
    return total / len(e)


def burg(e: Array, lags: int, starts: NDArray[np.intp]) -> Array:
    """Return the autocovariances (lags + 1,) of Burg's autoregression of e (N,).

    Its reflection coefficients make the prediction errors of both directions of time least, within
    segments only, so nothing leaks over their ends. Noise that the loop or a differentiation has
    emptied of low frequencies, in the short segments that a mask leaves, has a spectrum that leaks:
    the autocovariance of its pairs tells a third too much of the shocks.

    References
    ----------
    J. P. Burg, *Maximum Entropy Spectral Analysis*, Stanford University, 1975.

    Examples
    --------
    >>> burg(np.array([1.0, -1.0, 1.0, 1.0]), 1, np.array([0, 2])).tolist()
    [1.0, 0.0]
    """
    first = np.zeros(len(e), dtype=np.intp)  # of its segment, for each row
    first[starts[1:]] = np.diff(starts)
    age = np.arange(len(e)) - np.cumsum(first) - starts[0]
    forth, back = np.array(e, dtype=float), np.array(e, dtype=float)
    variance = float(np.mean(e**2))
    acov, inverse = [variance], np.ones(1)
    for m in range(1, lags + 1):
        now = np.flatnonzero(age >= m)
        f, b = forth[now], back[now - 1]
        power = float(f @ f + b @ b)
        k = -2.0 * float(f @ b) / power if power > 0.0 else 0.0
        acov.append(-k * variance - float(inverse[1:] @ acov[:0:-1]))
        forth[now], back[now] = f + k * b, b + k * f
        inverse = np.append(inverse, 0.0) + k * np.append(inverse, 0.0)[::-1]
        variance *= 1.0 - k * k
    return np.array(acov)


def taken(inverse: Array, sigma: float, Q: Array, lags: int, adds: bool = True) -> Array:
    """Return the autocovariances (lags + 1,) that a fit takes from noise of a model, in the mean.

    A fit by columns that Q spans leaves (I - P) e of the noise e, where P = Q Q' projects on
    them. Of the covariance S of the noise that leaves S - P S - S P + P S P. What it takes is
    little of the whole. But the columns move at few frequencies, where it is a tenth of the noise
    or more, and a model of the residual makes intervals too narrow by half of that.

    Parameters
    ----------
    inverse : (order + 1,) ndarray
        Polynomial that whitens the noise, 1, -a1, ...
    sigma : float
        Deviation of the white noise behind it.
    Q : (N, k) ndarray
        Orthonormal columns, or the rows of such that this noise belongs to.
    lags : int
    adds : bool
        Whether the fit also adds. What it takes leaks into frequencies with hardly any noise, and
        the residual has more there, in the mean. A single one need not have so much to give back.

    References
    ----------
    D. A. Harville, "Maximum likelihood approaches to variance component estimation and to related
    problems", J. American Statistical Association 72, 1977.

    Examples
    --------
    >>> Q = np.full((50, 1), 50**-0.5)
    >>> taken(np.ones(1), 1.0, Q, 1).round(4)  # white: 1/50, and 49/50 of that
    array([0.02  , 0.0196])
    """
    n = len(Q)
    size = 1 << (2 * n - 1).bit_length()
    power = sigma**2 / np.abs(np.fft.rfft(inverse, size)[:, np.newaxis]) ** 2
    SQ = np.fft.irfft(power * np.fft.rfft(Q, size, axis=0), size, axis=0)[:n]
    R = 2.0 * SQ - Q @ (Q.T @ SQ)  # Q R' + R Q' is twice what is taken
    cross = np.fft.rfft(Q, size, axis=0) * np.conj(np.fft.rfft(R, size, axis=0))
    spectrum = cross.real.sum(axis=1) / n
    return np.fft.irfft(spectrum if adds else np.maximum(spectrum, 0.0), size)[: lags + 1]


def segment_starts(t: Array, joints: NDArray[np.int_]) -> NDArray[np.intp]:
    """Return the first rows (m,) of segments of equal spacing and one joint.

    Examples
    --------
    >>> segment_starts(np.array([0.0, 0.1, 0.2, 0.9, 1.0]), np.zeros(5, dtype=int)).tolist()
    [0, 3]
    """
    steps = np.diff(t)
    gap = (steps > 1.5 * np.median(steps)) | (steps < 0.0) | (np.diff(joints) != 0)
    return np.concatenate([[0], np.flatnonzero(gap) + 1]).astype(np.intp)
