"""What is drawn: axes, controllers, motions, and what is hidden in the axis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ..motions import KINDS
from ..motions import draw as motion
from .plant import STEPS, Plant, run

DT, SECONDS = 1e-3, 16.0
RATES = (200.0, 400.0, 1000.0, 2000.0)  # Hz
QUIET = 0.1  # times the noise of the others: 0.3 % of the dry friction
SENSED = 0.01  # noise of a velocity sensor, by the command that it makes, of the dry friction
Draw = Callable[[np.random.Generator, "Axis"], dict[str, Any]]


@dataclass(frozen=True)
class Axis:
    """An axis before anything is hidden: the plant, its size, and its controller."""

    plant: Plant
    length: float  # of the 0.25 m of the motions
    force: float  # natural size, N or N m
    gain: float
    kp: float
    kv: float
    noise: float
    quantum: float
    dt: float = DT
    sensed: float | None = None  # noise of a velocity sensor, where the axis has one


class Noise(NamedTuple):
    """What a run has of noise, (n,) each: of the force, and of the velocity where it is sensed."""

    force: np.ndarray
    speed: np.ndarray | None = None


@dataclass(frozen=True)
class Case:
    """Two records, an axis file's tables, and the label."""

    tables: dict[str, Any]
    records: list[dict[str, np.ndarray]]
    label: dict[str, Any]


def axis(rng: np.random.Generator) -> Axis:
    """Draw an axis; half are revolute."""
    joint = str(rng.choice(["prismatic", "revolute"]))
    length = 10.0 ** rng.uniform(-0.5, 0.7) if joint == "prismatic" else rng.uniform(3.0, 20.0)
    inertia = 10.0 ** rng.uniform(-1.0, 2.0) if joint == "prismatic" else 10 ** rng.uniform(-3, 0)
    force = inertia * length * rng.uniform(0.15, 0.35)  # as dry friction
    speed = 0.15 * length
    plant = Plant(joint, inertia, 0.8 * force / speed, force, 0.15 * force * rng.uniform(-1, 1))
    gain = 10.0 ** rng.uniform(-1.0, 1.5)
    outer, inner = rng.uniform(25.0, 60.0), rng.uniform(90.0, 200.0)
    return Axis(
        plant, length, force, gain, outer, inner * inertia / gain, 0.03 * force, 2e-7 * length
    )


def quiet(rng: np.random.Generator, a: Axis) -> Axis:
    """Return an axis with hardly any noise, at another rate, as fast as that allows."""
    dt = 1.0 / float(rng.choice(RATES))
    slower = min(1.0, 0.25 * a.plant.inertia / (a.kv * a.gain * dt))
    gains = {"kp": slower * a.kp, "kv": slower * a.kv}
    return replace(a, dt=dt, noise=QUIET * a.noise, **gains)


def sensed(rng: np.random.Generator, a: Axis) -> Axis:
    """Return an axis whose law takes the velocity of a sensor, which is in the log."""
    a = quiet(rng, a)
    return replace(a, sensed=SENSED * a.force / (a.kv * a.gain))


def _wave(rng: np.random.Generator, a: Axis) -> tuple[float, float]:
    return 2.0 * np.pi / (rng.uniform(0.003, 0.01) * a.length), rng.uniform(0.0, 6.28)


def _cogging(rng: np.random.Generator, a: Axis) -> dict[str, Any]:
    (k, p), size = _wave(rng, a), rng.uniform(0.08, 0.25) * a.force
    return {"force": lambda q, v, t, tau: size * np.cos(k * q + p)}


def _ripple(rng: np.random.Generator, a: Axis) -> dict[str, Any]:
    (k, p), size = _wave(rng, a), rng.uniform(0.04, 0.1)
    return {"force": lambda q, v, t, tau: -tau * size * np.cos(k * q + p)}


def _force(make: Callable[[np.random.Generator, Axis], Callable[..., float]]) -> Draw:
    return lambda rng, a: {"force": make(rng, a)}


def _speed(a: Axis) -> float:
    return 0.15 * a.length


def _asymmetric(rng: np.random.Generator, a: Axis) -> Callable[..., float]:
    c = rng.choice([-1, 1]) * rng.uniform(0.15, 0.35) * a.force / _speed(a)
    return lambda q, v, t, tau: c * abs(v)


def _stribeck(rng: np.random.Generator, a: Axis) -> Callable[..., float]:
    f, vs = rng.uniform(0.25, 0.6) * a.force, rng.uniform(0.04, 0.12) * _speed(a)
    return lambda q, v, t, tau: f * np.exp(-((v / vs) ** 2)) * np.tanh(v / (0.002 * _speed(a)))


def _quadratic(rng: np.random.Generator, a: Axis) -> Callable[..., float]:
    c = rng.uniform(0.4, 1.0) * a.force / _speed(a) ** 2
    return lambda q, v, t, tau: c * v * abs(v)


def _root(rng: np.random.Generator, a: Axis) -> Callable[..., float]:
    c = rng.uniform(0.4, 0.8) * a.force / _speed(a) ** 0.5
    return lambda q, v, t, tau: c * abs(v) ** 0.5 * np.sign(v)


def _position(rng: np.random.Generator, a: Axis) -> Callable[..., float]:
    f, k = rng.uniform(0.15, 0.35) * a.force, 4.0 / a.length
    p = rng.uniform(0.0, 6.28)
    return lambda q, v, t, tau: f * np.sin(k * q * 2.0 + p) * np.tanh(v / (0.002 * _speed(a)))


def _drifts(rng: np.random.Generator, a: Axis) -> Callable[..., float]:
    f = rng.uniform(0.2, 0.4) * a.force
    return lambda q, v, t, tau: f * (t / SECONDS) * np.tanh(v / (0.002 * _speed(a)))


def _offset(rng: np.random.Generator, a: Axis) -> Callable[..., float]:
    f = rng.uniform(0.2, 0.4) * a.force
    return lambda q, v, t, tau: f * (t / SECONDS)


def _load_friction(rng: np.random.Generator, a: Axis) -> Callable[..., float]:
    mu = rng.uniform(0.05, 0.12)
    return lambda q, v, t, tau: mu * abs(tau) * np.tanh(v / (0.002 * _speed(a)))


def _bristle(rng: np.random.Generator, a: Axis) -> dict[str, Any]:
    """LuGre's bristle in place of the dry friction, slightly to well damped."""
    stiffness = a.force / (10.0 ** rng.uniform(-4.0, -2.7) * 0.25 * a.length)
    damping = 2.0 * rng.uniform(0.02, 0.6) * np.sqrt(stiffness * a.plant.inertia)
    z, h, most = [0.0], a.dt / STEPS, a.force / stiffness

    def force(q: float, v: float, t: float, tau: float) -> float:
        before, end = z[0], most * np.sign(v)
        z[0] = end + (before - end) * np.exp(-abs(v) * h / most)
        return float(stiffness * z[0] + damping * (z[0] - before) / h)

    return {"force": force, "coulomb": 0.0}


def _flexible(rng: np.random.Generator, a: Axis) -> dict[str, Any]:
    hz, damping = rng.uniform(25, 70), rng.uniform(0.01, 0.05)
    return {"load": {"share": rng.uniform(0.1, 0.35), "hz": hz, "damping": damping}}


def _backlash(rng: np.random.Generator, a: Axis) -> dict[str, Any]:
    load = {"share": rng.uniform(0.15, 0.4), "hz": rng.uniform(100, 400)}
    gap = rng.uniform(4e-5, 3e-4) * a.length
    return {"load": {**load, "damping": rng.uniform(0.1, 1.0), "gap": gap}}


def _timing(rng: np.random.Generator, a: Axis) -> dict[str, Any]:
    return {str(rng.choice(["delay", "lag"])): rng.uniform(5e-4, 3e-3)}


def _dead(rng: np.random.Generator, a: Axis) -> dict[str, Any]:
    d = rng.uniform(0.08, 0.25) * a.force
    return {"drive": lambda tau: tau - min(max(tau, -d), d)}


def _unequal(rng: np.random.Generator, a: Axis) -> dict[str, Any]:
    g = rng.choice([-1, 1]) * rng.uniform(0.02, 0.06)
    return {"drive": lambda tau: tau * (1.0 + g * np.sign(tau))}


#: Label to what it changes in the plant.
EFFECTS: dict[str, Draw] = {
    "asymmetric-viscous": _force(_asymmetric),
    "stribeck": _force(_stribeck),
    "polynomial-viscous": _force(_quadratic),
    "sqrt-viscous": _force(_root),
    "position-friction": _force(_position),
    "load-friction": _force(_load_friction),
    "friction-drift": _force(_drifts),
    "offset-drift": _force(_offset),
    "spring": lambda r, a: {"stiffness": r.uniform(0.8, 2.5) * a.force / (0.25 * a.length)},
    "cogging": _cogging,
    "torque-ripple": _ripple,
    "presliding": _bristle,
    "flexibility": _flexible,
    "backlash": _backlash,
    "drive-timing": _timing,
    "dead-zone": _dead,
    "drive-asymmetry": _unequal,
    "regularised-coulomb": lambda r, a: {"dry": False},
    "inner-saturation": lambda r, a: {"cut": r.uniform(0.6, 0.85)},
    "gravity": lambda r, a: {"arm": r.uniform(0.3, 1.0) * a.force / 9.81},
    "controller-mismatch": lambda r, a: {"wrong": float(r.choice([-1, 1]) * r.uniform(0.02, 0.06))},
}


def _smooth(rng: np.random.Generator, a: Axis) -> dict[str, Any]:
    """A random smooth function of position and velocity."""
    W = rng.normal(size=(8, 2)) * np.array([3.0 / (0.25 * a.length), 2.0 / _speed(a)])
    p, c = rng.uniform(0, 6.28, 8), rng.normal(size=8) * rng.uniform(0.05, 0.2) * a.force
    return {"force": lambda q, v, t, tau: float(c @ np.cos(W[:, 0] * q + W[:, 1] * v + p))}


def _periodic_friction(rng: np.random.Generator, a: Axis) -> dict[str, Any]:
    (k, p), size = _wave(rng, a), rng.uniform(0.1, 0.3) * a.force
    return {
        "force": lambda q, v, t, tau: size * np.cos(k * q + p) * np.tanh(v / (0.002 * _speed(a)))
    }


def _warming(rng: np.random.Generator, a: Axis) -> dict[str, Any]:
    """Friction that falls with the work done, and comes back."""
    heat, size, h = [0.0], rng.uniform(0.3, 0.6), a.dt / STEPS

    def force(q: float, v: float, t: float, tau: float) -> float:
        heat[0] += h * (abs(v) / _speed(a) - 0.3 * heat[0])
        return -size * a.force * np.tanh(heat[0]) * np.tanh(v / (0.002 * _speed(a)))

    return {"force": force}


def _creep(rng: np.random.Generator, a: Axis) -> dict[str, Any]:
    """A force that relaxes after every move: a seal, a belt."""
    state, rate, size = [0.0], rng.uniform(0.5, 3.0), rng.uniform(0.5, 2.0) * a.force / a.length
    h = a.dt / STEPS

    def force(q: float, v: float, t: float, tau: float) -> float:
        state[0] += h * (v - rate * state[0])
        return 10.0 * size * state[0]

    return {"force": force}


def _gain(rng: np.random.Generator, a: Axis) -> dict[str, Any]:
    k, size = rng.uniform(2.0, 5.0) / (0.25 * a.length), rng.uniform(0.05, 0.15)
    return {"force": lambda q, v, t, tau: -tau * size * np.sin(k * q) * np.cos(v / _speed(a))}


def _beside(rng: np.random.Generator, a: Axis) -> dict[str, Any]:
    """The reaction of a second axis that goes to and fro on its own, in step with the start."""
    w, p = 2.0 * np.pi / rng.uniform(0.8, 4.0), rng.uniform(0.0, 6.28)
    size = rng.uniform(0.08, 0.25) * a.force
    return {"force": lambda q, v, t, tau: float(size * np.sin(w * t + p))}


#: Backgrounds that no effect of the library is.
UNKNOWN: dict[str, Draw] = {
    "smooth": _smooth,
    "smooth-2": _smooth,
    "periodic-friction": _periodic_friction,
    "warming": _warming,
    "creep": _creep,
    "pendulum": lambda r, a: {"pendulum": r.uniform(0.1, 0.4)},
    "gain": _gain,
    "second-axis": _beside,
}
#: Settings that differ between the records, as factors of the second one's.
CHANGED: dict[str, tuple[str, tuple[float, float]]] = {
    "payload": ("inertia", (1.12, 1.3)),
    "friction": ("coulomb", (0.65, 0.85)),
}


def draw(suite: str, name: str, seed: int) -> Case:
    """Draw a case: ``suite`` is effects, none, unknown, changed, or quiet or sensed, of all."""
    rng = np.random.default_rng([seed, *f"{suite}/{name}".encode()])
    a = axis(rng)
    if name in ("pendulum",) and a.plant.joint == "revolute":
        a = replace(a, plant=replace(a.plant, joint="prismatic"))
    if name in ("gravity",) and a.plant.joint == "prismatic":
        a = replace(a, plant=replace(a.plant, joint="revolute"))
    if suite in KINDS_OF_AXES:
        a, suite = KINDS_OF_AXES[suite](rng, a), _suite_of(name)
    source = {"effects": EFFECTS, "unknown": UNKNOWN}.get(suite, {})
    values = source[name](rng, a) if name in source else {}
    wrong, cut = values.pop("wrong", 0.0), values.pop("cut", None)
    plants = [replace(a.plant, **values)] * 2
    if suite == "changed":
        key, (low, high) = CHANGED[name]
        plants[1] = replace(plants[1], **{key: rng.uniform(low, high) * getattr(a.plant, key)})
    n, kind = round(SECONDS / a.dt), str(rng.choice(KINDS))
    fine, t = np.arange(round(SECONDS / DT)) * DT, np.arange(n) * a.dt
    refs = [np.interp(t, fine, motion(rng, kind, len(fine))) * a.length for _ in (0, 1)]
    noises = [Noise(a.noise * rng.normal(size=n)) for _ in refs]
    if a.sensed is not None:
        noises = [x._replace(speed=a.sensed * rng.normal(size=n)) for x in noises]
    if cut is not None:  # a drive has one limit, so both motions ask for about as much
        peaks = [_peak(a, plants[0], r, x) for r, x in zip(refs, noises, strict=True)]
        refs[1] = refs[1] * peaks[0] / peaks[1]
        limit = cut * min(peaks[0], _peak(a, plants[0], refs[1], noises[1]))
        plants = [replace(p, drive=lambda tau: min(max(tau, -limit), limit)) for p in plants]
    runs = zip(plants, refs, noises, strict=True)
    records = [_record(a, p, r, x, wrong) for p, r, x in runs]
    p = a.plant
    velocity = "differences" if a.sensed is None else "logged"
    tables = {
        "axis": {"name": "withheld", "joint": p.joint},
        "controller": {
            "kind": "cascade-pd",
            "kp": a.kp,
            "kv": a.kv,
            "limit": 1e9,
            "velocity": velocity,
        },
        "drive": {"gain": a.gain},
        "model": {"terms": ["inertia", "viscous", "coulomb", "offset"]},
    }
    truth = [name] if suite == "effects" else []
    return Case(tables, records, {"suite": suite, "name": name, "effects": truth})


#: Suites of all names, on axes of another kind.
KINDS_OF_AXES = {"quiet": quiet, "sensed": sensed}


def _suite_of(name: str) -> str:
    """Return the suite that a name belongs to."""
    suites = {"effects": EFFECTS, "unknown": UNKNOWN, "changed": CHANGED}
    return next((suite for suite, names in suites.items() if name in names), "none")


def _peak(a: Axis, plant: Plant, ref: np.ndarray, noise: Noise) -> float:
    """Return the largest force that a motion asks for, but for single samples."""
    return float(np.quantile(np.abs(a.gain * _play(a, plant, ref, noise, 0.0)["nu"]), 0.9995))


def _record(
    a: Axis, plant: Plant, ref: np.ndarray, noise: Noise, wrong: float
) -> dict[str, np.ndarray]:
    """Return the log of one run."""
    log = _play(a, plant, ref, noise, wrong)
    return {"t": a.dt * np.arange(len(ref)), "q_ref": ref, **log}


def _play(
    a: Axis, plant: Plant, ref: np.ndarray, noise: Noise, wrong: float
) -> dict[str, np.ndarray]:
    """Run the plant under its cascade, whose inner gain is `wrong`; return what a log has."""
    read, speeds, last = np.empty(len(ref)), np.empty(len(ref)), [float(ref[0])]
    kv = a.kv * (1.0 + wrong)

    def command(k: int, q: float, v: float) -> float:
        read[k] = a.quantum * round(q / a.quantum)
        differs, last[0] = (read[k] - last[0]) / a.dt, read[k]
        speeds[k] = differs if noise.speed is None else v + noise.speed[k]
        return kv * (a.kp * (ref[k] - read[k]) - speeds[k])

    _, nu = run(plant, command, float(ref[0]), len(ref), a.dt, a.gain, noise.force)
    return {"q": read, "nu": nu} | ({} if noise.speed is None else {"dq": speeds})
