"""Strength of instruments, jointly, against ivmodels, linearmodels and statsmodels; AR sets."""

import json

import numpy as np
import pandas as pd
import pytest
import statsmodels.api as sm
from ivmodels.tests import inverse_anderson_rubin_test, rank_test
from linearmodels.iv import IV2SLS

from ivtools import inference, linalg
from ivtools.inference.rank import FirstStage, stock_yogo
from ivtools.inference.system import System
from ivtools.results import FitResults

NAMES = ["inertia", "viscous", "coulomb"]
TIGHT = {"rel": 1e-8}


def made(k=2, surplus=1, strength=1.0, n=400, seed=0, collinear=0.0):
    """Return y, k endogenous columns in mixed units, instruments, exogenous and true values."""
    rng = np.random.default_rng(seed)
    Z = rng.standard_normal((n, k + surplus))
    mix = rng.standard_normal((k + surplus, k))
    if collinear:  # the instruments move the first two columns alike
        mix[:, 1] = mix[:, 0] + (1.0 - collinear) * mix[:, 1]
    noise = rng.standard_normal((n, k)) * (1.0 + 0.5 * np.abs(Z[:, :1]))
    for t in range(1, n):
        noise[t] += 0.4 * noise[t - 1]
    units = np.array([1.0, 1e-3, 1e4])[:k]
    X = (strength * Z @ mix + noise) * units
    y = X @ (1.0 / units) + noise.sum(axis=1) + rng.standard_normal(n) + 0.3
    return y, X, Z, np.ones((n, 1)), 1.0 / units


def fitted(y, X, Z, one, names=NAMES):
    columns, instruments = np.hstack([X, one]), np.hstack([Z, one])
    theta = linalg.solve_iv(columns, y, instruments)
    names = [*names[: X.shape[1]], "offset"]
    return FitResults.from_solution("idim-iv", theta, columns, y, names=names, Z=instruments)


def judged(data, **options):
    return inference.instrument_strength(fitted(*data[:4]), **options)


@pytest.mark.parametrize("k", [1, 2, 3])
@pytest.mark.parametrize("surplus", [0, 3])
def test_cragg_donald_is_that_of_ivmodels(k, surplus):
    data = made(k, surplus)
    y, X, Z, _, units = data
    statistic, pvalue = rank_test(Z, X * units, fit_intercept=True)
    found, q = judged(data, cov_type="classical"), k + surplus
    # ivmodels counts the intercept out of N - q; the textbook counts it among the instruments
    ours = q * found.cragg_donald / (len(y) - q - 1)
    theirs = [statistic / (len(y) - q - c) for c in (0, 1)]
    assert min(abs(ours / other - 1.0) for other in theirs) < 1e-8
    assert found.kleibergen_paap.value == pytest.approx(found.cragg_donald, **TIGHT)
    assert 0.0 <= pvalue <= 1.0


def test_with_one_column_all_statistics_are_the_first_stage_f():
    data = made(k=1, surplus=3)
    y, X, Z, one, _ = data
    model = IV2SLS(y, one, pd.DataFrame(X, columns=["inertia"]), Z)
    plain = model.fit(cov_type="unadjusted", debiased=True).first_stage.diagnostics
    found = judged(data, cov_type="classical")
    for ours in (found.cragg_donald, found.kleibergen_paap.value, found.effective[0],
                 found.first_stage["sw_f"].iloc[0]):  # fmt: skip
        assert ours == pytest.approx(float(plain["f.stat"].iloc[0]), **TIGHT)
    robust = model.fit(cov_type="robust").first_stage.diagnostics["f.stat"].iloc[0]
    found = judged(data, cov_type="robust")
    ours = found.kleibergen_paap.value * 4 * len(y) / (len(y) - 5)
    assert ours == pytest.approx(float(robust), **TIGHT)
    kernel = model.fit(cov_type="kernel", bandwidth=6).first_stage.diagnostics["f.stat"].iloc[0]
    found = judged(data, cov_type="hac", bandwidth=6)
    ours = found.kleibergen_paap.value * 4 * len(y) / (len(y) - 5)
    assert ours == pytest.approx(float(kernel), **TIGHT)


@pytest.mark.parametrize(
    ("options", "theirs"),
    [
        ({"cov_type": "robust"}, {"cov_type": "HC0"}),
        ({"cov_type": "hac", "bandwidth": 5}, {"cov_type": "HAC", "cov_kwds": {"maxlags": 5}}),
    ],
)
@pytest.mark.parametrize("k", [2, 3])
def test_kleibergen_paap_is_the_wald_test_of_their_paper(k, options, theirs):
    """The Kronecker form of the paper, with the covariance of the coefficients by statsmodels."""
    y, X, Z, one, units = made(k, surplus=2)
    n, q = len(y), k + 2
    X, Z = (m - m.mean(axis=0) for m in (X * units, Z))
    coefficients = np.linalg.lstsq(Z, X)[0]  # (q, k)
    V = X - Z @ coefficients
    G = np.linalg.cholesky(Z.T @ Z / n).T
    F = np.linalg.inv(np.linalg.cholesky(V.T @ V / n))  # F S F' = I
    Theta = G @ coefficients @ F.T
    # covariance of vec(coefficients): stacked regressions, scores Kronecker-multiplied
    bread = np.linalg.inv(Z.T @ Z)
    scores = np.hstack([Z * V[:, [j]] for j in range(k)])  # (n, kq), columns of X outermost
    lags = options.get("bandwidth", 0)
    S = scores.T @ scores
    for lag in range(1, lags + 1):
        cross = scores[lag:].T @ scores[:-lag]
        S += (1 - lag / (lags + 1)) * (cross + cross.T)
    one_equation = sm.OLS(X[:, 0], Z).fit(**theirs)
    cov = np.kron(np.eye(k), bread) @ S @ np.kron(np.eye(k), bread)
    np.testing.assert_allclose(cov[:q, :q], one_equation.cov_params(), rtol=1e-8)
    W = np.kron(F, G) @ cov @ np.kron(F, G).T
    U, s, Vt = np.linalg.svd(Theta)
    r = k - 1
    U12, U22, V12, V22 = U[:r, r:], U[r:, r:], Vt.T[:r, r:], Vt.T[r:, r:]

    def root(m):
        value, vectors = np.linalg.eigh(m)
        return vectors @ np.diag(np.sqrt(value)) @ vectors.T

    A = np.vstack([U12, U22]) @ np.linalg.solve(U22, root(U22 @ U22.T))
    B = root(V22 @ V22.T) @ np.linalg.solve(V22.T, np.hstack([V12.T, V22.T]))
    lam = (A.T @ Theta @ B.T).ravel(order="F")
    omega = np.kron(B, A.T) @ W @ np.kron(B, A.T).T
    rk = float(lam @ np.linalg.solve(omega, lam))
    ours = inference.instrument_strength(fitted(y, X / units, Z, one), **options).kleibergen_paap
    assert ours.value * q * n / (n - q - 1) == pytest.approx(rk, rel=1e-8)
    from scipy.stats import chi2

    assert ours.pvalue == pytest.approx(chi2.sf(rk, q - k + 1), rel=1e-6, abs=1e-300)


@pytest.mark.parametrize("k", [2, 3])
def test_sanderson_windmeijer_is_two_regressions(k):
    """The residual of each column, by 2SLS on the others, on the instruments."""
    y, X, Z, one, units = made(k, surplus=2)
    found = judged((y, X, Z, one), cov_type="classical").first_stage
    for j in range(k):
        others = np.delete(X * units, j, axis=1)
        e = np.asarray(IV2SLS(X[:, j] * units[j], one, others, Z).fit().resids)
        stage = sm.OLS(e, np.hstack([one, Z])).fit()
        F = stage.ess / (Z.shape[1] - k + 1) / stage.mse_resid
        assert found["sw_f"].iloc[j] == pytest.approx(F, **TIGHT)
    assert found["sw_f"].min() >= judged((y, X, Z, one), cov_type="classical").cragg_donald


def test_collinear_first_stages_are_weak_though_each_is_strong():
    data = made(k=2, surplus=0, n=2000, strength=3.0, collinear=0.999)
    found = judged(data)
    assert found.first_stage["f_stat"].min() > 1000.0
    assert found.cragg_donald < 2.0 and found.weak
    test = inference.weak_instruments(fitted(*data[:4]))
    assert test.reason.endswith("; weak") and test.statistic == found.kleibergen_paap.value
    assert "anderson_rubin_set()" in str(found)
    assert not judged(made(k=2, surplus=0, n=2000, strength=3.0)).weak


def test_critical_values_are_the_published_ones():
    assert stock_yogo(1, 1)[10] == 16.38 and stock_yogo(2, 2)[10] == 7.03
    assert stock_yogo(1, 30)[25] == 23.65 and stock_yogo(3, 3) == stock_yogo(2, 3)
    assert stock_yogo(2, 1) == {} == stock_yogo(1, 31)


def test_strength_shows_itself():
    found = judged(made(k=3, surplus=1))
    assert all(len(line) <= 80 for line in str(found.summary()).splitlines())
    content = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert content["weak"] is False and content["effective"] == [None, None]
    assert found.verdict.endswith("; not weak")


@pytest.mark.parametrize("k", [1, 2])
def test_the_classical_set_is_that_of_ivmodels(k):
    data = made(k, surplus=2)
    y, X, Z, _, units = data
    ours = fitted(*data[:4]).anderson_rubin_set(0.1, cov_type="classical")
    # ivmodels takes N - q for the degrees of freedom; the limit below makes up for it
    quadric = inverse_anderson_rubin_test(Z, X * units, y, alpha=0.1, critical_values="f")
    n, q = len(y), k + 2
    from scipy.stats import f

    A, b, c = (np.asarray(v) for v in (quadric.A, quadric.b, quadric.c))
    columns = np.column_stack([y, X * units])
    columns = columns - columns.mean(axis=0)
    Q = np.linalg.qr(Z - Z.mean(axis=0))[0]
    seen = Q.T @ columns
    left = columns - Q @ seen
    used = (seen.T @ seen)[0, 0] - c  # limit / freedom * y'My
    theirs = used / (left.T @ left)[0, 0]
    limit = q * f.ppf(0.9, q, n - q - 1) / (n - q - 1)
    assert theirs == pytest.approx(limit, rel=0.01)
    A = A + (theirs - limit) * (left.T @ left)[1:, 1:]
    b = b.ravel() - 2 * (theirs - limit) * (left.T @ left)[1:, 0]
    c = c + (theirs - limit) * (left.T @ left)[0, 0]
    centre = -np.linalg.solve(A, b / 2)
    reach = np.sqrt((centre @ A @ centre - c) * np.diag(np.linalg.inv(A)))
    np.testing.assert_allclose(ours["lower"], (centre - reach) * units, rtol=1e-8)
    np.testing.assert_allclose(ours["upper"], (centre + reach) * units, rtol=1e-8)


@pytest.mark.parametrize("cov_type", ["classical", "robust", "hac"])
@pytest.mark.parametrize("k", [1, 2])
def test_the_ends_of_a_set_are_where_the_test_rejects(k, cov_type):
    data = made(k, surplus=1, seed=7)  # whose surplus instruments agree, or the set is small
    fit = fitted(*data[:4])
    assert fit.sargan().pvalue > 0.2
    ends = fit.anderson_rubin_set(0.05, cov_type=cov_type, bandwidth=4)
    if k == 1:
        for end in ends.loc["inertia"]:
            test = fit.anderson_rubin({"inertia": end}, cov_type=cov_type, bandwidth=4)
            assert test.pvalue == pytest.approx(0.05, rel=1e-3)
    estimate = fit.params[ends.index]
    assert ((ends["lower"] < estimate) & (estimate < ends["upper"])).all()
    width = (ends["upper"] - ends["lower"]) / fit.std_errors[ends.index]
    assert (width > 3.9).all() and (width < 9.0).all()


def test_sets_are_scale_free_and_unbounded_where_nothing_is_known():
    strong, weak = made(k=2, surplus=1), made(k=2, surplus=1, strength=0.005, seed=3)
    for cov_type in ("classical", "hac"):
        ends = fitted(*strong[:4]).anderson_rubin_set(cov_type=cov_type)
        y, X, Z, one, _ = strong
        scaled = fitted(1e-5 * y, X * [1e6, 1e-4], 1e3 * Z, one).anderson_rubin_set(
            cov_type=cov_type
        )
        factor = np.array([[1e-11], [1e-1]])
        np.testing.assert_allclose(scaled, ends * factor, rtol=1e-4)
        assert np.isinf(fitted(*weak[:4]).anderson_rubin_set(cov_type=cov_type)).all().all()


def test_sets_hold_their_level_where_conventional_intervals_do_not():
    """Weak instruments, 200 records: two standard errors miss the truth, the set does not."""
    inside = {"conventional": 0, "set": 0}
    for seed in range(200):
        data = made(k=1, surplus=1, strength=0.06, seed=seed, n=300)
        fit, true = fitted(*data[:4]), data[4][0]
        lower, upper = fit.conf_int().loc["inertia"]
        inside["conventional"] += lower <= true <= upper
        lower, upper = fit.anderson_rubin_set(cov_type="classical").loc["inertia"]
        inside["set"] += lower <= true <= upper
    assert inside["set"] >= 180 and inside["set"] > inside["conventional"] + 10


def test_without_instruments_there_is_nothing_to_judge():
    y, X, _, one, _ = made()
    fit = FitResults.from_solution("idim-ls", [0.0, 0.0, 0.0], np.hstack([X, one]), y)
    assert not fit.weak_instruments().applies
    assert len(fit.anderson_rubin_set()) == 0
    assert "no instruments" in fit.anderson_rubin_set().attrs["reason"]


def test_first_stage_works_on_what_the_exogenous_columns_leave():
    data = made(k=2, surplus=1)
    stage = FirstStage(System.of(fitted(*data[:4])), "classical", None)
    assert stage.counts == (2, 3) and stage.freedom == 400 - 4
    np.testing.assert_allclose(stage.Q.T @ stage.Q, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(stage.Q.T @ stage.V, 0.0, atol=1e-10)
