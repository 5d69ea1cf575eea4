"""The Cramer-Rao bound, and the predictions of the position that it comes from."""

import numpy as np
import pytest

import ivtools as iv
from ivtools.errors import EstimationError
from ivtools.estimators.bound import Noise, Predictor, cramer_rao, predictor
from ivtools.record import Record

LOOP = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
DRAWN = [  # inertia, viscous, step, noise
    (95.0, 200.0, 1e-3, Noise(1e-6, 2.0)),
    (2e-4, 0.0, 4e-3, Noise(1e-4, 1e-3, quantum=1e-3)),
    (3.0, 40.0, 1e-4, Noise(1e-7, 0.5, pole=0.95)),
    (0.05, 0.3, 2e-3, Noise(0.0, 0.01)),
    (10.0, 5.0, 1e-3, Noise(1e-5)),
]


def motion(theta, n=20000, **noise):
    """A linear axis in its loop, so slow that the sampled friction is what acts between samples."""
    loop = iv.axes.emps().with_terms("inertia", "viscous", "offset")
    t = np.arange(n) * 1e-3
    q_ref = 0.1 * np.sin(2.0 * t) + 0.02 * np.sin(9.0 * t)
    moved = Record(t, q_ref, q_ref=q_ref, nu=q_ref)
    return loop, loop.simulate(moved, theta, initial="rest", **noise)


@pytest.mark.parametrize(("inertia", "viscous", "dt", "noise"), DRAWN)
def test_prediction_errors_are_white_and_of_their_deviation(inertia, viscous, dt, noise):
    n, rng = 40000, np.random.default_rng(2)
    sigma = np.hypot(noise.position, noise.quantum / np.sqrt(12.0))
    force = noise.force * rng.standard_normal(n)
    for k in range(1, n):
        force[k] = noise.pole * force[k - 1] + np.sqrt(1.0 - noise.pole**2) * force[k]
    filter_ = Predictor.of(inertia, viscous, dt, noise)
    e = filter_.errors(sigma * rng.standard_normal(n), -force)[2000:]
    assert e.std() == pytest.approx(1.0, rel=0.03)
    lags = [np.mean(e[k:] * e[:-k]) for k in range(1, 30)]
    assert np.abs(lags).max() < 4.5 / np.sqrt(len(e))


def test_prediction_errors_of_a_record_are_those_of_its_noise():
    """The command is known: what the loop makes of the noise adds nothing."""
    theta, rng, n = (
        {"inertia": 95.0, "viscous": 200.0, "offset": -3.0},
        np.random.default_rng(0),
        20000,
    )
    noise = {
        "position_noise": 1e-6 * rng.standard_normal(n), "force_noise": 2.0 * rng.standard_normal(n)
    }  # fmt: skip
    loop, sim = motion(theta, **noise)
    filter_ = predictor(loop, theta, 1e-3, Noise(1e-6, 2.0))
    found = filter_.errors(sim.q[:, 0] - sim.q[0, 0], sim.tau[:, 0] + 3.0)
    expected = filter_.errors(noise["position_noise"], -noise["force_noise"])
    np.testing.assert_allclose(found[3000:], expected[3000:], atol=0.02)


def test_sensitivities_are_the_derivatives_of_the_errors():
    theta = {"inertia": 95.0, "viscous": 200.0, "offset": -3.0}
    loop, sim = motion(theta)
    noise, columns = Noise(1e-6, 2.0), loop.regressor(sim.motion, sim.tau, sim.t)
    filter_ = predictor(loop, theta, 1e-3, noise)
    mine = filter_.sensitivities(columns)
    for j, (name, step) in enumerate({"inertia": 0.1, "viscous": 0.2, "offset": 0.1}.items()):
        ends = []
        for sign in (1.0, -1.0):
            other = {**theta, name: theta[name] + sign * step}
            moved = Predictor.of(other["inertia"], other["viscous"], 1e-3, noise)
            moved = Predictor(moved.A, moved.B, filter_.gain, filter_.deviation)
            ends.append(moved.errors(sim.q[:, 0], sim.tau[:, 0] - other["offset"]))
        derivative = (ends[0] - ends[1]) / (2.0 * step)
        off = np.linalg.norm(derivative - mine[:, j]) / np.linalg.norm(derivative)
        assert off < 0.03, name


def test_the_bound_is_in_proportion_to_the_noise(twin):
    sims = [LOOP.simulate(twin, twin.theta_true)]
    one, two, coarse = (
        cramer_rao(LOOP, twin.theta_true, sims, noise)
        for noise in (Noise(1e-6, 2.0), Noise(2e-6, 4.0), Noise(1e-6, 2.0, quantum=1e-5))
    )
    np.testing.assert_allclose(two, 4.0 * one, rtol=1e-6)
    assert (np.diag(coarse) > np.diag(one)).all() and list(one.index) == list(LOOP.names)


def test_the_bound_needs_noise_and_a_motion(twin):
    with pytest.raises(EstimationError, match="without any noise there is no bound"):
        cramer_rao(LOOP, twin.theta_true, [LOOP.simulate(twin, twin.theta_true)], Noise())
    still = twin.replace(q_ref=1e-12 * np.sin(twin.t))
    standing = LOOP.simulate(still, twin.theta_true, initial="rest")
    with pytest.raises(EstimationError, match="does not tell the parameters apart"):
        cramer_rao(LOOP, twin.theta_true, [standing], Noise(1e-6, 2.0))
