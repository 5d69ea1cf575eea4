"""Input error: figures of the EMPS, noise-free recovery, far starts, honest failure, bad input."""

from dataclasses import replace

import numpy as np
import pytest

import ivtools as iv
from ivtools.errors import ConvergenceWarning, EstimationError
from ivtools.estimators import CLIE, CLOE, DDMIV, DIDIM
from ivtools.estimators.sensitivities import SimulatedSignal, scans
from ivtools.linalg import solve_iv

SYMMETRIC = ("inertia", "viscous", "coulomb", "offset")
ASYMMETRIC = ("inertia", "asymmetric-friction")
NEAR = (50.0, 50.0, 5.0, 0.0)
FAR = (500.0, 100.0, 50.0, 10.0)
TRUE = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
TRUE_ASYMMETRIC = {
    "inertia": 95.0, "viscous_pos": 165.0, "coulomb_pos": 20.0, "viscous_neg": 240.0,
    "coulomb_neg": 21.0,
}  # fmt: skip


def named(values):
    return dict(zip(SYMMETRIC, values, strict=True))


def noise_free(twin, loop, theta, **effect):
    """The record of a loop that starts at rest, and the way to simulate it."""
    sim = loop.simulate(twin, theta, initial="rest")
    record = sim.to_record(q_ref=twin.q_ref)
    return iv.Problem(record, loop, simulation={"initial": "rest"})


@pytest.fixture(scope="module")
def exact(twin):
    return noise_free(twin, iv.axes.emps(), TRUE)


@pytest.fixture(scope="module")
def measured(emps):
    return iv.Problem(emps, iv.axes.emps())


# --- published and recomputed figures --------------------------------------------------------


def test_didim_is_the_recomputed_one_on_its_simulation(measured):
    """Simulated from (0, 0) without a rule of standstill, as the recomputed figures were."""
    chattering = {"initial": (0.0, 0.0), "stiction": False, "substeps": 10}
    fit = DIDIM(start=named(NEAR), tol=1e-6).fit(replace(measured, simulation=chattering))
    np.testing.assert_allclose(fit.params, [93.698, 207.867, 20.096, -3.1788], rtol=2e-5)
    assert fit.n_iter <= 7
    assert fit.converged


@pytest.mark.parametrize("start", [NEAR, FAR, (5.0, 50.0, 500.0, 50.0), (2000.0, 0.0, 0.0, 0.0)])
def test_didim_with_exact_standstill_from_any_start(measured, start):
    fit = DIDIM(start=named(start)).fit(measured)
    np.testing.assert_allclose(fit.params["inertia"], 93.698, rtol=1e-4)
    np.testing.assert_allclose(fit.params, [93.698, 207.867, 20.096, -3.1788], rtol=0.008)
    np.testing.assert_allclose(fit.params, DIDIM().fit(measured).params, rtol=2e-5)
    assert fit.converged
    assert fit.n_iter <= 6
    assert fit.n_simulations <= 8


def test_the_plain_iteration_loses_its_inertia_where_the_scaled_one_converges(measured):
    X, _ = measured.simulated_rows(FAR, filtered=False)
    assert solve_iv(X, measured.y)[0] < 0.0
    scaled, _ = measured.simulated_rows(FAR, filtered=False, scale_gain=True)
    assert abs(solve_iv(scaled, measured.y)[0] - 93.7) < 2.0


def test_shortened_steps_save_the_unscaled_iteration(measured):
    fit = DIDIM(start=named(FAR), scale_gain=False).fit(measured)
    np.testing.assert_allclose(fit.params, DIDIM().fit(measured).params, rtol=1e-4)
    assert "shortened" in fit.notes[0]


def test_didim_with_asymmetric_friction(emps):
    problem = iv.Problem(emps, iv.axes.emps().with_terms(*ASYMMETRIC))
    fit = DIDIM().fit(problem)
    np.testing.assert_allclose(fit.params, [93.740, 170.01, 19.943, 243.35, 20.480], rtol=2e-3)
    assert fit.relative_error == pytest.approx(5.124, abs=0.01)


def test_clie_finds_a_smaller_simulated_error_than_didim(measured):
    didim, clie = DIDIM().fit(measured), CLIE().fit(measured)
    _, y_s = measured.simulated_rows(didim.params, filtered=False)
    of_didim = 100.0 * np.linalg.norm(measured.y - y_s) / np.linalg.norm(measured.y)
    assert clie.relative_error < of_didim
    assert clie.relative_error == pytest.approx(5.685, abs=0.02)
    reach = 4.0 * clie.std_errors
    assert ((clie.params - didim.params).abs() < reach).all()


@pytest.mark.parametrize("start", [NEAR, FAR])
def test_clie_from_any_start(measured, start):
    fit = CLIE(start=named(start)).fit(measured)
    np.testing.assert_allclose(fit.params, CLIE().fit(measured).params, rtol=1e-4)


# --- without noise ----------------------------------------------------------------------------


def test_clie_returns_the_parameters_of_a_simulated_record(exact):
    fit = CLIE(start=named(FAR)).fit(exact)
    np.testing.assert_allclose(fit.params, list(TRUE.values()), rtol=1e-6)
    assert fit.converged


def test_clie_with_asymmetric_friction_returns_them_too(twin):
    problem = noise_free(twin, iv.axes.emps().with_terms(*ASYMMETRIC), TRUE_ASYMMETRIC)
    fit = CLIE().fit(problem)
    np.testing.assert_allclose(fit.params, list(TRUE_ASYMMETRIC.values()), rtol=1e-6)


def test_didim_is_right_but_for_the_hold_between_samples(exact):
    """X_s takes the acceleration at the start of the sample; a half one of lag is left."""
    fit = DIDIM().fit(exact)
    np.testing.assert_allclose(fit.params, list(TRUE.values()), rtol=0.02)


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("drive-timing", {"delay": 7e-4, "lag": 4e-4}),
        ("stribeck", {"force": 5.0, "speed": 0.01}),
    ],
)
def test_clie_estimates_what_no_regression_can(twin, effect, values):
    """Without a starting value: the scan finds one."""
    true = iv.axes.emps().with_effect(effect, **values)
    record = true.simulate(twin, TRUE, initial="rest").to_record(q_ref=twin.q_ref)
    problem = iv.Problem(record, iv.axes.emps().with_effect(effect), simulation={"initial": "rest"})
    fit = CLIE(starts=1).fit(problem)
    expected = {**TRUE, **{f"{effect}.{name}": v for name, v in values.items()}}
    for name, value in expected.items():
        assert fit.params[name] == pytest.approx(value, rel=1e-3), name
    assert fit.converged
    assert fit.units[-1] in ("s", "m/s")
    assert fit.cross_test(problem).relative < 20.0


def test_some_parameters_alone(exact):
    fit = CLIE(parameters=("inertia", "offset"), start={**TRUE, "inertia": 80.0}).fit(exact)
    assert fit.names == ("inertia", "offset")
    np.testing.assert_allclose(fit.params, [95.0, -3.0], rtol=1e-6)


# --- what a result says -----------------------------------------------------------------------


def test_the_sensitivities_are_the_observation_matrix(measured):
    fit = CLIE().fit(measured)
    signal = SimulatedSignal(measured, measured.names, {})
    simulated, J = signal.sensitivities(fit.params.to_numpy())
    np.testing.assert_allclose(fit.X, J)
    np.testing.assert_allclose(fit.y - fit.resids, simulated)
    np.testing.assert_allclose(fit.fitted, simulated)
    assert fit.std_errors["viscous"] > fit.with_cov("classical").std_errors["viscous"]
    assert fit.extras["signal"] == "force"
    assert "CLIE" in fit.summary()


def test_threads_change_nothing(exact):
    theta = np.array(list(TRUE.values()))
    one, two = (SimulatedSignal(exact, exact.names, {}, n_jobs=n) for n in (1, 2))
    np.testing.assert_array_equal(one.sensitivities(theta)[1], two.sensitivities(theta)[1])


def test_a_parameter_at_its_bound_is_named(measured):
    loop = measured.loop.with_effect("drive-timing", delay=3e-4)
    fit = CLIE(parameters=(*SYMMETRIC, "drive-timing.delay")).fit(replace(measured, loop=loop))
    assert fit.params["drive-timing.delay"] < 1e-6
    assert any("drive-timing.delay lies at its bound" in note for note in fit.notes)


def test_scans_are_limited_and_even(measured):
    problem = replace(measured, loop=measured.loop.with_effect("backlash"))
    points = list(scans(problem, tuple(problem.loop.parameters), limit=10))
    gaps = [point["backlash.gap"] for point in points]
    assert len(points) == 10
    assert max(gaps) > 20 * min(gaps)


# --- honest failure ---------------------------------------------------------------------------


@pytest.mark.parametrize("method", [DIDIM(start=named(FAR), max_iter=1), CLIE(max_iter=1)])
def test_too_few_iterations_are_no_convergence(measured, method):
    with pytest.warns(ConvergenceWarning, match="has not converged"):
        assert not method.fit(measured).converged


@pytest.mark.parametrize("method", [DIDIM, CLIE])
def test_a_start_that_cannot_be_simulated_says_so(measured, method):
    with pytest.raises(EstimationError, match="no simulation to start from at inertia -5"):
        method(start={"inertia": -5.0}).fit(measured)


def test_a_search_that_is_stuck_has_not_converged(exact):
    """The command of another axis: no step helps, and that is not a minimum."""
    from ivtools.estimators.simulated_error import stationary

    J = np.column_stack([np.arange(10.0), np.ones(10)])
    error = J @ [1.0, 2.0] + 1e-3 * np.cos(np.arange(10.0))
    assert not stationary(J, error, np.ones(2), np.ones(2))
    rest = error - J @ np.linalg.lstsq(J, error)[0]
    assert stationary(J, rest, np.ones(2), np.ones(2))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"tol": 0.0}, "tol = 0.0 must lie between"),
        ({"max_iter": 0}, "max_iter = 0 must be 1 or more"),
    ],
)
@pytest.mark.parametrize("method", [DIDIM, CLIE])
def test_settings_that_make_no_sense(method, settings, message):
    with pytest.raises(EstimationError, match=message):
        method(**settings)


@pytest.mark.parametrize(
    ("method", "message"),
    [
        (CLIE(parameters=("mass",)), "'mass' is not a parameter of the loop"),
        (CLIE(signal="torque"), "signal = 'torque' is none of"),
        (CLIE(start={"mass": 3.0}), "start names mass"),
        (DIDIM(start={"mass": 3.0}), "start names mass"),
        (DIDIM(start="cad"), "start = 'cad' is unknown"),
        (DIDIM(start={"inertia": np.nan}), "must be finite"),
    ],
)
def test_what_a_problem_does_not_know(exact, method, message):
    with pytest.raises(EstimationError, match=message):
        method.fit(exact)


def test_no_start_is_no_search():
    with pytest.raises(EstimationError, match="starts = 0 must be 1 or more"):
        CLIE(starts=0)


# --- units and controllers --------------------------------------------------------------------


@pytest.mark.parametrize("method", [DIDIM(), CLIE(), CLOE(), DDMIV()], ids=lambda m: m.key)
def test_units_scale_the_results_and_nothing_else(twin, method):
    """The same axis as a small revolute one: positions times 20, forces times 1e-4."""
    length, force = 20.0, 1e-4
    loop = iv.axes.emps()
    problem = iv.Problem(twin, loop)
    settings = {**loop.controller.settings, "kv": loop.controller.settings["kv"] / length}
    small = replace(
        loop,
        joint="revolute",
        gain=loop.gain * force,
        controller=replace(loop.controller, settings=settings),
        start={"inertia": loop.start["inertia"] * force / length},
    )
    record = twin.replace(q=twin.q * length, q_ref=twin.q_ref * length, theta_true=None)
    one, other = method.fit(problem), method.fit(iv.Problem(record, small))
    scales = np.array([force / length, force / length, force, force])
    np.testing.assert_allclose(other.params, scales * one.params, rtol=1e-5)
    np.testing.assert_allclose(other.std_errors, scales * one.std_errors, rtol=1e-3)
    assert abs(other.n_iter - one.n_iter) <= 1


def test_another_control_law(twin):
    controller = iv.axes.emps().controller
    gains = {"kp": 160.18 * 243.45, "kd": 243.45}
    loop = replace(iv.axes.emps(), controller=replace(controller, kind="pd", settings=gains))
    problem = noise_free(twin, loop, TRUE)
    far = DIDIM(start=named(FAR)).fit(problem)
    assert far.converged
    np.testing.assert_allclose(far.params, DIDIM().fit(problem).params, rtol=1e-4)
    np.testing.assert_allclose(CLIE().fit(problem).params, list(TRUE.values()), rtol=1e-6)
