"""Whether a fit on a drawn axis that says it converged is far off: one record of each of 1000.

    python -m benchmarks.axes.astray run rows.csv 540       # goes on where rows.csv ends, for 540 s
    python -m benchmarks.axes.astray run half.csv 540 500   # the same, from record 500 on
    python -m benchmarks.axes.astray table rows.csv ...     # writes results/axes/astray.md

Each record is that of another axis; rows are appended record by record.
"""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from time import monotonic, process_time

import numpy as np
import pandas as pd

import ivtools as iv
from ivtools.errors import IVToolsError
from ivtools.estimators.base import estimator_class
from ivtools.study import Case

from .population import population
from .summary import cell

OFF_PERCENT, OFF_ERRORS = 20.0, 5.0
HEAD = """# Drawn axes, one record each: does a fit that says it converged go astray?

{records} axes of `population({all}, {seed})`, by `benchmarks/axes/astray.py`. Units
over eight decades, six control laws, 250 Hz to 10 kHz, encoders of 2^11 to 2^20 counts, late
drives, a fifth with friction of one to two times the force of acceleration; default pipeline and
settings. None of these axes was seen before the code was frozen. On every fifth record only:
{seldom}.

- **off**: converged with a parameter more than 20 % or 5 standard errors off, records; of these
- **unsaid**: with such a parameter that the result does not mark (`FitResults.weak`: its 99.9 %
  interval reaches beyond 20 %).
- **marked**: parameters that results mark so, % of all that converged.
- **coverage**: of the 95 % intervals, of records with noise, mean over axes and parameters.
- **bias**: largest over the parameters of |mean z|, z the error in standard errors; chance makes
  about {chance:.2f}.
- **no noise**: largest error of any parameter on the records without noise, %, of what converged.
- **largest**: error of any parameter in standard errors, of records with noise.
- **time**: median of the processor time, ms, on a busy machine, where it is up to twice as long.

{weak}

What instruments contradict counts as not converged: that is what least squares lacks to 100 %.
"""


RESULTS = Path(__file__).parents[1] / "results" / "axes"
SEED, RECORDS = 2036, 1000
METHODS = ("idim-ls", "ddm-ls", "idim-iv", "idim-bciv", "idim-piv", "didim")
SELDOM = ("idim-wls", "ml", "lmi-ls", "lmi-iv", "ddm-iv", "clie", "cloe", "oloe", "set-membership")
EVERY = 5  # the records that the slower ones get


def rows_of(index: int, case: Case) -> list[dict]:
    """Return one row per method and parameter of a case's record 0."""
    problem = iv.Problem(case.record(0), case.loop)
    methods = METHODS + (SELDOM if index % EVERY == 0 else ())
    return [row for method in methods for row in _fitted(index, case, problem, method)]


def _fitted(index: int, case: Case, problem: iv.Problem, method: str) -> list[dict]:
    """Fit one method; a failure is rows of NaN with its error."""
    names, start = list(problem.names), process_time()
    nothing = pd.Series(np.nan, index=names)
    theta, std, reach, weak, converged, error = nothing, nothing, nothing, (), False, ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            fit = estimator_class(method)().fit(problem)
            theta, std, converged = fit.params, fit.std_errors, fit.converged
            reach, weak = (fit.conf_int()["upper"] - theta) / std, fit.weak()
        except IVToolsError as raised:
            error = str(raised)
    spent = process_time() - start
    return [
        {"record": index, "case": case.name, "rate": case.sampling_hz, "method": method}
        | {"converged": converged, "parameter": name, "true": case.theta[name]}
        | {"theta": theta.get(name, np.nan), "std_error": std.get(name, np.nan)}
        | {"reach": reach.get(name, np.nan), "weak": name in weak}
        | {"seconds": spent, "error": error}
        for name in names
    ]


def run(path: Path, seconds: float, first: int = 0, last: int = RECORDS) -> None:
    """Append the records of [first, last) that are not there, until the time is up."""
    if path.exists():
        first = 1 + int(pd.read_csv(path, usecols=["record"])["record"].max())
    cases, end = population(RECORDS, SEED), monotonic() + seconds
    for index in range(first, last):
        if monotonic() > end:
            return
        table = pd.DataFrame(rows_of(index, cases[index]))
        table.to_csv(path, mode="a", header=not path.exists(), index=False)


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return one row per method."""
    table = _judged(table)
    rows = {str(m): _scores(group) for m, group in table.groupby("method", sort=False)}
    return pd.DataFrame(rows).T.rename_axis("method").reset_index()


def _known(table: pd.DataFrame) -> str:
    """Say how well what is more than 20 % off can be known at all."""
    table = _judged(table)
    far = table[table["off"] & (table["percent"].abs() > OFF_PERCENT)]
    found = far[["record", "parameter", "true"]].drop_duplicates(ignore_index=True)
    if found.empty:
        return "None is more than 20 % off."
    cases = population(RECORDS, SEED)
    bounds = [100.0 * cases[r].bound()[p] / abs(t) for r, p, t in found.itertuples(index=False)]
    return (
        f"More than 20 % off is {' or '.join(sorted(set(found['parameter'])))}, of "
        f"{found['record'].nunique()} records. The Cramer-Rao bound of these parameters is "
        f"{min(bounds):.2g} to {max(bounds):.2g} %\nof their values: the deviation of the best "
        "unbiased estimate."
    )


def _judged(table: pd.DataFrame) -> pd.DataFrame:
    """Add the errors, and what is off though it has converged."""
    error = table["theta"] - table["true"]
    table = table.assign(
        z=error / table["std_error"],
        percent=100.0 * error / table["true"].abs(),
        noisy=~table["case"].str.contains(" none"),
    )
    off = table["percent"].abs() > OFF_PERCENT
    off |= table["noisy"] & (table["z"].abs() > OFF_ERRORS)
    return table.assign(off=off & table["converged"])


def _scores(group: pd.DataFrame) -> dict[str, float]:
    fits = group.drop_duplicates("record")
    sure = group[group["converged"] & group["noisy"]]
    clean = group[group["converged"] & ~group["noisy"]]
    return {
        "records": len(fits),
        "converged": 100.0 * fits["converged"].mean(),
        "off": group[group["off"]]["record"].nunique(),
        "unsaid": group[group["off"] & ~group["weak"]]["record"].nunique(),
        "marked": 100.0 * group[group["converged"]]["weak"].mean(),
        "coverage": 100.0 * (sure["z"].abs() < sure["reach"]).mean(),
        "largest": sure["z"].abs().max(),
        "bias": sure.groupby("parameter")["z"].mean().abs().max(),
        "no_noise": clean["percent"].abs().max(),
        "milliseconds": 1e3 * fits["seconds"].median(),
    }


def markdown(table: pd.DataFrame) -> str:
    """Return the table of the methods, and the records that went astray."""
    rows, n = summary(table), table["record"].nunique()
    noisy = table[~table["case"].str.contains(" none")]["record"].nunique()
    lines = [
        HEAD.format(
            records=n,
            all=RECORDS,
            seed=SEED,
            seldom=", ".join(SELDOM),
            chance=2.0 / noisy**0.5,
            weak=_known(table),
        )
    ]
    lines += ["| method | records | converged, % | off | unsaid | marked, % | coverage, % "
              "| largest | bias | no noise, % | time, ms |", "|---|" + "---|" * 10]  # fmt: skip
    for r in rows.itertuples():
        lines.append(
            f"| {r.method} | {r.records:.0f} | {r.converged:.1f} | {r.off:.0f} | {r.unsaid:.0f} "
            f"| {r.marked:.1f} "
            f"| {cell(r.coverage, '.1f')} | {cell(r.largest, '.1f')} "
            f"| {cell(r.bias, '.2f')} | {cell(r.no_noise, '.2g')} "
            f"| {r.milliseconds:.0f} |"
        )
    return "\n".join(lines) + "\n"


def main(paths: list[str]) -> None:
    """Write the tables."""
    table = pd.concat([pd.read_csv(path) for path in paths], ignore_index=True)
    RESULTS.mkdir(parents=True, exist_ok=True)
    summary(table).to_csv(RESULTS / "astray.csv", index=False, float_format="%.4g")
    (RESULTS / "astray.md").write_text(markdown(table), encoding="utf-8")


if __name__ == "__main__":
    task, *rest = sys.argv[1:]
    if task == "run":
        run(Path(rest[0]), float(rest[1]), *(int(part) for part in rest[2:]))
    else:
        main(rest)
