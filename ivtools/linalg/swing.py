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
from numba import boolean, complex128, float64, types
from numpy.typing import NDArray
from scipy import optimize, signal

from ivtools.compiled import cached

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

    def pole(self, dt: float) -> complex:
        """Return its pole in discrete time."""
        turn = complex(-self.damping, np.sqrt(1.0 - self.damping**2))
        return complex(np.exp(2.0 * np.pi * self.hz * dt * turn))

    def of(self, ddq: Array, dt: float) -> Array:
        """Return what an acceleration sets ringing, in phase and out of it, (n_samples, 2)."""
        p = self.pole(dt)
        y = signal.lfilter([1.0 - abs(p)], [1.0, -p], ddq)
        return np.asarray(y.view(float).reshape(-1, 2))

    def begun(self, n: int, dt: float) -> Array:
        """Return how it rings down that swung before the record began, (n, 2)."""
        y = self.pole(dt) ** np.arange(n)
        return np.column_stack([y.real, y.imag])


class Found(NamedTuple):
    """A swing in a signal, and the share of its energy that it explains."""

    swing: Swing
    share: float


class Swings:
    """The swings that may be in signals which answer the same acceleration.

    A resonance and the loop are linear both: what a swing does to a signal is the resonance of
    what the acceleration itself would do. So the search runs on means of few samples.

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

    def strongest(self, x: Array) -> Found:
        """Return the swing that explains most of a signal, (n_samples,), 0 where none counts."""
        y = self._mean(x)
        energy = float(y[self.counts] @ y[self.counts])
        if not (self.grid and energy > 0.0):
            return Found(Swing(_HZ[0], _DAMPING[-1]), 0.0)

        def left(point: Array) -> float:
            """Return the share that a swing leaves, at the logarithms of its parameters."""
            hz, damping = np.exp(point)
            if not (self.lowest <= hz <= _HZ[1] and damping <= _DAMPING[-1]):  # more is no swing
                return 1.0
            return 1.0 - self._explained(Swing(float(hz), float(damping)), y) / energy

        best = max(self.grid, key=lambda swing: self._explained(swing, y))
        first = np.log([best.hz, best.damping])
        found = optimize.minimize(left, first, method="Nelder-Mead", options={"maxfev": _TRIES})
        hz, damping = np.exp(found.x if found.fun < 1.0 else first)
        return Found(Swing(float(hz), float(damping)), 1.0 - float(found.fun))

    def _mean(self, s: Array) -> Array:
        """Return the means of few samples each."""
        count = len(s) // self.width
        return np.asarray(s[: count * self.width].reshape(count, self.width).mean(axis=1))

    def _explained(self, swing: Swing, y: Array) -> float:
        """Return the energy of a signal's means that a swing explains."""
        return float(_explained(swing.pole(self.dt), self.answer, self.counts, y))


_SAMPLES, _COUNTS = (types.Array(t, 1, "C", readonly=True) for t in (float64, boolean))


@cached(float64(complex128, _SAMPLES, _COUNTS, _SAMPLES))
def _explained(pole: complex, x: Array, counts: Mask, y: Array) -> float:
    """Return the energy of y, where it counts, that both parts of what x sets ringing explain."""
    ring, in_phase, out_of_it, mixed, one, two = 0.0j, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(x.size):
        ring = pole * ring + x[k]
        if counts[k]:
            in_phase += ring.real * ring.real
            out_of_it += ring.imag * ring.imag
            mixed += ring.real * ring.imag
            one += ring.real * y[k]
            two += ring.imag * y[k]
    if not in_phase > 0.0:
        return 0.0
    found, share = one * one / in_phase, mixed / in_phase
    rest, beyond = out_of_it - share * mixed, two - share * one  # of the second beside the first
    return found + beyond * beyond / rest if rest > 0.0 else found
