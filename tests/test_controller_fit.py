"""Laws read from records: a population of every kind, and what surrounds them."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import signal

from benchmarks import populations
from ivtools.errors import RecordError
from ivtools.gap import parity
from ivtools.loop import Controller
from ivtools.loop.identification import linear
from ivtools.loop.identification.data import Data
from ivtools.loop.identification.forms import Form
from ivtools.loop.identification.polish import Law, jacobian, moved, names_of, values

UNKNOWN = Controller("identify", {})
pytestmark = pytest.mark.filterwarnings("ignore::ivtools.errors.RecordWarning")


def played(seed, kind, extra=None, noise=1e-4, **changes):
    """Return a loop, and a record of it with noise of the encoder, in parts of the stroke."""
    rng = np.random.default_rng([seed, len(kind)])
    loop, theta, stroke = populations.axis(rng, ("prismatic", "revolute")[seed % 2])
    hz = float(rng.choice([100, 250, 1000, 2000, 8000]))
    law = replace(populations.controller(rng, kind, theta["inertia"], hz), **changes)
    loop = replace(loop, controller=populations.scaled(law, loop.gain))
    record = populations.reference(rng, int(min(12 * hz, 16000)), hz, stroke, extra)
    white = noise * stroke * rng.normal(size=record.n_samples)
    made = loop.simulate(record, theta, initial="rest", position_noise=white)
    return loop, theta, record.replace(q=made.q, nu=made.nu)


def gains(controller):
    return {k: v for k, v in controller.full.items() if k in ("kp", "kv", "ki", "kd", "b", "c")}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", [k for k in populations.KINDS if k != "state-space"])
def test_the_law_of_any_kind_is_found(kind, seed):
    loop, _, record = played(seed, kind)
    found = replace(loop, controller=UNKNOWN).identify_controller(record)[1].controller
    assert (found.kind, found.delay) == (kind, loop.controller.delay)
    assert gains(found) == pytest.approx(gains(loop.controller), rel=0.02, abs=1e-9)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", ["pd", "pid", "p-pi"])
def test_a_law_that_derives_its_reference_backward_is_found(kind, seed):
    """Or another one that does the same: a p-pi law has its two gains either way round then."""
    loop, _, record = played(seed, kind, reference_derivative="backward")
    found = replace(loop, controller=UNKNOWN).identify_controller(record)[1].controller
    assert (found.kind, found.delay) == (kind, loop.controller.delay)
    shown = parity.check(record, replace(loop, controller=found), read=False)
    assert shown.before < 1e-7
    takes = loop.controller.full["c"] != 0.0
    assert found.reference_derivative == ("backward" if takes else "central")


@pytest.mark.parametrize("taps", [4, 6])
@pytest.mark.parametrize("kind", ["cascade-pd", "pd", "pid", "p-pi"])
def test_a_velocity_that_is_the_mean_of_several_differences_is_found(kind, taps):
    for seed in range(2):
        loop, _, record = played(seed, kind, velocity_filter=(1.0 / taps,) * taps)
        found = replace(loop, controller=UNKNOWN).identify_controller(record)[1].controller
        assert (found.kind, found.delay) == (kind, loop.controller.delay)
        shown = np.zeros(6)
        shown[: len(found.velocity_filter)] = found.velocity_filter
        assert shown == pytest.approx(np.repeat([1.0 / taps, 0.0], [taps, 6 - taps]), abs=1e-6)


NOISY = [  # seed, kind; 250 Hz to 4 kHz
    (0, "p-pi"), (1, "p-pi"), (0, "cascade-pd"), (1, "cascade-pd"), (0, "pd"), (2, "pd"),
    (0, "pid"), (1, "pid"), (0, "pi-velocity"), (2, "pi-velocity"),
]  # fmt: skip


@pytest.mark.parametrize(("seed", "kind"), NOISY)
def test_noise_of_the_log_that_the_controller_did_not_see_leaves_the_gains(seed, kind):
    """1e-4 of the stroke: differentiated, as large as the velocity itself at 4 kHz."""
    rng = np.random.default_rng([seed, len(kind)])
    loop, theta, stroke = populations.axis(rng, ("prismatic", "revolute")[seed % 2])
    hz = (250.0, 1000.0, 4000.0)[(seed + len(kind)) % 3]
    fast = 3.0 if hz < 500.0 else 1.0
    law = populations.controller(rng, kind, theta["inertia"], hz, fast)
    law = replace(law, settings={k: v for k, v in law.settings.items() if "filter" not in k})
    loop = replace(loop, controller=populations.scaled(law, loop.gain))
    record = populations.reference(rng, int(10 * hz), hz, stroke)
    made = loop.simulate(record, theta, initial="rest")
    noise = 1e-4 * stroke * rng.normal(size=made.q.shape)
    record = record.replace(q=made.q + noise, nu=made.nu)
    report = replace(loop, controller=UNKNOWN).identify_controller(record)[1]
    assert report.noise == pytest.approx(1e-4 * stroke, rel=0.03)
    assert law_of(report.controller) == pytest.approx(law_of(loop.controller), rel=0.02, abs=1e-9)


def law_of(controller):
    """Return the gains on position, velocity and their integral: a cascade is a pd with c = 0."""
    s = controller.full
    if controller.kind == "cascade-pd":
        return {"kp": s["kp"] * s["kv"], "kd": s["kv"], "c": 0.0}
    return gains(controller)


def test_noise_of_the_command_is_not_taken_for_noise_of_the_position():
    loop, _, record = played(1, "cascade-pd", noise=1e-5)
    rng = np.random.default_rng(4)
    rough = 0.03 * float(np.std(record.nu)) * rng.normal(size=record.nu.shape)
    report = replace(loop, controller=UNKNOWN).identify_controller(
        record.replace(nu=record.nu + rough)
    )[1]
    assert report.noise is None
    assert gains(report.controller) == pytest.approx(gains(loop.controller), rel=0.02)


@pytest.mark.parametrize("kind", ["cascade-pd", "p-pi"])
def test_feed_forwards_that_are_not_in_the_log_are_told(kind):
    rng = np.random.default_rng(5)
    loop, theta, record = played(1, kind)
    inertia = 0.7 * theta["inertia"]
    fed = replace(loop.controller, feedforward={"acceleration": inertia / loop.gain})
    fed_loop = replace(loop, controller=fed)
    made = fed_loop.simulate(
        record,
        theta,
        initial="rest",
        position_noise=rng.normal(size=1) * 0 + np.zeros(record.n_samples),
    )
    report = replace(loop, controller=UNKNOWN).identify_controller(
        record.replace(q=made.q, nu=made.nu)
    )[1]
    found = report.controller.feedforward["acceleration"] * loop.gain
    assert found == pytest.approx(inertia, rel=0.02)
    assert any("kg m2 of inertia feed-forward is in the command" in t for t in report.remains)


@pytest.mark.parametrize("share", [0.03, 0.15, 0.5])
@pytest.mark.parametrize("kind", ["pd", "pid", "p-pi", "pi-velocity", "p-velocity"])
def test_a_velocity_that_is_fed_forward_beside_its_whole_reference_is_found(kind, share):
    """Together they are more of it than a weight, which is 1 at most."""
    loop, theta, record = played(2, kind)
    law = loop.controller
    fed = {"velocity": share * law.settings["kd" if "kd" in law.settings else "kv"]}
    law = replace(law, settings={**law.settings, "c": 1.0}, feedforward=fed)
    loop = replace(loop, controller=law)
    made = loop.simulate(record, theta, initial="rest", quantum=1e-5 * np.ptp(record.q))
    record = record.replace(q=made.q, nu=made.nu)
    report = replace(loop, controller=UNKNOWN).identify_controller(record)[1]
    assert 1.0 - report.r2 < 1e-7
    assert report.controller.delay == law.delay


def test_another_feedback_is_found_by_its_column():
    rng = np.random.default_rng(2)
    loop, theta, record = played(2, "cascade-pd")
    n = record.n_samples
    strain = np.convolve(rng.normal(size=n), np.hanning(25), mode="same")
    record = record.replace(extra={"strain": strain})
    gain = 0.3 * float(np.std(record.nu)) / float(np.std(strain))
    bent = replace(loop, controller=replace(loop.controller, feedback={"strain": gain}))
    made = bent.simulate(record, theta, initial="rest")
    report = replace(loop, controller=UNKNOWN).identify_controller(
        record.replace(q=made.q, nu=made.nu)
    )[1]
    assert report.controller.feedback == {"strain": pytest.approx(gain, rel=0.01)}
    assert "another feedback: column strain" in report.note


def test_a_compensation_is_told_by_its_period():
    loop, _, record = played(1, "p-velocity", noise=0.0)
    q = record.q * 20.0 / np.ptp(record.q)  # three turns
    rng = np.random.default_rng(0)
    q_ref = q + 1e-3 * np.cumsum(rng.normal(size=q.shape), axis=0) / 100
    nu = 2.0 * np.gradient(q_ref - q, record.dt, axis=0)
    nu += 0.5 * float(np.std(nu)) * np.sin(72 * q)
    report = replace(loop, gain=1.0, controller=UNKNOWN).identify_controller(
        record.replace(q=q, q_ref=q_ref, nu=nu)
    )[1]
    assert any("periodic in q, 72 per turn: a compensation" in t for t in report.remains)


def test_the_logged_velocity_is_the_controllers():
    loop, theta, record = played(2, "p-velocity")
    smooth = np.convolve(record.q[:, 0], np.ones(9) / 9, mode="same")
    dq = np.gradient(smooth, record.dt)
    dq_ref = np.gradient(record.q_ref[:, 0], record.dt)
    kv = loop.controller.settings["kv"]
    record = record.replace(dq=dq, nu=kv * (dq_ref - dq))
    found = replace(loop, controller=UNKNOWN).identify_controller(record)[1].controller
    assert found.velocity == "logged"
    assert found.settings["kv"] == pytest.approx(kv, rel=1e-6)


@pytest.mark.parametrize("kind", ["cascade-pd", "pid", "pd"])
def test_two_filters_in_a_row_and_one_of_the_reference_are_read_as_matrices(kind):
    """A linear law that is none of the kinds; what it gives is the record's command."""
    loop, theta, record = played(5, kind)
    notch = {"kind": "notch", "hz": 0.1 * record.sampling_hz, "damping": 0.4}
    law = replace(loop.controller, filter=notch, delay=1)
    pole = 0.97
    smooth = signal.lfilter([1.0 - pole], [1.0, -pole], record.q_ref[:, 0])
    seen = record.replace(q_ref=smooth)
    sim = replace(loop, controller=law).simulate(seen, theta, initial="rest")
    logged = record.replace(q=sim.q, nu=sim.nu)
    found = replace(loop, controller=UNKNOWN).identify_controller(logged)[1]
    assert found.controller.kind == "state-space" and found.residual < 0.01
    assert "state-space, " in found.note and " states, delay 0" in found.note
    shown = parity.check(logged, replace(loop, controller=found.controller), read=False)
    assert shown.after < 1e-4


def test_what_drives_the_axis_away_from_its_reference_is_no_law():
    """Though a few past samples explain it: the sign of the command is wrong, or a unit."""
    loop, _, record = played(1, "pd")
    for wrong in (record.replace(nu=-record.nu), record.replace(q_ref=1000.0 * record.q_ref)):
        data = Data.of(loop, wrong, logged=False)
        assert linear.just_logged(data) and linear.state_space(data) is None


def test_no_gain_of_an_error_is_ever_negative():
    for kind in ("cascade-pd", "pd", "p-velocity", "p-pi"):
        loop, _, record = played(1, kind)
        unknown = replace(loop, controller=UNKNOWN)
        try:
            report = unknown.identify_controller(record.replace(nu=-record.nu))[1]
        except RecordError as error:
            assert "came out negative; check the sign" in str(error)
            continue
        found = report.controller.settings
        assert all(found.get(k, 0.0) >= 0.0 for k in ("kp", "kv", "kd", "ki"))
        assert report.residual > 20.0 and "with care" in report.note


def test_velocity_loops_need_no_position_reference():
    loop, theta, record = played(2, "pi-velocity")
    dq_ref = np.gradient(record.q_ref, record.dt, axis=0)
    bare = record.replace(q_ref=None, dq_ref=dq_ref)
    made = loop.simulate(bare, theta)
    assert made.finite
    found = replace(loop, controller=UNKNOWN).identify_controller(bare)[1].controller
    assert found.kind == "pi-velocity"
    assert gains(found) == pytest.approx(gains(loop.controller), rel=0.02)


@pytest.mark.parametrize(
    ("kp", "ki", "clip"),
    [(21.8, 13.6, None), (18.4, 11.5, None), (15.0, 14.0, None), (11.0, 6.9, 0.8)],
)
def test_a_servo_whose_two_gains_are_near_each_other_is_no_pid(kp, ki, clip):
    """At 250 Hz the sampled integral of the velocity reference is ahead by ki dt / 2."""
    rng = np.random.default_rng(3)
    loop, theta, stroke = populations.axis(rng, "revolute")
    law = Controller("p-pi", {"kp": kp, "kv": 60.0 * theta["inertia"] / loop.gain, "ki": ki})
    record = populations.reference(rng, 2500, 250.0, stroke)
    white = 1e-5 * stroke * rng.normal(size=record.n_samples)
    for _ in range(1 if clip is None else 2):  # the second time below a limit
        loop = replace(loop, controller=law)
        made = loop.simulate(record, theta, initial="rest", position_noise=white)
        law = replace(law, limit=(clip or 1.0) * float(np.abs(made.nu).max()))
    record = record.replace(q=made.q, nu=made.nu)
    found = replace(loop, controller=UNKNOWN).identify_controller(record)[1].controller
    assert found.kind == "p-pi"
    assert gains(found) == pytest.approx(gains(law), rel=0.01)


@pytest.mark.parametrize("kind", ["p-pi", "pid", "pi-velocity"])
def test_slopes_are_those_of_a_law_whose_state_is_fitted_anew(kind):
    """Variable projection against difference quotients of all of it."""
    loop, _, record = played(2, kind, noise=0.0)
    law = Law(Data.of(loop, record, logged=False), loop.controller)
    names = tuple(n for n in names_of(loop.controller) if any(values(loop.controller, (n,))))
    J = jacobian(law, loop.controller, names)
    for i, name in enumerate(names):
        step = np.zeros(len(names))
        step[i] = 1e-4 * abs(values(loop.controller, (name,))[0])
        more, less = (law.resids(moved(loop.controller, names, s)) for s in (step, -step))
        slope = (less - more) / (2.0 * step[i])
        assert np.linalg.norm(J[:, i] - slope) < 0.03 * np.linalg.norm(slope), name


def test_a_velocity_filter_that_is_made_of_noise_is_no_law():
    """Weights of a thousand that cancel are a second derivative."""
    data = SimpleNamespace(sign=1.0, logged=False, derivative="central", limit=np.inf,
                           record=SimpleNamespace(extra={}))  # fmt: skip
    columns = ("e", "-dq[0]", "-dq[1]")
    for taps, there in (((0.6, 0.4), True), ((-0.3, 1.3), True), ((-1232.0, 1233.0), False)):
        values = dict(zip(columns, (20.0, *(3.0 * w for w in taps)), strict=True))
        form = Form("cascade-pd", columns, 0, coefficients=values)
        assert (
            bool(form.controllers(Controller("cascade-pd", {"kp": 1.0, "kv": 1.0}), data)) is there
        )
