"""Sensor and controller: what is measured, and what is made of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..compiled import compiled
from .terms import Parameter, Term
from .transmission import PERIOD
from .waves import wave


def _accelerating(q, dt, inertia, period):
    """Return -M d2/dt2 of both waves: the axis follows what the encoder reads."""
    angle = 2.0 * np.pi * q / period
    waves = np.column_stack([np.cos(angle), np.sin(angle)])
    return -inertia * np.gradient(np.gradient(waves, dt, axis=0), dt, axis=0)


ENCODER_ECCENTRICITY = Term(
    "encoder-eccentricity",
    "sensor",
    (
        Parameter("cosine", "{L}", scale="stroke"),
        Parameter("sine", "{L}", scale="stroke"),
        replace(PERIOD, turn=True),
    ),
    "q + a cos(2 pi q/p) + b sin(2 pi q/p)",
    "Kavanagh, IEEE Trans. Industrial Electronics 47(4), 2000",
    search="lines",
    weight=lambda dq, tau: dq**2,
    as_force=_accelerating,
)

CONTROLLER_MISMATCH = Term(
    "controller-mismatch",
    "controller",
    (
        Parameter("kp", "1", lower=-0.9, upper=9.0, scale="one"),
        Parameter("kv", "1", lower=-0.9, upper=9.0, scale="one"),
        Parameter("kd", "1", lower=-0.9, upper=9.0, scale="one"),
        Parameter("ki", "1", lower=-0.9, upper=9.0, scale="one"),
        Parameter("velocity_filter", "1", lower=-1.0, upper=1.0, scale="one"),
        Parameter("added", "1", lower=-2.0, upper=9.0, scale="one"),
    ),
    "each gain (1 + a), one more tap c in the velocity filter, added input (1 + d)",
    "settings that differ from the ones in the axis file",
    search="elsewhere",
)

DISTURBANCE = Term(
    "disturbance",
    "outside",
    (),
    "a force from outside, not repeatable",
    "what no model of the axis explains: reported by time, never fitted",
    search="elsewhere",
)


@compiled
def encoder(q: float, a: float, b: float, period: float) -> float:
    """Return the position that an eccentric encoder reads, m or rad."""
    return q + wave(q, a, b, period)


TERMS = (ENCODER_ECCENTRICITY, CONTROLLER_MISMATCH, DISTURBANCE)
