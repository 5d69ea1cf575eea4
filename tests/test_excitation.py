"""References that make a record tell the parameters: within limits, and better than chance."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from robots import six_loop, two_axes, two_joints

import ivtools as iv
from ivtools.cli import run
from ivtools.errors import AxisError
from ivtools.excitation import PATTERNS, Limits, fourier, pattern
from ivtools.excitation.fourier import Series
from ivtools.excitation.information import Information
from ivtools.pipeline import Motion

LIMITS = Limits.of({"lower": -1.5, "upper": 2.0, "speed": 3.0, "effort": 6.0}, ("one", "two"))
AXIS = Limits.of({"lower": 0.0, "upper": 0.25, "speed": 0.3, "acceleration": 2.0}, ("axis",))


def two_loop():
    return iv.RobotLoop(two_joints(), two_axes())


def test_effort_beyond_its_limit_is_said():
    theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": 0.0}
    loop = replace(iv.axes.emps(), start=theta)
    told = {
        effort: str(pattern(loop, replace(AXIS, effort=np.array([effort])), "steps").summary())
        for effort in (180.0, 400.0)
    }
    assert "axis: more effort than its limit" in told[180.0]
    assert "more effort" not in told[400.0]


@pytest.fixture(scope="module")
def found():
    return fourier(two_loop(), LIMITS, seconds=10.0)


def keeps(found, limits, slack=1e-3):
    q, dq, ddq = found.motion
    assert (q >= limits.lower - slack).all() and (q <= limits.upper + slack).all()
    assert (np.abs(dq) <= limits.speed * (1 + slack)).all()
    assert (np.abs(ddq) <= limits.acceleration * (1 + slack)).all()
    assert not (np.abs(found.effort) > limits.effort * (1 + 0.02)).any()


def test_limits_hold_and_it_is_better_than_the_best_of_sixty(found):
    keeps(found, LIMITS)
    assert found.condition < 0.9 * found.settings["best_random"]
    q, dq, _ = found.motion
    assert np.abs(dq[0]).max() < 1e-9  # at rest
    np.testing.assert_allclose(q[-1] + dq[-1] * 1e-3, q[0], atol=1e-4)  # periodic
    np.testing.assert_allclose(np.gradient(q, 1e-3, axis=0)[1:-1], dq[1:-1], atol=1e-4)


@pytest.mark.parametrize("soft", [False, True])
@pytest.mark.parametrize("criterion", ["condition", "d", "a"])
def test_the_derivative_is_that_of_the_criterion(criterion, soft):
    tight = replace(LIMITS, effort=np.array([1.0, 0.3]))  # so that efforts cost
    information = Information(two_loop(), tight, criterion, soft=soft)
    series = Series(10.0, 4, 60)
    rng = np.random.default_rng(0)
    c, centre = 0.3 * rng.standard_normal((2, series.size)), np.array([0.2, 0.1])
    way = rng.standard_normal(c.shape)

    def at(step):
        motion = series.motion(c + step * way, centre)
        return information(motion), motion

    cost, _ = at(0.0)
    change = sum(
        np.sum(slope * (basis @ way.T))
        for slope, basis in zip(cost.slopes, series.functions, strict=True)
    )
    step = 1e-6
    assert change == pytest.approx((at(step)[0].value - at(-step)[0].value) / 2e-6, rel=1e-3)


@pytest.mark.parametrize("loop, limits", [(two_loop(), LIMITS), (iv.axes.emps(), AXIS)])
def test_dry_friction_and_nothing_else_turns_softly(loop, limits):
    motion = Series(10.0, 4, 60).motion(
        0.02 * np.random.default_rng(0).standard_normal((limits.n_joints, 6)), limits.lower + 0.1
    )
    step, turn = (Information(loop, limits, soft=soft).matrix(motion) for soft in (False, True))
    changed = {loop.names[k] for k in np.flatnonzero((step != turn).any(axis=(0, 1)))}
    assert changed == {name for name in loop.names if "coulomb" in name} != set()
    assert np.abs(turn[step != turn]).max() <= 1.0
    signs = step != 0.0
    assert (np.sign(turn[signs]) == np.sign(step[signs])).all()


def test_criteria_find_what_they_look_for(found):
    loop = two_loop()
    others = {c: fourier(loop, LIMITS, seconds=10.0, criterion=c, tries=12) for c in ("d", "a")}
    for criterion, other in others.items():
        keeps(other, LIMITS)
        information = Information(loop, LIMITS, criterion)

        def value(excitation, information=information):
            return information(Motion(*(x[::50] for x in excitation.motion))).value

        assert value(other) < value(found)


def test_one_axis_has_series_too():
    found, again = (fourier(iv.axes.emps(), AXIS, seconds=10.0, tries=20) for _ in range(2))
    np.testing.assert_array_equal(again.motion.q, found.motion.q)  # the same arguments
    keeps(found, AXIS)
    assert found.motion.q.shape == (10000, 1)
    assert list(found.frame().columns) == ["t", "q_ref", "dq_ref"]


@pytest.mark.parametrize("kind", PATTERNS)
def test_patterns_keep_their_limits(kind):
    made = pattern(iv.axes.emps(), AXIS, kind)
    # a trapezium's corners lie between samples, and differences smear them
    keeps(made, AXIS, slack=0.02)
    assert np.abs(made.motion.dq[0]).max() < 1e-3
    assert np.ptp(made.motion.q) > 0.3 * 0.25


def test_bang_bang_uses_the_acceleration_and_dwells():
    made = pattern(iv.axes.emps(), AXIS, "bang-bang")
    assert np.abs(made.motion.ddq).max() > 0.95 * 2.0
    assert np.mean(made.motion.dq == 0.0) > 0.1


def test_the_report_may_be_read_by_a_loop(tmp_path):
    """What is written is a reference: a simulated loop follows it."""
    file, loop = tmp_path / "r.csv", iv.axes.emps()
    assert run(["excite", "emps", "--limits", str(_limits(tmp_path)), "--kind", "steps",
                "--out", str(file), "--json", str(tmp_path / "r.json")]) == 0  # fmt: skip
    table = pd.read_csv(file)
    q_ref = table[["q_ref"]].to_numpy()
    noise = np.random.default_rng(0).standard_normal(q_ref.shape)
    record = iv.Record(table["t"].to_numpy(), q=q_ref, q_ref=q_ref, nu=noise)
    sim = loop.simulate(record, {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": 0.0})
    assert np.abs(sim.q - q_ref).max() < 0.01
    assert (tmp_path / "r.svg").exists()
    assert json.loads((tmp_path / "r.json").read_text())["kind"] == "steps"


def _limits(folder):
    file = folder / "limits.toml"
    file.write_text("[limits]\nlower = 0.0\nupper = 0.2\nspeed = 0.2\nacceleration = 1.0\n")
    return file


def test_limits_of_a_model_and_of_single_joints():
    loop = six_loop()
    tables = {"limits": {"speed": 2.0}, "joint": {"joint_3": {"limits": {"speed": 1.0}}}}
    limits = Limits.from_tables(tables, loop.joints, loop.robot)
    assert limits.speed.tolist() == [2.0, 2.0, 1.0, 2.0, 2.0, 2.0]
    assert limits.effort[0] == 160.0 and limits.acceleration[2] == 4.0


def test_what_is_at_fault_is_said(tmp_path, capsys):
    with pytest.raises(AxisError, match="axis: the positions nan to 1 are no range; state lower"):
        Limits.of({"upper": 1.0, "speed": 1.0}, ("axis",))
    with pytest.raises(AxisError, match="axis: no speed is known"):
        Limits.of({"lower": 0.0, "upper": 1.0}, ("axis",))
    with pytest.raises(AxisError, match="no random motion stays within the efforts"):
        fourier(two_loop(), replace(LIMITS, effort=np.array([0.1, 0.1])), seconds=5.0, tries=6)
    with pytest.raises(AxisError, match="steps is for one axis"):
        pattern(two_loop(), LIMITS, "steps")
    with pytest.raises(AxisError, match="no move fits"):
        pattern(iv.axes.emps(), AXIS, "steps", seconds=0.5)
    bad = tmp_path / "bad.toml"
    bad.write_text("[limits]\nvelocity = 1.0\n")
    assert run(["excite", "emps", "--limits", str(bad)]) == 2
    assert "does not know 'velocity'; it knows: lower, upper" in capsys.readouterr().err


@pytest.mark.slow
def test_six_joints_below_thirty():
    loop = six_loop()
    found = fourier(loop, Limits.of({}, loop.joints, robot=loop.robot))
    keeps(found, found.limits)
    links = loop.robot.standard_names
    X = Information(loop, found.limits).matrix(Motion(*(x[::50] for x in found.motion)))
    base = X.reshape(-1, X.shape[2])[:, loop.base.columns < len(links)]
    assert np.linalg.cond(base) < found.condition < 26.0 < found.settings["best_random"]
