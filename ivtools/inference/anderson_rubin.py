"""Anderson and Rubin's test and confidence sets: valid however weak the instruments are."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import fdtri

from ivtools import linalg
from ivtools.errors import EstimationError
from ivtools.hypothesis import TestResult
from ivtools.inference.rank import FirstStage
from ivtools.inference.system import System, excluded_test, f_result, lacks, quadratic_form
from ivtools.linalg import CovType
from ivtools.results import FitResults

Array = NDArray[np.float64]

REACH = 1e6  # conventional standard errors, beyond which an interval counts as unbounded
_STEPS = 20  # most steps of the continuously updated weights


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


def anderson_rubin_set(
    results: FitResults,
    alpha: float = 0.05,
    cov_type: CovType = "hac",
    bandwidth: int | None = None,
) -> pd.DataFrame:
    """Return the values of each parameter that `anderson_rubin` does not reject with any others.

    The set of all parameters together, projected on each: its level is at least 1 - alpha, however
    weak the instruments. An interval may be empty (NaN: the surplus instruments contradict each
    other) or unbounded (the record says nothing about the parameter).

    Parameters
    ----------
    results : FitResults
        Of an instrumental-variable method.
    alpha : float
        One less the level.
    cov_type, bandwidth
        As for `anderson_rubin`.

    Returns
    -------
    DataFrame
        Columns lower and upper, one row per endogenous parameter. No rows, and the reason in
        `attrs`, if there are no instruments.

    References
    ----------
    J.-M. Dufour, M. Taamouti, Econometrica 73, 2005: the projection of the classical set;
    J. H. Stock, J. H. Wright, Econometrica 68, 2000: other covariances.

    Examples
    --------
    ::

        IDIMIV().fit(problem).anderson_rubin_set()
    """
    frame = pd.DataFrame({"lower": [], "upper": []}, dtype=float)
    if reason := lacks(results):
        frame.attrs["reason"] = reason
        return frame
    region = _Region(System.of(results), alpha, cov_type, bandwidth)
    names = results.params.index[~region.system.exogenous]
    project = region.ellipsoid if cov_type == "classical" else region.scanned
    ends = project()
    return pd.DataFrame(ends, index=names, columns=["lower", "upper"])


class _Region:
    """The parameters that the test does not reject, for columns of unit norm.

    Attributes
    ----------
    X, y : (N, k), (N,) ndarray
        Endogenous columns and force, the exogenous columns taken out.
    """

    def __init__(
        self, system: System, alpha: float, cov_type: CovType, bandwidth: int | None
    ) -> None:
        stage = FirstStage(system, cov_type, bandwidth)
        self.system, self.stage = system, stage
        self.X = stage.X
        self.norms = np.linalg.norm(
            system.X_endog - linalg.projection(system.X_exog, system.X_endog), axis=0
        )
        self.y = system.y - linalg.projection(system.X_exog, system.y[:, np.newaxis])[:, 0]
        q = stage.counts[1]
        self.limit = q * float(fdtri(q, stage.freedom, 1.0 - alpha))  # of the Wald statistic
        columns = np.column_stack([self.y, self.X])
        self.seen = stage.Q.T @ columns  # (q, 1 + k)
        self.left = columns - stage.Q @ self.seen  # (N, 1 + k)
        if bandwidth is None and cov_type == "hac":
            best = self._solution(np.arange(len(self.norms)))
            stage.bandwidth = linalg.automatic_bandwidth(
                stage.Q * (self.left @ best)[:, np.newaxis]
            )

    def ellipsoid(self) -> Array:
        """Return the ends (k, 2) of the classical set, a quadric."""
        shrink = self.limit / self.stage.freedom
        A = self.seen.T @ self.seen - shrink * (self.left.T @ self.left)
        (c, b), A = (A[0, 0], -A[0, 1:]), A[1:, 1:]  # theta'A theta + 2 b'theta + c <= 0
        k = len(A)
        if np.linalg.eigvalsh(A)[0] <= 0.0:
            return np.tile([-math.inf, math.inf], (k, 1))
        centre = -np.linalg.solve(A, b)
        depth = -float(c + b @ centre)
        if depth < 0.0:
            return np.full((k, 2), math.nan)
        reach = np.sqrt(depth * np.diag(np.linalg.solve(A, np.eye(k))))
        return np.column_stack([centre - reach, centre + reach]) / self.norms[:, np.newaxis]

    def scanned(self) -> Array:
        """Return the ends (k, 2) of the set with any covariance, found by its profile."""
        return np.array([self._ends(j) for j in range(len(self.norms))])

    def _ends(self, j: int) -> tuple[float, float]:
        """Return the ends of one parameter: where the profile of the statistic meets the limit."""
        best = self._least(np.arange(len(self.norms)))
        if self.statistic(best) > self.limit:
            return math.nan, math.nan
        others = np.delete(np.arange(len(self.norms)), j)
        centre = -float(best[1 + j])
        size = self._size(best, j)

        def beyond(a: float) -> float:
            return self.statistic(self._least(others, (j, a))) - self.limit

        ends = [self._crossing(beyond, centre, sign * size) for sign in (-1.0, 1.0)]
        return ends[0] / self.norms[j], ends[1] / self.norms[j]

    @staticmethod
    def _crossing(beyond: Callable[[float], float], centre: float, step: float) -> float:
        """Return where a profile crosses its limit in one direction, or infinity."""
        inner, reach = centre, 1.0
        while reach <= REACH:
            outer = centre + reach * step
            if beyond(outer) > 0.0:
                return float(brentq(beyond, inner, outer, xtol=1e-6 * abs(step), rtol=1e-12))
            inner, reach = outer, 2.0 * reach
        return math.copysign(math.inf, step)

    def statistic(self, error: Array) -> float:
        """Return the Wald statistic of the instruments in an error, columns @ (1, -theta)."""
        cov = self.stage.covariance(self.stage.Q, self.left @ error)
        return quadratic_form(self.seen @ error, cov)

    def _size(self, best: Array, j: int) -> float:
        """Return the standard error of a parameter, which sets the scale of the search."""
        cov = self.stage.covariance(self.stage.Q, self.left @ best)
        slopes = np.linalg.pinv(self.seen[:, 1:])  # (k, q)
        return math.sqrt(float(slopes[j] @ cov @ slopes[j]))

    def _least(self, free: NDArray[np.intp], held: tuple[int, float] | None = None) -> Array:
        """Return (1, -theta) of least statistic over the free parameters, the other one held.

        The weights of the moments are updated until the statistic stops to fall.
        """
        error = self._solution(free, held)
        lowest = self.statistic(error)
        for _ in range(_STEPS if len(free) else 0):
            cov = self.stage.covariance(self.stage.Q, self.left @ error)
            new = self._solution(free, held, cov)
            value = self.statistic(new)
            if value >= lowest * (1.0 - 1e-10):
                break
            error, lowest = new, value
        return error

    def _solution(
        self,
        free: NDArray[np.intp],
        held: tuple[int, float] | None = None,
        cov: Array | None = None,
    ) -> Array:
        """Return (1, -theta) that makes the moments small, in the metric of their covariance."""
        error = np.zeros(1 + len(self.norms))
        error[0] = 1.0
        if held is not None:
            error[1 + held[0]] = -held[1]
        root = np.eye(len(self.seen)) if cov is None else np.linalg.cholesky(cov)
        moments, slopes = self.seen @ error, self.seen[:, 1 + free]
        if len(free):
            solved = np.linalg.solve(root, np.column_stack([slopes, moments]))
            error[1 + free] = -np.linalg.lstsq(solved[:, :-1], solved[:, -1])[0]
        return error
