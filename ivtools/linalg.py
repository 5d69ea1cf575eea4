"""Linear algebra of the estimators: one solver, its covariances, and base columns.

Every system is solved by QR of column-scaled matrices, so that units do not matter and no matrix
is inverted. Least squares is the instrumental-variable solution with Z = X.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from ivtools.errors import EstimationError, ShapeError

Array = NDArray[np.float64]
CovType = Literal["hac", "robust", "classical"]
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


def covariance(
    X: Array,
    resids: Array,
    Z: Array | None = None,
    cov_type: CovType = "hac",
    *,
    weights: Weights | None = None,
    bandwidth: int | None = None,
    debiased: bool | None = None,
) -> Array:
    """Return the covariance of the instrumental-variable (or least-squares) estimate.

    Parameters
    ----------
    X, Z, weights
        As given to `solve_iv`.
    resids : (N,) array_like
        y - X theta, not weighted.
    cov_type : {"hac", "robust", "classical"}
        Robust to autocorrelation and heteroskedasticity (Newey-West), to heteroskedasticity
        (White), or to neither.
    bandwidth : int, optional
        Lags of the Bartlett kernel; the default is `automatic_bandwidth`.
    debiased : bool, optional
        True divides by N - p instead of N. The default is False, except that the classical form
        then takes std(e, ddof=1) for sigma, as the EMPS report does.

    Returns
    -------
    (p, p) ndarray
        Covariance matrix of theta.

    Raises
    ------
    EstimationError
        If cov_type is unknown or the bandwidth is out of range.

    References
    ----------
    W. K. Newey, K. D. West, Econometrica 55, 1987; H. White, Econometrica 48, 1980.

    Examples
    --------
    >>> import numpy as np
    >>> X = np.ones((4, 1))
    >>> covariance(X, np.array([1.0, -1.0, 1.0, -1.0]), cov_type="classical").round(6)
    array([[0.333333]])
    """
    X, resids, Z = weighted(*check_system(X, resids, Z), weights)
    n, p = X.shape
    rows = influence(X, Z)  # (N, p)
    if cov_type == "classical":
        return _variance(resids, p, debiased) * rows.T @ rows
    scores = rows * resids[:, np.newaxis]  # (N, p)
    return score_covariance(scores, cov_type, bandwidth) * (n / (n - p) if debiased else 1.0)


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


def score_covariance(scores: Array, cov_type: CovType, bandwidth: int | None = None) -> Array:
    """Return the covariance of the sum of scores (N, m), robust or HAC.

    Examples
    --------
    >>> import numpy as np
    >>> score_covariance(np.array([[1.0], [-2.0]]), "robust")
    array([[5.]])
    """
    if cov_type == "robust":
        return scores.T @ scores
    if cov_type != "hac":
        raise EstimationError(f"cov_type = {cov_type!r} is unknown; use hac, robust or classical")
    return long_run_variance(
        scores, automatic_bandwidth(scores) if bandwidth is None else bandwidth
    )


def long_run_variance(scores: Array, bandwidth: int) -> Array:
    """Return the Bartlett-weighted sum of the autocovariances, N times the long-run variance.

    The Bartlett kernel is a box convolved with itself, so the weighted sum over the lags is the
    product of moving sums of the scores: linear in N whatever the bandwidth, and never indefinite.

    Parameters
    ----------
    scores : (N, m) ndarray
        Rows to be summed, of zero mean.
    bandwidth : int
        Largest lag of non-zero weight, 1 - lag/(bandwidth + 1).

    Returns
    -------
    (m, m) ndarray
        Sum over t and s of the weight at lag t - s times scores[t] scores[s]'.

    Examples
    --------
    >>> import numpy as np
    >>> float(long_run_variance(np.array([[1.0], [2.0]]), 1)[0, 0])  # 1 + 4 + 2 (1/2) 2
    7.0
    """
    n, m = scores.shape
    if not 0 <= bandwidth < n:
        raise EstimationError(
            f"bandwidth = {bandwidth} must lie between 0 and {n - 1}, "
            "the number of rows less one; None chooses it"
        )
    width = int(bandwidth) + 1
    total = np.zeros((n + 2 * width - 1, m))
    np.cumsum(scores, axis=0, out=total[width : n + width])
    total[n + width :] = total[n + width - 1]
    moving = total[width:] - total[:-width]  # (N + width - 1, m)
    return moving.T @ moving / width


def automatic_bandwidth(scores: Array) -> int:
    """Return the number of Bartlett lags by the rule of Newey and West (1994).

    The rule is applied to the mean autocorrelation of the columns, so that the result depends
    neither on units nor on signs.

    Parameters
    ----------
    scores : (N, m) ndarray
        Scores, or any linear combinations of them.

    Returns
    -------
    int
        ceil(1.1447 (s1/s0)^(2/3) N^(1/3)), at most N - 1.

    References
    ----------
    W. K. Newey, K. D. West, "Automatic lag selection in covariance matrix estimation",
    Review of Economic Studies 61, 1994.

    Examples
    --------
    >>> import numpy as np
    >>> automatic_bandwidth(np.random.default_rng(0).standard_normal((1000, 1)))
    6
    """
    n = len(scores)
    power = np.einsum("ij,ij->j", scores, scores)
    alive = scores[:, power > 0.0] / np.sqrt(power[power > 0.0])
    pilot = min(int(np.ceil(4.0 * (n / 100.0) ** (2.0 / 9.0))), n - 1)
    lags = np.arange(1, pilot + 1)
    rho = np.array([np.vdot(alive[j:], alive[:-j]) for j in lags]) / max(alive.shape[1], 1)
    s0, s1 = 1.0 + 2.0 * rho.sum(), 2.0 * (lags * rho).sum()
    if s0 == 0.0:
        return n - 1
    return min(int(np.ceil(1.1447 * ((s1 / s0) ** 2 * n) ** (1.0 / 3.0))), n - 1)


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
    Q = np.linalg.qr(Z / _norms(Z))[0]
    return Q @ (Q.T @ columns)


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
    scale = _norms(X)
    if Z is None:
        Q, A = np.linalg.qr(X / scale)
    else:
        Q, R = np.linalg.qr(Z / _norms(Z))
        if _dependent(R):
            raise EstimationError(
                f"instruments {_dependent(R)} (counted from 0) depend on the others; drop them"
            )
        A = Q.T @ (X / scale)
    if dependent := _dependent(A):
        labels = [f"column {i}" if names is None else str(names[i]) for i in dependent]
        what = "depends on" if len(labels) == 1 else "depend on"
        how = "the other columns" if Z is None else "the others in the space of the instruments"
        raise EstimationError(
            f"{', '.join(labels)} {what} {how} or vanish; drop the term, or excite the axis more"
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


def _norms(X: Array) -> Array:
    """Return the norms of the columns, 1 for a column of zeros."""
    norms = np.sqrt(np.einsum("ij,ij->j", X, X))
    return np.where(norms > 0.0, norms, 1.0)


def _variance(resids: Array, p: int, debiased: bool | None) -> float:
    """Return the residual variance in the form asked for (see `covariance`)."""
    if debiased is None:
        return float(np.var(resids, ddof=1))
    return float(resids @ resids) / (len(resids) - (p if debiased else 0))
