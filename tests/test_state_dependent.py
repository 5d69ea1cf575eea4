"""Friction without a model: known curves, the measured asymmetry, what a curve says, bad input."""

import json

import numpy as np
import pytest

import ivtools as iv
from ivtools.errors import EstimationError
from ivtools.estimators import StateDependentFriction
from ivtools.estimators.smoother import smooth


@pytest.fixture(scope="module")
def problem(twin):
    return iv.Problem(twin, iv.axes.emps())


@pytest.fixture(scope="module")
def curve(problem):
    return StateDependentFriction().fit(problem)


@pytest.fixture(scope="module")
def measured(emps):
    return StateDependentFriction().fit(iv.Problem(emps, iv.axes.emps()))


def of_the_twin(v):
    return np.where(v > 0.0, 20.0 + 165.0 * v, -21.0 + 240.0 * v)


# --- what it finds ----------------------------------------------------------------------------


def test_the_friction_of_the_twin(curve):
    error = curve.force - of_the_twin(curve.velocity)
    assert np.max(np.abs(error)) < 0.5
    inside = np.abs(error) <= 1.96 * curve.std_error
    assert inside.mean() > 0.6  # the points of a curve err together
    assert curve.params["inertia"] == pytest.approx(95.0, rel=1e-3)
    assert curve.converged


def test_a_peak_that_nobody_modelled(twin):
    """A Stribeck effect shows in the curve, and as a bend of its branches."""
    theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": 0.0}
    force = np.random.default_rng(3).normal(0.0, 1.0, twin.n_samples)
    loop = iv.axes.emps().with_effect("stribeck", force=15.0, speed=0.04)
    sim = loop.simulate(twin, theta, initial="rest", force_noise=force)
    record = sim.to_record(q_ref=twin.q_ref)
    curve = StateDependentFriction().fit(iv.Problem(record, iv.axes.emps()))
    v = curve.velocity
    true = (20.0 + 15.0 * np.exp(-((v / 0.04) ** 2))) * np.sign(v) + 200.0 * v
    assert np.max(np.abs(curve.force - true)) < 2.0
    assert np.sqrt(np.mean((curve.force - true) ** 2)) < 0.6
    assert (curve.branches()["bend"] > 2.0).all()


def test_the_measured_asymmetry(measured):
    """The report's asymmetric model: Fv+ 166.7, Fc+ 20.14, Fv- 240.4, Fc- 20.63 (equation 12)."""
    branches = measured.branches()
    np.testing.assert_allclose(branches["viscous"], [166.7, 240.4], rtol=0.06)
    np.testing.assert_allclose(branches["coulomb"], [20.14, 20.63], rtol=0.04)
    fast = measured.asymmetry(5).iloc[-1]
    assert fast["difference"] == pytest.approx(0.126 * (166.7 - 240.4) - 0.5, abs=1.5)
    assert fast["upper"] < -5.0  # far outside of what noise does
    assert measured.params["inertia"] == pytest.approx(95.15, rel=0.01)
    assert measured.relative_error < 3.112  # of the asymmetric model, in per cent
    assert measured.runtime < 3.0


def test_an_even_axis_shows_no_asymmetry(twin):
    theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": 0.0}
    noise = np.random.default_rng(4).normal(0.0, 2.0, twin.n_samples)
    sim = iv.axes.emps().simulate(twin, theta, initial="rest", force_noise=noise)
    record = sim.to_record(q_ref=twin.q_ref)
    gap = StateDependentFriction().fit(iv.Problem(record, iv.axes.emps())).asymmetry()
    assert gap["difference"].abs().max() < 0.4


def test_what_does_not_depend_on_the_velocity_stays_a_parameter(twin):
    """A spring, as the regression with a friction model finds it."""
    theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": 0.0}
    loop = iv.axes.emps().with_effect("spring", stiffness=100.0, curvature=0.0)
    record = loop.simulate(twin, theta, initial="rest").to_record(q_ref=twin.q_ref)
    problem = iv.Problem(record, loop)
    curve, fit = StateDependentFriction().fit(problem), iv.IDIMLS().fit(problem)
    assert list(curve.params) == ["inertia", "spring.stiffness", "spring.curvature"]
    for name, value in curve.params.items():
        assert value == pytest.approx(fit.params[name], rel=0.02, abs=8.0), name
    assert curve.params["spring.stiffness"] == pytest.approx(100.0, abs=5.0)


# --- the smoother -----------------------------------------------------------------------------


def test_units_change_nothing_but_the_units():
    rng = np.random.default_rng(5)
    v = rng.uniform(-1.0, 1.0, 800)
    y = np.sign(v) + np.sin(3.0 * v) + rng.normal(0.0, 0.05, v.size)
    one, other = smooth(v, y), smooth(1e3 * v, 1e-3 * y)
    np.testing.assert_allclose(other.level, 1e-3 * one.level, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(other.std_error, 1e-3 * one.std_error, rtol=0.05)


def test_the_band_covers_a_smooth_curve():
    rng = np.random.default_rng(6)
    covered = []
    for _ in range(20):
        v = rng.uniform(0.0, 1.0, 500)
        y = np.sin(4.0 * v) + rng.normal(0.0, 0.2, v.size)
        found = smooth(v, y)
        error = found.level - np.sin(4.0 * found.state)
        covered.append(np.mean(np.abs(error) <= 1.96 * found.std_error))
    assert 0.88 < np.mean(covered) <= 1.0


def test_more_noise_makes_a_smoother_curve():
    rng = np.random.default_rng(7)
    v = np.linspace(0.01, 1.0, 600)
    quiet, loud = (smooth(v, np.sin(12.0 * v) + rng.normal(0.0, s, v.size)) for s in (0.05, 1.0))
    assert quiet.ratios[0] > loud.ratios[0]
    assert quiet.std_error.mean() < loud.std_error.mean()


def test_given_ratios_are_held():
    v = np.linspace(-1.0, 1.0, 300) + 1e-3
    assert smooth(v, v**2, ratios=(3.0, 4.0)).ratios == (3.0, 4.0)


def test_equal_states_are_one_point():
    v = np.repeat([0.1, 0.2, 0.3, 0.4], 30)
    found = smooth(v, 2.0 * v)
    np.testing.assert_allclose(found.state, [0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(found.level, 2.0 * found.state, rtol=1e-4)


# --- what a curve says ------------------------------------------------------------------------


def test_a_curve_is_a_function(curve):
    assert curve(0.1) == pytest.approx(36.5, abs=0.5)
    assert curve(np.array([-0.1, 0.1])).shape == (2,)
    assert np.isnan(curve(0.0))
    assert np.isnan(curve(1.0))


def test_a_curve_shows_itself(curve):
    frame = curve.to_frame()
    assert list(frame) == ["velocity", "force", "std_error", "lower", "upper"]
    assert frame["velocity"].is_monotonic_increasing
    assert ((frame["lower"] < frame["force"]) & (frame["force"] < frame["upper"])).all()
    assert "velocity, m/s" in curve.summary()
    assert max(map(len, curve.summary().splitlines())) <= 80
    assert "<table" in curve._repr_html_() or "<pre" in curve._repr_html_()
    assert repr(curve).startswith("<FrictionCurve twin: -0.15")
    assert json.loads(json.dumps(curve.to_dict()))["converged"]


def test_a_curve_draws_itself(curve):
    figure = curve.plot(models={"symmetric": {"coulomb": 20.0, "viscous": 200.0, "offset": -3.0}})
    above, below = figure.axes
    assert above.get_xlabel() == "velocity, m/s"
    assert len(above.get_legend().get_texts()) == 3
    assert below.get_ylabel() == "|friction|, N"


def test_one_direction_is_one_branch(twin):
    t = twin.t[:4000]
    q_ref = 0.03 * t + 0.01 * t**2
    theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": 0.0}
    driver = iv.Record(t, q=q_ref, q_ref=q_ref, nu=q_ref)
    noise = np.random.default_rng(8).normal(0.0, 1.0, len(t))
    sim = iv.axes.emps().simulate(driver, theta, force_noise=noise)
    record = sim.to_record(q_ref=driver.q_ref)
    curve = StateDependentFriction().fit(iv.Problem(record, iv.axes.emps()))
    assert curve(0.08) == pytest.approx(36.0, abs=1.5)
    assert list(curve.branches().index) == ["positive"]
    assert len(curve.plot().axes) == 1
    with pytest.raises(EstimationError, match="one direction only"):
        curve.asymmetry()


# --- bad input --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"min_speed": 0.0}, "min_speed = 0.0 must be positive"),
        ({"min_speed": np.nan}, "min_speed = nan must be positive"),
        ({"tol": 0.0}, "tol = 0.0 must lie between"),
        ({"max_passes": 0}, "max_passes = 0 must be 1 or more"),
    ],
)
def test_settings_that_make_no_sense(settings, message):
    with pytest.raises(EstimationError, match=message):
        StateDependentFriction(**settings)


def test_a_model_of_friction_alone_is_refused(twin):
    loop = iv.axes.emps().with_terms("viscous", "coulomb")
    problem = iv.Problem(twin, loop, iv.Pipeline(100.0, 10, trim=(49, 0)))
    with pytest.raises(EstimationError, match="friction only"):
        StateDependentFriction().fit(problem)


def test_an_axis_that_hardly_moves_is_refused(problem):
    with pytest.raises(ValueError, match="masks every row"):
        StateDependentFriction(min_speed=1.0).fit(problem)
    with pytest.raises(EstimationError, match="fewer than 20 samples"):
        smooth(np.array([0.1, 0.2]), np.zeros(2))


def test_too_few_passes_are_no_convergence(problem):
    assert not StateDependentFriction(max_passes=1).fit(problem).converged
