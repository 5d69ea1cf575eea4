"""Real machines other than the EMPS: what is known of each, and what must be found."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from conftest import measured

from ivtools import IDIMIV, IDIMLS, Pipeline, Problem, axes, datasets
from ivtools.errors import IVToolsError
from ivtools.gap import Diagnosis, diagnose
from ivtools.gap.preflight import hanging
from ivtools.loop.controllers import Seen
from ivtools.loop.rough_inertia import shown_inertia
from ivtools.record import Record

MOTORS = [f"laas-motor-{i}" for i in (1, 2, 3)]
COGGING = 72  # periods per turn
SWINGS = ["ddp", "direct-collocation", "pd"]


def slow(value):
    """Return a value of a parameter that only the slow tests try."""
    return pytest.param(value, marks=pytest.mark.slow)


FEW_MOTORS = [MOTORS[0], *map(slow, MOTORS[1:])]  # the others are motors of the same make


@pytest.fixture(autouse=True)
def _quiet():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def axis_of(name: str):
    return getattr(axes, datasets.REGISTRY[name].axis.replace("-", "_"))()


def diagnosed(name: str) -> Diagnosis:
    return diagnose(measured(name), axis_of(name))


def said(diagnosis: Diagnosis) -> str:
    """Everything that a diagnosis says, on one line."""
    return " ".join(diagnosis.summary().split())


# --- the brushless motor ------------------------------------------------------------------------


def lines(record: Record) -> np.ndarray:
    """Amplitude of the velocity at 1 ... 200 periods per turn, rad/s: a spectrum over position."""
    q, dq = record.q[:, 0], record.dq[:, 0]
    wave = (dq - dq.mean()) * np.hanning(len(q))
    return np.array([4.0 * abs(np.mean(wave * np.exp(-1j * k * q))) for k in range(1, 201)])


@pytest.mark.parametrize("name", MOTORS)
def test_the_cogging_of_the_motor_is_its_largest_line(name):
    off, on = lines(measured(name)), lines(measured(f"{name}-compensated"))
    assert np.argmax(off) + 1 == COGGING and off[COGGING - 1] > 2.0
    assert on[COGGING - 1] < 0.4 * off[COGGING - 1]


@pytest.mark.parametrize("name", FEW_MOTORS)
def test_the_law_of_the_motor_is_found(name):
    """Its current is proportional to the error of the logged velocity, two samples late.

    Half-way through the first record the loop itself was up to 9 ms late, and caught up: the law is
    the same, but only the samples before repeat to a few per cent.
    """
    record = measured(name)
    law = axis_of(name).identify_controller(record)[0].controller
    on_time = record.slice(0, record.n_samples // 2) if name == MOTORS[0] else record
    report = axis_of(name).identify_controller(on_time)[1]
    assert (law.kind, law.velocity, law.delay) == ("p-velocity", "logged", 2)
    assert 0.06 < law.settings["kv"] < 0.10 and report.residual < 4.0  # %


@pytest.mark.parametrize("name", FEW_MOTORS)
def test_a_compensation_that_is_not_logged_is_told(name):
    found = diagnosed(f"{name}-compensated")
    assert "cogging" not in found.effects
    assert "72 per turn: a compensation" in said(found)


@pytest.mark.slow
@pytest.mark.parametrize("name", MOTORS)
def test_the_cogging_of_the_motor_is_named(name):
    found = diagnosed(name)
    period = found.parameters["cogging"]["period"]
    assert period == pytest.approx(2.0 * np.pi / COGGING, rel=1e-2)
    assert found.shrink.closed > 0.5
    before, after = found.shrink.signals["velocity"]
    assert after < 0.5 * before


# --- the pendulum -------------------------------------------------------------------------------


def swing(name: str, *more: str, cutoff_hz: float = 6.0) -> Problem:
    """A swing-up with gravity in the model, smoothed below what shakes the drive."""
    record = measured(f"dfki-pendulum-{name}")
    loop = axes.dfki_pendulum().with_terms("inertia", "viscous", "coulomb", "offset", *more)
    thin = round(record.sampling_hz / 40.0)
    return Problem(record, loop, Pipeline(cutoff_hz, thin, trim=(30, 30)))


def test_inertia_and_gravity_of_the_pendulum_agree_between_records():
    """All three plans by least squares, the two that the drive follows by instruments."""
    for make, plans in ((IDIMLS, SWINGS), (IDIMIV, SWINGS[:2])):
        fits = [make().fit(swing(name, "gravity")).params for name in plans]
        for name in ("inertia", "gravity.sin"):
            values = np.array([fit[name] for fit in fits])
            assert np.ptp(values) < 0.1 * values.mean()
        for fit in fits:  # it hangs down at 0
            assert abs(fit["gravity.cos"]) < 0.03 * fit["gravity.sin"]


def test_what_can_be_compared_with_the_owners_of_the_pendulum():
    """The drive's torque is half as large again as their model's; the ratio knows no such scale.

    They state 0.546 kg at 0.45 m and 0.105 kg m2, their plans follow 2.42 N m and 0.1115 kg m2.
    """
    stated, planned = 0.546 * 9.81 * 0.45 / 0.105, 2.4204 / 0.1115
    for name in SWINGS:
        fit = IDIMLS().fit(swing(name, "gravity")).params
        ratio = fit["gravity.sin"] / fit["inertia"]  # 1/s2
        assert ratio == pytest.approx(planned, rel=0.12)
        assert ratio == pytest.approx(stated, rel=0.20)


@pytest.mark.parametrize("name", ["pd", "energy-shaping", *map(slow, SWINGS[:2])])
def test_a_pendulum_is_not_told_of_a_wrong_sign(name):
    record, loop = measured(f"dfki-pendulum-{name}"), axes.dfki_pendulum()
    assert not shown_inertia(loop, record)[1].negative
    if record.q_ref is not None:
        problem = Problem(record, loop, Pipeline(6.0, 8, trim=(30, 30)))
        assert problem.start["inertia"] > 0.0


@pytest.mark.parametrize("name", [slow(SWINGS[0]), SWINGS[1]])
def test_gravity_is_named_where_the_model_lacks_it(name):
    found = diagnosed(f"dfki-pendulum-{name}")
    assert found.effects == ("gravity",)
    assert found.parameters["gravity"]["sin"] == pytest.approx(3.6, rel=0.2)  # N m
    assert found.shrink.closed > 0.5 and "the sign" not in said(found)


def test_gravity_is_named_where_no_law_is_known():
    """The drive of one runs on what is not logged, the other follows no reference.

    What the weight makes of the inertia knows no scale of the torque, and agrees between all four.
    """
    known = {name: hanging(measured(f"dfki-pendulum-{name}"), axes.dfki_pendulum())
             for name in [*SWINGS, "energy-shaping"]}  # fmt: skip
    assert all(one is not None for one in known.values())
    inertia = {k: np.sqrt(np.prod(one.inertia)) for k, one in known.items()}
    ratio = np.array([known[k].sin / inertia[k] for k in known])
    assert np.ptp(ratio) < 0.1 * ratio.mean()
    for values in ([known[k].sin for k in SWINGS], [inertia[k] for k in SWINGS]):
        assert np.ptp(values) < 0.1 * np.mean(values)
    for name in ("pd", "energy-shaping"):
        found = diagnosed(f"dfki-pendulum-{name}")
        assert found.effects == ("gravity",) and found.verdict == "partial"
        assert "without a simulation" in said(found)


@pytest.mark.parametrize("name", [*MOTORS, "quanser-flexible-link"])
def test_no_gravity_is_seen_where_none_acts(name):
    assert hanging(measured(name), axis_of(name)) is None


# --- the flexible link --------------------------------------------------------------------------


def explained(record: Record, loop) -> float:
    """R2 of the command by the control law, as the controller saw the record."""
    seen = Seen.of(loop.controller, record, loop.command(record), loop.joint)
    law = loop.controller.law(record.dt)
    left = seen.command - law.command(seen.inputs, law.settled(seen.inputs[0]))
    return 1.0 - float(np.var(left) / np.var(seen.command))


def test_the_link_is_in_its_law_a_second_time():
    record, loop = measured("quanser-flexible-link"), axes.quanser_flexible_link()
    assert explained(record, loop) > 0.995
    without = replace(loop, controller=replace(loop.controller, feedback={}))
    assert explained(record, without) < 0.8


def test_a_law_without_the_deflection_is_not_taken_for_a_fault_of_the_axis():
    record, loop = measured("quanser-flexible-link"), axes.quanser_flexible_link()
    blind = replace(record, extra={})
    without = replace(loop, controller=replace(loop.controller, feedback={}))
    try:
        found = diagnose(blind, without)
    except IVToolsError as error:
        assert "law" in str(error)
        return
    assert not set(found.effects) - {"flexibility", "controller-mismatch"}


def test_the_frequency_and_the_mass_of_the_link_are_found():
    """The owners' J11, J12 and Ks1 make 4.68 Hz between two free masses, 0.728 of it the link.

    Creep of the friction closes as much of the gap by itself: the deflection in the law decides.
    """
    stated = np.sqrt(39.957 * (1.0 / 0.06354 + 1.0 / 0.17043)) / (2.0 * np.pi)
    found = diagnosed("quanser-flexible-link")
    assert found.effects == ("flexibility",)
    assert "polynomial-viscous" in found.ambiguous_with["flexibility"]
    link = found.parameters["flexibility"]
    assert link["frequency_hz"] == pytest.approx(stated, rel=0.15)
    assert link["load_share"] == pytest.approx(0.17043 / (0.06354 + 0.17043), rel=0.10)
    assert found.shrink.after < 0.75 * found.shrink.before


def test_a_column_that_the_law_is_not_said_to_have_is_named():
    record, loop = measured("quanser-flexible-link"), axes.quanser_flexible_link()
    found = diagnose(record, replace(loop, controller=replace(loop.controller, feedback={})))
    assert "another feedback: column deflection, times 42.93" in said(found)
    values = found.parameters["controller-mismatch"]
    assert values["feedback.deflection"] == pytest.approx(42.931, rel=1e-3)
    assert "feedback.deflection 42.93," in said(found)  # a value, no per cent of what was not there


# --- the double pendulum ------------------------------------------------------------------------


@pytest.mark.parametrize("joint", ["dfki-shoulder", "dfki-elbow"])
def test_the_law_of_each_joint_is_found(joint):
    """20 per rad and 0.5 per rad/s."""
    loop, _ = axis_of(joint).identify_controller(measured(joint))
    law = loop.controller
    assert law.kind == "pd" and law.full["c"] == 1.0
    assert law.settings["kp"] == pytest.approx(20.0, rel=0.03)
    assert 0.4 < law.settings["kd"] < 0.7


@pytest.mark.parametrize("joint", ["dfki-shoulder", slow("dfki-elbow")])
def test_the_other_joint_is_a_force_from_outside(joint):
    """The axis is not told to hold an effect that another joint's motion makes."""
    found = diagnosed(joint)
    assert (found.verdict, found.effects, found.block) == ("unexplained", (), "outside")
    assert "something outside may make it" in said(found)
