"""A diagnosis with every kind of controller, and without one."""

from dataclasses import replace

import numpy as np
import pytest

import ivtools as iv
from benchmarks import healthy, populations
from benchmarks.withheld.cases import draw
from benchmarks.withheld.suites import Task
from ivtools.gap import parity, preflight
from ivtools.loop import Controller, identification
from ivtools.loop.axis_file import from_tables
from ivtools.suitability import suitability

pytestmark = pytest.mark.filterwarnings("ignore::ivtools.errors.RecordWarning")


def played(kind, effect=None, seed=3, hz=500.0, n=8000, sensor=1e-6, **changes):
    """Return a declared loop without effect, and a record of the same with it."""
    rng = np.random.default_rng([seed, len(kind)])
    loop, theta, stroke = populations.axis(rng, ("prismatic", "revolute")[seed % 2])
    law = replace(populations.controller(rng, kind, theta["inertia"], hz), **changes)
    declared = replace(loop, controller=populations.scaled(law, loop.gain))
    true = declared
    if effect:
        force = 0.9 * theta["coulomb"]
        true = declared.with_effect("stribeck", force=force, speed=0.15 * stroke)
        theta = {**theta, "stribeck.force": force, "stribeck.speed": 0.15 * stroke}
    record = populations.reference(rng, n, hz, stroke)
    sim = true.simulate(
        record,
        theta,
        initial="rest",
        position_noise=sensor * stroke * rng.normal(size=n),
        force_noise=0.03 * theta["coulomb"] * rng.normal(size=n),
    )
    return declared, record.replace(q=sim.q, nu=sim.nu)


@pytest.mark.parametrize("kind", populations.KINDS)
def test_an_effect_is_named_behind_any_controller(kind):
    loop, record = played(kind, "stribeck")
    found = iv.diagnose(record, loop)
    assert not [f.text for f in found.findings if f.fatal]
    assert "controller-mismatch" not in found.effects
    assert found.effects == ("stribeck",) or "stribeck" in sum(found.ambiguous_with.values(), [])


def test_without_a_controller_the_model_is_pulled_to_the_motion():
    loop, record = played("p-pi", "stribeck")
    found = iv.diagnose(record, replace(loop, controller=Controller("none", {})))
    assert any("no controller: the model is driven" in f.text for f in found.findings)
    assert "stribeck" in found.effects or "stribeck" in sum(found.ambiguous_with.values(), [])


@pytest.mark.parametrize("effect", [(), ("sqrt-viscous",)])
def test_without_a_controller_a_sharp_motion_is_no_gap(effect):
    """Smoothed, a measured motion pulled by itself wherever the acceleration jumps."""
    case = draw(Task("controllers", 2000 if not effect else 2001, effect, ("none",)))
    first, second = (iv.Record.from_dict(r) for r in case.records)
    found = iv.diagnose(first, from_tables(case.axis.tables()), holdout=second)
    assert found.effects == effect
    assert found.verdict == ("explained" if effect else "adequate")


@pytest.mark.parametrize("seed", [508, 512, 517])
def test_without_a_controller_noise_of_the_encoder_is_no_gap(seed):
    """The pull, and the command that the controller answered it with, are that noise too."""
    case = healthy.draw(seed, (250, 500, 1000, 2000))
    found = iv.diagnose(case.record, replace(case.loop, controller=Controller("none", {})))
    assert found.verdict == "adequate" and found.chi[0] < 1.2


def test_a_velocity_loop_needs_no_position_reference():
    loop, record = played("pi-velocity")
    dq_ref = np.gradient(record.q_ref, record.dt, axis=0)
    found = iv.diagnose(record.replace(q_ref=None, dq_ref=dq_ref), loop)
    assert found.effects == () and not [f.text for f in found.findings if f.fatal]


@pytest.mark.parametrize("kind", ["cascade-pd", "pd", "pid", "p-pi", "state-space"])
def test_a_weak_drive_is_named_where_dry_friction_is_most_of_the_force(kind):
    """What could not move the axis at all would leave nothing of its force unexplained."""
    hz, n, rng = 500.0, 5000, np.random.default_rng([11, len(kind)])
    loop, theta, stroke = populations.axis(rng, "revolute")
    law = populations.controller(rng, kind, theta["inertia"], hz)
    loop = replace(loop, controller=populations.scaled(law, loop.gain))
    asked = [populations.reference(rng, n, hz, stroke) for _ in range(2)]
    faster = min(np.quantile(np.abs(np.diff(r.q_ref[:, 0], 2)), 0.98) for r in asked) * hz**2
    theta["coulomb"] = 2.5 * theta["inertia"] * faster
    limit = theta["coulomb"] + 0.6 * theta["inertia"] * faster + abs(theta["offset"])
    weak = loop.with_effect("inner-saturation", force=limit)
    records = []
    for r in asked:
        noise = 0.01 * theta["coulomb"] * rng.normal(size=n)
        sim = weak.simulate(r, weak.values(theta), initial="rest", force_noise=noise)
        records.append(r.replace(q=sim.q, nu=sim.nu))
    found = iv.diagnose(records[0], loop, records[1])
    assert found.effects == ("inner-saturation",)
    assert found.parameters["inner-saturation"]["force"] == pytest.approx(limit, rel=0.01)


@pytest.mark.parametrize("tighter, said", [(1.0, 0), (6.0, 1)])
def test_a_velocity_loop_that_rings_is_held_to_the_motion_and_says_so(tighter, said):
    loop, record = played("p-velocity")
    gains = loop.controller.settings
    law = replace(loop.controller, settings={**gains, "kv": tighter * gains["kv"]})
    loop = replace(loop, controller=law)
    sim = loop.simulate(record, iv.IDIMLS().fit(record, loop).params)
    found = iv.diagnose(record.replace(q=sim.q, nu=sim.nu), loop)
    assert (found.verdict, found.block) == ("adequate", None)
    assert not any("the axis file says" in text for text in found.advice)  # not what holds it has
    assert sum("hardly has a phase margin" in f.text for f in found.findings) == said


def test_a_velocity_loop_has_the_phase_margin_of_its_own_rate():
    """So many samples of delay are the controller's, not those of a log that it is faster than."""
    loop, fine = played("p-velocity", hz=2000.0, n=24000, delay=9)
    thinned = iv.Record(fine.t[::4], **{k: x[::4] for k, x in fine.signals.items()})
    found = iv.diagnose(thinned, loop)
    assert preflight.rings(thinned, loop) and not preflight.rings(thinned, loop, 4)
    assert found.verdict == "adequate" and preflight.HELD not in found.findings


def test_a_controller_is_told_to_be_faster_than_its_log_where_noise_is_most_of_what_it_leaves():
    """No law of the samples that are logged leaves less than the noise does."""
    loop, fine = played("pid", seed=7, hz=400.0, sensor=2e-5)
    thinned = iv.Record(fine.t[::2], **{k: x[::2] for k, x in fine.signals.items()})
    found = parity.check(thinned, loop, read=False)
    assert (found.oversampling, found.mismatch) == (2, {})
    slow = replace(loop, controller=loop.controller.with_mismatch(kp=0.2, kd=0.2))
    assert parity.check(thinned, slow, read=False).mismatch  # wrong settings are wrong at any rate


def test_a_feed_forward_that_nobody_declared_is_said():
    fed = {"acceleration": 0.5}
    loop, record = played("cascade-pd", "stribeck", feedforward=fed)
    plain = replace(loop, controller=replace(loop.controller, feedforward={}))
    found = iv.diagnose(record, plain)
    text = " ".join(f.text for f in found.findings)
    assert "of inertia feed-forward is in the command and not in the log" in text
    shown = found.parameters["controller-mismatch"]["feedforward.acceleration"]
    assert shown == pytest.approx(0.5 / loop.gain, rel=0.02)
    assert "stribeck" in found.effects


@pytest.mark.parametrize("kind", ["p-pi", "pid", "pi-velocity"])
def test_a_limit_that_nobody_declared_holds_the_integrator_as_well(kind):
    loop, record = played(kind)
    limit = 0.6 * float(np.abs(record.nu).max())
    cut = replace(loop, controller=replace(loop.controller, limit=limit))
    theta = iv.IDIMLS().fit(record, loop).params
    sim = cut.simulate(record, theta)
    shown = parity.check(record.replace(q=sim.q, nu=sim.nu), loop)
    assert shown.limit == pytest.approx(limit) and shown.trustworthy and not shown.mismatch


def misstated(kind):
    """Yield loops with a wrong setting, and records of the right one with noise of the command."""
    for seed in range(3, 9):
        loop, record = played(kind, seed=seed)
        rng = np.random.default_rng(seed)
        name, size = str(rng.choice(loop.controller.mismatches)), rng.uniform(0.02, 0.2)
        wrong = replace(loop, controller=loop.controller.with_mismatch(**{name: size}))
        noise = 0.002 * np.std(record.nu) * rng.standard_normal(record.nu.shape)
        yield wrong, record.replace(nu=record.nu + noise)


def elsewhere(record, samples):
    """Return a record whose log has the reference that many samples early; late if negative."""
    k = np.clip(np.arange(record.n_samples) + samples, 0, record.n_samples - 1)
    dq_ref = None if record.dq_ref is None else record.dq_ref[k]
    return record.replace(q_ref=record.q_ref[k], dq_ref=dq_ref)


@pytest.mark.parametrize("kind", populations.KINDS)
@pytest.mark.parametrize(("seed", "samples"), [(4, -1), (5, 2)])
def test_a_reference_that_is_logged_elsewhere_is_no_wrong_controller(kind, seed, samples):
    """As where the position is late and the reference is not, or a cycle's end is logged."""
    loop, record = played(kind, "stribeck", seed=seed)
    found = iv.diagnose(elsewhere(record, samples), loop)
    assert found.effects == ("stribeck",)
    when = "1 sample after" if samples < 0 else "2 samples before"
    assert any(f"the reference is logged {when} the control" in f.text for f in found.findings)


def test_where_a_reference_is_logged_one_record_tells_for_both():
    """In noise of a hundredth of the command a filter twice as large does as well."""
    loop, record = played("pi-velocity", "stribeck", seed=6)
    noise = np.random.default_rng(1).normal(0.0, 0.01 * np.std(record.nu), record.nu.shape)
    one, two = (elsewhere(r, -1) for r in (record, record.replace(nu=record.nu + noise)))
    clear, noisy = (parity.check(r, loop, read=False) for r in (one, two))
    assert preflight.misplaced(one, loop, clear).samples == 1
    assert preflight.misplaced(two, loop, noisy) is None
    assert preflight.misplaced(two, loop, noisy, 1).samples == 1


DERIVES = ("pd", "pid", "p-pi", "pi-velocity", "p-velocity")


@pytest.mark.parametrize("kind", DERIVES)
@pytest.mark.parametrize("seed", [4, 5])
def test_a_reference_that_the_controller_derives_backward_is_no_wrong_controller(kind, seed):
    """Half a sample late, it looks like another filter of the velocity, or another gain."""
    loop, record = played(kind, "stribeck", seed=seed, reference_derivative="backward")
    plain = replace(loop, controller=replace(loop.controller, reference_derivative="central"))
    found = iv.diagnose(record, plain)
    assert "controller-mismatch" not in found.effects
    takes = loop.controller.full["c"] != 0.0
    assert takes == any("by backward differences" in f.text for f in found.findings)
    assert takes == any(
        row[:2] == ("derived", "backward") for row in suitability(record, plain).rows
    )
    assert found.effects == iv.diagnose(record, loop).effects


@pytest.mark.parametrize("kind", [k for k in populations.KINDS if k != "state-space"])
@pytest.mark.parametrize("fed", [("velocity",), ("acceleration",), ("velocity", "acceleration")])
def test_a_log_that_ends_in_motion_is_no_wrong_controller(kind, fed):
    """Derivatives of the reference at its last samples take some that are not logged."""
    inertia = played(kind)[0]
    size = 0.5 * max(abs(v) for v in inertia.controller.settings.values())
    loop, whole = played(kind, feedforward={name: 0.02 * size for name in fed})
    speed = np.abs(np.gradient(np.gradient(whole.q_ref[:, 0])))
    for end in 4000 + np.argsort(speed[4000:])[-3:]:
        record = whole.slice(500, int(end))
        found = parity.check(record, loop, read=False)
        assert found.before < 1e-9 and not found.mismatch
        assert found.delay == loop.controller.delay


@pytest.mark.parametrize("kind", DERIVES)
def test_noise_and_wrong_gains_are_no_matter_of_how_a_reference_is_derived(kind):
    """Of what the law does as it is declared, or with other gains, either says how."""
    for wrong, logged in misstated(kind):

        def compared(one, logged=logged):
            return [parity.check(logged, one, read=False)]

        assert not parity.otherwise_derived(logged, wrong, compared(wrong), compared)


@pytest.mark.parametrize("kind", populations.KINDS)
def test_wrong_gains_are_no_matter_of_where_the_reference_is_logged(kind):
    for wrong, logged in misstated(kind):
        assert not preflight.misplaced(logged, wrong, parity.check(logged, wrong, read=False))


@pytest.mark.parametrize(("kind", "seed"), [("p-pi", 4), ("pi-velocity", 6)])
@pytest.mark.parametrize("does", ["none", "back-calculation"])
def test_what_an_integrator_does_at_its_limit_is_no_wrong_controller(kind, seed, does):
    loop, record = played(kind, seed=seed)
    limit = 0.6 * float(np.abs(record.nu).max())
    law = replace(loop.controller, limit=limit, anti_windup=does)
    sim = replace(loop, controller=law).simulate(record, iv.IDIMLS().fit(record, loop).params)
    noise = np.random.default_rng(4).normal(0.0, 0.002 * limit, sim.nu.shape)
    found = iv.diagnose(record.replace(q=sim.q, nu=sim.nu + noise), loop)
    assert found.effects == ("saturation",)
    assert found.parameters["saturation"]["limit"] == pytest.approx(limit, rel=0.01)
    assert any(f'anti_windup = "{does}"' in f.text for f in found.findings)


@pytest.mark.parametrize("kind", ["pd", "cascade-pd", "p-velocity"])
@pytest.mark.parametrize("noise", [0.001, 0.004, 0.015])
def test_a_limit_is_seen_in_a_command_that_was_measured(kind, noise):
    """A current at its limit is as flat as its noise; the largest one of a free law is no limit."""
    loop, record = played(kind)
    top = float(np.abs(record.nu).max())
    for share in (0.6, np.inf):
        cut = replace(loop, controller=replace(loop.controller, limit=share * top))
        sim = cut.simulate(record, iv.IDIMLS().fit(record, loop).params)
        drawn = np.random.default_rng(3).normal(0.0, noise * top, sim.nu.shape)
        shown = parity.check(record.replace(q=sim.q, nu=sim.nu + drawn), loop)
        if share == np.inf:
            assert shown.limit is None
        else:
            assert shown.limit == pytest.approx(share * top, rel=0.01) and not shown.mismatch


@pytest.mark.parametrize("seed", range(3, 9))
def test_a_smooth_peak_that_is_sampled_fast_is_no_limit(seed):
    """Viscous friction is the load: a law with a wrong gain gives more wherever that is largest."""
    loop, record = played("pid", seed=seed, hz=5000.0, n=50_000)
    theta = iv.IDIMLS().fit(record, loop).params
    slow = 0.3 * np.ptp(record.q_ref) * np.sin(2.0 * np.pi * 0.2 * record.t)[:, None]
    true = replace(loop.controller, settings={**loop.controller.settings, "c": 0.0})
    loop = replace(loop, controller=true)
    theta = {**theta, "viscous": 0.5 * loop.gain * true.settings["kd"]}
    sim = loop.simulate(record.replace(q_ref=slow, dq_ref=None), theta, initial="rest")
    logged = record.replace(q=sim.q, q_ref=slow, dq_ref=None, nu=sim.nu)
    wrong = replace(true, settings={**true.settings, "kp": true.settings["kp"] / 0.8})
    shown = parity.check(logged, replace(loop, controller=wrong))
    assert shown.limit is None
    assert shown.mismatch == {"kp": pytest.approx(-0.2, abs=0.01)}


@pytest.mark.parametrize(
    "kind, left_out",
    [
        ("cascade-pd", {"filter": {"kind": "lowpass", "hz": 40.0}}),
        ("pid", {"filter": {"kind": "notch", "hz": 30.0, "damping": 0.3}}),
        ("p-pi", {"filter": {"kind": "lowpass", "hz": 60.0, "damping": 0.7}}),
    ],
)
@pytest.mark.parametrize("effect", [None, "stribeck"])
def test_a_filter_that_the_axis_file_lacks_is_read_and_is_no_other_effect(kind, left_out, effect):
    """It leaves some per cent of the command, which a flexible load imitates."""
    loop, record = played(kind, effect, **left_out)
    stated = replace(loop, controller=replace(loop.controller, filter=None))
    assert 0.005 < parity.check(record, stated, read=False).after < 0.2
    found = iv.diagnose(record, stated)
    assert found.effects == ("controller-mismatch", *([effect] if effect else []))
    assert found.verdict == "explained"
    shown = found.parameters["controller-mismatch"]
    assert shown["filter.hz"] == pytest.approx(left_out["filter"]["hz"], rel=2e-3)
    kept = f'filter = {{ kind = "{left_out["filter"]["kind"]}", hz = {left_out["filter"]["hz"]:g}'
    assert any("the record shows" in f.text and kept in f.text for f in found.findings)


def test_a_filter_is_the_declared_one_or_another_or_is_not_there():
    """One that is read has the digits of a fit; where there is none, its frequency is 0."""
    loop, record = played("pd", filter={"kind": "lowpass", "hz": 40.0})
    read = parity.check(record, replace(loop, controller=replace(loop.controller, filter=None)))
    assert read.taken and read.found == {"filter.hz": pytest.approx(40.0, rel=1e-3)}
    for hz, found in (
        (40.0, {}),
        (40.01, {}),
        (60.0, {"filter.hz": 40.0}),
        (None, {"filter.hz": 0.0}),
    ):
        law = read.loop.controller
        stated = replace(law, filter={"kind": "lowpass", "hz": hz or 40.0})
        shown = (
            replace(read.loop, controller=replace(law, filter=None)) if hz is None else read.loop
        )
        assert replace(read, declared=stated, loop=shown).found == pytest.approx(found, rel=1e-3)


def test_what_a_command_says_of_itself_is_no_law():
    """A smooth command follows from its own past, whatever it answers to."""
    loop, record = played("pid")
    walk = np.cumsum(np.random.default_rng(0).normal(size=record.n_samples))
    alone = record.replace(nu=walk)
    left, own = identification.least(loop, alone)
    assert own < 0.05 and left > 0.5 * own
    assert not parity.doubted(alone, replace(parity.check(alone, loop, read=False), after=0.019))


def test_a_little_off_is_no_mistake_of_a_law_that_was_read():
    loop, record = played("pd")
    law = loop.controller
    for times, gross in ((1.02, False), (1.3, True)):
        stated = replace(law, settings={**law.settings, "kp": times * law.settings["kp"]})
        shown = parity.check(record, replace(loop, controller=stated), read=False)
        assert "kp" in shown.mismatch
        kept = parity.as_read(shown)
        assert (kept is shown) is gross and (kept.found == {}) is not gross
        assert kept.loop.controller == shown.loop.controller


@pytest.mark.parametrize("steps", [500, 5000])
def test_without_a_controller_a_coarse_encoder_does_not_pull(steps):
    """Where a sensor measures the velocity: differences of the steps had been the force."""
    loop, record = played("p-pi", n=4000)
    step = float(np.ptp(record.q)) / steps
    dq = np.gradient(record.q, record.dt, axis=0)
    coarse = record.replace(q=step * np.round(record.q / step), dq=dq)
    bare = replace(loop, controller=Controller("none", {}))
    driven, pulled = preflight.pulled(coarse, bare)
    assert pulled.controller.velocity == "logged" and np.array_equal(driven.dq_ref, dq)
    driven, pulled = preflight.pulled(coarse.replace(dq=None), bare)
    assert pulled.controller.velocity == "differences"


def test_a_record_read_without_the_units_of_the_axis_file_is_told_how_to_be_read():
    loop, record = played("pd")
    metres = loop.joint == "prismatic"
    factor, unit = (1000.0, "mm") if metres else (180.0 / np.pi, "deg")
    other = record.replace(q=factor * record.q, q_ref=factor * record.q_ref)
    known = replace(loop, log=replace(loop.log, units={"q": unit, "q_ref": unit}))
    for one, told in ((loop, False), (known, True)):
        (found,) = iv.diagnose(other, one).findings[:1]
        assert "as if q and q_ref were in" in found.text
        assert ("iv.Record.read(path, loop.log)" in found.text) is told


def test_a_law_that_was_read_from_one_record_is_not_asked_for_again(monkeypatch):
    """Only a gross rest speaks of another one in the second record."""
    asked, check = [], parity.check

    def checked(record, loop, read=True, oversampling=0):
        """Note whether a record is asked for its own law."""
        asked.append(read)
        return check(record, loop, read, oversampling)

    monkeypatch.setattr(parity, "check", checked)
    monkeypatch.setattr(parity, "doubted", lambda record, found: True)
    loop, record = played("cascade-pd")
    iv.diagnose(record, loop)
    assert any(asked)
    asked.clear()
    iv.diagnose(record, replace(loop, controller=Controller("identify", {})))
    assert asked and not any(asked)
