"""Diagnoses on axes as others draw them: slow rates, hardly any noise, soft bristles, twins."""

from dataclasses import replace

import numpy as np
import pytest

import ivtools as iv
from benchmarks import moves
from benchmarks.withheld.cases import draw
from benchmarks.withheld.suites import Task
from ivtools.gap.fold import usable
from ivtools.gap.response import leaky
from ivtools.gap.rules import TRANSIENT
from ivtools.loop import ClosedLoop, Controller
from ivtools.loop.axis_file import from_tables
from ivtools.physics import Parameter, Term
from ivtools.record import Record

BASE = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
SECONDS = 16.0


def withheld(*effects, seed):
    """Return the diagnosis of a drawn case with two effects."""
    case = draw(Task("two", seed, effects))
    one, two = (Record.from_dict(r, name=n) for r, n in zip(case.records, "ab", strict=True))
    return iv.diagnose(one, from_tables(case.axis.tables()), two)


def pair(effect="", *, noise=None, seeds=(1, 2), monkeypatch=None, **values):
    """Return two records of the EMPS with an effect, and maybe another force noise, N."""
    loop = iv.axes.emps().with_effect(effect, **values) if effect else iv.axes.emps()
    if noise is not None:
        monkeypatch.setattr(moves, "FORCE_NOISE", noise)
    return [moves.record(loop, loop.values(BASE), SECONDS, seed) for seed in seeds]


# -- what is negligible ----------------------------------------------------------------------------
def test_what_nobody_could_see_has_no_name_and_is_no_gap(monkeypatch):
    """Where the noise is a thousandth of the force, everything is significant."""
    pairs = pair("cogging", noise=0.004, monkeypatch=monkeypatch, cosine=0.012, period=0.004)
    gap = iv.diagnose(pairs[0], iv.axes.emps(), pairs[1])
    assert gap.effects == () and gap.verdict == "adequate"
    asked = iv.diagnose(pairs[0], iv.axes.emps(), pairs[1], tolerance=0.01)
    assert asked.effects == ("cogging",)


@pytest.mark.parametrize("factor", [0.7, 1.35])
def test_a_payload_is_a_changed_setting_and_no_other_axis(factor):
    loop = iv.axes.emps()
    heavy = loop.values({**BASE, "inertia": factor * BASE["inertia"]})
    one = moves.record(loop, loop.values(BASE), SECONDS, 3)
    gap = iv.diagnose(one, loop, moves.record(loop, heavy, SECONDS, 4))
    assert gap.verdict == "non-repeatable" and set(gap.changed) == {"inertia"}
    assert gap.changed["inertia"].holdout == pytest.approx(heavy["inertia"], rel=0.03)


def test_a_changed_setting_is_said_beside_a_small_gap(monkeypatch):
    """The model is never quite the axis, which shows where there is hardly any noise."""
    plain = iv.axes.emps().with_effect("stribeck", force=0.05, speed=0.01)
    monkeypatch.setattr(moves, "FORCE_NOISE", 0.004)
    records = [
        moves.record(plain, plain.values({**BASE, "coulomb": c}), SECONDS, s)
        for s, c in ((5, 20.0), (6, 16.0))
    ]
    gap = iv.diagnose(records[0], iv.axes.emps(), records[1], without=["stribeck"])
    assert "coulomb" in gap.changed


# -- what is looked for --------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("stiffness", "damping"), [(2e5, 1200.0), (6e5, 3000.0), (8e4, 400.0), (2.34e5, 5383.0)]
)
def test_a_bristle_has_its_damping(stiffness, damping):
    one, two = pair("presliding", stiffness=stiffness, damping=damping)
    gap = iv.diagnose(one, iv.axes.emps(), two)
    assert gap.effects == ("presliding",)
    assert gap.parameters["presliding"]["stiffness"] == pytest.approx(stiffness, rel=0.1)
    assert gap.parameters["presliding"]["damping"] == pytest.approx(damping, rel=0.25)


def test_two_that_hide_each_other_are_found_together():
    """Neither reaches its threshold while the other one is in the gap."""
    gap = withheld("position-friction", "spring", seed=7109)
    assert set(gap.effects) == {"position-friction", "spring"}
    assert gap.chi[1] < 1.05


def test_what_is_uneven_alone_is_judged_beside_the_others():
    gap = withheld("friction-drift", "asymmetric-viscous", seed=7106)
    assert set(gap.effects) == {"friction-drift", "asymmetric-viscous"}


def test_an_effect_that_one_motion_hides_is_told_by_the_other():
    """At constant speed friction of the load is dry and viscous friction."""
    loop = iv.axes.emps().with_effect("load-friction", ratio=0.08)
    t = np.arange(0.0, SECONDS, moves.DT)
    q_ref = 0.1 + 0.08 * np.sin(2.0 * np.pi * 0.04 * t)
    asked = Record(t, q_ref, q_ref=q_ref, nu=q_ref)
    noise = np.random.default_rng(8).normal(0.0, moves.FORCE_NOISE, len(t))
    ran = loop.simulate(asked, loop.values(BASE), initial="rest", force_noise=noise)
    slow = Record(t, ran.q, q_ref=q_ref, nu=ran.nu, name="slow")
    brisk = moves.record(loop, loop.values(BASE), SECONDS, 9).replace(name="brisk")
    for one, two in ((slow, brisk), (brisk, slow)):
        gap = iv.diagnose(one, iv.axes.emps(), two)
        assert gap.effects == ("load-friction",)
        assert gap.parameters["load-friction"]["ratio"] == pytest.approx(0.08, rel=0.1)
    assert any("the motion of slow does not show it" in f.text for f in gap.findings)


def beside_a_force(unknown):
    """Return the diagnosis of a rigid axis with a further force, N, of its speed."""
    loop = iv.axes.emps()
    records = [
        moves.record(loop, loop.values(BASE), SECONDS, seed, unknown=unknown) for seed in (1, 2)
    ]
    return iv.diagnose(records[0], loop, records[1])


@pytest.fixture(scope="module")
def noise():
    """Return the noise of an axis without a further force, N."""
    return beside_a_force(None).floors[0].noise


@pytest.mark.parametrize("law", [lambda v: v / 0.08, np.sign], ids=["creep", "relaxing"])
@pytest.mark.parametrize("seconds", [0.2, 0.6, 2.0])
def test_a_force_that_remembers_the_motion_is_no_noise(law, seconds, noise):
    """A seal or a belt that relaxes had been learnt as coloured noise, and its gap was adequate."""
    gap = beside_a_force(lambda v: 15.0 * leaky(law(v), seconds, moves.DT))
    assert gap.floors[0].noise < 1.5 * noise
    assert gap.verdict != "adequate" and gap.effects == ()


@pytest.mark.parametrize("period", [0.1, 0.2])
@pytest.mark.parametrize("power", [1, 2])
def test_a_force_of_position_times_speed_is_no_noise(period, power, noise):
    """It had been learnt as slow noise, of up to six times the noise that there is."""

    def force(v):
        return 15.0 * np.sin(2.0 * np.pi * np.cumsum(v) * moves.DT / period) * (v / 0.08) ** power

    gap = beside_a_force(force)
    assert gap.floors[0].noise < 2.6 * noise
    assert gap.verdict not in ("adequate", "explained")


def waves(size, low, high):
    """Return a force of five waves between two frequencies, Hz, that each motion has of its own."""

    def force(v):
        rng, t = np.random.default_rng([7, len(v), round(1e6 * abs(v).sum())]), np.arange(len(v))
        each = np.sin(2.0 * np.pi * np.outer(t * moves.DT, rng.uniform(low, high, 5)) + range(5))
        return size * np.sum(each, axis=1) / np.sqrt(2.5)

    return force


@pytest.mark.parametrize("size", [5.0, 15.0])
def test_a_slow_force_that_follows_nothing_is_no_noise(size, noise):
    """It had been learnt as coloured noise, of five to six times the noise that there is."""
    gap = beside_a_force(waves(size, 0.3, 1.0))
    assert gap.floors[0].noise < 4.0 * noise
    assert gap.verdict == "unexplained" and gap.effects == ()


@pytest.mark.parametrize("slower", [0.0, 5.0])
def test_nor_is_one_that_stands_out_an_octave_higher(slower):
    """Most of it had been learnt as noise."""
    low, high = waves(slower, 0.3, 1.0), waves(5.0, 5.5, 7.5)
    gap = beside_a_force(lambda v: low(v) + high(v))
    assert max(f.noise for f in gap.floors) < 0.5 * np.hypot(slower, 5.0)
    assert gap.verdict != "adequate" and gap.effects == ()


@pytest.mark.parametrize("size", [0.3, 3.0])
def test_noise_of_the_force_alone_is_no_gap(size):
    """No sensor of this axis has any: all that is in the command came through the loop."""
    loop, found = iv.axes.emps(), []
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        q_ref = moves.reference(rng, SECONDS)
        asked = Record(np.arange(len(q_ref)) * moves.DT, q_ref, q_ref=q_ref, nu=q_ref)
        noise = rng.normal(0.0, size, len(q_ref))
        ran = loop.simulate(asked, loop.values(BASE), initial="rest", force_noise=noise)
        found.append(Record(asked.t, ran.q, q_ref=q_ref, nu=ran.nu))
    assert iv.diagnose(found[0], loop, found[1]).verdict == "adequate"


@pytest.mark.parametrize(("size", "said"), [(0.6, False), (60.0, True)])
def test_that_much_of_the_force_counts_as_noise_is_said(size, said, monkeypatch):
    """Two records of one motion would show whether it is."""
    one, two = pair(noise=size, monkeypatch=monkeypatch)
    lines = [line for line in iv.diagnose(one, iv.axes.emps(), two).advice if "as noise" in line]
    assert len(lines) == 2 * said and all("two records of one motion" in x for x in lines)


@pytest.mark.parametrize("hz", [7.0, 12.0, 75.0])
def test_a_second_mass_is_found_below_and_above_the_usual(hz):
    one, two = pair("flexibility", frequency_hz=hz, damping=0.03, load_share=0.3)
    gap = iv.diagnose(one, iv.axes.emps(), two)
    assert gap.effects == ("flexibility",)
    assert gap.parameters["flexibility"]["frequency_hz"] == pytest.approx(hz, rel=0.05)


@pytest.mark.parametrize("share", [0.6, 0.8])
def test_a_limit_that_is_rarely_reached_is_found_beside_standstill(share):
    """Most of such a record says nothing of the limit, and the inverse model nothing of rest."""
    loop = iv.axes.emps()
    plain = moves.record(loop, loop.values(BASE), SECONDS, 1)
    limit = share * float(np.max(np.abs(loop.force(plain))))
    one, two = pair("inner-saturation", force=limit)
    gap = iv.diagnose(one, loop, two)
    assert gap.effects == ("inner-saturation",)
    assert gap.parameters["inner-saturation"]["force"] == pytest.approx(limit, rel=0.03)
    assert any(f.isolated for f in gap.floors)  # it stands out of the base model
    assert not any("far above the noise" in line for line in gap.advice)


# -- what comes from outside -----------------------------------------------------------------------
@pytest.mark.parametrize(("count", "size"), [(3, 6.0), (9, 60.0)])
@pytest.mark.parametrize("which", [0, 1])
def test_pushes_in_one_record_are_said_however_many_and_strong(count, which, size):
    loop, width = iv.axes.emps(), round(0.15 / moves.DT)
    starts = np.linspace(1.0, SECONDS - 1.0, count)

    def pushes(v):
        force = np.zeros(len(v))
        for start in starts:
            force[round(start / moves.DT) :][:width] = size
        return force

    records = [
        moves.record(
            loop, loop.values(BASE), SECONDS, seed, unknown=pushes if seed == which else None
        )
        for seed in (0, 1)
    ]
    gap = iv.diagnose(records[0], loop, records[1])
    assert gap.verdict == "non-repeatable" and gap.effects == () and gap.changed == {}
    (advice,) = (line for line in gap.advice if "far above the noise" in line)
    assert advice.startswith(records[which].name)
    hit = [any(a - 0.2 < s < b for a, b in gap.floors[which].events) for s in starts]
    assert all(hit) and gap.floors[1 - which].events == ()


@pytest.mark.parametrize(("joint", "stroke"), [("prismatic", 1e-3), ("revolute", 300.0)])
@pytest.mark.parametrize("hz", [200.0, 4000.0])
def test_an_axis_is_compared_once_it_has_moved_off(hz, joint, stroke):
    """It stood wherever friction had caught it, which the record does not show."""
    t = np.arange(0.0, 8.0, 1.0 / hz)
    noise = 1e-5 * stroke * np.random.default_rng(3).normal(size=len(t))
    asked, done = (stroke * np.sin(0.9 * np.clip(t - start, 0.0, None)) for start in (0.4, 0.7))
    law = Controller("cascade-pd", {"kp": 30.0, "kv": 0.8})
    loop = iv.ClosedLoop(law, 1.0, ("inertia", "viscous", "coulomb", "offset"), joint=joint)
    record = Record(t, done + noise, q_ref=asked, nu=np.gradient(asked))
    assert t[np.argmax(usable(record, loop))] == pytest.approx(0.7 + TRANSIENT, abs=0.02)


# -- what is said to be one ------------------------------------------------------------------------
def hinge(arc, noise, seed):
    """Return a record of a hinge with an eccentric mass, over an arc of so many radians."""
    law = Controller("cascade-pd", {"kp": 30.0, "kv": 0.8})
    terms = ("inertia", "viscous", "coulomb", "offset")
    loop = iv.ClosedLoop(law, 1.0, terms, joint="revolute")
    axis = loop.with_effect("gravity", sin=0.2, cos=0.1)
    theta = axis.values({"inertia": 0.02, "viscous": 0.05, "coulomb": 0.04, "offset": 0.0})
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, SECONDS, 2e-3)
    hz, turn = rng.uniform(0.1, 1.2, 5), rng.uniform(0.0, 2.0 * np.pi, 5)
    q_ref = np.sin(2.0 * np.pi * hz * t[:, None] + turn).sum(axis=1) * arc / 10.0
    asked = Record(t, q_ref, q_ref=q_ref, nu=q_ref)
    ran = axis.simulate(asked, theta, initial="rest", force_noise=rng.normal(0.0, noise, len(t)))
    return Record(t, ran.q, q_ref=q_ref, nu=ran.nu, name=f"seed {seed}"), loop


def test_gravity_and_a_spring_are_one_over_a_short_arc_only():
    (one, loop), (two, _) = hinge(0.8, 3e-3, 11), hinge(0.8, 3e-3, 12)
    short = iv.diagnose(one, loop, two)
    assert {*short.effects, *short.ambiguous_with[short.effects[0]]} == {"gravity", "spring"}
    assert any("three times the stroke" in line for line in short.advice)
    (one, loop), (two, _) = hinge(3.0, 1e-4, 11), hinge(3.0, 1e-4, 12)
    wide = iv.diagnose(one, loop, two)
    assert wide.effects == ("gravity",) and wide.ambiguous_with["gravity"] == []


# -- rates -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("hz", [100.0, 125.0, 200.0, 250.0, 333.0, 400.0, 2000.0, 5000.0])
def test_a_slow_rate_has_a_pipeline(hz):
    """A cut-off at half the sampling rate had been asked for, and refused."""
    t = np.arange(0.0, 10.0, 1.0 / hz)
    q = 0.1 * np.sin(2.0 * np.pi * 0.7 * t)
    loop = iv.axes.emps()
    for inertia in (0.5, 5.0, 50.0):  # the loop as fast as its rate, and faster
        quick = replace(loop, start={**loop.start, "inertia": inertia})
        pipeline = quick.pipeline(Record(t, q, q_ref=q, nu=q), "report")
        assert pipeline.cutoff_hz < 0.45 * hz


@pytest.mark.parametrize("effect", ["cogging", "torque-ripple"])
def test_a_line_that_one_of_two_motions_hardly_repeats_is_found(effect):
    """It comes four times in one record, and less than twice where the other one has been."""
    size = {"cogging": 6.0, "torque-ripple": 0.08}[effect]
    loop = iv.axes.emps().with_effect(effect, cosine=size, sine=0.5 * size, period=0.055)
    records = []
    for stroke, rate, name in ((0.11, 0.21, "wide"), (0.05, 0.27, "narrow")):
        t = np.arange(0.0, SECONDS, moves.DT)
        waves = 0.7 * np.sin(2.0 * np.pi * rate * t) + 0.3 * np.sin(5.0 * rate * t + 1.0)
        q_ref = 0.12 + stroke * (waves - waves[0])
        asked = Record(t, q_ref, q_ref=q_ref, nu=q_ref)
        noise = np.random.default_rng(len(name)).normal(0.0, moves.FORCE_NOISE, len(t))
        ran = loop.simulate(asked, loop.values(BASE), initial="rest", force_noise=noise)
        records.append(Record(t, ran.q, q_ref=q_ref, nu=ran.nu, name=name))
    for one, two in (records, records[::-1]):
        gap = iv.diagnose(one, iv.axes.emps(), two)
        assert gap.effects == (effect,)
        assert gap.parameters[effect]["period"] == pytest.approx(0.055, rel=0.03)


# -- lines over position ---------------------------------------------------------------------------
@pytest.mark.parametrize(("turns", "named"), [(1.1, True), (1.6, True), (1.1, False)])
def test_one_turn_of_an_encoder_need_come_once(turns, named, monkeypatch):
    """Any other line must come twice."""
    monkeypatch.setattr(moves, "SPEEDS", (0.8, 6.0))
    monkeypatch.setattr(moves, "FORCE_NOISE", 30.0)
    flat = iv.axes.emps()
    loop = replace(flat, joint="revolute", controller=replace(flat.controller, limit=np.inf))
    period = 2.0 * np.pi if named else 0.7 * 2.0 * np.pi * turns
    off = loop.with_effect("encoder-eccentricity", cosine=0.02, sine=0.015, period=period)
    theta = off.values({**BASE, "coulomb": 1000.0, "offset": -150.0})
    stroke = (0.0, 2.0 * np.pi * turns)
    one, two = (moves.record(off, theta, SECONDS, seed, stroke) for seed in (1, 2))
    gap = iv.diagnose(one, loop, two)
    assert gap.effects == ("encoder-eccentricity",) * named
    if named:
        assert gap.parameters["encoder-eccentricity"]["cosine"] == pytest.approx(0.02, rel=0.1)


@pytest.mark.parametrize("away", [0.06, 0.09])
def test_a_scale_far_off_its_shaft_has_harmonics_as_well(away, monkeypatch):
    """It shows the angle at a point beside the centre; of its period one turn is known."""
    monkeypatch.setattr(moves, "SPEEDS", (0.8, 6.0))
    law, terms = Controller("cascade-pd", {"kp": 40.0, "kv": 15.0}), iv.axes.emps().names
    loop = ClosedLoop(law, 1.0, tuple(terms), joint="revolute")
    rng, records, dt, steps = np.random.default_rng(1), [], 1e-3, 20
    h = dt / steps
    for seed in (1, 2):
        q_ref = moves.reference(np.random.default_rng(seed), SECONDS, (0.0, 2.8 * np.pi))
        q, dq, last = float(q_ref[0]), 0.0, float(q_ref[0])
        read, nu = np.empty((2, len(q_ref)))
        for k, asked in enumerate(q_ref):
            read[k] = q + np.arctan2(away * np.sin(q), 1.0 - away * np.cos(q))
            last, speed = read[k], (read[k] - last) / dt * (k > 0)
            nu[k] = 15.0 * (40.0 * (asked - read[k]) - speed)
            force = nu[k] + 0.01 * rng.normal() - 0.1
            for _ in range(steps):
                free = dq + (force - 0.2 * dq) * h / 0.15
                dq = np.sign(free) * max(abs(free) - 0.5 * h / 0.15, 0.0)  # dry friction
                q += dq * h
        t = dt * np.arange(len(q_ref))
        records.append(Record(t, read, q_ref=q_ref, nu=nu, name=str(seed)))
    gap = iv.diagnose(records[0], loop, records[1])
    assert gap.effects == ("encoder-eccentricity",)
    found = gap.parameters["encoder-eccentricity"]
    assert found["period"] == 2.0 * np.pi and found["sine"] == pytest.approx(away, rel=0.1)


def second(q, dq, ddq, sign, tau, t, size):
    """The second harmonic of a cogging of 12 mm."""
    return size * np.cos(4.0 * np.pi * q / 0.012 + 1.0)


HARMONIC = Term("second", "mechanics", (Parameter("size", "{F}"),), "a wave", "a test", law=second)


@pytest.mark.parametrize("hz", [None, 8.0, 14.0])
def test_a_harmonic_is_no_further_effect(hz):
    """The force of an eccentric encoder, which it resembles, had been named beside it.

    Behind a flexible load a wave of force does something else than to a rigid axis.
    """
    loop = iv.axes.emps().with_effect("cogging", cosine=4.0, sine=0.0, period=0.012)
    loop = loop.with_effect(HARMONIC, size=1.2)
    if hz is not None:
        link = {"damping": 0.03, "load_share": 0.3, "load_friction": 0.05}
        loop = loop.with_effect("flexibility", frequency_hz=hz, **link)
    theta = loop.values({**BASE, "cogging.cosine": 4.0, "cogging.sine": 0.0, "second.size": 1.2})
    one, two = (moves.record(loop, theta, SECONDS, seed) for seed in (1, 2))
    gap = iv.diagnose(one, iv.axes.emps(), two)
    assert {*gap.effects} == {"cogging"} | ({"flexibility"} if hz else set())
    assert not any(gap.ambiguous_with.values())


@pytest.mark.parametrize(("stroke", "damping"), [(0.002, 100.0), (0.035, 100.0), (0.1, 600.0)])
def test_bristles_of_any_stiffness_are_found(stroke, damping):
    """The softest let an axis move by a tenth of its stroke before they yield."""
    stiffness = BASE["coulomb"] / (stroke * (moves.STROKE[1] - moves.STROKE[0]))
    one, two = pair("presliding", stiffness=stiffness, damping=damping)
    gap = iv.diagnose(one, iv.axes.emps(), two)
    assert gap.effects == ("presliding",)
    assert gap.parameters["presliding"]["stiffness"] == pytest.approx(stiffness, rel=0.1)
