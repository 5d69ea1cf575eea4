"""What a log may have made of a record before it is diagnosed, and the controller never saw."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

#: Columns of a record.
Log = dict[str, np.ndarray]

_DIGITS = 1e-5  # step of a rounded reference, of its range
_LEVELS = 4000  # of a coarse command
_FAR = 1e3  # ranges between the motion and the origin of positions


def _changed(log: Log, **columns: np.ndarray) -> Log:
    return {**log, **columns}


def _rounded(log: Log) -> Log:
    """Return it with a reference of few digits."""
    step = _DIGITS * np.ptp(log["q_ref"])
    return _changed(log, q_ref=step * np.round(log["q_ref"] / step))


def _coarse(log: Log) -> Log:
    """Return it with a command of few digits."""
    step = np.ptp(log["nu"]) / _LEVELS
    return _changed(log, nu=step * np.round(log["nu"] / step))


def _late(log: Log) -> Log:
    """Return it with every command one sample after it acted."""
    return _changed(log, nu=np.concatenate([log["nu"][:1], log["nu"][:-1]]))


def _early(log: Log) -> Log:
    """Return it with every command one sample before it acts."""
    return _changed(log, nu=np.concatenate([log["nu"][1:], log["nu"][-1:]]))


def _far(log: Log) -> Log:
    """Return it with positions that are counted from far away."""
    away = _FAR * np.ptp(log["q"])
    return _changed(log, q=log["q"] + away, q_ref=log["q_ref"] + away)


def _every(count: int) -> Callable[[Log], Log]:
    """Return one of so many samples of a log."""
    return lambda log: {name: x[::count] for name, x in log.items()}


def _part(start: float, stop: float) -> Callable[[Log], Log]:
    """Return the part of a log between two times, s."""

    def cut(log: Log) -> Log:
        inside = (log["t"] >= start) & (log["t"] < stop)
        return {name: x[inside] for name, x in log.items()}

    return cut


#: Name to what becomes of a record.
KINDS: dict[str, Callable[[Log], Log]] = {
    "rounded": _rounded,
    "coarse": _coarse,
    "late": _late,
    "early": _early,
    "sparse": _every(2),
    "sparser": _every(4),
    "far": _far,
    "short": _part(0.0, 6.0),
    "begun": _part(3.2, 60.0),
}
