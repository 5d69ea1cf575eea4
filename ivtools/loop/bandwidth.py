"""The bandwidth of the rigid loop, from which the default filters come.

Frequency responses of a control law and of an axis without dry friction, exact at the samples,
written out so that neither python-control nor the compiler has to be started for one number.
"""

from __future__ import annotations

from math import exp, floor
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .closed_loop import ClosedLoop

Array = NDArray[np.float64]
Response = NDArray[np.complex128]

_GRID = 2000  # frequencies from 1e-5 of Nyquist's up to it
_STILL = 1e-9  # viscous decay over a sample below which the axis is a double integrator


def bandwidth_hz(loop: ClosedLoop, inertia: float, viscous: float, dt: float) -> float:
    """Return the gain crossover of the loop without dry friction, Hz; NaN if there is none.

    It is the highest frequency at which a force comes back as large as it went around the loop:
    up to there the controller moves the axis, beyond it the axis is on its own. It lies between
    the natural frequency of the highest mode that matters and the -3 dB bandwidth from reference to
    position, within a factor of 2 of both. Unlike a mode it does not jump to the slow pole that
    integral action adds, and unlike the -3 dB bandwidth it does not depend on a feed-forward; and
    it is the same for position and for velocity loops.

    Parameters
    ----------
    loop : ClosedLoop
    inertia, viscous : float
        SI.
    dt : float
        Sampling step, s.

    References
    ----------
    S. Skogestad, I. Postlethwaite, *Multivariable Feedback Control*, 2nd ed., 2005, section 2.4.

    Examples
    --------
    >>> import ivtools as iv
    >>> round(bandwidth_hz(iv.axes.emps(), 95.0, 200.0, 1e-3))
    23
    """
    return _crossover(loop, inertia, viscous, dt)[0]


def margin_deg(loop: ClosedLoop, inertia: float, viscous: float, dt: float) -> float:
    """Return the phase margin at that crossover, degrees, negative if unstable; NaN without one.

    Parameters
    ----------
    loop, inertia, viscous, dt
        As for `bandwidth_hz`.

    Examples
    --------
    >>> import ivtools as iv
    >>> round(margin_deg(iv.axes.emps(), 95.0, 200.0, 1e-3))
    27
    """
    return _crossover(loop, inertia, viscous, dt)[1]


def _crossover(loop: ClosedLoop, inertia: float, viscous: float, dt: float) -> tuple[float, float]:
    """Return frequency, Hz, and phase margin, degrees, of the highest gain crossover."""
    hz = np.geomspace(1e-5, 1.0, _GRID) * 0.5 / dt
    z = np.exp(2j * np.pi * hz * dt)
    law = loop.controller.shown(dt).law(dt).response(z) * z**-loop.controller.delay
    around = law * axis_response(inertia, viscous, loop.delay, dt, z) * loop.gain
    log_gain = np.log(np.maximum(np.abs(around), np.finfo(float).tiny))  # (_GRID,)
    above = np.flatnonzero(log_gain > 0.0)
    if not len(above):
        return float("nan"), float("nan")
    last = min(int(above[-1]), _GRID - 2)
    part = np.clip(log_gain[last] / (log_gain[last] - log_gain[last + 1]), 0.0, 1.0)
    return float(hz[last] * (hz[last + 1] / hz[last]) ** part), float(np.angle(around, True)[last])


def axis_response(inertia: float, viscous: float, late: float, dt: float, z: Response) -> Response:
    """Return position per force of a rigid axis at these z, the force held over each sample.

    Parameters
    ----------
    inertia, viscous : float
        SI.
    late : float
        Delay of the force, s; what is left of whole samples splits each sample in two.
    dt : float
        Sampling step, s.
    z : (n,) ndarray
        On the unit circle, but not 1.
    """
    whole = floor(late / dt + 1e-9)
    part = max(late - whole * dt, 0.0)
    decay, reach, _ = _glide(viscous / inertia, dt)
    tail, new_dq, new_q = _glide(viscous / inertia, dt - part)
    _, dq, q = _glide(viscous / inertia, part)
    old_q, old_dq = q + dq * new_dq, dq * tail
    moved = (z - decay) * (new_q + old_q / z) + reach * (new_dq + old_dq / z)
    return np.asarray(moved / ((z - 1.0) * (z - decay)) * z**-whole / inertia)


def _glide(rate: float, h: float) -> tuple[float, float, float]:
    """Return what friction (1/s) leaves of a speed over h s; speed and way per acceleration."""
    if rate * h <= _STILL:
        return 1.0, h, 0.5 * h * h
    reach = (1.0 - exp(-rate * h)) / rate
    return exp(-rate * h), reach, (h - reach) / rate
