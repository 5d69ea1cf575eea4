"""Monte-Carlo studies: bias and spread, error against a level, and methods against models."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from ivtools.plots.parameters import shown_name
from ivtools.plots.style import COLOURS, MARKERS, WIDTH_MM, Sheet, look, sheet

if TYPE_CHECKING:
    from ivtools.study import Score


LABELS = {
    "encoder_noise": "encoder noise, m",
    "quantum": "resolution of the encoder, m",
    "force_noise": "force noise, N",
    "sampling_hz": "sampling rate, Hz",
    "sampling": "sampling rate, Hz",
    "cutoff_hz": "cut-off of the band-pass, Hz",
}
"""Factors as they are printed on an axis."""


def bias(score: Score, case: str | None = None, *, width_mm: float = WIDTH_MM) -> Sheet:
    """Draw bias and spread of every estimator, a panel per parameter.

    Parameters
    ----------
    score : Score
    case : str, optional
        Default: the first.
    width_mm : float
        Width of the figure, mm.

    Returns
    -------
    Figure
        Points are the bias, thick bars its 95 % interval (Monte-Carlo error), thin bars one
        standard deviation of an estimate; all in % of the true value.
    """
    case = str(score.table["case"].iloc[0]) if case is None else case
    table = score.table[(score.table["case"] == case) & score.table["bias"].notna()]
    estimators = [str(e) for e in dict.fromkeys(score.table["estimator"])]
    names = [str(p) for p in dict.fromkeys(table["parameter"])]
    rows = max(1, -(-len(names) // 2))
    with look():
        figure = sheet(width_mm, 12.0 + rows * (11.5 + 3.6 * len(estimators)))
        panels = np.ravel(figure.subplots(rows, 2, squeeze=False, sharey=True))
        for axes, name in zip(panels, names, strict=False):
            _biases(axes, table[table["parameter"] == name], estimators)
            axes.set_xlabel(f"bias of {shown_name(name)}, %")
        for axes in panels[len(names) :]:
            axes.set_visible(False)
        panels[0].set_yticks(range(len(estimators)), estimators)
        panels[0].set_ylim(len(estimators) - 0.5, -0.5)
        figure.suptitle(f"Bias and spread, {case.replace('_', ' ')}", fontsize=7.5)
    return figure


def levels(
    score: Score, factor: str, parameter: str | None = None, *, width_mm: float = WIDTH_MM
) -> Sheet:
    """Draw the error of every estimator against a factor that is a number.

    Parameters
    ----------
    score : Score
    factor : str
        A column of ``score.factors``; cases where it is no number are left out.
    parameter : str, optional
        Default: the root mean square over all parameters.
    width_mm : float
        Width of the figure, mm.

    Returns
    -------
    Figure
        RMSE in % of the true value; with a parameter, bars are two Monte-Carlo standard errors.
    """
    table = score.overall if parameter is None else score.table
    if parameter is not None:
        table = table[table["parameter"] == parameter]
    table = table.assign(x=_numbers(table["case"].astype(str).map(score.factors[factor])))
    table = table[np.isfinite(table["x"])]
    with look():
        figure = sheet(width_mm, 62.0 + 2.5 * table["estimator"].nunique())
        axes = figure.subplots()
        for k, (name, rows) in enumerate(table.groupby("estimator", observed=True)):
            rows = rows.groupby("x").mean(numeric_only=True).reset_index()
            spread = None if parameter is None else 2.0 * rows["rmse_mcse"]
            axes.errorbar(
                rows["x"],
                rows["rmse"],
                yerr=spread,
                label=str(name),
                color=COLOURS["series"][k % len(COLOURS["series"])],
                marker=MARKERS[k % len(MARKERS)],
                ms=3.2,
                ls="-" if k < len(COLOURS["series"]) else "--",
            )
        x = table["x"].to_numpy()
        if x.min() > 0.0 and x.max() > 5.0 * x.min():
            axes.set_xscale("log")
        axes.set_yscale("log")
        name = factor.split(".")[-1]
        axes.set_xlabel(LABELS.get(name, name.replace("_", " ")))
        axes.set_ylabel(f"RMSE{'' if parameter is None else ' of ' + shown_name(parameter)}, %")
        figure.legend(loc="outside lower center", ncols=3)
    return figure


def heatmap(
    score: Score, parameter: str | None = None, *, width_mm: float = 2.0 * WIDTH_MM
) -> Sheet:
    """Draw the error of every estimator (down) in every case (across).

    Parameters
    ----------
    score : Score
    parameter : str, optional
        Default: the root mean square over all parameters.
    width_mm : float
        Width of the figure, mm.

    Returns
    -------
    Figure
        Colour and number are the RMSE, in % of the true value.
    """
    table = score.overall
    if parameter is not None:
        table = score.table[score.table["parameter"] == parameter]
    table = table.pivot(index="estimator", columns="case", values="rmse")
    values = table.to_numpy(dtype=float)
    good = values[np.isfinite(values) & (values > 0.0)]
    lowest, highest = (good.min(), good.max()) if good.size else (0.1, 1.0)
    with look():
        figure = sheet(width_mm, 32.0 + 5.5 * len(table))
        axes = figure.subplots()
        norm = LogNorm(lowest, max(highest, 1.01 * lowest))
        axes.imshow(values, cmap="YlOrBr", norm=norm, aspect="auto")
        axes.set_yticks(range(len(table)), [str(e) for e in table.index])
        labels = [str(c).replace(", ", "\n").replace("_", " ") for c in table.columns]
        axes.set_xticks(range(table.shape[1]), labels, rotation=30, ha="right")
        axes.grid(visible=False)
        for (row, column), value in np.ndenumerate(values):
            dark = bool(np.isfinite(value) and norm(value) > 0.6)
            text = f"{value:.2g}" if np.isfinite(value) else "\u2013"
            colour = "#fdfdfd" if dark else "#111111"  # on a dark page too
            axes.text(column, row, text, ha="center", va="center", color=colour, fontsize=6.5)
        what = "over all parameters" if parameter is None else f"of {shown_name(parameter)}"
        axes.set_title(f"RMSE {what}, %")
    return figure


def figures(score: Score) -> list[tuple[str, Sheet, str]]:
    """Return the figures that suit a study: name, figure and caption of each.

    A factor that is a number gives a curve; several cases give the heat map; a study of few cases
    shows bias and spread in each.
    """
    found: list[tuple[str, Sheet, str]] = []
    for factor in score.factors.columns:
        if np.isfinite(_numbers(score.factors[factor])).sum() > 2:
            said = str(factor).replace("_", " ")
            name = f"levels-{_slug(factor.split('.')[-1])}"
            if "inertia" in set(score.table["parameter"]):
                caption = f"Error of the inertia against {said}, bars are two standard errors."
                found.append((f"{name}-inertia", levels(score, factor, "inertia"), caption))
            caption = f"Error of every estimator against {said}, all parameters together."
            found.append((name, levels(score, factor), caption))
    cases = [str(c) for c in dict.fromkeys(score.table["case"])]
    if len(cases) > 1:
        if "inertia" in set(score.table["parameter"]):
            caption = "Error of the inertia, every estimator in every case."
            found.append(("heatmap-inertia", heatmap(score, "inertia"), caption))
        caption = "Error of every estimator in every case, all parameters together."
        found.append(("heatmap", heatmap(score), caption))
    for case in cases if len(cases) <= 4 else cases[:: max(1, len(cases) - 1)]:
        caption = (
            f"Bias (point, with its 95 % Monte-Carlo interval) and standard deviation of one "
            f"estimate (thin bar), {case.replace('_', ' ')}."
        )
        found.append((f"bias-{_slug(case)}", bias(score, case), caption))
    return found


def _biases(axes: Axes, table: pd.DataFrame, estimators: list[str]) -> None:
    """Draw one parameter of every estimator that has it."""
    axes.axvline(0.0, color=COLOURS["truth"], lw=0.8)
    for k, name in enumerate(estimators):
        rows = table[table["estimator"] == name]
        if len(rows):
            value, error, spread = (float(rows[c].iloc[0]) for c in ("bias", "bias_mcse", "sd"))
            colour = COLOURS["series"][k % len(COLOURS["series"])]
            axes.errorbar(value, k, xerr=np.nan_to_num(spread), color=colour, lw=0.7)
            axes.errorbar(
                value,
                k,
                xerr=np.nan_to_num(1.96 * error),
                color=colour,
                fmt=MARKERS[k % len(MARKERS)],
                ms=3.4,
                lw=2.0,
            )
    axes.margins(x=0.12)
    axes.locator_params(axis="x", nbins=4)
    axes.grid(axis="y", visible=False)


def _numbers(values: pd.Series) -> pd.Series:
    return values.map(lambda value: float(value) if isinstance(value, int | float) else np.inf)


def _slug(text: str) -> str:
    return "".join(c if c.isalnum() else "-" for c in text.lower()).replace("--", "-")
