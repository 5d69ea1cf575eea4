"""linalg against linearmodels and statsmodels, its invariants and its messages."""

import numpy as np
import pytest
import statsmodels.api as sm
from hypothesis import given, settings
from hypothesis import strategies as st
from linearmodels.iv import IV2SLS
from linearmodels.iv.covariance import kernel_optimal_bandwidth

from ivtools import linalg
from ivtools.errors import EstimationError, ShapeError

EXACT = {"rtol": 1e-8, "atol": 0}


@pytest.fixture(scope="module")
def system():
    """Endogenous X (400, 3), instruments (400, 5), autocorrelated y, in mixed units."""
    rng = np.random.default_rng(7)
    Z = rng.standard_normal((400, 5)).cumsum(axis=0) * 0.1 + rng.standard_normal((400, 5))
    noise = rng.standard_normal((400, 3))
    for k in range(1, 400):
        noise[k] += 0.6 * noise[k - 1]
    X = (Z[:, :3] + 0.3 * Z[:, 2:5] + 0.5 * noise) * [1.0, 1e-3, 1e4]
    y = X @ [2.0, 3e3, 1e-4] + noise.sum(axis=1) * (1.0 + 0.5 * np.abs(Z[:, 0]))
    return X, y, Z


def oracle(system, surplus, **options):
    X, y, Z = system
    return IV2SLS(y, None, X, Z if surplus else Z[:, :3]).fit(**options)


@pytest.mark.parametrize("surplus", [False, True])
@pytest.mark.parametrize("debiased", [False, True])
@pytest.mark.parametrize(
    ("cov_type", "theirs"),
    [
        ("classical", {"cov_type": "unadjusted"}),
        ("robust", {"cov_type": "robust"}),
        ("hac", {"cov_type": "kernel", "kernel": "bartlett", "bandwidth": 12}),
    ],
)
def test_instrumental_variables_agree_with_linearmodels(
    system, surplus, debiased, cov_type, theirs
):
    X, y, Z = system
    Z = Z if surplus else Z[:, :3]
    theta = linalg.solve_iv(X, y, Z)
    cov = linalg.covariance(X, y - X @ theta, Z, cov_type, bandwidth=12, debiased=debiased)
    expected = oracle(system, surplus, debiased=debiased, **theirs)
    np.testing.assert_allclose(theta, expected.params, **EXACT)
    np.testing.assert_allclose(np.sqrt(np.diag(cov)), expected.std_errors, **EXACT)
    np.testing.assert_allclose(cov, expected.cov, rtol=1e-7)


@pytest.mark.parametrize(
    ("cov_type", "debiased", "theirs"),
    [
        ("classical", True, {"cov_type": "nonrobust"}),
        ("robust", False, {"cov_type": "HC0"}),
        ("robust", True, {"cov_type": "HC1"}),
        ("hac", False, {"cov_type": "HAC", "cov_kwds": {"maxlags": 9}}),
        (
            "hac",
            True,
            {"cov_type": "HAC", "cov_kwds": {"maxlags": 9, "use_correction": True}},
        ),
    ],
)
def test_least_squares_agrees_with_statsmodels(system, cov_type, debiased, theirs):
    X, y, _ = system
    theta = linalg.solve_iv(X, y)
    cov = linalg.covariance(X, y - X @ theta, None, cov_type, bandwidth=9, debiased=debiased)
    expected = sm.OLS(y, X).fit(**theirs)
    np.testing.assert_allclose(theta, expected.params, **EXACT)
    np.testing.assert_allclose(np.sqrt(np.diag(cov)), expected.bse, **EXACT)


def test_weights_are_inverse_variances(system):
    X, y, Z = system
    weights = np.random.default_rng(8).uniform(0.2, 3.0, len(y))
    theta = linalg.solve_iv(X, y, weights=weights)
    cov = linalg.covariance(X, y - X @ theta, None, "classical", weights=weights, debiased=True)
    expected = sm.WLS(y, X, weights=weights).fit()
    np.testing.assert_allclose(theta, expected.params, **EXACT)
    np.testing.assert_allclose(np.sqrt(np.diag(cov)), expected.bse, **EXACT)
    ours = linalg.solve_iv(X, y, Z, weights)
    theirs = IV2SLS(y, None, X, Z, weights=weights).fit()
    np.testing.assert_allclose(ours, theirs.params, **EXACT)


def test_instruments_equal_to_the_columns_are_least_squares(system):
    X, y, _ = system
    np.testing.assert_allclose(linalg.solve_iv(X, y, X), linalg.solve_iv(X, y), rtol=1e-11)


def test_classical_form_of_the_report(system):
    X, y, _ = system
    theta = linalg.solve_iv(X, y)
    e = y - X @ theta
    cov = linalg.covariance(X, e, cov_type="classical")
    expected = e.std(ddof=1) * np.sqrt(np.diag(np.linalg.inv(X.T @ X)))
    np.testing.assert_allclose(np.sqrt(np.diag(cov)), expected, **EXACT)


@given(exponents=st.lists(st.integers(-8, 8), min_size=3, max_size=3))
@settings(max_examples=25, deadline=None)
def test_units_scale_the_results_and_change_nothing_else(system, exponents):
    X, y, Z = system
    units = 10.0 ** np.array(exponents)
    theta, scaled = linalg.solve_iv(X, y, Z), linalg.solve_iv(X * units, y, Z)
    np.testing.assert_allclose(scaled * units, theta, rtol=1e-9)
    for cov_type in ("classical", "robust", "hac"):
        cov = linalg.covariance(X, y - X @ theta, Z, cov_type)
        rescaled = linalg.covariance(X * units, y - X @ theta, Z, cov_type)
        np.testing.assert_allclose(rescaled * np.outer(units, units), cov, rtol=1e-7)


@given(n=st.integers(2, 60), bandwidth=st.integers(0, 59), seed=st.integers(0, 99))
@settings(max_examples=40, deadline=None)
def test_long_run_variance_is_the_weighted_sum_over_lags(n, bandwidth, seed):
    bandwidth = min(bandwidth, n - 1)
    scores = np.random.default_rng(seed).standard_normal((n, 2))
    total = scores.T @ scores
    for lag in range(1, bandwidth + 1):
        gamma = scores[lag:].T @ scores[:-lag]
        total += (1 - lag / (bandwidth + 1)) * (gamma + gamma.T)
    np.testing.assert_allclose(linalg.long_run_variance(scores, bandwidth), total, atol=1e-10)


def test_automatic_bandwidth_of_one_column_is_that_of_newey_and_west():
    rng = np.random.default_rng(9)
    for pole in (0.0, 0.3, 0.7, 0.95):
        x = rng.standard_normal((800, 1))
        for k in range(1, 800):
            x[k] += pole * x[k - 1]
        assert linalg.automatic_bandwidth(x) == kernel_optimal_bandwidth(x)


def test_automatic_bandwidth_ignores_units_signs_and_empty_columns():
    x = np.random.default_rng(10).standard_normal((500, 3)).cumsum(axis=0)
    expected = linalg.automatic_bandwidth(x)
    assert linalg.automatic_bandwidth(x * [1e-6, -1.0, 1e8]) == expected
    assert linalg.automatic_bandwidth(np.column_stack([x, np.zeros((500, 2))])) == expected


def test_base_columns_drop_what_the_others_say():
    rng = np.random.default_rng(11)
    X = rng.standard_normal((50, 3)) * [1.0, 1e-9, 1e9]
    assert linalg.base_columns(X).tolist() == [0, 1, 2]
    twice = np.column_stack([X, X[:, 0] + X[:, 2], np.zeros(50)])
    assert len(linalg.base_columns(twice)) == 3
    assert 4 not in linalg.base_columns(twice)


def test_projection_is_idempotent_and_keeps_its_space(system):
    X, _, Z = system
    onto = linalg.projection(Z, X)
    np.testing.assert_allclose(linalg.projection(Z, onto), onto, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(linalg.projection(Z, Z), Z, rtol=1e-9, atol=1e-12)
    assert not linalg.projection(Z[:, :0], X).any()


def test_dependent_columns_are_named(system):
    X, y, Z = system
    twice = np.column_stack([X[:, :2], 3 * X[:, 1]])
    with pytest.raises(EstimationError, match="viscous.* depends on the other columns"):
        linalg.solve_iv(twice, y, names=["inertia", "viscous", "viscous_2"])
    with pytest.raises(EstimationError, match="gravity depends on"):
        linalg.solve_iv(X * [1, 0, 1], y, names=["inertia", "gravity", "offset"])
    with pytest.raises(EstimationError, match="column 1 depends on"):
        linalg.solve_iv(X * [1, 0, 1], y)
    with pytest.raises(EstimationError, match=r"instruments \[[03]\] \(counted from 0\) depend"):
        linalg.solve_iv(X, y, np.column_stack([Z[:, :3], Z[:, 0]]))
    orthogonal = X - linalg.projection(Z, X)
    with pytest.raises(EstimationError, match="in the space of the instruments"):
        linalg.solve_iv(np.column_stack([X[:, :2], orthogonal[:, 2]]), y, Z)


def test_systems_that_cannot_be_solved_are_refused(system):
    X, y, Z = system
    with pytest.raises(ShapeError, match="X has 400 rows, y 399"):
        linalg.solve_iv(X, y[1:])
    with pytest.raises(ShapeError, match="Z 399"):
        linalg.solve_iv(X, y, Z[1:])
    with pytest.raises(ShapeError, match=r"\(N, p\)"):
        linalg.solve_iv(X[:, 0], y)
    with pytest.raises(ShapeError, match="3 rows are too few for 3 parameters"):
        linalg.solve_iv(X[:3], y[:3])
    with pytest.raises(ShapeError, match="2 instruments are too few for 3 parameters"):
        linalg.solve_iv(X, y, Z[:, :2])
    bad = y.copy()
    bad[17] = np.nan
    with pytest.raises(EstimationError, match="y has a value that is not finite in row 17"):
        linalg.solve_iv(X, bad)
    with pytest.raises(ShapeError, match="weights are"):
        linalg.solve_iv(X, y, weights=np.ones(3))
    with pytest.raises(EstimationError, match="weights must be finite and not negative"):
        linalg.solve_iv(X, y, weights=-np.ones_like(y))
    with pytest.raises(EstimationError, match="cov_type = 'white' is unknown"):
        linalg.covariance(X, y, cov_type="white")
    with pytest.raises(EstimationError, match="bandwidth = 400 must lie between 0 and 399"):
        linalg.covariance(X, y, bandwidth=400)


def coloured(n, taps, seed):
    from scipy.signal import lfilter

    rng = np.random.default_rng(seed)
    X = np.column_stack([np.sin(0.05 * np.arange(n)), np.sign(np.sin(0.021 * np.arange(n)))])
    return X, lfilter(*taps, rng.standard_normal(n + 100))[100:]


@pytest.mark.parametrize("taps", [([1.0], [1.0, -0.7]), ([1.0, -2.0, 1.0], [1.0, -0.5])])
def test_prewhitened_covariance_is_nearer_to_the_noise(taps):
    """Red noise, 300 rows, and blue noise: the kernel alone is up to a factor of 4 off."""
    estimates, found, plain = [], [], []
    for seed in range(150):
        X, e = coloured(300, taps, seed)
        theta = linalg.solve_iv(X, e)
        resids = e - X @ theta
        estimates.append(theta)
        found.append(np.diag(linalg.covariance(X, resids)))
        bandwidth = linalg.automatic_bandwidth(X * resids[:, np.newaxis])
        plain.append(np.diag(linalg.covariance(X, resids, bandwidth=bandwidth)))
    true = np.var(estimates, axis=0)
    ours, theirs = (np.sqrt(np.median(v, axis=0) / true) for v in (found, plain))
    assert np.abs(np.log(ours)).sum() < 0.6 * np.abs(np.log(theirs)).sum()
    assert (ours > 0.8).all() and (ours < 1.45).all()


def test_prewhitened_intervals_hold_their_level():
    """150 short records, heteroskedastic and autocorrelated: 95 % intervals by Student."""
    inside = 0
    for seed in range(150):
        X, e = coloured(150, ([1.0], [1.0, -0.6]), seed)
        e = e * (1.0 + 0.5 * np.abs(X[:, 0]))
        theta = linalg.solve_iv(X, e)
        cov = linalg.estimate_covariance(X, e - X @ theta)
        reach = st_quantile(cov.freedom) * np.sqrt(np.diag(cov.matrix))
        inside += int(np.sum(np.abs(theta) <= reach))
    assert 0.91 <= inside / 300 <= 0.985


def st_quantile(freedom):
    from scipy.special import stdtrit

    return stdtrit(freedom, 0.975)


def test_prewhitened_covariance_knows_gaps_units_and_weights(system):
    X, y, Z = system
    theta = linalg.solve_iv(X, y, Z)
    e = y - X @ theta
    found = linalg.estimate_covariance(X, e, Z)
    units = np.array([1e6, 1e-4, 1e2])
    scaled = linalg.estimate_covariance(X * units, 1e-5 * e, 1e3 * Z)
    np.testing.assert_allclose(
        scaled.matrix * np.outer(units, units) * 1e10, found.matrix, rtol=1e-6
    )
    np.testing.assert_allclose(scaled.freedom, found.freedom, rtol=1e-8)
    gaps = linalg.estimate_covariance(X, e, Z, starts=np.array([0, 100, 250]))
    assert not np.allclose(gaps.matrix, found.matrix, rtol=1e-6)
    np.testing.assert_allclose(np.diag(gaps.matrix), np.diag(found.matrix), rtol=0.2)
    same = linalg.covariance(X, e, Z, weights=np.ones(len(e)))
    np.testing.assert_allclose(same, found.matrix, rtol=1e-12)
    assert (found.freedom < found.rows).all() and (found.rows <= len(e)).all()
    exact = linalg.estimate_covariance(X, np.zeros(len(e)), Z)
    assert not exact.matrix.any()


def test_blocks_that_hold_one_row_each_are_whites_covariance(system):
    scores = system[2]
    found = linalg.block_covariance(scores, np.arange(len(scores)))
    np.testing.assert_allclose(found, linalg.score_covariance(scores, "robust"), rtol=1e-12)
    halves = linalg.block_covariance(scores, np.array([0, 200]))
    sums = np.stack([scores[:200].sum(axis=0), scores[200:].sum(axis=0)])
    np.testing.assert_allclose(halves, sums.T @ sums, rtol=1e-12)


# --- metric ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def metric():
    """One with noise of order 2, every third sample left out, and three directions in doubt."""
    rng = np.random.default_rng(3)
    at = np.flatnonzero(np.arange(300) % 3)
    doubted = np.linalg.qr(rng.standard_normal((len(at), 3)))[0].T
    return linalg.Metric([1.0, -0.6, 0.2], at, doubted, [1.0, 0.5, 1e-3])


@pytest.mark.parametrize("shape", [(300,), (300, 4), (300, 2, 2)])
def test_a_metric_whitens_keeps_and_discounts(metric, shape):
    """The same as by filter, mask and projections, in any memory order."""
    x = np.random.default_rng(1).standard_normal(shape)
    white = linalg.fir(metric.taps, x)[metric.at]
    flat = white.reshape(len(white), -1)
    part = metric.doubted @ flat
    wanted = (flat - metric.doubted.T @ (metric.shares[:, None] * part)).reshape(white.shape)
    for one in (x, np.asfortranarray(x)):
        np.testing.assert_allclose(metric(one), wanted, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(metric.discounted(white), wanted, rtol=1e-12, atol=1e-14)


def test_what_rows_leave_is_the_energy_beside_them(metric):
    x = np.random.default_rng(2).standard_normal(300)
    white = linalg.fir(metric.taps, x)[metric.at]
    rows = metric.doubted[:2]
    beside = white - rows.T @ (rows @ white)
    assert np.isclose(metric.left(x, rows), np.mean(beside**2), rtol=1e-12)


@given(st.integers(1, 6), st.integers(0, 3), st.floats(0.0, 8.0))
@settings(deadline=None, max_examples=40)
def test_independent_combinations_are_orthonormal_and_span_the_columns(count, more, size):
    rng = np.random.default_rng(count + 10 * more)
    X = rng.standard_normal((80, count)) * 10.0 ** rng.uniform(-size, size, count)
    X = np.column_stack([X, X @ rng.standard_normal((count, more)), np.zeros(80)])
    T = linalg.independent(X, 1e-12)
    Q = X @ T
    assert T.shape == (count + more + 1, count)
    np.testing.assert_allclose(Q.T @ Q, np.eye(count), atol=1e-6)
    np.testing.assert_allclose(
        X[:, :count] - Q @ (Q.T @ X[:, :count]), 0.0, atol=1e-6 * np.max(np.abs(X))
    )
