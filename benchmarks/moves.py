"""Moves: records of an axis that goes from place to place, simulated; for tests and benchmarks."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

import ivtools as iv
from ivtools.record import Record

DT = 1e-3
STROKE = (0.0, 0.245)  # m
SPEEDS = (0.02, 0.15)  # m/s
FORCE_NOISE = 0.6  # N
QUANTUM = 5e-8  # m
_SMOOTHING = 0.12  # s


def reference(
    rng: np.random.Generator, seconds: float, stroke: tuple[float, float] = STROKE
) -> np.ndarray:
    """Return a reference that moves between random positions at random speeds, m, (n_samples,)."""
    n, smooth = round(seconds / DT), np.ones(round(_SMOOTHING / DT))
    at, q = [0.0], [stroke[0]]
    while at[-1] < seconds:
        goal, speed = rng.uniform(*stroke), rng.uniform(*SPEEDS)
        at.append(at[-1] + max(abs(goal - q[-1]) / speed, 0.1))
        q.append(goal)
    path = np.pad(np.interp(np.arange(n) * DT, at, q), (len(smooth) - 1, 0), mode="edge")
    return np.convolve(path, smooth / len(smooth), mode="valid")


def record(
    loop: iv.ClosedLoop,
    theta: Mapping[str, float],
    seconds: float,
    seed: int,
    stroke: tuple[float, float] = STROKE,
    unknown: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Record:
    """Return a record of a loop with noise on its force and a coarse encoder.

    `unknown` is a further force, N, of the speed of the reference, m/s.
    """
    rng = np.random.default_rng(seed)
    q_ref = reference(rng, seconds, stroke)
    t, noise = np.arange(len(q_ref)) * DT, rng.normal(0.0, FORCE_NOISE, len(q_ref))
    if unknown is not None:
        noise = noise - unknown(np.gradient(q_ref, DT))
    asked = Record(t, q_ref, q_ref=q_ref, nu=q_ref)  # only its reference counts
    ran = loop.simulate(asked, theta, initial="rest", force_noise=noise, quantum=QUANTUM)
    return Record(t, ran.q, q_ref=q_ref, nu=ran.nu, name=f"{seconds:g} s, seed {seed}")
