"""Refined instrumental variables: the noise model, its filter, and the bound they aim at."""

from dataclasses import replace

import numpy as np
import pytest
from linearmodels.iv import IV2SLS
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from statsmodels.tsa.arima_process import arma_acovf

import ivtools as iv
from ivtools.errors import EstimationError
from ivtools.estimators.compensated import IDIMBCIV
from ivtools.estimators.refined import IDIMPIV, whiteness
from ivtools.linalg.autocovariance import segment_starts, taken
from ivtools.linalg.noise import NoiseModel

AR = np.array([1.2, -0.5])


@pytest.fixture(scope="module")
def noise():
    white = np.random.default_rng(0).standard_normal(5000)
    return lfilter([1.0], np.r_[1.0, -AR], white)


@pytest.fixture(scope="module")
def problem(twin):
    return iv.Problem(twin, iv.axes.emps().with_terms("inertia", "asymmetric-friction"))


# --- the noise model ------------------------------------------------------------------------------


def test_autoregression_is_that_of_yule_and_walker(noise):
    model = NoiseModel.fit(noise, criterion="bic")
    acov = [np.sum(noise[: len(noise) - k] * noise[k:]) / len(noise) for k in range(3)]
    expected = np.linalg.solve(toeplitz(acov[:2]), acov[1:])
    assert model.label == "AR(2)"
    np.testing.assert_allclose(model.coefficients, expected, rtol=1e-6)
    assert model.sigma**2 == pytest.approx(acov[0] - expected @ acov[1:], rel=1e-6)
    assert model.sigma == pytest.approx(1.0, rel=0.05)


def test_filter_is_that_of_generalised_least_squares():
    """Whitening of two segments equals the inverse Cholesky factor of their covariance."""
    acov = arma_acovf(np.r_[1.0, -AR], [1.0], 30)
    starts = np.array([0, 12])
    model = NoiseModel.from_autocovariance(acov[:3], starts)
    X = np.random.default_rng(1).standard_normal((30, 3))
    for rows in (slice(0, 12), slice(12, 30)):
        n = rows.stop - rows.start
        factor = np.linalg.cholesky(toeplitz(acov[:n]))
        expected = np.linalg.solve(factor, X[rows]) * model.sigma
        np.testing.assert_allclose(model(X)[rows], expected, atol=1e-7)
    np.testing.assert_allclose(model(X)[:, 0], model(X[:, 0]))


def test_what_a_fit_takes_from_the_noise_is_given_back():
    """The difference of the noise's covariance and that of its residual, averaged per lag."""
    n, lags = 60, 5
    acov = arma_acovf(np.r_[1.0, -AR], [1.0], n)
    model, S = NoiseModel.from_autocovariance(acov[:3]), toeplitz(acov)
    X = np.column_stack([np.ones(n), np.sin(np.arange(n) / 5.0)])
    left = np.eye(n) - X @ np.linalg.pinv(X)
    lost = S - left @ S @ left.T
    expected = [np.trace(lost, k) / n for k in range(lags + 1)]
    found = taken(model.inverse, model.sigma, np.linalg.qr(X)[0], lags)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_a_fit_does_not_narrow_the_model_of_the_noise():
    """Slow columns take a tenth of the slow noise; the model has its power all the same."""
    rng, slow = np.random.default_rng(5), np.array([1e-3])
    t = np.arange(1000) / 1000.0
    X = np.column_stack([np.cos(np.pi * k * t) for k in range(8)])
    power = {False: [], True: []}
    for _ in range(200):
        e = lfilter([1.0], np.r_[1.0, -AR], rng.standard_normal(len(t)))
        left = e - X @ np.linalg.lstsq(X, e)[0]
        for back, found in power.items():
            model = NoiseModel.fit(left, max_order=20, criterion="bic", fitted=X if back else None)
            found.append(model.spectrum(slow)[0])
    true = 1.0 / (1.0 - AR.sum()) ** 2
    without, given = (np.mean(power[back]) / true for back in (False, True))
    assert without < 0.95
    assert abs(given - 1.0) < 0.5 * abs(without - 1.0)


def test_segments_shorter_than_the_order_are_filtered_too(noise):
    model = NoiseModel.fit(noise, np.array([0, 3000, 3001, 3004]), max_order=8)
    assert np.isfinite(model(noise)).all()
    assert len(model(noise)) == len(noise)


def test_the_order_grows_with_what_is_there(noise):
    rng = np.random.default_rng(2)
    assert NoiseModel.fit(rng.standard_normal(3000), criterion="bic").order == 1
    assert NoiseModel.fit(noise, max_order=1).order == 1
    long = lfilter(np.r_[1.0, np.zeros(9), 0.8], [1.0], rng.standard_normal(5000))
    assert NoiseModel.fit(long).order >= 10


def test_moving_average_noise_is_found():
    e = lfilter([1.0, 0.9], [1.0, -0.5], np.random.default_rng(3).standard_normal(6000))
    model = NoiseModel.fit(e, kind="arma", criterion="bic")
    assert model.label == "ARMA(1, 1)"
    assert whiteness(model(e))[1] > 0.01 > whiteness(e)[1]
    assert model.sigma == pytest.approx(1.0, rel=0.05)


def test_spectrum_holds_the_variance(noise):
    model = NoiseModel.fit(noise, criterion="bic")
    frequencies = (np.arange(1000) + 0.5) / 1000.0
    assert model.spectrum(frequencies).mean() == pytest.approx(noise.var(), rel=0.02)


def test_segments_end_at_gaps_and_joints():
    t = np.r_[np.arange(5), np.arange(8, 12), np.arange(3)] * 0.01
    joints = np.r_[np.zeros(9, dtype=int), np.ones(3, dtype=int)]
    assert segment_starts(t, joints).tolist() == [0, 5, 9]


@pytest.mark.parametrize("settings", [{"kind": "garch"}, {"criterion": "hqic"}])
def test_unknown_noise_models_are_refused(noise, settings):
    with pytest.raises(EstimationError, match="is unknown; use ar or arma, aic or bic"):
        NoiseModel.fit(noise, **settings)


# --- the estimate ---------------------------------------------------------------------------------


def test_estimate_is_that_of_linearmodels_on_prefiltered_matrices(problem):
    fit = IDIMPIV().fit(problem)
    X, y, Z = (fit.extras["noise"](a) for a in (fit.X, fit.y, fit.Z))
    oracle = IV2SLS(y, None, X, Z).fit(cov_type="robust")
    np.testing.assert_allclose(fit.params, oracle.params, rtol=1e-8)
    np.testing.assert_allclose(fit.with_cov("robust").std_errors, oracle.std_errors, rtol=1e-8)


def test_the_noise_is_white_behind_the_filter(problem):
    fit = IDIMPIV().fit(problem)
    before, after = (fit.extras["whiteness"][key] for key in ("before", "after"))
    assert after[0] < 0.5 * before[0]
    assert before[0] == pytest.approx(whiteness(fit.resids)[0])
    assert fit.ljung_box(20).statistic == pytest.approx(after[0])
    assert any("noise AR(" in note for note in fit.notes)
    assert any("Ljung-Box" in note for note in fit.notes)
    assert fit.converged


def test_residual_and_relative_error_are_those_before_the_filter(problem):
    refined, plain = IDIMPIV().fit(problem), IDIMBCIV().fit(problem)
    assert refined.relative_error == pytest.approx(plain.relative_error, rel=0.01)


@pytest.mark.parametrize("settings", [{"noise": "arma"}, {"criterion": "bic"}, {"renew": True}])
def test_other_noise_models_agree(problem, settings):
    fit, default = IDIMPIV(**settings).fit(problem), IDIMPIV().fit(problem)
    assert fit.converged
    assert ((fit.params - default.params).abs() < default.std_errors).all()


def test_masked_rows_start_new_segments(problem):
    masked = replace(problem, pipeline=replace(problem.pipeline, min_speed=5e-3, guard=10))
    fit = IDIMPIV().fit(masked)
    assert len(fit.extras["noise"].starts) > 10
    assert fit.converged
    truth = problem.record.theta_true
    assert all(abs(fit.params[k] - truth[k]) < 5 * fit.std_errors[k] for k in truth)


def test_a_filter_that_moves_the_estimate_too_far_is_told(problem, emps):
    """What the model of the measured axis lacks is in its residual, and no noise."""
    assert not any("lacks an effect" in note for note in IDIMPIV().fit(problem).notes)
    measured = IDIMPIV().fit(replace(problem, record=emps))
    assert any("the model lacks an effect" in note for note in measured.notes)


def test_every_test_of_a_result_takes_the_filter(problem):
    fit = IDIMPIV().fit(problem)
    tests = fit.tests()
    assert tests["wu_hausman"].applies
    assert tests["weak_instruments"].statistic > 1e3
    assert fit.first_stage().notna().all().all()


def test_without_noise_there_is_none_to_model(twin):
    loop = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    simulation = loop.simulate(twin, twin.theta_true, initial="rest")
    record = twin.replace(q=simulation.q, nu=simulation.nu)
    fit = IDIMPIV(tol=1e-8).fit(iv.Problem(record, loop, simulation={"initial": "rest"}))
    np.testing.assert_allclose(fit.params, list(twin.theta_true.values()), rtol=1e-5)


def test_other_weights_are_refused():
    with pytest.raises(EstimationError, match="leave weighted and robust"):
        IDIMPIV(robust="huber")


def test_the_noise_is_modelled_from_near_starts_too(twin):
    """A start some per cent away is settled after one step, when no noise was looked at yet."""
    loop = iv.axes.emps()
    theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    rng = np.random.default_rng(1)
    size = twin.n_samples
    noise = {
        "position_noise": rng.normal(0.0, 1e-6, size),
        "force_noise": rng.normal(0.0, 5.0, size),
    }
    record = loop.simulate(twin, theta, initial="rest", **noise).to_record(q_ref=twin.q_ref)
    masked = replace(loop.pipeline(record), force_shift=0.5, min_speed=0.005, guard=10)
    masked = iv.Problem(record, loop, masked)
    near = IDIMPIV(start={"inertia": 100.0}).fit(masked)
    far = IDIMPIV(start={"inertia": 50.0, "viscous": 50.0, "coulomb": 5.0}).fit(masked)
    assert "noise" in near.extras
    np.testing.assert_allclose(near.params, far.params, rtol=1e-4)
