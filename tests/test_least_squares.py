"""Least squares: weights of the joints, Huber's weights, the register, reduction."""

import warnings
from dataclasses import dataclass, fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
import statsmodels.api as sm

from ivtools import estimators
from ivtools.errors import ConvergenceWarning, EstimationError
from ivtools.estimators import METHODS, Estimator, reduce
from ivtools.estimators.base import estimator_class
from ivtools.estimators.least_squares import IDIMLS, IDIMWLS, joint_weights


@dataclass(frozen=True, eq=False)
class Stub:
    """A problem that is nothing but its matrices."""

    X: np.ndarray
    y: np.ndarray
    names: tuple = ("inertia", "viscous", "offset")
    units: tuple = ("kg", "N s/m", "N")
    row_joints: np.ndarray | None = None

    def select(self, names):
        kept = [self.names.index(name) for name in names]
        units = tuple(self.units[i] for i in kept)
        return replace(self, X=self.X[:, kept], names=tuple(names), units=units)


@pytest.fixture
def problem():
    rng = np.random.default_rng(1)
    X = np.column_stack([rng.standard_normal((600, 2)), np.ones(600)])
    joints = np.repeat([0, 1], 300)
    y = X @ [3.0, 0.5, -1.0] + rng.standard_normal(600) * np.where(joints, 5.0, 0.1)
    return Stub(X, y, row_joints=joints)


def test_least_squares_is_that_of_statsmodels(problem):
    fit = IDIMLS(cov_type="robust").fit(problem)
    expected = sm.OLS(problem.y, problem.X).fit(cov_type="HC0")
    np.testing.assert_allclose(fit.params, expected.params, rtol=1e-10)
    np.testing.assert_allclose(fit.std_errors, expected.bse, rtol=1e-10)
    np.testing.assert_allclose(fit.resids, expected.resid, atol=1e-12)
    np.testing.assert_allclose(fit.pvalues, expected.pvalues, rtol=1e-8, atol=1e-300)
    np.testing.assert_allclose(fit.conf_int(0.1), expected.conf_int(0.1), rtol=1e-8)
    assert fit.method == "idim-ls"
    assert fit.units == problem.units
    assert fit.problem is problem
    assert fit.runtime > 0


def test_weights_are_the_inverse_variances_of_the_joints(problem):
    fit = IDIMWLS().fit(problem)
    e = IDIMLS().fit(problem).resids
    for _ in range(20):
        sigma = np.where(problem.row_joints, np.mean(e[300:] ** 2), np.mean(e[:300] ** 2)) ** 0.5
        expected = sm.WLS(problem.y, problem.X, weights=1 / sigma**2).fit()
        e = expected.resid
    assert fit.converged
    np.testing.assert_allclose(fit.params, expected.params, rtol=1e-4)
    np.testing.assert_allclose(fit.weights[0], 1 / np.mean(e[:300] ** 2), rtol=1e-3)
    np.testing.assert_allclose(fit.weights[-1], 1 / np.mean(e[300:] ** 2), rtol=1e-3)
    assert fit.std_errors["viscous"] < 0.1 * IDIMLS().fit(problem).std_errors["viscous"]


def test_with_one_joint_the_weights_change_nothing(problem):
    single = replace(problem, row_joints=np.zeros(600, dtype=int))
    np.testing.assert_allclose(
        IDIMWLS().fit(single).params, IDIMLS().fit(single).params, rtol=1e-12
    )
    np.testing.assert_allclose(IDIMWLS().fit(single).cov, IDIMLS().fit(single).cov, rtol=1e-8)


def test_a_joint_without_error_keeps_a_finite_weight():
    weights = joint_weights(np.array([0.0, 0.0, 1.0, -1.0]), np.array([0, 0, 1, 1]))
    assert np.isfinite(weights).all()
    assert joint_weights(np.zeros(4), np.array([0, 0, 1, 1])).tolist() == [1, 1, 1, 1]


def test_huber_weights_resist_gross_errors(problem):
    y = problem.y.copy()
    y[::20] += 300.0
    struck = replace(problem, y=y, row_joints=np.zeros(600, dtype=int))
    plain, robust = IDIMWLS().fit(struck), IDIMWLS(robust="huber").fit(struck)
    expected = sm.RLM(y, problem.X).fit(maxiter=100)
    np.testing.assert_allclose(robust.params, expected.params, rtol=1e-6)
    assert abs(robust.params["offset"] + 1.0) < 0.2 < abs(plain.params["offset"] + 1.0)
    assert robust.converged
    assert robust.n_iter > 1


def test_an_iteration_that_stops_early_says_so(problem):
    with pytest.warns(ConvergenceWarning, match="idim-wls has not converged in 2 iterations"):
        fit = IDIMWLS(robust="huber", max_iter=2).fit(problem)
    assert not fit.converged


def test_dependent_columns_are_named(problem):
    twice = replace(problem, X=problem.X[:, [0, 0, 2]])
    with pytest.raises(EstimationError, match="inertia|viscous"):
        IDIMLS().fit(twice)


def test_settings_that_make_no_sense_are_refused(problem):
    with pytest.raises(EstimationError, match="robust = 'tukey' is unknown"):
        IDIMWLS(robust="tukey")
    with pytest.raises(EstimationError, match="cov_type = 'hc3' is unknown"):
        IDIMLS(cov_type="hc3").fit(problem)


def test_a_fit_changes_neither_the_estimator_nor_the_problem(problem):
    estimator, before = IDIMLS(), (problem.X.copy(), problem.y.copy())
    first, second = estimator.fit(problem), estimator.fit(problem)
    assert estimator == IDIMLS()
    np.testing.assert_array_equal(first.params, second.params)
    np.testing.assert_array_equal(problem.X, before[0])
    np.testing.assert_array_equal(problem.y, before[1])


def test_every_registered_method_is_an_estimator_with_its_key():
    for key in METHODS:
        cls = estimator_class(key)
        assert issubclass(cls, Estimator)
        assert cls.key == key
        assert getattr(estimators, cls.__name__) is cls
        assert cls() == cls()
        assert "cov_type" in {field.name for field in fields(cls)}
    with pytest.raises(EstimationError, match="method 'ols' is unknown; use one of idim-ls"):
        estimator_class("ols")
    with pytest.raises(AttributeError, match="no attribute 'IDIMXX'"):
        estimators.IDIMXX  # noqa: B018


def test_reduction_drops_the_least_significant_until_all_are_significant(problem):
    rng = np.random.default_rng(2)
    noise = rng.standard_normal((600, 2))
    wide = Stub(
        np.column_stack([problem.X, noise]),
        problem.X @ [3.0, 0.5, -1.0] + 0.1 * rng.standard_normal(600),
        names=("inertia", "viscous", "offset", "cogging", "gravity"),
        units=("",) * 5,
    )
    fit = reduce(wide, IDIMLS(), limit=10.0)
    assert fit.names == ("inertia", "viscous", "offset")
    assert [note.split(":")[0] for note in fit.notes if "dropped" in note] in (
        ["dropped cogging", "dropped gravity"],
        ["dropped gravity", "dropped cogging"],
    )
    assert fit.relative_std.max() <= 10.0
    assert reduce(wide, IDIMLS(), limit=1e9).names == wide.names
    assert len(reduce(wide, IDIMLS(), limit=1e-9).names) == 1


def test_no_warning_where_everything_converges(problem):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        IDIMLS().fit(problem)
        IDIMLS().fit(SimpleNamespace(X=problem.X, y=problem.y, names="abc", units="abc"))
