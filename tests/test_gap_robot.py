"""A robot is diagnosed joint by joint, and what a joint shows of another's effect is not named."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from robots import axis, plan, reference, six_loop, two_axes, two_joints
from scipy import signal
from threadpoolctl import threadpool_info, threadpool_limits

import ivtools as iv
from benchmarks import moves
from benchmarks.withheld.robots import draw, simulated, split
from ivtools.cli import run
from ivtools.errors import AxisError
from ivtools.estimators.instrumental import IDIMIV
from ivtools.gap import fit, response
from ivtools.gap.attribute import Supposed, attribution
from ivtools.gap.candidate import starts
from ivtools.gap.diagnose import Task, begin, finish
from ivtools.gap.fit import gauss_newton
from ivtools.gap.fold import Doubt, Fold, Link, usable
from ivtools.gap.library import Scales
from ivtools.gap.response import Response
from ivtools.gap.robot import alone, assumed, behind, identified, joint, joints, links
from ivtools.loop import robot_engine
from ivtools.physics import EFFECTS


def measured(loop, seed, noise=2e-5, seconds=12.0):
    rng = np.random.default_rng(seed)
    t, q_ref = reference(seconds, n=loop.n_joints, seed=seed)
    shaken = noise * rng.standard_normal(q_ref.shape)
    sim = loop.simulate(plan(t, q_ref), initial="rest", position_noise=shaken)
    return iv.Record(t, q=sim.q, q_ref=q_ref, nu=sim.nu, name=f"seed {seed}")


def two_loop():
    return iv.RobotLoop(two_joints(), two_axes())


@pytest.fixture(scope="module")
def found():
    loop = two_loop()
    true = loop.with_effect("elbow", "stribeck", force=0.15, speed=0.1, exponent=2.0)
    return iv.diagnose_robot(measured(true, 1), loop, measured(true, 2))


def test_a_robot_is_diagnosed_the_same_however_many_threads_linear_algebra_has(found):
    """A last digit leads the search of a narrow valley elsewhere."""
    loop = two_loop()
    true = loop.with_effect("elbow", "stribeck", force=0.15, speed=0.1, exponent=2.0)
    with threadpool_limits(2 if threads() == 1 else 1, "blas"):
        again = iv.diagnose_robot(measured(true, 1), loop, measured(true, 2))
    for name in loop.joints:
        assert again[name].theta == found[name].theta


def threads():
    """Return how many threads linear algebra has."""
    return max(pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas")


def test_the_joint_and_its_effect_are_named(found):
    assert found.effects == {"elbow": ("stribeck",)}
    assert len(found.plot().axes) == 2 and "of the force, floor included: " in str(found.summary())
    assert max(map(len, str(found.summary()).splitlines())) <= 80
    assert found["elbow"].parameters["stribeck"]["force"] == pytest.approx(0.15, rel=0.1)
    assert found.coupled.after["elbow"] < found.coupled.before["elbow"]


def test_a_name_that_other_joints_links_may_have_left_is_none():
    loop = iv.axes.emps()
    lame = loop.with_effect("asymmetric-viscous", delta=-40.0)
    theta = lame.values({"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0})
    one, two = (moves.record(lame, theta, 12.0, seed) for seed in (1, 2))
    begun = begin(Task(one, loop, two))
    named = finish(begun)
    removed = (named.chi[0] - named.chi[1]) * sum(floor.surprise for floor in named.floors)
    assert named.effects and finish(begun, swung=0.9 * removed).effects == named.effects
    none = finish(begun, swung=1.1 * removed)
    assert (none.effects, none.parameters, none.replicas, none.probability) == ((), {}, (), {})
    assert none.shrink.after == none.shrink.before and none.verdict == "unexplained"
    assert "links of other joints" in none.findings[-1].text


def test_the_likelier_error_has_less_that_is_new_from_sample_to_sample():
    """Slow swings are most of an error's energy and little of what is new; jerks are new."""
    rng = np.random.default_rng(1)
    noise, keep = rng.standard_normal(8000), np.ones(8000, bool)
    swing = signal.lfilter(*signal.iirpeak(8.0, 30.0, fs=1000.0), rng.standard_normal(8000))
    swung = joint._new(noise + 20.0 * swing, keep)
    assert joint._new(noise, keep) < 0.95 * swung
    jerks = 20.0 * (rng.uniform(size=8000) < 0.01)
    assert swung < joint._new(noise + jerks, keep)


def test_a_joint_is_diagnosed_beside_a_link_that_swings_only_if_that_is_likelier():
    """A rigid joint's noise is learnt where links swing, and nothing stands out from it."""
    record = measured(two_loop(), 3, seconds=8.0)
    fit, _ = identified(record, two_loop())
    loads = joint.Loads.of(fit, [record], [None])
    stiff = joint._begun(1, loads, {})
    assert joint._swung(stiff, stiff) == 0.0
    worse = replace(stiff, measured=tuple(shaken(m) for m in stiff.measured))
    assert joint._swung(stiff, worse) == 0.0 < joint._swung(worse, stiff)


def shaken(measured):
    """Return a joint measured beside a load that swings, and is not there."""
    fold = measured.fold
    shocks = np.random.default_rng(2).standard_normal(fold.record.n_samples)
    swing = signal.lfilter(*signal.iirpeak(9.0, 5.0, fs=1000.0), shocks)
    felt = fold.link.on(fold.record) + np.outer(0.1 * swing / np.std(swing), [1.0, 0.0])
    fold = replace(fold, link=replace(fold.link, t=fold.record.t, felt=felt))
    return replace(measured, base=replace(measured.base, fold=fold))


def test_the_other_joints_say_what_the_links_are():
    """What the elbow says of a wrong link is what was put in, and of the shoulder's own nothing."""
    loop = two_loop()
    record = measured(loop, 4)
    fit, _ = identified(record, loop)
    right = links.measure(fit, record)
    k = fit.names.index("ZZ2")
    params = fit.params.copy()
    params["ZZ2"] *= 1.05
    wrong = links.measure(replace(fit, params=params), record)
    doubts = [one.doubt("shoulder") for one in (right, wrong)]
    change = doubts[1].mean - doubts[0].mean
    spread = np.sqrt(np.diag(np.linalg.pinv(doubts[1].precision)))
    at = 2  # of MX1R, MY1R, ZZ2, MX2, MY2: ZZ1R is the axis's own
    assert right.names[k] == "ZZ2" and len(change) == 5
    wrong_by = params["ZZ2"] - fit.params["ZZ2"]
    assert change[at] == pytest.approx(-wrong_by, rel=0.3) and abs(wrong_by) > 4.0 * spread[at]


def _fold(record, keep, loop=None, link=None):
    """Return a fold of noise that is white; without a loop nothing answers a force."""
    silent = Response(np.zeros(1), record.n_samples)
    heard = silent if loop is None else response.measure(loop, record, loop.start)
    return Fold(record, keep, Scales(record, loop or iv.axes.emps()), heard, link=link)


def test_doubt_discounts_what_nobody_knows():
    """Without precision the answers count for nothing, with much of it they count as any error."""
    loop = iv.axes.emps()
    record = iv.datasets.twin()
    rng = np.random.default_rng(0)
    answers = rng.standard_normal((record.n_samples, 2))
    keep, nothing = np.ones(record.n_samples, dtype=bool), np.zeros((record.n_samples, 2))
    for precision, left in ((0.0, 0.0), (1e-3 * record.n_samples, 0.032), (1e12, 1.0)):
        doubt = Doubt(record.t, answers, np.zeros(2), precision * np.eye(2))
        white = _fold(record, keep, link=Link(record.t, nothing, doubt)).white(answers[:, 0])
        assert np.linalg.norm(white) / np.linalg.norm(answers[:, 0]) == pytest.approx(
            left, abs=2e-3
        )
    shift = Doubt(record.t, answers, np.array([2.0, 0.0]), 1e12 * np.eye(2))
    values = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    plain, moved = (
        _fold(record, keep, link=Link(record.t, nothing, d)).error(loop, values)
        for d in (None, shift)
    )
    np.testing.assert_allclose(plain - moved, 2.0 * answers[:, 0], atol=1e-6)


def test_what_nobody_knows_of_a_load_is_no_part_of_the_force_error():
    rng = np.random.default_rng(0)
    t = 1e-3 * np.arange(600)
    A, sizes = rng.standard_normal((600, 2)), np.array([3.0, -2.0])
    noise = 0.1 * rng.standard_normal(600)
    doubt = Doubt(t, A[:, :1], np.zeros(1), np.eye(1), own=0.5 * A[:, :1])
    assert np.allclose(doubt.whole.answers, 1.5 * A[:, :1])
    record = iv.Record(t, q=t, q_ref=t, nu=A @ sizes + noise)
    both = doubt.beside(record, A[:, 1:])
    fold = _fold(record, np.ones(600, bool), link=Link(t, np.zeros((600, 2)), both))
    still = SimpleNamespace(
        gain=1.0,
        command=lambda record: record.nu,
        simulate=lambda record, *_, **__: SimpleNamespace(nu=0.0 * record.nu, finite=True),
    )
    assert np.std(fold.likeliest(still, fold.simulate(still, {}))) == pytest.approx(0.1, rel=0.1)


def test_what_changed_between_the_records_is_said_of_that_joint_only():
    """Blows at the start, where the motion's derivatives are those of a filter, are no change."""
    loop = two_loop()
    warm = replace(loop.axes[1], start={**loop.axes[1].start, "coulomb": 0.192})
    other = iv.RobotLoop(loop.robot, [loop.axes[0], warm])
    one, two = (measured(arm, seed, noise=3e-6) for arm, seed in ((loop, 5), (other, 6)))
    found = iv.diagnose_robot(one, loop, two)
    assert found["shoulder"].verdict == "adequate" and not found["shoulder"].changed
    assert found["elbow"].verdict == "non-repeatable"
    assert found["elbow"].changed["coulomb"].holdout == pytest.approx(0.192, rel=0.02)


def test_it_shows_itself(found, tmp_path):
    text = str(found.summary())
    assert "elbow" in text and "stribeck" in text and "coupled" in text
    content = json.loads(json.dumps(found.to_dict()))
    assert content["joints"]["elbow"]["effects"] == ["stribeck"]
    assert found.to_html(tmp_path / "r.html").stat().st_size > 10_000


def test_the_load_is_what_the_others_ask():
    """With the true links, a joint by itself follows as it does on the robot."""
    loop = six_loop()
    record = measured(loop, 3, noise=0.0, seconds=8.0)
    fit, _ = identified(record, loop)
    for j in (0, 2, 5):
        part = alone(j, record, fit)
        theta = {name: part.loop.start[name] for name in part.loop.names}
        sim = part.loop.simulate(part.record, theta)
        force = part.loop.force(part.record)
        assert np.sqrt(np.mean((sim.tau - force)[500:] ** 2)) < 0.02 * np.sqrt(np.mean(force**2))


def test_links_that_cannot_be_simulated_are_no_end_of_the_identification(monkeypatch):
    """The instruments are led back from there, or those of least squares are taken."""
    loop = two_loop()
    record, run, calls = measured(loop, 1), robot_engine.run, []

    def once(*arguments):
        calls.append(arguments)
        return run(*arguments) if len(calls) > 1 else False

    monkeypatch.setattr(robot_engine, "run", once)
    assert identified(record, loop)[0].converged and len(calls) > 2
    monkeypatch.setattr(robot_engine, "run", lambda *arguments: False)
    fit, (said,) = identified(record, loop)
    assert "did not converge" in said and np.isfinite(fit.params).all()


def test_instruments_that_lead_to_links_that_cannot_be_are_not_taken(monkeypatch):
    loop = two_loop()
    record, fitted = measured(loop, 1), IDIMIV.fit

    def wrong(self, problem):
        fit = fitted(self, problem)
        params = fit.params.copy()
        params["ZZ2"] *= -1.0
        return replace(fit, params=params)

    monkeypatch.setattr(IDIMIV, "fit", wrong)
    fit, (said,) = identified(record, loop)
    assert "links that cannot be" in said and fit.params["ZZ2"] > 0.0


def test_a_joint_that_was_identified_without_inertia_is_refused_by_itself(monkeypatch):
    """Least squares may give it none, where little of it shows; the others are diagnosed."""
    loop = two_loop()
    record, found = measured(loop, 1), joints.identified

    def light(*arguments):
        fit, said = found(*arguments)
        params = fit.params.copy()
        params["ZZ2"] *= -1.0
        return replace(fit, params=params), said

    monkeypatch.setattr(joints, "identified", light)
    gap = iv.diagnose_robot(record, loop)
    assert gap["elbow"].shrink is None and gap["shoulder"].shrink is not None
    assert "has no inertia" in gap["elbow"].findings[0].text
    assert "elbow: with the parameters that were identified" in str(gap.summary())


def test_a_link_swings_behind_its_drive():
    """With the swing of the elbow's link in its load, the shoulder follows better."""
    start = {"inertia": 0.02, "viscous": 0.05, "coulomb": 0.1, "offset": 0.0}
    axes = [axis(kp, kd, tuple(start), **start) for kp, kd in ((40.0, 4.0), (20.0, 1.5))]
    loop = iv.RobotLoop(two_joints(), axes)
    true = split(loop, "elbow", hz=12.0, damping=0.03, gap=0.0)
    record = simulated(true, plan(*reference(8.0, n=2, seed=3)), None)
    fit, _ = identified(record, loop)
    own = 0.02 / 0.04  # the drive's share
    values = {"frequency_hz": 12.0 / own**0.5, "damping": 0.03 / own**0.5, "load_share": 1.0 - own}
    theta = {**start, "inertia": 0.04, **{f"flexibility.{k}": v for k, v in values.items()}}
    soft = SimpleNamespace(effects=("flexibility",), theta=theta)
    errors = []
    for beside in ({}, {"elbow": soft}):
        shoulder = alone(0, record, fit, soft=beside)
        sim = shoulder.loop.simulate(shoulder.record, shoulder.loop.start)
        errors.append(np.std((sim.tau - shoulder.loop.force(shoulder.record))[3000:]))
    assert errors[1] < 0.7 * errors[0], errors


@pytest.mark.parametrize(("damping", "strays"), [(0.003, True), (0.5, False)])
def test_a_link_that_swings_up_without_end_is_taken_for_rigid(damping, strays):
    """Its inertia comes and goes at twice its frequency, as a child pumps a swing."""
    record, hz = measured(two_loop(), 3, seconds=8.0).joint(1), 10.0
    pumped = 0.017 * np.sin(4.0 * np.pi * hz * np.sqrt(0.5) * record.t)
    pumped = np.column_stack([0.0 * record.t, pumped])
    theta = {**two_loop().axes[1].start, "inertia": 0.04, "flexibility.frequency_hz": hz}
    theta |= {"flexibility.damping": damping, "flexibility.load_share": 0.5}
    soft = SimpleNamespace(effects=("flexibility",), theta=theta)
    part = behind.Alone(record, two_loop().axes[1], pumped, pumped[:, :0])
    dq = np.gradient(record.q[:, 0], record.dt)
    link = behind.follow(soft, part, dq, np.gradient(dq, record.dt))
    assert np.array_equal(link.q, record.q[:, 0]) == strays
    assert (len(link.unknown) == 0) == strays


@pytest.mark.parametrize(("inertia", "share"), [(30.0, None), (100.0, 0.4)])
def test_a_fit_gives_a_link_no_less_than_its_poses_take_of_it(inertia, share, twin):
    lacks = np.column_stack([0.0 * twin.t, -50.0 * np.sin(twin.t) ** 2])
    one = _fold(twin, np.ones(twin.n_samples, bool), link=Link(twin.t, lacks))
    loop = iv.axes.emps()
    loop = loop if share is None else loop.with_effect("flexibility", load_share=share)
    theta = {"viscous": 200.0, "coulomb": 20.0, "offset": 0.0}
    values = fit.heavy_enough(one, loop, loop.values({**theta, "inertia": inertia}))
    link = values["inertia"] * values.get("flexibility.load_share", 1.0)
    assert link == pytest.approx(one.least_link) and one.least_link == pytest.approx(55.6, rel=1e-2)
    assert (values["inertia"] == inertia) == (share is not None)
    enough = loop.values({**theta, "inertia": 500.0})
    assert fit.heavy_enough(one, loop, enough) is enough


def behind_a_gap(joint):
    """An arm of two joints with drives, and the same with a gap of 3 mrad in one of them."""
    start = {"inertia": 0.02, "viscous": 0.05, "coulomb": 0.1, "offset": 0.0}
    axes = [axis(kp, kd, tuple(start), **start) for kp, kd in ((40.0, 4.0), (20.0, 1.5))]
    loop = iv.RobotLoop(two_joints(), axes)
    return loop, split(loop, joint, hz=40.0, damping=0.2, gap=3e-3)


def linked(loop, joint, inertia):
    """The values of that gap on the joint by itself, of this mean inertia."""
    j, share = loop.robot.joint(joint), 1.0 - 0.02 / inertia
    felt = loop.mass_matrix(np.zeros(2))[0, j, j]
    stiffer = ((felt - 0.02) / (inertia * share * (1.0 - share))) ** 0.5
    return {"gap": 3e-3, "load_share": share, "load_friction": 0.0, "load_offset": 0.0,
            "contact_hz": 40.0 * stiffer, "damping": 0.2 * stiffer}  # fmt: skip


def test_a_link_behind_a_gap_has_the_inertia_of_its_pose():
    """The force of what it has beyond its mean is that of its own acceleration, not the drive's."""
    loop, true = behind_a_gap("shoulder")
    record = simulated(true, plan(*reference(8.0, n=2, seed=3, size=0.8)), None)
    fit, _ = identified(record, loop)
    drawn = [loop.values()[n] for n in fit.params.index]
    shoulder = alone(0, record, replace(fit, params=fit.params * 0.0 + drawn))
    values = linked(loop, "shoulder", shoulder.loop.start["inertia"])
    axis_with = shoulder.loop.with_effect("backlash", **values)
    own = axis_with.values(shoulder.loop.start)
    none = np.column_stack([shoulder.record.load, 0.0 * shoulder.link[:, 1]])
    errors = []
    for link in (None, none, shoulder.link):
        sim = axis_with.simulate(shoulder.record, own, link=link)
        errors.append(np.std((sim.tau - axis_with.force(shoulder.record))[500:]))
    assert errors[1] == pytest.approx(errors[0], rel=1e-9)  # one sums a series, the other has it
    assert errors[2] < 0.5 * errors[0]


def test_what_a_link_has_beyond_its_mean_is_inertia_of_the_joint():
    loop = two_loop()
    record = measured(loop, 4, seconds=3.0)
    fit, _ = identified(record, loop)
    part = alone(0, record, fit)
    theta = {name: part.loop.start[name] for name in part.loop.names}
    more = 0.3 * theta["inertia"]
    link = np.column_stack([part.link[:, 0], np.full(part.record.n_samples, more)])
    heavier = {**theta, "inertia": theta["inertia"] + more}
    plain = part.record.replace(load=link[:, :1])
    one = part.loop.simulate(part.record, theta, link=link)
    two = part.loop.simulate(plain, heavier)
    np.testing.assert_allclose(one.q, two.q, rtol=1e-9, atol=1e-12)


def test_a_link_is_looked_for_no_lighter_than_what_a_pose_takes_of_it():
    """With less than no inertia in some pose, a simulation of it would say nothing."""
    loop = two_loop()
    record = measured(loop, 4, seconds=3.0)
    part = alone(0, record, identified(record, loop)[0])
    inertia = part.loop.start["inertia"]
    link = np.column_stack([part.link[:, 0], -0.36 * inertia * (part.record.t < 1.0)])
    link = Link(part.record.t, link)
    one = _fold(part.record, usable(part.record, part.loop), part.loop, link)
    lightest = one.least_link / inertia
    assert lightest == pytest.approx(0.4)
    assert replace(one, link=None).least_link == 0.0
    rigid = gauss_newton(one, part.loop, part.loop.start, part.loop.names, 1)
    cost = starts._cost(rigid, EFFECTS["flexibility"])
    shape = {"frequency_hz": 20.0, "damping": 0.03, "load_friction": 0.0}
    costs = [cost({**shape, "load_share": lightest * share}) for share in (0.99, 1.01)]
    assert costs[0] == np.inf and np.isfinite(costs[1])


def test_what_removes_most_of_a_gap_and_gets_no_name_is_supposed(monkeypatch):
    """However little of the energy the gap is, most of which is noise."""
    monkeypatch.setattr(attribution, "LIKELY", 1.1)
    loop = two_loop()
    true = loop.with_effect("elbow", "stribeck", force=0.02, speed=0.1, exponent=2.0)
    one, two = (measured(true, seed, noise=1.2e-5) for seed in (1, 2))
    elbow = iv.diagnose_robot(one, loop, two, joints=["elbow"])["elbow"]
    assert not elbow.effects and elbow.supposed.effect == "stribeck"
    assert elbow.supposed.gain < 0.5


def test_what_is_supposed_is_assumed_where_nothing_is_named(found):
    elbow = found["elbow"]
    values = {**elbow.theta, "backlash.gap": 1e-3, "backlash.load_share": 0.5}
    guess = Supposed("backlash", values, 0.6)
    bare = replace(elbow, effects=(), parameters={}, supposed=guess)
    assert assumed(elbow) is elbow and assumed(replace(bare, supposed=None)).effects == ()
    assert assumed(bare).effects == ("backlash",) and assumed(bare).theta == values
    assert assumed(bare).parameters == {"backlash": {"gap": 1e-3, "load_share": 0.5}}


def test_a_link_behind_a_gap_is_not_jerked_as_its_drive():
    """With the elbow's gap in its load, the shoulder follows better."""
    loop, true = behind_a_gap("elbow")
    record = simulated(true, plan(*reference(8.0, n=2, seed=3, size=0.8)), None)
    fit, _ = identified(record, loop)
    values = {f"backlash.{k}": v for k, v in linked(loop, "elbow", 0.04).items()}
    theta = {**loop.axes[1].start, "inertia": 0.04, **values}
    gap = SimpleNamespace(effects=("backlash",), theta=theta)
    errors = []
    for beside in ({}, {"elbow": gap}):
        shoulder = alone(0, record, fit, soft=beside)
        sim = shoulder.loop.simulate(shoulder.record, shoulder.loop.start)
        errors.append(np.std((sim.tau - shoulder.loop.force(shoulder.record))[500:]))
    assert errors[1] < 0.6 * errors[0]


@pytest.mark.slow
def test_a_link_that_rattles_gives_the_other_joint_no_name():
    """A joint that is judged beside it, and the other way round, is a rigid one."""
    case = draw(6, 8540, ("flexibility", "backlash"))
    (one, _), (two, _) = case.both
    found = iv.diagnose_robot(one, case.loop, two)
    assert {name: effect for name, (effect, _) in case.hidden.items()} == {"elbow": "backlash"}
    assert {name: d.effects for name, d in found.joints.items() if d.effects} == {
        "elbow": ("backlash",)
    }


def test_an_unknown_joint_is_refused():
    loop = two_loop()
    with pytest.raises(AxisError, match="no joint 'wrist'; its joints: shoulder, elbow"):
        iv.diagnose_robot(measured(loop, 1), loop, joints=["wrist"])


def test_joint_belongs_to_robot(capsys):
    assert run(["diagnose", "twin", "--joint", "elbow"]) == 2
    assert "--joint belongs to --robot" in capsys.readouterr().err
