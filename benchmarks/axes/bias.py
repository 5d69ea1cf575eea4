"""Bias of IDIM-BCIV and IDIM-PIV, parameter by parameter, on the study `axes`.

python -m benchmarks.axes.bias run FOLDER 60    # goes on where FOLDER ends; 60 seeds
python -m benchmarks.axes.bias table FOLDER     # writes results/axes/bias.csv and bias.md
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pandas as pd
from scipy.stats import norm

from ivtools.study import Study
from ivtools.study.named import load

from .summary import RESULTS, cell

METHODS = ("idim-bciv", "idim-piv")
MOST, MOST_PERCENT = 0.3, 0.3  # standard errors and % that a bias is to stay below
HEAD = """# Bias of the bias-compensated methods, parameter by parameter

{fewest} to {seeds} records of each of {cases} noisy cases of the study `axes`, default pipeline
and settings, by `benchmarks/axes/bias.py`. A cell is one parameter of one case, its bias the mean
error. So many records tell a mean to {told:.2f} to {least:.2f} of the deviation of one estimate,
its **standard error**: of {count} cells without any bias the largest would be {chance:.2f} by
chance, and {over:.0f} would be above {most}.

- **above**: cells with more than {most} standard errors; **surely**: by two deviations of the mean.
- **above, %**: cells with more than {most_percent} % of the true value; **surely** likewise.
- **sum of squares**: of the means over their own deviation, per cell: 1 without any bias.

| method | axes | cells | largest | where | above | surely | above, % | surely | sum of squares |
|---|---|---|---|---|---|---|---|---|---|
"""


def study(seeds: int) -> Study:
    """Return the noisy cases of the study for the two methods."""
    whole = load("axes", seeds=seeds)
    labels = dict(whole.estimators)
    noisy = [case for case in whole.cases if "noise none" not in case.name]
    return replace(whole, cases=noisy, estimators={m: labels[m] for m in METHODS})


def cells(table: pd.DataFrame) -> pd.DataFrame:
    """Return one row per method, case and parameter."""
    good = table[table["converged"] & (table["error"] == "")]
    error = good["theta"] - good["theta_true"]
    good = good.assign(miss=error, percent=100.0 * error / good["theta_true"].abs())
    groups = good.groupby(["estimator", "case", "parameter"], observed=True)
    sd, n = groups["miss"].std(), groups["miss"].count()
    found = pd.DataFrame({"records": n, "bias": groups["miss"].mean() / sd, "told": n**-0.5})
    return found.assign(
        percent=groups["percent"].mean(), percent_told=groups["percent"].std() * n**-0.5
    ).reset_index()


def markdown(found: pd.DataFrame) -> str:
    """Return the table."""
    told = found.loc[found["estimator"] == METHODS[0], "told"].to_numpy()
    draws = np.abs(np.random.default_rng(0).standard_normal((500, len(told)))) * told
    lines = HEAD.format(
        fewest=found["records"].min(),
        seeds=found["records"].max(),
        cases=found["case"].nunique(),
        told=told.min(),
        least=told.max(),
        count=len(told),
        chance=np.median(draws.max(axis=1)),
        over=2.0 * norm.sf(MOST / told).sum(),
        most=MOST,
        most_percent=MOST_PERCENT,
    )
    valve = found["case"].astype(str).str.contains("valve")
    for axes, part in (("eleven", found[~valve]), ("valve", found[valve])):
        for method, rows in part.groupby("estimator", observed=True):
            size, percent = rows["bias"].abs(), rows["percent"].abs()
            worst = rows.loc[size.idxmax()]
            where = f"{worst['parameter']}, {str(worst['case']).removeprefix('axis ')}"
            lines += (
                f"| {method} | {axes} | {len(rows)} | {cell(size.max(), '.2f')} | {where} "
                f"| {(size > MOST).sum()} | {(size - 2.0 * rows['told'] > MOST).sum()} "
                f"| {(percent > MOST_PERCENT).sum()} "
                f"| {(percent - 2.0 * rows['percent_told'] > MOST_PERCENT).sum()} "
                f"| {cell(float(((size / rows['told']) ** 2).mean()), '.2f')} |\n"
            )
    return lines


def main(task: str, folder: str, seeds: str = "1000") -> None:
    """Run the study, or write its table."""
    if task == "run":
        study(int(seeds)).run(path=folder)
        return
    table = study(int(seeds)).table(folder)
    found = cells(table)
    found.to_csv(RESULTS / "bias.csv", index=False, float_format="%.4g")
    (RESULTS / "bias.md").write_text(markdown(found), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
