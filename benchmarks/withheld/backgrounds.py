"""Real backgrounds: what fitted models leave of two records of a measured axis, as unknown force.

The records are the EMPS benchmark's, read from `IVTOOLS_DATA` and never copied. A residual of the
inverse model is structure that nobody put there. It goes back onto a simulated axis together with
the motion it belongs to: as it is, mirrored, backwards in time, with its cycles in another order,
or looked up by position, speed and acceleration along another motion altogether.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy import io, signal, spatial

DT = 0.001  # s
GAIN = 35.15065188  # N/V of the measured axis
FILES = ("DATA_EMPS.mat", "DATA_EMPS_PULSES.mat")
CYCLE = 6240  # samples after which the reference of these records comes again
KINDS = ("plain", "swapped", "mirrored", "backwards", "shuffled", "moved")
MODELS = ("asymmetric", "curved", "full")
_BAND = 60.0  # Hz, beyond which the residual is noise of the differentiation


@dataclass(frozen=True)
class Background:
    """A motion and the unknown force that belongs to it: m and N, (n_samples,) each."""

    ref: np.ndarray
    force: np.ndarray


def draw(
    rng: np.random.Generator, kind: str, model: str, refs: list[np.ndarray]
) -> list[Background]:
    """Return two backgrounds, of either record; `refs`, m, are the motions of kind `moved`."""
    files = FILES if kind != "swapped" else FILES[::-1]
    both = [residual(f, model) for f in files]
    if kind == "mirrored":
        return [Background(b.ref[0] + np.max(b.ref) - b.ref, -b.force) for b in both]
    if kind == "backwards":  # odd friction keeps its sense: the velocity turns round, and the force
        return [Background(b.ref[::-1].copy(), -b.force[::-1]) for b in both]
    if kind == "shuffled":
        return [_shuffled(rng, b) for b in both]
    if kind == "moved":
        return [moved(f, model, r) for f, r in zip(files, refs, strict=True)]
    return both


@cache
def residual(file: str, model: str) -> Background:
    """Return the force, N, that a friction model leaves of a record, below 60 Hz.

    `asymmetric` has its own viscous and Coulomb friction for each direction, `curved` six more
    functions of the speed, `full` twelve more of position, direction and time.
    """
    raw = io.loadmat(next(Path(os.environ["IVTOOLS_DATA"]).rglob(file)))
    q, tau, ref = (np.ravel(raw[k]).astype(float) for k in ("qm", "vir", "qg"))
    q, tau = _low(q), GAIN * _low(tau)
    X = _columns(q, tau, model)
    X = X / np.linalg.norm(X, axis=0)
    rest = tau - X @ np.linalg.lstsq(X, tau, rcond=1e-10)[0]
    rest[:100] = rest[-100:] = 0.0
    return Background(ref, rest)


def _columns(q: np.ndarray, tau: np.ndarray, model: str) -> np.ndarray:
    """Return what the model explains, (n_samples, m)."""
    v = np.gradient(q, DT)
    s, t = np.sign(v), np.linspace(-1.0, 1.0, len(q))
    x = 2.0 * (q - q.min()) / np.ptp(q) - 1.0
    columns = [np.gradient(v, DT), v * (v > 0), v > 0, v * (v < 0), v < 0]
    if model in ("curved", "full"):
        columns += [np.sqrt(np.abs(v)) * s, v * np.abs(v), v**3, v**2]
        columns += [np.exp(-((v / 0.02) ** 2)) * s, np.abs(tau) * s]
    if model == "full":
        waves = [x, x**2, np.sin(np.pi * x), np.cos(np.pi * x)]
        columns += [*waves, *(w * s for w in waves), t, t**2, t * s, t * v]
    return np.column_stack([np.asarray(c, float) for c in columns])


def _low(x: np.ndarray) -> np.ndarray:
    b, a = signal.butter(4, 2.0 * _BAND * DT)
    return signal.filtfilt(b, a, x)


def _shuffled(rng: np.random.Generator, b: Background) -> Background:
    """Put whole cycles of the force in another order; the motion stays the same."""
    cycles = [b.force[k * CYCLE : (k + 1) * CYCLE] for k in range(3)]
    order = rng.permutation(3)
    return Background(
        b.ref, np.concatenate([*(cycles[k] for k in order), b.force[3 * CYCLE : len(b.ref)]])
    )


def moved(file: str, model: str, ref: np.ndarray) -> Background:
    """Look the force up where position, speed and acceleration are nearest along a motion, m."""
    there = residual(file, model)
    tree = spatial.cKDTree(_state(there.ref)[100:-100:3])
    at = tree.query(_state(ref))[1]
    return Background(ref, _low(there.force[100:-100:3][at]))


def _state(ref: np.ndarray) -> np.ndarray:
    """Return position, speed and acceleration over their sizes in the measured records."""
    v = np.gradient(ref, DT)
    a = np.clip(np.gradient(_low(v), DT), -1.5, 1.5)
    return np.column_stack([ref / 0.25, v / 0.06, a / 1.5])
