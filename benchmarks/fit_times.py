"""Fit times: what one fit of 24841 samples takes after warm-up, and where the time goes.

    python benchmarks/fit_times.py

writes benchmarks/results/fit_times.csv. The record is the measured one if this machine has it,
else the twin. Each figure is the processor time of one fit, filters and problem included: the best
and the median of many, with the best elapsed time, which a busy machine inflates.
"""

import time
from pathlib import Path

import numpy as np
import pandas as pd

import ivtools as iv
from ivtools.errors import IVToolsError

RESULTS = Path(__file__).parent / "results"
STARTS = {
    "axis": "axis",
    "near": {"inertia": 50.0, "viscous": 50.0, "coulomb": 5.0, "offset": 0.0},
    "far": {"inertia": 500.0, "viscous": 100.0, "coulomb": 50.0, "offset": 10.0},
}


def measured_or_twin() -> iv.Record:
    try:
        return iv.datasets.emps()
    except IVToolsError:
        return iv.datasets.twin()


def milliseconds(work, repeats: int = 30) -> dict[str, float]:
    """Return the best and the median processor time, and the best elapsed time."""
    work()
    processor, elapsed = [], []
    for _ in range(repeats):
        start = time.process_time(), time.perf_counter()
        work()
        processor.append(1e3 * (time.process_time() - start[0]))
        elapsed.append(1e3 * (time.perf_counter() - start[1]))
    return {
        "best_ms": float(np.min(processor)),
        "median_ms": float(np.median(processor)),
        "best_elapsed_ms": float(np.min(elapsed)),
    }


def cases(record: iv.Record):
    """Yield a name and what to time; every fit starts from the record."""
    loop = iv.axes.emps()
    pipeline = loop.pipeline(record)

    def problem() -> iv.Problem:
        return iv.Problem(record, loop, pipeline)

    known = problem()
    theta = iv.IDIMLS().fit(known).params
    yield "band-pass, regressor, decimation", lambda: problem().X
    yield "one simulation", lambda: known.simulate(theta)
    yield "one set of instruments", lambda: known.instruments(theta)
    yield "HAC covariance", lambda: iv.IDIMLS().fit(known)
    yield "idim-ls", lambda: iv.IDIMLS().fit(problem())
    for name, start in STARTS.items():
        fit = iv.IDIMIV(start=start, filtered=False)
        yield f"idim-iv, unfiltered instruments, {name} start", lambda fit=fit: fit.fit(problem())
    yield "idim-iv", lambda: iv.IDIMIV().fit(problem())
    yield "idim-bciv", lambda: iv.IDIMBCIV().fit(problem())
    yield "idim-piv", lambda: iv.IDIMPIV().fit(problem())
    yield "didim", lambda: iv.DIDIM().fit(problem())


def main() -> None:
    record = measured_or_twin()
    rows = []
    for name, work in cases(record):
        rows.append({"what": name, **milliseconds(work), "record": record.name})
    RESULTS.mkdir(exist_ok=True)
    table = pd.DataFrame(rows)
    table.to_csv(RESULTS / "fit_times.csv", index=False, float_format="%.2f")
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
