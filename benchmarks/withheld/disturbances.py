"""Forces that nobody modelled: noise, and bursts from outside."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import signal

from .axes import DT, Axis

Shape = Callable[[np.ndarray, np.random.Generator], np.ndarray]


def noise(rng: np.random.Generator, axis: Axis, n: int) -> np.ndarray:
    """Return the random force of an axis, N, (n,): first-order, normal or heavy-tailed."""
    a = np.exp(-2.0 * np.pi * axis.noise.hz * DT)
    white = rng.standard_t(5, n) / np.sqrt(5.0 / 3.0) if axis.noise.heavy else rng.normal(size=n)
    return axis.noise.force * np.sqrt(1.0 - a * a) * signal.lfilter([1.0], [1.0, -a], white)


def _hum(t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.sin(2.0 * np.pi * rng.uniform(3.0, 25.0) * t)


#: Shape of a burst over its own time, s: at most 1. With the range of its length, s.
BURSTS: dict[str, tuple[Shape, tuple[float, float]]] = {
    "push": (lambda t, r: np.sin(np.pi * t / t[-1]), (0.2, 1.5)),
    "step": (lambda t, r: np.ones(len(t)), (0.1, 1.5)),
    "decay": (lambda t, r: np.exp(-4.0 * t / t[-1]), (0.2, 1.5)),
    "hum": (_hum, (0.3, 1.5)),
    "knock": (lambda t, r: np.sin(np.pi * t / t[-1]), (0.02, 0.06)),
    "ramp": (lambda t, r: t / t[-1], (0.2, 1.5)),
    "rattle": (lambda t, r: np.clip(r.normal(size=len(t)), -2.0, 2.0) / 2.0, (0.2, 1.0)),
    "ring": (lambda t, r: np.exp(-5.0 * t / t[-1]) * _hum(4.0 * t, r), (0.2, 1.0)),
}


def burst(rng: np.random.Generator, shape: str, n: int) -> tuple[np.ndarray, list[list[float]]]:
    """Return one to three bursts of a shape, N, (n,), and their times, s."""
    law, (least, most) = BURSTS[shape]
    force, when = np.zeros(n), []
    for _ in range(rng.integers(1, 4)):
        length = int(rng.uniform(least, most) / DT)
        at = int(rng.uniform(0.1, 0.9) * (n - length))
        size = 10.0 ** rng.uniform(np.log10(3.0), np.log10(40.0)) * rng.choice([-1, 1])
        force[at : at + length] += size * law(np.arange(1, length + 1) * DT, rng)
        when.append([round(at * DT, 3), round((at + length) * DT, 3)])
    return force, when
