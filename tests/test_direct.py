"""Direct dynamic model: the regression on the acceleration, mapped back by the delta method."""

import numpy as np
import pytest

import ivtools as iv
from ivtools.errors import EstimationError
from ivtools.estimators import DDMIV, DDMLS, IDIMIV
from ivtools.estimators.direct import direct_regressor
from ivtools.linalg import covariance, solve_iv

MODELS = [("inertia", "viscous", "coulomb", "offset"), ("inertia", "asymmetric-friction")]
TRUE = {
    "inertia": 95.0, "viscous_pos": 165.0, "coulomb_pos": 20.0, "viscous_neg": 240.0,
    "coulomb_neg": 21.0,
}  # fmt: skip


@pytest.fixture(scope="module", params=MODELS, ids=["symmetric", "asymmetric"])
def problem(request, twin):
    return iv.Problem(twin, iv.axes.emps().with_terms(*request.param))


def mapped(b, cov):
    """The inverse model's parameters and their covariance: the delta method, spelled out."""
    theta = np.concatenate([[1.0], b[1:]]) / b[0]
    G = np.diag(np.full(len(b), 1.0 / b[0]))
    G[:, 0] = -np.concatenate([[1.0], b[1:]]) / b[0] ** 2
    return theta, G @ cov @ G.T


@pytest.mark.parametrize("cov_type", ["robust", "hac"])
def test_least_squares_is_the_regression_on_the_acceleration(problem, cov_type):
    ddq, W = problem.X[:, 0], direct_regressor(problem.X, problem.y, 0)
    b = np.linalg.lstsq(W, ddq)[0]
    cov = covariance(W, ddq - W @ b, None, cov_type, bandwidth=12)
    theta, expected = mapped(b, cov)
    fit = DDMLS().fit(problem).with_cov(cov_type, bandwidth=12)
    np.testing.assert_allclose(fit.params, theta, rtol=1e-9)
    np.testing.assert_allclose(fit.cov, expected, rtol=1e-8)
    np.testing.assert_allclose(fit.resids, -theta[0] * (ddq - W @ b), atol=1e-8)


def test_instrumental_variables_are_those_of_the_acceleration(problem):
    fit = DDMIV().fit(problem)
    ddq, W = problem.X[:, 0], direct_regressor(problem.X, problem.y, 0)
    b = solve_iv(W, ddq, fit.Z)
    cov = covariance(W, ddq - W @ b, fit.Z, "robust")
    theta, expected = mapped(b, cov)
    np.testing.assert_allclose(fit.params, theta, rtol=1e-8)
    np.testing.assert_allclose(fit.with_cov("robust").cov, expected, rtol=1e-7)


def test_both_instrumental_variable_estimates_agree(problem):
    direct, inverse = DDMIV().fit(problem), IDIMIV().fit(problem)
    assert ((direct.params - inverse.params).abs() < inverse.std_errors).all()


def test_the_twin_gives_its_parameters_back(twin):
    problem = iv.Problem(twin, iv.axes.emps().with_terms(*MODELS[1]))
    fit = DDMIV(start={"inertia": 500.0, "coulomb_pos": 50.0}).fit(problem)
    np.testing.assert_allclose(fit.params, list(TRUE.values()), rtol=0.01)
    assert fit.converged


@pytest.mark.parametrize("method", [DDMLS(), DDMIV()], ids=["ls", "iv"])
def test_the_measured_axis(emps, method):
    """Beside the inverse model's figures: little noise, so little between them."""
    problem = iv.Problem(emps, iv.axes.emps().with_terms(*MODELS[1]))
    fit = method.fit(problem)
    np.testing.assert_allclose(fit.params, [95.22, 166.4, 20.17, 240.4, 20.63], rtol=2.5e-3)
    assert fit.relative_error == pytest.approx(3.112, abs=0.01)


def test_least_squares_offers_no_test_of_its_force(problem):
    fit = DDMLS().fit(problem)
    assert not fit.wu_hausman().applies
    assert "measured force" in fit.wu_hausman().reason


@pytest.mark.parametrize("method", [DDMLS(), DDMIV()], ids=["ls", "iv"])
def test_a_model_without_inertia_is_refused(twin, method):
    loop = iv.axes.emps().with_terms("viscous", "coulomb")
    problem = iv.Problem(twin, loop, iv.Pipeline(100.0, 10, trim=(49, 0)))
    with pytest.raises(EstimationError, match="no inertia"):
        method.fit(problem)
