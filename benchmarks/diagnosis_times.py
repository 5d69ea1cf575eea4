"""Diagnosis times: how long `iv.diagnose` takes, on two cores and on one, and how it grows.

    python -m benchmarks.diagnosis_times

writes benchmarks/results/diagnosis_times.csv. Each figure is the median of some runs in one warm
process on an idle machine. The EMPS records are those of the data set; the others are simulated
with asymmetric, Stribeck and position-dependent friction on the twin's axis, with a hold-out of
the same length. Of a fleet it is the time per record, the start of the workers included.
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np
import pandas as pd

import ivtools as iv
from benchmarks.moves import record as moves
from ivtools.record import Record

RESULTS = Path(__file__).parent / "results"
SECONDS = (12.5, 25.0, 50.0, 100.0)
FLEET = 12


def axis() -> tuple[iv.ClosedLoop, dict[str, float]]:
    """Return the loop that the records come from, and its parameters."""
    loop = iv.axes.emps()
    for effect in ("asymmetric-viscous", "stribeck", "position-friction"):
        loop = loop.with_effect(effect)
    theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    theta |= {"asymmetric-viscous.delta": -35.0, "stribeck.force": 6.0, "stribeck.speed": 0.01}
    return loop, theta | {"position-friction.slope": 12.0, "position-friction.curvature": 0.0}


def timed(record: Record, holdout: Record | None, repeats: int, cores: int) -> dict[str, object]:
    """Return the median wall time of a diagnosis on so many cores."""
    everything = os.sched_getaffinity(0)
    os.sched_setaffinity(0, set(sorted(everything)[:cores]))
    try:
        times = []
        for _ in range(repeats + 1):  # the first one warms up
            start = time.perf_counter()
            gap = iv.diagnose(record, iv.axes.emps(), holdout)
            times.append(time.perf_counter() - start)
    finally:
        os.sched_setaffinity(0, everything)
    return {
        "record": record.name,
        "holdout": "" if holdout is None else holdout.name,
        "samples": record.n_samples,
        "cores": cores,
        "seconds": round(float(np.median(times[1:])), 2),
        "effects": " ".join(gap.effects),
    }


def fleet(records: list[Record], holdout: Record, repeats: int, n_jobs: int) -> dict[str, object]:
    """Return the median wall time per record of a fleet, judged by one hold-out."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        found = iv.diagnose_fleet(records, iv.axes.emps(), holdout, n_jobs=n_jobs)
        times.append((time.perf_counter() - start) / len(records))
    return {
        "record": f"{len(records)} records of {records[0].name.partition(',')[0]}",
        "holdout": holdout.name,
        "samples": records[0].n_samples,
        "cores": n_jobs,
        "seconds": round(float(np.median(times)), 2),
        "effects": " ".join(found.effects()),
    }


def main() -> None:
    """Measure, write, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    args = parser.parse_args()
    emps, pulses = iv.datasets.emps(), iv.datasets.emps_pulses()
    pairs = [(emps, pulses), (pulses, emps), (emps, None)]
    pairs += [(moves(*axis(), s, 1), moves(*axis(), s, 2)) for s in SECONDS]
    rows = [timed(a, b, args.repeats, cores) for a, b in pairs for cores in (2, 1)]
    many = [moves(*axis(), 25.0, seed) for seed in range(3, 3 + FLEET)]
    rows += [fleet(many, moves(*axis(), 25.0, 1), 3, n_jobs) for n_jobs in (2, 1)]
    table = pd.DataFrame(rows)
    table.to_csv(RESULTS / "diagnosis_times.csv", index=False)
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
