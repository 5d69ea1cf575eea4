"""Set membership: the box holds the truth, and the linear programs are right."""

from itertools import combinations, product

import numpy as np
import pytest

from ivtools import axes
from ivtools.errors import ConvergenceWarning, EstimationError, ShapeError
from ivtools.estimators.feasible_set import FeasibleSet
from ivtools.estimators.linear_programs import smallest_bound
from ivtools.estimators.set_membership import SetMembership
from ivtools.problem import Problem


def system(seed: int, n: int = 8, p: int = 3, bound: float = 0.5):
    """Rows whose error respects the bound."""
    rng = np.random.default_rng(seed)
    X, theta = rng.standard_normal((n, p)) * 10.0 ** rng.uniform(-2, 2, p), rng.uniform(-5, 5, p)
    return X, X @ theta + rng.uniform(-bound, bound, n), theta, bound


def brute_force(X, y, bound):
    """Corners of the set: every p faces that meet in a point that no other face cuts off."""
    n, p = X.shape
    corners = []
    for rows in combinations(range(n), p):
        for signs in product((-1.0, 1.0), repeat=p):
            point = np.linalg.solve(X[list(rows)], y[list(rows)] + bound * np.array(signs))
            if np.all(np.abs(y - X @ point) <= bound * (1.0 + 1e-9)):
                corners.append(point)
    return np.array(corners)


@pytest.mark.parametrize("seed", range(12))
def test_the_programs_agree_with_every_corner_of_the_set(seed):
    X, y, _, bound = system(seed, p=2 + seed % 3)
    found, corners = FeasibleSet.of(X, y, bound), brute_force(X, y, bound)
    np.testing.assert_allclose(found.lower, corners.min(axis=0), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(found.upper, corners.max(axis=0), rtol=1e-7, atol=1e-9)
    mine = found.vertices()
    assert len(mine) == len(np.unique(corners.round(9), axis=0))
    np.testing.assert_allclose(mine.min(axis=0), corners.min(axis=0), rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("seed", range(40))
def test_the_set_holds_the_truth_when_the_noise_respects_the_bound(seed):
    X, y, theta, bound = system(seed, n=200, p=4)
    found = FeasibleSet.of(X, y, bound)
    assert not found.empty
    assert found.contains(theta)
    assert np.all((found.lower <= theta) & (theta <= found.upper))
    assert found.contains(found.centre.to_dict())
    assert not found.contains(found.upper.to_numpy() + 1e-3 * np.abs(found.upper))


def test_the_centre_is_furthest_from_the_faces():
    X, y, _, bound = system(4, n=30, p=2)
    found = FeasibleSet.of(X, y, bound)
    size = np.linalg.norm(X / np.linalg.norm(X, axis=0) * np.sqrt(len(X)), axis=1)

    def distance(theta):
        return np.min((bound - np.abs(y - X @ theta)) / size)

    centre = found.centre.to_numpy()
    assert distance(centre) == pytest.approx(found.radius, rel=1e-6)
    rng, width = np.random.default_rng(0), (found.upper - found.lower).to_numpy()
    others = [distance(centre + rng.uniform(-0.5, 0.5, 2) * width) for _ in range(2000)]
    assert max(others) <= found.radius * (1.0 + 1e-9)


def test_of_several_centres_the_middle_one_is_taken():
    # the first parameter alone limits the ball, which can slide along the second
    X = np.array([[10.0, 0.0], [0.0, 0.1], [10.0, 0.0], [0.0, 0.1]])
    found = FeasibleSet.of(X, [0.0, 1.0, 0.0, 1.0], [0.1, 1.0, 0.1, 1.0])
    np.testing.assert_allclose(found.lower, [-0.01, 0.0], atol=1e-9)
    np.testing.assert_allclose(found.upper, [0.01, 20.0], atol=1e-9)
    np.testing.assert_allclose(found.centre, [0.0, 10.0], atol=1e-5)


def test_an_empty_set_names_the_rows_that_contradict_each_other():
    X, y, _, bound = system(5, n=60, p=3)
    y[17] += 200.0 * bound
    found = FeasibleSet.of(X, y, bound, t=np.arange(60) * 0.01)
    assert found.empty and found.smallest > 1.0
    assert 17 in found.rows and len(found.rows) <= 4
    assert found.lower.isna().all() and not len(found.vertices())
    assert FeasibleSet.of(X[found.rows], y[found.rows], bound).empty
    without = np.setdiff1d(np.arange(60), [17])
    assert not FeasibleSet.of(X[without], y[without], bound).empty
    assert "t = 0.170 s" in found.summary() and "EMPTY" in found.summary()
    assert "empty" in repr(found)


def test_the_smallest_bound_is_where_the_set_appears():
    X, y, _, bound = system(6, n=50, p=3)
    factor, theta, _ = smallest_bound(X, y, np.full(50, bound))
    assert np.max(np.abs(y - X @ theta)) == pytest.approx(factor * bound)
    assert FeasibleSet.of(X, y, 0.999 * factor * bound).empty
    assert not FeasibleSet.of(X, y, 1.001 * factor * bound).empty


def test_units_do_not_matter():
    X, y, _, bound = system(7, n=50, p=3)
    scale = np.array([1e-6, 1.0, 1e6])
    a, b = FeasibleSet.of(X, y, bound), FeasibleSet.of(X * scale, y, bound)
    for name in ("lower", "upper", "centre"):
        np.testing.assert_allclose(getattr(b, name) * scale, getattr(a, name), rtol=1e-6)


def test_a_record_without_noise_gives_the_parameters(twin):
    theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    problem = Problem(twin, axes.emps())
    exact = type("Exact", (), {})()  # the twin's own regressor with an exact force
    for name in ("X", "names", "units", "t"):
        setattr(exact, name, getattr(problem, name))
    exact.y = problem.X @ list(theta.values())
    found = SetMembership().feasible_set(exact)
    np.testing.assert_allclose(found.centre, list(theta.values()), rtol=1e-6)
    assert np.all((found.upper - found.lower).abs() < 1e-5 * found.centre.abs())


def test_fit_returns_the_centre_and_the_set(twin):
    problem = Problem(twin, axes.emps().with_terms("inertia", "asymmetric-friction"))
    fit = SetMembership(bound=40.0).fit(problem)
    assert fit.converged and fit.extras["set"].contains(twin.theta_true)
    np.testing.assert_allclose(fit.params, fit.extras["set"].centre)
    assert "Feasible set" in fit.extras["set"]._repr_html_()
    with pytest.warns(ConvergenceWarning, match="set-membership has not converged"):
        falsified = SetMembership(bound=5.0).fit(problem)
    assert any("contradict" in note for note in falsified.notes)
    sweep = SetMembership().sweep(problem, [5.0, 35.0, 45.0])
    assert sweep["set", "empty"].tolist() == [True, False, False]
    width = sweep["inertia", "upper"] - sweep["inertia", "lower"]
    assert np.isnan(width[5.0]) and width[35.0] < width[45.0]


def test_bad_input_is_refused():
    with pytest.raises(EstimationError, match="bound = -1.0 must be positive"):
        SetMembership(bound=-1.0)
    with pytest.raises(EstimationError, match="margin = 1.0 must be above 1"):
        SetMembership(margin=1.0)
    with pytest.raises(EstimationError, match="must be positive in every row"):
        FeasibleSet.of(np.ones((2, 1)), [1.0, 1.0], [1.0, 0.0])
    with pytest.raises(EstimationError, match="unbounded"):
        FeasibleSet.of(np.ones((5, 2)), np.ones(5), 1.0)
    with pytest.raises(ShapeError, match="need"):
        FeasibleSet.of(np.ones(5), np.ones(5), 1.0)
