"""Optimal: the Fourier series within limits that tells the parameters best."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from ..errors import AxisError
from ..loop import ClosedLoop, RobotLoop
from ..pipeline import Motion
from .excitation import Excitation
from .fourier import Fourier, Series
from .information import Criterion, Information
from .limits import Limits

Array = NDArray[np.float64]

HARMONICS = (4, 5, 8)  # of random series; with the period they say the bandwidth
STARTS = 24  # searches


class Stage(NamedTuple):
    """Searches with so many harmonics at least; how sharp, how long, and how many then go on."""

    harmonics: int
    per_wave: int  # samples of the shortest wave
    powers: tuple[float, ...]
    steps: int
    kept: int


#: What a short search finds says more of a start than what the start is worth: many begin, few end.
STAGES = (
    Stage(12, 8, (2.0,), 40, 10),
    Stage(16, 8, (4.0,), 60, 5),
    Stage(16, 8, (12.0,), 80, 3),
    Stage(20, 12, (4.0, 20.0), 80, 2),
    Stage(20, 12, (60.0,), 120, 1),
)
_PER_WAVE = 12  # samples of the shortest wave where a series is judged
_FINE = 60  # and when limits are made to hold
_WEIGHT = 100.0  # of motion beyond its limits
_SHRINK, _SHRINKS = 0.95, 60


def fourier(
    loop: ClosedLoop | RobotLoop,
    limits: Limits,
    *,
    seconds: float = 20.0,
    rate_hz: float = 1000.0,
    criterion: Criterion = "condition",
    tries: int = 60,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Excitation:
    """Return the series within limits whose record would tell the parameters best.

    Random series of several bandwidths are scaled to the limits; short gradient searches start from
    the best of them, and ever longer ones, with more harmonics, from the best of what those find.
    The same arguments give the same series.

    Parameters
    ----------
    loop : ClosedLoop or RobotLoop
        Its columns count, and its starting values for the efforts.
    limits : Limits
    seconds : float
        Length of a period.
    rate_hz : float
        Of the samples.
    criterion : {"condition", "d", "a"}
        See `Information`.
    tries : int
        Random series.
    seed : int
    progress : callable, optional
        Called with a line of text at each stage.

    Raises
    ------
    AxisError
        If the limits leave no motion, such as an effort that does not hold the arm.

    References
    ----------
    J. Swevers et al., IEEE Trans. Robotics and Automation 13(5), 1997: the series; K.-J. Park,
    "Fourier-based optimal excitation trajectories for the dynamic identification of robots",
    Robotica 24(5), 2006: their bandwidth.
    """
    say = progress or (lambda _: None)
    information = Information(loop, limits, criterion)
    say("random series")
    drawn = sorted(_drawn(information, seconds, tries, seed), key=lambda pair: pair[0])
    if not drawn:
        raise AxisError(
            "no random motion stays within the efforts; check [limits] effort, or the links"
        )
    best_random = min(information.condition(_coarse(series)) for _, series in drawn)

    found = [Found(value, series) for value, series in drawn[:STARTS]]
    for stage in STAGES:
        say(f"{len(found)} searches up to {stage.harmonics / seconds:.3g} Hz")
        better = [_searched(information, start, stage) for start in found]
        found = sorted(better, key=lambda one: one.value)[: stage.kept]
    best = found[0].series
    samples = round(seconds * rate_hz)
    motion = best.motion(samples)
    return Excitation(
        np.arange(samples) / rate_hz,
        motion,
        information.effort(motion),
        information.condition(best.motion(_FINE * best.harmonics)),
        limits,
        "fourier",
        {
            "criterion": criterion,
            "period_s": seconds,
            "harmonics": best.harmonics,
            "bandwidth_hz": best.bandwidth_hz,
            "best_random": best_random,
            "tries": tries,
        },
    )


def _coarse(series: Fourier) -> Motion:
    return series.motion(_PER_WAVE * series.harmonics)


def _judged(information: Information, series: Fourier) -> float:
    """Return the criterion as it is, without smoothing."""
    motion = _coarse(series)
    if information.criterion == "condition":
        return information.condition(motion)
    return information(motion).value


def _drawn(
    information: Information, seconds: float, tries: int, seed: int
) -> Iterator[tuple[float, Fourier]]:
    """Yield random series within all limits, each with what it is worth."""
    rng, limits = np.random.default_rng(seed), information.limits
    middle = 0.5 * (limits.lower + limits.upper)
    for k in range(tries):
        harmonics = HARMONICS[k % len(HARMONICS)]
        shape = (limits.n_joints, 2 * harmonics - 2)
        wide = 1e3 * (limits.upper - limits.lower)[:, np.newaxis] * rng.standard_normal(shape)
        series = Fourier(seconds, wide, middle).within(limits, _FINE * harmonics)
        held = _held(information, series)
        if held is not None:
            yield _judged(information, held), held


def _held(information: Information, series: Fourier) -> Fourier | None:
    """Return the series within efforts as well, made smaller joint by joint; None if none is."""
    limits, samples = information.limits, _PER_WAVE * series.harmonics
    for _ in range(_SHRINKS):
        effort = np.abs(information.effort(series.motion(samples))).max(axis=0)
        if not (effort > limits.effort).any():
            return series
        share = np.where(effort > limits.effort, _SHRINK, 1.0)
        series = Fourier(series.period, series.coefficients * share[:, np.newaxis], series.centre)
    return None


class Found(NamedTuple):
    """A series within limits, and what it is worth."""

    value: float
    series: Fourier


def _searched(information: Information, found: Found, stage: Stage) -> Found:
    """Return the series that a gradient search finds from a start, or the start if none is better.

    The search lets motion beyond its limits cost; what it finds is made to hold them all.
    """
    start = found.series.wider(stage.harmonics)
    series = Series(start.period, start.harmonics, stage.per_wave * start.harmonics)
    n, size = start.coefficients.shape
    limits = information.limits
    unit = limits.upper - limits.lower
    x = np.column_stack([start.coefficients, start.centre]) / unit[:, np.newaxis]

    def unpacked(x: Array) -> tuple[Array, Array]:
        parts = x.reshape(n, size + 1) * unit[:, np.newaxis]
        return parts[:, :size], parts[:, size]

    for power in stage.powers if information.criterion == "condition" else stage.powers[:1]:
        sharp = replace(information, power=power, soft=True)

        def cost(x: Array, sharp: Information = sharp) -> tuple[float, Array]:
            motion = series.motion(*unpacked(x))
            value, slopes = sharp(motion)
            more, beyond = _beyond(motion, sharp.limits)
            q, dq, ddq = (a + b for a, b in zip(slopes, beyond, strict=True))
            functions = series.functions
            by = q.T @ functions.q + dq.T @ functions.dq + ddq.T @ functions.ddq  # (n, size)
            by = np.column_stack([by, q.sum(axis=0)]) * unit[:, np.newaxis]
            return value + more, by.ravel()

        x = minimize(
            cost, x.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": stage.steps}
        ).x
    samples = _FINE * start.harmonics
    held = _held(information, Fourier(start.period, *unpacked(x)).within(limits, samples))
    value = np.inf if held is None else _judged(information, held)
    return found if held is None or value >= found.value else Found(value, held)


def _beyond(motion: Motion, limits: Limits) -> tuple[float, Motion]:
    """Return what motion beyond its limits costs, and the derivative of that."""
    middle, half = 0.5 * (limits.lower + limits.upper), 0.5 * (limits.upper - limits.lower)
    total, slopes, rest = 0.0, [], np.zeros_like(middle)
    for signal, centre, most in zip(
        motion, (middle, rest, rest), (half, limits.speed, limits.acceleration), strict=True
    ):
        share = (signal - centre) / most
        over = np.maximum(np.abs(share) - 1.0, 0.0)
        total += _WEIGHT * float(np.sum(over**2))
        slopes.append(2.0 * _WEIGHT * over * np.sign(share) / most)
    return total, Motion(*slopes)
