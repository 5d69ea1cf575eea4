"""Drive: what happens between the command and the force."""

from __future__ import annotations

import numpy as np

from .terms import Parameter, Term
from .transmission import PERIOD
from .waves import wave

TORQUE_RIPPLE = Term(
    "torque-ripple",
    "drive",
    (
        Parameter("cosine", "1", scale="one"),
        Parameter("sine", "1", scale="one"),
        PERIOD,
    ),
    "tau (1 + a cos(2 pi q/p) + b sin(2 pi q/p))",
    "Holtz, Springob, IEEE Trans. Industrial Electronics 43(2), 1996",
    law=lambda q, dq, ddq, sign, tau, t, a, b, p: -tau * wave(q, a, b, p),
    search="lines",
    weight=lambda dq, tau: tau,
)

DRIVE_ASYMMETRY = Term(
    "drive-asymmetry",
    "drive",
    (Parameter("gain", "1", scale="one"),),
    "tau (1 + g sign(tau))",
    "unequal half-bridges of a power amplifier",
    law=lambda q, dq, ddq, sign, tau, t, g: -g * np.abs(tau),
)

DEAD_ZONE = Term(
    "dead-zone",
    "drive",
    (
        Parameter(
            "force",
            "{F}",
            lower=0.0,
            neutral=0.0,
            scale="force",
            scan=(0.01, 0.03, 0.1),
        ),
    ),
    "tau - clip(tau, -d, d)",
    "Tao, Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities, 1996",
    law=lambda q, dq, ddq, sign, tau, t, d: np.minimum(np.maximum(tau, -d), d),
)

INNER_SATURATION = Term(
    "inner-saturation",
    "drive",
    (
        Parameter(
            "force",
            "{F}",
            lower=0.0,
            neutral=1e300,
            scale="peak",
            scan=(0.95, 0.005),
            most=1.0,  # what is never asked for is no limit
        ),
    ),
    "clip(tau, -L, L), behind the recorded command",
    "current limit of the drive",
    law=lambda q, dq, ddq, sign, tau, t, limit: tau - np.minimum(np.maximum(tau, -limit), limit),
    search="valleys",  # a loop without its force is not the linear one: simulated, not linearised
)

_KEPT = 0.1  # of the sampling step: neither a log nor the step of a simulator keeps its time better

DRIVE_TIMING = Term(
    "drive-timing",
    "drive",
    (
        Parameter("delay", "s", lower=0.0, scale="step", scan=(0.5, 1.0, 2.5), least=_KEPT),
        Parameter("lag", "s", lower=0.0, scale="step", scan=(0.5, 1.0, 2.5), least=_KEPT),
    ),
    "tau(t - delay), then lag dtau/dt + tau = command",
    "current loop and bus: Leonhard, Control of Electrical Drives, 2001",
    search="either",
)

SATURATION = Term(
    "saturation",
    "drive",
    (
        Parameter(
            "limit",
            "command",
            lower=0.0,
            neutral=np.inf,
            scale="command",
            scan=(0.9, 0.7, 0.5),
        ),
    ),
    "clip(nu, -limit, limit)",
    "limit of the power amplifier, below the one that the axis file states",
    search="elsewhere",
)

TERMS = (TORQUE_RIPPLE, DRIVE_ASYMMETRY, DEAD_ZONE, INNER_SATURATION, DRIVE_TIMING, SATURATION)
