"""Monte Carlo of the other methods: a few records here, the committed result in full."""

import sys
from pathlib import Path

import pandas as pd
import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))
import other_methods  # noqa: E402

UNBIASED = ["srivc", "rivc", "clsrivc", "sriv", "drive gain, idim-bciv", "drive gain, idim-piv"]
DISTURBED = "linear axis in closed loop, its position disturbed"


@pytest.fixture(scope="module")
def experiment():
    return other_methods.Experiment()


@pytest.fixture(scope="module")
def committed():
    return pd.read_csv(BENCHMARKS / "results" / "other_methods.csv")


def biases(table, **where):
    for name, value in where.items():
        table = table[table[name] == value]
    assert len(table)
    return table.assign(t=table["bias_percent"] / table["bias_error_percent"])


@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_the_set_holds_the_truth_in_closed_loop_whenever_the_noise_respects_the_bound(
    experiment, noise
):
    bounds = other_methods.row_bounds(experiment)
    rows = [r for seed in range(100, 102)
            for r in other_methods.containment(noise, seed, bounds, experiment)]  # fmt: skip
    found = pd.DataFrame(rows)
    assert found.loc[found["bound_kind"] == "guaranteed", "respected"].all()
    good = found[found["respected"]]
    assert good["set_holds"].all() and good["box_holds"].all() and not good["empty"].any()


def test_the_set_held_the_truth_in_every_committed_record():
    sets = pd.read_csv(BENCHMARKS / "results" / "set_membership.csv")
    assert len(sets) >= 300
    assert sets.loc[sets["bound_kind"] == "guaranteed", "respected"].all()
    assert 1.0 - sets.loc[sets["bound_kind"] == "tight", "respected"].mean() > 0.1
    good = sets[sets["respected"]]
    assert good["set_holds"].all() and good["box_holds"].all()
    assert not sets.loc[~sets["respected"], "set_holds"].any()


@pytest.mark.parametrize("noise", [0.0, 1e-5])
def test_transfer_functions_of_a_closed_loop(experiment, noise):
    rows = other_methods.functions("linear axis in closed loop", noise, 200, experiment)
    found = pd.DataFrame(rows)
    found = found[~found["method"].eq("rivbj")]
    error = (found["estimate"] / found["truth"] - 1.0).abs()
    assert found["converged"].all() and (error < (0.05 if noise else 1e-4)).all()


def test_nothing_depends_on_the_start_that_says_it_does_not(committed):
    searches = committed["method"].isin(["nsga2"])
    for _, pair in committed[~searches].groupby(["setting", "method", "noise", "parameter"]):
        assert pair["failed"].sum() == 0 and pair["not_converged"].sum() == 0
        assert pair["bias_percent"].max() - pair["bias_percent"].min() < 0.02


def test_a_record_without_noise_gives_the_parameters(committed):
    exact = committed[(committed["noise"] == 0.0) & ~committed["method"].eq("nsga2")]
    worst = exact.groupby("method")["bias_percent"].agg(lambda b: b.abs().max())
    assert (worst.drop("set-membership") < 0.1).all()
    assert worst["set-membership"] < 2.5


@pytest.mark.parametrize("method", UNBIASED)
def test_the_unbiased_ones_are(committed, method):
    table = committed[committed["noise"] > 0.0]
    if method in ("srivc", "sriv"):
        table = table[table["setting"] != DISTURBED]
    assert (biases(table, method=method)["t"].abs() < 4.0).all()


def test_the_biased_ones_are_those_that_say_so(committed):
    plain = biases(committed, method="srivc", setting=DISTURBED, noise=1e-3, parameter="a1")
    closed = biases(committed, method="clsrivc", setting=DISTURBED, noise=1e-3, parameter="a1")
    assert (plain["t"] < -6.0).all() and (plain["bias_percent"] < -1.0).all()
    assert (closed["bias_percent"].abs() < 0.3).all()
    inertia = committed[(committed["noise"] == 1e-5) & (committed["parameter"] == "inertia")]
    bias = inertia.groupby("method")["bias_percent"].mean()
    assert bias["ml"] < -10.0 and bias["lmi-ls"] < -10.0
    assert -6.0 < bias["ml, errors in variables"] < -2.0
    assert abs(bias["lmi-iv"]) < 0.2
    tls = committed[(committed["method"] == "drive gain, tls") & (committed["noise"] == 1e-5)]
    assert (tls["bias_percent"] > 30.0).all()
