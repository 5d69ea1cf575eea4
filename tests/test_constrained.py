"""Linear matrix inequalities: least squares where it is physical, the nearest point elsewhere."""

import sys

import numpy as np
import pytest

from ivtools import axes
from ivtools.errors import EstimationError, MissingExtraError
from ivtools.estimators.constrained import LMIIV, LMILS, bounds, unphysical
from ivtools.estimators.least_squares import IDIMLS
from ivtools.estimators.matrix_inequalities import pseudo_inertia, solve_lmi
from ivtools.linalg import solve_iv
from ivtools.problem import Problem
from ivtools.record import Record

pytest.importorskip("cvxpy")


@pytest.fixture(scope="module")
def weak():
    """A short noisy record of an axis with little viscous friction: the twin's slowest moves."""
    from ivtools import datasets

    theta = {"inertia": 95.0, "viscous": 30.0, "coulomb": 20.0, "offset": -3.0}
    part = datasets.twin().slice(9000, 12000)
    noise = np.random.default_rng(0).normal(0.0, 10.0, part.n_samples)
    sim = axes.emps().simulate(part, theta, initial="rest", force_noise=noise)
    return Problem(Record(part.t, sim.q, q_ref=part.q_ref, nu=sim.nu), axes.emps())


@pytest.fixture(scope="module")
def problem():
    from ivtools import datasets

    return Problem(datasets.twin(), axes.emps().with_terms("inertia", "asymmetric-friction"))


def test_a_physical_estimate_is_that_of_least_squares(problem):
    ls, lmi = IDIMLS().fit(problem), LMILS().fit(problem)
    np.testing.assert_allclose(lmi.params, ls.params, rtol=1e-6)
    np.testing.assert_allclose(lmi.cov, ls.cov, rtol=1e-6)
    assert lmi.extras["active"] == () and unphysical(ls) == ()


def test_a_physical_estimate_is_that_of_instrumental_variables(problem):
    fit = LMIIV().fit(problem)
    assert fit.converged and fit.n_simulations == fit.n_iter
    np.testing.assert_allclose(fit.params, solve_iv(problem.X, problem.y, fit.Z), rtol=1e-6)


def test_an_unphysical_estimate_is_moved_to_its_bound(weak):
    ls = IDIMLS().fit(weak)
    assert unphysical(ls) == ("viscous",) and ls.params["viscous"] < -50.0
    for method in (LMILS(), LMIIV()):
        fit = method.fit(weak)
        assert fit.converged and unphysical(fit) == ()
        assert weak.simulate(fit.params).finite
    fit = LMILS().fit(weak)
    assert fit.params["viscous"] == 0.0 and fit.notes == ("viscous is on its physical bound",)
    others = weak.X[:, [0, 2, 3]]  # with one parameter on its bound the others are least squares
    np.testing.assert_allclose(fit.params.iloc[[0, 2, 3]], solve_iv(others, weak.y), rtol=1e-5)


def test_a_mass_that_least_squares_finds_negative_becomes_positive():
    rng = np.random.default_rng(1)
    X = rng.standard_normal((100, 2))
    y = X @ [-3.0, 1.0] + 0.1 * rng.standard_normal(100)
    theta, active = solve_lmi(X, y, None, np.array([0.1, 0.0]), np.full(2, np.inf), names="ab")
    assert theta[0] == pytest.approx(0.1) and active == ("a",)


@pytest.mark.parametrize("seed", range(5))
def test_the_solution_is_that_of_bounded_least_squares(seed):
    from scipy.optimize import lsq_linear

    rng = np.random.default_rng(seed)
    X = rng.standard_normal((60, 4)) * [1.0, 1e-3, 1e3, 1.0]
    y = rng.standard_normal(60)
    theta, _ = solve_lmi(X, y, None, np.zeros(4), np.full(4, np.inf))
    oracle = lsq_linear(X, y, (0.0, np.inf), tol=1e-14, method="bvls").x
    scale = np.linalg.norm(X, axis=0)
    np.testing.assert_allclose(theta * scale, oracle * scale, atol=2e-6 * np.linalg.norm(y))


def test_far_starting_values_lead_to_the_same_estimate(problem):
    from dataclasses import replace

    far = {"inertia": 30.0, "viscous_pos": 900.0, "coulomb_pos": 0.1, "viscous_neg": 1.0,
           "coulomb_neg": 90.0}  # fmt: skip
    start = replace(problem, loop=replace(problem.loop, start=far), pipeline=problem.pipeline)
    near, away = LMIIV(tol=1e-6).fit(problem), LMIIV(tol=1e-6).fit(start)
    assert away.converged
    np.testing.assert_allclose(away.params, near.params, rtol=2e-3)


def test_the_pseudo_inertia_keeps_a_link_possible():
    box = np.array([2.0, 0.2, 0.0, -0.1, 0.05, 0.0, 0.01, 0.06, 0.0, 0.07])
    assert np.linalg.eigvalsh(pseudo_inertia(box)).min() > 0.0
    rng = np.random.default_rng(2)
    X = rng.standard_normal((40, 10))
    y = X @ box + 0.5 * rng.standard_normal(40)
    free = solve_iv(X, y)
    assert np.linalg.eigvalsh(pseudo_inertia(free)).min() < -1e-3
    none = np.full(10, np.inf)
    theta, _ = solve_lmi(X, y, None, -none, none, lambda link: [pseudo_inertia(link)])
    assert np.linalg.eigvalsh(pseudo_inertia(theta)).min() > -1e-7
    assert np.linalg.norm(theta - box) < np.linalg.norm(free - box)


def test_inequalities_without_a_solution_are_reported():
    X, y = np.eye(3)[:, :2], np.ones(3)
    with pytest.raises(EstimationError, match="infeasible: no parameters respect them"):
        solve_lmi(X, y, None, np.array([2.0, 0.0]), np.array([1.0, np.inf]))


def test_bounds_are_those_of_the_terms(problem):
    lower, upper = bounds(problem)
    assert lower[0] > 0.0 and np.all(lower[1:] == 0.0) and np.all(np.isinf(upper))


def test_a_missing_library_is_one_line(problem, monkeypatch):
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    with pytest.raises(MissingExtraError, match=r'^cvxpy is not installed; run: pip install "ivt'):
        LMILS().fit(problem)
