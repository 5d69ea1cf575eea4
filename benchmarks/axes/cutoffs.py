"""How far the default cut-off is from the best one, on drawn axes: RMSE of IDIM-IV and IDIM-PIV.

    python -m benchmarks.axes.cutoffs rows.csv 540      # goes on where rows.csv ends, for 540 s
    python -m benchmarks.axes.cutoffs rows.csv          # writes benchmarks/results/axes/cutoffs.md

Of each axis ten records are fitted with its default pipeline and with the same one at other
cut-offs; an error is relative to the true value, and its square is averaged over the parameters
and the records. The best of eight is the best by chance as well: with ten records, two equally
good cut-offs differ by a factor of 1.2 to 1.3.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from time import monotonic

import numpy as np
import pandas as pd

import ivtools as iv
from ivtools.errors import IVToolsError
from ivtools.study import Case

from .population import population

RESULTS = Path(__file__).parents[1] / "results" / "axes"
SEED, AXES, RECORDS = 2027, 60, 10
FACTORS = (0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8)
METHODS = {"idim-iv": iv.IDIMIV(), "idim-piv": iv.IDIMPIV()}


def rows_of(index: int, case: Case) -> list[dict]:
    """Return the root mean square error of a case by method and factor of the cut-off."""
    records = [case.record(seed) for seed in range(RECORDS)]
    return [
        {"axis": index, "case": case.name, "method": method, "factor": factor}
        | {"rmse": _rmse(case, records, factor, METHODS[method])}
        for method in METHODS
        for factor in FACTORS
    ]


def _rmse(case: Case, records: list[iv.Record], factor: float, estimator: iv.IDIMIV) -> float:
    """Return the error in %; NaN where the cut-off has no place below Nyquist's."""
    true, errors = np.array(list(case.theta.values())), []
    for record in records:
        cutoff = factor * case.loop.pipeline(record).cutoff_hz
        if cutoff > 0.45 * record.sampling_hz:
            return np.nan
        pipeline = case.loop.pipeline(record, cutoff_hz=cutoff) if factor != 1.0 else None
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                theta = estimator.fit(iv.Problem(record, case.loop, pipeline)).params.to_numpy()
        except IVToolsError:
            return np.inf
        errors.append(theta / true - 1.0)
    return 100.0 * float(np.sqrt(np.mean(np.square(errors))))


def run(path: Path, seconds: float) -> None:
    """Append the axes that are not there, until the time is up."""
    done = 1 + int(pd.read_csv(path, usecols=["axis"])["axis"].max()) if path.exists() else 0
    end = monotonic() + seconds
    noisy = [case for case in population(2 * AXES, SEED) if case.force_noise][:AXES]
    for index in range(done, len(noisy)):
        if monotonic() > end:
            return
        table = pd.DataFrame(rows_of(index, noisy[index]))
        table.to_csv(path, mode="a", header=not path.exists(), index=False)


def summarise(path: Path) -> str:
    """Return the table, in Markdown."""
    table = pd.read_csv(path)
    wide = table.pivot(index=["method", "axis", "case"], columns="factor", values="rmse")
    ratio = (wide[1.0] / wide.min(axis=1)).rename("ratio").reset_index()
    lines = [
        f"# The default cut-off against the best one, {ratio['axis'].nunique()} drawn axes",
        "",
    ]
    lines += [str(__doc__).split("\n\n")[-1].strip(), ""]
    lines += ["| method | median ratio of RMSE | 90 % of the axes below | largest | within 2 |"]
    lines += ["|---|" + "---|" * 4]
    for method, group in ratio.groupby("method"):
        r = group["ratio"]
        lines.append(f"| {method} | {r.median():.2f} | {r.quantile(0.9):.2f} | {r.max():.2f} "
                     f"| {(r <= 2.0).sum()} of {len(r)} |")  # fmt: skip
    lines += ["", "Median RMSE by cut-off, over that of the default:", ""]
    lines += ["| method | " + " | ".join(f"{f:g}" for f in FACTORS) + " |"]
    lines += ["|---|" + "---|" * len(FACTORS)]
    for method, group in wide.groupby("method"):
        cells = [f"{(group[f] / group[1.0]).median():.2f}" for f in FACTORS]
        lines.append(f"| {method} | " + " | ".join(cells) + " |")
    worst = ratio[ratio["ratio"] > 2.0].sort_values("ratio", ascending=False)
    lines += ["", "Beyond a factor of 2:" if len(worst) else "None is beyond a factor of 2.", ""]
    lines += [f"- {r.method}, {r.case}: {r.ratio:.2f}" for r in worst.itertuples()]
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    rows = Path(sys.argv[1])
    if len(sys.argv) > 2:
        run(rows, float(sys.argv[2]))
    else:
        (RESULTS / "cutoffs.md").write_text(summarise(rows), encoding="utf-8")
