"""A population of axes: units over eight decades, every controller, rate, motion and noise.

    case = draw(np.random.default_rng(1))
    record = case.record(seed=0)

A case is drawn in ratios that make sense of an axis (samples per period of the loop, friction over
force of acceleration, counts over the stroke), and then given an inertia and a length.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ivtools.loop import ClosedLoop, Controller
from ivtools.study import BangBang, Case, Multisine, Trapezoids

from .controllers import p_pi, state_feedback

LAWS = ("pd", "cascade-pd", "p-velocity", "p-pi", "pi-velocity", "state-feedback")
MOTIONS = ("bang-bang", "multisine", "trapezoids")
NOISES = ("white", "coloured", "force", "none")
RATES = (250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0, 10000.0)  # Hz
LONGEST = 40_000  # samples


@dataclass(frozen=True)
class Axis:
    """What an axis is made of, SI."""

    law: str
    joint: str
    inertia: float
    viscous: float
    coulomb: float
    offset: float
    gain: float
    hz: float  # natural frequency of the loop
    rate: float  # Hz
    late: float  # delay of the drive, samples
    delay: int  # of the controller, samples
    count: float  # resolution of the encoder


def draw(rng: np.random.Generator, law=None, motion=None, noise=None, stiction=None) -> Case:
    """Draw a case; what is given is not drawn."""
    law, motion, noise = (
        given or str(rng.choice(kinds))
        for given, kinds in ((law, LAWS), (motion, MOTIONS), (noise, NOISES))
    )
    stiction = bool(rng.random() < 0.2) if stiction is None else stiction
    rate = float(rng.choice(RATES))
    slowest = max(3.0, 60.0 * rate / LONGEST)
    hz = 10.0 ** rng.uniform(np.log10(slowest), np.log10(max(min(60.0, rate / 40.0), slowest)))
    revolute = bool(rng.random() < 0.5)
    inertia = 10.0 ** (rng.uniform(-5.0, 0.0) if revolute else rng.uniform(-1.0, 3.0))
    stroke = rng.uniform(2.0, 20.0) if revolute else 10.0 ** rng.uniform(-2.0, 0.0)
    reference, speed, acceleration = _motion(rng, motion, stroke, hz, rate)
    push = inertia * acceleration
    coulomb = push * (rng.uniform(1.0, 2.0) if stiction else rng.uniform(0.1, 0.6))
    axis = Axis(
        law=law,
        joint="revolute" if revolute else "prismatic",
        inertia=inertia,
        viscous=push * rng.uniform(0.1, 0.6) / speed,
        coulomb=coulomb,
        offset=coulomb * rng.uniform(0.1, 0.4) * float(rng.choice([-1.0, 1.0])),
        gain=10.0 ** rng.uniform(-2.0, 2.0),
        hz=hz,
        rate=rate,
        late=float(rng.choice([0.0, rng.uniform(0.1, 1.5)])),
        delay=int(rng.integers(0, 2)),
        count=2.0 * np.pi / 2.0 ** rng.uniform(11.0, 20.0) * (1.0 if revolute else stroke / 10.0),
    )
    theta = {k: getattr(axis, k) for k in ("inertia", "viscous", "coulomb", "offset")}
    return Case(
        f"{law} {motion} {noise}{' stiction' if stiction else ''}",
        loop(axis),
        theta,
        reference,
        rate,
        **_noise(rng, noise, push, axis.count),
    )


def _motion(rng, kind, stroke, hz, rate):
    """Return a reference, its top speed and its acceleration; the loop can follow each move."""
    duration = min(rng.uniform(60.0, 150.0) / hz, LONGEST / rate)
    strokes = tuple(stroke * share for share in (1.0, 0.6, 0.35, 0.2, 0.1))
    if kind == "multisine":
        top = hz / rng.uniform(4.0, 12.0)
        multisine = Multisine(duration, 0.5 * stroke, 0.1 * top, top, 12, 1.0 / top)
        t = np.arange(0.0, duration, 1.0 / rate)
        dq = np.gradient(multisine.position(t), 1.0 / rate)
        return multisine, float(abs(dq).max()), float(2.0 * np.gradient(dq, 1.0 / rate).std())
    if kind == "bang-bang":
        acceleration = stroke * (18.0 / duration) ** 2
        peak = float(np.sqrt(stroke * acceleration))
        return BangBang(duration, strokes, acceleration), peak, acceleration
    resting = rng.choice([0.0, rng.uniform(0.1, 0.4)])  # share of the record
    speed = 16.0 * stroke / ((1.0 - resting) * duration)
    speeds = tuple(speed * share for share in (1.0, 0.7, 0.4, 0.2, 0.1))
    acceleration = speed * hz / rng.uniform(2.0, 6.0)
    pause = float(0.1 * resting * duration)
    return Trapezoids(duration, strokes, speeds, acceleration, pause), speed, acceleration


def _noise(rng, kind, push, count):
    encoder = {"encoder_noise": rng.uniform(0.2, 1.0) * count, "quantum": count}
    force = {"force_noise": push * 10.0 ** rng.uniform(-2.0, -0.7)}
    return {
        "white": encoder | force,
        "coloured": encoder | force | {"force_noise_pole": rng.uniform(0.7, 0.98)},
        "force": force,
        "none": {},
    }[kind]


def loop(axis: Axis, **changes: object) -> ClosedLoop:
    """Return the closed loop of an axis."""
    made = ClosedLoop(
        controller(axis),
        axis.gain,
        ("inertia", "viscous", "coulomb", "offset"),
        name=axis.law,
        joint=axis.joint,
        delay=axis.late / axis.rate,
    )
    return replace(made, **changes) if changes else made


def controller(axis: Axis) -> Controller:
    """Return a controller whose loop has about the natural frequency asked for."""
    w, unit, dt = 2.0 * np.pi * axis.hz, axis.inertia / axis.gain, 1.0 / axis.rate
    common = {"delay": axis.delay}
    if axis.law == "pd":
        settings = {"kp": unit * w**2, "kd": 1.6 * unit * w}
        return Controller("pd", settings, (0.5, 0.5), **common)
    if axis.law == "cascade-pd":
        return Controller("cascade-pd", {"kp": 0.7 * w, "kv": 1.4 * unit * w}, **common)
    if axis.law == "p-velocity":
        return Controller("p-velocity", {"kv": unit * w}, (0.5, 0.5), **common)
    if axis.law == "p-pi":
        return p_pi(0.5 * w, unit * w, 0.2 * w, dt, **common)
    if axis.law == "pi-velocity":
        return p_pi(0.0, unit * w, 0.3 * w, dt, **common)
    return state_feedback(axis.inertia, axis.viscous, axis.gain, axis.hz, dt, **common)


def population(n: int, seed: int = 0, **given: object) -> list[Case]:
    """Return n cases that no other seed has."""
    seeds = np.random.SeedSequence([20131, seed]).spawn(n)
    cases = [draw(np.random.default_rng(s), **given) for s in seeds]
    return [replace(case, name=f"{i} {case.name}") for i, case in enumerate(cases)]
