"""Random axes, and what their owner would write down about them.

An axis is drawn near the EMPS in its ratios (speeds, frequencies, forces in N), where the ranges of
the effects are known, and scaled to another mass and length only when the record is written.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .plant import INDEX, NAMES, POLE

DT = 0.001  # s
LAWS = (
    "cascade-pd", "pd", "pid", "p-pi", "pi-velocity", "p-velocity", "state-space", "none",
)  # fmt: skip


@dataclass(frozen=True)
class Noise:
    """Noise of an axis before scaling.

    Parameters
    ----------
    force : float
        Random force, N rms.
    hz : float
        Its corner frequency, Hz.
    heavy : bool
        Whether its increments are Student's t with five degrees of freedom instead of normal.
    position : float
        White noise of the encoder, m rms.
    quantum : float
        Step of the encoder, m.
    """

    force: float
    hz: float
    heavy: bool
    position: float
    quantum: float


@dataclass(frozen=True)
class Axis:
    """An axis before scaling: N, m, s and V.

    Parameters
    ----------
    inertia, viscous, coulomb, offset : float
        kg, N/(m/s), N, N.
    law : int
        Index in `LAWS`: 0 for a cascade (kp in 1/s, kv in V/(m/s)), 1 for pd (kp in V/m, kv in
        V/(m/s)).
    taps : tuple of float
        Of the velocity filter.
    delay : int
        Samples from the measured position to the command.
    gain : float
        N/V.
    limit : float
        Of the command before added inputs, V.
    noise : Noise
    mass, length : float
        Factors that scale it.
    ki, weight, ahead : float
        Integral gain (V/(m s) of a pid, else 1/s), weight of the velocity reference, and
        feed-forward of the acceleration, V/(m/s2).
    """

    inertia: float
    viscous: float
    coulomb: float
    offset: float
    law: int
    kp: float
    kv: float
    taps: tuple[float, ...]
    delay: int
    gain: float
    limit: float
    noise: Noise
    mass: float
    length: float
    ki: float = 0.0
    weight: float = 1.0
    ahead: float = 0.0

    def vector(self) -> np.ndarray:
        """Return the parameters of the plant without effects."""
        p = np.zeros(len(NAMES))
        base = {"m": self.inertia, "fv": self.viscous, "fc": self.coulomb, "off": self.offset}
        for name, value in base.items():
            p[INDEX[name]] = value
        return p

    def tables(self) -> dict[str, dict[str, object]]:
        """Return the axis as its owner knows it: the tables of an axis file, scaled."""
        kind, scale = LAWS[self.law], 1.0 / self.length
        outer = self.kp * scale if kind in ("pd", "pid") else self.kp
        inner = "kd" if kind in ("pd", "pid") else "kv"
        controller: dict[str, object] = {
            "kind": kind,
            **({} if kind.endswith("velocity") else {"kp": outer}),
            inner: self.kv * scale,
            "velocity_filter": list(self.taps),
            "delay": self.delay,
            "limit": self.limit,
        }
        if kind in ("pid", "p-pi", "pi-velocity"):
            controller["ki"] = self.ki * (scale if kind == "pid" else 1.0)
        if kind == "none":  # whatever it is, its owner knows the command alone
            controller = {"kind": kind}
        if kind == "state-space":
            steep = self.kv * scale * (1.0 - POLE) / DT
            D = self.kp * scale + steep
            controller = {
                "kind": kind,
                "A": [[POLE]],
                "B": [[1.0, -1.0]],
                "C": [[-steep * (1.0 - POLE)]],
                "D": [[D, -D]],
                "delay": self.delay,
                "limit": self.limit,
            }
        if self.weight != 1.0:
            controller["c"] = self.weight
        if self.ahead:
            controller["feedforward"] = {"acceleration": self.ahead * scale}
        joint = "revolute" if self.inertia * self.mass < 0.05 else "prismatic"
        return {
            "axis": {"name": "withheld", "joint": joint},
            "controller": controller,
            "drive": {"gain": self.gain * self.mass * self.length},
            "model": {"terms": ["inertia", "viscous", "coulomb", "offset"]},
        }


def draw(rng: np.random.Generator) -> Axis:
    """Draw an axis: 1e-4 kg m2 to 200 kg, two laws, loops from 10 to 16 Hz, no limit yet."""
    inertia, gain = 95.0 * rng.uniform(0.6, 1.5), 35.0 * rng.uniform(0.5, 2.0)
    law, inner = int(rng.random() < 0.3), rng.uniform(60.0, 100.0)
    kv = inner * inertia / gain
    outer = inner * (rng.uniform(0.5, 1.2) if law == 0 else rng.uniform(0.25, 0.45))
    target = 10.0 ** rng.uniform(-4.0, np.log10(200.0))
    revolute = target < 0.05
    return Axis(
        inertia=inertia,
        viscous=200.0 * rng.uniform(0.6, 1.5),
        coulomb=20.0 * rng.uniform(0.5, 1.5),
        offset=rng.uniform(-4.0, 4.0),
        law=law,
        kp=outer if law == 0 else outer * kv,
        kv=kv,
        taps=(0.5, 0.5) if rng.random() < 0.5 else (1.0,),
        delay=int(rng.random() < 0.5),
        gain=gain,
        limit=np.inf,
        noise=_noise(rng),
        mass=target / inertia,
        length=10.0 ** (rng.uniform(0.5, 2.0) if revolute else rng.uniform(-0.5, 0.8)),
    )


def controlled(rng: np.random.Generator, axis: Axis, kind: str) -> Axis:
    """Return an axis under another kind of controller with much the same bandwidth."""
    law, inner = LAWS.index(kind), rng.uniform(60.0, 100.0)
    kv = inner * axis.inertia / axis.gain
    outer, slow = inner * rng.uniform(0.25, 0.45), inner * rng.uniform(0.05, 0.2)
    kp = {1: outer * kv, 2: (outer + slow) * kv, 4: 0.0, 5: 0.0, 6: outer * kv}.get(law, outer)
    return replace(
        axis,
        law=law,
        kp=kp,
        kv=kv,
        ki=outer * slow * kv if kind == "pid" else slow,
        weight=float(rng.choice([1.0, 0.0, 0.8])) if kind in ("pid", "p-pi") else 1.0,
        ahead=(law < 6) * float(rng.choice([0.0, 0.0, 0.7])) * axis.inertia / axis.gain,
    )


def _noise(rng: np.random.Generator) -> Noise:
    return Noise(
        force=rng.uniform(0.3, 1.2),
        hz=rng.uniform(15.0, 80.0),
        heavy=bool(rng.random() < 0.3),
        position=rng.uniform(0.5e-8, 3e-8),
        quantum=float(rng.choice([2e-8, 5e-8, 1e-7])),
    )
