"""Populations of controllers: every kind, with all that may surround a law."""

import csv
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from ivtools.loop import ClosedLoop, Controller
from ivtools.loop.controllers import backward_difference
from ivtools.record import Record

KINDS = ("cascade-pd", "pd", "pid", "p-pi", "pi-velocity", "p-velocity", "state-space")


def controller(
    rng: np.random.Generator, kind: str, inertia: float, hz: float, fast: float = 1.0
) -> Controller:
    """A controller, in units of force, of a sensible loop on this inertia at this rate."""
    width = fast * 2.0 * np.pi * hz * rng.uniform(0.004, 0.015)  # rad/s, of the velocity loop
    kp, kv, ki = width * rng.uniform(0.15, 0.4), inertia * width, width * rng.uniform(0.05, 0.2)
    c = float(rng.choice([1.0, 1.0, 0.0, 0.7]))
    gains = {
        "cascade-pd": {"kp": kp, "kv": kv},
        "pd": {"kp": kp * kv, "kd": kv, "c": c},
        "pid": {
            "kp": (kp + ki) * kv,
            "ki": kp * ki * kv,
            "kd": kv,
            "c": c,
            "b": float(rng.choice([1.0, 0.6])),
            "derivative_filter": float(rng.choice([0.0, 0.1 / width])),
        },
        "p-pi": {"kp": kp, "kv": kv, "ki": ki, "c": c},
        "pi-velocity": {"kv": kv, "ki": ki, "c": 1.0},
        "p-velocity": {"kv": kv, "c": 1.0},
        "state-space": _lead(kp * kv, kv, 0.3, 1.0 / hz),
    }[kind]
    return Controller(kind, gains, delay=int(rng.integers(0, 3)))


def _lead(kp: float, kd: float, pole: float, dt: float) -> dict:
    D = kp + kd * (1.0 - pole) / dt
    return {
        "A": [[pole]],
        "B": [[1.0, -1.0]],
        "C": [[-kd * (1.0 - pole) ** 2 / dt]],
        "D": [[D, -D]],
    }


def surrounded(rng: np.random.Generator, plain: Controller, hz: float) -> Controller:
    """The same with a filter of the velocity, of the command, feed-forwards and a column."""
    taps = [(1.0,), (0.5, 0.5), (0.6, 0.3, 0.1)][rng.integers(3)]
    filters = [
        None,
        {"kind": "lowpass", "hz": 0.1 * hz},
        {"kind": "lowpass", "hz": 0.12 * hz, "damping": 0.7},
        {"kind": "notch", "hz": 0.2 * hz, "damping": 0.3},
    ]
    return replace(
        plain,
        velocity_filter=taps,
        filter=filters[rng.integers(4)],
        anti_windup=str(rng.choice(["clamp", "back-calculation", "none"])),
    )


def scaled(plain: Controller, gain: float) -> Controller:
    """A controller whose command is in V where it was in N."""
    return plain.scaled(1.0 / gain)


def speed(law_taps: tuple[float, ...], q: np.ndarray, dt: float) -> np.ndarray:
    """The velocity that these weights make of a position, as `backward_difference` does."""
    return np.convolve(q, backward_difference(law_taps, dt))[: len(q)]


def reference(
    rng: np.random.Generator, n: int, hz: float, stroke: float, extra=None, most: float = 7.0
) -> Record:
    """A record of smooth moves over a stroke, there and back, at most so often."""
    t = np.arange(n) / hz
    whole = n / hz
    q_ref = np.zeros(n)
    for cycles in rng.uniform(2.0, most, 3) * min(1.0, whole):
        q_ref += np.sin(2.0 * np.pi * cycles * t / whole + rng.uniform(0, 6)) ** 3
    q_ref *= stroke / np.ptp(q_ref)
    return Record(t, q_ref - q_ref[0], q_ref=q_ref - q_ref[0], nu=np.cos(t), extra=extra or {})


def axis(rng: np.random.Generator, joint: str) -> tuple[ClosedLoop, dict[str, float], float]:
    """An axis without controller, its parameters, and the stroke that it moves over."""
    inertia, stroke = 10 ** rng.uniform(-4, 2.5), 10 ** rng.uniform(-2, 0.5)
    gain = 10 ** rng.uniform(-1, 2)
    terms = ("inertia", "viscous", "coulomb", "offset")
    loop = ClosedLoop(Controller("none", {}), gain, terms, joint=joint)
    force = inertia * stroke
    theta = {
        "inertia": inertia,
        "viscous": inertia * rng.uniform(0.2, 3.0),
        "coulomb": force * rng.uniform(0.2, 2.0),
        "offset": force * rng.uniform(-0.5, 0.5),
    }
    return loop, theta, stroke


def rows(file: Path) -> list[dict[str, str]]:
    """Return the rows of a csv file; none if there is no such file."""
    if not file.exists():
        return []
    with file.open(newline="") as open_file:
        return list(csv.DictReader(open_file))


def append(file: Path, row: Mapping[str, object]) -> None:
    """Write a row at the end of a csv file, below a header if it is the first."""
    new = not file.exists()
    with file.open("a", newline="") as open_file:
        writer = csv.DictWriter(open_file, row)
        if new:
            writer.writeheader()
        writer.writerow(row)


def filled(
    file: Path,
    cases: Iterable[tuple[object, ...]],
    answer: Callable[..., Mapping[str, object] | None],
) -> list[dict[str, str]]:
    """Add the rows of the cases that a csv file lacks, one at a time, and return all that it holds.

    A case is what stands first in its row; ``answer(*case)`` makes that, or None if there is none.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    there = [list(row.values()) for row in rows(file)]
    for case in cases:
        known = any(row[: len(case)] == [str(x) for x in case] for row in there)
        row = None if known else answer(*case)
        if row is not None:
            append(file, row)
            print("; ".join(f"{k} {v}" for k, v in row.items()), flush=True)
    return rows(file)
