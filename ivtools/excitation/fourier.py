"""Fourier: periodic motion of n joints as finite Fourier series, at rest where a period ends."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..pipeline import Motion
from .limits import Limits

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Series:
    """The functions of time that a series is made of; velocity and acceleration are 0 at 0.

    Parameters
    ----------
    period : float
        s.
    harmonics : int
    samples : int
        Over one period.

    References
    ----------
    J. Swevers, C. Ganseman, D. B. Tukel, J. De Schutter, H. Van Brussel, "Optimal robot excitation
    and identification", IEEE Trans. Robotics and Automation 13(5), 1997.

    Examples
    --------
    >>> series = Series(10.0, 5, 200)
    >>> series.functions.q.shape, bool(np.abs(series.functions.dq[0]).max() < 1e-12)
    ((200, 8), True)
    """

    period: float
    harmonics: int
    samples: int

    @cached_property
    def functions(self) -> Motion:
        """Position, velocity, acceleration of each function, (samples, size) each."""
        k = np.arange(1, self.harmonics + 1)
        w = 2.0 * np.pi / self.period * k
        t = np.arange(self.samples) * self.period / self.samples
        S, C = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
        # of every sine the velocity, of every cosine the acceleration is 1 at 0: differences are 0
        rest = np.diff(np.eye(self.harmonics), axis=0).T  # (harmonics, harmonics - 1)
        sines, cosines = rest * w[0], rest * w[0] ** 2  # of a size of about 1
        return Motion(
            np.hstack([(S / w) @ sines, (C / w**2) @ cosines]),
            np.hstack([C @ sines, -(S / w) @ cosines]),
            np.hstack([-(S * w) @ sines, -C @ cosines]),
        )

    @property
    def size(self) -> int:
        """Coefficients of one joint."""
        return 2 * self.harmonics - 2

    def motion(self, coefficients: Array, centre: Array) -> Motion:
        """Return the motion of coefficients (n, size) about the centre (n,)."""
        q, dq, ddq = (x @ coefficients.T for x in self.functions)
        return Motion(centre + q, dq, ddq)


@dataclass(frozen=True, eq=False)
class Fourier:
    """Finite Fourier series of n joints.

    Parameters
    ----------
    period : float
        s.
    coefficients : (n, 2 harmonics - 2) ndarray
        Of the functions of `Series`.
    centre : (n,) ndarray
        m or rad.
    """

    period: float
    coefficients: Array
    centre: Array

    @property
    def harmonics(self) -> int:
        """Number of harmonics."""
        return self.coefficients.shape[1] // 2 + 1

    @property
    def bandwidth_hz(self) -> float:
        """Frequency of the highest harmonic, Hz."""
        return self.harmonics / self.period

    def motion(self, samples: int) -> Motion:
        """Return one period, (samples, n) each."""
        return Series(self.period, self.harmonics, samples).motion(self.coefficients, self.centre)

    def wider(self, harmonics: int) -> Fourier:
        """Return the same motion as a series of more harmonics."""
        sines, cosines = np.split(self.coefficients, 2, axis=1)
        more = np.zeros((len(sines), max(harmonics - self.harmonics, 0)))
        return Fourier(self.period, np.hstack([sines, more, cosines, more]), self.centre)

    def within(self, limits: Limits, samples: int) -> Fourier:
        """Return the nearest series within position, speed and acceleration: smaller, and moved.

        What is within them stays as it is.
        """
        q, dq, ddq = self.motion(samples)
        middle, half = 0.5 * (q.max(axis=0) + q.min(axis=0)), 0.5 * np.ptp(q, axis=0)
        room = 0.5 * (limits.upper - limits.lower)
        needed = (
            half / room,
            np.abs(dq).max(axis=0) / limits.speed,
            np.abs(ddq).max(axis=0) / limits.acceleration,
        )
        share = 1.0 / np.maximum(np.max(needed, axis=0), 1.0)
        offset = (middle - self.centre) * share
        least, most = limits.lower + half * share, limits.upper - half * share
        return Fourier(
            self.period,
            self.coefficients * share[:, np.newaxis],
            np.clip(self.centre + offset, least, most) - offset,
        )
