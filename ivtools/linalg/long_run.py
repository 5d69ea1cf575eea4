"""Long-run variance: how much a sum of autocorrelated scores varies."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import EstimationError

Array = NDArray[np.float64]
CovType = Literal["hac", "robust", "classical"]


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


def kernel_share(bandwidth: int) -> float:
    """Return the sum of the squared weights of the Bartlett kernel over all lags.

    The variance of a variance estimated from N white scores is 2/N times this.

    Examples
    --------
    >>> kernel_share(0), kernel_share(1)
    (1.0, 1.5)
    """
    width = bandwidth + 1.0
    return 2.0 * width / 3.0 + 1.0 / (3.0 * width)


def block_covariance(scores: Array, firsts: NDArray[np.intp]) -> Array:
    """Return the covariance (m, m) of the sum of scores (N, m) that hang together within blocks.

    Parameters
    ----------
    scores : (N, m) ndarray
    firsts : (k,) ndarray of int
        First row of each block; blocks count as independent.

    References
    ----------
    K.-Y. Liang, S. L. Zeger, Biometrika 73, 1986.

    Examples
    --------
    >>> block_covariance(np.array([[1.0], [1.0], [-2.0]]), np.array([0, 2]))
    array([[8.]])
    """
    sums = np.add.reduceat(scores, firsts, axis=0)
    return np.asarray(sums.T @ sums)
