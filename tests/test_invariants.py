"""What must hold whatever the numbers are: for every method, model and system of units."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import ivtools as iv
from ivtools.errors import ConvergenceWarning
from ivtools.estimators import METHODS
from ivtools.estimators.base import estimator_class
from ivtools.estimators.compensated import IDIMBCIV
from ivtools.estimators.instrumental import IDIMIV
from ivtools.estimators.least_squares import IDIMLS
from ivtools.estimators.refined import IDIMPIV
from ivtools.linalg import solve_iv
from ivtools.record import Record

MODELS = {
    "symmetric": {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0},
    "asymmetric": {
        "inertia": 95.0,
        "viscous_pos": 165.0,
        "coulomb_pos": 20.0,
        "viscous_neg": 240.0,
        "coulomb_neg": 21.0,
    },
    "viscous": {"inertia": 95.0, "viscous": 200.0, "offset": 2.0},
}
TERMS = {
    "symmetric": ("inertia", "viscous", "coulomb", "offset"),
    "asymmetric": ("inertia", "asymmetric-friction"),
    "viscous": ("inertia", "viscous", "offset"),
}
# Methods whose equations hold exactly on a record without noise, and how exactly they solve them.
# The others take a held command and a low-passed motion for simultaneous.
EXACT = {"idim-bciv": 1e-5, "idim-piv": 1e-5, "clie": 1e-4, "cloe": 1e-4, "oloe": 1e-4}
# A set of feasible parameters, and a random search that is as good as its population is large,
# have tests of their own.
POINTS = [method for method in METHODS if method not in ("set-membership", "nsga2")]
REGRESSIONS = [IDIMLS(), IDIMIV(tol=1e-8), IDIMBCIV(tol=1e-8), IDIMPIV(tol=1e-8)]


@cache
def short_record(model: str, noisy: bool = False) -> Record:
    """Eight seconds of the twin's motion, simulated with a model."""
    twin = iv.datasets.twin().slice(0, 8000)
    rng, n = np.random.default_rng(5), 8000
    noise = {"position_noise": rng.normal(0, 1e-6, n), "force_noise": rng.normal(0, 1.0, n)}
    simulation = (
        iv.axes.emps()
        .with_terms(*TERMS[model])
        .simulate(twin, MODELS[model], initial="rest", **(noise if noisy else {}))
    )
    return Record(twin.t, simulation.q, q_ref=twin.q_ref, nu=simulation.nu)


def problem_of(model: str, noisy: bool = False) -> iv.Problem:
    loop = iv.axes.emps().with_terms(*TERMS[model])
    return iv.Problem(short_record(model, noisy), loop, simulation={"initial": "rest"})


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("method", POINTS)
def test_without_noise_every_method_returns_the_truth(method, model):
    fit = estimator_class(method)().fit(problem_of(model))
    truth = MODELS[model]
    tolerance = EXACT.get(method, 0.03)
    for name in truth:
        assert fit.params[name] == pytest.approx(truth[name], rel=tolerance, abs=tolerance), name


# --- instruments ----------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    p=st.integers(1, 5),
    scales=st.lists(st.floats(-6, 6), min_size=5, max_size=5),
)
def test_instruments_that_are_the_regressor_give_least_squares(seed, p, scales):
    rng = np.random.default_rng(seed)
    columns, y = rng.standard_normal((40, p)), rng.standard_normal(40)
    X = columns * 10.0 ** np.array(scales[:p])
    ls = solve_iv(X, y)
    np.testing.assert_allclose(solve_iv(X, y, X), ls, rtol=1e-9)
    mixed = columns @ (np.eye(p) + np.triu(np.ones((p, p)), 1))  # the same space
    np.testing.assert_allclose(solve_iv(X, y, mixed), ls, rtol=1e-6)


# --- units ----------------------------------------------------------------------------------------


def in_units(problem: iv.Problem, length: float, force: float) -> iv.Problem:
    """The same axis with lengths and forces in other units; the command stays in volts."""
    record, loop = problem.record, problem.loop
    scaled = record.replace(q=record.q * length, q_ref=record.q_ref * length)
    law = dict(loop.controller.settings)
    law["kv"] = law["kv"] / length
    start = {"inertia": loop.start["inertia"] * force / length}
    return replace(
        problem,
        record=scaled,
        loop=replace(
            loop,
            gain=loop.gain * force,
            controller=replace(loop.controller, settings=law),
            start=start,
        ),
    )


def factors(names, length, force):
    rates = ("inertia", "viscous")
    return np.array([force / length if n.startswith(rates) else force for n in names])


@pytest.mark.parametrize("estimator", REGRESSIONS, ids=lambda e: e.key)
@settings(max_examples=4, deadline=None)
@given(length=st.sampled_from([1e3, 1e-2, 57.3]), force=st.sampled_from([1e-3, 1e-6, 9.81]))
def test_units_scale_the_result_and_change_nothing_else(estimator, length, force):
    problem = problem_of("asymmetric", noisy=True)
    fit, other = estimator.fit(problem), estimator.fit(in_units(problem, length, force))
    scale = factors(problem.names, length, force)
    np.testing.assert_allclose(other.params, fit.params * scale, rtol=1e-5)
    np.testing.assert_allclose(other.std_errors, fit.std_errors * scale, rtol=1e-4)
    assert other.relative_error == pytest.approx(fit.relative_error, rel=1e-5)
    assert other.n_iter == fit.n_iter


@pytest.mark.parametrize("estimator", REGRESSIONS, ids=lambda e: e.key)
def test_an_axis_of_a_ten_thousandth_is_as_good_as_any(estimator):
    problem = problem_of("symmetric", noisy=True)
    small = in_units(problem, 1.0, 1e-4 / 95.0)
    fit, other = estimator.fit(problem), estimator.fit(small)
    assert other.params["inertia"] == pytest.approx(1e-4, rel=0.02)
    np.testing.assert_allclose(other.params, fit.params * 1e-4 / 95.0, rtol=1e-5)
    assert other.converged == fit.converged


# --- two halves -----------------------------------------------------------------------------------


def assert_halves_agree(record, loop, estimator, middle, pipeline=None, limit=4.0):
    parts = [record.slice(0, middle), record.slice(middle, record.n_samples)]
    pipeline = pipeline or loop.pipeline(record)
    fits = [estimator.fit(iv.Problem(part, loop, pipeline)) for part in parts]
    spread = np.hypot(fits[0].std_errors, fits[1].std_errors)
    assert ((fits[0].params - fits[1].params).abs() < limit * spread).all()
    assert all(fit.converged for fit in fits)


@pytest.mark.parametrize("estimator", REGRESSIONS, ids=lambda e: e.key)
def test_halves_of_a_record_agree(twin, estimator):
    loop = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    still = np.argmin(np.abs(np.gradient(twin.q_ref[11000:14000, 0]))) + 11000
    assert_halves_agree(twin, loop, estimator, int(still))


@pytest.mark.parametrize("estimator", REGRESSIONS[:3], ids=lambda e: e.key)
def test_halves_of_the_measured_record_agree(emps, estimator):
    loop = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    assert_halves_agree(emps, loop, estimator, emps.n_samples // 2)


@pytest.mark.parametrize("estimator", REGRESSIONS[:3], ids=lambda e: e.key)
def test_units_of_the_measured_record(emps, estimator):
    loop = iv.axes.emps()
    problem = iv.Problem(emps, loop)
    fit, other = estimator.fit(problem), estimator.fit(in_units(problem, 1e3, 1e-3))
    scale = factors(problem.names, 1e3, 1e-3)
    np.testing.assert_allclose(other.params, fit.params * scale, rtol=1e-5)
    np.testing.assert_allclose(other.std_errors, fit.std_errors * scale, rtol=1e-4)


def test_a_fit_leaves_the_problem_as_it_was():
    problem = problem_of("asymmetric", noisy=True)
    before = problem.X.copy(), problem.y.copy()
    first, second = IDIMBCIV().fit(problem), IDIMBCIV().fit(problem)
    np.testing.assert_array_equal(first.params, second.params)
    np.testing.assert_array_equal(problem.X, before[0])
    np.testing.assert_array_equal(problem.y, before[1])
    with pytest.warns(ConvergenceWarning):
        IDIMBCIV(max_iter=1).fit(problem)
