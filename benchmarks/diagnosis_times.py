"""Diagnosis times: how long `iv.diagnose` takes, on two cores and on one, and how it grows.

    python -m benchmarks.diagnosis_times

writes benchmarks/results/diagnosis_times.csv. Each figure is the median of some runs in one warm
process on an idle machine. The EMPS records are those of the data set; the others are simulated
with asymmetric, Stribeck and position-dependent friction on the twin's axis, with a hold-out of
the same length.
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


def main() -> None:
    """Measure, write, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    args = parser.parse_args()
    emps, pulses = iv.datasets.emps(), iv.datasets.emps_pulses()
    pairs = [(emps, pulses), (pulses, emps), (emps, None)]
    pairs += [(moves(*axis(), s, 1), moves(*axis(), s, 2)) for s in SECONDS]
    rows = [timed(a, b, args.repeats, cores) for a, b in pairs for cores in (2, 1)]
    table = pd.DataFrame(rows)
    table.to_csv(RESULTS / "diagnosis_times.csv", index=False)
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
