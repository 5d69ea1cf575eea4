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

from ivtools.linalg.columns import orthonormal

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
        return np.asarray(y.view(float).reshape(-1, 2))

    def begun(self, n: int, dt: float) -> Array:
        """Return how it rings down that swung before the record began, (n, 2)."""
        y = self._pole(dt) ** np.arange(n)
        return np.column_stack([y.real, y.imag])


class Found(NamedTuple):
    """A swing in a signal, and the share of its energy that it explains."""

    swing: Swing
    share: float


class Swings:
    """The swings that may be in signals which answer the same acceleration.

    A resonance and the loop are linear both: what a swing does to a signal is the resonance of
    what the acceleration itself would do. So the search runs on means of few samples, and what
    every point of its grid does is known before a signal is.

    Parameters
    ----------
    answer : ndarray, (n_samples,)
        Of the signals to a force as large as the acceleration.
    keep : ndarray of bool, (n_samples,)
        Samples that count.
    dt : float
    """

    def __init__(self, answer: Array, keep: Mask, dt: float) -> None:
        self.width = max(round(1.0 / (_RATE * _HZ[1] * dt)), 1)
        self.dt = dt * self.width
        self.answer = self._mean(answer)
        self.counts = self._mean(keep.astype(float)) == 1.0
        self.lowest = max(_HZ[0], 2.0 / (dt * len(answer)))  # it must come twice
        self.grid: list[Swing] = []
        if np.isfinite(self.answer).all() and self.answer.any() and self.lowest < _HZ[1]:
            points = product(np.geomspace(self.lowest, _HZ[1], _TRIES), _DAMPING)
            self.grid = [Swing(float(hz), damping) for hz, damping in points]
        self.units = self._units(self.grid)

    def strongest(self, x: Array) -> Found:
        """Return the swing that explains most of a signal, (n_samples,), 0 where none counts."""
        y = self._mean(x)[self.counts]
        energy = float(y @ y)
        if not (self.grid and energy > 0.0):
            return Found(Swing(_HZ[0], _DAMPING[-1]), 0.0)

        def left(point: Array) -> float:
            """Return the share that a swing leaves, at the logarithms of its parameters."""
            hz, damping = np.exp(point)
            if not (self.lowest <= hz <= _HZ[1] and damping <= _DAMPING[-1]):  # more is no swing
                return 1.0
            b = self._units([Swing(float(hz), float(damping))])[0] @ y
            return 1.0 - float(b @ b) / energy

        best = self.grid[int(np.argmax(np.sum((self.units @ y) ** 2, axis=1)))]
        first = np.log([best.hz, best.damping])
        found = optimize.minimize(left, first, method="Nelder-Mead", options={"maxfev": _TRIES})
        hz, damping = np.exp(found.x if found.fun < 1.0 else first)
        return Found(Swing(float(hz), float(damping)), 1.0 - float(found.fun))

    def _mean(self, s: Array) -> Array:
        """Return the means of few samples each."""
        count = len(s) // self.width
        return np.asarray(s[: count * self.width].reshape(count, self.width).mean(axis=1))

    def _units(self, swings: list[Swing]) -> Array:
        """Return what each of some swings does as two orthonormal signals, (points, 2, n)."""
        found = [swing.of(self.answer, self.dt)[self.counts] for swing in swings]
        return np.swapaxes(orthonormal(np.array(found)), 1, 2) if found else np.zeros((0, 2, 0))
