"""Strength of the instruments, and a test of theta that does not depend on it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from ivtools import linalg
from ivtools.errors import EstimationError
from ivtools.hypothesis import TestResult
from ivtools.inference.system import System, excluded_test, f_result, lacks
from ivtools.linalg import CovType
from ivtools.results import FitResults

WEAK_F = 10.0  # Staiger and Stock's rule of thumb
COLUMNS = ["rsquared", "partial_rsquared", "shea_rsquared", "f_stat", "f_pvalue"]


def first_stage(
    results: FitResults, cov_type: CovType = "classical", bandwidth: int | None = None
) -> pd.DataFrame:
    """Measure how well the instruments explain each endogenous column of X.

    Parameters
    ----------
    results : FitResults
        Of an instrumental-variable method.
    cov_type : {"classical", "robust", "hac"}
        Of the F statistic.
    bandwidth : int, optional
        Lags of the HAC covariance; automatic if left out.

    Returns
    -------
    DataFrame
        One row per endogenous column: R2; partial R2, the exogenous columns taken out; Shea's R2,
        the other columns taken out as well; F of the excluded instruments, with its p-value.
        Empty, with the reason in `attrs`, if there is nothing to measure.

    References
    ----------
    J. Shea, Review of Economics and Statistics 79, 1997; D. Staiger, J. H. Stock,
    Econometrica 65, 1997.

    Examples
    --------
    ::

        IDIMIV().fit(problem).first_stage()
    """
    if reason := lacks(results):
        empty = pd.DataFrame(columns=COLUMNS, dtype=float)
        empty.attrs["reason"] = reason
        return empty
    system = System.of(results)
    left = _squares(system.first_stage_resids)
    exog = system.X_endog - linalg.projection(system.X_exog, system.X_endog)
    tests = [excluded_test(system, x, cov_type, bandwidth) for x in system.X_endog.T]
    data = {
        "rsquared": 1.0 - left / _total_squares(system, results.weights),
        "partial_rsquared": 1.0 - left / _squares(exog),
        "shea_rsquared": _shea(system),
        "f_stat": [statistic for statistic, _ in tests],
        "f_pvalue": [f_result("", "", statistic, df).pvalue for statistic, df in tests],
    }
    return pd.DataFrame(data, index=results.params.index[~system.exogenous])


def weak_instruments(
    results: FitResults, cov_type: CovType = "classical", bandwidth: int | None = None
) -> TestResult:
    """Return the smallest first-stage F: below 10 the instruments are weak.

    Parameters
    ----------
    results, cov_type, bandwidth
        As in `first_stage`.

    Returns
    -------
    TestResult
        The column is named in `reason`.

    References
    ----------
    D. Staiger, J. H. Stock, Econometrica 65, 1997.

    Examples
    --------
    ::

        weak_instruments(results).statistic > 10
    """
    name, null = "Weak instruments", "the instruments say nothing about the column"
    if reason := lacks(results):
        return TestResult(name, null, reason=reason)
    f = first_stage(results, cov_type, bandwidth)["f_stat"]
    system = System.of(results)
    q = system.Z_excluded.shape[1]
    df = (q, len(system.y) - q - system.X_exog.shape[1])
    word = "weak" if f.min() < WEAK_F else "not weak"
    return f_result(name, null, float(f.min()), df, f"{f.idxmin()} is the weakest; {word}")


def anderson_rubin(
    results: FitResults,
    theta0: Mapping[str, float] | pd.Series | None = None,
    cov_type: CovType = "hac",
    bandwidth: int | None = None,
) -> TestResult:
    """Test values of the endogenous parameters, valid however weak the instruments are.

    If theta0 is right, nothing of y - X theta0 is left for the instruments to explain.

    Parameters
    ----------
    results : FitResults
        Of an instrumental-variable method.
    theta0 : Mapping or Series, optional
        Values of all endogenous parameters; 0 if left out.
    cov_type : {"hac", "robust", "classical"}
        "classical" is the textbook F test.
    bandwidth : int, optional
        Lags of the HAC covariance; automatic if left out.

    Returns
    -------
    TestResult
        F(q, N - m) for q excluded instruments.

    References
    ----------
    T. W. Anderson, H. Rubin, Annals of Mathematical Statistics 20, 1949.

    Examples
    --------
    ::

        iv_results.anderson_rubin(theta0=ls_results.params)
    """
    what = "0" if theta0 is None else "theta0"
    name, null = f"Anderson-Rubin ({cov_type})", f"the endogenous parameters are {what}"
    if reason := lacks(results):
        return TestResult(name, null, reason=reason)
    system = System.of(results)
    endog = [n for n, fixed in zip(results.names, system.exogenous, strict=True) if not fixed]
    given = dict.fromkeys(endog, 0.0) if theta0 is None else dict(theta0)
    if missing := [n for n in endog if n not in given]:
        raise EstimationError(f"theta0 lacks {', '.join(missing)}; give every endogenous parameter")
    values = np.array([float(given[n]) for n in endog])
    y0 = system.y - system.X_endog @ values
    return f_result(name, null, *excluded_test(system, y0, cov_type, bandwidth))


def _shea(system: System) -> np.ndarray:
    """Return Shea's R2 of each endogenous column: how much of what is its own is explained."""
    ls, iv = linalg.influence(system.X), linalg.influence(system.X, system.Z)
    return (_squares(ls) / _squares(iv))[~system.exogenous]


def _total_squares(system: System, weights: linalg.Weights | None) -> np.ndarray:
    """Return the sums of squares of the endogenous columns, about the mean if Z has a constant."""
    one = linalg.reweighted(np.ones((len(system.y), 1)), weights)
    outside = np.linalg.norm(one - linalg.projection(system.Z, one))
    centre = outside <= 1e-6 * np.linalg.norm(one)
    X = system.X_endog
    return _squares(X - linalg.projection(one, X)) if centre else _squares(X)


def _squares(X: np.ndarray) -> np.ndarray:
    """Return the sums of squares of the columns."""
    return np.einsum("ij,ij->j", X, X)
