"""Maximum likelihood: its noise model, recovery, starting values and bias."""

import numpy as np
import pytest

from ivtools import axes
from ivtools.errors import EstimationError
from ivtools.estimators.least_squares import IDIMLS
from ivtools.estimators.maximum_likelihood import (
    ML,
    noise_covariance,
    position_noise,
    row_variance,
    sensitivities,
)
from ivtools.pipeline import Pipeline
from ivtools.problem import Problem
from ivtools.record import Record

THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
PIPELINE = Pipeline(100.0, 10, trim=(49, 0), force_shift=0.5, min_speed=0.002, guard=10)


def simulated(twin, sigma=0.0, force=0.0, seed=0, pipeline=PIPELINE, samples=None) -> Problem:
    """A problem of the rigid EMPS with white noise on position (m) and force (N)."""
    reference = twin.slice(0, samples)
    rng, n = np.random.default_rng(seed), reference.n_samples
    noise = {
        "position_noise": rng.normal(0.0, sigma, n) if sigma else None,
        "force_noise": rng.normal(0.0, force, n) if force else None,
    }
    sim = axes.emps().simulate(reference, THETA, initial="rest", **noise)
    record = Record(reference.t, sim.q, q_ref=reference.q_ref, nu=sim.nu)
    return Problem(record, axes.emps(), pipeline)


@pytest.mark.parametrize("log_determinant", [True, False])
def test_a_record_without_noise_gives_the_parameters(twin, log_determinant):
    problem = simulated(twin, samples=12000)
    fit = ML(log_determinant=log_determinant, position_noise=0.0).fit(problem)
    assert fit.converged
    # what is left is the band-pass at the corners of the reference, as in least squares
    np.testing.assert_allclose(fit.params, list(THETA.values()), rtol=0.012)
    np.testing.assert_allclose(fit.params, IDIMLS().fit(problem).params, rtol=1e-6)


@pytest.mark.parametrize("value", [5.0, 500.0, -3000.0])
@pytest.mark.parametrize("log_determinant", [True, False])
def test_far_starting_values_lead_to_the_same_estimate(twin, value, log_determinant):
    problem = simulated(twin, 3e-6, 2.0, samples=12000)
    near = ML(log_determinant=log_determinant).fit(problem)
    start = dict.fromkeys(problem.names, value)
    far = ML(log_determinant=log_determinant, start=start).fit(problem)
    assert near.converged and far.converged
    np.testing.assert_allclose(far.params, near.params, rtol=1e-5)


def test_the_estimate_is_a_minimum_of_the_likelihood(twin):
    problem = simulated(twin, 5e-6, 2.0, samples=12000)
    fit = ML(position_noise=5e-6).fit(problem)
    S = 25e-12 * noise_covariance(problem.pipeline, problem.record.dt)
    B, force = sensitivities(problem), fit.extras["force_noise"] ** 2

    def cost(theta, variance=force):
        v = row_variance(B, S, theta, variance)
        return 0.5 * np.sum((problem.y - problem.X @ theta) ** 2 / v + np.log(v))

    theta, best = fit.params.to_numpy(), cost(fit.params.to_numpy())
    for i, step in enumerate(0.1 * fit.std_errors):
        for sign in (-1.0, 1.0):
            assert cost(theta + sign * step * np.eye(4)[i]) > best
    assert min(cost(theta, 1.05 * force), cost(theta, 0.95 * force)) > best


def test_the_noise_of_the_rows_is_that_of_the_pipeline():
    rng, pipeline = np.random.default_rng(3), Pipeline(100.0, 10)
    motion = pipeline.differentiate(rng.standard_normal(400_000), 1e-3)
    rows = pipeline.rows(np.hstack(motion))
    S = noise_covariance(pipeline, 1e-3)
    found = np.cov(rows.T)
    size = np.sqrt(np.outer(np.diag(S), np.diag(S)))
    np.testing.assert_allclose(found / size, S / size, atol=0.02)


def test_the_noise_of_the_position_is_read_from_the_record(twin):
    problem = simulated(twin, 3e-6, 2.0, samples=12000)
    record, motion = problem.record, problem.motion
    assert position_noise(problem.pipeline, record, motion) == pytest.approx(3e-6, rel=0.05)
    assert position_noise(Pipeline(None, 10), record, motion) == 0.0


def test_a_noise_that_is_none_is_refused():
    with pytest.raises(EstimationError, match="position_noise = -1.0 must be a standard deviation"):
        ML(position_noise=-1.0)


@pytest.mark.slow
def test_bias_in_closed_loop_is_the_documented_one(twin):
    methods = {"ls": IDIMLS(), "published": ML(), "eiv": ML(log_determinant=False)}
    found = {name: [] for name in methods}
    for seed in range(20):
        problem = simulated(twin, 1e-5, 2.0, seed)
        for name, method in methods.items():
            found[name].append(method.fit(problem).params["inertia"])
    bias = {name: 100.0 * (np.mean(values) / 95.0 - 1.0) for name, values in found.items()}
    assert bias["ls"] == pytest.approx(-8.7, abs=0.5)
    assert bias["published"] == pytest.approx(bias["ls"], abs=0.2)
    assert bias["eiv"] == pytest.approx(-2.8, abs=0.6)
