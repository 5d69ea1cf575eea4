"""Band: the frequencies of a motion, and what a signal has below one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from .rules import NEARLY_ALL, SLOW, SLOW_RATE

Array = NDArray[np.float64]


def below(x: Array, hz: float, dt: float) -> Array:
    """Return what a signal has below a frequency, (n_samples, ...)."""
    sos = signal.butter(2, min(2 * hz * dt, NEARLY_ALL), output="sos")
    return np.asarray(signal.sosfiltfilt(sos, x, axis=0))


def motion_hz(q: Array, dt: float) -> float:
    """Return some times the median frequency of a motion, (n_samples,), Hz."""
    dq = np.gradient(q, dt)
    power = np.abs(np.fft.rfft(dq - dq.mean())) ** 2
    hz = np.fft.rfftfreq(len(dq), dt)
    median = float(hz[np.searchsorted(power.cumsum(), 0.5 * power.sum())])
    return min(SLOW * median, SLOW_RATE / dt)
