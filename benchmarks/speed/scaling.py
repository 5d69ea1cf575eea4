"""Time and peak memory of one simulation and one least-squares fit of n samples; prints JSON.

Memory is what the process held at its peak above what it held with the input, per sample and
signal; the signals are time, position, reference, command, velocity and acceleration. A fit of a
short record comes first, so that libraries are not counted.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np

from ivtools import IDIMLS, Problem, Record, axes

THETA = {"inertia": 95.1, "viscous": 203.5, "coulomb": 20.4, "offset": -3.16}
SIGNALS = 6


def record(n: int) -> Record:
    """A record of n samples at 1 kHz with several speeds."""
    t = np.arange(n) * 1e-3
    q_ref = 0.02 * np.sin(2.2 * t) + 0.01 * np.sin(5.1 * t)
    loop = axes.emps()
    base = Record(t=t, q=q_ref, q_ref=q_ref, nu=np.cos(t))
    made = loop.simulate(base, THETA, initial="rest", quantum=1e-6)
    return made.to_record(q_ref=q_ref)


def measured(call) -> tuple[float, float]:
    """Return seconds (best of three) and bytes at the peak above the start."""
    before = reset_peak()
    call()
    peak = memory("VmHWM") - before
    times = []
    for _ in range(3):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times), float(peak)


def reset_peak() -> int:
    """Forget the peak so far (Linux); return the memory in use, bytes."""
    Path("/proc/self/clear_refs").write_text("5")
    return memory("VmRSS")


def memory(field: str) -> int:
    """Return a figure of this process's memory, bytes; compiled code's arrays count as well."""
    status = Path("/proc/self/status").read_text().split()
    return 1024 * int(status[status.index(f"{field}:") + 1])


def main(n: int) -> None:
    loop, given, short = axes.emps(), record(n), record(1000)
    loop.simulate(short, THETA)
    IDIMLS().fit(Problem(short, loop))
    seconds, peak = measured(lambda: loop.simulate(given, THETA))
    fit_seconds, fit_peak = measured(lambda: IDIMLS().fit(Problem(given, loop)))
    figures = {
        "samples": n,
        "simulate_ns": 1e9 * seconds / n,
        "simulate_bytes": peak / n / SIGNALS,
        "rows_ns": 1e9 * fit_seconds / n,
        "rows_bytes": fit_peak / n / SIGNALS,
    }
    print(json.dumps(figures))


if __name__ == "__main__":
    main(int(sys.argv[1]))
