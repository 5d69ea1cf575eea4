"""Instruments: the law of a log whose noise the controller did not see.

Such noise is in every column that the measured position makes, and least squares shrinks its gain.
The reference has none of it: what it makes of the position, fed to the law, gives instruments, and
a law is right where nothing of what it leaves follows from the reference.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ...errors import AxisError, RecordError
from ..controllers.seen import speed_reference
from .data import Data
from .forms import plausible
from .polish import Fitted, Law, jacobian, moved

Array = NDArray[np.float64]

_LAGS = (0.0, 2.0, 6.0, 20.0, 60.0, 200.0)  # samples, of low-passes that the reference's words pass
_STEPS = 8  # of Newton's
_DONE = 1e-3  # standard errors, of a last step


def refined(data: Data, fitted: Fitted) -> Fitted | None:
    """Return a law of the same structure by instrumental variables; None if it has no answer.

    Newton's steps on Z'(command - law) = 0, in which Z is how the command of the law changes with
    its settings where the reference alone moves it.

    Parameters
    ----------
    data : Data
        As measured.
    fitted : Fitted
        The structure, and settings to begin from.
    """
    controller, names = fitted.controller, fitted.names
    try:
        law, clean = Law(data, controller), Law(_clean(data), controller)
    except RecordError:  # a reference that makes no motion
        return None
    for _ in range(_STEPS):
        e = law.resids(controller)
        J = jacobian(law, controller, names)
        Z = jacobian(clean, controller, names)
        size = np.maximum(np.linalg.norm(Z, axis=0), 1e-300)
        A = (Z / size).T @ (J / size)
        step = np.linalg.lstsq(A, (Z / size).T @ e, rcond=1e-9)[0]
        noise = np.linalg.lstsq(A, np.eye(len(step)), rcond=1e-9)[0] * np.std(e)
        try:
            controller = moved(controller, names, step / size)
            e = law.resids(controller)
        except AxisError:
            return None
        if (np.abs(step) <= _DONE * np.linalg.norm(noise, axis=1)).all():
            explained = Z @ np.linalg.lstsq(Z, J, rcond=1e-9)[0]
            good = plausible(controller.settings, data.sign) and np.isfinite(e).all()
            left = float(e @ e) / law.power
            return Fitted(controller, names, explained, e, left) if good else None
    return None


def _clean(data: Data) -> Data:
    """Return the log with the part of position and velocity that follows from the reference."""
    record, X = data.record, _words(data)
    dq_ref = speed_reference(record, data.derivative)

    def explained(x: Array) -> Array:
        return np.asarray(X @ np.linalg.lstsq(X.T @ X, X.T @ x, rcond=1e-12)[0])

    q, ref = record.q[:, 0], record.q_ref
    if ref is not None:
        clean = {"q": ref[:, 0] - explained(ref[:, 0] - q)}
    else:  # a velocity loop: where it is does not matter
        lag = dq_ref - np.gradient(q, record.dt)
        clean = {"q": q[0] + np.cumsum(dq_ref - explained(lag)) * record.dt}
    if record.dq is not None:
        clean["dq"] = dq_ref - explained(dq_ref - record.dq[:, 0])
    return replace(data, record=record.replace(**clean))


def _words(data: Data) -> Array:
    """Return signals that the reference makes of a loop, (n, m): its words behind slow filters."""
    record = data.record
    dq = speed_reference(record, data.derivative)
    ddq = np.gradient(dq, record.dt)
    words = [dq, ddq, np.sign(dq), np.gradient(ddq, record.dt)]
    if record.q_ref is not None:
        q = record.q_ref[:, 0] - record.q_ref.mean()
        words += [q, q**2] + ([np.sin(q), np.cos(q)] if data.joint == "revolute" else [])
    columns = [np.ones(len(dq))]
    for lag in _LAGS:
        keep = lag / (lag + 1.0)
        columns += [signal.lfilter([1.0 - keep], [1.0, -keep], w - w[0]) for w in words]
    X = np.column_stack(columns)
    return np.asarray(X / np.maximum(np.linalg.norm(X, axis=0), 1e-300))
