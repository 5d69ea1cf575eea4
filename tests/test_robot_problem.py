"""Robots are identified by the estimators of one axis."""

from dataclasses import replace

import numpy as np
import pytest
from robots import one_joint, plan, reference, six_loop, two_axes, two_joints

import ivtools as iv
from ivtools.errors import EstimationError, ShapeError
from ivtools.pipelines import Pipelines
from ivtools.plots import joint_simulation
from ivtools.robot.consistent import possible


def measured(loop, seconds=10.0, noise=0.0, seed=0, n=6):
    """A record of a loop, with encoder noise (rad) and 1 % noise of the torques with it."""
    rng = np.random.default_rng(seed)
    t, q_ref = reference(seconds, n=n, seed=seed)
    shaken = noise * rng.standard_normal(q_ref.shape)
    sim = loop.simulate(plan(t, q_ref), initial="rest", position_noise=shaken)
    tau = sim.tau + (0.01 if noise else 0.0) * sim.tau.std(axis=0) * rng.standard_normal(
        q_ref.shape
    )
    return iv.Record(t, q=sim.q, q_ref=q_ref, nu=sim.nu, tau=tau)


def diagonal(loop, theta, record):
    """The mean diagonal of the mass matrix over a record."""
    return loop.mass_matrix(record.q[::200], theta).diagonal(axis1=1, axis2=2).mean(axis=0)


@pytest.fixture(scope="module")
def clean():
    loop = six_loop()
    return iv.Problem(measured(loop), loop)


@pytest.fixture(scope="module")
def noisy():
    loop = six_loop()
    return iv.Problem(measured(loop, 20.0, 2e-4), loop)


@pytest.mark.parametrize("estimator", [iv.IDIMLS(), iv.IDIMWLS(), iv.IDIMIV(), iv.DIDIM()])
def test_a_record_without_noise_gives_the_truth(clean, estimator):
    fit = estimator.fit(clean)
    truth = clean.loop.values()
    assert fit.converged
    found = diagonal(clean.loop, truth | dict(fit.params), clean.record)
    np.testing.assert_allclose(found, diagonal(clean.loop, truth, clean.record), rtol=0.01)
    assert fit.relative_error < 0.5


def test_instruments_remove_the_bias_of_least_squares(noisy):
    truth = noisy.loop.values()
    true = diagonal(noisy.loop, truth, noisy.record)
    ls, ivr = iv.IDIMLS().fit(noisy), iv.IDIMIV().fit(noisy)
    biased = diagonal(noisy.loop, truth | dict(ls.params), noisy.record) / true - 1.0
    right = diagonal(noisy.loop, truth | dict(ivr.params), noisy.record) / true - 1.0
    assert ivr.converged
    assert np.abs(biased).max() > 0.2 and np.abs(right).max() < 0.03


def test_one_joint_has_the_rows_of_one_axis():
    twin, loop = iv.datasets.twin(), iv.axes.emps()
    start = {k: v for k, v in loop.start.items() if k != "inertia"}
    own = replace(loop, terms=loop.terms[1:], start=start)
    robot = iv.RobotLoop(one_joint(95.0), [own])
    one = iv.Problem(twin, loop)
    many = iv.Problem(twin, robot, pipeline=Pipelines((one.pipeline,)))
    np.testing.assert_allclose(many.X, one.X, atol=1e-12)
    np.testing.assert_array_equal(many.y, one.y)
    np.testing.assert_array_equal(many.t, one.t)
    a, b = (iv.IDIMIV(start="ls").fit(problem).params.to_numpy() for problem in (one, many))
    np.testing.assert_allclose(b, a, rtol=1e-4)


def test_rows_say_their_joint_and_masks_are_each_joints_own(clean):
    joints = clean.row_joints
    counts = np.bincount(joints)
    assert len(joints) == len(clean.y) == counts.sum() and len(set(counts)) > 1
    elbow = clean.names.index("joint_3.viscous")
    assert not clean.X[joints != 2, elbow].any()


def test_a_load_is_subtracted_from_the_force():
    loop = iv.RobotLoop(two_joints(), two_axes())
    record = measured(loop, n=2)
    load = np.column_stack([0.5 * np.sin(2.0 * record.t), 0.2 * np.cos(record.t)])
    pushed = loop.simulate(record.replace(load=load), initial="rest")
    heavy = record.replace(q=pushed.q, nu=pushed.nu, tau=pushed.tau, load=load)
    truth = loop.values()
    fit = iv.IDIMLS().fit(iv.Problem(heavy, loop))
    ignored = iv.IDIMLS().fit(iv.Problem(heavy.replace(load=None), loop))
    assert fit.relative_error < 0.5 < 5.0 < ignored.relative_error
    assert fit.params["ZZ2"] == pytest.approx(truth["ZZ2"], rel=0.02)


def test_an_impossible_estimate_is_simulated_at_the_nearest_robot_that_can_exist(clean):
    loop, values = clean.loop, clean.loop.values()
    wrong = values | {"ZZ6": -1.0, "joint_6.inertia": 0.0, "joint_5.viscous": -3.0}
    found = loop.possible(wrong, clean.record, lambda: clean.X)
    assert found["joint_5.viscous"] >= 0.0
    assert loop.felt_inertias(clean.record, found).min() > 0.0
    loop.simulate(clean.record, found)  # no matrix is indefinite, be the loop stable or not
    phi = loop.consistent(wrong, clean.X)
    assert possible(phi[:60].reshape(-1, 10), 1e-6)


def test_a_joint_is_an_axis_with_a_record_of_its_own(clean):
    record, loop = clean.record.joint(2), clean.loop.axis(2, clean.record)
    assert record.n_joints == 1 and record.name.endswith("joint 3")
    assert loop.joint == "revolute" and loop.start["coulomb"] == pytest.approx(5.0, rel=0.1)
    sim = clean.loop.simulate(clean.record)
    errors = sim.joint(2, clean.record).relative_error(record)
    assert errors["position"] < 0.5


def test_a_joint_that_stands_still_is_said_not_to_be_identifiable():
    loop = iv.RobotLoop(two_joints(), two_axes())
    t, q_ref = reference(8.0, n=2)
    q_ref[:, 1] = 0.3
    sim = loop.simulate(plan(t, q_ref), initial="rest")
    q, rng = sim.q.copy(), np.random.default_rng(0)
    q[:, 1] = 0.3 + 1e-5 * rng.standard_normal(len(t))  # held by its brake
    fit = iv.IDIMLS().fit(iv.Problem(iv.Record(t, q=q, q_ref=q_ref, nu=sim.nu), loop))
    weak = fit.not_identifiable()
    assert {"elbow.viscous", "elbow.coulomb", "elbow.offset", "ZZ2"} <= set(weak)
    assert "ZZ1R" not in weak and "shoulder.coulomb" not in weak
    assert clean_line(fit.summary())


def clean_line(summary):
    return "not identifiable from this record" in " ".join(str(summary).split())


def test_methods_of_one_axis_say_so(clean):
    with pytest.raises(EstimationError, match="idim-piv is for one axis; robots .* lmi-iv"):
        iv.IDIMPIV().fit(clean)


def test_fewer_columns_than_joints_are_refused(clean):
    with pytest.raises(ShapeError, match="has 1 joints and the loop 6"):
        iv.Problem(clean.record.joint(0), clean.loop)
    with pytest.raises(ShapeError, match="count from 0"):
        clean.record.joint(6)


def test_links_that_can_exist_are_an_estimate_too(noisy):
    """Least squares of a noisy record makes links that cannot exist; LMI does not."""
    loop, links = noisy.loop, 60
    fit = iv.LMIIV().fit(noisy)
    truth = loop.values()
    right = diagonal(loop, truth | dict(fit.params), noisy.record)
    right /= diagonal(loop, truth, noisy.record)
    assert fit.converged and np.abs(right - 1.0).max() < 0.03
    phi = loop.consistent(dict(fit.params), noisy.X)
    assert possible(phi[:links].reshape(-1, 10), 1e-6)
    moved = noisy.X @ (loop.base.matrix @ phi - fit.params.to_numpy())
    assert np.linalg.norm(moved) < 1e-3 * np.linalg.norm(noisy.y)
    assert "links that can exist" in " ".join(fit.notes)


def test_a_prior_tells_what_the_record_does_not():
    """Of a short record with noise: closer to the truth than without, and said what is whose."""
    true = iv.RobotLoop(two_joints(), two_axes())
    drawn = replace(true.robot, inertias=1.1 * true.robot.inertias)
    loop = replace(true, robot=drawn)
    problem = iv.Problem(measured(true, 8.0, 1e-4, n=2), loop)
    free, fit = iv.LMIIV().fit(problem), iv.LMIIV(prior=0.1).fit(problem)
    share, links = fit.extras["from_prior"], ["ZZ1R", "MX1R", "MY1", "ZZ2", "MX2", "MY2"]
    assert fit.converged and 0.0 < share[links].max() <= 1.0
    assert share.drop(links).max() < 0.05  # a drawing does not know frictions
    assert (fit.std_errors < 1.3 * free.std_errors).all()
    truth = np.array([true.values()[n] for n in links])
    errors = [np.abs(f.params[links] - truth) for f in (free, fit)]
    assert np.sum(errors[1] / fit.std_errors[links] < 3.0) >= 5
    assert "robot file known to 10 %" in fit.notes[0] and "are the prior's" in fit.notes[1]
    sure = iv.LMILS(prior=1e-6).fit(problem)
    np.testing.assert_allclose(sure.params[links], 1.1 * truth, atol=1e-3 * np.abs(truth).max())
    vague = iv.LMIIV(prior=1e4).fit(problem)
    assert (np.abs(vague.params - free.params) < 2.0 * free.std_errors).all()
    assert vague.extras["from_prior"].max() < 0.01


def test_a_prior_that_means_nothing_is_refused():
    problem = iv.Problem(iv.datasets.twin(), iv.axes.emps())
    with pytest.raises(EstimationError, match="one axis has none"):
        iv.LMILS(prior=0.3).fit(problem)


def test_weights_of_the_joints_are_iterated(noisy):
    fit = iv.IDIMWLS().fit(noisy)
    left = noisy.y - noisy.X @ fit.params.to_numpy()
    deviation = [left[noisy.row_joints == j].std() for j in range(6)]
    weights = [fit.weights[noisy.row_joints == j][0] for j in range(6)]
    np.testing.assert_allclose(np.sqrt(weights) * deviation, 1.0, rtol=1e-2)
    assert fit.converged and fit.n_iter > 1


def test_input_error_withholds_what_it_does_not_know(clean):
    fit = iv.DIDIM().fit(clean)
    assert fit.converged and fit.std_errors.isna().all() and not fit.not_identifiable()
    assert "no standard errors" in str(fit.summary())


def test_figures_show_every_joint():
    """Beside each joint's force what is left of it."""
    loop = iv.RobotLoop(two_joints(), two_axes())
    t, q_ref = reference(6.0, n=2)
    sim = loop.simulate(plan(t, q_ref), initial="rest")
    record = iv.Record(t, q=sim.q, q_ref=q_ref, nu=sim.nu)
    fit = iv.IDIMLS().fit(iv.Problem(record, loop))
    figure = fit.plot()
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["shoulder, N m", "error, N m", "elbow, N m", "error, N m"]
    left = fit.resids[fit.problem.row_joints == 1]
    assert f"{np.sqrt(np.mean(left**2)):.3g} N m rms" in figure.axes[3].get_title("right")
    figure = joint_simulation(sim, record)
    assert "0 N m rms" in figure.axes[1].get_title("right")  # simulated from itself


def test_intervals_hold_where_a_mask_leaves_short_segments_of_steep_noise():
    """Twice differentiated noise in segments of 60 rows, whose autocovariance leaks."""
    from ivtools.linalg import Stack, estimate_covariance

    rng = np.random.default_rng(1)
    t = np.concatenate([np.arange(60) + 100.0 * k for k in range(25)]) * 1e-2
    rows, joints = np.tile(t, 2), np.repeat([0, 1], len(t))
    X = np.sin(2.0 * np.pi * 0.2 * rows)[:, np.newaxis]
    starts = np.arange(0, len(rows), 60)
    found = []
    for _ in range(40):
        noise = np.concatenate([np.diff(rng.standard_normal(62), 2) for _ in range(50)])
        noise += 0.02 * rng.standard_normal(len(rows))
        theta = np.linalg.lstsq(X, noise)[0]
        left = noise - X @ theta
        known = estimate_covariance(X, left, starts=starts, stack=Stack(joints, rows)).matrix
        found.append((theta[0], known[0, 0]))
    spread, said = np.array(found).T
    assert 0.85 < np.sqrt(said.mean()) / spread.std() < 1.2  # by Yule and Walker's equations 1.29


def test_intervals_of_short_records_are_finite():
    """What a fit takes leaks to where there is no noise: given back, it may leave no covariance."""
    from scipy.signal import firwin, lfilter

    from ivtools.linalg import Stack, estimate_covariance

    rng, decimated = np.random.default_rng(0), np.diff(firwin(25, 0.5), 2)
    t = np.arange(240) * 1e-2
    rows, joints = np.tile(t, 2), np.repeat([0, 1], len(t))
    w = 2.0 * np.pi * np.array([0.2, 0.5, 0.9, 1.3, 1.7])
    waves = np.hstack([np.sin(np.outer(rows, w)), np.cos(np.outer(rows, w))])
    X = np.hstack([waves * (joints == j)[:, np.newaxis] for j in (0, 1)])
    starts, stack = np.arange(0, 480, 120), Stack(joints, rows)
    found = []
    for _ in range(60):
        noise = lfilter(decimated, [1.0], rng.standard_normal((4, 160)))[:, 40:].ravel()
        theta = np.linalg.lstsq(X, noise)[0]
        known = estimate_covariance(X, noise - X @ theta, starts=starts, stack=stack).matrix
        found.append((theta, np.sqrt(np.diag(known))))
    theta, said = np.array(found).transpose(1, 0, 2)
    ratio = said / theta.std(axis=0)  # without: more than 1e40 in most of them
    assert 0.7 < np.median(ratio) < 1.2 and ratio.max() < 5.0


def test_errors_of_one_instant_hang_together():
    """Two joints with the same noise: their mean is no better known than one of them."""
    from ivtools.linalg import Stack, covariance, segment_starts

    rng = np.random.default_rng(0)
    shared = rng.standard_normal(2000)
    X, e = np.ones((4000, 1)), np.tile(shared, 2)
    t, joints = np.tile(np.arange(2000) * 1e-2, 2), np.repeat([0, 1], 2000)
    starts = segment_starts(t, joints)
    apart = covariance(X, e, starts=starts)[0, 0]
    together = covariance(X, e, starts=starts, stack=Stack(joints, t))[0, 0]
    assert together == pytest.approx(1.0 / 2000, rel=0.15)
    assert apart == pytest.approx(1.0 / 4000, rel=0.15)


def test_a_joint_held_by_its_brake_leaves_the_rest_to_be_estimated():
    """Not a count of its encoder changes: what it would tell keeps its value, and that is said."""
    loop = iv.RobotLoop(two_joints(), two_axes())
    t, q_ref = reference(8.0, n=2)
    q_ref[:, 1] = 0.3
    stuck = iv.RobotLoop(two_joints(), [two_axes()[0], replace(two_axes()[1], start=_stiff())])
    sim = stuck.simulate(plan(t, q_ref), initial="rest")
    q = sim.q.copy()
    assert np.ptp(q[:, 1]) == 0.0
    problem = iv.Problem(iv.Record(t, q=q, q_ref=q_ref, nu=sim.nu), loop)
    assert {"elbow.viscous", "elbow.coulomb"} <= set(problem.loop.held)
    assert not (problem.row_joints == 1).any() and len(problem.names) == problem.X.shape[1]
    truth = loop.values()
    for method in (iv.IDIMLS(), iv.IDIMIV(), iv.LMILS()):
        fit = method.fit(problem)
        assert fit.converged and fit.relative_error < 0.5
        assert "elbow stands still" in " ".join(fit.notes)
        assert fit.params["shoulder.coulomb"] == pytest.approx(truth["shoulder.coulomb"], rel=0.05)
        assert fit.params["ZZ1R"] == pytest.approx(truth["ZZ1R"], rel=0.1)


def _stiff():
    return {"viscous": 0.03, "coulomb": 50.0, "offset": 0.0}
