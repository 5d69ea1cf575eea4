"""Control laws: their form, their changes, and their identification from a record."""

from dataclasses import replace

import numpy as np
import pytest

from ivtools import IDIMLS, Problem, Record, axes
from ivtools.errors import AxisError, RecordError
from ivtools.loop import ClosedLoop, Controller
from ivtools.loop.controllers import velocity

DT = 1e-3
THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
UNKNOWN = Controller("identify", {})


def moving(n: int = 3000) -> Record:
    """A reference with several speeds."""
    t = np.arange(n) * DT
    q_ref = 0.02 * np.sin(2.0 * np.pi * 0.7 * t) ** 3 + 0.01 * np.sin(2.0 * np.pi * 1.9 * t)
    return Record(t=t, q=q_ref, q_ref=q_ref, nu=np.cos(t))


def simulated(controller: Controller, quantum: float = 1e-6) -> Record:
    """A record of the EMPS under this controller."""
    loop, record = replace(axes.emps(), controller=controller), moving()
    made = loop.simulate(record, THETA, initial="rest", quantum=quantum)
    return made.to_record(q_ref=record.q_ref)


# --- the law ----------------------------------------------------------------------------------


def commanded(law, q_ref, dq_ref, q):
    """The command of a law along a trajectory, (n_samples,), settled at first."""
    inputs = np.column_stack([q_ref, dq_ref, np.zeros(len(q)), q, law.velocity(q)])
    return law.command(inputs, law.settled(inputs[0]))


def test_the_cascade_is_what_it_says():
    rng = np.random.default_rng(0)
    q_ref, q = rng.normal(size=(2, 50))
    law = Controller("cascade-pd", {"kp": 3.0, "kv": 2.0}, (0.5, 0.5)).law(0.1)
    smooth = 0.5 * (q[1:] + q[:-1])
    dq = np.diff(smooth, prepend=np.nan) / 0.1
    expected = 2.0 * (3.0 * (q_ref - q)[1:] - dq)
    assert commanded(law, q_ref, np.zeros(50), q)[2:] == pytest.approx(expected[1:])


@pytest.mark.parametrize(
    ("controller", "expected"),
    [
        (Controller("pd", {"kp": 3.0, "kd": 2.0}), lambda e, de: 3.0 * e + 2.0 * de),
        (Controller("p-velocity", {"kv": 2.0}), lambda e, de: 2.0 * de),
        (
            Controller("state-space", {"A": [], "B": [], "C": [], "D": [[3.0, -3.0]]}),
            lambda e, de: 3.0 * e,
        ),
    ],
)
def test_the_others_are_what_they_say(controller, expected):
    t = np.arange(50) * 0.1
    q_ref, q = np.sin(t), 0.9 * np.sin(t - 0.1)
    dq = np.diff(q, prepend=q[0]) / 0.1
    nu = commanded(controller.law(0.1), q_ref, np.cos(t), q)
    assert nu[1:] == pytest.approx(expected(q_ref - q, np.cos(t) - dq)[1:])


def test_a_state_space_law_follows_its_matrices():
    A, B, C, D = np.array([[0.5]]), np.array([[1.0, -1.0]]), [[2.0]], [[0.3, 0.1]]
    law = Controller("state-space", {"A": A, "B": B, "C": C, "D": D}).law(DT)
    q_ref, q = np.random.default_rng(1).normal(size=(2, 20))
    x, expected = (q_ref[0] - q[0]) / (1.0 - 0.5), []  # settled at the first sample
    for r, y in zip(q_ref, q, strict=True):
        expected.append(2.0 * x + 0.3 * r + 0.1 * y)
        x = 0.5 * x + r - y
    assert commanded(law, q_ref, np.zeros(20), q) == pytest.approx(expected)


def test_scaling_and_mismatch_change_the_output_as_stated():
    controller = Controller("cascade-pd", {"kp": 160.0, "kv": 240.0}, (0.5, 0.5))
    law, twice = controller.law(DT), controller.scaled(2.0).law(DT)
    assert twice.D[3:] == pytest.approx(2.0 * law.D[3:])
    off = controller.with_mismatch(kp=0.1, kv=-0.05, velocity_filter=0.2)
    assert off.settings == pytest.approx({"kp": 176.0, "kv": 228.0})
    assert off.velocity_filter == pytest.approx((0.4, 0.4, 0.2))
    lead = Controller(
        "state-space", {"A": [[0.8]], "B": [[0.2, -0.2]], "C": [[1.0]], "D": [[2, -2]]}
    )
    scaled = lead.scaled(3.0).law(DT)
    assert pytest.approx([6.0, -6.0]) == scaled.D[[0, 3]]


def test_an_unknown_law_says_how_to_find_it():
    with pytest.raises(AxisError, match=r"identify_controller\(record\)"):
        UNKNOWN.law(DT)


# --- identification ---------------------------------------------------------------------------

SAMPLES = [
    Controller("cascade-pd", {"kp": 160.0, "kv": 240.0}, (0.5, 0.5), 1),
    Controller("cascade-pd", {"kp": 120.0, "kv": 200.0}, (1.0,), 0),
    Controller("cascade-pd", {"kp": 90.0, "kv": 260.0}, (0.6, 0.3, 0.1), 2),
    Controller("pd", {"kp": 2e4, "kd": 250.0}, (1.0,), 1),
    Controller("pd", {"kp": 3e4, "kd": 220.0}, (0.7, 0.3), 0),
    Controller("p-velocity", {"kv": 240.0}, (0.5, 0.5), 1),
]


@pytest.mark.parametrize(
    "truth", SAMPLES, ids=lambda c: f"{c.kind}-{len(c.velocity_filter)}-{c.delay}"
)
def test_the_law_of_a_simulated_axis_is_found(truth):
    record = simulated(truth)
    loop, report = replace(axes.emps(), controller=UNKNOWN).identify_controller(record)
    found = loop.controller
    assert (found.kind, found.delay) == (truth.kind, truth.delay)
    assert found.settings == pytest.approx(truth.settings, rel=1e-6)
    assert found.velocity_filter == pytest.approx(truth.velocity_filter, rel=1e-5, abs=1e-6)
    assert report.residual < 1e-4 and report.std_errors.keys() == report.estimates.keys()
    assert found.kind in report.note and found.kind in str(report)


def test_noise_on_the_command_widens_the_standard_errors_and_keeps_the_structure():
    truth = SAMPLES[0]
    clean = simulated(truth)
    noise = np.random.default_rng(3).normal(0.0, 0.02, clean.nu.shape)
    loop, report = axes.emps().identify_controller(clean.replace(nu=clean.nu + noise))
    assert (loop.controller.kind, loop.controller.delay) == ("cascade-pd", 1)
    assert len(loop.controller.velocity_filter) == 2
    for name, value in truth.settings.items():
        assert abs(report.estimates[name] - value) < 4.0 * report.std_errors[name]
        assert report.std_errors[name] > 1e-6 * value


def test_samples_at_the_limit_are_left_out():
    limit = 0.9 * float(np.abs(simulated(SAMPLES[0]).nu).max())
    truth = replace(SAMPLES[0], limit=limit)
    record = simulated(truth)
    clipped = int((np.abs(record.nu) >= limit).sum())
    assert clipped >= 5
    loop, report = replace(axes.emps(), controller=UNKNOWN).identify_controller(record)
    assert report.saturated == clipped and loop.controller.limit == pytest.approx(limit)
    assert loop.controller.settings == pytest.approx(truth.settings, rel=1e-6)


def test_added_inputs_are_not_the_controllers():
    base = moving()
    added = np.where(np.arange(base.n_samples) % 500 > 480, 2.0, 0.0)
    record = base.replace(added=added)
    loop = replace(axes.emps(), controller=SAMPLES[0])
    made = loop.simulate(record, THETA, initial="rest").to_record(q_ref=record.q_ref, added=added)
    found, _ = loop.identify_controller(made)
    assert found.controller.settings == pytest.approx(SAMPLES[0].settings, rel=1e-6)


def test_the_law_of_the_measured_axis_is_found(emps):
    loop, report = replace(axes.emps(), controller=UNKNOWN).identify_controller(emps)
    assert (loop.controller.kind, loop.controller.delay) == ("cascade-pd", 0)
    assert loop.controller.settings["kp"] == pytest.approx(160.18, rel=1e-3)
    assert loop.controller.settings["kv"] == pytest.approx(243.45, rel=1e-3)
    assert loop.controller.velocity_filter == pytest.approx((0.5, 0.5), abs=2e-3)
    assert report.residual < 0.3


def test_identify_is_a_kind_of_controller_everywhere():
    record, truth = simulated(SAMPLES[0]), replace(axes.emps(), controller=SAMPLES[0])
    unknown = replace(axes.emps(), controller=UNKNOWN)
    assert unknown.known(record).controller.kind == "cascade-pd"
    assert unknown.pipeline(record) == truth.pipeline(record)
    ours, theirs = unknown.simulate(record, THETA), truth.simulate(record, THETA)
    assert ours.nu == pytest.approx(theirs.nu, rel=1e-5, abs=1e-6)
    fit = IDIMLS().fit(Problem(record, unknown))
    assert fit.params["inertia"] == pytest.approx(95.0, rel=0.02)
    assert any("controller identified" in note for note in fit.notes)
    assert "controller identified" in " ".join(str(fit.summary()).split())


def test_an_identified_loop_can_be_kept(tmp_path):
    loop, report = axes.emps().identify_controller(simulated(SAMPLES[2]))
    file = tmp_path / "found.toml"
    file.write_text(loop.to_toml())
    assert report.note in file.read_text()
    again = ClosedLoop.from_file(file).controller
    ours, theirs = loop.controller.law(DT), again.law(DT)
    assert theirs.taps == pytest.approx(ours.taps) and pytest.approx(ours.D) == theirs.D


def test_a_command_that_is_no_control_law_is_said_to_be_doubtful():
    record = moving()
    strange = record.replace(nu=np.random.default_rng(5).normal(size=record.n_samples))
    _, report = axes.emps().identify_controller(strange)
    assert report.residual > 50.0 and "with care" in report.note


def test_without_a_reference_the_error_says_so():
    record, unknown = moving().replace(q_ref=None), replace(axes.emps(), controller=UNKNOWN)
    with pytest.raises(RecordError, match="q_ref is missing; a control law is fitted from"):
        Problem(record, unknown)


@pytest.mark.parametrize("steps", [300, 3000, 30_000])
@pytest.mark.parametrize("hz", [500.0, 4000.0])
def test_a_velocity_beside_a_coarse_encoder_is_the_sensors_or_made_of_its_steps(steps, hz):
    """Steps weaken what a regression finds; what is made of positions has their steps."""
    t = np.arange(0.0, 8.0, 1.0 / hz)
    true = np.sin(2.0 * np.pi * 0.4 * t) + 0.3 * np.sin(2.0 * np.pi * 1.1 * t)
    step = np.ptp(true) / steps
    q = step * np.round(true / step)
    noise = 1e-3 * np.random.default_rng(steps).normal(size=len(t))
    assert velocity.shown(q, np.gradient(true, t) + noise, 1.0 / hz) is None
    taps = (0.4, 0.3, 0.2, 0.1)
    made = np.convolve(np.diff(q, prepend=q[0]) * hz, taps)[: len(t)]
    assert np.allclose(velocity.shown(q, made, 1.0 / hz), taps, atol=1e-6)
