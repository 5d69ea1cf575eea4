"""Sizes: what the parameters of an effect are measured in on one axis, from one motion of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..record import Record

Array = NDArray[np.float64]

#: Dry friction, of the force of the drive, where nobody states it, and the share of the stroke
#: after which it acts in full: where a search for presliding begins.
DRY, TAKES_HOLD = 0.2, 5e-4


def sizes(
    record: Record, q: Array, dq: Array, force: Array, command: Array, friction: float = 0.0
) -> dict[str, float]:
    """Return the size of each kind of `Parameter.scale`, SI.

    Parameters
    ----------
    record : Record
        When it was sampled.
    q, dq : ndarray, (n_samples,) or (n_samples, 1)
        Position, m or rad, and velocity of the motion.
    force : ndarray, (n_samples,) or (n_samples, 1)
        N or N m.
    command : ndarray, (n_samples,) or (n_samples, 1)
        What the controller asks of the drive.
    friction : float
        Dry friction, N or N m, if it is known.

    Examples
    --------
    >>> from ivtools import datasets
    >>> twin = datasets.twin()
    >>> found = sizes(twin, twin.q, np.gradient(twin.q, twin.dt, axis=0), 35.15 * twin.nu, twin.nu)
    >>> round(found["stroke"], 2)
    0.24
    """
    rms, speed, stroke = (float(x) for x in (np.sqrt(np.mean(force**2)), _largest(dq), np.ptp(q)))
    dry = abs(friction) or DRY * rms
    return {
        "force": rms,
        "per force": 1.0 / rms if rms > 0.0 else 1.0,
        "peak": _largest(force),
        "speed": speed,
        "stroke": stroke,
        "time": float(np.ptp(record.t)),
        "step": record.dt,
        "command": _largest(command),
        "stiffness": dry / (TAKES_HOLD * stroke),
        "damping": dry / max(speed, 1e-300),
        "one": 1.0,
    }


def _largest(x: Array) -> float:
    return float(np.max(np.abs(x)))
