"""Swing: a load that hangs from the axis, and what its ringing does to the force.

A pendulum under a cart, a crane's hook, liquid in a vessel: what the axis accelerates rings on at
a frequency of its own, far below the bandwidth of the loop, and for longer than a move takes. No
law of the axis's own state has that, so it would pass for slow noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, signal

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_HZ, _DAMPING = (0.1, 10.0), (0.003, 0.01, 0.03, 0.1)  # 20 m of rope to 3 mm of liquid
_RATE, _TRIES = 10, 40  # samples per period of the highest; steps of the search


@dataclass(frozen=True)
class Swing:
    """A resonance that the acceleration of the axis excites.

    Parameters
    ----------
    hz : float
        Natural frequency, Hz.
    damping : float
        Damping ratio.
    """

    hz: float
    damping: float

    def _pole(self, dt: float) -> complex:
        turn = complex(-self.damping, np.sqrt(1.0 - self.damping**2))
        return complex(np.exp(2.0 * np.pi * self.hz * dt * turn))

    def of(self, ddq: Array, dt: float) -> Array:
        """Return what an acceleration sets ringing, in phase and out of it, (n_samples, 2)."""
        p = self._pole(dt)
        y = signal.lfilter([1.0 - abs(p)], [1.0, -p], ddq)
        return np.column_stack([y.real, y.imag])

    def begun(self, n: int, dt: float) -> Array:
        """Return how it rings down that swung before the record began, (n, 2)."""
        y = self._pole(dt) ** np.arange(n)
        return np.column_stack([y.real, y.imag])


class Found(NamedTuple):
    """A swing in a signal, and the share of its energy that it explains."""

    swing: Swing
    share: float


def strongest(answer: Array, x: Array, keep: Mask, dt: float) -> Found:
    """Return the swing that explains most of a signal.

    A resonance and the loop are linear both: what the swing does to the signal is the resonance of
    what the acceleration itself would do. So the search runs on means of few samples.

    Parameters
    ----------
    answer : ndarray, (n_samples,)
        Of the signal to a force as large as the acceleration.
    x : ndarray, (n_samples,)
        The signal; 0 where it does not count.
    keep : ndarray of bool, (n_samples,)
        Samples that count.
    dt : float
    """
    width = max(round(1.0 / (_RATE * _HZ[1] * dt)), 1)
    count = len(x) // width

    def mean(s: Array) -> Array:
        """Return the means of few samples each."""
        return np.asarray(s[: count * width].reshape(count, width).mean(axis=1))

    a, y, counts = mean(answer), mean(x), mean(keep.astype(float)) == 1.0
    energy = float(y[counts] @ y[counts])
    lowest = max(_HZ[0], 2.0 / (dt * len(x)))  # it must come twice
    if not (energy > 0.0 and np.isfinite(a).all()) or lowest >= _HZ[1]:
        return Found(Swing(_HZ[0], _DAMPING[-1]), 0.0)

    def left(point: Array) -> float:
        """Return the share of the signal that a swing leaves, at logarithms of its parameters."""
        hz, damping = np.exp(point)
        if not (lowest <= hz <= _HZ[1] and damping <= _DAMPING[-1]):  # more is no swing
            return 1.0
        C = Swing(float(hz), float(damping)).of(a, dt * width)[counts]
        b = C.T @ y[counts]
        return 1.0 - float(b @ np.linalg.lstsq(C.T @ C, b, rcond=None)[0]) / energy

    grid = product(np.geomspace(lowest, _HZ[1], _TRIES), _DAMPING)
    first = min((np.log(point) for point in grid), key=left)
    found = optimize.minimize(left, first, method="Nelder-Mead", options={"maxfev": _TRIES})
    hz, damping = np.exp(found.x if found.fun < 1.0 else first)
    return Found(Swing(float(hz), float(damping)), 1.0 - float(found.fun))
