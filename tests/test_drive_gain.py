"""Drive gain: recovered from simulated records without and with a payload."""

from dataclasses import replace

import numpy as np
import pytest

from ivtools import axes
from ivtools.errors import EstimationError
from ivtools.estimators.drive_gain import drive_gain
from ivtools.pipeline import Pipeline
from ivtools.problem import Problem
from ivtools.record import Record

THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
PIPELINE = Pipeline(100.0, 10, trim=(49, 0), force_shift=0.5, min_speed=0.002, guard=10)


def payload(twin, mass, force=0.0, seed=0, stated=None, samples=12000, **changes) -> Problem:
    """The EMPS with a payload, behind a loop that states another drive gain."""
    reference, loop = twin.slice(0, samples), axes.emps()
    noise = np.random.default_rng([seed, int(mass)]).normal(0.0, force, reference.n_samples)
    theta = {**THETA, "inertia": 95.0 + mass, **changes}
    sim = loop.simulate(reference, theta, initial="rest", force_noise=noise)
    record = Record(reference.t, sim.q, q_ref=reference.q_ref, nu=sim.nu)
    return Problem(record, replace(loop, gain=stated or loop.gain), PIPELINE)


def test_a_record_without_noise_gives_the_gain_whatever_is_stated(twin):
    found = drive_gain(payload(twin, 0.0, stated=10.0), payload(twin, 20.0, stated=10.0), 20.0)
    assert found.gain == pytest.approx(axes.emps().gain, rel=2e-3)
    np.testing.assert_allclose(found.params, list(THETA.values()), rtol=0.012)
    assert found.stated == 10.0 and found.unit == "N/V"


@pytest.mark.parametrize("seed", range(4))
def test_the_true_gain_lies_within_its_interval(twin, seed):
    pair = (payload(twin, 0.0, 2.0, seed), payload(twin, 20.0, 2.0, seed))
    found = drive_gain(*pair, 20.0)
    lower, upper = found.conf_int(0.99)
    assert lower < axes.emps().gain < upper
    assert 0.001 < found.std_error / found.gain < 0.02
    assert "Drive gain" in found.summary() and found._repr_html_() and "N/V" in repr(found)


@pytest.mark.slow
def test_intervals_cover_the_truth_as_often_as_they_say(twin):
    true, inside, gains = axes.emps().gain, 0, []
    for seed in range(60):
        found = drive_gain(payload(twin, 0.0, 2.0, seed), payload(twin, 20.0, 2.0, seed), 20.0)
        gains.append(found.gain)
        lower, upper = found.conf_int()
        inside += lower < true < upper
    assert inside >= 51  # 57 expected of 60
    assert np.mean(gains) == pytest.approx(true, rel=3e-3)


def test_a_friction_that_the_payload_changes_needs_columns_of_its_own(twin):
    pair = (payload(twin, 0.0), payload(twin, 20.0, coulomb=24.0))
    plain, own = (drive_gain(*pair, 20.0, loaded_friction=on) for on in (False, True))
    true = axes.emps().gain
    assert own.gain == pytest.approx(true, rel=3e-3)
    assert own.relative_error < 0.7 * plain.relative_error
    assert own.params["coulomb_loaded"] == pytest.approx(4.0, abs=0.2)


def test_bad_input_is_refused(twin):
    problem = payload(twin, 0.0)
    with pytest.raises(EstimationError, match="mass = 0.0 must be positive"):
        drive_gain(problem, problem, 0.0)
    other = Problem(problem.record, axes.emps().with_terms("inertia", "coulomb"), PIPELINE)
    with pytest.raises(EstimationError, match="the models differ"):
        drive_gain(problem, other, 10.0)
