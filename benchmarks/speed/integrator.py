"""How fine the integration must be: error and time of every effect over the steps per sample.

    python benchmarks/speed/integrator.py

writes `benchmarks/results/integrator.md`. The error is that of the simulated command against 64
steps per sample, relative to the signature of the effects: what they change in the command. Axes
are random, of 1e-4 kg m2 to 200 kg; they move, rest and are pushed.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ivtools import Record, axes, datasets
from ivtools.loop import ClosedLoop, Controller

DT, SAMPLES, AXES, FINE = 1e-3, 3000, 20, 64
STEPS = (1, 2, 4, 8)
OUT = Path(__file__).parents[1] / "results" / "integrator.md"
INTRODUCTION = (
    "Written by `python benchmarks/speed/integrator.py`: the error of the simulated command "
    f"against {FINE} steps per sample, relative to the signature of the effects (what they change "
    f"in the command), over {AXES} random axes of 1e-4 kg m2 to 200 kg that move, rest and are "
    "pushed: median and greatest. Time: one simulation of 24841 samples with one step per sample, "
    "the default; processor time of one thread, the best of 20. A bristle and a stiff spring raise "
    "the number of steps by themselves."
)
THETA = {"inertia": 95.1, "viscous": 203.5, "coulomb": 20.4, "offset": -3.16}

Draw = Callable[[np.random.Generator, float, float], dict[str, float]]
# the ranges of an axis like the EMPS, in its units of mass m (95 kg) and length x
RANGES: dict[str, Draw] = {
    "asymmetric-viscous": lambda r, m, x: {"delta": m * r.uniform(10, 45)},
    "stribeck": lambda r, m, x: {
        "force": m * x * r.uniform(3, 12),
        "speed": x * r.uniform(3e-3, 0.02),
    },
    "presliding": lambda r, m, x: {"stiffness": m * 10 ** r.uniform(5.18, 6.18)},
    "polynomial-viscous": lambda r, m, x: {
        "quadratic": m / x * r.uniform(250, 1000),
        "cubic": m / x**2 * r.uniform(2e3, 9e3),
    },
    "sqrt-viscous": lambda r, m, x: {"force": m * x**0.5 * r.uniform(15, 60)},
    "position-friction": lambda r, m, x: {"slope": m * r.uniform(4, 20)},
    "load-friction": lambda r, m, x: {"ratio": r.uniform(0.015, 0.08)},
    "friction-drift": lambda r, m, x: {"coulomb_rate": m * x * r.uniform(0.3, 2.0)},
    "offset-drift": lambda r, m, x: {"rate": m * x * r.uniform(0.3, 2.0)},
    "spring": lambda r, m, x: {"stiffness": m * r.uniform(4, 24)},
    "cogging": lambda r, m, x: {
        "cosine": m * x * r.uniform(0.6, 4),
        "period": x * r.uniform(1.8e-3, 0.01),
    },
    "torque-ripple": lambda r, m, x: {
        "cosine": r.uniform(0.015, 0.08),
        "period": x * r.uniform(1.8e-3, 0.01),
    },
    "flexibility": lambda r, m, x: {
        "frequency_hz": r.uniform(25, 70),
        "damping": r.uniform(0.01, 0.05),
        "load_share": r.uniform(0.08, 0.35),
        "load_friction": r.uniform(0.0, 0.5),
    },
    "backlash": lambda r, m, x: {
        "gap": x * r.uniform(1e-5, 8e-5),
        "contact_hz": r.uniform(120, 220),
        "load_share": r.uniform(0.12, 0.35),
        "load_friction": r.uniform(0.3, 0.8),
    },
    "drive-timing": lambda r, m, x: {
        r.choice(["delay", "lag"]): r.uniform(3e-4, 3e-3),
    },
    "drive-asymmetry": lambda r, m, x: {"gain": r.uniform(0.01, 0.05)},
    "dead-zone": lambda r, m, x: {"force": m * x * r.uniform(0.7, 3.5)},
}  # fmt: skip
TWO = ("asymmetric-viscous", "stribeck")
COMBINATIONS = [
    *((name,) for name in RANGES),
    (*TWO, "drive-timing"),
    (*TWO, "drive-timing", "cogging"),
    (*TWO, "presliding"),
    (*TWO, "presliding", "drive-timing"),
    (*TWO, "flexibility"),
    (*TWO, "backlash"),
    ("backlash", "drive-timing"),
    ("presliding", "flexibility"),
    ("presliding", "backlash"),
]


def reference(rng: np.random.Generator, n: int) -> np.ndarray:
    """Moves at random speeds with rests between them, (n,); stroke about 0.2."""
    knots, at, q = [(0.0, 0.0)], 0.1, 0.0
    while at < n * DT:
        knots.append((at, q))
        goal = rng.uniform(0.0, 0.2)
        at += abs(goal - q) / rng.uniform(0.02, 0.15)
        knots.append((at, goal))
        at, q = at + rng.choice([0.0, 0.15]), goal
    times, points = np.array(knots).T
    smooth = np.ones(int(rng.uniform(0.04, 0.12) / DT))
    path = np.interp(np.arange(n) * DT, times, points)
    return np.convolve(path, smooth / smooth.sum())[:n]


def axis(rng: np.random.Generator) -> tuple[ClosedLoop, dict[str, float], Record, float, float]:
    """Return a random axis, its parameters, what it is to follow, and its mass and length."""
    mass, length = 10.0 ** rng.uniform(-6.0, 0.3), 10.0 ** rng.uniform(-0.5, 1.0)
    force = mass * length
    theta = {
        "inertia": 95.0 * mass * rng.uniform(0.6, 1.5),
        "viscous": 200.0 * mass * rng.uniform(0.6, 1.5),
        "coulomb": 20.0 * force * rng.uniform(0.5, 1.5),
        "offset": force * rng.uniform(-4.0, 4.0),
    }
    inner = rng.uniform(60.0, 100.0)  # 1/s
    gains = {"kp": rng.uniform(0.5, 1.2) * inner, "kv": inner * theta["inertia"] / (35.0 * force)}
    loop = replace(
        axes.emps(),
        controller=Controller("cascade-pd", gains, (0.5, 0.5), int(rng.integers(2))),
        gain=35.0 * force,
    )
    t = np.arange(SAMPLES) * DT
    q = length * reference(rng, SAMPLES)
    pulses = rng.choice([0.0, 2.0]) * (t % 0.9 > 0.6)
    return loop, theta, Record(t, q, q_ref=q, nu=np.sin(t), added=pulses), mass, length


def errors(effects: tuple[str, ...], seed: int) -> list[float]:
    """Return the error for every number of steps, relative to the signature of the effects."""
    rng = np.random.default_rng([seed, *map(ord, "".join(effects))])
    plain, theta, record, mass, length = axis(rng)
    loop = plain
    for name in effects:
        loop = loop.with_effect(name, **RANGES[name](rng, mass, length))
    fine = loop.simulate(record, theta, initial="rest", substeps=FINE).nu
    signature = np.linalg.norm(fine - plain.simulate(record, theta, initial="rest").nu)
    coarse = (loop.simulate(record, theta, initial="rest", substeps=n).nu for n in STEPS)
    return [float(np.linalg.norm(nu - fine) / signature) for nu in coarse]


def milliseconds(effects: tuple[str, ...], record: Record) -> float:
    """Return the processor time of one simulation of the twin record, the best of many."""
    rng, loop = np.random.default_rng(1), axes.emps()
    for name in effects:
        loop = loop.with_effect(name, **RANGES[name](rng, 1.0, 1.0))
    spent = []
    for _ in range(20):
        before = time.process_time()
        loop.simulate(record, THETA)
        spent.append(time.process_time() - before)
    return 1e3 * min(spent)


def main() -> None:
    record = datasets.twin()
    lines = [
        "# The integrator",
        "",
        INTRODUCTION,
        "",
        "| effects | ms | " + " | ".join(f"{n} per sample" for n in STEPS) + " |",
        "|---|---:|" + "---:|" * len(STEPS),
        f"| none | {milliseconds((), record):.2f} |" + " exact |" * len(STEPS),
    ]
    for effects in COMBINATIONS:
        table = np.array([errors(effects, seed) for seed in range(AXES)])
        cells = [f"{np.median(c):.0e}, {c.max():.0e}" for c in table.T]
        ms = milliseconds(effects, record)
        lines.append(f"| {', '.join(effects)} | {ms:.2f} | {' | '.join(cells)} |")
    OUT.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
