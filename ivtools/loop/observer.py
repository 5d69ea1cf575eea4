"""Observer: how the axis itself moved, behind the noise of its encoder.

The controller passes the encoder's noise on to the drive, which shakes the axis. A simulation from
the reference knows nothing of that, and the differentiated position is noise itself. But the
recorded command says how the axis was shaken: the model driven by it moves as the axis did.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from math import pi
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import RecordWarning
from .controllers import Controller

if TYPE_CHECKING:
    from ..pipeline import Motion
    from ..record import Record
    from .closed_loop import ClosedLoop
    from .model import Theta

Array = NDArray[np.float64]

_DAMPING = 0.7
_NONE = ("kp", "kv", "velocity_filter", "added")  # of a controller's mismatch: it is not simulated


def driven_by(command: Array, motion: Motion, record: Record) -> Record:
    """Return a record whose known input is a command, and whose reference the measured motion.

    Parameters
    ----------
    command : (n_samples, 1) ndarray
        In units of the command, such as V.
    motion : Motion
        Band-passed position and its derivatives, (n_samples, 1) each.
    record : Record
        Gives the time.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordWarning)  # the record itself has warned
        return record.replace(
            q=motion.q, q_ref=motion.q, dq_ref=motion.dq, nu=command, added=command, tau=None
        )


def observed_velocity(
    loop: ClosedLoop, driven: Record, theta: Theta | None, pull_hz: float, **options: Any
) -> Array:
    """Return the velocity of the model driven by a recorded command, (n_samples, 1).

    A slow pull towards the measured motion makes up for what the command does not tell: the
    force noise, and what the model lacks.

    Parameters
    ----------
    loop : ClosedLoop
        Its controller does not matter.
    driven : Record
        From `driven_by`.
    theta : mapping, Series or array_like, optional
        Parameters; default: the starting values.
    pull_hz : float
        Natural frequency of the pull. A faster one follows the encoder's noise, a slower one
        keeps the errors of force and model for longer.
    **options
        As for `ClosedLoop.simulate`.

    Examples
    --------
    >>> import ivtools as iv
    >>> loop, twin = iv.axes.emps(), iv.datasets.twin()
    >>> loop = loop.with_terms("inertia", "asymmetric-friction")
    >>> motion = loop.pipeline(twin).differentiate(twin.q, twin.dt)
    >>> v = observed_velocity(loop, driven_by(twin.nu, motion, twin), twin.theta_true, 3.0)
    >>> bool(abs(v - motion.dq).max() < 0.02 * abs(v).max())
    True
    """
    values = loop.values(theta)
    rate = 2.0 * pi * pull_hz  # rad/s
    unit = values["inertia"] * rate / loop.gain
    pull = Controller("pd", {"kp": unit * rate, "kd": 2.0 * _DAMPING * unit})
    values |= {key: 0.0 for n in _NONE if (key := f"controller-mismatch.{n}") in values}
    return replace(loop, controller=pull).simulate(driven, values, **options).dq
