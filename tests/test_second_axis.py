"""A small revolute axis: nothing is tuned to the units of the EMPS.

J = 2e-4 kg m2, a PD loop at 2 kHz, 10,000 counts per turn: inertia, forces and command differ from
those of the EMPS by factors of 10^3 to 10^6.
"""

from dataclasses import replace

import numpy as np
import pytest

from ivtools import IDIMLS, Problem, Record
from ivtools.loop import ClosedLoop, Controller
from ivtools.physics import EFFECTS

THETA = {"inertia": 2e-4, "viscous": 1e-4, "coulomb": 6e-3, "offset": -8e-4}
COUNT = 2.0 * np.pi / 10_000
DT, GAIN = 5e-4, 0.045  # N m/A


def reference(n: int = 16_000) -> Record:
    """Turns to and fro at several speeds, started gently, rad."""
    t = np.arange(n) * DT
    gently = np.clip(t, 0.0, 1.0) ** 3 * (
        10.0 - 15.0 * np.clip(t, 0, 1) + 6.0 * np.clip(t, 0, 1) ** 2
    )
    q_ref = gently * (5.0 * np.sin(2.0 * np.pi * 0.31 * t) + 1.2 * np.sin(2.0 * np.pi * 1.13 * t))
    return Record(t=t, q=q_ref, q_ref=q_ref, nu=np.cos(t))


def axis(**changes: object) -> ClosedLoop:
    # 12 Hz, damping 0.7 for 2e-4 kg m2
    stiffness, damping = 2e-4 * (2.0 * np.pi * 12.0) ** 2, 2.0 * 0.7 * 2e-4 * 2.0 * np.pi * 12.0
    controller = Controller(
        "pd", {"kp": stiffness / GAIN, "kd": damping / GAIN}, (0.5, 0.5), delay=1, limit=8.0
    )
    terms = ("inertia", "viscous", "coulomb", "offset")
    return ClosedLoop(controller, GAIN, terms, name="wrist", joint="revolute", **changes)


@pytest.fixture(scope="module")
def record() -> Record:
    base, rng = reference(), np.random.default_rng(11)
    noise = rng.normal(0.0, 2e-4, base.n_samples)  # N m
    made = axis().simulate(base, THETA, initial="rest", quantum=COUNT, force_noise=noise)
    return made.to_record("wrist", dict(THETA), q_ref=base.q_ref)


def test_the_pipeline_suits_the_axis(record):
    pipeline = axis().pipeline(record)  # no inertia is given: it is guessed from the record
    assert pipeline.cutoff_hz == 100.0  # 5 times 18 Hz to one digit: 12 Hz, and the derivative part
    assert pipeline.decimation >= 10
    assert pipeline == axis(start={"inertia": 2e-4}).pipeline(record)


def test_units_are_those_of_a_turning_axis():
    assert axis().units == {
        "inertia": "kg m2",
        "viscous": "N m s/rad",
        "coulomb": "N m",
        "offset": "N m",
    }


def test_least_squares_finds_the_parameters(record):
    fit = IDIMLS().fit(Problem(record, axis()))
    for name in ("inertia", "coulomb", "offset"):
        assert fit.params[name] == pytest.approx(THETA[name], rel=0.05), name
        assert abs(fit.params[name] - THETA[name]) < 5.0 * fit.std_errors[name]
    assert fit.condition_number < 200.0
    assert fit.relative_error < 15.0


def test_instruments_and_simulation_work_at_this_size(record):
    problem = Problem(record, axis())
    Z = problem.instruments(problem.start)
    theta = np.linalg.solve(Z.T @ problem.X, Z.T @ problem.y)
    assert theta[[0, 2, 3]] == pytest.approx(np.array([*THETA.values()])[[0, 2, 3]], rel=0.05)
    simulation = problem.simulate(dict(zip(problem.names, theta, strict=True)))
    errors = simulation.relative_error(record)
    assert errors["position"] < 0.1 and errors["velocity"] < 1.0  # force: the encoder's steps


def test_both_engines_agree():
    import control

    from ivtools.loop.system import initial_state

    short = reference(800)
    loop = axis().with_effect("stribeck", force=2e-3, speed=0.5)
    ours = loop.simulate(short, THETA, initial=(0.0, 0.0))
    state = initial_state(loop, loop.values(THETA), DT, 0.0, 0.0)
    q_ref = short.q_ref[:, 0]
    inputs = np.array([q_ref, np.gradient(q_ref, DT), np.zeros(800)])
    theirs = control.input_output_response(
        loop.system(THETA, dt=DT), np.arange(800) * DT, inputs, state
    )
    assert ours.nu[:, 0] == pytest.approx(theirs.outputs[2], rel=1e-9, abs=1e-12)


def test_the_controller_is_found(record):
    loop, report = replace(axis(), controller=Controller("identify", {})).identify_controller(
        record
    )
    truth = axis().controller
    assert (loop.controller.kind, loop.controller.delay) == ("pd", 1)
    assert loop.controller.settings == pytest.approx(truth.settings, rel=1e-6)
    assert report.residual < 1e-4


@pytest.mark.filterwarnings("ignore:.*is it in m or rad")
def test_a_change_of_units_changes_nothing_else(record):
    """In degrees and mN m the same axis gives the same answer: no tolerance has a unit."""
    deg, milli = 180.0 / np.pi, 1e3
    scaled = record.replace(q=record.q * deg, q_ref=record.q_ref * deg)
    loop = axis()
    gains = {key: value / deg for key, value in loop.controller.settings.items()}
    other = replace(loop, gain=GAIN * milli, controller=replace(loop.controller, settings=gains))
    ours, theirs = IDIMLS().fit(Problem(record, loop)), IDIMLS().fit(Problem(scaled, other))
    ratio = {"inertia": milli / deg, "viscous": milli / deg, "coulomb": milli, "offset": milli}
    for name, factor in ratio.items():
        assert theirs.params[name] == pytest.approx(factor * ours.params[name], rel=1e-6)
    one = loop.simulate(record, THETA)
    two = other.simulate(scaled, {k: v * ratio[k] for k, v in THETA.items()})
    assert two.nu == pytest.approx(one.nu, rel=1e-8, abs=1e-11)


@pytest.mark.parametrize("effect", EFFECTS)
def test_effects_act_at_this_size(effect, record):
    from ivtools.estimators.sensitivities import natural, scales

    loop, term = axis(), EFFECTS[effect]
    sizes = scales(Problem(record, loop))
    values = {
        p.name: 0.1 * sizes[p.scale] if p.linear else natural(p, sizes) for p in term.parameters
    }
    moved = loop.with_effect(effect, **values).simulate(record, THETA)
    assert moved.finite and np.isfinite(moved.nu).all()
