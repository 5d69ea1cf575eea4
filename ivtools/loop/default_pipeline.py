"""The default pipeline: filters from the loop's bandwidth, alignment and mask from the record."""

from __future__ import annotations

from dataclasses import replace
from math import pi, sqrt
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from ..errors import AxisError
from ..pipeline import Pipeline
from .rough_inertia import rough_inertia

if TYPE_CHECKING:
    from ..pipeline import Motion
    from ..record import Record
    from .closed_loop import ClosedLoop

Array = NDArray[np.float64]
Rule = Literal["record", "report"]

SLOWLY = ("stribeck", "regularised-coulomb", "presliding", "sqrt-viscous", "backlash")
"""Effects that show at low speed: a model with one of them keeps every row."""

WIDEST = 0.08  # of the sampling rate: the bandwidth whose cut-off, five times it, is still a filter
ABOVE = 10.0  # times the power of the noise: a motion
MOST = 0.95  # of the velocity's power that the band of a free motion holds
LEAST = 0.2  # of the rows a mask must leave
SEEN, ASKED = 0.6, 0.3  # of the square of the acceleration, measured or of the reference, as well


class Mask(NamedTuple):
    """Which rows are too slow to have a direction.

    Attributes
    ----------
    slow : float
        Of the highest speed: slower is a reversal or a standstill.
    certain : float
        Standard deviations of the velocity's noise: faster has a direction.
    smeared : float
        Periods of the cut-off: to either side, the low-pass smears a reversal so far.
    """

    slow: float
    certain: float
    smeared: float


NARROW = Mask(0.005, 3.0, 0.5)
WIDE = Mask(0.02, 6.0, 1.0)
"""For robots, whose rows the measured velocity chooses to the end: noise has less of a say."""


def default_pipeline(
    loop: ClosedLoop, record: Record, rule: Rule, mask: Mask = NARROW, **settings: Any
) -> Pipeline:
    """Return the pipeline of a record; see `ClosedLoop.pipeline`."""
    if rule not in get_args(Rule):
        raise AxisError(f"pipeline rule {rule!r} is unknown; use {' or '.join(get_args(Rule))}")
    known = loop.known(record)
    if known.controller.kind == "none":
        natural = motion_hz(record)
    else:
        inertia = loop.start.get("inertia") or rough_inertia(loop, record)
        natural = known.natural_frequency_hz(record.dt, inertia)
    if not natural > 0.0:
        raise AxisError(
            "the closed loop has no mode of its own; check the controller's gains, or give a "
            "Pipeline"
        )
    hz = min(float(f"{natural:.0e}"), WIDEST * record.sampling_hz)
    if rule == "report":
        return Pipeline.from_bandwidth(
            hz, record.sampling_hz, **{"breaks": record.breaks} | settings
        )
    # A command held from sample k to k + 1, and late, acts at sample k as the mean of two.
    aligned = {"force_shift": 0.5 + loop.delay / record.dt, "blank": True, "breaks": record.breaks}
    pipeline = Pipeline.from_bandwidth(hz, record.sampling_hz, **aligned | settings)
    if "trim" not in settings:
        pipeline = replace(pipeline, trim=2 * pipeline.trim[:1])  # filters extrapolate at both ends
    slow = {term.name for term in loop.terms} & {*SLOWLY}
    by_hand = {"min_speed", "guard"} & {*settings}
    return pipeline if slow or by_hand else _masked(pipeline, record, mask)


def motion_hz(record: Record) -> float:
    """Return the frequency, Hz, below which nearly all of the measured velocity's power lies.

    Without a controller no mode of a loop says how fast an axis moves. What does not stand out of
    the encoder's noise, whose spectrum is flat, does not count.
    """
    q = record.longest.q[:, 0]
    window = np.hanning(len(q))
    power = np.abs(np.fft.rfft((q - q.mean()) * window)) ** 2
    hz = np.fft.rfftfreq(len(q), record.dt)
    noise = float(np.median(power[len(power) // 2 :]))
    speed = np.where(power > ABOVE * noise, hz**2 * power, 0.0)
    return float(hz[np.searchsorted(speed.cumsum(), MOST * speed.sum())])


def _masked(pipeline: Pipeline, record: Record, mask: Mask) -> Pipeline:
    """Mask what is too slow to have a direction, as far as enough rows are left.

    Around a reversal dry friction changes its sign within a sample and the low-pass does not: it
    smears the acceleration over a period of the cut-off, and the velocity's sign is noise.
    """
    motion = pipeline.differentiate(record.q, record.dt)
    speed = np.abs(motion.dq[:, 0])
    noise = velocity_noise(pipeline, record, motion)
    least = max(mask.slow * float(speed.max()), mask.certain * noise)
    cutoff = pipeline.cutoff_hz
    smeared = mask.smeared * record.sampling_hz / cutoff if cutoff else pipeline.decimation
    guard = int(round(smeared))
    found = None  # the first that leaves enough rows
    while least > 1e-3 * mask.slow * speed.max():
        masked = replace(pipeline, min_speed=least, guard=guard)
        kept = masked.moving(len(speed), speed)
        if kept.mean() >= LEAST:
            if _pushed(record, motion, kept):
                return masked
            found = found or masked
        least, guard = 0.5 * least, guard // 2
    return found or pipeline


def _pushed(record: Record, motion: Motion, kept: NDArray[np.bool_]) -> bool:
    """Whether some of the samples show the inertia: enough of the acceleration is in them.

    An axis that sticks between short moves accelerates in few samples, next to standstill. Noise
    hides that from the measured acceleration, and the reference may jump where the axis does not.
    """
    q_ref = motion.q if record.q_ref is None else record.q_ref
    asked = np.gradient(np.gradient(q_ref[:, 0])) ** 2  # (n_samples,), of no unit
    seen = motion.ddq[:, 0] ** 2
    return bool(seen[kept].sum() >= SEEN * seen.sum() or asked[kept].sum() >= ASKED * asked.sum())


def velocity_noise(pipeline: Pipeline, record: Record, motion: Motion) -> float:
    """Return the deviation of the noise of the band-passed velocity, m/s or rad/s."""
    cutoff = pipeline.cutoff_hz
    if cutoff is None:
        return 0.0
    white = position_noise(pipeline, record, motion)
    return 2.0 * pi * cutoff * white * sqrt(2.0 / 3.0 * cutoff * record.dt)


_LEAST = 16  # samples that say anything of noise


def position_noise(pipeline: Pipeline, record: Record, motion: Motion) -> float:
    """Return the deviation of the position's white noise, from what the band-pass removes.

    The upper half of the removed band is taken, where the motion has no part; 0 without a filter.
    """
    cutoff, dt = pipeline.cutoff_hz, record.dt
    if cutoff is None:
        return 0.0
    removed = (record.q - motion.q)[pipeline.trim[0] :, 0]
    if len(removed) < _LEAST:
        return 0.0
    power = np.abs(np.fft.rfft(removed * np.hanning(len(removed)))) ** 2
    power /= np.sum(np.hanning(len(removed)) ** 2)
    hz = np.fft.rfftfreq(len(removed), dt)
    upper = hz >= 0.5 * (cutoff + hz[-1])
    return float(np.sqrt(np.median(power[upper]) / np.log(2.0)))
