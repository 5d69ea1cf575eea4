"""What a study costs: CPU time per fit of every estimator, scaling over workers, memory.

    python benchmarks/cost_model.py

writes benchmarks/results/cost-model.csv and cost-model.md. CPU time is that of the process, so
other work on the machine hardly changes it; the ratio of two workers to one is of wall time and
needs a machine that has nothing else to do. Linux only.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import joblib
import numpy as np
import pandas as pd

import ivtools as iv
from ivtools.estimators.base import METHODS, estimator_class
from ivtools.study import Case, Study, Trapezoids
from ivtools.study.work import Bench, payload, quiet

RESULTS = Path(__file__).parent / "results"
THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
ROWS = {"force_shift": 0.5, "min_speed": 0.005, "guard": 10}
MEMORY_RUN = """
import sys
sys.path.insert(0, sys.argv[3])
from cost_model import Nothing, case
from ivtools.study import Study, Trapezoids
short = case(1.0, Trapezoids(1.0, strokes=(0.03,), speeds=(0.12,)))
rows = len(Study([short], [Nothing()], int(sys.argv[1])).run(path=sys.argv[2]))
print(rows, int(open("/proc/self/status").read().split("VmHWM:")[1].split()[0]) / 1024)
"""


class Nothing:
    """No estimator at all: what is left is the record and its rows."""

    def fit(self, problem):
        return dict.fromkeys(problem.names, 1.0)


def case(duration: float, reference: Trapezoids | None = None) -> Case:
    """Return an EMPS-like axis at 1 kHz."""
    return Case(
        f"{duration:g} s",
        iv.axes.emps(),
        THETA,
        reference or Trapezoids(duration),
        encoder_noise=1e-6,
        force_noise=5.0,
        pipeline=ROWS,
    )


def cpu_per_seed(estimator: object, duration: float, budget_s: float) -> float:
    """Return the CPU time of one repetition, s: the record, its rows and one fit."""
    bench = Bench(case(duration), {"one": estimator})
    with quiet():
        bench.rows(0)  # warms the hold-out, caches and imports
        bench.rows(1)
        start, seeds = time.process_time(), 0
        while time.process_time() - start < budget_s or seeds < 3:
            bench.rows(2 + seeds)
            seeds += 1
    return (time.process_time() - start) / seeds


def wall_per_seed(duration: float, seeds: int, jobs: int) -> float:
    """Return the wall time of one repetition with IDIM-IV, s, workers warm."""
    study = Study([case(duration)], [iv.IDIMIV()], seeds)
    Study([case(duration)], [iv.IDIMIV()], 2 * jobs).run(n_jobs=jobs)
    start = time.perf_counter()
    study.run(n_jobs=jobs)
    return (time.perf_counter() - start) / seeds


def cpu_in_worker(sent: bytes, first: int, last: int) -> float:
    """Return the CPU time that a worker spends on some repetitions, s."""
    from ivtools.study.work import work

    work(sent, 0, 2)
    start = time.process_time()
    work(sent, first, last)
    return time.process_time() - start


def cpu_with_workers(duration: float, seeds: int, jobs: int) -> float:
    """Return the CPU time of one repetition with IDIM-IV, s, with so many workers at once."""
    sent = payload(case(duration), {"iv": iv.IDIMIV()})
    blocks = [(seeds * k, seeds * (k + 1)) for k in range(jobs)]
    parallel = joblib.Parallel(jobs if jobs > 1 else 2, batch_size=1)
    return sum(parallel(joblib.delayed(cpu_in_worker)(sent, *b) for b in blocks)) / (seeds * jobs)


def peak_mb(seeds: int) -> tuple[int, float]:
    """Return the rows of a streamed study and the peak memory of its process, MB."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", MEMORY_RUN, str(seeds), folder, str(Path(__file__).parent)]
        out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    rows, peak = out.split()
    return int(rows), float(peak)


def estimators(budget_s: float) -> pd.DataFrame:
    """Return the cost of every estimator."""
    short, long = (cpu_per_seed(Nothing(), d, budget_s) for d in (10.0, 24.84))
    rows = [{"estimator": "record and rows alone", "ms": 1e3 * short, "ms_24.84_s": 1e3 * long}]
    for key in METHODS:
        try:
            whole = [cpu_per_seed(estimator_class(key)(), d, budget_s) for d in (10.0, 24.84)]
        except Exception as error:  # an extra that is not installed
            print(f"{key}: {error}")
            continue
        rows.append({"estimator": key, "ms": 1e3 * whole[0], "ms_24.84_s": 1e3 * whole[1]})
    table = pd.DataFrame(rows)
    table["per_s_and_core"] = 1e3 / table["ms"]
    table["million_1_worker_h"] = table["ms"] / 3.6
    table["million_100_workers_min"] = table["ms"] / 3.6 * 60.0 / 100.0
    return table


def markdown(table: pd.DataFrame, facts: dict[str, str]) -> str:
    """Return the tables that the documentation quotes."""
    head = [
        "| estimator | CPU ms, 10 s record | CPU ms, 24.84 s record | repetitions/s per core | "
        "10^6 on 1 worker, h | 10^6 on 100 workers, min |",
        "|---|---|---|---|---|---|",
    ]
    body = [
        f"| {r[1]} | {r[2]:.1f} | {r[3]:.1f} | {r[4]:.0f} | {r[5]:.1f} | {r[6]:.1f} |"
        for r in table.itertuples()
    ]
    rest = ["", "| measured | |", "|---|---|", *(f"| {k} | {v} |" for k, v in facts.items())]
    return "\n".join(["# Cost model", "", *head, *body, *rest, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--budget", type=float, default=1.0, help="CPU s per figure")
    parser.add_argument("--seeds", type=int, default=600, help="for the scaling")
    parser.add_argument("--memory", type=int, default=25_000, help="repetitions of four rows")
    options = parser.parse_args()
    table = estimators(options.budget)
    facts = {}
    for duration in (10.0, 24.84):
        one, two = (min(wall_per_seed(duration, options.seeds, j) for _ in "12") for j in (1, 2))
        facts[f"record + IDIM-IV, {duration:g} s at 1 kHz: 1 worker"] = f"{1 / one:.0f} per s"
        facts[f"record + IDIM-IV, {duration:g} s at 1 kHz: 2 workers"] = f"{1 / two:.0f} per s"
        facts[f"ratio of 2 workers to 1, {duration:g} s, wall time"] = f"{one / two:.2f}"
        alone, both = (1e3 * cpu_with_workers(duration, options.seeds // 4, j) for j in (1, 2))
        label = f"CPU per repetition, {duration:g} s: 1 worker, 2 at once (2 / their ratio)"
        facts[label] = f"{alone:.2f} ms, {both:.2f} ms ({2.0 * alone / both:.2f})"
    for seeds in (options.memory // 10, options.memory):
        rows, peak = peak_mb(seeds)
        facts[f"peak memory, {rows} rows streamed and returned"] = f"{peak:.0f} MB"
    facts["load of the machine during the scaling"] = f"{os.getloadavg()[1]:.1f}"
    RESULTS.mkdir(exist_ok=True)
    table.round(3).to_csv(RESULTS / "cost-model.csv", index=False)
    (RESULTS / "cost-model.md").write_text(markdown(table, facts), encoding="utf-8")
    print(markdown(table, facts))


if __name__ == "__main__":
    np.seterr(all="ignore")
    main()
