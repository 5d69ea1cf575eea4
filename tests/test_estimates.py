"""What statisticians know by name, and what is withheld from a fit that has not converged."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import statsmodels.api as sm

import ivtools as iv
from ivtools.errors import EstimationError
from ivtools.estimates import WITHHELD, critical_values
from ivtools.estimators.continuous import respond
from ivtools.estimators.state_dependent import StateDependentFriction
from ivtools.results import FitResults

NAMES = ["inertia", "viscous", "offset"]
TIGHT = {"rtol": 1e-8}


@pytest.fixture(scope="module")
def system():
    rng = np.random.default_rng(5)
    X = np.column_stack([rng.standard_normal((300, 2)) * [1.0, 1e-3], np.ones(300)])
    weights = rng.uniform(0.2, 3.0, 300)
    y = X @ [2.0, 3e3, -1.0] + rng.standard_normal(300) / np.sqrt(weights)
    return X, y, weights


def fitted(system, weighted=False, **status):
    X, y, weights = system
    w = weights if weighted else None
    theta = np.linalg.lstsq(X, y)[0]
    if weighted:
        theta = sm.WLS(y, X, weights=w).fit().params
    return FitResults.from_solution(
        "idim-ls", theta, X, y, names=NAMES, weights=w, t=0.01 * np.arange(300), **status
    )


@pytest.mark.parametrize("weighted", [False, True])
def test_names_and_figures_are_those_of_statsmodels(system, weighted):
    X, y, weights = system
    fit = fitted(system, weighted).with_cov("classical", debiased=True)
    model = sm.WLS(y, X, weights=weights) if weighted else sm.OLS(y, X)
    theirs = model.fit(use_t=False)
    for name in ("params", "bse", "tvalues", "resid", "fittedvalues", "llf", "aic", "bic"):
        np.testing.assert_allclose(getattr(fit, name), getattr(theirs, name), **TIGHT)
    np.testing.assert_allclose(fit.pvalues, theirs.pvalues, rtol=1e-6, atol=1e-200)
    np.testing.assert_allclose(fit.cov_params(), theirs.cov_params(), **TIGHT)
    for alpha in (0.05, 0.01, 0.5):
        np.testing.assert_allclose(fit.conf_int(alpha), theirs.conf_int(alpha), **TIGHT)
    assert (fit.nobs, list(fit.resid.index[:2])) == (300, [0.0, 0.01])


def test_wald_test_reads_equations_as_statsmodels_does(system):
    X, y, _ = system
    fit = fitted(system).with_cov("classical", debiased=True)
    theirs = sm.OLS(y, X).fit()
    for use_f in (False, True):
        R = np.array([[1.0, 0.0, 2.0], [0.0, 1.0, 0.0]])
        expected = theirs.wald_test((R, [0.5, 2.9e3]), use_f=use_f, scalar=True)
        for ours in (
            fit.wald_test("inertia + 2 * offset = 0.5, viscous = 2900", use_f=use_f),
            fit.wald_test((R, [0.5, 2.9e3]), use_f=use_f),
            fit.wald_test(R, [0.5, 2.9e3], use_f=use_f),
        ):
            assert ours.statistic == pytest.approx(float(expected.statistic), rel=1e-8)
            assert ours.pvalue == pytest.approx(float(expected.pvalue), rel=1e-6)
    with pytest.raises(EstimationError, match="'mass = 1' is not understood .*inertia, viscous"):
        fit.wald_test("mass = 1")


def test_alpha_is_checked():
    with pytest.raises(EstimationError, match=r"alpha = 95 must lie between 0 and 1; 0.05 gives"):
        critical_values(math.inf, 95)


def test_there_is_no_likelihood_of_instruments_or_filtered_rows(system):
    X, y, _ = system
    fit = fitted(system)
    instrumental = replace(fit, Z=X)
    filtered = replace(fit, weights=lambda columns: columns)
    for other in (instrumental, filtered):
        assert all(math.isnan(v) for v in (other.llf, other.aic, other.bic))


def test_what_maximises_no_likelihood_has_none(system):
    """A centre of bounds, or where an iteration stopped, is no maximum."""
    fit = fitted(system)
    X, y, _ = system
    elsewhere = FitResults.from_solution("m", fit.params + [0.0, 0.0, 1.0], X, y, names=NAMES)
    assert math.isfinite(fit.llf)
    for other in (elsewhere, replace(fit, converged=False)):
        assert all(math.isnan(v) for v in (other.llf, other.aic, other.bic))


@pytest.mark.parametrize("late", [0.0, 5e-3])
def test_a_transfer_function_speaks_the_same_language(late):
    """Without poles that matter it is a regression: the criteria are those of statsmodels."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.standard_normal(60), 20)
    y = respond([50.0], [1.0, 20.0], u, 1e-3, "zoh", late) + 0.05 * rng.standard_normal(1200)
    record = iv.Record(1e-3 * np.arange(1200), y, nu=u)
    problem = iv.Problem(record, iv.axes.emps(), iv.Pipeline(None, 1))
    delay = "estimate" if late else 0.0
    fit = iv.SRIVC(poles=1, offset=False, initial="rest", delay=delay).fit(problem)
    theirs = sm.OLS(y, fit.simulated[:, None]).fit()
    assert fit.llf == pytest.approx(theirs.llf, rel=1e-3) and fit.nobs == 1200
    assert fit.aic == pytest.approx(2.0 * len(fit.params) - 2.0 * fit.llf)
    assert fit.bic == pytest.approx(np.log(1200.0) * len(fit.params) - 2.0 * fit.llf)
    np.testing.assert_allclose(fit.resid + fit.fittedvalues, y)
    np.testing.assert_allclose(fit.predict(record), fit.predict(), atol=1e-2 * np.std(y))
    t = (fit.params["a1"] - 20.0) / fit.bse["a1"]
    for test in (fit.wald_test("a1 = 20"), fit.wald_test({"a1": 20.0})):
        assert test.statistic == pytest.approx(t**2) and "autoregressive" in test.name
    lost = replace(fit, converged=False)
    assert math.isnan(lost.llf) and not lost.wald_test("a1 = 20").applies
    error = fit.cross_test(record.slice(400, 1200))
    part = fit.predict(record.slice(400, 1200))
    assert error == pytest.approx(100.0 * np.linalg.norm(y[400:] - part) / np.linalg.norm(y[400:]))


def test_what_has_not_converged_has_no_standard_errors(system):
    lost = fitted(system, converged=False)
    assert lost.notes == (WITHHELD,)
    series = (lost.std_errors, lost.bse, lost.tvalues, lost.pvalues, lost.relative_std)
    for figures in (*series, lost.cov, lost.conf_int(), lost.with_cov("classical").cov):
        assert figures.isna().to_numpy().all()
    assert np.isfinite(lost.params).all()
    content = json.loads(json.dumps(lost.to_dict(), allow_nan=False))
    assert content["std_errors"] == dict.fromkeys(NAMES) and content["converged"] is False
    text = str(lost.summary())
    assert WITHHELD[:30] in text and "NO (1 iterations)" in text and "identifiable" not in text
    row = next(line for line in text.splitlines() if line.startswith("inertia"))
    assert row.split()[2:] == ["-", "-", "-", "-"]
    assert not lost.wald_test("offset = 0").applies


def test_the_rule_holds_for_every_way_to_a_result(system):
    lost = replace(fitted(system), converged=False)
    assert lost.std_errors.isna().all() and lost.notes.count(WITHHELD) == 1
    assert replace(lost, notes=("else", *lost.notes)).notes == (WITHHELD, "else")
    found = replace(fitted(system), converged=True)
    assert found.std_errors.notna().all() and not found.notes


def test_a_curve_and_a_transfer_function_follow_the_same_rule():
    problem = iv.Problem(iv.datasets.twin(), iv.axes.emps())
    curve = StateDependentFriction().fit(problem)
    lost = replace(curve, converged=False)
    assert np.isnan(lost.std_error).all() and all(map(math.isnan, lost.std_errors.values()))
    assert " - " in str(lost.summary()) and set(lost.to_dict()["std_error"]) == {None}
    function = iv.SRIVC(poles=2, zeros=0, input="q_ref", output="q").fit(problem)
    lost = replace(function, converged=False)
    assert lost.std_errors.isna().all() and WITHHELD[:30] in str(lost.summary())
    assert set(lost.to_dict()["std_errors"].values()) == {None}


def test_predict_is_the_force_on_any_record():
    record = iv.datasets.twin()
    problem = iv.Problem(record, iv.axes.emps())
    fit = iv.IDIMLS().fit(problem)
    np.testing.assert_allclose(fit.predict(), fit.fittedvalues, rtol=1e-12)
    half = record.slice(2000, 20000)
    other, y = fit.predict(half), replace(problem, record=half).y
    assert other.index.name == "t" and len(other) == len(y)
    figures = fit.cross_test(half)
    assert figures.norm == pytest.approx(float(np.linalg.norm(y - other)))


def test_predict_knows_the_shapes_that_were_estimated():
    """A Stribeck speed has no column; the columns depend on it all the same."""
    loop = iv.axes.emps().with_terms("inertia", "viscous", "coulomb", "offset", "stribeck")
    problem = iv.Problem(iv.datasets.twin(), loop)
    shape = next(n for n in loop.parameters if n not in problem.names)
    theta = dict(zip(problem.names, np.ones(len(problem.names)), strict=True))
    fits = [
        FitResults.from_solution(
            "clie",
            [*theta.values(), v],
            np.eye(9)[:, : len(theta) + 1],
            np.ones(9),
            names=[*theta, shape],
        )  # fmt: skip
        for v in (0.01, 0.1)
    ]
    first, second = (replace(fit, problem=problem).predict() for fit in fits)
    assert not np.allclose(first, second)
