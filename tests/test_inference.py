"""Tests of the estimates against linearmodels and statsmodels, and what they say where."""

import numpy as np
import pandas as pd
import pytest
import statsmodels.api as sm
from linearmodels.iv import IV2SLS, IVGMM, IVLIML
from statsmodels.stats.diagnostic import acorr_ljungbox
from statsmodels.stats.stattools import jarque_bera

from ivtools import inference, linalg
from ivtools.errors import EstimationError, ShapeError
from ivtools.results import FitResults

NAMES = ["inertia", "viscous", "coulomb", "offset"]
TIGHT = {"rel": 1e-8}


def made(n=500, surplus=2, endogenous=0.8, seed=0, weights=False, strength=1.0):
    """Return X (three endogenous columns and a constant), y and Z in mixed units."""
    rng = np.random.default_rng(seed)
    drive = rng.standard_normal((n, 3 + surplus))
    noise = rng.standard_normal((n, 3))
    for k in range(1, n):
        noise[k] += 0.5 * noise[k - 1]
    mix = np.vstack([np.eye(3), 0.4 * rng.standard_normal((surplus, 3))])
    X = (strength * drive @ mix + noise) * [1.0, 1e-2, 1e3]
    e = endogenous * noise.sum(axis=1) + 0.5 * rng.standard_normal(n)
    y = X @ [2.0, 100.0, 1e-3] + 0.7 + e
    one = np.ones((n, 1))
    w = rng.uniform(0.5, 2.0, n) if weights else None
    return np.hstack([X, one]), y, np.hstack([drive, one]), w


def fitted(X, y, Z=None, w=None, names=NAMES):
    theta = linalg.solve_iv(X, y, Z, w)
    return FitResults.from_solution("idim-iv", theta, X, y, names=names, Z=Z, weights=w)


@pytest.fixture(scope="module", params=[(0, False), (2, False), (2, True)], ids=str)
def pair(request):
    """Our result and linearmodels' on the same matrices: exact, surplus, surplus and weighted."""
    surplus, weights = request.param
    X, y, Z, w = made(surplus=surplus, weights=weights)
    model = IV2SLS(y, X[:, 3:], pd.DataFrame(X[:, :3], columns=NAMES[:3]), Z[:, :-1], weights=w)
    return fitted(X, y, Z, w), model


@pytest.fixture(scope="module")
def surplus_pair():
    X, y, Z, _ = made()
    return fitted(X, y, Z), (y, X[:, 3:], X[:, :3], Z[:, :-1])


def test_wu_hausman_is_that_of_linearmodels(pair):
    fit, model = pair
    ours, theirs = fit.wu_hausman(cov_type="classical"), model.fit().wu_hausman()
    assert ours.statistic == pytest.approx(theirs.stat, **TIGHT)
    assert ours.pvalue == pytest.approx(theirs.pval, **TIGHT)
    assert ours.df == (theirs.df, theirs.df_denom)


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        ({"cov_type": "robust"}, {"cov_type": "robust"}),
        ({"cov_type": "hac", "bandwidth": 7}, {"cov_type": "kernel", "bandwidth": 7}),
    ],
)
def test_robust_wu_hausman_is_wooldridges_regression(pair, ours, theirs):
    fit, model = pair
    expected = model.fit(**theirs).wooldridge_regression
    assert fit.wu_hausman(**ours).statistic == pytest.approx(expected.stat, **TIGHT)
    assert fit.wu_hausman(**ours).pvalue == pytest.approx(expected.pval, **TIGHT)


def test_contrast_is_durbins_statistic(pair):
    fit, model = pair
    ours, theirs = fit.hausman_contrast(cov_type="classical"), model.fit().durbin()
    assert ours.statistic == pytest.approx(theirs.stat, **TIGHT)
    assert ours.pvalue == pytest.approx(theirs.pval, **TIGHT)


def test_surplus_instruments_are_judged_as_by_linearmodels(pair):
    fit, model = pair
    theirs = model.fit()
    for name in ("sargan", "basmann"):
        ours, expected = getattr(fit, name)(), getattr(theirs, name)
        if fit.Z.shape[1] == 4:
            assert not ours.applies and "surplus" in ours.reason
        else:
            assert ours.statistic == pytest.approx(expected.stat, **TIGHT)
            assert ours.pvalue == pytest.approx(expected.pval, **TIGHT)


def test_anderson_rubin_of_surplus_instruments_is_that_of_linearmodels(surplus_pair):
    """The oracle forms cross products, so it needs columns of one size to keep its digits."""
    fit, (y, exog, endog, instruments) = surplus_pair
    scaled = endog / np.linalg.norm(endog, axis=0)
    expected = IVLIML(y, exog, scaled, instruments).fit().anderson_rubin
    ours = inference.anderson_rubin_overid(fit)
    assert ours.statistic == pytest.approx(expected.stat, **TIGHT)
    assert ours.pvalue == pytest.approx(expected.pval, **TIGHT)


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        ({"cov_type": "robust"}, {"weight_type": "robust"}),
        ({"cov_type": "hac", "bandwidth": 6}, {"weight_type": "kernel", "bandwidth": 6}),
    ],
)
def test_hansen_is_the_j_statistic_of_linearmodels(surplus_pair, ours, theirs):
    fit, matrices = surplus_pair
    expected = IVGMM(*matrices, **theirs).fit(iter_limit=2).j_stat
    assert fit.hansen(**ours).statistic == pytest.approx(expected.stat, rel=1e-8)
    assert fit.hansen(**ours).pvalue == pytest.approx(expected.pval, rel=1e-7)


def test_first_stage_is_that_of_linearmodels(pair):
    fit, model = pair
    ours = fit.first_stage()
    theirs = model.fit(cov_type="unadjusted", debiased=True).first_stage.diagnostics
    assert list(ours.index) == NAMES[:3]
    for column in ours.columns:
        name = {"f_stat": "f.stat", "f_pvalue": "f.pval"}.get(column, column.replace("_", "."))
        expected = theirs[name].to_numpy(dtype=float)
        np.testing.assert_allclose(ours[column], expected, rtol=1e-8, atol=1e-300)


def test_robust_first_stage_is_the_wald_statistic_over_its_number(pair):
    fit, model = pair
    q = fit.Z.shape[1] - 1
    for options, theirs in (
        ({"cov_type": "robust"}, {"cov_type": "robust"}),
        ({"cov_type": "hac", "bandwidth": 5}, {"cov_type": "kernel", "bandwidth": 5}),
    ):
        expected = model.fit(**theirs).first_stage.diagnostics["f.stat"].to_numpy(dtype=float)
        np.testing.assert_allclose(q * fit.first_stage(**options)["f_stat"], expected, rtol=1e-8)


def test_anderson_rubin_is_the_f_test_of_the_instruments(surplus_pair):
    fit, (y, exog, endog, instruments) = surplus_pair
    theta0 = {"inertia": 2.1, "viscous": 99.0, "coulomb": 1e-3}
    y0 = y - endog @ list(theta0.values())
    ols = sm.OLS(y0, np.hstack([exog, instruments])).fit()
    expected = ols.f_test(np.eye(6)[1:])
    ours = fit.anderson_rubin(theta0=theta0, cov_type="classical")
    assert ours.statistic == pytest.approx(float(expected.fvalue), **TIGHT)
    assert ours.pvalue == pytest.approx(float(expected.pvalue), **TIGHT)
    hac = sm.OLS(y0, np.hstack([exog, instruments])).fit(
        cov_type="HAC", cov_kwds={"maxlags": 4}, use_t=True
    )
    ours = fit.anderson_rubin(theta0=theta0, bandwidth=4)
    assert ours.statistic == pytest.approx(float(hac.f_test(np.eye(6)[1:]).fvalue), rel=1e-6)
    with pytest.raises(EstimationError, match="theta0 lacks viscous, coulomb"):
        fit.anderson_rubin(theta0={"inertia": 1.0})


def test_anderson_rubin_does_not_reject_the_exact_estimate():
    X, y, Z, _ = made(surplus=0)
    fit = fitted(X, y, Z)
    assert fit.anderson_rubin(theta0=fit.params).pvalue == pytest.approx(1.0)
    assert fit.anderson_rubin().pvalue < 1e-6


def test_tests_ignore_units():
    X, y, Z, _ = made()
    units = np.array([1e6, 1e-5, 1e3, 1.0])
    plain = inference.all_tests(fitted(X, y, Z))
    scaled = inference.all_tests(fitted(X * units, 1e-3 * y, Z * 1e4))
    for name, test in plain.items():
        assert scaled[name].statistic == pytest.approx(test.statistic, rel=1e-6), name


def test_exogenous_columns_are_not_suspected_and_endogenous_ones_are():
    suspected = inference.all_tests(fitted(*made(n=2000)[:3]))
    innocent = inference.all_tests(fitted(*made(n=2000, endogenous=0.0)[:3]))
    for name in ("wu_hausman", "wu_hausman_classical", "hausman_contrast"):
        assert suspected[name].pvalue < 1e-6
        assert innocent[name].pvalue > 0.01


def test_hac_forms_hold_their_size_where_the_textbook_ones_reject_too_often():
    """Autocorrelated columns and errors, no endogeneity: 5 % tests over 150 records."""
    rejected = {"classical": 0, "hac": 0}
    for seed in range(150):
        rng = np.random.default_rng(seed)
        slow = np.zeros((600, 3))
        shocks = rng.standard_normal((600, 3))
        for k in range(1, 600):
            slow[k] = 0.8 * slow[k - 1] + shocks[k]
        X, Z, e = slow[:, :1] + slow[:, 1:2], slow[:, :1], slow[:, 2]
        fit = fitted(X, X[:, 0] + e, Z, names=["inertia"])
        for cov_type in rejected:
            rejected[cov_type] += fit.wu_hausman(cov_type=cov_type).pvalue < 0.05
    assert rejected["classical"] > 30  # 20 % and more
    assert rejected["hac"] < 25


def test_residual_tests_are_those_of_statsmodels(pair):
    fit, _ = pair
    e = fit.resids if fit.weights is None else fit.resids * np.sqrt(fit.weights)
    assert fit.ljung_box(lags=7).statistic == pytest.approx(
        acorr_ljungbox(e, lags=[7])["lb_stat"].iloc[0]
    )
    assert fit.ljung_box(lags=7).pvalue == pytest.approx(
        acorr_ljungbox(e, lags=[7])["lb_pvalue"].iloc[0]
    )
    assert fit.normality().statistic == pytest.approx(jarque_bera(e)[0])
    assert fit.normality().pvalue == pytest.approx(jarque_bera(e)[1], rel=1e-6)
    assert fit.stationarity(kind="kpss").pvalue > 0.05
    assert fit.stationarity(kind="adf").pvalue < 0.01
    with pytest.raises(EstimationError, match="lags = 0 must lie"):
        fit.ljung_box(lags=0)
    with pytest.raises(EstimationError, match="kind = 'pp' is unknown"):
        fit.stationarity(kind="pp")


def test_a_drifting_residual_is_not_stationary():
    rng = np.random.default_rng(3)
    X = rng.standard_normal((800, 1))
    fit = fitted(X, X[:, 0] + rng.standard_normal(800).cumsum(), names=["inertia"])
    assert fit.stationarity(kind="kpss").pvalue <= 0.05
    assert fit.stationarity(kind="adf").pvalue > 0.05
    assert fit.ljung_box().pvalue < 1e-10


def test_wald_is_that_of_statsmodels():
    X, y, _, _ = made()
    ols = sm.OLS(y, X).fit(cov_type="HAC", cov_kwds={"maxlags": 5})
    fit = fitted(X, y).with_cov("hac", bandwidth=5)
    R = np.array([[1.0, -0.01, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    expected = ols.wald_test((R, [1.0, 0.5]), use_f=False, scalar=True)
    ours = fit.wald(R, [1.0, 0.5])
    assert ours.statistic == pytest.approx(expected.statistic, **TIGHT)
    assert ours.pvalue == pytest.approx(expected.pvalue, **TIGHT)
    assert ours.null == "inertia - 0.01 viscous = 1, offset = 0.5"
    named = fit.wald({"offset": 0.5, "inertia": 2.0})
    expected = ols.wald_test((np.eye(4)[[3, 0]], [0.5, 2.0]), use_f=False, scalar=True)
    assert named.statistic == pytest.approx(expected.statistic, **TIGHT)
    assert fit.wald({"offset": 0.5}, cov_type="classical").name == "Wald (classical)"


def test_restrictions_that_do_not_fit_are_refused():
    fit = fitted(*made()[:2])
    with pytest.raises(EstimationError, match="'mass' is no parameter; use inertia"):
        fit.wald({"mass": 1.0})
    with pytest.raises(ShapeError, match=r"they must be \(q, 4\)"):
        fit.wald([1.0, 0.0])
    with pytest.raises(ShapeError, match="R is"):
        fit.wald(np.eye(4)[:2], [1.0])
    with pytest.raises(EstimationError, match="depend on each other"):
        fit.wald([[1.0, 0, 0, 0], [2.0, 0, 0, 0]])


def test_tests_that_do_not_apply_say_why():
    X, y, Z, _ = made(surplus=0)
    of_ls = inference.all_tests(fitted(X, y))
    for name in ("wu_hausman", "hausman_contrast", "sargan", "hansen", "anderson_rubin"):
        assert not of_ls[name].applies
        assert of_ls[name].pvalue is None
        assert of_ls[name].reason == "the method uses no instruments"
    own = inference.all_tests(fitted(X, y, X))
    assert own["wu_hausman"].reason == "every column is its own instrument"
    assert fitted(X, y).first_stage().empty
    assert fitted(X, y).first_stage().attrs["reason"] == "the method uses no instruments"
    exact = inference.all_tests(fitted(X, y, Z))
    assert "surplus" in exact["hansen"].reason
    assert "does not apply" in repr(exact["sargan"])


def test_a_residual_of_nothing_cannot_be_tested():
    X = made()[0]
    y = np.zeros(len(X))
    fit = FitResults.from_solution("idim-ls", np.zeros(4), X, y, names=NAMES)
    assert fit.normality().reason == "the residual is constant"
    assert fit.stationarity().reason == "the residual is constant"
    assert fit.ljung_box().reason == "the residual is constant"
    assert "too few" in fitted(X[:12], made()[1][:12]).stationarity().reason
