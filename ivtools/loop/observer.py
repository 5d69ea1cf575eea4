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
from ..pipeline import Pipeline
from .controllers import Controller

if TYPE_CHECKING:
    from ..record import Record
    from .closed_loop import ClosedLoop
    from .model import Theta

Array = NDArray[np.float64]

_DAMPING = 0.7
_SMOOTHED = 3.0  # cut-off of the smoothing, in natural frequencies of the pull
_SMOOTHING_ORDER = 2  # the gain 1/(1 + (f/cutoff)^4) is Wiener's for these two errors


def driven_by(command: Array, q: Array, record: Record) -> Record:
    """Return a record whose known input is a command, and whose reference the measured motion.

    Its velocity is a backward difference, as a digital controller forms its own, so that an
    observer that moves as the axis is not pulled.

    Parameters
    ----------
    command : (n_samples, 1) ndarray
        In units of the command, such as V.
    q : (n_samples, 1) ndarray
        The motion, m or rad: as measured, or band-passed.
    record : Record
        Gives the time.
    """
    dq = np.diff(q, axis=0, prepend=2.0 * q[:1] - q[1:2]) / record.dt  # as a controller forms it
    for k in record.breaks:
        dq[k] = dq[k + 1]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordWarning)  # the record itself has warned
        return record.replace(q=q, q_ref=q, dq_ref=dq, nu=command, added=command, tau=None)


def observed_velocity(
    loop: ClosedLoop, driven: Record, theta: Theta | None, pull_hz: float, **options: Any
) -> Array:
    """Return the velocity of the model driven by a recorded command, (n_samples, 1).

    What the command does not tell, the force noise and what the model lacks, is taken from the
    measured motion: a slow pull keeps the model near it, and what remains between the two is
    smoothed, forward and backward, and added. The velocity error of the model falls with the
    frequency, that of the differentiated position grows with it, so Wiener's smoother of the
    difference is 1/(1 + (f/cutoff)^4), a Butterworth filter of order 2 in either direction.

    Parameters
    ----------
    loop : ClosedLoop
        Its controller does not matter.
    driven : Record
        From `driven_by`.
    theta : mapping, Series or array_like, optional
        Parameters; default: the starting values.
    pull_hz : float
        Natural frequency of the pull; the cut-off of the smoothing is three times that. A faster
        one follows the encoder's noise, a slower one keeps the errors of force and model.
    **options
        As for `ClosedLoop.simulate`.

    References
    ----------
    T. Kailath, A. H. Sayed, B. Hassibi, *Linear Estimation*, 2000, ch. 7 (Wiener's smoother).

    Examples
    --------
    >>> import ivtools as iv
    >>> loop, twin = iv.axes.emps(), iv.datasets.twin()
    >>> loop = loop.with_terms("inertia", "asymmetric-friction")
    >>> motion = loop.pipeline(twin).differentiate(twin.q, twin.dt)
    >>> v = observed_velocity(loop, driven_by(twin.nu, motion.q, twin), twin.theta_true, 2.5)
    >>> bool(abs(v - motion.dq).max() < 0.02 * abs(v).max())
    True
    """
    values = loop.values(theta)
    rate = 2.0 * pi * pull_hz  # rad/s
    unit = values["inertia"] * rate / loop.gain
    pull = Controller("pd", {"kp": unit * rate, "kd": 2.0 * _DAMPING * unit})
    values |= {key: 0.0 for key in values if key.startswith("controller-mismatch.")}
    moved = replace(loop, controller=pull).simulate(driven, values, **options)
    smoother = Pipeline(_SMOOTHED * pull_hz, 1, order=_SMOOTHING_ORDER, breaks=driven.breaks)
    rest = smoother.differentiate(driven.q - moved.q, driven.dt).dq
    return np.where(moved.dq == 0.0, 0.0, moved.dq + rest)  # at standstill, friction holds it
