"""The pipelines of a robot's joints, and the first guess of its parameters that they come from."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ..linalg import solve_iv
from ..pipeline import Pipeline
from ..pipelines import Pipelines
from ..record import Record
from .default_pipeline import WIDE, default_pipeline
from .standing import at_rest

if TYPE_CHECKING:
    from .robot_loop import RobotLoop

Array = NDArray[np.float64]

_BAND = 3.0  # of a motion's own band, for a first guess
_FASTEST = 0.1  # of the sampling rate: the highest cut-off of a filter
_GUESSES: WeakKeyDictionary[Record, dict[int, Any]] = WeakKeyDictionary()


def robot_pipelines(loop: RobotLoop, record: Record, **settings: Any) -> Pipelines:
    """Return the pipelines of the joints; see `RobotLoop.pipeline`."""
    guess, found = first_guess(loop, record), []
    for j in range(loop.n_joints):
        own = {k: v[j] if isinstance(v, list) else v for k, v in settings.items()}
        axis = loop.axis(j, record, guess)
        natural = axis.natural_frequency_hz(record.dt, axis.start["inertia"])
        if natural > _FASTEST * record.sampling_hz / 5.0:  # the inertia is hardly known
            own.setdefault("cutoff_hz", _FASTEST * record.sampling_hz)
        given = {"rule": "record", **axis.rows, **own}
        found.append(default_pipeline(axis, record.joint(j), mask=WIDE, **given))
    common = {
        "decimation": min(p.decimation for p in found),
        "trim": tuple(max(p.trim[i] for p in found) for i in range(2)),
    }
    still = tuple(np.flatnonzero(at_rest(record)).tolist())
    return Pipelines(tuple(replace(p, **common) for p in found), still)  # type: ignore[arg-type]


def first_guess(loop: RobotLoop, record: Record) -> dict[str, float]:
    """Return least squares in the band that the references move in, made possible.

    Noise of the encoders, differentiated twice, biases least squares with the cut-off's fifth
    power; a first guess needs no more of the motion than what carries its acceleration. The
    filters of the rest come from it, for the inertia of the drives is in no model of a robot.
    Stated starting values count instead.
    """
    kept = _GUESSES.setdefault(record, {})
    if id(loop) not in kept:
        kept[id(loop)] = (loop, _guess(loop, record))
    return dict(kept[id(loop)][1])


def _guess(loop: RobotLoop, record: Record) -> dict[str, float]:
    loop._check(record)
    pipelines = band_pipelines(loop, record)
    motion = pipelines.differentiate(record.q, record.dt)
    force = pipelines.align(loop.force(record))
    t = record.t - record.t[0]
    columns, held = loop.regressor(motion, force, t), loop.held_force(motion, force, t)
    force = force - held - (0.0 if record.load is None else record.load)
    rows = pipelines.rows(np.concatenate([columns, force.T[:, :, np.newaxis]], 2), motion.dq)
    X, y = rows[:, :-1], rows[:, -1]
    theta = solve_iv(X, y, names=loop.names)
    return loop.possible(loop.values(theta) | dict(loop.start), record, lambda: X)


def band_pipelines(loop: RobotLoop, record: Record) -> Pipelines:
    """Return pipelines that keep a few times the band in which each joint moves."""
    moved = record.q if record.q_ref is None else record.q_ref
    highest = _FASTEST * record.sampling_hz
    found = []
    rows = max(record.stretches, key=lambda s: s.stop - s.start)
    for x, axis in zip(moved.T, loop.axes, strict=True):
        band = min(_BAND * band_hz(x[rows], record.dt), highest)
        speed = np.abs(np.gradient(x[rows], record.dt)).max()
        shift = 0.5 + axis.delay / record.dt
        # the rule's natural frequency is a fifth of its cut-off
        found.append(
            Pipeline.from_bandwidth(
                band / 5.0,
                record.sampling_hz,
                force_shift=shift,
                min_speed=WIDE.slow * float(speed),
                blank=True,
                breaks=record.breaks,
            )
        )
    decimation = min(p.decimation for p in found)
    trim = max(p.trim[0] for p in found)
    trim = min(trim, record.longest.n_samples // 10)
    still = tuple(np.flatnonzero(at_rest(record)).tolist())
    common = {"decimation": decimation, "trim": (trim, trim)}
    return Pipelines(tuple(replace(p, **common) for p in found), still)  # type: ignore[arg-type]


def band_hz(q: Array, dt: float) -> float:
    """Return the frequency below which 99 % of the acceleration's power of a motion lies, Hz."""
    ddq = np.diff(q, 2) * np.hanning(len(q) - 2)
    power = np.cumsum(np.abs(np.fft.rfft(ddq)) ** 2)
    return float(np.searchsorted(power, 0.99 * power[-1]) + 1) / (len(ddq) * dt)
