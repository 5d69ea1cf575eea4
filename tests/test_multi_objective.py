"""NSGA-II: its front against a random search, its knee, and a missing library."""

import sys

import numpy as np
import pytest

from ivtools import axes
from ivtools.errors import EstimationError, MissingExtraError
from ivtools.estimators.multi_objective import NSGA2, simulated_errors
from ivtools.estimators.pareto_front import ParetoFront, hypervolume, not_dominated
from ivtools.problem import Problem
from ivtools.record import Record

pytest.importorskip("pymoo")
THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}


@pytest.fixture(scope="module")
def problem():
    """A short record of the rigid EMPS without noise."""
    from ivtools import datasets

    part = datasets.twin().slice(0, 5000)
    sim = axes.emps().simulate(part, THETA, initial="rest")
    return Problem(Record(part.t, sim.q, q_ref=part.q_ref, nu=sim.nu), axes.emps())


@pytest.fixture(scope="module")
def fit(problem):
    return NSGA2(population=24, generations=25).fit(problem)


@pytest.mark.filterwarnings("ignore:nsga2 has not converged")
def test_the_front_dominates_a_random_search_of_equal_cost(problem, fit):
    front, method = fit.extras["front"], NSGA2()
    lower, upper = method.box(problem)
    candidates = np.random.default_rng(0).uniform(lower, upper, (front.n_simulations, 4))
    errors = np.array([simulated_errors(problem, theta) for theta in candidates])
    random = errors[not_dominated(errors)]
    assert front.dominates(random) > 0.9
    worst = np.maximum(random.max(axis=0), front.errors.max(axis=0)) * 1.01
    assert hypervolume(front.errors, worst) > hypervolume(random, worst)


def test_a_record_without_noise_gives_the_parameters_nearly(fit):
    # a search, not a solver: per cents, not digits
    # the offset hardly shows in these errors
    np.testing.assert_allclose(fit.params[:3], [95.0, 200.0, 20.0], rtol=0.15)
    assert fit.params["inertia"] == pytest.approx(95.0, rel=0.02)
    front = fit.extras["front"]
    assert fit.n_simulations == 600 and not_dominated(front.errors).all()
    np.testing.assert_array_equal(fit.params, front.theta[front.knee])
    assert "Pareto front" in front.summary() and front._repr_html_() and "points" in repr(front)
    assert len(front.frame()) == len(front.theta)


@pytest.mark.filterwarnings("ignore:nsga2 has not converged")
def test_the_same_seed_gives_the_same_front(problem):
    small = NSGA2(population=8, generations=3, seed=4)
    first, second = small.front(problem), small.front(problem)
    np.testing.assert_array_equal(first.theta, second.theta)
    bounded = NSGA2(population=8, generations=2, bounds={"inertia": (90.0, 91.0)}).front(problem)
    assert np.all((bounded.theta[:, 0] >= 90.0) & (bounded.theta[:, 0] <= 91.0))


def test_the_knee_is_nearest_to_the_ideal():
    errors = np.array([[0.0, 1.0], [0.1, 0.1], [1.0, 0.0]])
    front = ParetoFront(("a",), ("",), ("x", "y"), np.zeros((3, 1)), errors, 3, True)
    assert front.knee == 1
    assert front.dominates(np.array([[0.2, 0.2], [0.05, 0.05]])) == 0.5


def test_the_volume_is_that_of_pymoo():
    from pymoo.indicators.hv import HV

    points, reference = np.random.default_rng(1).random((15, 3)), np.full(3, 1.1)
    assert hypervolume(points, reference) == pytest.approx(HV(ref_point=reference)(points))


def test_an_axis_that_cannot_be_simulated_is_the_worst(problem):
    assert np.all(simulated_errors(problem, np.array([-5.0, 200.0, 20.0, 0.0])) == 1e3)


def test_bad_input_is_refused(problem, monkeypatch):
    with pytest.raises(EstimationError, match="population 2 and generations 5 are too few"):
        NSGA2(population=2, generations=5)
    with pytest.raises(EstimationError, match="bounds of inertia"):
        NSGA2(bounds={"inertia": (2.0, 1.0)}).box(problem)
    monkeypatch.setitem(sys.modules, "pymoo.algorithms.moo.nsga2", None)
    with pytest.raises(MissingExtraError, match=r"^pymoo is not installed; run: pip install"):
        NSGA2().fit(problem)
