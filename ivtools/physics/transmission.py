"""Transmission: masses, and the forces that depend on where they are."""

from __future__ import annotations

import numpy as np

from ..compiled import compiled
from .terms import Parameter, Term
from .waves import wave

_JANOT = "Janot, Gautier, Brunot, Data Set and Reference Models of EMPS, 2019, equation 1"
_SHARES = (0.1, 0.2, 0.35)
_A_MASS = 0.05  # of the inertia: what is lighter and has the friction on it is friction that yields
_TURN = 2.0 * np.pi

INERTIA = Term(
    "inertia",
    "mechanics",
    (Parameter("inertia", "{M}", lower=0.0),),
    "M ddq",
    _JANOT,
    law=lambda q, dq, ddq, sign, tau, t, m: m * ddq,
    base=True,
)

OFFSET = Term(
    "offset",
    "mechanics",
    (Parameter("offset", "{F}"),),
    "offset",
    _JANOT,
    law=lambda q, dq, ddq, sign, tau, t, offset: offset,
    base=True,
)

GRAVITY = Term(
    "gravity",
    "mechanics",
    (Parameter("sin", "{F}"), Parameter("cos", "{F}")),
    "gs sin(q) + gc cos(q); an eccentric mass m at r, hanging down at q0, has gs = m g r cos(q0), "
    "gc = -m g r sin(q0)",
    "Khalil, Dombre, Modeling, Identification and Control of Robots, 2004, chapter 9",
    law=lambda q, dq, ddq, sign, tau, t, gs, gc: wave(q, gc, gs, _TURN),
    joint="revolute",
)

OFFSET_DRIFT = Term(
    "offset-drift",
    "mechanics",
    (Parameter("rate", "{F}/s"), Parameter("curvature", "{F}/s2")),
    "a t + b t^2",
    "slow change of the offset: amplifier zero, counterbalance, cable",
    law=lambda q, dq, ddq, sign, tau, t, a, b: (a + b * t) * t,
)

SPRING = Term(
    "spring",
    "mechanics",
    (Parameter("stiffness", "{F}/{L}"), Parameter("curvature", "{F}/{L}2")),
    "k1 q + k2 q^2; the constant part is the offset",
    "cable drag, slope, counterbalance: the first terms of a static force over position",
    law=lambda q, dq, ddq, sign, tau, t, k1, k2: (k1 + k2 * q) * q,
)

PERIOD = Parameter(
    "period",
    "{L}",
    lower=1e-9,
    neutral=0.01,
    scale="stroke",
    scan=(0.005, 0.01, 0.02, 0.04, 0.08),
    most=0.5,  # it must come twice
)

COGGING = Term(
    "cogging",
    "mechanics",
    (Parameter("cosine", "{F}"), Parameter("sine", "{F}"), PERIOD),
    "a cos(2 pi q/p) + b sin(2 pi q/p)",
    "Holtz, Springob, IEEE Trans. Industrial Electronics 43(2), 1996",
    law=lambda q, dq, ddq, sign, tau, t, a, b, p: wave(q, a, b, p),
    search="lines",
)

FLEXIBILITY = Term(
    "flexibility",
    "mechanics",
    (
        Parameter(
            "frequency_hz",
            "Hz",
            lower=0.2,
            neutral=50.0,
            scale="one",
            scan=(25.0, 40.0, 65.0),
            wide=(5.0, 300.0),
        ),
        Parameter(
            "damping",
            "1",
            lower=0.0,
            upper=0.5,
            neutral=0.02,
            scale="one",
            scan=(0.03,),
        ),
        Parameter(
            "load_share",
            "1",
            lower=0.01,
            upper=0.98,
            neutral=0.2,
            scale="one",
            scan=_SHARES,
            least=_A_MASS,
        ),
        Parameter(
            "load_friction",
            "1",
            lower=0.0,
            upper=1.0,
            neutral=0.0,
            scale="one",
            scan=(0.0, 0.5),
        ),
    ),
    "two masses M (1 - r), M r joined by k, c: k = (2 pi f)^2 M r (1 - r)",
    "Spong, ASME J. Dynamic Systems, Measurement and Control 109(4), 1987",
    search="valleys",
    everywhere=True,
    sensed=True,
    slot="second mass",
)

BACKLASH = Term(
    "backlash",
    "mechanics",
    (
        Parameter(
            "gap",
            "{L}",
            lower=0.0,
            scale="stroke",
            scan=(2e-5, 1e-4, 4e-4, 2e-3, 5e-3),
            wide=(2e-3, 0.05),
            least=1e-6,  # a smaller one is a contact that never opens: friction that yields
        ),
        Parameter(
            "load_share",
            "1",
            lower=0.01,
            upper=0.98,
            neutral=0.2,
            scale="one",
            scan=(0.05, 0.15, 0.45),
            least=_A_MASS,
        ),
        Parameter(
            "load_friction",
            "1",
            lower=0.0,
            upper=1.0,
            neutral=0.5,
            scale="one",
            scan=(0.0, 0.1, 0.5, 0.9),
        ),
        Parameter(
            "load_offset",
            "1",
            lower=0.0,
            upper=1.0,
            neutral=0.0,
            scale="one",
            scan=(0.0, 1.0),
            nuisance=True,
        ),
        Parameter(
            "contact_hz",
            "Hz",
            lower=10.0,
            neutral=150.0,
            scale="one",
            scan=(100.0, 500.0),
            rigid=0.5,
        ),
        Parameter(
            "damping",
            "1",
            lower=0.0,
            upper=2.0,
            neutral=0.2,
            scale="one",
            scan=(0.2, 0.7),
            nuisance=True,
        ),
    ),
    "two masses M (1 - r), M r that touch when |q1 - q2| > gap/2; an offset of the load (gravity) "
    "preloads the gap, one of the motor (amplifier zero) does not",
    "Nordin, Gutman, Automatica 38(10), 2002",
    search="valleys",
    everywhere=True,
    slot="second mass",
)


@compiled
def push(stretch: float, rate: float, side: float, k: float, c: float, gap: float) -> float:
    """Return the force of a spring and damper between two masses that touch on one side, N.

    `side` is 1 or -1, and 0 if the masses are apart.
    """
    return k * (stretch - 0.5 * side * gap) + c * rate if side != 0.0 else 0.0


@compiled
def contact_margin(
    stretch: float, rate: float, side: float, k: float, c: float, gap: float
) -> float:
    """Return how far a state of contact is from its end, N: negative once it has ended.

    Contacts push and never pull: the damper cannot hold masses together that part. Masses touch
    once they are beyond the gap and the contact would push.
    """
    if gap <= 0.0:
        return np.inf  # joined for good
    if side != 0.0:
        return side * push(stretch, rate, side, k, c, gap)
    side = 1.0 if stretch > 0.0 else -1.0
    beyond = k * (side * stretch - 0.5 * gap)
    return -min(beyond, side * push(stretch, rate, side, k, c, gap))


@compiled
def contact(stretch: float, rate: float, k: float, c: float, gap: float) -> float:
    """Return the side on which two masses touch, 1 or -1; 0 if they are apart."""
    if gap <= 0.0 or contact_margin(stretch, rate, 0.0, k, c, gap) < 0.0:
        return 1.0 if gap <= 0.0 or stretch > 0.0 else -1.0
    return 0.0


TERMS = (INERTIA, OFFSET, OFFSET_DRIFT, SPRING, GRAVITY, COGGING, FLEXIBILITY, BACKLASH)
