"""What is hidden in an axis: the effects, their sizes, and which of them look alike."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Values = dict[str, float]
Draw = Callable[[np.random.Generator], Values]


def _sign(r: np.random.Generator) -> float:
    return float(r.choice([-1.0, 1.0]))


def _wave(r: np.random.Generator, name: str, size: float) -> Values:
    period, phase = r.uniform(0.0018, 0.01), r.uniform(0.0, 2.0 * np.pi)
    return {f"{name}_a": size, f"{name}_p": period, f"{name}_ph": phase}


def _polynomial(r: np.random.Generator) -> Values:
    return {"quad": r.uniform(250, 1000)} if r.random() < 0.5 else {"cube": r.uniform(2e3, 9e3)}


def _friction_drift(r: np.random.Generator) -> Values:
    key, size = ("fd_c", r.uniform(1.5, 6)) if r.random() < 0.5 else ("fd_v", r.uniform(15, 60))
    return {key: size * _sign(r), "fd_tau": r.uniform(8, 40)}


def _flexibility(r: np.random.Generator) -> Values:
    shape = {"flex_hz": r.uniform(25, 70), "flex_z": r.uniform(0.01, 0.05)}
    return {**shape, "flex_r": r.uniform(0.08, 0.35), "flex_fr": r.uniform(0, 0.5)}


def _backlash(r: np.random.Generator) -> Values:
    shape = {"gap": r.uniform(1e-5, 8e-5), "gap_hz": r.uniform(120, 220), "gap_z": 0.2}
    return {**shape, "flex_r": r.uniform(0.12, 0.35), "flex_fr": r.uniform(0.3, 0.8)}


#: Effect to the draw of its parameters: N, m, s of the unscaled axis; names as in `plant.NAMES`,
#: and `kp`, `kv`, `tap`, `pulse` (relative errors of the settings), `clip` (of the peak command).
EFFECTS: dict[str, Draw] = {
    "asymmetric-viscous": lambda r: {"asym": r.uniform(20, 90) * _sign(r)},
    "stribeck": lambda r: {"str_f": r.uniform(3, 12), "str_v": r.uniform(0.003, 0.02)},
    "presliding": lambda r: {"pre_s": 10 ** r.uniform(5.18, 6.18)},
    "polynomial-viscous": _polynomial,
    "sqrt-viscous": lambda r: {"root": r.uniform(15, 60) * _sign(r)},
    "position-friction": lambda r: {
        "pf_amp": r.uniform(1, 5),
        "pf_len": 0.25,
        "pf_ph": r.uniform(0, 6.28),
    },
    "load-friction": lambda r: {"load": r.uniform(0.015, 0.08)},
    "friction-drift": _friction_drift,
    "offset-drift": lambda r: {"od_a": r.uniform(1.5, 6) * _sign(r), "od_tau": r.uniform(8, 40)},
    "spring": lambda r: {"sp_amp": r.uniform(1, 6), "sp_len": 0.35, "sp_ph": r.uniform(-1.2, 1.2)},
    "cogging": lambda r: {**_wave(r, "cog", r.uniform(0.6, 4)), "cog_2": r.uniform(0, 0.15)},
    "torque-ripple": lambda r: _wave(r, "rip", r.uniform(0.015, 0.08)),
    "flexibility": _flexibility,
    "backlash": _backlash,
    "drive-timing": lambda r: {"delay" if r.random() < 0.5 else "lag": r.uniform(3e-4, 3e-3)},
    "saturation": lambda r: {"clip": r.uniform(0.45, 0.8)},
    "drive-asymmetry": lambda r: {"drv_asym": r.uniform(0.01, 0.05) * _sign(r)},
    "dead-zone": lambda r: {"dead": 35.0 * r.uniform(0.02, 0.1)},
    "encoder-eccentricity": lambda r: _wave(r, "enc", r.uniform(1e-6, 8e-6)),
    "controller-mismatch": lambda r: {
        str(r.choice(["kp", "kv", "tap", "pulse"])): r.uniform(0.01, 0.05) * _sign(r)
    },
}
#: Decided at the controller, so the library cannot do without them.
AT_CONTROLLER = ("saturation", "controller-mismatch")
#: The parameter that makes an effect larger.
SIZE = {
    "asymmetric-viscous": "asym",
    "stribeck": "str_f",
    "position-friction": "pf_amp",
    "load-friction": "load",
    "spring": "sp_amp",
    "cogging": "cog_a",
    "torque-ripple": "rip_a",
    "drive-timing": "lag",
}
#: Pairs that are documented as hard to separate.
TWINS = (
    ("asymmetric-viscous", "spring"),
    ("stribeck", "sqrt-viscous"),
    ("stribeck", "polynomial-viscous"),
    ("sqrt-viscous", "polynomial-viscous"),
    ("presliding", "position-friction"),
    ("load-friction", "dead-zone"),
    ("cogging", "encoder-eccentricity"),
    ("cogging", "torque-ripple"),
    ("torque-ripple", "encoder-eccentricity"),
    ("flexibility", "backlash"),
)


def twins(effect: str) -> set[str]:
    """Return the effects documented as hard to separate from one.

    >>> sorted(twins("cogging"))
    ['encoder-eccentricity', 'torque-ripple']
    """
    return {b if a == effect else a for a, b in TWINS if effect in (a, b)}
