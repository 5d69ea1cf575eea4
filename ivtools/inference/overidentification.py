"""Tests of surplus instruments: whether all of them agree on one theta."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ivtools import linalg
from ivtools.hypothesis import TestResult
from ivtools.inference.system import System, chi2_result, lacks, quadratic_form
from ivtools.linalg import CovType
from ivtools.results import FitResults

NULL = "every instrument is valid"


def sargan(results: FitResults) -> TestResult:
    """Test the surplus instruments, for errors that are white.

    Parameters
    ----------
    results : FitResults
        With more instruments than parameters.

    Returns
    -------
    TestResult
        N e' P_Z e / e'e, chi2(m - p).

    References
    ----------
    J. D. Sargan, Econometrica 26, 1958.

    Examples
    --------
    ::

        results.sargan()
    """
    if reason := lacks(results, surplus=True):
        return TestResult("Sargan", NULL, reason=reason)
    system = System.of(results)
    e = system.resids
    Pe = linalg.projection(system.Z, e[:, np.newaxis])[:, 0]
    return chi2_result("Sargan", NULL, float(len(e) * (Pe @ Pe) / (e @ e)), _surplus(system))


def basmann(results: FitResults) -> TestResult:
    """Test the surplus instruments: Sargan's statistic corrected for small samples.

    Parameters
    ----------
    results : FitResults
        With more instruments than parameters.

    Returns
    -------
    TestResult
        s (N - m) / (N - s), chi2(m - p), of Sargan's s.

    References
    ----------
    R. L. Basmann, Journal of the American Statistical Association 55, 1960.

    Examples
    --------
    ::

        results.basmann()
    """
    found = sargan(results)
    if found.statistic is None:
        return replace(found, name="Basmann")
    n, m = System.of(results).Z.shape
    s = found.statistic
    return chi2_result("Basmann", NULL, s * (n - m) / (n - s), int(found.df[0]))


def hansen(
    results: FitResults, cov_type: CovType = "hac", bandwidth: int | None = None
) -> TestResult:
    """Test the surplus instruments by Hansen's J of the two-step generalised method of moments.

    Parameters
    ----------
    results : FitResults
        With more instruments than parameters.
    cov_type : {"hac", "robust"}
        Covariance of the moments Z'e.
    bandwidth : int, optional
        Lags of the HAC covariance; automatic if left out.

    Returns
    -------
    TestResult
        chi2(m - p).

    References
    ----------
    L. P. Hansen, Econometrica 50, 1982.

    Examples
    --------
    ::

        results.hansen()
    """
    name = f"Hansen J ({cov_type})"
    if reason := lacks(results, surplus=True):
        return TestResult(name, NULL, reason=reason)
    system = System.of(results)
    Q = np.linalg.qr(system.Z / np.linalg.norm(system.Z, axis=0))[0]  # (N, m)
    first = system.y - system.X @ linalg.solve_iv(system.X, system.y, system.Z)
    S = linalg.score_covariance(Q * first[:, np.newaxis], cov_type, bandwidth)
    root = np.linalg.cholesky(S)
    A, b = np.linalg.solve(root, Q.T @ system.X), np.linalg.solve(root, Q.T @ system.y)
    moments = Q.T @ (system.y - system.X @ linalg.solve_iv(A, b))  # (m,) of the second step
    return chi2_result(name, NULL, quadratic_form(moments, S), _surplus(system))


def anderson_rubin_overid(results: FitResults) -> TestResult:
    """Test the surplus instruments by the likelihood ratio of limited-information ML.

    Parameters
    ----------
    results : FitResults
        With more instruments than parameters.

    Returns
    -------
    TestResult
        N log(kappa), chi2(m - p).

    References
    ----------
    T. W. Anderson, H. Rubin, Annals of Mathematical Statistics 20, 1949.

    Examples
    --------
    ::

        anderson_rubin_overid(results)
    """
    name = "Anderson-Rubin (surplus)"
    if reason := lacks(results, surplus=True):
        return TestResult(name, NULL, reason=reason)
    system = System.of(results)
    columns = np.column_stack([system.y, system.X_endog])
    columns = columns / np.linalg.norm(columns, axis=0)
    left = np.linalg.qr(columns - linalg.projection(system.Z, columns))[1]
    explained = linalg.projection(system.Z_excluded, columns)
    ratio = np.linalg.svd(np.linalg.solve(left.T, explained.T), compute_uv=False)
    statistic = len(columns) * math.log1p(ratio[-1] ** 2)  # kappa = 1 + ratio^2, the smallest
    return chi2_result(name, NULL, statistic, _surplus(system))


def _surplus(system: System) -> int:
    """Return the number of surplus instruments."""
    return system.Z.shape[1] - system.X.shape[1]
