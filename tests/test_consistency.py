"""Monte Carlo on the twin's axis in closed loop: bias, coverage, efficiency.

The records and the summary are those of benchmarks/consistency.py, whose committed result is
checked here as well.
"""

import sys
from pathlib import Path

import pandas as pd
import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))
import consistency  # noqa: E402

UNBIASED = ("idim-bciv", "idim-piv")
# At 1e-5 m the noise decides the sign of the friction force itself for a while around each
# reversal; that noise is not in the bound, and the inertia, seen there, takes most of it.
FRICTION_NOISE = {("idim-piv", 1e-5, "inertia")}


def table(seeds, noises, methods):
    chosen = {name: consistency.METHODS[name] for name in methods}
    return consistency.summarise(consistency.run(seeds, noises, chosen))


def check_bias(summary):
    """Unbiased within two standard errors; of many parameters a few exceed two, none four."""
    assert (summary["bias_percent"].abs() < 0.3).all()
    assert (summary["t"].abs() < 4.0).all()
    assert (summary["t"].abs() < 2.0).mean() >= 0.8


@pytest.fixture(scope="module")
def committed():
    return pd.read_csv(BENCHMARKS / "results" / "consistency.csv")


@pytest.mark.parametrize("method", UNBIASED)
def test_committed_bias_is_zero(committed, method):
    check_bias(committed[committed["method"] == method])


def test_committed_least_squares_is_biased(committed):
    row = committed[(committed["method"] == "idim-ls") & (committed["noise"] == 1e-5)]
    bias = row.set_index("parameter")["bias_percent"]
    assert bias["inertia"] < -5.0


@pytest.mark.parametrize("method", UNBIASED)
def test_committed_intervals_cover_what_they_say(committed, method):
    coverage = committed[committed["method"] == method]["coverage_percent"]
    assert 92.0 <= coverage.mean() <= 98.0
    assert coverage.between(90.0, 99.5).all()  # 200 seeds know each to 1.5 %


def test_committed_variance_is_near_the_bound(committed):
    refined = committed[committed["method"] == "idim-piv"]
    known = [
        (row.method, row.noise, row.parameter) in FRICTION_NOISE for row in refined.itertuples()
    ]
    ratio = refined[[not k for k in known]]["variance_over_bound"]
    assert ratio.mean() < 1.15
    assert ratio.max() < 1.15 * 1.25  # a variance of 200 seeds is known to 10 %


def test_every_committed_fit_has_converged(committed):
    assert (committed["converged_percent"] == 100.0).all()


def test_twelve_records_already_tell(twin):
    """Quick: at 1e-5 m least squares is off by 8 %, the compensated estimate by nothing."""
    summary = table(12, (1e-5,), ("idim-ls", "idim-bciv")).set_index(["method", "parameter"])
    assert summary.loc[("idim-ls", "inertia"), "bias_percent"] < -5.0
    unbiased = summary.loc["idim-bciv"]
    assert (unbiased["t"].abs() < 4.5).all()
    assert (unbiased["bias_percent"].abs() < 0.5).all()


@pytest.mark.slow
def test_two_hundred_records_agree_with_what_is_committed(committed):
    summary = table(200, consistency.POSITION_NOISE, ("idim-ls", *UNBIASED))
    for method in UNBIASED:
        check_bias(summary[summary["method"] == method])
    keys = ["method", "noise", "parameter"]
    both = summary.merge(committed, on=keys, suffixes=("", "_committed"))
    assert len(both) == len(summary)
    assert (both["bias_percent"] - both["bias_percent_committed"]).abs().max() < 0.05
    assert (both["coverage_percent"] - both["coverage_percent_committed"]).abs().max() < 3.0
