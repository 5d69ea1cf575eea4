"""The observer: the axis' own velocity, from the recorded command."""

from dataclasses import replace

import numpy as np
import pytest

import ivtools as iv
from ivtools.loop.controllers import Controller
from ivtools.loop.observer import driven_by, observed_velocity
from ivtools.problem import share_behind
from ivtools.record import Record

NOISE = 1e-5  # m, which shakes the axis by 1 mm/s
SLOW = 0.02  # m/s, around the reversals


@pytest.fixture(scope="module")
def loop():
    return iv.axes.emps().with_terms("inertia", "asymmetric-friction")


@pytest.fixture(scope="module")
def shaken(twin, loop):
    """The axis with a noisy encoder, and with a perfect one."""
    rng = np.random.default_rng(7)
    n = twin.n_samples
    options = {
        "position_noise": rng.normal(0.0, NOISE, n),
        "force_noise": rng.normal(0.0, 2.0, n),
    }
    clean = loop.simulate(twin, twin.theta_true, initial="rest")
    return loop.simulate(twin, twin.theta_true, initial="rest", **options), clean


def observed(loop, twin, simulation, pull_hz=6.0, **options):
    motion = iv.axes.emps().pipeline(twin).differentiate(simulation.q, twin.dt)
    driven = driven_by(simulation.nu, motion.q, twin)
    return observed_velocity(loop, driven, twin.theta_true, pull_hz, initial="rest", **options)


def test_a_noisy_encoder_does_not_hide_how_the_axis_moved(twin, loop, shaken):
    """At reversals the observer knows the velocity several times better than the simulation."""
    true, clean = shaken
    rows = (np.abs(clean.dq) < SLOW) & (twin.t[:, np.newaxis] > 0.2)
    error = observed(loop, twin, true) - true.dq - (observed(loop, twin, clean) - clean.dq)
    assert error[rows].std() < 0.3 * (clean.dq - true.dq)[rows].std()


def test_the_direction_differs_from_the_true_one_for_a_few_samples_only(twin, loop, shaken):
    true, clean = shaken
    wrong = np.sign(observed(loop, twin, true)) != np.sign(true.dq)
    simulated = np.sign(clean.dq) != np.sign(true.dq)
    assert wrong.sum() < 0.7 * simulated.sum()


def test_nothing_pulls_where_the_model_moves_as_the_axis(twin, loop, shaken):
    """Without noise the observed velocity is the true one, to a hundredth of a sample's change."""
    clean = shaken[1]
    error = np.abs(observed(loop, twin, clean, pull_hz=2.5) - clean.dq)
    assert error[200:-200].max() < 1.2e-5  # m/s


def test_the_difference_from_the_measured_motion_is_smoothed_not_filtered(twin, loop, shaken):
    """The error at the reversals comes near that of Wiener's smoother, 0.06 mm/s."""
    true, clean = shaken
    rows = (np.abs(clean.dq) < SLOW) & (twin.t[:, np.newaxis] > 0.2)
    error = observed(loop, twin, true, pull_hz=2.5) - true.dq
    assert error[rows].std() < 1.5e-4  # m/s


def test_the_controller_of_the_loop_does_not_matter(twin, loop, shaken):
    soft = replace(loop, controller=Controller("pd", {"kp": 10.0, "kd": 1.0}, limit=0.1))
    expected = observed(loop, twin, shaken[0])
    np.testing.assert_array_equal(observed(soft, twin, shaken[0]), expected)


def test_a_mismatch_of_the_controller_does_not_scale_the_known_input(twin, loop, shaken):
    wrong = loop.with_effect("controller-mismatch", kp=0.1, added=0.5)
    expected = observed(loop, twin, shaken[0])
    np.testing.assert_array_equal(observed(wrong, twin, shaken[0]), expected)


def test_the_pull_scales_with_the_units(twin, loop, shaken):
    """In millimetres and kilonewtons the same motion comes out."""
    true, _ = shaken
    expected = observed(loop, twin, true)
    small = {"inertia": 1e-6, "viscous_pos": 1e-6, "viscous_neg": 1e-6}
    small |= {"coulomb_pos": 1e-3, "coulomb_neg": 1e-3}
    theta = {name: value * small[name] for name, value in twin.theta_true.items()}
    metric = replace(loop, gain=loop.gain * 1e-3, start={})
    record = Record(twin.t, 1e3 * true.q, nu=true.nu)
    motion = loop.pipeline(twin).differentiate(record.q, twin.dt)
    found = observed_velocity(
        metric, driven_by(record.nu, motion.q, record), theta, 6.0, initial=(0.0, 0.0)
    )
    start = observed(loop, twin, true)[0, 0]
    np.testing.assert_allclose(start, 0.0)
    np.testing.assert_allclose(found, 1e3 * expected, atol=1e-6 * np.abs(expected).max() * 1e3)


# --- rows -----------------------------------------------------------------------------------------


def test_both_sides_agree_without_noise(twin, loop):
    clean = loop.simulate(twin, twin.theta_true, initial="rest")
    record = twin.replace(q=clean.q, nu=clean.nu)
    problem = iv.Problem(record, loop, simulation={"initial": "rest"})
    pair = problem.paired_rows(twin.theta_true)
    np.testing.assert_allclose(pair.X, pair.X_s, atol=1e-12)
    np.testing.assert_allclose(pair.y, pair.y_s, atol=1e-12)
    np.testing.assert_array_equal(pair.y, problem.y)


def test_a_sample_with_a_reversal_counts_for_either_direction(twin, loop):
    clean = loop.simulate(twin, twin.theta_true, initial="rest")
    problem = iv.Problem(twin, loop, simulation={"initial": "rest"})
    problem = replace(problem, pipeline=replace(problem.pipeline, decimation=1, trim=(0, 0)))
    pair = problem.paired_rows(twin.theta_true)
    ahead, back = pair.X_s[200:-200, 2], -pair.X_s[200:-200, 4]  # the Coulomb columns
    assert ((ahead >= 0.0) & (ahead <= 1.0)).all()
    np.testing.assert_allclose(ahead + back, 1.0)
    reversals = np.count_nonzero(np.diff(np.sign(clean.dq[200:-200, 0])))
    assert 0 < np.count_nonzero((ahead > 0.0) & (ahead < 1.0)) <= reversals


def test_a_reversal_shares_its_sample_by_the_accelerations_on_either_side():
    """A mass that slows with a1 for (1 - s) dt, and speeds up with a2 for s dt."""
    dt, a1, a2 = 1e-3, 1.6, 0.7
    s = np.linspace(0.05, 0.95, 10)[:, np.newaxis]
    found = share_behind(a1 * (1.0 - s) * dt, a2 * s * dt, np.full_like(s, (a1 - a2) * dt))
    np.testing.assert_allclose(found, s, rtol=1e-9)


def test_a_loop_without_a_mode_of_its_own_has_a_slow_observer(twin, loop):
    velocity = replace(loop, controller=Controller("p-velocity", {"kv": 0.0}))
    problem = iv.Problem(twin, velocity, loop.pipeline(twin))
    assert 0.0 < problem._pull_hz < 10.0
