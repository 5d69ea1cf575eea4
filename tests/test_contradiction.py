"""Instruments deny what noise has biased, or what settled elsewhere, and nothing else."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ivtools as iv
from ivtools.errors import ConvergenceWarning
from ivtools.estimators import CLOE, OLOE
from ivtools.estimators.base import estimator_class
from ivtools.estimators.contradiction import checked, correction
from ivtools.estimators.output_error import holds_position
from ivtools.study.named import load

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.axes.population import population  # noqa: E402


def case(axis, noise):
    cases = load("axes", seeds=1).cases
    return next(c for c in cases if c.factors["axis"] == axis and c.factors["noise"] == noise)


def problem_of(axis, noise, seed=70):
    found = case(axis, noise)
    return iv.Problem(found.record(seed), found.loop), np.array(list(found.theta.values()))


@pytest.fixture(scope="module")
def hinge():
    return problem_of("hinge", "white")  # 2000 counts per turn


@pytest.mark.parametrize("method", ["idim-ls", "idim-wls", "ml", "lmi-ls"])
def test_least_squares_with_a_coarse_encoder_is_contradicted(hinge, method):
    problem, _ = hinge
    with pytest.warns(ConvergenceWarning, match="contradicted by instruments"):
        fit = estimator_class(method)().fit(problem)
    assert not fit.converged and np.isnan(fit.std_errors).all()
    assert "contradicted by instruments: inertia is -" in fit.notes[1]
    plain = estimator_class(method)().fit(problem, check=False)
    assert plain.converged and (plain.params == fit.params).all()


def test_what_noise_does_not_bias_is_not_contradicted(hinge):
    problem, true = hinge
    for method in (iv.IDIMIV(), iv.IDIMBCIV(), iv.DIDIM(), iv.CLIE()):
        fit = method.fit(problem)
        assert fit.converged and np.abs((fit.params - true) / fit.std_errors).max() < 4.0
    for quiet in (problem_of("hinge", "none")[0], problem_of("slide", "white")[0]):
        assert iv.IDIMLS().fit(quiet).converged


def test_least_squares_of_the_measured_records_is_not_contradicted(emps, emps_pulses):
    for record in (emps, emps_pulses):
        assert iv.IDIMLS().fit(iv.Problem(record, iv.axes.emps())).converged


def test_a_solution_that_is_not_the_axis_is_contradicted(hinge):
    problem, _ = hinge
    sure = iv.IDIMIV().fit(problem)
    for scale, converged in ((1.0, True), (1.4, False)):
        other = sure.params * [scale, 1.0, 1.0, 1.0]
        fit = replace(sure, method="didim", params=other, Z=None)
        assert checked(fit, problem).converged == converged


def test_one_step_of_instruments_leads_to_the_truth(hinge):
    problem, true = hinge
    theta = iv.IDIMLS().fit(problem, check=False).params.to_numpy()
    moved, sure = correction(problem, theta)
    assert abs(moved[0] / sure[0]) > 4.0  # the inertia is far off by least squares
    fit = iv.IDIMIV().fit(problem)
    assert np.abs((theta + moved - fit.params) / fit.std_errors).max() < 0.5


@pytest.mark.parametrize("seed", [1000, 1001])
def test_steps_that_circle_are_averaged(seed):
    """On the valve, which sticks, theta moved by a percent for ever; its errors are larger."""
    problem, true = problem_of("valve", "force", seed)
    fit = iv.IDIMIV().fit(problem)
    assert fit.converged and fit.n_iter < 20
    assert np.abs((fit.params - true) / fit.std_errors).max() < 4.0


def test_behind_a_velocity_loop_the_velocity_is_compared():
    for case in population(2, seed=40, law="p-velocity", noise="white", stiction=False):
        problem = iv.Problem(case.record(0), case.loop)
        fit = CLOE().fit(problem)
        assert not holds_position(problem.loop, problem.record.dt)
        assert fit.converged and fit.signal == "velocity"
        error = fit.params - list(case.theta.values())
        assert np.abs(error / fit.std_errors).max() < 4.0
    assert holds_position(iv.axes.emps(), 1e-3)


def test_an_error_that_drifts_has_no_standard_errors():
    noisy = case("conveyor", "white")
    problem = iv.Problem(noisy.record(71), noisy.loop)
    fit = CLOE(signal="position").fit(problem)
    assert not fit.converged and any("drifts" in note for note in fit.notes)
    quiet = replace(noisy, encoder_noise=0.0, quantum=0.0, force_noise=0.0)
    fit = OLOE(starts=1).fit(iv.Problem(quiet.record(0), quiet.loop))
    assert not any("drifts" in note for note in fit.notes)
