"""Trapezoids: moves whose speed rises, stays and falls in straight lines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def trapezoid(t: Array, speed: float, ramp: float, cruise: float) -> Array:
    """Return the position of a move from rest to rest, from 0 to ``speed * cruise``, (n,).

    Parameters
    ----------
    t : ndarray, (n,)
        Since the move began, s.
    speed : float
        m/s or rad/s, with the sign of the move.
    ramp : float
        In which the speed rises, and then falls, s.
    cruise : float
        Until it begins to fall, s.

    Examples
    --------
    >>> trapezoid(np.array([-1.0, 1.0, 2.0, 3.0, 9.0]), speed=2.0, ramp=1.0, cruise=2.0)
    array([0., 1., 3., 4., 4.])
    """
    return np.asarray(speed * (_ramped(t, ramp) - _ramped(t - cruise, ramp)))


def _ramped(t: Array, ramp: float) -> Array:
    """Return the integral over time of a speed that rises from 0 to 1 within `ramp` seconds."""
    return np.where(t < ramp, 0.5 * np.clip(t, 0.0, ramp) ** 2 / ramp, t - 0.5 * ramp)
