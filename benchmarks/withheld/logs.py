"""What a log may have made of a record before it is diagnosed, and the controller never saw."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

#: Columns of a record.
Log = dict[str, np.ndarray]

#: Of a log and the stroke of its axis, m or rad, what becomes of the log.
Kind = Callable[[Log, float], Log]

_DIGITS = 1e-5  # step of a rounded reference, of the stroke
_LEVELS = 4000  # of a coarse command
_FAR = 1e3  # strokes between the motion and the origin of positions


def _changed(log: Log, **columns: np.ndarray) -> Log:
    return {**log, **columns}


def _rounded(log: Log, stroke: float) -> Log:
    """Return it with a reference of few digits."""
    step = _DIGITS * stroke
    return _changed(log, q_ref=step * np.round(log["q_ref"] / step))


def _coarse(log: Log, stroke: float) -> Log:
    """Return it with a command of few digits."""
    step = np.ptp(log["nu"]) / _LEVELS
    return _changed(log, nu=step * np.round(log["nu"] / step))


def _late(log: Log, stroke: float) -> Log:
    """Return it with every command one sample after it acted."""
    return _changed(log, nu=np.concatenate([log["nu"][:1], log["nu"][:-1]]))


def _early(log: Log, stroke: float) -> Log:
    """Return it with every command one sample before it acts."""
    return _changed(log, nu=np.concatenate([log["nu"][1:], log["nu"][-1:]]))


def _far(log: Log, stroke: float) -> Log:
    """Return it with positions that are counted from far away."""
    away = _FAR * stroke
    return _changed(log, q=log["q"] + away, q_ref=log["q_ref"] + away)


def _every(count: int) -> Kind:
    """Return one of so many samples of a log."""
    return lambda log, stroke: {name: x[::count] for name, x in log.items()}


def _part(start: float, stop: float) -> Kind:
    """Return the part of a log between two times, s."""

    def cut(log: Log, stroke: float) -> Log:
        inside = (log["t"] >= start) & (log["t"] < stop)
        return {name: x[inside] for name, x in log.items()}

    return cut


#: Name to what becomes of a record.
KINDS: dict[str, Kind] = {
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


def changed(kind: str, logs: tuple[Log, ...]) -> tuple[Log, ...]:
    """Return what became of the logs of an axis, of all of them the same."""
    stroke = float(np.ptp(logs[0]["q"]))
    return tuple(KINDS[kind](log, stroke) for log in logs)
