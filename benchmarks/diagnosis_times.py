"""Diagnosis times: how long `iv.diagnose` takes, on two cores and on one, and how it grows.

    python benchmarks/diagnosis_times.py

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
from ivtools.record import Record

RESULTS = Path(__file__).parent / "results"
SECONDS = (12.5, 25.0, 50.0, 100.0)
DT = 1e-3


def axis() -> tuple[iv.ClosedLoop, dict[str, float]]:
    """Return the loop that the records come from, and its parameters."""
    loop = iv.axes.emps()
    for effect in ("asymmetric-viscous", "stribeck", "position-friction"):
        loop = loop.with_effect(effect)
    theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    theta |= {"asymmetric-viscous.delta": -35.0, "stribeck.force": 6.0, "stribeck.speed": 0.01}
    return loop, theta | {"position-friction.slope": 12.0, "position-friction.curvature": 0.0}


def simulated(seconds: float, seed: int) -> Record:
    """Return a record with moves between random positions at random speeds."""
    rng, n = np.random.default_rng(seed), round(seconds / DT)
    t, at, q = np.arange(n) * DT, [0.0], [0.0]
    while at[-1] < seconds:
        goal, speed = rng.uniform(0.0, 0.245), rng.uniform(0.02, 0.15)
        at.append(at[-1] + max(abs(goal - q[-1]) / speed, 0.1))
        q.append(goal)
    smooth = np.ones(120) / 120
    q_ref = np.convolve(np.interp(t, at, q), smooth)[:n]
    ask = Record(t, q_ref, q_ref=q_ref, nu=q_ref)  # only its reference counts
    loop, theta = axis()
    noise = rng.normal(0.0, 0.6, n)
    ran = loop.simulate(ask, theta, initial="rest", force_noise=noise, quantum=5e-8)
    return Record(t, ran.q, q_ref=q_ref, nu=ran.nu, name=f"{seconds:g} s")


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
    pairs += [(simulated(s, 1), simulated(s, 2)) for s in SECONDS]
    rows = [timed(a, b, args.repeats, cores) for a, b in pairs for cores in (2, 1)]
    table = pd.DataFrame(rows)
    table.to_csv(RESULTS / "diagnosis_times.csv", index=False)
    print(table.to_string(index=False))


if __name__ == "__main__":
    main()
