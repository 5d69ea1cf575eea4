"""Motions and known inputs: what the axis is told to do."""

from __future__ import annotations

import numpy as np
from scipy import signal

from .axes import DT, Axis

KINDS = ("bang-bang", "moves", "multisine")
_STROKE, _SPEED = 0.245, 0.15  # m, m/s


def draw(rng: np.random.Generator, kind: str, n: int) -> np.ndarray:
    """Return a position reference, m, (n,)."""
    return _multisine(rng, n) if kind == "multisine" else _strokes(rng, kind, n)


def _multisine(rng: np.random.Generator, n: int) -> np.ndarray:
    t = np.arange(n) * DT
    hz = np.arange(1, 25) * 0.08 * rng.uniform(0.8, 1.2)
    size = rng.uniform(0.5, 1.0, len(hz)) / hz**1.3
    phase = rng.uniform(0.0, 2.0 * np.pi, len(hz))
    x = np.cos(2.0 * np.pi * np.outer(t, hz) + phase) @ size
    x -= x[0]
    return x * min(0.2 / np.ptp(x), 0.16 / float(np.max(np.abs(np.gradient(x, DT)))))


def _strokes(rng: np.random.Generator, kind: str, n: int) -> np.ndarray:
    """Return moves at constant speeds, joined by constant accelerations (bang-bang) or softer."""
    knots, at, q = [(0.0, 0.0)], 0.0, 0.0
    while at < n * DT:
        if kind == "moves":
            speed, goal = rng.uniform(0.02, _SPEED), rng.uniform(0.0, _STROKE)
        else:
            speed = rng.choice([0.03, 0.08, _SPEED])
            goal = _STROKE if q < 0.5 * _STROKE else 0.0
            if rng.random() < 0.6:
                goal = q + (goal - q) * rng.uniform(0.2, 0.9)
        at += max(abs(goal - q) / speed, 0.08)
        q = goal
        knots.append((at, q))
    times, points = np.array(knots).T
    x = np.interp(np.arange(n) * DT, times, points)
    x = _averaged(x, rng.uniform(0.06, 0.15))
    return _averaged(x, 0.03) if kind == "moves" else x


def _averaged(x: np.ndarray, seconds: float) -> np.ndarray:
    width = int(seconds / DT)
    return signal.lfilter(np.ones(width) / width, [1.0], x)


def pulses(rng: np.random.Generator, axis: Axis, n: int) -> np.ndarray:
    """Return a known square wave added to the command, V, (n,); zero in four cases of ten."""
    size, half = rng.uniform(40.0, 120.0) / axis.gain, int(rng.uniform(0.7, 1.3) / DT)
    return size * ((np.arange(n) // half) % 2) * (rng.random() < 0.6)
