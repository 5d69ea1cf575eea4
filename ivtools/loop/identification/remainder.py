"""What a law leaves of the command, and what it looks like."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .data import Data
from .polish import Fitted, Law

if TYPE_CHECKING:
    from ..closed_loop import ClosedLoop

Array = NDArray[np.float64]

_TOLD = 1e-5  # share of the command's power that is worth a word
_PART = 0.25  # share of the remainder that something must explain to be named
_TURN = 2.0 * np.pi
_HARMONICS = 400  # per turn
_BINS = 4000  # of the position
_PADDING, _PERIODS = 4, 3  # of the spectrum over position; that a stroke holds at least
_MOVES = 0.03  # of a turn, or it says nothing of periods


def remains(loop: ClosedLoop, data: Data, best: Fitted) -> tuple[str, ...]:
    """Say what is in the command beside the law's own feedback."""
    return (*_fed(loop, best), *_left(loop, data, best))


def _fed(loop: ClosedLoop, best: Fitted) -> list[str]:
    """Say which feed-forwards and columns the law has that the axis file does not state."""
    revolute = loop.joint == "revolute"
    units = {
        "acceleration": ("kg m2" if revolute else "kg", "of inertia feed-forward"),
        "velocity": ("N m s/rad" if revolute else "N s/m", "of viscous feed-forward"),
        "coulomb": ("N m" if revolute else "N", "of Coulomb friction feed-forward"),
        "gravity": ("N m" if revolute else "N", "of gravity feed-forward"),
        "gravity_cos": ("N m", "of gravity feed-forward (cosine)"),
    }
    told = []
    for name, gain in best.controller.feedforward.items():
        if name in loop.controller.feedforward:
            continue
        if name in units:
            unit, what = units[name]
            told.append(
                f"{loop.gain * gain:.4g} {unit} {what} is in the command and not in the log"
            )
        else:
            told.append(f"a feed-forward: column {name}, times {gain:.4g}")
    for name, gain in best.controller.feedback.items():
        if name not in loop.controller.feedback:
            told.append(f"another feedback: column {name}, times {gain:.4g}")
    return told


def _left(loop: ClosedLoop, data: Data, best: Fitted) -> list[str]:
    """Say what the rest looks like: periodic in the position, or like an acceleration."""
    if best.left < _TOLD:
        return []
    late = best.controller.delay
    law = Law(data, best.controller)
    n = len(data.command) - late
    rest = (data.command[late:] - law.command(best.controller)[:n]) * (data.side[late:] == 0.0)
    rest = rest - rest.mean()
    share = float(np.sqrt(best.left))
    text = _periodic(loop, data.record.q[:n, 0], rest)
    return [f"{100 * share:.2g} % of the command is {text}"] if text else []


def _periodic(loop: ClosedLoop, q: Array, rest: Array) -> str | None:
    """Say with which period of the position a remainder repeats, if it does."""
    span = float(np.ptp(q))
    if span <= 0.0 or (loop.joint == "revolute" and span < _MOVES * _TURN):
        return None
    at = np.minimum(((q - q.min()) / span * _BINS).astype(int), _BINS - 1)
    count = np.bincount(at, minlength=_BINS)
    mean = np.bincount(at, weights=rest, minlength=_BINS) / np.maximum(count, 1)
    weight = np.where(count > 0, count, 0)
    power = float(rest @ rest)
    spectrum = np.fft.rfft(mean * weight, _PADDING * _BINS)
    first = _PADDING * _PERIODS
    k = int(np.argmax(np.abs(spectrum[first:]))) + first
    period = _PADDING * span / k
    waves = np.column_stack([f(_TURN * q / period) for f in (np.cos, np.sin)])
    x = np.linalg.lstsq(waves, rest, rcond=None)[0]
    part = 1.0 - float(np.sum((rest - waves @ x) ** 2)) / max(power, 1e-300)
    if part < _PART:
        return None
    if loop.joint == "revolute":
        return f"periodic in q, {_TURN / period:.3g} per turn: a compensation"
    return f"periodic in q, every {period:.4g} m: a compensation"
