"""The first guess of an inertia, on axes drawn at random: no force over the position upsets it."""

from dataclasses import dataclass

import numpy as np
import pytest

from ivtools import Problem
from ivtools.errors import AxisError
from ivtools.gap.preflight import doubts
from ivtools.loop import ClosedLoop
from ivtools.loop import rough_inertia as module
from ivtools.loop.controllers import Controller
from ivtools.loop.rough_inertia import rough_inertia, shown_inertia, start_values
from ivtools.record import Record

N_FAST, N_ALL = 12, 200
RATES = [100.0, 125.0, 200.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0]


@dataclass
class Axis:
    """A random axis: the rigid loop, what it does, and its inertia."""

    loop: ClosedLoop
    record: Record
    inertia: float


def _moves(r: np.random.Generator, t: np.ndarray, hz: float) -> np.ndarray:
    """Return moves of minimum jerk between random places within +-0.5, with pauses."""
    q, start, here = np.zeros_like(t), 0.0, 0.0
    while start < t[-1]:
        there, s = r.uniform(-0.5, 0.5), np.clip((t - start) * hz, 0.0, 1.0)
        path = here + (there - here) * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        q, here, start = np.where(t >= start, path, q), there, start + r.uniform(1.3, 2.3) / hz
    return q


def _motion(r: np.random.Generator, t: np.ndarray, hz: float) -> np.ndarray:
    """Return a reference within +-0.5 that moves no faster than hz."""
    kind = r.choice(["sine", "multisine", "moves"])
    if kind == "sine":
        return 0.5 * np.sin(np.pi * hz * t)
    if kind == "moves":
        return _moves(r, t, hz)
    tones, phases = np.linspace(hz / 6.0, hz, 6), r.uniform(0.0, 2.0 * np.pi, 6)
    q = np.sum(np.sin(2.0 * np.pi * tones * t[:, None] + phases) / tones, axis=1)
    return 0.5 * q / np.max(np.abs(q))


def _controller(r: np.random.Generator, stiffness: float, wn: float, dt: float) -> Controller:
    """Return a law of this stiffness and natural frequency: PD, cascade, or PID."""
    kp, kd = stiffness, 2.0 * r.uniform(0.5, 1.2) * stiffness / wn
    kind = r.choice(["pd", "cascade-pd", "pid"])
    if kind == "pd":
        return Controller("pd", {"kp": kp, "kd": kd})
    if kind == "cascade-pd":
        return Controller("cascade-pd", {"kp": kp / kd, "kv": kd})
    ki = 0.25 * wn * kp * dt
    matrices = {"A": [[0, 0], [0, 1]], "B": [[0, 1], [ki, -ki]], "C": [[kd / dt, 1]]}
    return Controller("state-space", {**matrices, "D": [[kp, -kp - kd / dt]]})


def axis(seed: int) -> Axis:
    """Draw an axis of any size whose forces over the position reach 30 times the inertial one."""
    r = np.random.default_rng([123, seed])
    joint, fs = str(r.choice(["prismatic", "revolute"])), float(r.choice(RATES))
    m, gain = 10.0 ** r.uniform(-5.0, 2.5), 10.0 ** r.uniform(-3.0, 3.0)
    stroke = 10.0 ** (r.uniform(-1.0, 1.0) if joint == "revolute" else r.uniform(-3.0, 0.3))
    wn = 2.0 * np.pi * 10.0 ** r.uniform(-0.1, np.log10(min(fs / 25.0, 40.0)))
    hz = wn / (2.0 * np.pi) * 10.0 ** r.uniform(-1.0, -0.3)
    t = np.arange(int(np.clip(8.0 / hz, 6.0, 20.0) * fs)) / fs
    q_ref = stroke * (_motion(r, t, hz) + r.uniform(-1.0, 1.0))
    dq = np.gradient(q_ref, t)
    force = m * np.sqrt(np.mean(np.gradient(dq, t) ** 2))
    friction, large = 10.0 ** r.uniform(-1.5, 0.5, 2) * force, 10.0 ** r.uniform(-0.5, 1.5) * force
    theta = {"inertia": m, "viscous": friction[0] / np.sqrt(np.mean(dq**2)), "coulomb": friction[1]}
    theta["offset"] = force * r.normal()
    law = _controller(r, m * wn * wn / gain, wn, 1.0 / fs)
    loop = real = ClosedLoop(law, gain, tuple(theta), joint=joint, name=f"axis {seed}")
    if joint == "revolute" and r.random() < 0.6:
        angle = r.uniform(0.0, 2.0 * np.pi)
        real = real.with_effect("gravity", sin=large * np.cos(angle), cos=large * np.sin(angle))
    if r.random() < 0.5:
        real = real.with_effect("spring", stiffness=2.0 * large / stroke)
    noise = 10.0 ** r.uniform(-6.0, -4.0) * stroke
    moved = real.simulate(
        Record(t, q_ref, q_ref, nu=np.cos(t)),
        theta,
        initial="rest",
        position_noise=noise * r.standard_normal(len(t)),
        force_noise=0.05 * force * r.standard_normal(len(t)),
    )
    return Axis(loop, Record(t, moved.q, q_ref, nu=moved.nu, name=loop.name), m)


def assert_right(ratios: np.ndarray, share: float) -> None:
    """At least this share lies within 30 %, all within a factor of ten."""
    assert np.mean((ratios > 1.0 / 1.3) & (ratios < 1.3)) >= share
    assert ratios.min() > 0.1 and ratios.max() < 10.0


@pytest.mark.filterwarnings("ignore::ivtools.errors.RecordWarning")
def test_no_force_over_the_position_upsets_the_guess():
    drawn = [axis(seed) for seed in range(N_FAST)]
    assert not any(doubts(a.record, a.loop) for a in drawn)
    assert_right(np.array([rough_inertia(a.loop, a.record) / a.inertia for a in drawn]), 0.9)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ivtools.errors.RecordWarning")
def test_nowhere_in_a_large_population():
    drawn = [axis(seed) for seed in range(N_ALL)]
    assert not any(doubts(a.record, a.loop) for a in drawn)
    assert_right(np.array([rough_inertia(a.loop, a.record) / a.inertia for a in drawn]), 0.97)


@pytest.mark.filterwarnings("ignore::ivtools.errors.RecordWarning")
@pytest.mark.parametrize("seed", range(4))
def test_a_wrong_sign_is_told(seed):
    a = axis(seed)
    turned = a.record.replace(nu=-a.record.nu)
    assert shown_inertia(a.loop, turned)[1].negative
    with pytest.raises(AxisError, match="sign of the command"):
        rough_inertia(a.loop, turned)


@pytest.mark.filterwarnings("ignore::ivtools.errors.RecordWarning")
@pytest.mark.parametrize("size", [0.0, 300.0])
def test_a_compensation_of_gravity_is_no_wrong_sign(size):
    """Though the command is next to nothing but that compensation, and a wrong sign is told."""
    a = next(a for a in map(axis, range(20)) if a.loop.joint == "revolute")
    force = size * np.std(a.record.nu) * np.cos(a.record.q)
    assert doubts(a.record.replace(nu=a.record.nu + force), a.loop) == ()
    assert "opposite sign" in doubts(a.record.replace(nu=force - a.record.nu), a.loop)[0]


def test_it_is_found_once_per_model_and_record(monkeypatch):
    calls, whole = [], module._found
    monkeypatch.setattr(module, "_found", lambda *given: calls.append(given) or whole(*given))
    a = axis(0)
    problem = Problem(a.record, a.loop)
    assert problem.start["inertia"] > 0.0 and len(calls) == 1
    other = ClosedLoop(a.loop.controller, 2.0 * a.loop.gain, a.loop.terms, joint=a.loop.joint)
    assert rough_inertia(other, a.record) > rough_inertia(a.loop, a.record) and len(calls) == 2


@pytest.mark.filterwarnings("ignore::ivtools.errors.RecordWarning")
def test_units_do_not_matter():
    a = next(a for a in map(axis, range(20)) if a.loop.joint == "prismatic")
    scaled = a.record.replace(q=1e3 * a.record.q, q_ref=1e3 * a.record.q_ref, nu=1e-5 * a.record.nu)
    ratio = rough_inertia(a.loop, scaled) / rough_inertia(a.loop, a.record)
    assert ratio == pytest.approx(1e-8, rel=1e-6)


def test_a_problem_starts_from_a_positive_inertia_beside_a_pendulum():
    t = np.arange(5000) * 2e-3
    controller = Controller("pd", {"kp": 60.0, "kd": 6.0})
    loop = ClosedLoop(controller, 1.0, ("inertia", "viscous", "coulomb", "offset"), "p", "revolute")
    theta = {"inertia": 0.1, "viscous": 0.05, "coulomb": 0.05, "offset": 0.0}
    q_ref = 0.4 * np.sin(2.0 * t) + 0.3 * np.sin(3.3 * t)
    record = Record(t, q_ref, q_ref, nu=np.cos(t))
    moved = loop.with_effect("gravity", sin=2.5, cos=0.3).simulate(record, theta)
    problem = Problem(record.replace(q=moved.q, nu=moved.nu), loop)
    assert np.linalg.lstsq(problem.X, problem.y, rcond=None)[0][0] < 0.0  # without the pendulum
    assert problem.start["inertia"] == pytest.approx(0.1, rel=0.05)


def test_what_lies_over_the_position_is_fitted_last():
    r = np.random.default_rng(5)
    moves, places = r.normal(size=(50, 2)), r.normal(size=(50, 3))
    X = np.column_stack([moves, places[:, 0]])
    y = X @ [1.0, 2.0, 3.0] + places[:, 1]
    assert start_values(X, y, places)[:2] == pytest.approx([1.0, 2.0], rel=1e-9)
