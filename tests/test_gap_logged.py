"""What a log has made of the signals: digits that are missing, a command that is late."""

from dataclasses import replace

import numpy as np
import pytest

import ivtools as iv
from benchmarks import healthy, moves, populations
from ivtools.gap import between, parity, preflight
from ivtools.gap.diagnose.input import bounded, readied
from ivtools.gap.diagnose.task import Task
from ivtools.gap.fold import stepped
from ivtools.gap.preflight import logged
from ivtools.gap.rules import PARITY_HEAD
from ivtools.loop import Controller
from ivtools.plots.parity import parity_chart
from ivtools.suitability import suitability

BASE = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
SECONDS, STEP = 8.0, 2e-6


def follows_speed():
    """Return the axis under a law that differentiates its reference."""
    loop = iv.axes.emps()
    unit = BASE["inertia"] / loop.gain
    settings = {"kp": 6000.0 * unit, "kd": 110.0 * unit}
    return replace(loop, controller=Controller("pd", settings, limit=1e3))


def pair(loop, **effects):
    theta = dict(BASE)
    for name, values in effects.items():
        loop = loop.with_effect(name, **values)
        theta |= {f"{name}.{k}": v for k, v in values.items()}
    return [moves.record(loop, theta, SECONDS, seed) for seed in (1, 2)]


def rounded(record, step=STEP):
    return record.replace(q_ref=step * np.round(record.q_ref / step))


def late(record, samples):
    """Return a record whose log has the command that many samples late, or early."""
    return record.replace(nu=np.roll(record.nu, samples, axis=0)).slice(9, record.n_samples - 9)


def said(found, words):
    return [f.text for f in found.findings if words in f.text]


@pytest.mark.parametrize("step", [1.0, 2e-6, 2 * np.pi / 4096])
def test_a_grid_is_found_whatever_its_unit_and_its_origin(step):
    rng = np.random.default_rng(0)
    x = 1e3 * step * np.cumsum(rng.normal(size=3000)) / 30.0
    for origin in (0.0, 0.37 * step, 1e6 * step):
        assert parity.grid(origin + step * np.round(x / step)) == pytest.approx(step, rel=1e-6)
    assert parity.grid(x) == 0.0 and parity.grid(np.full(30, 1.3)) == 0.0


def test_a_smooth_motion_comes_back_from_a_rounded_one():
    t = np.arange(8000) * 1e-3
    x = 0.1 * np.sin(2.0 * t) + 0.02 * np.sin(9.0 * t)
    fine, coarse = (np.gradient(y, 1e-3) for y in (x, STEP * np.round(x / STEP)))
    smooth = np.gradient(logged.smoothed(STEP * np.round(x / STEP), STEP), 1e-3)
    assert np.std(smooth - fine) < 0.1 * np.std(coarse - fine)


@pytest.mark.parametrize("step", [1e-6, 2e-6, 2e-5])
def test_a_rounded_reference_makes_no_gap_and_hides_no_effect(step):
    loop = follows_speed()
    for effects in ({}, {"asymmetric-viscous": {"delta": -40.0}}):
        one, two = (rounded(r, step) for r in pair(loop, **effects))
        found = iv.diagnose(one, loop, two)
        assert found.effects == tuple(effects)
        assert found.verdict == ("explained" if effects else "adequate")
        assert len(said(found, f"q_ref is rounded to {1e6 * step:g} µm")) == 2


@pytest.mark.parametrize("kind", populations.KINDS)
def test_commands_tell_the_reference_that_was_rounded(kind):
    """And a law whose gains are wrong by a few per cent does not make another one of it."""
    for seed in range(4):
        rng = np.random.default_rng([seed, populations.KINDS.index(kind)])
        loop, theta, stroke = populations.axis(rng, ("prismatic", "revolute")[seed % 2])
        law = populations.controller(rng, kind, theta["inertia"], 1e3)
        law = replace(
            populations.surrounded(rng, law, 1e3), feedforward={"acceleration": theta["inertia"]}
        )
        loop = replace(loop, controller=populations.scaled(law, loop.gain))
        motion = populations.reference(rng, 6000, 1e3, stroke)
        ran = loop.simulate(motion, theta, initial="rest", quantum=1e-6 * stroke)
        exact, step = motion.replace(q=ran.q, nu=ran.nu), stroke * 10 ** rng.uniform(-5.5, -4.0)
        coarse = step * np.round(exact.q_ref[:, 0] / step)
        smooth = exact.replace(q_ref=logged.smoothed(coarse, step))

        wrong = replace(loop, controller=loop.controller.scaled(1.05))
        told, false = (logged.implied(coarse, smooth, one) for one in (loop, wrong))
        assert np.std(told - exact.q_ref[:, 0]) < 0.2 * step
        assert np.std(false - exact.q_ref[:, 0]) > 5.0 * step


def test_a_reference_that_the_controller_had_rounded_stays():
    loop = follows_speed()
    motion = rounded(moves.record(loop, BASE, SECONDS, 1))
    simulation = loop.simulate(motion, BASE)
    record = motion.replace(q=simulation.q, nu=simulation.nu)
    assert preflight.finer(record, loop) == (record, [])


@pytest.mark.parametrize("samples", [2, -1])
def test_a_command_that_is_logged_late_is_moved_back(samples):
    loop = iv.axes.emps()
    wave = {"cosine": 3.0, "sine": 1.0, "period": 0.004}
    one, two = (late(r, samples) for r in pair(loop, cogging=wave))
    found = iv.diagnose(one, loop, two)
    assert found.effects == ("cogging",)
    count = f"{abs(samples)} sample" + "s" * (abs(samples) > 1)
    when = "after" if samples > 0 else "before"
    assert len(said(found, f"is logged {count} {when} it acts")) == 2


def test_a_controller_that_is_late_is_not_the_log():
    loop = iv.axes.emps()
    slow = replace(loop, controller=replace(loop.controller, delay=loop.controller.delay + 1))
    one, two = pair(slow)
    found = iv.diagnose(one, loop, two)
    assert found.verdict == "adequate" and not said(found, "is logged")


def sparse(record, count):
    """Return a record of which the log has only every so manieth sample."""
    kept = {k: x[::count] for k, x in every(record).items()}
    return iv.Record.from_dict(kept, name=record.name)


@pytest.mark.parametrize("away", [0.4, -300.0])
def test_positions_that_are_counted_from_far_away_hide_no_force_over_them(away):
    loop = iv.axes.emps()
    effects = {"cogging": {"cosine": 3.0, "sine": 1.0, "period": 0.004}}
    one, two = (r.replace(q=r.q + away, q_ref=r.q_ref + away) for r in pair(loop, **effects))
    found = iv.diagnose(one, loop, two)
    assert found.effects == ("cogging",)
    assert len(said(found, "of what is named, it is counted from")) == 1


@pytest.mark.filterwarnings("ignore:record. q implies")
@pytest.mark.parametrize("joint", ["prismatic", "revolute"])
def test_positions_are_counted_from_a_round_number_or_whole_turns(joint):
    rng = np.random.default_rng(3)
    loop = iv.ClosedLoop(Controller("pd", {"kp": 9.0, "kd": 1.0}), 1.0, ("inertia",), joint=joint)
    hangs = replace(loop, terms=iv.ClosedLoop(loop.controller, 1.0, ("inertia", "gravity")).terms)
    for _ in range(20):
        stroke, away = 10.0 ** rng.uniform(-5, 3), rng.uniform(-1e4, 1e4)
        q = stroke * (away + 0.5 * np.sin(np.arange(999) / 30.0))
        record = iv.Record(np.arange(999) * 1e-3, q, q_ref=q, nu=np.sin(q / stroke))
        start = preflight.origin(record, (), loop)
        near = np.max(np.abs(preflight.counted(record, start).q))
        assert near <= (1.01 if joint == "prismatic" else 1.51) * stroke
        turns = preflight.origin(record, (), hangs) / (2.0 * np.pi)
        assert joint == "prismatic" or turns == pytest.approx(round(turns), abs=1e-9)
    mine = replace(loop.terms[0], name="mine")
    assert preflight.origin(record, (mine,), loop) == 0.0


@pytest.mark.parametrize("count", [2, 4])
def test_a_log_of_some_of_the_samples_is_no_fault_of_the_controller(count):
    """At its rate other settings of the law come nearer; between its samples those of the file."""
    loop = iv.axes.emps()
    effects = {"cogging": {"cosine": 3.0, "sine": 1.0, "period": 0.004}}
    one, two = (sparse(r, count) for r in pair(loop, **effects))
    found = iv.diagnose(one, loop, two)
    assert found.effects == ("cogging",) and found.verdict == "explained"
    assert len(said(found, f"takes {count} samples for each of the log")) == 1


def commanded(seed, kind, hz):
    """Return an axis that was drawn, and what its controller of that rate did on two motions."""
    rng = np.random.default_rng([seed, populations.KINDS.index(kind)])
    loop, theta, stroke = populations.axis(rng, ("prismatic", "revolute")[seed % 2])
    law = populations.controller(rng, kind, theta["inertia"], hz)
    loop, records = replace(loop, controller=populations.scaled(law, loop.gain), start=theta), []
    for _ in range(2):
        motion = populations.reference(rng, 16_000, hz, stroke)
        noise = 1e-6 * stroke * rng.normal(size=motion.n_samples)
        ran = loop.simulate(motion, theta, initial="rest", position_noise=noise)
        records.append(motion.replace(q=ran.q, nu=ran.nu))
    return loop, records


@pytest.mark.parametrize("counts", [(1, 2), (4, 1), (2, 5)])
@pytest.mark.parametrize("kind", populations.KINDS)
def test_a_controller_has_one_rate_whatever_its_logs_have(kind, counts):
    """Each is compared at its own multiple of it; at another's the law is a wrong one."""
    for seed in range(3):
        loop, records = commanded(seed, kind, 2000.0)
        one, two = (sparse(r, n) for r, n in zip(records, counts, strict=True))
        for task in (Task(one, loop, two), Task(one, loop, judge=two)):
            compared = readied(bounded(task)).compared
            assert tuple(p.oversampling for p in compared) == counts, seed
            assert not any(p.found for p in compared), seed


@pytest.mark.parametrize("counts", [(1, 2), (4, 1)])
@pytest.mark.parametrize("kind", [k for k in populations.KINDS if k != "state-space"])
def test_a_log_with_all_samples_tells_wrong_gains_for_the_others(kind, counts):
    """To the last digit, where noise between the samples of another one hides them."""
    for seed, factor in enumerate((0.8, 1.02, 1.1)):
        loop, records = commanded(seed, kind, 2000.0)
        one, two = (sparse(r, n) for r, n in zip(records, counts, strict=True))
        stated = replace(loop, controller=loop.controller.scaled(factor))
        compared = readied(bounded(Task(one, stated, two))).compared
        assert tuple(p.oversampling for p in compared) == counts, seed
        first, second = (p.found for p in compared)
        assert first == second and first, seed
        off = np.array([*first.values()]) - (1.0 / factor - 1.0)
        assert np.max(np.abs(off)) < 1e-6, seed


@pytest.mark.parametrize("kind", ["identify", "none"])
def test_without_a_declared_law_no_log_has_the_rate_of_another(kind):
    """One that is identified has the rate of the log that it was read from."""
    loop, records = commanded(2, "p-pi", 2000.0)
    one, two = (sparse(r, n) for r, n in zip(records, (1, 2), strict=True))
    found = iv.diagnose(one, replace(loop, start={}, controller=Controller(kind, {})), two)
    assert "controller-mismatch" not in found.effects
    rates = [p.oversampling for p in found.parity]
    assert rates == ([1, 2] if said(found, "takes 2 samples") else [1, 1])
    assert kind == "identify" or rates == [1, 1]


@pytest.mark.parametrize("kind", ["pd", "cascade-pd", "p-pi"])
def test_the_axis_may_have_been_moved_by_a_slower_controller(kind):
    """A log with all that this one did is not told the rate of the other."""
    for seed in range(3):
        loop, (fast, motion) = commanded(seed, kind, 2000.0)
        slow = sparse(motion, 2)
        ran = loop.simulate(slow, loop.start, initial="rest")
        logged_whole = slow.replace(q=ran.q, nu=np.round(ran.nu, 9))
        compared = readied(bounded(Task(sparse(fast, 4), loop, logged_whole))).compared
        assert compared[0].oversampling > 2 and compared[1].oversampling == 1, seed
        assert not any(p.found for p in compared), seed


def filtered(loop, hz):
    """Return a loop with a low-pass behind its law."""
    return replace(loop, controller=replace(loop.controller, filter={"kind": "lowpass", "hz": hz}))


@pytest.mark.parametrize("count", [3, 4, 5])
def test_a_filter_that_the_rate_of_the_log_cannot_have_says_that_the_controller_is_faster(count):
    loop = filtered(iv.axes.emps(), 300.0)
    wave = {"cosine": 3.0, "sine": 1.0, "period": 0.004}
    one, two = (sparse(r, count) for r in pair(loop, cogging=wave))
    found = iv.diagnose(one, loop, two)
    assert found.effects == ("cogging",) and found.verdict == "explained"
    assert len(said(found, f"takes {count} samples for each of the log")) == 1


def test_a_filter_beyond_the_log_that_no_faster_controller_has_is_left_out():
    loop = iv.axes.emps()
    found = iv.diagnose(pair(loop)[0], filtered(loop, 600.0), pair(loop)[1])
    assert found.verdict == "adequate" and found.loop.controller.filter is None
    assert len(said(found, "at 600 Hz is not below half of the log's rate (1000 Hz)")) == 1


@pytest.mark.parametrize("count", [3, 8, 16, 20])
def test_a_drive_is_as_much_faster_than_its_log_as_its_settings_say(count, monkeypatch):
    """At 20 kHz noise of the encoder hides some of its delay."""
    monkeypatch.setattr(moves, "DT", 1e-3 / count)
    loop = iv.axes.emps()
    found = parity.check(sparse(pair(loop)[0], count), loop, read=False)
    assert found.oversampling == count and not found.mismatch
    assert found.delay == loop.controller.delay and found.after < 0.03


@pytest.mark.parametrize("count", [2, 5, 10])
def test_a_controller_is_simulated_at_its_own_rate(count):
    """What it does at the samples of the log is what it does there if all of them are logged."""
    rng = np.random.default_rng(count)
    for joint, unit in (("prismatic", 1.0), ("revolute", 3e-4)):  # kg, and kg m2
        theta = {"inertia": unit, "viscous": 3.0 * unit, "coulomb": 0.5 * unit}
        settings = {"kp": 2500.0 * unit, "kd": 70.0 * unit * rng.uniform(0.8, 1.2)}
        law = Controller("pd", settings, delay=1)
        loop = iv.ClosedLoop(law, 1.0, ("inertia", "viscous", "coulomb"), joint=joint)
        t = np.arange(3001) * 1e-3
        q_ref = np.sin(2.0 * np.pi * rng.uniform(0.5, 2.0) * t)
        record = iv.Record(t, q_ref, q_ref=q_ref, nu=unit * q_ref)
        all_of_them = loop.simulate(record, theta).to_record()
        few = sparse(all_of_them.replace(q_ref=record.q_ref), count)
        own, logs = (between.simulate(loop, few, theta, k).nu for k in (count, 1))
        begun = few.t > 1.0
        off, as_logged = (np.std((x - few.nu)[begun]) for x in (own, logs))
        assert off < 0.1 * as_logged


@pytest.mark.filterwarnings("ignore:record. q implies")
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("made", [0, 1, 3])
def test_between_the_samples_of_a_log_a_reference_goes_on_as_it_was_made(made, seed):
    """Held or interpolated by whoever made it at a lower rate, or smooth."""
    rng = np.random.default_rng(seed)
    log, count, slower = 1e-3, int(rng.integers(2, 9)), int(rng.integers(3, 11))
    fine = np.arange(4000 * count + 1) * log / count
    hz, size = rng.uniform(0.5, 2.0), 10.0 ** rng.uniform(-5, 2)
    smooth = size * np.sin(2.0 * np.pi * hz * fine) * np.sin(2.0 * np.pi * 0.3 * hz * fine)
    knots = slice(None, None, count * slower)
    q_ref = {
        0: smooth[knots][np.arange(len(fine)) // (count * slower)],
        1: np.interp(fine, fine[knots], smooth[knots]),
        3: smooth,
    }[made]
    last = len(fine) - (len(fine) - 1) % (count * slower)
    few = q_ref[:last:count]
    digits = size * 1e-9 * np.round(few / (size * 1e-9))
    record = iv.Record(fine[:last:count], digits, q_ref=digits, nu=np.cos(fine[:last:count]))
    between_them = between.interpolated(record, count).q_ref[:, 0]
    assert np.max(np.abs(between_them - q_ref[:last])) < 1e-4 * size


def test_of_a_step_that_a_log_has_between_its_samples_nothing_is_asked():
    """Of an input that always jumps everything is."""
    loop = iv.axes.emps()
    record = moves.record(loop, BASE, SECONDS, 1)
    pulses = np.where(record.t % 2.0 < 0.03, 1.3, 0.0)
    at = record.t[np.flatnonzero(np.diff(pulses)) + 1]
    shows = stepped(record.replace(added=pulses))
    since = np.min(
        np.where(record.t >= at[:, np.newaxis], record.t - at[:, np.newaxis], 9.0), axis=0
    )
    assert shows[since < 0.14].all() and not shows[since > 0.16].any()
    always = np.random.default_rng(0).choice([-1.0, 1.0], record.n_samples)
    assert not stepped(record.replace(added=always)).any() and not stepped(record).any()


def test_a_first_look_compares_the_law_at_its_rate():
    loop = iv.axes.emps()
    found = suitability(sparse(pair(loop)[0], 4), loop)
    assert found.sufficient and ("its rate", "4 times", "that of the log") in found.rows
    left = []
    for rate in (1, 4):
        chart = parity_chart(found.record, loop, caption="", oversampling=rate)
        left.append(np.std(chart.panels[1].series[0].values[PARITY_HEAD:]))
    assert left[1] < 0.1 * left[0]
    found = suitability(pair(loop)[0], filtered(loop, 600.0))
    beyond = ("filter", "600 Hz", "beyond the log's rate: compared without it")
    assert found.sufficient and beyond in found.rows


def test_gains_that_are_wrong_are_no_matter_of_the_rate():
    loop = iv.axes.emps()
    record = pair(loop)[0]
    gains = {**loop.controller.settings, "kv": 1.04 * loop.controller.settings["kv"]}
    wrong = replace(loop, controller=replace(loop.controller, settings=gains))
    found = parity.check(record, wrong)
    assert found.oversampling == 1 and found.found == pytest.approx({"kv": 1 / 1.04 - 1}, rel=1e-3)


@pytest.mark.parametrize("seed", range(8))
def test_nor_are_they_behind_noise_of_the_encoder(seed):
    """A filter of the velocity that the file lacks, a gain, or a delay that is shorter."""
    rng = np.random.default_rng(seed)
    loop = iv.axes.emps()
    law = loop.controller
    size, kv = rng.choice([-1.0, 1.0]) * rng.uniform(0.03, 0.2), law.settings["kv"]
    others = (
        {"settings": {**law.settings, "kv": (1.0 + size) * kv}},
        {"velocity_filter": (0.6, 0.4)},
        {"delay": law.delay + 1},
        {"settings": {**law.settings, "kp": (1.0 + size) * law.settings["kp"]}},
    )
    other = replace(law, **others[seed % len(others)])
    true, declared = (law, other) if seed < len(others) else (other, law)
    record = pair(replace(loop, controller=true))[0]
    noise = 10.0 ** rng.uniform(-6.5, -5.5) * rng.normal(size=record.n_samples)
    found = parity.check(
        record.replace(q=record.q[:, 0] + noise), replace(loop, controller=declared)
    )
    assert found.oversampling == 1


@pytest.mark.parametrize("seed", [1104, 1112, 1116, 1125, 1138])
def test_noise_between_the_samples_of_a_log_hides_no_law(seed):
    """It is most of the command of drives at 4 kHz that are logged at 1 kHz."""
    case = healthy.draw(seed, rates=(4000,), seconds=8.0)
    record, loop = sparse(case.record, 4), case.loop
    plain = parity.check(record, loop, read=False)
    found = parity.at_motion(record, loop, plain)
    assert not plain.trustworthy
    assert found.trustworthy and not found.mismatch and found.below < 8.0
    law = loop.controller
    gains = {k: 1.6 * v for k, v in law.settings.items() if k in ("kp", "kv", "ki")}
    if gains:
        wrong = replace(loop, controller=replace(law, settings={**law.settings, **gains}))
        other = parity.at_motion(record, wrong, parity.check(record, wrong, read=False))
        assert other.below is None and (other.mismatch or not other.trustworthy)


def test_an_added_input_of_the_wrong_sign_is_no_noise():
    """Between the frequencies of the motion it would not show."""
    loop, rng = iv.axes.emps(), np.random.default_rng(0)
    motion = moves.record(loop, BASE, SECONDS, 1)
    added = 2.0 * rng.choice([-1.0, 1.0], motion.n_samples // 20 + 1).repeat(20)[: motion.n_samples]
    record = stepped_in(loop, motion, added)
    record = record.replace(q=record.q[:, 0] + 3e-6 * rng.normal(size=record.n_samples))
    wrong = record.replace(added=-added)
    plain = parity.check(wrong, loop, read=False)
    assert plain.mismatch["added"] == pytest.approx(-2.0, abs=0.1)
    assert parity.at_motion(wrong, loop, plain) is plain
    assert parity.at_motion(record, loop, parity.check(record, loop, read=False)).trustworthy


def stepped_in(loop, motion, added):
    """Return the record of a motion with an added input."""
    made = loop.simulate(motion.replace(added=added), loop.values(BASE), initial="rest")
    return motion.replace(q=made.q, nu=made.nu, added=added)


def test_a_law_behind_such_noise_is_said_and_diagnosed():
    case = healthy.draw(1116, rates=(4000,), seconds=8.0)
    record = sparse(case.record, 4)
    found = iv.diagnose(record, case.loop)
    assert found.verdict == "adequate" and not found.effects
    assert len(said(found, "noise that is not the other's")) == 1
    shown = suitability(record, case.loop)
    assert any("noise that only one of them has" in text for *_, text in shown.rows)


@pytest.mark.parametrize("seed", range(4))
def test_a_limit_is_seen_in_a_command_of_few_digits_beside_an_added_input(seed):
    """Less what was added it is not the same wherever it sits at the limit."""
    rng = np.random.default_rng(seed)
    free, limit = iv.axes.emps(), rng.uniform(1.0, 2.0)
    cut = replace(free, controller=replace(free.controller, limit=limit))
    motion = moves.record(free, BASE, SECONDS, seed)
    pulses = rng.uniform(0.2, 0.9) * (motion.t % 1.1 < 0.1)
    simulation = cut.simulate(motion.replace(added=pulses), BASE)
    step = 10.0 ** rng.uniform(-4, -2.5)
    command = step * np.round(simulation.nu / step)
    found = parity.check(motion.replace(q=simulation.q, nu=command, added=pulses), free)
    assert found.limit == pytest.approx(limit, abs=step)
    assert not found.mismatch and found.after < 0.01


def every(record):
    return {"t": record.t, **{k: x[:, 0] for k, x in record.signals.items()}}
