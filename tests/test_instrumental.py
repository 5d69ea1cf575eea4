"""Instrumental variables: published numbers, far starts, failures, and what compensation does."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from linearmodels.iv import IV2SLS

import ivtools as iv
from ivtools.errors import ConvergenceWarning, EstimationError
from ivtools.estimators.alignment import aligned, force_shift
from ivtools.estimators.compensated import IDIMBCIV, settled_rows
from ivtools.estimators.instrumental import IDIMIV
from ivtools.estimators.least_squares import IDIMLS
from ivtools.pipeline import Pipeline
from ivtools.study.named import load

REPORT = Pipeline(100.0, 10, trim=(49, 0))
# the published simulation: from rest, no zero-crossing detection, a tenth of a sample per step
PUBLISHED = {"initial": (0.0, 0.0), "stiction": False, "substeps": 10}
ASYMMETRIC = ("inertia", "asymmetric-friction")
NEAR = {"inertia": 50.0, "viscous": 50.0, "coulomb": 5.0, "offset": 0.0}
FAR = {"inertia": 500.0, "viscous": 100.0, "coulomb": 50.0, "offset": 10.0}


@pytest.fixture(scope="module")
def problem(twin):
    return iv.Problem(twin, iv.axes.emps().with_terms(*ASYMMETRIC))


@pytest.fixture(scope="module")
def exact(twin):
    """The twin without noise."""
    loop = iv.axes.emps().with_terms(*ASYMMETRIC)
    simulation = loop.simulate(twin, twin.theta_true, initial="rest")
    record = twin.replace(q=simulation.q, nu=simulation.nu)
    return iv.Problem(record, loop, simulation={"initial": "rest"})


def close(fit, expected, rtol):
    np.testing.assert_allclose(fit.params.to_numpy(), expected, rtol=rtol)


# --- published numbers on the measured record -----------------------------------------------------


@pytest.mark.parametrize("start", [NEAR, FAR], ids=["near", "far"])
def test_published_estimate_in_four_iterations(emps, start):
    problem = iv.Problem(emps, iv.axes.emps(), REPORT, simulation=PUBLISHED)
    fit = IDIMIV(start=start, filtered=False, cov_type="classical").fit(problem)
    found = [round(value, digits) for value, digits in zip(fit.params, (4, 3, 4, 4), strict=True)]
    assert found == [95.1779, 203.331, 20.4107, -3.1646]  # every printed digit
    np.testing.assert_allclose(fit.std_errors, [0.1088, 1.1491, 0.1015, 0.0444], rtol=1e-3)
    assert fit.converged
    assert fit.n_iter <= 4


@pytest.mark.parametrize("start", [NEAR, FAR, "axis", "ls"], ids=str)
def test_exact_standstill_moves_it_by_less_than_a_thousandth(emps, start):
    problem = iv.Problem(emps, iv.axes.emps(), REPORT)
    fit = IDIMIV(start=start, filtered=False).fit(problem)
    close(fit, [95.1779, 203.331, 20.4107, -3.1646], rtol=3e-4)
    close(fit, [95.1796, 203.3828, 20.4056, -3.16457], rtol=1e-5)
    assert fit.converged
    assert fit.n_iter <= 4


def test_published_asymmetric_estimate(emps):
    loop = iv.axes.emps().with_terms(*ASYMMETRIC)
    fit = IDIMIV(filtered=False).fit(iv.Problem(emps, loop, REPORT))
    close(fit, [95.223, 166.43, 20.171, 240.43, 20.627], rtol=2e-4)
    assert fit.relative_error == pytest.approx(3.112, abs=5e-4)


def test_instruments_must_be_filtered_as_the_regressor_is(emps):
    """At a cut-off that bites, unfiltered instruments move the inertia by 3 %."""
    problem = iv.Problem(emps, iv.axes.emps(), replace(REPORT, cutoff_hz=20.0))
    unfiltered, filtered = IDIMIV(filtered=False).fit(problem), IDIMIV().fit(problem)
    compensated = IDIMBCIV().fit(problem)
    assert unfiltered.params["inertia"] > 97.5
    assert compensated.params["inertia"] == pytest.approx(
        IDIMBCIV().fit(iv.Problem(emps, iv.axes.emps(), REPORT)).params["inertia"], rel=0.01
    )
    assert filtered.converged


def test_compensation_explains_part_of_the_measured_residual(emps):
    problem = iv.Problem(emps, iv.axes.emps().with_terms(*ASYMMETRIC), REPORT)
    assert IDIMBCIV().fit(problem).relative_error < 0.95 * IDIMIV().fit(problem).relative_error


# --- the estimate itself --------------------------------------------------------------------------


@pytest.mark.parametrize("estimator", [IDIMIV(), IDIMBCIV()], ids=lambda e: e.key)
def test_estimate_and_errors_are_those_of_linearmodels(problem, estimator):
    fit = estimator.fit(problem)
    oracle = IV2SLS(fit.y, None, fit.X, fit.Z)
    robust = oracle.fit(cov_type="robust")
    np.testing.assert_allclose(fit.params, robust.params, rtol=1e-8)
    np.testing.assert_allclose(fit.with_cov("robust").std_errors, robust.std_errors, rtol=1e-8)
    kernel = oracle.fit(cov_type="kernel", kernel="bartlett", bandwidth=8)
    np.testing.assert_allclose(fit.with_cov("hac", 8).std_errors, kernel.std_errors, rtol=1e-8)
    plain = oracle.fit(cov_type="unadjusted")
    classical = fit.with_cov("classical", debiased=False)
    np.testing.assert_allclose(classical.std_errors, plain.std_errors, rtol=1e-8)


def test_without_noise_compensation_returns_the_truth(exact):
    truth = list(exact.record.theta_true.values())
    close(IDIMBCIV(tol=1e-7).fit(exact), truth, rtol=2e-6)
    plain = IDIMIV().fit(exact).params / truth - 1.0
    assert 1e-3 < plain.abs().max() < 0.02  # what no instrument removes


def test_far_starts_end_where_near_ones_do(problem):
    truth = IDIMBCIV(tol=1e-7).fit(problem)
    for estimator in (IDIMIV, IDIMBCIV):
        near = estimator(tol=1e-7).fit(problem)
        far = estimator(tol=1e-7, start={"inertia": 500.0, "coulomb_pos": 50.0}).fit(problem)
        light = estimator(tol=1e-7, start={"inertia": 10.0}).fit(problem)
        slack = 1e-6 * near.params if estimator is IDIMIV else 0.02 * near.std_errors  # X is held
        assert ((far.params - near.params).abs() < slack).all()
        assert ((light.params - near.params).abs() < slack).all()
    np.testing.assert_allclose(truth.params, near.params, rtol=1e-6)


def test_the_gain_is_scaled_on_the_way_and_not_at_the_end(problem):
    """A start value of the axis file that is wrong leaves no trace in the estimate."""
    wrong = replace(problem.loop, start={"inertia": 60.0})
    fits = [IDIMIV(tol=1e-6).fit(replace(problem, loop=loop)) for loop in (wrong, problem.loop)]
    np.testing.assert_allclose(fits[0].params, fits[1].params, rtol=1e-6)


def test_results_hold_what_was_solved(problem):
    fit = IDIMBCIV().fit(problem)
    kept = settled_rows(problem)
    np.testing.assert_array_equal(fit.X.shape, (len(kept), 5))
    np.testing.assert_allclose(fit.Z.T @ fit.resids / np.linalg.norm(fit.Z, axis=0), 0, atol=1e-8)
    np.testing.assert_array_equal(fit.t, problem.t[kept])
    np.testing.assert_array_equal(IDIMLS().fit(problem).t, problem.t)
    assert fit.n_simulations == fit.n_iter
    assert "simulated loop makes as well" in fit.notes[0]
    assert kept[0] == 3
    assert kept[-1] < len(problem.y) - 3


# --- the direction of motion ----------------------------------------------------------------------


def test_the_direction_of_motion_is_the_axis_own(problem):
    """Noise of the encoder alone, that the command does not know of, turns no row around."""
    record, truth = problem.record, problem.record.theta_true
    noise = np.random.default_rng(3).normal(0.0, 1e-5, record.q.shape)
    full = replace(problem, pipeline=replace(problem.pipeline, decimation=1))
    noisy = replace(full, record=record.replace(q=record.q + noise))
    np.testing.assert_array_equal(noisy.paired_rows(truth).y, noisy.y)
    clean, ahead = full.paired_rows(truth).X[:, 2], noisy.paired_rows(truth).X[:, 2]
    turned = np.count_nonzero(np.abs(ahead - clean) > 0.5)
    assert turned < 0.4 * np.count_nonzero(np.abs(noisy.X[:, 2] - clean) > 0.5)


# --- robust and weighted forms --------------------------------------------------------------------


def test_huber_weights_resist_gross_errors(problem):
    nu = problem.record.nu.copy()
    nu[5000:20000:500] += 60.0
    struck = replace(problem, record=problem.record.replace(nu=nu))
    plain, robust, clean = (
        f.fit(p).params
        for f, p in [
            (IDIMIV(), struck),
            (IDIMIV(robust="huber", weighted=True), struck),
            (IDIMIV(), problem),
        ]
    )
    assert np.linalg.norm(robust / clean - 1.0) < 0.35 * np.linalg.norm(plain / clean - 1.0)


def test_with_one_joint_weights_change_nothing(problem):
    plain, weighted = IDIMIV(tol=1e-6).fit(problem), IDIMIV(tol=1e-6, weighted=True).fit(problem)
    np.testing.assert_allclose(weighted.params, plain.params, rtol=1e-8)
    np.testing.assert_allclose(weighted.std_errors, plain.std_errors, rtol=1e-6)


# --- failures -------------------------------------------------------------------------------------


def test_too_few_iterations_are_said(problem):
    with pytest.warns(ConvergenceWarning, match="idim-iv has not converged in 1 iterations"):
        fit = IDIMIV(max_iter=1).fit(problem)
    assert not fit.converged


@pytest.mark.parametrize(
    "start", [{"inertia": 0.5}, {"inertia": -30.0}, {"coulomb_pos": 1e4, "coulomb_neg": 1e4}]
)
@pytest.mark.parametrize("scale_gain", [True, False])
def test_a_start_that_cannot_be_simulated_is_led_back(problem, start, scale_gain):
    fit = IDIMIV(start=start, scale_gain=scale_gain).fit(problem)
    np.testing.assert_allclose(fit.params, IDIMIV().fit(problem).params, rtol=1e-3)
    assert fit.n_simulations >= fit.n_iter


def test_a_loop_that_is_never_stable_is_not_an_exception(problem):
    loop = replace(problem.loop, controller=problem.loop.controller.scaled(1e3))
    wild = replace(problem, loop=replace(loop, controller=replace(loop.controller, limit=np.inf)))
    with pytest.warns(ConvergenceWarning):
        fit = IDIMIV().fit(wild)
    assert not fit.converged
    assert any("failed" in note for note in fit.notes)
    np.testing.assert_allclose(fit.params, IDIMLS().fit(wild).params)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"tol": 0.0}, "tol = 0.0 must lie between 0 and 1"),
        ({"max_iter": 0}, "max_iter = 0 must be 1 or more"),
        ({"robust": "tukey"}, "robust = 'tukey' is unknown"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, message):
    with pytest.raises(EstimationError, match=message):
        IDIMIV(**settings)


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ("cad", "start = 'cad' is unknown; use 'axis', 'ls'"),
        ({"mass": 1.0}, "start names mass; the parameters are inertia, viscous_pos"),
        ({"inertia": np.nan}, "must be finite"),
    ],
)
def test_starts_that_make_no_sense_are_refused(problem, start, message):
    with pytest.raises(EstimationError, match=message):
        IDIMIV(start=start).fit(problem)


# --- alignment ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("delay", "expected"), [(0.0, 0.5), (0.0004, 0.9), (0.0015, 2.0)])
def test_the_delay_of_the_force_is_found(twin, delay, expected):
    loop = replace(iv.axes.emps().with_terms(*ASYMMETRIC), delay=delay)
    rng = np.random.default_rng(6)
    noise = rng.normal(0.0, 1e-6, twin.n_samples)
    simulation = loop.simulate(twin, twin.theta_true, initial="rest", position_noise=noise)
    record = twin.replace(q=simulation.q, nu=simulation.nu)
    problem = iv.Problem(record, loop)
    assert force_shift(problem) == pytest.approx(expected, abs=0.1)
    assert aligned(problem).pipeline.force_shift == force_shift(problem)
    better, before = (IDIMIV().fit(p).relative_error for p in (aligned(problem), problem))
    assert better < before


def test_an_empty_search_is_refused(problem):
    with pytest.raises(EstimationError, match="search = \\(1, 1\\) is empty"):
        force_shift(problem, search=(1, 1))


def sticking():
    """An axis that sticks between short moves; encoder and force are noisy."""
    return next(case for case in load("axes").cases if case.name == "axis valve, noise white")


def test_noise_does_not_choose_the_rows_of_a_sticking_axis():
    case = sticking()
    pipeline = case.rows
    problems = [iv.Problem(case.record(seed), case.loop, pipeline) for seed in (1, 2)]
    chosen = [problem.masked_by(case.theta) for problem in problems]
    assert not np.array_equal(problems[0].t, problems[1].t)
    np.testing.assert_array_equal(chosen[0].t, chosen[1].t)
    fit = iv.IDIMIV().fit(problems[0], check=False)
    assert not np.array_equal(fit.t, problems[0].t)
    assert fit.problem is problems[0]


@pytest.mark.slow
def test_friction_of_a_sticking_axis_is_unbiased():
    """Where the measured motion chose the rows, it was off by one deviation (24 records)."""
    case, fits = sticking(), []
    for seed in range(24):
        problem = case.problem(case.record(seed))
        fits.append(iv.IDIMIV().fit(problem, check=False).params)
    error = pd.DataFrame(fits) - pd.Series(case.theta)
    assert (error.mean().abs() < 3.0 * error.std() / np.sqrt(24)).all()
