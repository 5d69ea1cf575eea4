"""Whether a fit on a drawn axis that says it converged is far off: 1000 records, a new axis each.

    python -m benchmarks.axes.astray rows.csv 540     # goes on where rows.csv ends, for 540 s
    python -m benchmarks.axes.astray rows.csv         # writes benchmarks/results/axes/astray.md

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

RESULTS = Path(__file__).parents[1] / "results" / "axes"
SEED, RECORDS = 2026, 1000
METHODS = ("idim-ls", "ddm-ls", "lmi-ls", "idim-iv", "ddm-iv", "lmi-iv", "idim-bciv", "idim-piv",
           "didim", "clie", "cloe")  # fmt: skip
SELDOM, EVERY = ("idim-wls", "ml", "oloe", "set-membership"), 5  # on every fifth record


def rows_of(index: int, case: Case) -> list[dict]:
    """Return one row per method and parameter of a case's record 0."""
    problem = iv.Problem(case.record(0), case.loop)
    methods = METHODS + (SELDOM if index % EVERY == 0 else ())
    return [row for method in methods for row in _fitted(index, case, problem, method)]


def _fitted(index: int, case: Case, problem: iv.Problem, method: str) -> list[dict]:
    """Fit one method; a failure is rows of NaN with its error."""
    names, start = list(problem.names), process_time()
    nothing = pd.Series(np.nan, index=names)
    theta, std, converged, error = nothing, nothing, False, ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            fit = estimator_class(method)().fit(problem)
            theta, std, converged = fit.params, fit.std_errors, fit.converged
        except IVToolsError as raised:
            error = str(raised)
    spent = process_time() - start
    return [
        {"record": index, "case": case.name, "rate": case.sampling_hz, "method": method}
        | {"converged": converged, "parameter": name, "true": case.theta[name]}
        | {"theta": theta.get(name, np.nan), "std_error": std.get(name, np.nan)}
        | {"seconds": spent, "error": error}
        for name in names
    ]


def run(path: Path, seconds: float) -> None:
    """Append the records that are not there, until the time is up."""
    done = 1 + int(pd.read_csv(path, usecols=["record"])["record"].max()) if path.exists() else 0
    cases, end = population(RECORDS, SEED), monotonic() + seconds
    for index in range(done, RECORDS):
        if monotonic() > end:
            return
        table = pd.DataFrame(rows_of(index, cases[index]))
        table.to_csv(path, mode="a", header=not path.exists(), index=False)


if __name__ == "__main__":
    run(Path(sys.argv[1]), float(sys.argv[2]))
