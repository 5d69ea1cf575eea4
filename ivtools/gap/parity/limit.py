"""Limit: where a recorded command sits at one, which nobody may have declared."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ...loop import Controller
from ..rules import (
    AT_LIMIT,
    AT_TOP,
    CUT,
    CUT_SHARE,
    FLAT,
    LIMIT_SAMPLES,
    LITTLE,
    NEARLY_ALL,
    PARITY_HEAD,
    ROUGHEST,
    SOME,
)
from .signals import Signals, least_at

Array = NDArray[np.float64]


def limit_of(
    signals: Signals, controller: Controller
) -> tuple[Signals, float | None, NDArray[np.bool_]]:
    """Return signals that know their limit, one that nobody declared, and where they sit at any.

    The top of a command that was measured, as a current is, is as flat as its noise lets it.
    """
    own = np.abs(signals.own)
    largest, top = float(np.max(own)), _top(own, signals.step)
    noisy = top[1] in (AT_TOP * largest, np.inf)
    for level, least in (_level(signals, controller, own), top) if noisy else (top,):
        at_top = own > least
        if at_top.sum() < LIMIT_SAMPLES:
            continue
        found = signals.limited(min(level, controller.limit), least)
        law = found.law(controller, controller.delay)
        cut = at_top & _cut(found, law, level)
        mostly = cut.sum() > CUT_SHARE * at_top.sum()
        if cut.sum() >= LIMIT_SAMPLES and (mostly or _explains(found, controller, law, cut)):
            declared = largest >= AT_LIMIT * controller.limit
            return found, None if declared else level, at_top
    return signals, None, own >= signals.least


def _top(own: Array, step: float) -> tuple[float, float]:
    """Return the largest command and the least from which it sits there, if it does.

    A smooth peak that is sampled fast has many samples near its top as well.
    """
    largest = float(np.max(own))
    least = AT_TOP * largest
    sits = np.median(own[own >= least]) >= least + NEARLY_ALL * (largest - least)
    return largest, least_at(own, largest, AT_TOP, step) if sits else np.inf


def _level(signals: Signals, controller: Controller, own: Array) -> tuple[float, float]:
    """Return where the command is when the law gives more than it ever is, and the least of that.

    It is flat there, and the law is not. An integrator stands, for a first look, wherever the
    command is near its largest.
    """
    largest = float(np.max(own))
    near = signals.limited(largest, (1.0 - LITTLE) * largest)
    law = near.law(controller, controller.delay)
    cut = _cut(near, law, largest)
    if cut.sum() < LIMIT_SAMPLES:
        return largest, np.inf
    level, noise = float(np.median(own[cut])), stats.median_abs_deviation(own[cut])
    spread = stats.median_abs_deviation(np.abs(law[cut]))
    flat = FLAT * noise < ROUGHEST * level and noise < SOME * spread
    return level, min(level - FLAT * noise, AT_TOP * level) if flat else np.inf


def _cut(signals: Signals, law: Array, level: float) -> NDArray[np.bool_]:
    """Return where a law gives more than a level, with the sign of the command, (n_samples,)."""
    same = np.sign(law) == np.sign(signals.own)
    return (np.abs(law) > CUT * level) & same


def _explains(signals: Signals, controller: Controller, law: Array, cut: NDArray[np.bool_]) -> bool:
    """Whether a law gives nearly the command if it is limited, and does not if it is not.

    One with an integrator, a little wrong, may hardly exceed the limit where it begins and ends.
    The noise of the log, as it is where the law was cut, no law explains.
    """
    own = signals.own[PARITY_HEAD:]
    left = signals.own - np.clip(law, -signals.limit, signals.limit)
    noise = float(np.mean(left[cut] ** 2)) * len(own)
    limited = float(left[PARITY_HEAD:] @ left[PARITY_HEAD:]) - noise
    free = signals.limited(np.inf, np.inf).error(controller, controller.delay, 0.0)[PARITY_HEAD:]
    return limited < LITTLE * min(float(free @ free), float(own @ own))


def beyond(command: Array, limit: float) -> bool:
    """Whether a command, (n_samples, ...), exceeds what it is said to be limited to."""
    return int(np.sum(np.abs(command) > (1.0 + LITTLE) * limit)) >= LIMIT_SAMPLES
