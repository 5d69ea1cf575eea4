"""Rank of the first stage: whether the instruments tell the endogenous columns apart.

One column at a time says little: two columns that the instruments move alike have large F
statistics each, and no estimate. What counts is the direction in which the instruments move the
columns least.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, fdtrc

from ivtools import linalg
from ivtools.inference.system import System, quadratic_form

Array = NDArray[np.float64]

TABLE = Path(__file__).parents[1] / "published" / "stock_yogo_size.csv"


class FStatistic(NamedTuple):
    """An F statistic, its degrees of freedom and p-value."""

    value: float
    df: tuple[int, int]
    pvalue: float


class FirstStage:
    """Endogenous columns and excluded instruments, the exogenous columns taken out of both.

    Parameters
    ----------
    system : System
    cov_type, bandwidth
        Of the errors of the first stage (see `linalg.score_covariance`).

    Attributes
    ----------
    X, V : (N, k) ndarray
        Endogenous columns, and what the instruments leave of them, both divided by the norm of X.
    Q : (N, q) ndarray
        Excluded instruments, orthonormal.
    freedom : int
        N less the number of instruments, the exogenous ones included.
    """

    def __init__(self, system: System, cov_type: linalg.CovType, bandwidth: int | None) -> None:
        X = system.X_endog - linalg.projection(system.X_exog, system.X_endog)
        norms = np.linalg.norm(X, axis=0)
        self.X = X / norms
        self.Q = np.linalg.qr(system.Z_excluded / np.linalg.norm(system.Z_excluded, axis=0))[0]
        self.V = self.X - self.Q @ (self.Q.T @ self.X)
        self.freedom = len(X) - self.Q.shape[1] - system.X_exog.shape[1]
        self.cov_type, self.bandwidth = cov_type, bandwidth

    @property
    def counts(self) -> tuple[int, int]:
        """Number of endogenous columns, k, and of excluded instruments, q."""
        return self.X.shape[1], self.Q.shape[1]

    def covariance(self, basis: Array, v: Array) -> Array:
        """Return the covariance of basis' v for a basis (N, m) of instruments and errors v (N,)."""
        if self.cov_type == "classical":
            return float(v @ v) / len(v) * np.eye(basis.shape[1])
        return linalg.score_covariance(basis * v[:, np.newaxis], self.cov_type, self.bandwidth)

    def _weakest(self) -> tuple[Array, Array, float]:
        """Return the instruments' directions (q, q-k+1) beyond all but the weakest direction of X.

        And that direction (k,), with its singular value: of the canonical correlations.
        """
        R = np.linalg.qr(self.V)[1]
        U, s, Vt = np.linalg.svd(np.linalg.solve(R.T, self.X.T @ self.Q).T)
        k = len(s)
        return U[:, k - 1 :], np.linalg.solve(R, Vt[-1]), float(s[-1])

    def cragg_donald(self) -> float:
        """Return the smallest eigenvalue of the concentration matrix, as an F statistic.

        References
        ----------
        J. G. Cragg, S. G. Donald, Econometric Theory 9, 1993.
        """
        return self._weakest()[2] ** 2 * self.freedom / self.counts[1]

    def kleibergen_paap(self) -> FStatistic:
        """Return the Wald form of the rk statistic, as an F statistic over q.

        Robust to whatever `cov_type` is; with the classical one it is Cragg and Donald's. Its
        p-value is that of chi2(q - k + 1), under the null hypothesis that the rank is k - 1.

        References
        ----------
        F. Kleibergen, R. Paap, Journal of Econometrics 133, 2006.
        """
        k, q = self.counts
        directions, weakest, _ = self._weakest()
        basis = self.Q @ directions  # (N, q-k+1)
        cov = self.covariance(basis, self.V @ weakest)
        rk = quadratic_form(basis.T @ (self.X @ weakest), cov)
        value = rk / q * self.freedom / len(basis)
        return FStatistic(value, (q, self.freedom), float(chdtrc(q - k + 1, rk)))

    def sanderson_windmeijer(self, column: int) -> FStatistic:
        """Return the conditional F of one column: what the instruments tell beyond the others.

        References
        ----------
        E. Sanderson, F. Windmeijer, Journal of Econometrics 190, 2016.
        """
        k, q = self.counts
        others = np.delete(self.X, column, axis=1)
        fitted = self.Q.T @ others  # (q, k-1)
        e = self.X[:, column] - others @ np.linalg.lstsq(fitted, self.Q.T @ self.X[:, column])[0]
        basis = self.Q @ np.linalg.qr(fitted, mode="complete")[0][:, k - 1 :]  # (N, q-k+1)
        v = e - self.Q @ (self.Q.T @ e)
        df = (q - k + 1, self.freedom)
        value = quadratic_form(basis.T @ e, self.covariance(basis, v)) / df[0]
        value *= self.freedom / len(e)
        return FStatistic(value, df, float(fdtrc(*df, value)))

    def effective_f(self, bias: float = 0.1, alpha: float = 0.05) -> tuple[float, float]:
        """Return the effective F of one endogenous column, and its critical value.

        Above that, the bias of two-stage least squares is below the share `bias` of the worst case.

        References
        ----------
        J. L. Montiel Olea, C. Pflueger, Journal of Business & Economic Statistics 31, 2013; the
        critical value is the simplified one, for any covariance of both stages.
        """
        x, n = self.Q.T @ self.X[:, 0], len(self.X)
        W = self.covariance(self.Q, self.V[:, 0]) * n / self.freedom
        return float(x @ x / np.trace(W)), effective_critical_value(W, bias, alpha)


def effective_critical_value(W: Array, bias: float = 0.1, alpha: float = 0.05) -> float:
    """Return the critical value of the effective F for a covariance W (q, q) of the first stage.

    Examples
    --------
    >>> [round(effective_critical_value(np.eye(1), bias), 2) for bias in (0.05, 0.1, 0.2, 0.3)]
    [37.42, 23.11, 15.06, 12.05]
    """
    from scipy.stats import ncx2

    trace, x = float(np.trace(W)), 1.0 / bias
    largest = float(np.linalg.eigvalsh(W)[-1])
    freedom = trace**2 * (1 + 2 * x) / (float(np.sum(W**2)) + 2 * x * trace * largest)
    return float(ncx2.ppf(1.0 - alpha, freedom, freedom * x)) / freedom


def stock_yogo(endogenous: int, instruments: int) -> dict[int, float]:
    """Return critical values by the largest size, in %, of a Wald test at 5 %; empty if unknown.

    The table ends at two endogenous columns; more take its values for two, which are conservative.

    References
    ----------
    J. H. Stock, M. Yogo, in *Identification and Inference for Econometric Models*, 2005, ch. 5.

    Examples
    --------
    >>> stock_yogo(1, 1)
    {10: 16.38, 15: 8.96, 20: 6.66, 25: 5.53}
    """
    return _table().get((min(endogenous, 2), instruments), {})


@cache
def _table() -> dict[tuple[int, int], dict[int, float]]:
    """Return the published table by numbers of endogenous columns and instruments."""
    lines = [line for line in TABLE.read_text(encoding="utf-8").splitlines() if line[0] != "#"]
    sizes = [int(name.removeprefix("size_")) for name in lines[0].split(",")[2:]]
    rows = (line.split(",") for line in lines[1:])
    return {(int(n), int(q)): dict(zip(sizes, map(float, v), strict=True)) for n, q, *v in rows}
