"""The generator of withheld cases against theory; its scorer and runner against made-up answers."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import statsmodels.api as sm

import ivtools as iv
from ivtools.loop.axis_file import from_tables

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.withheld import (  # noqa: E402
    axes,
    calibration,
    ceiling,
    cells,
    motions,
    robots,
    scores,
    truth,
    unknowns,
    weights,
)  # fmt: skip
from benchmarks.withheld.cases import DETECTABLE, draw  # noqa: E402
from benchmarks.withheld.experiments import Experiment, play, record, signature  # noqa: E402
from benchmarks.withheld.run import done, run  # noqa: E402
from benchmarks.withheld.suites import SUITES, Task  # noqa: E402

N, HEAD = 6000, 200  # samples; those that know the start


def silent(seed, kind):
    """Return a random axis without limit, and a motion without noise."""
    rng = np.random.default_rng(seed)
    axis = replace(axes.draw(rng), limit=1e3)
    zero = np.zeros(N)
    return axis, Experiment(motions.draw(rng, kind, N), motions.pulses(rng, axis, N), zero, zero)


def scaled(axis):
    """Return the true base parameters of the axis as written, SI."""
    force = axis.mass * axis.length
    return {
        "inertia": axis.inertia * axis.mass,
        "viscous": axis.viscous * axis.mass,
        "coulomb": axis.coulomb * force,
        "offset": axis.offset * force,
    }


def off(a, b):
    """Return the difference relative to the second signal, after the start."""
    return np.linalg.norm((a - b)[HEAD:]) / np.linalg.norm(b[HEAD:])


@pytest.mark.parametrize(("seed", "kind"), list(enumerate(motions.KINDS)))
def test_without_noise_the_plant_agrees_with_the_toolkit(seed, kind):
    axis, experiment = silent(seed, kind)
    fine = play(axis, {}, experiment, sub=320)
    simulated = from_tables(axis.tables()).simulate(
        iv.Record.from_dict(record(axis, experiment, fine)), scaled(axis)
    )
    assert off(fine[1], simulated.nu[:, 0]) < 1e-4
    assert off(play(axis, {}, experiment)[1], simulated.nu[:, 0]) < 1e-3


@pytest.mark.parametrize(
    "effect",
    [
        {},
        {"str_f": 8.0, "str_v": 0.01},
        {"pre_s": 5e5},
        {"flex_hz": 40.0, "flex_z": 0.03, "flex_r": 0.2, "flex_fr": 0.3},
        {"gap": 4e-5, "gap_hz": 170.0, "gap_z": 0.2, "flex_r": 0.25, "flex_fr": 0.5},
        {"lag": 2e-3},
    ],
    ids=["rigid", "stribeck", "dahl", "flexible", "backlash", "lag"],
)
def test_the_plant_converges_in_its_own_step(effect):
    axis, experiment = silent(0, "bang-bang")
    exact = play(axis, {"": effect}, experiment, sub=640)[1]
    coarse, fine = (off(play(axis, {"": effect}, experiment, sub=s)[1], exact) for s in (20, 40))
    assert coarse < 2e-3
    assert 1.6 < coarse / fine < 3.0  # first order


def test_a_constant_speed_takes_the_force_that_friction_takes():
    axis, _ = silent(3, "moves")
    speed = 0.05
    ref = speed * axes.DT * np.arange(N)
    nu = play(axis, {}, Experiment(ref, *np.zeros((3, N))))[1]
    expected = axis.viscous * speed + axis.coulomb + axis.offset
    assert axis.gain * nu[-1] == pytest.approx(expected, rel=1e-3)


def test_the_signature_of_a_base_parameter_is_nothing():
    axis, experiment = silent(1, "bang-bang")
    rng = np.random.default_rng(0)
    noisy = replace(experiment, force=rng.normal(size=N), noise=1e-8 * rng.normal(size=N))
    assert signature(axis, {"": {"od_a": 2.0, "od_tau": 1e-4}}, noisy) < 0.01
    assert signature(axis, {"": {"od_a": 2.0, "od_tau": 4.0}}, noisy) > 0.05


@pytest.mark.parametrize("effect", ["spring", "saturation"])
def test_a_case_is_visible_and_its_command_off_the_limit(effect):
    case = draw(Task("single", 0, (effect,)))
    limit = case.axis.limit
    tops = [np.max(np.abs(r["nu"] - r.get("added", 0.0))) for r in case.records]
    assert max(tops) < 0.97 * limit
    if effect == "saturation":
        assert max(tops) == pytest.approx(case.effects[effect]["limit"])
    else:
        assert case.label["signature"][effect] >= DETECTABLE
    assert not set(case.axis.tables()["axis"]) & {"effects", "label"}


@pytest.mark.parametrize("kind", unknowns.KINDS)
def test_a_background_without_a_name_comes_again_unless_it_is_of_time_alone(kind):
    rng = np.random.default_rng(0)
    path = motions.draw(rng, "moves", N)
    one, two = unknowns.draw(rng, kind, [path, path])
    assert np.array_equal(one, two) != (kind in unknowns.OF_TIME)
    assert 0.8 <= np.sqrt(np.mean(np.var([one, two], axis=1))) <= 6.0


def test_a_case_with_a_background_without_a_name_shows_it():
    case = draw(Task("unknown", 0, (), ("smooth",)))
    assert case.label["unknown"] >= 0.5 and case.label["effects"] == []
    assert np.std(case.steady[0]) > 0.0


def test_the_true_figure_of_the_true_model_is_the_floor():
    case = draw(Task("none", 0))
    gap = iv.diagnose(
        *(iv.Record.from_dict(r) for r in case.records[:1]),
        from_tables(case.axis.tables()),
        holdout=iv.Record.from_dict(case.records[1]),
    )
    found = truth.measure(case, gap, from_tables(case.axis.tables()), 2)
    assert not gap.effects
    assert found.after == pytest.approx(found.floor, rel=0.05)
    low, high = gap.to_dict()["shrink"]["interval_frozen"]
    assert low < found.after_frozen < high
    assert found.after < found.after_frozen == pytest.approx(gap.shrink.after_frozen, rel=0.05)


ANSWERS = [
    (["spring"], ["spring"], {}, "right"),
    (["spring"], ["cogging"], {"cogging": ["spring"]}, "ambiguous"),
    (["spring"], ["cogging"], {"cogging": ["spring", "stribeck"]}, "vague"),
    (["spring"], ["spring"], {"spring": ["cogging", "stribeck"]}, "vague"),
    (["spring"], ["spring", "cogging"], {}, "extra"),
    (["spring"], ["cogging"], {}, "wrong"),
    (["spring"], [], {}, "abstained"),
    (["spring", "cogging"], ["cogging", "spring"], {}, "right"),
    (["spring", "cogging"], ["cogging"], {}, "subset"),
    (["spring", "cogging"], ["stribeck"], {}, "wrong"),
    (["spring", "cogging"], ["spring", "encoder-eccentricity"], {}, "twin"),
    (["spring", "cogging"], ["spring", "dead-zone"], {}, "wrong"),
]


@pytest.mark.parametrize(("hidden", "named", "others", "expected"), ANSWERS)
def test_scores(hidden, named, others, expected):
    found = {"effects": named, "ambiguous_with": others, "verdict": "explained"}
    suite = "two" if len(hidden) > 1 else "single"
    assert scores.score(found, {"suite": suite, "effects": hidden}) == expected


@pytest.mark.parametrize(
    ("suite", "named", "verdict", "expected"),
    [
        ("none", [], "adequate", "right"),
        ("none", [], "unexplained", "abstained"),
        ("none", ["spring"], "explained", "wrong"),
        ("bursts", [], "non-repeatable", "right"),
        ("bursts", [], "adequate", "abstained"),
        ("background", [], "unexplained", "right"),
        ("background", ["stribeck"], "partial", "wrong"),
        ("outside", [], "unexplained", "right"),
        ("outside", ["asymmetric-viscous"], "explained", "twin"),
        ("outside", ["cogging"], "partial", "flagged"),
        ("outside", ["cogging"], "explained", "wrong"),
    ],
)
def test_scores_where_nothing_can_be_named(suite, named, verdict, expected):
    found = {"effects": named, "ambiguous_with": {}, "verdict": verdict}
    hidden = ["spring"] if suite == "outside" else []
    assert scores.score(found, {"suite": suite, "effects": hidden}) == expected


def test_a_run_resumes_after_a_line_that_was_cut_off(tmp_path):
    tasks = [Task("none", 0), Task("none", 1)]
    path = tmp_path / "none.jsonl"
    first = {"key": tasks[0].key, "suite": "none", "seed": 0, "score": "failed"}
    path.write_text(json.dumps(first) + '\n{"key": "no')
    rows = list(run(tasks, path, 1, truth=False))
    assert [r["key"] for r in rows] == [tasks[1].key]
    assert done(path) == {t.key for t in tasks}
    assert rows[0]["score"] == "right"
    assert list(cells.load(tmp_path)[0]["score"]) == ["failed", "right"]


def test_every_suite_has_its_own_keys():
    tasks = [t for suite in SUITES.values() for t in suite(range(5))]
    assert len({t.key for t in tasks}) == len(tasks)


def test_probabilities_that_are_right_are_reliable():
    rng = np.random.default_rng(4)
    rows = [
        {
            "suite": "single",
            "label": {"effects": ["spring"] if rng.random() < p else ["cogging"]},
            "found": {"probability": {"spring": p}, "ambiguous_with": {}},
        }
        for p in rng.uniform(0.2, 1.0, 2000)
    ]
    assert calibration.reliability(calibration.stated(rows)).error < 0.04


def test_weights_are_those_of_a_logistic_regression():
    rng = np.random.default_rng(1)
    X = rng.normal(size=(4000, 3)) * [1.0, 5.0, 0.2] + [2.0, 0.0, -1.0]
    z = X @ [1.0, -0.3, 4.0] + 2.5
    y = (rng.uniform(size=len(z)) < 1.0 / (1.0 + np.exp(-z))).astype(float)
    peer = sm.Logit(y, sm.add_constant(X)).fit(disp=0).params
    np.testing.assert_allclose(weights.fit(X, y), peer, rtol=0.02)


def test_a_run_notes_the_evidence_for_its_names(tmp_path):
    task = next(t for t in SUITES["single"](range(1)) if t.effects == ("spring",))
    (row,) = run([task], tmp_path / "single.jsonl", jobs=1, truth=False)
    (found,), proof = weights.rows(tmp_path), row["found"]["evidence"]["spring"]
    assert found["name"] == "spring" and found["right"] and found["given"]
    assert {n: found[n] for n in proof} == pytest.approx(proof)  # made anew, to rounding
    names, X = weights.design([found])
    assert X.shape == (1, len(names)) and np.isfinite(X).all()


def test_a_gap_of_an_arm_is_one():
    """A joint's link, still and pulled by its weight, hangs below the drive by gap and spring."""
    loop = robots.arm(2, np.random.default_rng(0))
    t = np.arange(2000) * 1e-3
    rest = 1e-12 * np.random.default_rng(0).standard_normal((2000, 3))
    still = iv.Record(t, q=rest, q_ref=rest, nu=rest)
    hangs = []
    for gap in (0.0, 4e-3):
        true = robots.split(loop, "elbow", hz=40.0, damping=0.2, gap=gap)
        hangs.append(true.simulate(still, initial="rest", substeps=4).q[-1, 2])
    assert hangs[0] < 0.0 and hangs[1] - hangs[0] == pytest.approx(-2e-3, rel=0.02)


def test_the_ceiling_counts_what_the_largest_gain_would_score():
    def row(hidden, score, **gains):
        ranking = [{"effect": e, "closed": g, "held_out": True} for e, g in gains.items()]
        ranking.append({"effect": "spring", "closed": 0.99, "held_out": False})  # not fitted
        label = {"effects": hidden}
        return {
            "suite": "background",
            "label": label,
            "score": score,
            "found": {"ranking": ranking},
        }

    rows = [
        row(["cogging"], "right", cogging=0.5, gravity=0.2),
        row(["cogging"], "right", cogging=0.3, gravity=0.4),
        row(["gravity"], "abstained", gravity=0.1),
        row([], "right", cogging=0.2),
    ]
    said = ceiling.table([ceiling.leader(r) for r in rows]).splitlines()
    assert said[:2] == [
        "3 with an effect, 1 without",
        "named always: 2 right; the diagnosis: 2 good, either: 3",
    ]
    assert said[2].endswith("from 20 % closed on, 1 right, 1 wrong")
