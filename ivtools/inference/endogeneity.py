"""Durbin-Wu-Hausman tests: whether the columns are exogenous, or least squares is biased."""

from __future__ import annotations

import numpy as np

from ivtools import linalg
from ivtools.errors import EstimationError
from ivtools.hypothesis import TestResult
from ivtools.inference.system import (
    SPANNED,
    System,
    chi2_result,
    f_result,
    lacks,
    quadratic_form,
    rss,
)
from ivtools.linalg import CovType
from ivtools.results import FitResults

NULL = "the columns are exogenous, least squares is consistent"


def wu_hausman(
    results: FitResults, cov_type: CovType = "hac", bandwidth: int | None = None
) -> TestResult:
    """Test exogeneity by the augmented regression.

    The residuals V of the first stage, X on Z, are added to the columns: y = X theta + V gamma;
    the null hypothesis is gamma = 0.

    Parameters
    ----------
    results : FitResults
        Of an instrumental-variable method.
    cov_type : {"hac", "robust", "classical"}
        "classical" is the textbook F test, valid for white errors only; the others are Wald
        tests with that covariance of gamma.
    bandwidth : int, optional
        Lags of the HAC covariance; automatic if left out.

    Returns
    -------
    TestResult
        F(q, N - p - q), or chi2(q), for q endogenous columns.

    References
    ----------
    J. A. Hausman, Econometrica 46, 1978; A. Janot, P.-O. Vandanjon, M. Gautier, "A revised
    Durbin-Wu-Hausman test for industrial robot identification", Control Eng. Practice 48, 2016.

    Examples
    --------
    ::

        IDIMIV().fit(problem).wu_hausman()
    """
    name = f"Wu-Hausman ({cov_type})"
    if reason := lacks(results):
        return TestResult(name, NULL, reason=reason)
    system = System.of(results)
    V = system.first_stage_resids
    V = V[:, linalg.base_columns(V, SPANNED)]  # columns may be exogenous in combination only
    augmented = np.hstack([system.X, V])  # (N, p + q)
    n, p = system.X.shape
    q = augmented.shape[1] - p
    try:
        theta = linalg.solve_iv(augmented, system.y)
    except EstimationError as error:
        return TestResult(name, NULL, reason=f"the augmented regression fails: {error}")
    resids = system.y - augmented @ theta
    if cov_type == "classical":
        dof = n - p - q
        explained = rss(system.X, system.y) - resids @ resids
        return f_result(name, NULL, explained / q / (resids @ resids / dof), (q, dof))
    cov = linalg.covariance(augmented, resids, cov_type=cov_type, bandwidth=bandwidth)
    return chi2_result(name, NULL, quadratic_form(theta[p:], cov[p:, p:]), q)


def hausman_contrast(
    results: FitResults, cov_type: CovType = "hac", bandwidth: int | None = None
) -> TestResult:
    """Test exogeneity by the difference between instrumental variables and least squares.

    Parameters
    ----------
    results : FitResults
        Of an instrumental-variable method.
    cov_type : {"hac", "robust", "classical"}
        "classical" takes the difference of the classical covariances with the variance of the
        least-squares error (Durbin's statistic); the others take the covariance of the difference
        itself, which needs no estimate to be efficient.
    bandwidth : int, optional
        Lags of the HAC covariance; automatic if left out.

    Returns
    -------
    TestResult
        chi2(q) for q endogenous columns.

    References
    ----------
    J. Durbin, Review of the International Statistical Institute 22, 1954; Hausman 1978.

    Examples
    --------
    ::

        IDIMIV().fit(problem).hausman_contrast(cov_type="classical")
    """
    name = f"Hausman contrast ({cov_type})"
    if reason := lacks(results):
        return TestResult(name, NULL, reason=reason)
    system = System.of(results)
    endog = ~system.exogenous
    rows_ls = linalg.influence(system.X)
    resids = system.y - system.X @ (rows_ls.T @ system.y)  # (N,) of least squares
    rows = (linalg.influence(system.X, system.Z) - rows_ls)[:, endog]  # (N, q)
    if cov_type == "classical":
        cov = resids @ resids / len(resids) * rows.T @ rows
    else:
        cov = linalg.score_covariance(rows * resids[:, np.newaxis], cov_type, bandwidth)
    return chi2_result(name, NULL, quadratic_form(rows.T @ system.y, cov), int(endog.sum()))
