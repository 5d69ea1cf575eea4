"""Every kind of controller, and all that surrounds a law, in both engines."""

from dataclasses import replace

import control
import numpy as np
import pytest
from scipy import signal

from benchmarks import populations
from ivtools import IDIMLS, Problem
from ivtools.errors import AxisError, RecordError
from ivtools.gap import parity
from ivtools.loop import ClosedLoop, Controller
from ivtools.loop.controllers import Seen
from ivtools.loop.system import initial_state


def python_control(loop, theta, record):
    """The same simulation by python-control, from rest at 0."""
    system = loop.system(theta, dt=record.dt)
    command = np.zeros((record.n_samples, 1))
    seen = Seen.of(loop.controller, record, command, loop.joint).inputs
    added = np.zeros(record.n_samples) if record.added is None else record.added[:, 0]
    inputs = [seen[:, 0], seen[:, 1], added, *([seen[:, 2]] if system.ninputs == 4 else [])]
    state = initial_state(loop, loop.values(theta), record.dt, 0.0, 0.0)
    times = np.arange(record.n_samples) * record.dt
    return control.input_output_response(system, times, np.array(inputs), state)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", populations.KINDS)
def test_both_engines_are_the_same(kind, seed):
    rng = np.random.default_rng([seed, len(kind), ord(kind[-1])])
    joint = ("prismatic", "revolute")[seed % 2]
    loop, theta, stroke = populations.axis(rng, joint)
    hz = 10 ** rng.uniform(2.0, 3.9)
    record = populations.reference(rng, 300, hz, stroke, {"strain": rng.normal(size=300)})
    force = theta["coulomb"]
    plain = populations.controller(rng, kind, theta["inertia"], hz)
    law = populations.surrounded(rng, plain, hz)
    law = replace(
        law,
        feedforward={
            "acceleration": 0.5 * theta["inertia"],
            "coulomb": 0.3 * force,
            "gravity": 0.1 * force,
        },
        feedback={"strain": 0.05 * force},
    )
    loop = replace(loop, controller=populations.scaled(law, loop.gain))
    whole = loop.simulate(record, theta, initial=(0.0, 0.0))
    top = 0.6 * float(np.abs(whole.nu).max())  # so that the limit and its anti-windup act
    for limit in (np.inf, top):
        bound = replace(loop, controller=replace(loop.controller, limit=limit))
        ours = bound.simulate(record, theta, initial=(0.0, 0.0))
        theirs = python_control(bound, theta, record)
        assert np.isfinite(ours.nu).all()
        for name in ("q", "nu"):
            a, b = getattr(ours, name)[:, 0], theirs.outputs[theirs.output_labels.index(name)]
            assert np.max(np.abs(a - b)) <= 1e-9 * np.max(np.abs(b)), (name, limit)


@pytest.mark.parametrize("kind", [k for k in populations.KINDS if k != "state-space"])
def test_the_velocity_of_a_sensor_is_that_of_the_motion_in_both_engines(kind):
    rng = np.random.default_rng([7, len(kind)])
    loop, theta, stroke = populations.axis(rng, "prismatic")
    given = populations.reference(rng, 300, 500.0, stroke)
    given = given.replace(dq=np.gradient(given.q, given.dt, axis=0))  # no past differences make it
    law = replace(populations.controller(rng, kind, theta["inertia"], 500.0), velocity="logged")
    loop = replace(loop, controller=populations.scaled(law, loop.gain))
    assert loop.controller.known(given).velocity == "logged"
    ours = loop.simulate(given, theta, initial=(0.0, 0.0))
    theirs = python_control(loop, theta, given)
    for name in ("q", "nu"):
        a, b = getattr(ours, name)[:, 0], theirs.outputs[theirs.output_labels.index(name)]
        assert np.max(np.abs(a - b)) <= 1e-9 * np.max(np.abs(b)), name
    seen = replace(given, q=ours.q, nu=ours.nu, dq=ours.dq)
    assert parity.check(seen, loop).after < 1e-9


@pytest.mark.parametrize("seed", range(8))
def test_a_sensor_is_told_from_what_a_drive_makes_of_the_position(seed):
    """Noise of either, dry friction whose reversals jump, rates from 200 Hz to 5 kHz."""
    rng = np.random.default_rng([11, seed])
    loop, theta, stroke = populations.axis(rng, ("prismatic", "revolute")[seed % 2])
    hz = 10 ** rng.uniform(2.3, 3.7)
    given = populations.reference(rng, 6000, hz, stroke)
    law = populations.controller(rng, "cascade-pd", theta["inertia"], hz)
    loop = replace(loop, controller=populations.scaled(law, loop.gain))
    sim = loop.simulate(given, theta, initial="rest")
    fine = 10 ** rng.uniform(-7, -5) * stroke
    q = np.round(sim.q[:, 0] / fine) * fine
    made = np.diff(q, prepend=q[0]) * hz
    slow = signal.lfilter([0.3], [1.0, -0.7], made)
    noise = 10 ** rng.uniform(-4, -2) * np.std(sim.dq) * rng.normal(size=len(q))
    for dq, way in (
        (sim.dq[:, 0] + noise, "logged"),
        (made, "differences"),
        (np.convolve(made, [0.5, 0.3, 0.2])[: len(q)], "differences"),
        (slow, "differences"),
    ):
        record = given.replace(q=q, nu=sim.nu, dq=dq)
        known = replace(loop.controller, velocity="logged").known(record)
        assert known.velocity == way


@pytest.mark.parametrize("kind", populations.KINDS)
def test_a_record_is_reproduced_wherever_it_begins(kind):
    """With filter, feed-forwards, a column, limit and anti-windup; the states are not logged."""
    rng = np.random.default_rng([5, len(kind)])
    loop, theta, stroke = populations.axis(rng, "revolute")
    hz, n = float(rng.choice([200, 1000, 4000])), 5000
    strain = np.convolve(rng.normal(size=n), np.ones(9) / 9, mode="same")
    given = populations.reference(rng, n, hz, stroke, {"strain": strain})
    law = populations.surrounded(rng, populations.controller(rng, kind, theta["inertia"], hz), hz)
    fed = {"acceleration": 0.5 * theta["inertia"], "coulomb": 0.3 * theta["coulomb"]}
    law = replace(law, feedforward=fed, feedback={"strain": 0.1 * theta["coulomb"]})
    loop = replace(loop, controller=populations.scaled(law, loop.gain))
    free = loop.simulate(given, theta, initial="rest")
    limit = 0.7 * float(np.abs(free.nu).max())
    loop = replace(loop, controller=replace(loop.controller, limit=limit))
    made = loop.simulate(given, theta, initial="rest", quantum=1e-6 * stroke)
    record = given.replace(q=made.q, nu=made.nu)
    for part in (record, record.slice(n // 5, n)):
        found = parity.check(part, loop)
        assert found.after < 1e-4 and not found.found
        assert found.delay == loop.controller.delay


def test_all_that_surrounds_a_law_survives_the_way_to_a_file_and_back(tmp_path):
    rng = np.random.default_rng(3)
    loop = populations.axis(rng, "revolute")[0]
    law = replace(
        populations.controller(rng, "p-pi", 1.0, 1000.0),
        velocity="logged",
        filter={"kind": "notch", "hz": 80.0, "damping": 0.3},
        feedforward={"acceleration": 0.5, "plan [N m]": 1.0},
        feedback={"strain": -0.2},
        anti_windup="back-calculation",
        reference_derivative="backward",
        limit=4.0,
    )
    file = tmp_path / "axis.toml"
    file.write_text(replace(loop, controller=law).to_toml())
    again = ClosedLoop.from_file(file).controller
    assert again == replace(law, settings=again.settings)
    assert again.settings == pytest.approx(dict(law.settings))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"filter": {"kind": "lowpass"}}, "filter lacks 'hz'"),
        ({"filter": {"kind": "comb", "hz": 3.0}}, "'comb' is not known; it is lowpass or notch"),
        ({"filter": {"kind": "notch", "hz": 3.0}}, "a notch filter needs its damping"),
        ({"filter": {"hz": 3.0, "q": 1}}, "filter does not know 'q'"),
        ({"velocity": "guessed"}, "velocity is 'guessed'; it is 'differences' or 'logged'"),
        ({"anti_windup": "maybe"}, "anti_windup is 'maybe'"),
        ({"reference_derivative": "ahead"}, "reference_derivative is 'ahead'"),
        ({"feedforward": {"velocity": np.nan}}, "feedforward.velocity = nan is not a finite"),
        ({"feedback": 3.0}, "feedback is 3.0; give gains by name"),
    ],
)
def test_what_surrounds_a_law_is_checked(changes, message):
    with pytest.raises(AxisError, match=message):
        Controller("p-velocity", {"kv": 1.0}, **changes)


def test_what_a_law_needs_and_a_record_lacks_is_said():
    rng = np.random.default_rng(1)
    loop, theta, stroke = populations.axis(rng, "revolute")
    record = populations.reference(rng, 300, 500.0, stroke)
    law = populations.controller(rng, "p-velocity", 1.0, 500.0)
    for changes, message in (
        ({"velocity": "logged"}, 'dq is missing; velocity = "logged"'),
        ({"feedback": {"strain": 1.0}}, "column 'strain', which the controller sees, is not in"),
    ):
        bound = replace(loop, controller=replace(law, **changes))
        with pytest.raises(RecordError, match=message):
            parity.check(record, bound)
    with pytest.raises(RecordError, match="dq_ref is missing, and q_ref too"):
        replace(loop, controller=law).simulate(record.replace(q_ref=None), theta)


def test_an_axis_without_controller_is_identified_from_its_command():
    rng = np.random.default_rng(2)
    loop, theta, stroke = populations.axis(rng, "revolute")
    given = populations.reference(rng, 8000, 500.0, stroke)
    law = populations.scaled(
        populations.controller(rng, "p-pi", theta["inertia"], 500.0), loop.gain
    )
    made = replace(loop, controller=law).simulate(given, theta, initial="rest")
    fit = IDIMLS().fit(Problem(given.replace(q=made.q, nu=made.nu, q_ref=None), loop))
    assert fit.params["inertia"] == pytest.approx(theta["inertia"], rel=0.01)
    assert fit.params["coulomb"] == pytest.approx(theta["coulomb"], rel=0.03)
