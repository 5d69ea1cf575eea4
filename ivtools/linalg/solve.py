"""One solver for every linear system of the estimators: least squares and instruments, by QR.

Columns are scaled first, so that units do not matter, and no matrix is inverted. Least squares is
the instrumental-variable solution with Z = X.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from ivtools.errors import EstimationError, ShapeError

Array = NDArray[np.float64]
Weights = Array | Callable[[Array], Array]
"""Inverse variances of the rows (N,), or a function that whitens the columns (N, k) of a system."""

RANK_TOLERANCE = 1e-10  # of a pivot of the QR of unit-norm columns


def solve_iv(
    X: Array,
    y: Array,
    Z: Array | None = None,
    weights: Weights | None = None,
    names: Sequence[str] | None = None,
) -> Array:
    """Solve y = X theta + e by instrumental variables, Z'(y - X theta) = 0.

    Parameters
    ----------
    X : (N, p) array_like
        Observation matrix.
    y : (N,) array_like
        Measurement vector.
    Z : (N, m) array_like, optional
        Instruments, m >= p; surplus ones give two-stage least squares. None is least squares.
    weights : (N,) array_like or callable, optional
        Inverse variances of the rows, or a function that whitens columns (N, k) and keeps their
        number of rows; X, y and Z are all weighted.
    names : sequence of str, optional
        Names of the columns, for the messages.

    Returns
    -------
    (p,) ndarray
        theta.

    Raises
    ------
    ShapeError
        If the shapes do not fit or there are fewer rows than columns.
    EstimationError
        If columns depend on each other, or the instruments do not move with them; they are named.

    References
    ----------
    P. C. Young, *Recursive Estimation and Time-Series Analysis*, 2nd ed., Springer 2011, ch. 7.

    Examples
    --------
    >>> import numpy as np
    >>> X = np.column_stack([np.arange(5.0), np.ones(5)])
    >>> solve_iv(X, X @ [2.0, -1.0]).round(12)
    array([ 2., -1.])
    """
    X, y, Z = weighted(*check_system(X, y, Z), weights)
    A, Q, scale = _projected(X, Z, names)
    return _triangle_solve(A, Q.T @ y) / scale  # (p,)


def influence(X: Array, Z: Array | None = None) -> Array:
    """Return the rows (N, p) whose product with y is the estimate: theta = influence' y.

    Examples
    --------
    >>> import numpy as np
    >>> influence(np.ones((4, 1))).ravel().round(12)
    array([0.25, 0.25, 0.25, 0.25])
    """
    A, Q, scale = _projected(X, Z)
    return Q @ _triangle_solve(A, np.eye(len(A))).T / scale


def check_system(X: Array, y: Array, Z: Array | None = None) -> tuple[Array, Array, Array | None]:
    """Return X, y, Z as float arrays; refuse shapes that do not fit and numbers not finite."""
    X, y = np.asarray(X, dtype=float), np.asarray(y, dtype=float)
    Z = None if Z is None else np.asarray(Z, dtype=float)
    if X.ndim != 2 or y.ndim != 1 or (Z is not None and Z.ndim != 2):
        raise ShapeError(
            "X and Z must be (N, p) and (N, m) and y (N,); "
            f"X is {X.shape}, y {y.shape}, Z {None if Z is None else Z.shape}"
        )
    if len(X) != len(y) or (Z is not None and len(Z) != len(y)):
        raise ShapeError(
            f"X has {len(X)} rows, y {len(y)}, Z {len(X if Z is None else Z)}; all must match"
        )
    if len(X) <= X.shape[1]:
        raise ShapeError(
            f"{len(X)} rows are too few for {X.shape[1]} parameters; "
            "take a longer record, decimate or mask less"
        )
    if Z is not None and Z.shape[1] < X.shape[1]:
        raise ShapeError(
            f"{Z.shape[1]} instruments are too few for {X.shape[1]} parameters; "
            "give one per parameter at least"
        )
    for name, values in (("X", X), ("y", y), ("Z", Z)):
        if values is not None and not np.isfinite(values).all():
            row = int(np.argwhere(~np.isfinite(values))[0][0])
            raise EstimationError(
                f"{name} has a value that is not finite in row {row}; estimates need finite numbers"
            )
    return X, y, Z


def weighted(
    X: Array, y: Array, Z: Array | None, weights: Weights | None
) -> tuple[Array, Array, Array | None]:
    """Weigh X, y and Z alike; None changes nothing."""
    if weights is None:
        return X, y, Z
    Z = None if Z is None else reweighted(Z, weights)
    return reweighted(X, weights), reweighted(y, weights), Z


def reweighted(columns: Array, weights: Weights | None) -> Array:
    """Whiten columns (N,) or (N, k), or multiply their rows by the root of the weights.

    Examples
    --------
    >>> import numpy as np
    >>> reweighted(np.ones(2), np.array([1.0, 4.0]))
    array([1., 2.])
    """
    if weights is None:
        return columns
    if callable(weights):
        return weights(columns)
    w = np.asarray(weights, dtype=float)
    if w.shape != columns.shape[:1]:
        raise ShapeError(f"weights are {w.shape} and y {columns.shape[:1]}; both must match")
    if not (np.isfinite(w).all() and (w >= 0.0).all()):
        raise EstimationError("weights must be finite and not negative (inverse variances)")
    root = np.sqrt(w)
    return columns * (root if columns.ndim == 1 else root[:, np.newaxis])


def _projected(
    X: Array, Z: Array | None, names: Sequence[str] | None = None
) -> tuple[Array, Array, Array]:
    """Return A = Q'X/scale (m, p), Q (N, m) orthonormal on the instruments, and scale (p,)."""
    scale = norms_of(X)
    if Z is None:
        Q, A = np.linalg.qr(X / scale)
    else:
        Q, R = np.linalg.qr(Z / norms_of(Z))
        if _dependent(R):
            raise EstimationError(
                f"instruments {_dependent(R)} (counted from 0) depend on the others; drop them"
            )
        A = Q.T @ (X / scale)
    if dependent := _dependent(A):
        labels = [f"column {i}" if names is None else str(names[i]) for i in dependent]
        one = len(labels) == 1
        what, gone = ("depends on", "vanishes") if one else ("depend on", "vanish")
        how = "the other columns" if Z is None else "the others in the space of the instruments"
        raise EstimationError(
            f"{', '.join(labels)} {what} {how} or {gone}; drop the term, or excite the axis more"
        )
    return A, Q, scale


def _dependent(A: Array) -> list[int]:
    """Return the columns of A that the others span."""
    if np.linalg.svd(A, compute_uv=False)[-1] > RANK_TOLERANCE:
        return []
    R, order = qr(A, mode="r", pivoting=True)
    pivots = np.abs(np.diag(R))
    return sorted(int(i) for i in order[pivots <= max(RANK_TOLERANCE, pivots[-1])])


def _triangle_solve(A: Array, b: Array) -> Array:
    """Return the least-squares solution of A x = b by QR, A (m, p) of full rank."""
    Q, R = np.linalg.qr(A)
    return np.linalg.solve(R, Q.T @ b)  # R is small; scipy's triangular solver starts threads


def norms_of(X: Array) -> Array:
    """Return the norms of the columns, 1 for a column of zeros."""
    norms = np.sqrt(np.einsum("ij,ij->j", X, X))
    return np.where(norms > 0.0, norms, 1.0)
