"""Scores: what a table of fits says about each estimator, with the error of the study itself."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pandas as pd

from ivtools.display import Displayed
from ivtools.files import write
from ivtools.study.outcome import NORMAL
from ivtools.tables import csv

if TYPE_CHECKING:
    from ivtools.report import Page
    from ivtools.study.run import Study
    from ivtools.tables import Text

GROUP = ["case", "estimator", "parameter"]
SCORES = ["theta_true", "n", "bias", "bias_mcse", "sd", "sd_mcse", "rmse", "rmse_mcse"]
SCORES += ["coverage", "coverage_mcse"]


@dataclass(frozen=True, eq=False, repr=False)
class Score(Displayed):
    """Bias, spread, coverage and efficiency of every estimator.

    Attributes
    ----------
    table : DataFrame
        One row per case, estimator and parameter. Columns: ``theta_true``; ``n`` fits that
        converged, of which all that follows speaks; ``bias``, ``sd``, ``rmse`` in % of the true
        value, each with its Monte-Carlo standard error ``*_mcse``; ``coverage`` of the 95 %
        intervals, %; ``bound``, the Cramer-Rao bound in % of the true value; ``efficiency``,
        100 bound^2/rmse^2, %.
    fits : DataFrame
        One row per case and estimator: ``fits``, ``failed`` and ``converged`` (% of the fits),
        median ``relative_error`` and ``holdout_error`` (%), ``n_iter``, ``n_simulations``, and the
        median ``runtime`` (s).
    factors : DataFrame
        One row per case: what distinguishes it.
    title, question : str
    """

    figure: ClassVar[str] = "study.bias"

    table: pd.DataFrame
    fits: pd.DataFrame
    factors: pd.DataFrame
    title: str = ""
    question: str = ""

    @classmethod
    def of(cls, table: pd.DataFrame, study: Study | None = None, bounds: bool = True) -> Score:
        """Score the table of a study.

        Parameters
        ----------
        table : DataFrame
            As `Study.run` returns it.
        study : Study, optional
            Gives the Cramer-Rao bounds, and the names of what varies.
        bounds : bool
            Whether to work the bounds out.

        Examples
        --------
        >>> import ivtools as iv
        >>> from ivtools.study import Trapezoids
        >>> theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
        >>> case = iv.Case("quick", iv.axes.emps(), theta, Trapezoids(3.0), force_noise=2.0)
        >>> table = iv.Study([case], [iv.IDIMLS()], seeds=10).run()
        >>> bool(abs(Score.of(table).table["bias"].iloc[0]) < 1.0)
        True
        """
        good = table[table["converged"] & (table["error"] == "")]
        groups = good.groupby(GROUP, observed=True, sort=True)
        rows = [dict(zip(GROUP, key, strict=True)) | _scores(rows) for key, rows in groups]
        scores = pd.DataFrame(rows, columns=[*GROUP, *SCORES])
        scores = scores.astype({name: table[name].dtype for name in GROUP})
        cases = study.cases if study is not None else ()
        limits = {(c.name, k): v for c in cases if bounds for k, v in c.bound().items()}
        keys = zip(scores["case"], scores["parameter"], strict=True)
        scores["bound"] = [limits.get(key, np.nan) for key in keys]
        scores["bound"] *= 100.0 / scores["theta_true"].abs()
        scores["efficiency"] = 100.0 * (scores["bound"] / scores["rmse"]) ** 2
        factors = pd.DataFrame({c.name: dict(c.factors) for c in cases}).T.infer_objects()
        factors.index.name = "case"
        title, question = (study.title, study.question) if study is not None else ("", "")
        return cls(scores, _fits(table), factors, title, question)

    @cached_property
    def overall(self) -> pd.DataFrame:
        """One row per case and estimator: what a reader compares first.

        ``rmse`` and ``bias`` are root mean squares over the parameters that have a true value,
        ``n`` the fits behind them, ``coverage`` the mean.
        """
        known = self.table[self.table["theta_true"].notna() & (self.table["theta_true"] != 0.0)]
        groups = known.groupby(GROUP[:2], observed=True)
        rms = groups[["bias", "rmse"]].agg(_rms)
        rest = groups[["coverage", "n"]].agg({"coverage": "mean", "n": "min"})
        return self.fits.set_index(GROUP[:2]).join(rms).join(rest).reset_index()

    def best(self) -> pd.DataFrame:
        """Return, per case and parameter, the estimators that no other beats beyond chance.

        An estimator is beaten if another one's RMSE is smaller by more than two Monte-Carlo
        standard errors of the difference.

        Returns
        -------
        DataFrame
            Columns case, parameter, estimator, rmse, rmse_mcse; the smallest RMSE first.
        """
        rows = []
        for _, group in self.table.groupby(GROUP[::2], observed=True):
            ranked = group[group["rmse"].notna()].sort_values("rmse", kind="stable")
            if len(ranked):
                first = ranked.iloc[0]
                doubt = 2.0 * np.hypot(first["rmse_mcse"], ranked["rmse_mcse"])
                rows.append(ranked[ranked["rmse"] - first["rmse"] <= doubt])
        columns = [*GROUP[::2], "estimator", "rmse", "rmse_mcse"]
        return pd.concat(rows)[columns].reset_index(drop=True) if rows else self.table[columns]

    def biased(self) -> pd.DataFrame:
        """Return the rows whose bias three Monte-Carlo standard errors do not explain."""
        return self.table[self.table["bias"].abs() > 3.0 * self.table["bias_mcse"]]

    def to_markdown(self) -> str:
        """Return the report in Markdown."""
        from ivtools.study.summary import markdown

        return markdown(self)

    def page(self, figures: bool = True) -> Page:
        """Return the report as a page of `ivtools.report`."""
        from ivtools.study.summary import page

        return page(self, figures)

    def to_dict(self) -> dict[str, Any]:
        """Return the scores as plain objects, ready for JSON."""
        return {
            "title": self.title,
            "scores": self.table.astype({k: str for k in GROUP}).to_dict("records"),
            "fits": self.fits.astype({k: str for k in GROUP[:2]}).to_dict("records"),
        }

    def save(self, folder: str | Path) -> Path:
        """Write scores.csv, fits.csv, report.md, report.html and the figures to a folder."""
        folder = Path(folder)
        write(folder / "scores.csv", csv(self.table))
        write(folder / "fits.csv", csv(self.fits))
        write(folder / "report.md", self.to_markdown())
        return self.page().write(folder / "report.html", figures=True)

    def summary(self) -> Text:
        """Return the comparison of the estimators, case by case, at most 80 columns wide."""
        from ivtools.study.summary import text

        return text(self)

    def __str__(self) -> str:
        return str(self.summary())

    def __repr__(self) -> str:
        cases, estimators = (self.table[k].nunique() for k in GROUP[:2])
        return f"Score: {cases} cases, {estimators} estimators, {int(self.fits['fits'].sum())} fits"

    def _repr_html_(self) -> str:
        return self.summary().html  # a row per estimator; `table` has those of the parameters


def _scores(group: pd.DataFrame) -> dict[str, float]:
    """Return the scores of one estimator's values of one parameter."""
    true = float(group["theta_true"].iloc[0])
    scale = 100.0 / abs(true) if true else np.nan
    error = scale * (group["theta"].to_numpy() - true)  # (n,) %
    n, bias, rmse = len(error), float(error.mean()), float(np.sqrt(np.mean(error**2)))
    sd, sd_mcse = _deviation(error)
    reach = group["half_width"] if "half_width" in group else NORMAL * group["std_error"]
    inside = np.abs(group["theta"] - true) <= reach
    covered = float(inside.mean()) if group["std_error"].notna().all() else np.nan
    square_mcse = float(np.std(error**2, ddof=1)) / np.sqrt(n) if n > 1 else np.nan
    return {
        "theta_true": true,
        "n": n,
        "bias": bias,
        "bias_mcse": sd / np.sqrt(n),
        "sd": sd,
        "sd_mcse": sd_mcse,
        "rmse": rmse,
        "rmse_mcse": square_mcse / (2.0 * rmse) if rmse else 0.0,
        "coverage": 100.0 * covered if np.isfinite(true) else np.nan,
        "coverage_mcse": 100.0 * np.sqrt(covered * (1.0 - covered) / n),
    }


def _rms(x: pd.Series) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _deviation(x: np.ndarray) -> tuple[float, float]:
    """Return the standard deviation and its standard error, whatever the distribution."""
    n = len(x)
    if n < 2:
        return np.nan, np.nan
    variance = float(np.var(x, ddof=1))
    if not variance > 0.0:
        return np.sqrt(variance), np.nan if np.isnan(variance) else 0.0
    kurtosis = float(np.mean((x - x.mean()) ** 4)) / variance**2
    return np.sqrt(variance), np.sqrt(variance * max(kurtosis - 1.0, 0.0) / (4.0 * n))


def _fits(table: pd.DataFrame) -> pd.DataFrame:
    """Return the counts and medians per case and estimator."""
    fits = table.drop_duplicates(["case", "estimator", "seed"])
    fits = fits.assign(failed=fits["error"] != "")
    groups = fits.groupby(GROUP[:2], observed=True)
    shares = 100.0 * groups[["failed", "converged"]].mean()
    names = ["relative_error", "holdout_error", "n_iter", "n_simulations", "runtime"]
    good = fits[~fits["failed"]].groupby(GROUP[:2], observed=True)[names].median()
    return groups.size().rename("fits").to_frame().join(shares).join(good).reset_index()
