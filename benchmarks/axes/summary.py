"""What the study `axes` says in one table per noise, from the folder of its rows.

    ivtools benchmark axes --seeds 9 --out FOLDER
    python -m benchmarks.axes.summary FOLDER/rows

writes benchmarks/results/axes: scores.csv, fits.csv, summary.csv and README.md. What the folder
has no rows of keeps those of the run before.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.special import stdtrit
from scipy.stats import chi2

from ivtools.study.named import load
from ivtools.study.score import Score

RESULTS = Path(__file__).parents[1] / "results" / "axes"
OFF_PERCENT, OFF_ERRORS = 20.0, 5.0
HEAD = """# Axes: default settings on twelve axes under four noises

{seeds} records of each of 48 cases (`ivtools benchmark axes`), on axes and seeds that nothing was
tuned on, of a slow method fewer; default pipeline, default settings. Tables by
`benchmarks/axes/summary.py`. Eleven axes first, `conveyor` with 36 % of standstill among them;
`valve`, where it ends, by itself.

- **converged**: share of the records; the rest of a row speaks of these.
- **bias**: over axes and parameters, median and largest of |mean error| in standard deviations of
  the estimate. With {seeds} records chance alone makes {chance:.2f} in the median and
  {most:.2f} at most.
- **bias, %**: the same of the true value.
- **coverage**: of the 95 % intervals, mean over axes and parameters.
- **largest z**: error of any parameter in standard errors.
- **/ bound**: variance over the Cramer-Rao bound, median, without what so few records take from a
  median. The bound counts every sample, those of reversals too, which the default pipeline masks.
- **by errors**: the same of the mean squared standard error. As far as intervals cover what they
  say, it is the same figure, and better known: so few records tell a variance to {vague:.0f} %.
- **off**: records that converged with a parameter more than 20 % *or* 5 standard errors off; of
  these
- **unsaid**: with such a parameter that the result does not mark (`FitResults.weak`).

A study takes every fit as it is: that instruments contradict least squares, which then says that
it has not converged, does not count here ([astray.md](astray.md) counts it).
{earlier}"""
EARLIER = """
Methods with a dagger were not run again when the others were: their rows are of earlier code, which
has not changed for them by intention.
"""
VALVE = """## The valve

Dry friction three times the force of acceleration, 39 % of the record at standstill, 250 Hz. Noise
decides when it sticks, and the mask of least squares keeps the rows that it has pushed; methods
with a simulation choose theirs by it (`Problem.masked_by`). Each move accelerates for eight
samples, next to standstill. They alone show the inertia, and what the low-pass smears of them is
the error without noise: 1 % of least squares, 1.7 % of DIDIM.
"""


def rows_of(table: pd.DataFrame, bounds: pd.DataFrame) -> pd.DataFrame:
    """Return one row per set of axes, noise and estimator."""
    names = table["case"].astype(str)
    table = table.assign(
        noise=names.str.split("noise ").str[-1],
        axes=np.where(names.str.contains("valve"), "valve", "eleven"),
    )
    found = []
    for (axes, noise, method), group in table.groupby(
        ["axes", "noise", "estimator"], observed=True
    ):
        fits = group.drop_duplicates(["case", "seed"])
        good = group[group["converged"] & (group["error"] == "")]
        found.append(
            {"axes": axes, "noise": noise, "estimator": method, "fits": len(fits)}
            | {"converged": 100.0 * (fits["converged"] & (fits["error"] == "")).mean()}
            | _scores(good, bounds, noise != "none")
        )
    return pd.DataFrame(found)


def _scores(good: pd.DataFrame, bounds: pd.DataFrame, noisy: bool) -> dict[str, float]:
    error = good["theta"] - good["theta_true"]
    good = good.assign(
        error=error, z=error / good["std_error"], percent=100.0 * error / good["theta_true"].abs()
    )
    off = good["percent"].abs() > OFF_PERCENT
    if noisy:
        off |= good["z"].abs() > OFF_ERRORS
    cells = good.groupby(["case", "parameter"], observed=True)
    mean, sd, freedom = cells["error"].mean(), cells["error"].std(), cells["error"].count() - 1
    bias = (mean / sd).abs()
    bound = bounds.reindex(sd.index)
    ratio = (sd / bound) ** 2 / (chi2.ppf(0.5, freedom) / freedom)
    stated = good["std_error"].pow(2).groupby([good["case"], good["parameter"]], observed=True)
    inside = (good["error"].abs() < good["half_width"])[good["half_width"].notna()]
    return {
        "bias_sd_median": bias.median() if noisy else np.nan,
        "bias_sd_max": bias.max() if noisy else np.nan,
        "bias_percent_median": cells["percent"].mean().abs().median(),
        "bias_percent_max": cells["percent"].mean().abs().max(),
        "coverage": 100.0 * inside.mean() if noisy and len(inside) else np.nan,
        "largest_z": good["z"].abs().max() if noisy else np.nan,
        "variance_over_bound": ratio.median() if noisy else np.nan,
        "stated_over_bound": (stated.mean() / bound**2).median() if noisy else np.nan,
        "off": len(good[off].drop_duplicates(["case", "seed"])),
        "unsaid": len(good[off & ~_weak(good)].drop_duplicates(["case", "seed"])),
    }


def _weak(good: pd.DataFrame) -> pd.Series:
    """Return what `FitResults.weak` names; the rows have the freedom in their half widths."""
    freedom = np.geomspace(1.0, 1e7, 20_001)
    critical = (good["half_width"] / good["std_error"]).to_numpy()
    freedom = np.interp(-critical, -stdtrit(freedom, 0.975), freedom)
    reach = 100.0 * stdtrit(freedom, 0.9995) * good["std_error"] / good["theta"].abs()
    return ~(reach <= OFF_PERCENT)


def markdown(rows: pd.DataFrame, seeds: int) -> str:
    """Return the tables."""
    draws = np.abs(np.random.default_rng(0).standard_normal((500, 44))) / np.sqrt(seeds)
    lines = [
        HEAD.format(
            seeds=seeds,
            vague=100.0 * np.sqrt(2.0 / (seeds - 1.0)),
            chance=np.median(draws),
            most=np.median(draws.max(axis=1)),
            earlier=EARLIER if rows["earlier"].any() else "",
        )
    ]
    valve = rows["axes"] == "valve"
    for noise, part in rows[~valve].groupby("noise", sort=False):
        lines += [f"## Noise: {noise}", "", *_table(part), ""]
    lines.append(VALVE)
    for noise, part in rows[valve].groupby("noise", sort=False):
        lines += [f"### Noise: {noise}", "", *_table(part), ""]
    return "\n".join(lines)


def _table(part: pd.DataFrame) -> list[str]:
    lines = ["| method | records | converged, % | bias | largest | bias, % | largest | coverage, % "
             "| largest z | / bound | by errors | off | unsaid |",
             "|---|" + "---|" * 12]  # fmt: skip
    for r in part.itertuples():
        cells = [
            r.estimator + ("†" if r.earlier else ""),
            f"{r.fits:.0f}",
            f"{r.converged:.1f}",
            *(cell(v, ".2f") for v in (r.bias_sd_median, r.bias_sd_max)),
            *(cell(v, ".3g") for v in (r.bias_percent_median, r.bias_percent_max)),
            cell(r.coverage, ".1f"),
            cell(r.largest_z, ".1f"),
            cell(r.variance_over_bound, ".2f"),
            cell(r.stated_over_bound, ".2f"),
            f"{r.off:.0f}",
            cell(r.unsaid, ".0f"),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def cell(value: float, form: str) -> str:
    """Return a number as text; a dash if it is not finite."""
    return f"{value:{form}}" if np.isfinite(value) else "-"


def main(folder: str) -> None:
    """Write the tables."""
    study = load("axes", seeds=1000)  # as many as there are
    table = study.table(folder)
    seeds = int(table.groupby("case", observed=True)["seed"].nunique().min())
    study = replace(study, seeds=seeds)
    table = table[table["seed"] < seeds]
    score = Score.of(table, study)
    bounds = pd.concat(
        {case.name: case.bound() for case in study.cases}, names=["case", "parameter"]
    )
    RESULTS.mkdir(parents=True, exist_ok=True)
    rows = _kept("summary.csv", rows_of(table, bounds).assign(earlier=False))
    order = list(dict(study.estimators))
    rows = rows.sort_values(["axes", "noise", "estimator"], key=lambda c: c.map(_place(order, c)))
    for name, part in (("scores.csv", score.table), ("fits.csv", score.fits)):
        _kept(name, part).to_csv(RESULTS / name, index=False, float_format="%.5g")
    rows.to_csv(RESULTS / "summary.csv", index=False, float_format="%.5g")
    (RESULTS / "README.md").write_text(markdown(rows, seeds), encoding="utf-8")


def _place(order: list[str], column: pd.Series) -> dict[str, int]:
    """Return the places of a column's values: methods in the order of the study."""
    given = order if column.name == "estimator" else sorted(column.unique())
    return {str(value): k for k, value in enumerate(given)}


def _kept(name: str, new: pd.DataFrame) -> pd.DataFrame:
    """Return rows and, of what has none, those of the run before."""
    old = pd.read_csv(RESULTS / name) if (RESULTS / name).exists() else new[:0]
    old = old[~old["estimator"].isin(new["estimator"].astype(str))]
    if "earlier" in new:
        old = old.assign(earlier=True)
    return pd.concat([new, old], ignore_index=True)


if __name__ == "__main__":
    main(sys.argv[1])
