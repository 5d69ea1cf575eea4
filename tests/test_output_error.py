"""Output error: noise-free recovery, the open loop, figures of the EMPS."""

from dataclasses import replace

import numpy as np
import pytest

import ivtools as iv
from ivtools.errors import RecordError
from ivtools.estimators import CLIE, CLOE, OLOE
from ivtools.estimators.output_error import open_loop
from ivtools.estimators.sensitivities import SimulatedSignal

TRUE = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}


@pytest.fixture(scope="module")
def exact(twin):
    loop = iv.axes.emps()
    record = loop.simulate(twin, TRUE, initial="rest").to_record(q_ref=twin.q_ref)
    return iv.Problem(record, loop, simulation={"initial": "rest"})


@pytest.mark.parametrize("signal", ["position", "velocity", "force"])
def test_closed_loop_returns_the_parameters_of_a_simulated_record(exact, signal):
    fit = CLOE(signal=signal, start={"inertia": 300.0, "coulomb": 60.0}).fit(exact)
    np.testing.assert_allclose(fit.params, list(TRUE.values()), rtol=1e-5)
    assert fit.converged


def test_the_open_loop_repeats_a_simulated_record(exact):
    problem = open_loop(replace(exact, simulation={}))
    simulation = problem.simulate(TRUE)
    np.testing.assert_allclose(simulation.q, exact.record.q, atol=1e-9)
    np.testing.assert_array_equal(simulation.nu, exact.record.nu)


def test_open_loop_returns_the_parameters_of_a_simulated_record(exact):
    fit = OLOE(starts=1).fit(replace(exact, simulation={}))
    np.testing.assert_allclose(fit.params, list(TRUE.values()), rtol=2e-3)


def test_the_open_loop_needs_no_reference(exact):
    record = exact.record.replace(q_ref=None)
    problem = iv.Problem(record, exact.loop, exact.pipeline)
    fit = OLOE(starts=1, start=TRUE).fit(problem)
    np.testing.assert_allclose(fit.params, list(TRUE.values()), rtol=2e-3)
    with pytest.raises(RecordError, match="q_ref is missing"):
        CLOE(start=TRUE).fit(problem)


def test_added_inputs_are_part_of_the_command(twin):
    added = np.zeros((twin.n_samples, 1))
    added[5000:5020] = 2.0
    loop, record = iv.axes.emps(), twin.replace(added=added)
    sim = loop.simulate(record, TRUE, initial="rest")
    pulsed = sim.to_record(q_ref=twin.q_ref, added=added)
    simulation = open_loop(iv.Problem(pulsed, loop)).simulate(TRUE)
    np.testing.assert_allclose(simulation.q, pulsed.q, atol=1e-9)


@pytest.mark.filterwarnings("ignore:oloe has not converged")
def test_figures_of_the_measured_axis(emps):
    """The open loop's minimum is flat and rugged: its recomputed figures to 5 %, if no more."""
    problem = iv.Problem(emps, iv.axes.emps())
    closed, opened = CLOE().fit(problem), OLOE(starts=1).fit(problem)
    np.testing.assert_allclose(closed.params, [94.88, 217.45, 19.365, -3.1641], rtol=2e-3)
    assert closed.converged
    assert closed.relative_error < 0.0017  # of the position, in per cent
    expected = np.array([90.31, 182.19, 22.98, -3.38])
    np.testing.assert_allclose(opened.params, expected, rtol=0.05)


def test_output_and_input_error_agree_within_their_deviations(emps):
    problem = iv.Problem(emps, iv.axes.emps())
    inner, outer = CLIE().fit(problem), CLOE().fit(problem)
    gap = (inner.params - outer.params).abs()
    assert (gap < 3.0 * np.hypot(inner.std_errors, outer.std_errors)).all()


def test_further_starting_points_are_the_same_ones_every_time(exact):
    points, _ = OLOE(starts=4)._starting_points(exact, exact.names)
    again, _ = OLOE(starts=4)._starting_points(exact, exact.names)
    assert len(points) == 4
    assert points == again
    assert points[0] != points[1]


def test_measured_and_simulated_position_take_the_same_way(exact):
    signal = SimulatedSignal(exact, exact.names, {}, "position")
    np.testing.assert_allclose(signal(np.array(list(TRUE.values()))), signal.measured, atol=1e-12)


def test_the_figure_names_the_signal(exact):
    fit = CLOE().fit(exact)
    above, below = fit.plot().axes
    assert above.get_ylabel() == "position, m"
    assert "error" in below.get_ylabel()
    assert "the error is that of the simulated position" in fit.notes
