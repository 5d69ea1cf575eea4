"""Columns: signals as columns, filtered; which are independent, and what a space holds of them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numba import float64
from numpy.typing import NDArray
from scipy.linalg import qr

from ivtools.compiled import cached, compiled
from ivtools.linalg.solve import RANK_TOLERANCE, norms_of

Array = NDArray[np.float64]

#: Samples that are filtered at a time: signal and result fit the processor's nearest memory.
SPAN = 1024


def rms(x: Array) -> float:
    """Return the root mean square of a signal."""
    return float(np.sqrt(np.mean(x**2)))


def as_columns(signals: Iterable[Array]) -> Array:
    """Return signals (N,) as columns (N, k), each in one piece of memory, as filters read them.

    Examples
    --------
    >>> import numpy as np
    >>> as_columns([np.zeros(3), np.ones(3)]).tolist()
    [[0.0, 1.0], [0.0, 1.0], [0.0, 1.0]]
    """
    return np.array(list(signals), dtype=float).T


def fir(taps: Array, x: Array) -> Array:
    """Filter signals along the first axis, (N, ...), by a polynomial in the delay, from rest.

    Examples
    --------
    >>> import numpy as np
    >>> fir(np.array([1.0, -0.5]), np.array([1.0, 1.0, 1.0])).tolist()
    [1.0, 0.5, 0.5]
    """
    x = np.asarray(x, dtype=float)
    rows = np.ascontiguousarray(x.T).reshape(-1, len(x))
    return _filtered(np.ascontiguousarray(taps, dtype=float), rows).reshape(x.T.shape).T


@compiled
def filtered(taps: Array, x: Array) -> Array:
    """Filter rows, (k, N), tap by tap over spans that stay near the processor."""
    out = np.zeros_like(x)
    for j in range(x.shape[0]):
        for start in range(0, x.shape[1], SPAN):
            stop = min(start + SPAN, x.shape[1])
            for k in range(min(taps.size, stop)):
                first, tap = max(start, k), taps[k]
                y, late = out[j, first:stop], x[j, first - k : stop - k]
                for i in range(y.size):
                    y[i] += tap * late[i]
    return out


@cached(float64[:, ::1](float64[::1], float64[:, ::1]))
def _filtered(taps: Array, x: Array) -> Array:
    return filtered(taps, x)


def base_columns(X: Array, tolerance: float = RANK_TOLERANCE) -> NDArray[np.intp]:
    """Return the columns that span the others, by QR with pivoting of the scaled matrix.

    Parameters
    ----------
    X : (N, p) array_like
        Observation matrix.
    tolerance : float
        Smallest share of a column of unit norm that counts as independent.

    Returns
    -------
    (rank,) ndarray of int
        Indices in increasing order.

    References
    ----------
    M. Gautier, "Numerical calculation of the base inertial parameters of robots",
    Journal of Robotic Systems 8, 1991.

    Examples
    --------
    >>> import numpy as np
    >>> base_columns(np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 3.0], [1.0, 2.0, 1.0]])).tolist()
    [1, 2]
    """
    X = np.asarray(X, dtype=float)
    norms = np.linalg.norm(X, axis=0)
    scaled = X / np.where(norms > 0.0, norms, 1.0)
    R, order = qr(scaled, mode="r", pivoting=True)
    rank = int(np.count_nonzero(np.abs(np.diag(R)) > tolerance))
    return np.sort(order[:rank]).astype(np.intp)


def abs_diag_r(X: Array) -> Array:
    """Return |diag R| of the QR decomposition of X (N, p): what each column adds to those before.

    Examples
    --------
    >>> import numpy as np
    >>> abs_diag_r(np.array([[3.0, 1.0], [4.0, 1.0], [0.0, 2.0]])).round(4)
    array([5.  , 2.01])
    """
    return np.abs(np.diag(np.linalg.qr(np.asarray(X, dtype=float), mode="r")))


def orthonormal(columns: Array) -> Array:
    """Return an orthonormal basis (..., N, k) of the space of columns, whatever their sizes.

    Examples
    --------
    >>> import numpy as np
    >>> orthonormal(np.array([[3e9, 0.0], [4e9, 1.0]])).round(3)
    array([[-0.6, -0.8],
           [-0.8,  0.6]])
    """
    scale = np.maximum(np.linalg.norm(columns, axis=-2, keepdims=True), 1e-300)
    return np.asarray(np.linalg.qr(columns / scale)[0])


def independent(columns: Array, least: float, beside: Array | float = 0.0) -> Array:
    """Return the combinations of columns (N, k) that are orthonormal, (k, m), m <= k.

    By the normal equations, which take a fifth of the time of a QR of long columns, and tell
    columns apart down to 1e-7 of their sizes.

    Parameters
    ----------
    columns : ndarray, (N, k)
        Of whatever sizes.
    least : float
        Energy, of the largest, below which a combination of columns of unit size is left out.
    beside : ndarray, (k, k), optional
        Normal equations of what else counts as energy.

    Examples
    --------
    >>> import numpy as np
    >>> X = np.array([[3e9, 3e9, 0.0], [4e9, 4e9, 1.0]])
    >>> Q = X @ independent(X, 1e-12)
    >>> Q.shape, np.allclose(Q.T @ Q, np.eye(2))
    ((2, 2), True)
    """
    G = columns.T @ columns + beside
    size = np.sqrt(np.diag(G))
    size[size == 0.0] = 1.0
    values, vectors = np.linalg.eigh(G / size / size[:, np.newaxis])
    known = values > least * values.max(initial=0.0)
    return np.asarray(vectors[:, known] / np.sqrt(values[known]) / size[:, np.newaxis])


def projection(Z: Array, columns: Array) -> Array:
    """Project columns (N, k) on the space of Z (N, m), Z (Z'Z)^-1 Z' columns, by QR.

    Examples
    --------
    >>> import numpy as np
    >>> projection(np.ones((3, 1)), np.array([[0.0], [1.0], [2.0]])).ravel()
    array([1., 1., 1.])
    """
    if Z.shape[1] == 0:
        return np.zeros_like(columns)
    Q = np.linalg.qr(Z / norms_of(Z))[0]
    return Q @ (Q.T @ columns)
