"""FitResults, TestResult and Comparison: their figures, their tables, their JSON."""

import json
import math
from dataclasses import FrozenInstanceError, dataclass, replace

import numpy as np
import pandas as pd
import pytest
from scipy.special import stdtrit

from ivtools.comparison import compare
from ivtools.errors import EstimationError, IVToolsError
from ivtools.hypothesis import TestResult
from ivtools.pipeline import Pipeline
from ivtools.results import FitResults
from ivtools.tables import Text, table

NAMES = ("inertia", "viscous", "coulomb", "offset")
UNITS = ("kg", "N s/m", "N", "N")


@dataclass(frozen=True, eq=False)
class StubProblem:
    """A problem whose record is its seed, and whose simulation says what it was asked."""

    record: int
    pipeline: Pipeline = Pipeline(None, 10)  # noqa: RUF009
    names: tuple = NAMES
    units: tuple = UNITS
    loop: None = None

    @property
    def columns(self):
        rng = np.random.default_rng(self.record)
        v = np.sin(np.arange(3000) * 0.01) + 0.3 * np.sin(np.arange(3000) * 0.037)
        return np.column_stack([np.gradient(v, 0.01), v, np.sign(v), np.ones(3000)]), rng

    @property
    def X(self):
        return self.pipeline.rows(self.columns[0])

    @property
    def y(self):
        X, rng = self.columns
        return self.pipeline.rows(X @ [95.0, 203.0, 20.0, -3.0] + 5.0 * rng.standard_normal(3000))

    def simulate(self, theta):
        if self.record == 13:
            raise IVToolsError("the simulation runs away")
        return StubSimulation(float(np.sum(theta)))


@dataclass(frozen=True)
class StubSimulation:
    size: float

    def relative_error(self, record, pipeline):
        signals = ("position", "velocity", "acceleration", "force")
        return {s: self.size + record + i for i, s in enumerate(signals)}


def fitted(method="idim-ls", seed=0, **status):
    problem = StubProblem(seed)
    X, y = problem.X, problem.y
    theta = np.linalg.lstsq(X, y)[0]
    return FitResults.from_solution(method, theta, X, y, problem=problem, **status)


def lines(text):
    assert all(len(line) <= 80 for line in text.splitlines())
    return text.splitlines()


def test_derived_figures():
    fit = fitted()
    assert fit.names == NAMES
    assert fit.units == UNITS
    assert fit.nobs == 300
    np.testing.assert_allclose(fit.fitted + fit.resids, fit.y)
    np.testing.assert_allclose(fit.std_errors**2, np.diag(fit.cov))
    np.testing.assert_allclose(fit.tstats * fit.std_errors, fit.params)
    np.testing.assert_allclose(fit.relative_std, 100 * fit.std_errors / fit.params.abs())
    np.testing.assert_allclose(fit.conf_int().mean(axis=1), fit.params)
    reach = (fit.conf_int()["upper"] - fit.params) / fit.std_errors
    np.testing.assert_allclose(reach, stdtrit(fit.degrees_of_freedom, 0.975))
    assert (fit.degrees_of_freedom < fit.effective_rows).all()
    plain = fit.with_cov("robust").conf_int()
    reach = (plain["upper"] - fit.params) / fit.with_cov("robust").std_errors
    np.testing.assert_allclose(reach, 1.959963984540054)
    e = fit.resids
    assert fit.errors == (
        pytest.approx(np.linalg.norm(e)),
        pytest.approx(fit.relative_error),
        pytest.approx(e.std(ddof=1)),
    )
    assert fit.relative_error == pytest.approx(100 * np.linalg.norm(e) / np.linalg.norm(fit.y))
    assert fit.condition_number == pytest.approx(np.linalg.cond(fit.X))


def test_abs_diag_r_is_that_before_decimation():
    fit = fitted()
    full = StubProblem(0, Pipeline(None, 1)).X
    expected = np.abs(np.diag(np.linalg.qr(full, mode="r")))
    np.testing.assert_allclose(fit.abs_diag_r, expected)
    bare = replace(fit, problem=None)
    np.testing.assert_allclose(bare.abs_diag_r, np.abs(np.diag(np.linalg.qr(fit.X, mode="r"))))


def test_a_result_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        fitted().method = "other"


def test_units_may_come_by_name():
    problem = replace(StubProblem(0), units=dict(zip(NAMES, UNITS, strict=True)))
    fit = FitResults.from_solution("idim-ls", np.ones(4), problem.X, problem.y, problem=problem)
    assert fit.units == UNITS


def test_another_covariance_leaves_the_estimate_alone():
    fit = fitted()
    classical = fit.with_cov("classical")
    pd.testing.assert_series_equal(classical.params, fit.params)
    assert (fit.cov_type, classical.cov_type) == ("hac", "classical")
    assert not np.allclose(classical.cov, fit.cov)
    e = fit.resids
    expected = e.std(ddof=1) * np.sqrt(np.diag(np.linalg.inv(fit.X.T @ fit.X)))
    np.testing.assert_allclose(classical.std_errors, expected)
    with pytest.raises(EstimationError, match="cov_type = 'white' is unknown"):
        fit.with_cov("white")


def test_cross_test_applies_the_parameters_unchanged():
    fit, other = fitted(), StubProblem(5)
    e = other.y - other.X @ fit.params.to_numpy()
    figures = fit.cross_test(other)
    assert figures.norm == pytest.approx(np.linalg.norm(e))
    assert figures.relative == pytest.approx(100 * np.linalg.norm(e) / np.linalg.norm(other.y))
    assert figures.std == pytest.approx(e.std(ddof=1))


def test_parameters_that_the_record_does_not_show_are_marked():
    fit = fitted()
    assert fit.not_identifiable() == ()
    assert fit.not_identifiable(0.0) == NAMES
    weak = replace(fit, params=fit.params.mask(fit.params.index == "offset", 0.0))
    assert weak.relative_std["offset"] == math.inf
    assert weak.not_identifiable() == ("offset",)
    unknown = replace(fit, cov=fit.cov * np.nan)
    assert unknown.not_identifiable() == NAMES


def test_parameters_that_may_be_far_off_are_marked_though_the_fit_has_converged():
    fit = fitted()
    name = str(fit.relative_std.idxmax())
    width = 100.0 * (fit.conf_int(1e-3)["upper"] / fit.params - 1.0).abs()
    assert fit.weak(1.001 * width.max()) == () and fit.weak(0.999 * width.max()) == (name,)
    assert replace(fit, cov=fit.cov * np.nan).weak() == NAMES
    sized = replace(fit, cov=fit.cov * (8.0 / fit.relative_std.max()) ** 2)  # 8 %
    marked = [row for row in lines(sized.summary()) if row.endswith("~")]
    assert [row.split()[0] for row in marked] == list(sized.weak()) and name in sized.weak()
    assert sum("may be more than 20 % off" in row for row in lines(sized.summary())) == 1


def test_summary_is_an_aligned_table_of_eighty_columns():
    text = fitted(notes=("started from the axis file",), n_simulations=3).summary()
    rows = lines(text)
    assert rows[0].strip() == "IDIM-LS estimate"
    for expected in ("HAC (Newey-West)", "300", "Condition number", "Converged", "Simulations"):
        assert any(expected in row for row in rows)
    body = [row for row in rows if row.startswith(NAMES)]
    assert [row.split()[0] for row in body] == list(NAMES)
    assert len({len(row) for row in body}) == 1
    assert rows[-1] == "started from the axis file"
    assert "identifiable" not in text
    assert repr(text) == str(text)


def test_summary_marks_what_is_not_identifiable_in_one_line():
    fit = fitted()
    text = fit.summary(limit=float(fit.relative_std.sort_values().iloc[-2]))
    marked = [row for row in lines(text) if row.endswith("*")]
    assert len(marked) == 1
    assert marked[0].startswith(fit.relative_std.idxmax())
    assert sum("not identifiable from this record" in row for row in lines(text)) == 1


def test_summary_survives_long_names_and_all_sizes_of_numbers():
    X, y = fitted().X, fitted().y
    names = ["a_very_long_name_of_a_parameter_of_the_axis" + str(i) for i in range(4)]
    units = ("N m s/rad",) * 4
    for scale in (1e-12, 1e-4, 1.0, 1e9):
        theta = np.linalg.lstsq(X, scale * y)[0]
        fit = FitResults.from_solution("idim-ls", theta, X, scale * y, names=names, units=units)
        lines(fit.summary())
    zero = FitResults.from_solution("idim-ls", np.zeros(4), X, np.zeros(300), names=names)
    with np.errstate(invalid="ignore"):
        lines(zero.summary())


def test_notebook_form_holds_the_table():
    html = fitted()._repr_html_()
    assert html.startswith("<div") and html.endswith("</div>")
    for name in NAMES:
        assert f">{name}</td>" in html
    escaped = table("<T>", ["<a>"], ["<h>"], [["<c>"]], ["<n>"])
    assert "<T>" not in escaped._repr_html_() and "&lt;c&gt;" in escaped._repr_html_()
    assert Text("a < b")._repr_html_() == "<pre>a &lt; b</pre>"


def test_dict_is_the_json_of_identify():
    fit = fitted(n_iter=3)
    content = json.loads(json.dumps(fit.to_dict(), allow_nan=False))
    assert list(content) == [
        "method", "params", "std_errors", "cov_type", "relative_error", "condition_number",
        "nobs", "n_iter", "converged", "tests",
    ]  # fmt: skip
    assert content["params"] == {k: pytest.approx(v) for k, v in fit.params.items()}
    assert content["std_errors"] == {k: pytest.approx(v) for k, v in fit.std_errors.items()}
    assert (content["nobs"], content["n_iter"], content["converged"]) == (300, 3, True)
    whiteness = content["tests"]["ljung_box"]
    assert whiteness["statistic"] > 0 and 0 <= whiteness["pvalue"] <= 1
    absent = content["tests"]["sargan"]
    assert absent["statistic"] is None and absent["pvalue"] is None and absent["reason"]
    assert fit.to_dict(tests=False)["tests"] == {}


def test_test_results_show_themselves():
    test = TestResult("Sargan", "every instrument is valid", 3.2, 0.0736, (1,), "chi2")
    assert repr(test) == "Sargan: chi2(1) = 3.2, p = 0.0736; null: every instrument is valid"
    assert test.applies
    absent = TestResult("Sargan", "every instrument is valid", reason="no surplus")
    assert repr(absent) == "Sargan: does not apply (no surplus)"
    assert not absent.applies


def test_every_test_is_a_method_with_a_docstring():
    for name in ("wu_hausman", "sargan", "ljung_box", "wald_test"):
        method = getattr(FitResults, name)
        assert method.__name__ == name
        assert f"ivtools.inference.{name}" in method.__doc__
    assert TestResult.__test__ is False


def test_compare_sets_results_side_by_side():
    ls, wls = fitted("idim-ls", runtime=0.004), fitted("idim-wls", n_iter=5, n_simulations=6)
    both = compare([ls, wls], holdout=7)
    assert list(both.frame.columns) == ["idim-ls", "idim-wls"]
    column = both.frame["idim-ls"]
    assert column["params", "inertia"] == ls.params["inertia"]
    assert column["std_errors", "offset"] == ls.std_errors["offset"]
    assert column["relative_error", "direct"] == ls.relative_error
    assert column["relative_error", "cross-test"] == ls.cross_test(StubProblem(7)).relative
    total = ls.params.sum()
    assert column["simulated", "position"] == pytest.approx(total)
    assert column["simulated-holdout", "force"] == pytest.approx(total + 7 + 3)
    assert column["cost", "time_ms"] == pytest.approx(4.0)
    assert both.frame["idim-wls"]["cost", "iterations"] == 5
    assert both.frame["idim-wls"]["cost", "simulations"] == 6


def test_a_holdout_may_be_a_problem_too():
    ls = fitted()
    by_record, by_problem = compare([ls], holdout=7), compare([ls], holdout=StubProblem(7))
    pd.testing.assert_frame_equal(by_record.frame, by_problem.frame)


def test_an_error_of_another_signal_is_marked():
    """CLOE minimises the error of the position, whose size says nothing beside a force's."""
    position = {"signal": "position"}
    fits = [fitted(), fitted("cloe", extras=position), fitted("oloe", extras=position)]
    velocity = fitted("cloe", extras={"signal": "velocity"})
    assert [fit.signal for fit in (*fits, velocity)] == ["force", *["position"] * 2, "velocity"]
    text = lines(str(compare([*fits, velocity])))
    cells = [cell for line in text if line.startswith("relative error, %") for cell in line.split()]
    marks = [cell.lstrip("0123456789.") for cell in cells if cell[0].isdigit()]
    assert marks == ["", "*", "*", "**"]
    notes = [line for line in text if "not to be compared with errors of the force" in line]
    assert [note.split(":")[0].strip() for note in notes] == [
        "* of the simulated position",
        "** of the simulated velocity",
    ]
    assert "not to be compared" not in str(compare(fits[:1]))


def test_comparison_shows_itself_in_eighty_columns_however_many_results():
    fits = [fitted(f"method-{i}") for i in range(7)] + [fitted("method-0")]
    comparison = compare(fits, holdout=3)
    text = str(comparison)
    lines(text)
    assert repr(comparison) == text
    for label in comparison.frame.columns:
        assert label in text
    assert "method-0 #2" in text
    assert text.count("standard errors in parentheses") == 1
    assert text.count("Comparison") == 3 and comparison._repr_html_().count("<table>") == 1
    assert "hold-out force, %" in text


def test_comparison_of_unlike_models_leaves_gaps():
    ls = fitted()
    X = ls.X[:, :3]
    short = FitResults.from_solution(
        "idim-ls", np.linalg.lstsq(X, ls.y)[0], X, ls.y, names=NAMES[:3]
    )
    comparison = compare([ls, short])
    assert np.isnan(comparison.frame.loc[("params", "offset"), "idim-ls #2"])
    assert " - " in str(comparison) or str(comparison).count("  -") > 0
    content = json.loads(json.dumps(comparison.to_dict(), allow_nan=False))
    assert content["idim-ls #2"]["params"]["offset"] is None
    assert content["idim-ls"]["params"]["offset"] == pytest.approx(ls.params["offset"])


def test_a_simulation_that_fails_is_a_note():
    comparison = compare([fitted(seed=13)])
    assert comparison.notes == ("idim-ls, simulated: the simulation runs away",)
    told = comparison.to_dict()["idim-ls"]["simulated"]
    assert told["reason"] == "the simulation runs away"  # beside figures that are null
    assert "runs away" in str(comparison)
    assert ("simulated", "force") not in comparison.frame.index
    assert ("simulated", "force") not in compare([fitted()], simulate=False).frame.index


def test_nothing_to_compare_is_refused():
    with pytest.raises(IVToolsError, match="given no result"):
        compare([])
