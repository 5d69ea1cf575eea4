"""Tests of the residual: whether it is white, normal and stationary."""

from __future__ import annotations

import warnings
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ivtools import linalg
from ivtools.errors import EstimationError
from ivtools.hypothesis import TestResult
from ivtools.inference.system import chi2_result
from ivtools.results import FitResults

MAX_ADF_CELLS = 5_000_000  # rows times lags of the unit-root regression


def ljung_box(results: FitResults, lags: int | None = None) -> TestResult:
    """Test whether the residual is white.

    Parameters
    ----------
    results : FitResults
        Any result.
    lags : int, optional
        Autocorrelations tested together; min(10, N // 5) if left out.

    Returns
    -------
    TestResult
        chi2(lags).

    References
    ----------
    G. M. Ljung, G. E. P. Box, Biometrika 65, 1978.

    Examples
    --------
    ::

        results.ljung_box(lags=20)
    """
    from statsmodels.stats.diagnostic import acorr_ljungbox

    name, null = "Ljung-Box", "the residual is white"
    e = _weighted_resids(results)
    lags = max(1, min(10, len(e) // 5)) if lags is None else lags
    if not 1 <= lags < len(e):
        raise EstimationError(f"lags = {lags} must lie between 1 and {len(e) - 1}")
    if reason := _degenerate(e):
        return TestResult(name, null, reason=reason)
    statistic = float(acorr_ljungbox(e, lags=[lags])["lb_stat"].iloc[0])
    return chi2_result(name, null, statistic, lags)


def normality(results: FitResults) -> TestResult:
    """Test whether the residual is normal, by its skewness and kurtosis.

    Parameters
    ----------
    results : FitResults
        Any result.

    Returns
    -------
    TestResult
        chi2(2).

    References
    ----------
    C. M. Jarque, A. K. Bera, Economics Letters 6, 1980.

    Examples
    --------
    ::

        results.normality()
    """
    from statsmodels.stats.stattools import jarque_bera

    name, null = "Jarque-Bera", "the residual is normal"
    e = _weighted_resids(results)
    if reason := _degenerate(e):
        return TestResult(name, null, reason=reason)
    statistic, _, skewness, kurtosis = (float(v) for v in jarque_bera(e))
    remark = f"skewness {skewness:.3g}, kurtosis {kurtosis:.3g}"
    return chi2_result(name, null, statistic, 2, remark)


def stationarity(results: FitResults, kind: Literal["adf", "kpss"] = "kpss") -> TestResult:
    """Test whether the residual is stationary.

    Parameters
    ----------
    results : FitResults
        Any result.
    kind : {"kpss", "adf"}
        KPSS, whose null hypothesis is a stationary residual, or the augmented Dickey-Fuller
        test, whose null hypothesis is a unit root.

    Returns
    -------
    TestResult
        The p-value of KPSS is interpolated from its table and ends at 0.01 and 0.1.

    References
    ----------
    D. Kwiatkowski, P. C. B. Phillips, P. Schmidt, Y. Shin, Journal of Econometrics 54, 1992;
    S. E. Said, D. A. Dickey, Biometrika 71, 1984; G. W. Schwert, Journal of Business & Economic
    Statistics 7, 1989.

    Examples
    --------
    ::

        results.stationarity(kind="adf")
    """
    tests = {"adf": _adf, "kpss": _kpss}
    if kind not in tests:
        raise EstimationError(f"kind = {kind!r} is unknown; use adf or kpss")
    return tests[kind](_weighted_resids(results))


def _kpss(e: NDArray[np.float64]) -> TestResult:
    """Test the null hypothesis of a stationary residual."""
    from statsmodels.tsa.stattools import kpss

    name, null = "KPSS", "the residual is stationary"
    if reason := _degenerate(e):
        return TestResult(name, null, reason=reason)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a p-value at the end of the table; documented above
        statistic, pvalue, lags = kpss(e, regression="c", nlags="auto")[:3]
    return TestResult(name, null, float(statistic), float(pvalue), (), "KPSS", f"{lags} lags")


def _adf(e: NDArray[np.float64]) -> TestResult:
    """Test the null hypothesis of a unit root; order by Schwert, bounded for long records."""
    from statsmodels.tsa.stattools import adfuller

    name, null = "Augmented Dickey-Fuller", "the residual has a unit root"
    if reason := _degenerate(e):
        return TestResult(name, null, reason=reason)
    schwert = int(12.0 * (len(e) / 100.0) ** 0.25)
    order = max(1, min(schwert, MAX_ADF_CELLS // len(e), len(e) // 2 - 3))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the regression of an exactly periodic residual
        statistic, pvalue, lags = adfuller(e, maxlag=order, autolag=None)[:3]
    return TestResult(name, null, float(statistic), float(pvalue), (), "ADF", f"{lags} lags")


def _weighted_resids(results: FitResults) -> NDArray[np.float64]:
    """Return the residual (N,), whitened or divided by the deviation of each row."""
    return linalg.reweighted(results.resids, results.weights)


def _degenerate(e: NDArray[np.float64]) -> str:
    """Return why a residual cannot be tested, or an empty string."""
    if len(e) < 20:
        return f"{len(e)} rows are too few"
    return "" if np.ptp(e) > 0.0 else "the residual is constant"
