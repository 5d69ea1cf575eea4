"""Strength of the instruments: one column at a time, and together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ivtools import linalg
from ivtools.display import Displayed
from ivtools.hypothesis import TestResult
from ivtools.inference.rank import FirstStage, FStatistic, stock_yogo
from ivtools.inference.system import System, excluded_test, f_result, lacks
from ivtools.linalg import CovType
from ivtools.results import FitResults
from ivtools.tables import Text, dashed, table, two_columns

Array = NDArray[np.float64]

WEAK_F = 10.0  # Staiger and Stock's rule of thumb, where no table has a value
SIZE = 10  # %, of a test at 5 %: what Stock and Yogo's critical value allows
COLUMNS = ["rsquared", "partial_rsquared", "shea_rsquared", "f_stat", "f_pvalue"]


@dataclass(frozen=True, eq=False, repr=False)
class InstrumentStrength(Displayed):
    """How strong instruments are.

    Attributes
    ----------
    first_stage : DataFrame
        One row per endogenous column (see `first_stage`), and ``sw_f``, ``sw_pvalue``: Sanderson
        and Windmeijer's F, of what the instruments tell of the column beyond the others.
    cragg_donald : float
        The smallest eigenvalue of the concentration matrix as an F statistic: white errors.
    kleibergen_paap : FStatistic
        The same, robust to what `cov_type` says.
    effective : tuple of float
        Effective F of Montiel Olea and Pflueger with its critical value (10 % of the worst-case
        bias), where there is one endogenous column; else NaN.
    stock_yogo : dict of int to float
        Critical values by the size, in %, of a Wald test at 5 %; empty if there are none.
    cov_type : str
    """

    content: ClassVar[tuple[str, ...]] = (
        "cragg_donald", "kleibergen_paap", "effective", "stock_yogo", "cov_type", "weak", "verdict",
    )  # fmt: skip

    first_stage: pd.DataFrame
    cragg_donald: float
    kleibergen_paap: FStatistic
    effective: tuple[float, float]
    stock_yogo: dict[int, float]
    cov_type: str

    @property
    def statistic(self) -> float:
        """What decides: the effective F of one endogenous column, Kleibergen and Paap's of more."""
        return self.effective[0] if len(self.first_stage) == 1 else self.kleibergen_paap.value

    @property
    def limit(self) -> float:
        """What the statistic must exceed."""
        if len(self.first_stage) == 1:
            return self.effective[1]
        return self.stock_yogo.get(SIZE, WEAK_F)

    @property
    def weak(self) -> bool:
        """Whether an estimate and its standard errors are not to be trusted."""
        return not self.statistic > self.limit

    @property
    def verdict(self) -> str:
        """The verdict in one line, with the column that is worst off."""
        worst = self.first_stage["sw_f"].idxmin()
        name = "effective" if len(self.first_stage) == 1 else "Kleibergen-Paap"
        return (
            f"{worst} is the weakest; {name} F {self.statistic:.4g} against {self.limit:.4g}, "
            f"Cragg-Donald {self.cragg_donald:.4g}; {'weak' if self.weak else 'not weak'}"
        )

    def summary(self) -> Text:
        """Return a table of at most 80 columns."""
        k, q = len(self.first_stage), self.kleibergen_paap.df[0]
        critical = ", ".join(f"{size} %: {v:.2f}" for size, v in self.stock_yogo.items())
        head = two_columns(
            [
                ("Endogenous columns", str(k)),
                ("Excluded instruments", str(q)),
                ("Cragg-Donald F", f"{self.cragg_donald:.4g}"),
                (f"Kleibergen-Paap F ({self.cov_type})", f"{self.kleibergen_paap.value:.4g}"),
                ("Effective F", dashed(self.effective[0], ".4g")),
                ("its critical value", dashed(self.effective[1], ".4g")),
            ]
        )
        header = ["", "R2", "partial R2", "Shea R2", "F", "conditional F"]
        names = [*COLUMNS[:4], "sw_f"]
        rows = [
            [str(name), *(f"{row[column]:.4g}" for column in names)]
            for name, row in self.first_stage.iterrows()
        ]
        notes = [f"Stock-Yogo, by the size of a test at 5 %: {critical or 'not tabulated'}"]
        if self.weak:
            notes.append("weak: take the intervals of anderson_rubin_set() instead of conf_int()")
        return table("Strength of the instruments", head, header, rows, [self.verdict, *notes])


def instrument_strength(
    results: FitResults, cov_type: CovType = "hac", bandwidth: int | None = None
) -> InstrumentStrength | TestResult:
    """Judge the instruments of a result, each column and all together.

    Parameters
    ----------
    results : FitResults
        Of an instrumental-variable method.
    cov_type : {"hac", "robust", "classical"}
        Of the errors of the first stage.
    bandwidth : int, optional
        Lags of the HAC covariance; automatic if left out.

    Returns
    -------
    InstrumentStrength, or TestResult with the reason why there is nothing to judge.

    References
    ----------
    J. H. Stock, M. Yogo 2005; F. Kleibergen, R. Paap 2006; J. L. Montiel Olea, C. Pflueger 2013;
    E. Sanderson, F. Windmeijer 2016 (see `ivtools.inference.rank`).

    Examples
    --------
    ::

        IDIMIV().fit(problem).instrument_strength()
    """
    if reason := lacks(results):
        return TestResult(*_NAMES, reason=reason)
    stage = FirstStage(System.of(results), cov_type, bandwidth)
    k, q = stage.counts
    conditional = [stage.sanderson_windmeijer(column) for column in range(k)]
    return InstrumentStrength(
        first_stage=first_stage(results, cov_type, bandwidth).assign(
            sw_f=[test.value for test in conditional],
            sw_pvalue=[test.pvalue for test in conditional],
        ),
        cragg_donald=stage.cragg_donald(),
        kleibergen_paap=stage.kleibergen_paap(),
        effective=stage.effective_f() if k == 1 else (float("nan"), float("nan")),
        stock_yogo=stock_yogo(k, q),
        cov_type=cov_type,
    )


def weak_instruments(
    results: FitResults, cov_type: CovType = "hac", bandwidth: int | None = None
) -> TestResult:
    """Test whether the instruments tell the columns apart, and say whether they do so well enough.

    Parameters
    ----------
    results, cov_type, bandwidth
        As in `instrument_strength`.

    Returns
    -------
    TestResult
        Kleibergen and Paap's F, or the effective F of one column. The p-value is that of no
        strength at all; `reason` compares the statistic with the strength that is needed.

    Examples
    --------
    ::

        weak_instruments(results).reason
    """
    found = instrument_strength(results, cov_type, bandwidth)
    if isinstance(found, TestResult):
        return found
    df, p = found.kleibergen_paap.df, found.kleibergen_paap.pvalue
    return TestResult(*_NAMES, found.statistic, p, df, "F", found.verdict)


_NAMES = ("Weak instruments", "the instruments do not tell the columns apart")


def first_stage(
    results: FitResults, cov_type: CovType = "classical", bandwidth: int | None = None
) -> pd.DataFrame:
    """Measure how well the instruments explain each endogenous column of X.

    Parameters
    ----------
    results : FitResults
        Of an instrumental-variable method.
    cov_type : {"classical", "robust", "hac"}
        Of the F statistics.
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


def _shea(system: System) -> Array:
    """Return Shea's R2 of each endogenous column: how much of what is its own is explained."""
    ls, iv = linalg.influence(system.X), linalg.influence(system.X, system.Z)
    return (_squares(ls) / _squares(iv))[~system.exogenous]


def _total_squares(system: System, weights: linalg.Weights | None) -> Array:
    """Return the sums of squares of the endogenous columns, about the mean if Z has a constant."""
    one = linalg.reweighted(np.ones((len(system.y), 1)), weights)
    outside = np.linalg.norm(one - linalg.projection(system.Z, one))
    centre = outside <= 1e-6 * np.linalg.norm(one)
    X = system.X_endog
    return _squares(X - linalg.projection(one, X)) if centre else _squares(X)


def _squares(X: Array) -> Array:
    """Return the sums of squares of the columns."""
    return np.einsum("ij,ij->j", X, X)
