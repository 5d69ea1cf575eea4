"""The natural frequency of the rigid loop, from which the default filters come.

The same loop as `system` linearised without dry friction, written out so that neither
python-control nor the compiler has to be started for one number.
"""

from __future__ import annotations

from math import exp, floor
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .closed_loop import ClosedLoop

Array = NDArray[np.float64]
_GONE = 1e-6  # poles at 0 and rates at 0: unused states, the free integrator of a velocity loop


def dominant_mode_hz(loop: ClosedLoop, inertia: float, viscous: float, dt: float) -> float:
    """Return the lowest natural frequency of the loop without dry friction, Hz.

    States that the loop does not use, and the free integrator of a velocity loop, do not count.

    Parameters
    ----------
    loop : ClosedLoop
    inertia, viscous : float
        SI.
    dt : float
        Sampling step, s.

    Examples
    --------
    >>> import ivtools as iv
    >>> round(dominant_mode_hz(iv.axes.emps(), 95.0, 200.0, 1e-3))
    22
    """
    poles = np.linalg.eigvals(transition(loop, inertia, viscous, dt))
    rates = np.abs(np.log(poles[np.abs(poles) > _GONE].astype(complex))) / dt
    return float(min(rates[rates * dt > _GONE], default=np.nan)) / (2.0 * np.pi)


def transition(loop: ClosedLoop, inertia: float, viscous: float, dt: float) -> Array:
    """Return the matrix that takes the state of the closed loop over one sample, (n, n).

    State: position and velocity, positions that the controller remembers, its own states, and
    the commands on their way.
    """
    law = loop.controller.law(dt)
    remembered, own = len(law.taps) - 1, len(law.C)
    late = loop.delay / dt
    whole = floor(late + 1e-9)
    drop = loop.controller.delay + whole
    part = max(late - whole, 0.0)

    def step(z: Array) -> Array:
        place, past, x, line = np.split(z, np.cumsum([2, remembered, own]))
        seen = np.array([0.0, 0.0, 0.0, place[0], law.taps @ np.append(place[0], past)])
        line = np.append(law.D @ seen + law.C @ x, line)
        older, newer = loop.gain / inertia * line[[drop + 1, drop]]
        moved = _glide(place, older, viscous / inertia, part * dt)
        moved = _glide(moved, newer, viscous / inertia, (1.0 - part) * dt)
        past = np.append(place[0], past)[:remembered]
        return np.concatenate([moved, past, law.A @ x + law.B @ seen, line[:-1]])

    n = 2 + remembered + own + drop + 1
    return np.column_stack([step(unit) for unit in np.eye(n)])


def _glide(place: Array, push: float, rate: float, h: float) -> Array:
    """Move for h s under a held push (m/s2) and viscous friction at this rate (1/s); exact."""
    q, v = place
    decay = exp(-rate * h)
    reach = (1.0 - decay) / rate if rate > _GONE else h
    drift = (h - reach) / rate if rate > _GONE else 0.5 * h * h
    return np.array([q + v * reach + push * drift, v * decay + push * reach])
