"""The report of a study, in Markdown and as one HTML page."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pandas as pd

from ivtools.tables import Text, rounded, table

if TYPE_CHECKING:
    from ivtools.report import Card, Page
    from ivtools.study.score import Score

_OVERALL = {
    "estimator": "estimator",
    "rmse": "RMSE %",
    "bias": "bias %",
    "coverage": "coverage %",
    "converged": "converged %",
    "failed": "failed %",
    "holdout_error": "hold-out error %",
    "n_simulations": "simulations",
    "runtime": "ms per fit",
}
_LEGEND = (
    "RMSE and bias are in per cent of the true value, with Monte-Carlo standard errors; coverage "
    "is that of the 95 % intervals; efficiency is the squared Cramer-Rao bound over the mean "
    "squared error. They are over the fits that converged; RMSE and bias of a case are root mean "
    "squares over its parameters. The time of a fit leaves out the simulation and the filtering "
    "of the record, which all estimators share."
)


def markdown(score: Score) -> str:
    """Return a score's report in Markdown."""
    lines = [f"# {score.title or 'Monte-Carlo study'}", ""]
    lines += [score.question, ""] if score.question else []
    lines += [f"{score!r}. {_LEGEND}", ""]
    for case, rows in _by_case(overall(score)):
        lines += [f"## {case}", "", _pipes(rows), ""]
        lines += [_pipes(group) for _, group in _by_case(details(score, case))] + [""]
        lines += [f"Smallest RMSE, ties within chance included: {first(score, case)}.", ""]
    return "\n".join(lines)


def page(score: Score, figures: bool = True) -> Page:
    """Return a score's report as a page."""
    from ivtools.plots import study
    from ivtools.report import Page, Picture

    out = Page(score.title or "Monte-Carlo study", score.question, card(score))
    drawn = [Picture(*found) for found in study.figures(score)] if figures else []
    out.add("At a glance", f"{score!r}. {_LEGEND}", figures=drawn)
    for case, rows in _by_case(overall(score)):
        parameters = details(score, case).drop(columns="case")
        best = f"Smallest RMSE, ties within chance included: {first(score, case)}."
        folded = [("By parameter", _laid_out(parameters, 2))]
        out.add(case.replace("_", " "), best, tables=[_laid_out(rows, 1)], folded=folded)
    return out


def card(score: Score) -> Card:
    """Return a score in short: who is never beaten, who is biased, who does not converge."""
    from ivtools.report import Card

    best, biased, fits = score.best(), score.biased(), score.fits
    pairs = best.groupby(["case", "parameter"], observed=True).ngroups
    wins = best["estimator"].value_counts()
    leaders = [str(name) for name in wins[wins == wins.max()].index] if len(wins) else []
    verdict = "No estimator has a score."
    if leaders:
        names, count = " and ".join(leaders), int(wins.max())
        verdict = f"{names}: least error, or not told from it, in {count} of {pairs} comparisons."
    lasting = biased["estimator"].value_counts()
    told = ", ".join(f"{name} {n}" for name, n in lasting.items() if n) or "none"
    facts = [
        ("Comparisons", "a parameter in a case: which estimator has the smallest RMSE"),
        ("Biased beyond three standard errors", f"{told} of {pairs}" if len(biased) else told),
    ]
    lost = fits[fits["converged"] < 100.0].groupby("estimator", observed=True).size()
    if len(lost := lost[lost > 0]):
        text = ", ".join(f"{name} in {n} case{'s' * (n > 1)}" for name, n in lost.items())
        facts.append(("Not always converged", text))
    return Card(verdict, tuple(facts), (), "good" if leaders else "doubt")


def text(score: Score) -> Text:
    """Return the first table of each case, at most 80 columns wide."""
    header = ["", "RMSE %", "bias %", "cover %", "conv. %", "ms"]
    tables = []
    for case, rows in _by_case(overall(score)):
        keep = rows[["estimator", "RMSE %", "bias %", "coverage %", "converged %", "ms per fit"]]
        cells = [[_cell(v) for v in row] for row in keep.itertuples(index=False)]
        tables.append(table(case, [], header, cells))
    return Text("\n\n".join(map(str, tables)), "".join(t.html for t in tables))


def overall(score: Score) -> pd.DataFrame:
    """Return the first table of each case, the smallest RMSE first."""
    rows = score.overall.assign(runtime=1e3 * score.overall["runtime"])
    rows = rows.sort_values(["case", "rmse"], kind="stable")
    return rows[["case", *_OVERALL]].rename(columns=_OVERALL)


def details(score: Score, case: str) -> pd.DataFrame:
    """Return the scores by parameter of one case, as people read them."""
    rows = score.table[score.table["case"] == case]
    shown = rows[["case", "parameter", "estimator"]].copy()
    for name in ("bias", "sd", "rmse"):
        pairs = zip(rows[name], rows[f"{name}_mcse"], strict=True)
        label = "RMSE" if name == "rmse" else name
        shown[f"{label} %"] = [" ± ".join(rounded(value, error, 1)) for value, error in pairs]
    shown["coverage %"] = rows["coverage"].map("{:.3g}".format)
    shown["efficiency %"] = rows["efficiency"].map("{:.3g}".format)
    shown["fits"] = rows["n"].astype(int)
    return shown.sort_values(["parameter", "estimator"], kind="stable")


def first(score: Score, case: str) -> str:
    """Return who has the smallest RMSE of each parameter of a case."""
    best = score.best()
    groups = best[best["case"] == case].groupby("parameter", observed=True)["estimator"]
    return "; ".join(f"{parameter}: {', '.join(names)}" for parameter, names in groups)


def _by_case(rows: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    groups = rows.groupby("case", observed=True, sort=True)
    return [(str(case), group.drop(columns="case")) for case, group in groups]


def _cell(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _pipes(table: pd.DataFrame) -> str:
    """Return a table in Markdown."""
    rows = [list(table.columns), ["---"] * table.shape[1]]
    rows += [[_cell(v) for v in row] for row in table.itertuples(index=False)]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows) + "\n"


def _laid_out(frame: pd.DataFrame, left: int) -> Text:
    """Return a table for a page, its numbers on the right."""
    rows = [[_cell(v) for v in row] for row in frame.itertuples(index=False)]
    return table("", [], list(frame.columns), rows, left=left)
