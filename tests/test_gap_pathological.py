"""Records that can be read and make no sense: every one gets an answer or one clear line."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import ivtools as iv
from ivtools.errors import IVToolsError
from ivtools.gap import VERDICTS
from ivtools.loop import Controller

QUICK, CASES = 20, 100  # in the quick tests, and in all
MODELS = (
    ("inertia", "viscous", "coulomb", "offset"),
    ("inertia", "coulomb"),
    ("inertia", "asymmetric-friction", "offset"),
)
MASS = 95.0  # kg or kg m2
THETA = {"inertia": MASS, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
EFFECTS = (
    {},
    {"stribeck": {"force": 15.0, "speed": 0.01}},
    {"cogging": {"cosine": 6.0, "sine": 2.0, "period": 0.004}},
    {"presliding": {"stiffness": 4e5}},
    {"backlash": {"gap": 1e-4, "load_share": 0.3}},
    {"flexibility": {"frequency_hz": 12.0, "load_share": 0.4}},
    {"drive-timing": {"delay": 0.02}},
)


def case(seed):
    """Return a record, a loop, and a hold-out or None."""
    rng = np.random.default_rng([seed, 7])
    dt = float(rng.choice([5e-4, 1e-3, 1e-3, 4e-3, 0.016]))
    loop = replace(
        iv.axes.emps().with_terms(*MODELS[rng.integers(3)]),
        controller=law(rng, dt),
        joint=str(rng.choice(["prismatic", "revolute"])),
    )
    records = [readable(rng, loop, dt, f"case {seed}.{k}") for k in range(2)]
    given = Controller("identify", {}) if rng.random() < 0.15 else loop.controller
    return records[0], replace(loop, controller=given), None if rng.random() < 0.4 else records[1]


def law(rng, dt):
    """Return a control law that is stable at a sampling step."""
    outer, inner = rng.uniform(0.03, 0.12) / dt, rng.uniform(0.1, 0.3) / dt * MASS / 35.0
    limit = float(rng.choice([np.inf, np.inf, np.inf, 20.0]))
    kind = rng.choice(["cascade-pd", "cascade-pd", "pd", "p-velocity"])
    if kind == "pd":
        return Controller("pd", {"kp": outer * inner, "kd": inner}, limit=limit)
    if kind == "p-velocity":
        return Controller("p-velocity", {"kv": inner}, limit=limit)
    return Controller("cascade-pd", {"kp": outer, "kv": inner}, limit=limit)


def readable(rng, loop, dt, name):
    """Return a record that breaks no rule of records."""
    while True:
        try:
            return record(rng, loop, dt, name)
        except IVToolsError:
            continue


def record(rng, loop, dt, name):
    """Return a record: a motion, an axis that follows it somehow, and what went wrong."""
    t = dt * np.arange(int(rng.choice([220, 2000, 6000, 9000])))
    given = {"q_ref": motion(rng, t)}
    if rng.random() < 0.3:
        given["added"] = float(rng.choice([0.01, 1.0])) * np.sign(np.sin(40.0 * t))
    if rng.random() < 0.1:
        given["dq_ref"] = np.gradient(given["q_ref"], dt) * float(rng.choice([1.0, 0.0, -1.0]))
    given["q"], given["nu"] = followed(rng, loop, given, t)
    if rng.random() < 0.25:
        spoil(rng, given)
    return iv.Record(t, name=name, **given)


def motion(rng, t):
    """Return a reference, (n,): sines, steps, ramps one way, a walk, or hardly anything."""
    size, hz = 10.0 ** rng.uniform(-3, 0), 10.0 ** rng.uniform(-1, 0.5)
    return (
        size
        * (
            np.sin(2 * np.pi * hz * t),
            np.sin(2 * np.pi * hz * t) + 0.3 * np.sin(7.1 * hz * t),
            np.sign(np.sin(2 * np.pi * hz * t)),
            t / t[-1],
            np.cumsum(rng.normal(size=len(t))) / np.sqrt(len(t)),
            np.where(t > 0.5 * t[-1], t - 0.5 * t[-1], 0.0),
            np.clip(np.sin(2 * np.pi * hz * t), -0.1, 0.1),
        )[int(rng.integers(2 if rng.random() < 0.6 else 7))]
    )


def followed(rng, loop, given, t):
    """Return position and command: simulated with an effect, the reference itself, or noise."""
    noise, q_ref = rng.normal(size=len(t)), given["q_ref"]
    if rng.random() < 0.95:
        full, theta = loop, {n: THETA.get(n, 20.0) for n in loop.names}
        for effect, values in EFFECTS[rng.integers(len(EFFECTS))].items():
            full = full.with_effect(effect, **values)
        template = iv.Record(t, q=q_ref, nu=noise, **given)
        sim = full.simulate(
            template,
            full.values(theta),
            force_noise=float(rng.choice([0.01, 1.0, 1.0, 300.0])) * noise,
            quantum=float(rng.choice([0.0, 1e-6, 1e-5, 1e-3])),
        )
        return sim.q[:, 0], sim.nu[:, 0]
    size = float(np.ptp(q_ref))
    q = (q_ref + 1e-3 * size * noise, np.roll(q_ref, 3), 1e-12 * noise)[rng.integers(3)]
    return q, 10.0 ** rng.uniform(-6, 6) * (noise, q_ref - q + 1e-9 * noise)[rng.integers(2)]


def spoil(rng, given):
    """Change a signal: quantised, clipped, one absurd sample, constant for long, late."""
    key = str(rng.choice([k for k in given]))
    x = np.array(given[key], dtype=float)
    at, span = int(rng.integers(1, len(x))), float(np.ptp(x)) or 1.0
    held = np.where(np.arange(len(x)) < at, x, x[at])
    absurd = np.where(np.arange(len(x)) == at, 10.0 ** rng.uniform(0, 300), x)
    changed = (
        0.2 * span * np.round(x / (0.2 * span)),
        np.clip(x, -0.3 * span, 0.3 * span),
        absurd,
        held,
        np.roll(x, 3),
    )
    given[key] = changed[rng.integers(5)]


def cases():
    """Return the seeds; most of them are slow tests."""
    return [s if s < QUICK else pytest.param(s, marks=pytest.mark.slow) for s in range(CASES)]


@pytest.mark.parametrize("seed", cases())
def test_it_is_answered_or_refused_in_one_line(seed):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        given = case(seed)
        try:
            found = iv.diagnose(*given)
            assert found.verdict in VERDICTS and found.to_dict() and found.summary()
        except IVToolsError as error:
            assert str(error) and "\n" not in str(error)
