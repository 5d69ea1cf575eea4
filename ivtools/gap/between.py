"""Between: a loop whose controller takes several samples for each of the log.

Between its samples the log is interpolated; what is simulated there is compared at its samples.
"""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from ..loop import ClosedLoop, Simulation
from ..loop.model import Theta
from ..record import Record
from .rules import SINGLE

Array = NDArray[np.float64]

_FINER: WeakKeyDictionary[Record, dict[int, Record]] = WeakKeyDictionary()


def interpolated(record: Record, count: int) -> Record:
    """Return a record with so many samples for each; an added input is held between them."""
    if count == 1:
        return record
    kept = _FINER.setdefault(record, {})
    if count not in kept:
        kept[count] = _interpolated(record, count)
    return kept[count]


def _interpolated(record: Record, count: int) -> Record:
    signals: dict[str, Any] = {}
    for name, x in record.signals.items():
        degree = _degree(x) if name in ("q_ref", "dq_ref") else 1 if name in ("nu", "tau") else 3
        signals[name] = _finer(x, count, degree) if degree else _held(x, count)
    if record.added is not None:
        signals["added"] = _held(record.added, count)
        if record.nu is not None:  # which jumps where the added input does
            signals["nu"] = _finer(record.nu - record.added, count, 1) + signals["added"]
    extra = {name: _finer(x, count, 1) for name, x in record.extra.items()}
    return Record(_finer(record.t, count, 1), extra=extra, name=record.name, **signals)


def _degree(reference: Array) -> int:
    """Return how a reference goes on between its samples, (n_samples, 1): 0 holds it.

    One that was made at a lower rate than it is logged has single jumps, where it was held, or
    single bends, where it was interpolated; one between two samples of the log makes two of them.
    """
    for degree in (0, 1):
        size = np.abs(np.diff(reference[:, 0], degree + 1))
        single = size > SINGLE * np.max(size, initial=0.0)
        starts = np.flatnonzero(single[1:] & ~single[:-1])
        if 0 < single.sum() <= 2 * (len(starts) + single[0]):
            return degree
    return 3


def _finer(x: Array, count: int, degree: int) -> Array:
    """Return a signal with so many samples for each, by a spline, (n_finer, ...)."""
    at = np.arange(count * (len(x) - 1) + 1) / count
    return np.asarray(make_interp_spline(np.arange(len(x)), x, k=degree)(at))


def _held(x: Array, count: int) -> Array:
    """Return the same of a signal that stays as it is until its next sample."""
    return x[np.arange(count * (len(x) - 1) + 1) // count]


def simulate(
    loop: ClosedLoop, record: Record, values: Theta, count: int, ramp: bool = False, **signals: Any
) -> Simulation:
    """Simulate a loop whose controller takes so many samples for each of the record.

    Parameters
    ----------
    loop, record, values, ramp
        As for `ClosedLoop.simulate`.
    count : int
        Samples of the controller from one of the record to the next.
    **signals : (n_samples, ...) ndarray, optional
        Of the others of its arguments those that are signals, at the samples of the record.

    Returns
    -------
    Simulation
        At the samples of the record.
    """
    if count == 1:
        return loop.simulate(record, values, ramp=ramp, **signals)
    given: Any = {k: _finer(x, count, 1) for k, x in signals.items() if x is not None}
    fine = loop.simulate(interpolated(record, count), values, ramp=ramp, **given)
    q, dq, ddq, nu, tau = (x[::count] for x in (fine.q, fine.dq, fine.ddq, fine.nu, fine.tau))
    return Simulation(record.t, q, dq, ddq, nu, tau, fine.loop, place=signals.get("place"))
