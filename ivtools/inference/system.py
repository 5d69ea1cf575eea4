"""System: the weighted matrices of a result, and which of its columns are exogenous."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc

from ivtools import linalg
from ivtools.hypothesis import TestResult
from ivtools.results import FitResults

Array = NDArray[np.float64]

SPANNED = 1e-8  # of a column's norm outside the instruments' space


@dataclass(frozen=True, eq=False)
class System:
    """What the tests of the instruments work on.

    Attributes
    ----------
    X, y, Z, resids : ndarray
        (N, p), (N,), (N, m), (N,), rows multiplied by the root of their weights.
    exogenous : (p,) ndarray of bool
        Columns of X that the instruments span, such as a constant.
    """

    X: Array
    y: Array
    Z: Array
    resids: Array
    exogenous: NDArray[np.bool_]

    @classmethod
    def of(cls, results: FitResults) -> System:
        """Take the matrices of a result that has instruments."""
        if results.Z is None:
            raise ValueError("the result has no instruments")  # guarded by `lacks`
        X, y, Z = linalg.weighted(results.X, results.y, results.Z, results.weights)
        assert Z is not None
        outside = np.linalg.norm(X - linalg.projection(Z, X), axis=0)
        return cls(
            X=X,
            y=y,
            Z=Z,
            resids=y - X @ results.params.to_numpy(),
            exogenous=outside <= SPANNED * np.linalg.norm(X, axis=0),
        )

    @property
    def X_exog(self) -> Array:
        """Exogenous columns of X."""
        return self.X[:, self.exogenous]

    @property
    def X_endog(self) -> Array:
        """Endogenous columns of X."""
        return self.X[:, ~self.exogenous]

    @property
    def first_stage_resids(self) -> Array:
        """What the instruments leave of the endogenous columns."""
        return self.X_endog - linalg.projection(self.Z, self.X_endog)

    @property
    def Z_excluded(self) -> Array:
        """Instruments beyond the exogenous columns, orthogonal to these."""
        rest = self.Z - linalg.projection(self.X_exog, self.Z)
        small = np.linalg.norm(rest, axis=0) <= SPANNED * np.linalg.norm(self.Z, axis=0)
        rest = np.where(small, 0.0, rest)
        return rest[:, linalg.base_columns(rest)]


def lacks(results: FitResults, surplus: bool = False) -> str:
    """Return the reason why a test of instruments does not apply, or an empty string."""
    if results.Z is None:
        return "the method uses no instruments"
    if "invalid_instruments" in results.extras:
        return str(results.extras["invalid_instruments"])
    if surplus and results.Z.shape[1] <= results.X.shape[1]:
        return "there are as many instruments as parameters; the test needs surplus ones"
    if System.of(results).exogenous.all():
        return "every column is its own instrument"
    return ""


def chi2_result(name: str, null: str, statistic: float, df: int, reason: str = "") -> TestResult:
    """Return the result of a statistic with a chi-square distribution."""
    p = float(chdtrc(df, statistic))
    return TestResult(name, null, float(statistic), p, (df,), "chi2", reason)


def f_result(
    name: str, null: str, statistic: float, df: tuple[float, float], reason: str = ""
) -> TestResult:
    """Return the result of a statistic with an F distribution."""
    p = float(fdtrc(*df, statistic))
    return TestResult(name, null, float(statistic), p, df, "F", reason)


def rss(X: Array, y: Array) -> float:
    """Return the sum of squares that X leaves of y (N,)."""
    e = y - linalg.projection(X, y[:, np.newaxis])[:, 0]
    return float(e @ e)


def quadratic_form(d: Array, V: Array) -> float:
    """Return d' V^-1 d for a covariance V, its units scaled away."""
    scale = np.sqrt(np.diag(V))
    z = d / scale
    return float(z @ np.linalg.solve(V / np.outer(scale, scale), z))


def excluded_test(
    system: System, y: Array, cov_type: linalg.CovType, bandwidth: int | None
) -> tuple[float, tuple[int, int]]:
    """Return the F statistic, with its degrees of freedom, of the excluded instruments in y (N,).

    The classical form is the textbook one; the others are Wald statistics over their number.
    """
    Z, X_exog = system.Z_excluded, system.X_exog
    q, n = Z.shape[1], len(y)
    dof = n - q - X_exog.shape[1]
    if cov_type == "classical":
        small = rss(np.hstack([X_exog, Z]), y)
        return (rss(X_exog, y) - small) / q / (small / dof), (q, dof)
    regressors = np.hstack([X_exog, Z])
    gamma = linalg.solve_iv(regressors, y)
    cov = linalg.covariance(
        regressors, y - regressors @ gamma, cov_type=cov_type, bandwidth=bandwidth
    )
    return quadratic_form(gamma[-q:], cov[-q:, -q:]) / q, (q, dof)
