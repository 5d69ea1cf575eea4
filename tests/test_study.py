"""Monte-Carlo studies: the table, its seeds, failures, estimators from outside, and the scores."""

import pickle
import textwrap
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import ivtools as iv
from ivtools.digest import digest, loop_text, seed_sequence
from ivtools.errors import IVToolsError
from ivtools.study import (
    COLUMNS,
    MEASURED,
    NAMES,
    BangBang,
    Case,
    Multisine,
    Recorded,
    Score,
    Study,
    Trapezoids,
    load,
    named,
)

THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
REFERENCE = Trapezoids(3.0, strokes=(0.12, 0.04), speeds=(0.15, 0.1))
ROWS = {"force_shift": 0.5, "min_speed": 0.005, "guard": 10}


def case(name: str = "case", **changes: object) -> Case:
    settings: dict = {"reference": REFERENCE, "force_noise": 3.0, "encoder_noise": 1e-6}
    return Case(name, iv.axes.emps(), THETA, **{**settings, "pipeline": ROWS, **changes})


def same(a: pd.DataFrame, b: pd.DataFrame) -> None:
    """Tables are the same, bit for bit, but for what a clock measured."""
    columns = [name for name in COLUMNS if name not in MEASURED]
    pd.testing.assert_frame_equal(a[columns], b[columns], check_exact=True)


# --- cases --------------------


def test_a_setting_that_came_later_changes_no_seed_unless_it_is_used():
    """The first digits are those from before controllers had one."""
    loop = iv.axes.emps()
    assert digest(loop_text(loop)).startswith("c215f2638f4529c6")
    other = replace(loop.controller, reference_derivative="backward")
    assert digest(loop_text(replace(loop, controller=other))) != digest(loop_text(loop))


def test_the_same_seed_gives_the_same_record_and_others_differ():
    first, again, other = case().record(0), case().record(0), case().record(1)
    np.testing.assert_array_equal(first.q, again.q)
    assert not np.array_equal(first.q, other.q)
    assert first.theta_true == THETA


def test_records_do_not_depend_on_how_they_are_identified():
    plain = case()
    other = case("other", pipeline={}, start={"inertia": 50.0})
    np.testing.assert_array_equal(plain.record(3).nu, other.record(3).nu)
    assert plain.identity != other.identity


def test_seeds_are_the_same_on_every_machine():
    assert digest("case", 1.5, {"b": 1, "a": [True, None]})[:16] == "a1a79136015a618c"
    assert seed_sequence("case", 7).generate_state(2).tolist() == [964356519, 3617899903]


def test_every_part_of_a_case_is_in_its_identity():
    changes = [
        {"encoder_noise": 2e-6},
        {"quantum": 1e-7},
        {"force_noise": 4.0},
        {"force_noise_pole": 0.5},
        {"sampling_hz": 500.0},
        {"reference": BangBang(3.0)},
        {"holdout": BangBang(3.0)},
        {"start": {"inertia": 90.0}},
        {"expected": {"inertia": 90.0}},
        {"pipeline": {**ROWS, "guard": 11}},
        {"fitted": iv.axes.emps().with_effect("stribeck", force=1.0)},
    ]
    identities = [case(**change).identity for change in changes] + [case().identity]
    assert len(set(identities)) == len(identities)


def test_a_case_survives_pickling_with_the_terms_the_engine_knows():
    before = case(fitted=iv.axes.emps().with_effect("stribeck", force=1.0))
    after = pickle.loads(pickle.dumps(before))
    assert after.identity == before.identity
    assert all(a is b for a, b in zip(after.loop.terms, before.loop.terms, strict=True))
    np.testing.assert_array_equal(after.record(0).q, before.record(0).q)


def test_coloured_noise_has_the_deviation_asked_for():
    from ivtools.study.case import _noise

    noise = _noise(np.random.default_rng(0), 100_000, 2.0, 0.9)
    assert noise.std() == pytest.approx(2.0, rel=0.05)
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] == pytest.approx(0.9, abs=0.01)


@pytest.mark.parametrize(
    "reference",
    [
        Trapezoids(5.0),
        BangBang(5.0),
        Multisine(5.0),
        Recorded(0.1 * np.sin(np.arange(500) / 80), 0.01),
    ],
    ids=lambda r: type(r).__name__,
)
def test_references_start_smoothly_and_scale(reference):
    t = np.arange(4900) * 1e-3
    q = reference.position(t)
    np.testing.assert_allclose(reference.scaled(0.5).position(t)[0], 0.5 * q[0], atol=1e-12)
    assert np.abs(np.diff(q, 2)).max() < 1e-4  # no jump of position or velocity
    assert np.abs(reference.scaled(0.5).position(t)).max() < np.abs(q).max()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"encoder_noise": -1.0}, "encoder_noise = -1.0 must be"),
        ({"sampling_hz": 0.0}, "sampling_hz"),
        ({"force_noise_pole": 1.0}, "force_noise_pole"),
    ],
)
def test_impossible_cases_are_refused(changes, message):
    with pytest.raises(IVToolsError, match=message):
        case(**changes)


# --- the table --------------------


@pytest.fixture(scope="module")
def study() -> Study:
    asymmetric = iv.axes.emps().with_effect("asymmetric-viscous", delta=40.0)
    cases = [case("true"), Case("asymmetric", asymmetric, THETA, REFERENCE, force_noise=3.0)]
    return Study(cases, {"ls": iv.IDIMLS(), "robust": iv.IDIMLS(cov_type="robust")}, seeds=6)


@pytest.fixture(scope="module")
def table(study) -> pd.DataFrame:
    return study.run()


def test_the_table_is_tidy(study, table):
    assert list(table) == list(COLUMNS)
    assert len(table) == 6 * 2 * (4 + 5)
    assert not table.duplicated(["case", "estimator", "seed", "parameter"]).any()
    assert (table["error"] == "").all()
    assert np.isfinite(table.select_dtypes("float")).all(axis=None)
    assert table["case"].cat.categories.tolist() == ["true", "asymmetric"]


def test_all_estimators_see_the_same_record(table):
    values = table.pivot_table(
        index=["case", "seed", "parameter"], columns="estimator", values="theta", observed=True
    )
    assert (values["ls"] == values["robust"]).all()


@pytest.mark.parametrize(
    "how", [{"n_jobs": 2}, {"n_jobs": 2, "backend": "threading"}], ids=["loky", "threading"]
)
def test_any_number_of_workers_gives_the_same_table(study, table, how):
    same(study.run(**how), table)


def test_blas_threads_do_not_matter(study, table):
    from threadpoolctl import threadpool_limits

    with threadpool_limits(2):
        same(study.run(), table)


def test_progress_is_told(study):
    told = []
    study.run(progress=told.append)
    assert told[-1].done == told[-1].total == 12
    assert told[-1].left == 0.0 < told[-1].elapsed
    assert all(a.done < b.done for a, b in zip(told, told[1:], strict=False))


class Fails:
    """An estimator that fails for one record in two."""

    def fit(self, problem):
        if problem.record.name.endswith(("0", "2", "4")):
            raise RuntimeError("no luck\nand more of it")
        return dict.fromkeys(problem.names, 1.0)


def test_a_failure_is_a_row_with_its_reason(study):
    table = Study(study.cases[:1], {"ls": iv.IDIMLS(), "fails": Fails()}, seeds=4).run()
    failed = table[table["error"] != ""]
    assert failed["error"].unique().tolist() == ["RuntimeError: no luck"]
    assert sorted(failed["seed"].unique()) == [0, 2]
    assert failed["theta"].isna().all() and not failed["converged"].any()
    assert failed["parameter"].tolist() == list(THETA) * 2
    fits = study.score(table, bounds=False).fits.set_index("estimator")
    assert fits.loc["fails", "failed"] == 50.0 and fits.loc["ls", "failed"] == 0.0


def test_an_unstable_truth_is_a_row_too():
    wild = Case("wild", iv.axes.emps(), {**THETA, "inertia": 1.0}, REFERENCE)
    table = Study([wild], [iv.IDIMLS()], seeds=1).run()
    assert table["error"].str.contains("unstable").all() or table["theta"].notna().all()


def test_one_holdout_record_serves_every_repetition(study, table):
    errors = table[table["estimator"] == "ls"].groupby("case", observed=True)["holdout_error"]
    assert (errors.std() / errors.mean() < 0.05).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([], [iv.IDIMLS()]), "at least one"),
        (([case(), case()], [iv.IDIMLS()]), "each of its own name"),
        (([case()], []), "at least one estimator"),
        (([case()], [iv.IDIMLS(), iv.IDIMLS()]), "two estimators are called 'idim-ls'"),
        (([case()], [iv.IDIMLS]), "no object with a method fit"),
        (([case()], [iv.IDIMLS()], 0), "seeds = 0"),
    ],
)
def test_impossible_studies_are_refused(arguments, message):
    with pytest.raises(IVToolsError, match=message):
        Study(*arguments)


def test_an_unknown_backend_is_refused(study):
    with pytest.raises(IVToolsError, match="loky, threading or dask"):
        study.run(backend="mpi")


# --- from outside --------------------


class LinearModels:
    """Two-stage least squares of linearmodels, with the noise-free motion as instruments."""

    def fit(self, problem):
        from linearmodels.iv import IV2SLS

        X = pd.DataFrame(problem.X, columns=problem.names)
        Z = pd.DataFrame(problem.instruments(problem.record.theta_true)).add_prefix("z")
        return IV2SLS(problem.y, None, X, Z).fit(cov_type="robust")


class CurveFit:
    """Least squares by scipy's curve_fit."""

    def fit(self, problem):
        from scipy.optimize import curve_fit

        theta, cov = curve_fit(lambda X, *theta: X @ theta, problem.X, problem.y, p0=np.ones(4))
        self_made = type("Result", (), {})()
        self_made.params = dict(zip(problem.names, theta, strict=True))
        self_made.std_errors = dict(zip(problem.names, np.sqrt(np.diag(cov)), strict=True))
        return self_made


def test_one_class_with_one_method_enters_the_comparison():
    noisy = case(encoder_noise=1e-5)
    study = Study([noisy], [iv.IDIMLS(), LinearModels(), CurveFit()], seeds=8)
    table = study.run()
    assert (table["error"] == "").all()
    assert table["std_error"].notna().all()
    theta = table.pivot_table(
        index=["seed", "parameter"], columns="estimator", values="theta", observed=True
    )
    np.testing.assert_allclose(theta["CurveFit"], theta["idim-ls"], rtol=1e-6)
    bias = study.score().table.set_index(["parameter", "estimator"])["bias"]["inertia"]
    assert bias["idim-ls"] < -3.0 < abs(bias["LinearModels"]) < 1.0


def test_an_outside_estimator_is_sent_to_other_processes():
    study = Study([case()], [CurveFit()], seeds=2)
    same(study.run(n_jobs=2), study.run())


# --- scores --------------------


def made(error: np.ndarray, std_error: float) -> pd.DataFrame:
    """Return a table of one parameter whose errors are known."""
    n = len(error)
    constant = {"case": "c", "estimator": "e", "parameter": "inertia", "theta_true": 50.0}
    table = pd.DataFrame({"theta": 50.0 + error, "seed": np.arange(n), **constant})
    table = table.assign(
        std_error=std_error, converged=True, error="", n_iter=1, n_simulations=0, runtime=0.1
    )
    return table.assign(relative_error=1.0, holdout_error=2.0).astype(
        {"case": "category", "estimator": "category", "parameter": "category"}
    )


def test_scores_of_known_errors():
    error = 0.5 + 2.0 * np.random.default_rng(1).standard_normal(20_000)
    row = Score.of(made(error, 2.0)).table.iloc[0]
    assert row["bias"] == pytest.approx(1.0, abs=3 * row["bias_mcse"])
    assert row["sd"] == pytest.approx(4.0, abs=3 * row["sd_mcse"])
    assert row["sd_mcse"] == pytest.approx(4.0 / np.sqrt(2 * 20_000), rel=0.05)
    assert row["rmse"] == pytest.approx(np.hypot(1.0, 4.0), abs=3 * row["rmse_mcse"])
    from scipy.stats import norm

    inside = norm.cdf(1.96 - 0.25) - norm.cdf(-1.96 - 0.25)
    assert row["coverage"] == pytest.approx(100 * inside, abs=3 * row["coverage_mcse"])


def test_fits_that_did_not_converge_are_counted_and_left_out():
    table = made(np.array([0.0, 0.1, -0.1, 1e6]), 1.0)
    table.loc[3, "converged"] = False
    score = Score.of(table)
    assert score.table["n"].tolist() == [3]
    assert score.fits["converged"].tolist() == [75.0]
    assert abs(score.table["bias"].iloc[0]) < 1e-9


def test_least_squares_is_biased_by_encoder_noise_and_the_score_says_so():
    cases = [case(f"{e:g}", encoder_noise=e, factors={"encoder_noise": e}) for e in (1e-8, 1e-5)]
    study = Study(cases, [iv.IDIMLS()], seeds=12)
    study.run()
    score = study.score()
    inertia = score.table.set_index(["parameter", "case"]).loc["inertia"]
    assert abs(inertia.loc["1e-08", "bias"]) < 1.0
    assert inertia.loc["1e-05", "bias"] < -2.0 - 3 * inertia.loc["1e-05", "bias_mcse"]
    assert ["1e-05", "inertia"] in score.biased()[["case", "parameter"]].astype(str).values.tolist()
    assert set(score.best()["estimator"]) == {"idim-ls"}


def test_least_squares_reaches_the_bound_where_it_is_the_likelihood():
    quiet = case(encoder_noise=0.0, pipeline=iv.Pipeline(None, 1))
    study = Study([quiet], [iv.IDIMLS()], seeds=60)
    study.run()
    row = study.score().table.set_index("parameter").loc[["inertia", "offset"]]
    assert (row["sd"] / row["bound"]).between(0.8, 1.25).all()


def test_the_bound_does_not_apply_to_a_wrong_model():
    wrong = case(fitted=iv.axes.emps().with_terms("inertia", "viscous", "coulomb"))
    assert wrong.bound().isna().all()
    assert case(encoder_noise=0.0, force_noise=0.0).bound().isna().all()
    assert case().bound().notna().all()


def test_the_bound_is_continuous_in_the_noise():
    none, little = (case(encoder_noise=e).bound() for e in (0.0, 1e-11))
    np.testing.assert_allclose(none, little, rtol=0.05)
    white, coloured = (case(force_noise_pole=p).bound() for p in (0.0, 1e-6))
    np.testing.assert_allclose(white, coloured, rtol=0.05)


def test_a_parameter_the_truth_does_not_have_is_not_scored():
    asymmetric = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    theta = {"inertia": 95.0, "viscous_pos": 165.0, "coulomb_pos": 20.0, "viscous_neg": 240.0,
             "coulomb_neg": 21.0}  # fmt: skip
    wrong = Case("w", asymmetric, theta, REFERENCE, fitted=iv.axes.emps(), expected={"offset": 0.5})
    assert np.isnan(wrong.theta_true["viscous"]) and wrong.theta_true["offset"] == 0.5
    study = Study([wrong], [iv.IDIMLS()], seeds=2)
    study.run()
    scores = study.score().table.set_index("parameter")
    assert np.isnan(scores.loc["viscous", "bias"]) and np.isfinite(scores.loc["offset", "bias"])


def test_reports_and_figures(study, table, tmp_path):
    score = study.score(table)
    page = score.save(tmp_path)
    text = page.read_text(encoding="utf-8")
    assert "<svg" in text or "data:image/svg" in text
    assert "asymmetric" in (tmp_path / "report.md").read_text(encoding="utf-8")
    assert max(map(len, str(score).splitlines())) <= 80
    assert "2 cases, 2 estimators, 24 fits" in repr(score)
    assert score.plot().axes
    assert set(score.to_dict()) == {"title", "scores", "fits"}
    read = pd.read_csv(tmp_path / "scores.csv")
    assert len(read) == len(score.table)


def test_nothing_to_score_yet():
    with pytest.raises(IVToolsError, match="run\\(\\) the study"):
        Study([case()], [iv.IDIMLS()]).score()


# --- study files --------------------


@pytest.mark.parametrize("name", NAMES)
def test_named_studies_run(name):
    study = load(name, seeds=1)
    assert study.title and study.question
    assert len({c.identity for c in study.cases}) == len(study.cases)
    study.cases[0].record(0)
    study.cases[-1].problem(study.cases[-1].record(0))


def test_the_issue_names_its_studies():
    asked = "methods noise filtering starting-values misspecified-friction excitation sample-rate"
    assert set(asked.split()) <= set(NAMES)


def test_a_study_file_in_toml(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(
        textwrap.dedent("""
        title = "Mine"
        estimators = ["idim-ls", { method = "idim-ls", label = "white", cov_type = "robust" }]
        seeds = 7
        [case]
        theta = { inertia = 95.0, viscous = 200.0, coulomb = 20.0, offset = 0.0 }
        pipeline = { cutoff_hz = 50 }
        reference = { kind = "multisine", duration = 4 }
        [vary]
        "pipeline.cutoff_hz" = [80, "none"]
        [vary.truth.plain]
        [vary.truth.stribeck]
        effects.stribeck = { force = 5.0, speed = 0.01 }
        fitted = { terms = ["inertia", "viscous", "coulomb", "offset"] }
        """)
    )
    study = load(file)
    names = [c.name for c in study.cases]
    assert names == [
        "cutoff_hz 80, truth plain",
        "cutoff_hz 80, truth stribeck",
        "cutoff_hz none, truth plain",
        "cutoff_hz none, truth stribeck",
    ]
    assert list(study.estimators) == ["idim-ls", "white"] and study.seeds == 7
    assert study.cases[0].rows.cutoff_hz == 80 and study.cases[2].rows.cutoff_hz is None
    assert study.cases[3].factors == {"pipeline.cutoff_hz": "none", "truth": "stribeck"}
    assert not study.cases[1].well_specified and study.cases[0].well_specified


def test_a_study_file_in_python(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(
        textwrap.dedent("""
        import ivtools as iv
        from ivtools.study import Case, Study, Trapezoids

        class Mine:
            def fit(self, problem):
                return dict.fromkeys(problem.names, 2.0)

        theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": 0.0}
        study = Study([Case("c", iv.axes.emps(), theta, Trapezoids(3.0))], [Mine()])
        """)
    )
    table = load(file, seeds=2).run(n_jobs=2)
    assert table["estimator"].unique().tolist() == ["Mine"] and (table["theta"] == 2.0).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seeds = [", "is not TOML"),
        ("sedes = 3", "does not know 'sedes'"),
        ("estimators = ['idim-xx']", "idim-xx"),
        ("estimators = ['idim-ls']\n[case]\nnoise = 1", "does not know 'noise'"),
        ("estimators = ['idim-ls']\n[case]\nreference = {kind = 'steps'}", "'steps' is unknown"),
        ("estimators = ['idim-ls']\n[vary]\nquantum = 3", "give a list of values"),
        ("estimators = ['idim-ls', 'idim-ls']", "one name"),
    ],
)
def test_a_wrong_study_file_says_what_is_wrong(tmp_path, text, message):
    file = tmp_path / "wrong.toml"
    file.write_text(text)
    with pytest.raises(IVToolsError, match=message):
        load(file)


def test_a_python_file_without_a_study(tmp_path):
    file = tmp_path / "wrong.py"
    file.write_text("1/0")
    with pytest.raises(IVToolsError, match="ZeroDivisionError"):
        load(file)
    file.write_text("x = 1")
    with pytest.raises(IVToolsError, match="defines no study"):
        load(file)
    with pytest.raises(IVToolsError, match="neither a named study"):
        load("no-such-study")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"seeds": True}, "seeds = True; it is a whole number"),
        ({"seeds": 10**400}, "seeds = 1000.*; it is a whole number"),
        ({"estimators": 3}, "estimators = 3; it is a list"),
        ({"estimators": [{"method": "idim-iv", "tol": "a"}]}, "idim-iv: tol = 'a'; it is a number"),
        ({"case": {"reference": "x"}}, "a reference = 'x'; it is a table"),
        ({"case": {"reference": {"strokes": "abc"}}}, "strokes = 'abc'; it is a list, each a num"),
        ({"case": {"theta": 1}}, "theta = 1; it is a table, each value a number"),
        ({"case": {"theta": {"inertia": 1e200}}}, "inertia is 1e\\+200; it must be finite"),
        ({"case": {"pipeline": {"cutoff_hz": "fast"}}}, "cutoff_hz = 'fast'; it is a number or n"),
        ({"case": {"terms": "inertia"}}, "terms = 'inertia'; it is a list"),
        ({"case": {"effects": {"stribeck": 1}}}, "effects = .*; it is a table"),
        ({"case": {"sampling_hz": 1e12}}, "1e.13 samples; a record has 200 to 10000000"),
        ({"vary": 3}, "vary. is 3; it is a table"),
        ({"vary": {"case": 3}}, "vary. case = 3; give a list of values"),
    ],
)
def test_a_damaged_study_file_says_what_it_wants(changes, message):
    theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    case = {"axis": "emps", "theta": theta} | changes.get("case", {})
    tables = {"seeds": 1, "estimators": ["idim-ls"]} | changes | {"case": case}
    with pytest.raises(IVToolsError, match=message) as caught:
        named.from_tables(tables).cases[0].record(0)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300
