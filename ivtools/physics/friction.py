"""Friction: what opposes the motion where surfaces meet."""

from __future__ import annotations

import numpy as np

from ..compiled import compiled
from .terms import Parameter, Term

_JANOT = "Janot, Gautier, Brunot, Data Set and Reference Models of EMPS, 2019"
_ARMSTRONG = "Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994"

VISCOUS = Term(
    "viscous",
    "mechanics",
    (Parameter("viscous", "{F} s/{L}", lower=0.0),),
    "Fv dq",
    f"{_JANOT}, equation 1",
    law=lambda q, dq, ddq, sign, tau, t, fv: fv * dq,
    base=True,
)

COULOMB = Term(
    "coulomb",
    "mechanics",
    (Parameter("coulomb", "{F}", lower=0.0),),
    "Fc sign(dq)",
    f"{_JANOT}, equation 1",
    law=lambda q, dq, ddq, sign, tau, t, fc: fc * sign,
    base=True,
)


def _asymmetric(q, dq, ddq, sign, tau, t, fv_pos, fc_pos, fv_neg, fc_neg):
    ahead, back = 0.5 * (1.0 + sign), 0.5 * (1.0 - sign)
    return (ahead * fv_pos + back * fv_neg) * dq + (ahead * fc_pos + back * fc_neg) * sign


ASYMMETRIC_FRICTION = Term(
    "asymmetric-friction",
    "mechanics",
    (
        Parameter("viscous_pos", "{F} s/{L}", lower=0.0),
        Parameter("coulomb_pos", "{F}", lower=0.0),
        Parameter("viscous_neg", "{F} s/{L}", lower=0.0),
        Parameter("coulomb_neg", "{F}", lower=0.0),
    ),
    "Fv+ dq + Fc+ where dq > 0, Fv- dq - Fc- where dq < 0",
    f"{_JANOT}, equation 12",
    law=_asymmetric,
    base=True,
    slot="asymmetry",
)

ASYMMETRIC_VISCOUS = Term(
    "asymmetric-viscous",
    "mechanics",
    (Parameter("delta", "{F} s/{L}"),),
    "dFv |dq|",
    f"{_JANOT}, equation 12, as its odd part",
    law=lambda q, dq, ddq, sign, tau, t, delta: delta * np.abs(dq),
    slot="asymmetry",
)


def _stribeck(q, dq, ddq, sign, tau, t, fs, vs, n):
    ratio = np.abs(dq / vs)
    return fs * np.exp(-(ratio * ratio if n == 2.0 else ratio**n)) * sign  # a power takes longest


STRIBECK = Term(
    "stribeck",
    "mechanics",
    (
        Parameter("force", "{F}", lower=0.0),
        Parameter(
            "speed",
            "{L}/s",
            lower=1e-9,
            neutral=0.01,
            scale="speed",
            scan=(0.02, 0.05, 0.1, 0.2),
        ),
        Parameter(
            "exponent",
            "1",
            lower=0.1,
            neutral=2.0,
            scale="one",
            scan=(2.0, 1.0),
            nuisance=True,
        ),
    ),
    "Fs exp(-(dq/vs)^2) sign(dq); exponent: another power of |dq/vs|, 1 is Tustin's",
    _ARMSTRONG,
    law=_stribeck,
    everywhere=True,
)

POLYNOMIAL_VISCOUS = Term(
    "polynomial-viscous",
    "mechanics",
    (Parameter("quadratic", "{F} s2/{L}2"), Parameter("cubic", "{F} s3/{L}3")),
    "F2 dq |dq| + F3 dq^3",
    "Bittencourt, Axelsson, IEEE/ASME Trans. Mechatronics 19(5), 2014",
    law=lambda q, dq, ddq, sign, tau, t, f2, f3: (f2 * np.abs(dq) + f3 * dq * dq) * dq,
    everywhere=True,
)

SQRT_VISCOUS = Term(
    "sqrt-viscous",
    "mechanics",
    (Parameter("force", "{F} s0.5/{L}0.5"),),
    "Fh sqrt|dq| sign(dq)",
    "Harnoy, Friedland, Cohn, IEEE Control Systems 28(6), 2008: hydrodynamic lubrication",
    law=lambda q, dq, ddq, sign, tau, t, fh: fh * np.sqrt(np.abs(dq)) * sign,
    everywhere=True,
)

_SHIPPED = 0.9  # share of the net force that MuJoCo's friction takes up
_RATES = np.geomspace(25.0, 400.0, 5)  # 1/s, at which it stops an axis: 105 as shipped

REGULARISED_COULOMB = Term(
    "regularised-coulomb",
    "mechanics",
    (
        Parameter("force", "{F}", lower=0.0),
        Parameter(
            "speed",
            "{L}/s",
            lower=1e-9,
            neutral=0.01,
            scale="speed",
            scan=(0.02, 0.06, 0.2),
            most=0.4,  # beyond, it is a curve of the viscous friction
        ),
        Parameter(
            "hold",
            "1/{F}",
            lower=0.0,
            scale="per force",
            scan=(0.0, 0.8, 1.6, 3.2),
        ),
    ),
    "F clip(dq/v + h net, -1, 1) instead of a part of Fc sign(dq), net: drive force less all other "
    "forces; it creeps where dry friction sticks; F h: share of the net force that it takes up "
    "before it slides, 0.9 to 0.95 in MuJoCo as it ships",
    "E. Todorov, IEEE Int. Conf. Robotics and Automation, 2014: friction of a common simulator",
    law=lambda q, dq, ddq, sign, tau, t, f, v, h: (
        f * np.minimum(np.maximum(dq / v + h * tau, -1.0), 1.0)
    ),
    everywhere=True,
    net=True,
    instead=lambda coulomb, inertia: np.column_stack(
        np.broadcast_arrays(coulomb, coulomb / (_SHIPPED * inertia * _RATES), _SHIPPED / coulomb)
    ),
)

POSITION_FRICTION = Term(
    "position-friction",
    "mechanics",
    (Parameter("slope", "{F}/{L}"), Parameter("curvature", "{F}/{L}2")),
    "(c1 q + c2 q^2) sign(dq); the constant part is the Coulomb friction",
    f"{_ARMSTRONG}, section 2.2",
    law=lambda q, dq, ddq, sign, tau, t, c1, c2: (c1 + c2 * q) * q * sign,
)

LOAD_FRICTION = Term(
    "load-friction",
    "mechanics",
    (Parameter("ratio", "1", lower=0.0, scale="one"),),
    "mu |tau| sign(dq)",
    "Gogoussis, Donath, IEEE Int. Conf. Robotics and Automation, 1988",
    law=lambda q, dq, ddq, sign, tau, t, mu: mu * np.abs(tau) * sign,
)

FRICTION_DRIFT = Term(
    "friction-drift",
    "mechanics",
    (
        Parameter("coulomb_rate", "{F}/s"),
        Parameter("coulomb_curvature", "{F}/s2"),
        Parameter("viscous_rate", "{F}/{L}"),
        Parameter("viscous_curvature", "{F}/({L} s)"),
    ),
    "(a t + c t^2) sign(dq) + (b t + d t^2) dq",
    "Bittencourt, Gunnarsson, ASME J. Dynamic Systems, Measurement and Control 134(5), 2012",
    law=lambda q, dq, ddq, sign, tau, t, a, c, b, d: t * ((a + c * t) * sign + (b + d * t) * dq),
)

PRESLIDING = Term(
    "presliding",
    "mechanics",
    (
        Parameter(
            "stiffness",
            "{F}/{L}",
            lower=0.0,
            neutral=np.inf,
            scale="stiffness",
            scan=(0.02, 0.2, 1.0, 3.0, 10.0),
        ),
        Parameter(
            "damping", "{F} s/{L}", lower=0.0, neutral=0.0, scale="damping", scan=(0.0, 20.0)
        ),
    ),
    "dz = dq - s0 |dq| z / Fc, f = s0 z + s1 dz in place of Fc sign(dq)",
    "Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Trans. Automatic Control 40(3), 1995",
    everywhere=True,
)


@compiled
def bristle_rate(z: float, v: float, level: float, s0: float) -> float:
    """Return the rate of the mean bristle deflection, m/s; `level` is the Coulomb force, N."""
    return v - s0 * abs(v) * z / level if level > 0.0 else 0.0


@compiled
def bristle_deflection(z: float, path: float, level: float, s0: float) -> float:
    """Return the deflection after a path (m, signed) without reversal, m.

    The exact solution of `bristle_rate`, which knows no time: the deflection decays over the
    distance level/s0 to its final value, whatever the speed.
    """
    if not level > 0.0:
        return z
    final = np.sign(path) * level / s0
    return final + (z - final) * np.exp(-s0 * abs(path) / level)


TERMS = (
    VISCOUS,
    COULOMB,
    ASYMMETRIC_FRICTION,
    ASYMMETRIC_VISCOUS,
    STRIBECK,
    PRESLIDING,
    POLYNOMIAL_VISCOUS,
    SQRT_VISCOUS,
    REGULARISED_COULOMB,
    POSITION_FRICTION,
    LOAD_FRICTION,
    FRICTION_DRIFT,
)
