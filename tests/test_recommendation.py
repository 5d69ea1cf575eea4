"""What a comparison recommends, and how it shows results that are no estimates."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest

from ivtools import linalg
from ivtools.comparison import compare
from ivtools.comparison_table import labels_of, model_of
from ivtools.recommendation import recommend
from ivtools.results import FitResults

NAMES = ("inertia", "viscous", "offset")
FORCE = ("simulated-holdout", "force")


@dataclass(frozen=True)
class Noise:
    """How the columns and the error of a regression hang together."""

    endogenous: float = 0.0
    strength: float = 1.0


def fitted(method="idim-ls", noise=Noise(), instruments=False, seed=0, **status):  # noqa: B008
    rng = np.random.default_rng(seed)
    drive, own = rng.standard_normal((2, 800, 2))
    X = np.column_stack([noise.strength * drive + own, np.ones(800)])
    e = noise.endogenous * own[:, 0] + 0.3 * rng.standard_normal(800)
    y = X @ [2.0, 3.0, 1.0] + e
    Z = np.column_stack([drive, np.ones(800)]) if instruments else None
    theta = linalg.solve_iv(X, y, Z)
    simulations = 3 if instruments else 0
    return FitResults.from_solution(
        method, theta, X, y, names=NAMES, Z=Z, units=("kg", "N s/m", "N"),
        n_simulations=simulations, **status,
    )  # fmt: skip


def chosen(fits, errors):
    return recommend([f.method for f in fits], fits, [{FORCE: e} for e in errors])


def test_the_least_holdout_error_of_those_that_converged_wins():
    fits = [fitted("a"), fitted("b"), fitted("c", converged=False)]
    found = chosen(fits, [5.0, 4.0, 3.0])
    assert found.label == "b"
    assert found.reason == (
        "converged, least hold-out force error (4 %; a 5 %); no test against it; not converged: c"
    )


def test_least_squares_that_a_test_finds_biased_is_passed_over():
    biased = Noise(endogenous=0.5)
    fits = [fitted("idim-ls", biased), fitted("idim-iv", biased, instruments=True)]
    found = chosen(fits, [4.0, 4.02])
    assert found.label == "idim-iv"
    assert "within 1 % of the least" in found.reason
    assert "idim-ls is passed over, as least squares is biased (Wu-Hausman" in found.reason
    clean = [fitted("idim-ls"), fitted("idim-iv", instruments=True)]
    assert chosen(clean, [4.0, 4.02]).label == "idim-ls"


def test_weak_instruments_count_against_a_result():
    weak = Noise(strength=0.01)
    fits = [fitted("idim-iv", weak, instruments=True), fitted("idim-ls", weak)]
    found = chosen(fits, [4.0, 4.0])
    assert found.label == "idim-ls" and "weak" in found.reason


def test_without_a_converged_result_nothing_is_recommended():
    assert chosen([fitted(converged=False)], [1.0]).label == ""
    assert "nothing has converged" in str(chosen([fitted(converged=False)], [1.0]))
    assert recommend([], [], []) is None


def test_the_error_of_another_signal_is_no_criterion():
    position = fitted("cloe", extras={"signal": "position"})
    figures = [{("relative_error", "direct"): 0.1}, {("relative_error", "direct"): 5.0}]
    assert recommend(["cloe", "idim-ls"], [position, fitted()], figures).label == "idim-ls"


def test_a_table_marks_what_is_no_estimate_and_ends_with_the_recommendation():
    fits = [fitted("idim-ls"), fitted("idim-iv", instruments=True, converged=False)]
    comparison = compare(fits)
    lines = str(comparison).splitlines()
    assert all(len(line) <= 80 for line in lines)
    assert "idim-iv !" in str(comparison) and "! has not converged" in str(comparison)
    row = next(line for line in lines if line.startswith("inertia, kg"))
    value, error = row.removeprefix("inertia, kg").split()[:2]
    assert len(value.split(".")[1]) == len(error.strip("()").split(".")[1])
    assert row.endswith("(-)")
    assert any(line.startswith("Recommended: idim-ls: converged, least") for line in lines)
    assert comparison.best is fits[0]
    content = json.loads(json.dumps(comparison.to_dict(), allow_nan=False))
    assert content["idim-iv"]["converged"] is False and content["idim-iv"]["recommended"] is None
    assert set(content["idim-iv"]["std_errors"].values()) == {None}
    assert content["idim-ls"]["recommended"].startswith("converged, least")


@pytest.mark.parametrize("count", [2, 5])
def test_no_two_tables_have_the_same_title(count):
    base = fitted()
    asym = ["inertia", "viscous_pos", "viscous_neg"]
    more = ["inertia", "viscous", "stribeck.force"]
    models = [base, *(replace(base, params=base.params.set_axis(n), cov=base.cov.set_axis(
        n).set_axis(n, axis=1)) for n in (asym, more))]  # fmt: skip
    fits = [replace(fit, method=f"m{k}") for fit in models for k in range(count)]
    labels = labels_of(fits)
    assert len(set(labels)) == len(fits) and "m0 asym." in labels and "m1 +stribeck" in labels
    titles = [t.splitlines()[0].strip() for t in str(compare(fits)).split("\n\n")]
    assert len(set(titles)) == len(titles)
    assert model_of(fits[-1]) == "symmetric friction, stribeck"
    assert all(any(words in t for t in titles) for words in ("asymmetric friction", "stribeck"))


def test_several_friction_models_stand_in_one_table_if_it_holds_them():
    base = fitted()
    names = ["inertia", "viscous_pos", "viscous_neg"]
    cov = base.cov.set_axis(names).set_axis(names, axis=1)
    other = replace(base, params=base.params.set_axis(names), cov=cov)
    text = str(compare([base, other]))
    assert text.count("Comparison") == 1 and len(text.split("\n\n")) == 1
    header = text.splitlines()[2].split("  ")
    assert [cell.strip() for cell in header if cell] == ["idim-ls", "idim-ls asym."]
    assert text.splitlines()[-1].startswith(("Recommended", "  "))
