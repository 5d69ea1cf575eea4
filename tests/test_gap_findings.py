"""What is wrong with a record or its axis file is said, and no effect is named instead."""

import json
from dataclasses import replace

import numpy as np
import pytest

import ivtools as iv
from ivtools.cli import run
from ivtools.gap import parity, preflight
from ivtools.gap.fold import usable
from ivtools.gap.page import effects_text
from ivtools.gap.preflight import plausible
from ivtools.loop import Controller
from ivtools.loop.controllers import Seen
from ivtools.physics import EFFECTS
from ivtools.units import parse

THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
SAMPLES = 8000


@pytest.fixture(scope="module")
def loop():
    return iv.axes.emps()


@pytest.fixture(scope="module")
def twin():
    return iv.datasets.twin().slice(0, SAMPLES)


SOUND = ["twin", *(pytest.param(n, marks=pytest.mark.slow) for n in ("emps", "emps_pulses"))]


@pytest.fixture(params=SOUND)
def record(request):
    """A sound record: simulated, and measured without and with an added input."""
    return request.getfixturevalue(request.param).slice(0, SAMPLES)


def with_gains(loop, **settings):
    gains = {**loop.controller.settings, **settings}
    return replace(loop, controller=replace(loop.controller, settings=gains))


def scaled(record, factor, *signals):
    found = {s: factor * x for s in signals if (x := getattr(record, s)) is not None}
    return record.replace(**found)


def moved(loop, record, q_ref, theta=THETA, name="other", seed=1):
    """Return the record of another motion, or of another axis."""
    q_ref = np.asarray(q_ref).reshape(-1, 1)
    given = record.replace(q=q_ref, q_ref=q_ref, added=None, dq_ref=None, name=name)
    noise = np.random.default_rng(seed).normal(0.0, 2.0, record.n_samples)
    sim = loop.simulate(given, theta, initial="rest", force_noise=noise, quantum=5e-8)
    return given.replace(q=sim.q, nu=sim.nu)


def refusal(record, loop, holdout=None):
    """Return what a diagnosis says against its input, having made sure that it names nothing."""
    found = iv.diagnose(record, loop, holdout)
    assert (found.verdict, found.effects, found.shrink) == ("unexplained", (), None)
    assert found.parameters == {} and found.ranking == ()
    assert json.loads(json.dumps(found.to_dict()))["findings"]
    assert max(map(len, found.summary().splitlines())) <= 80
    (only,) = [f.text for f in found.findings if f.fatal]  # one cause, not its consequences
    assert "\n" not in only
    return only


# -- units, signs, gains ---------------------------------------------------------------------------
UNITS = {
    "mm instead of m": (1e3, ("q", "q_ref"), "in mm; give m"),
    "mm in q only": (1e3, ("q",), "as if q were in mm; give m"),
    "mm in q_ref only": (1e3, ("q_ref",), "as if q_ref were in mm; give m"),
    "command in mV": (1e3, ("nu",), "check the unit of nu"),
    "command in kV": (1e-3, ("nu",), "check the units of q, q_ref and nu"),
    "command reversed": (-1.0, ("nu",), "opposite sign"),
    "position reversed": (-1.0, ("q", "q_ref"), "opposite sign"),
    "position against its reference": (-1.0, ("q",), "check the signs of q and q_ref"),
    "time in ms": (1e3, ("t",), "is it in s?"),
}


@pytest.mark.filterwarnings("ignore::ivtools.errors.RecordWarning")
@pytest.mark.parametrize("factor, signals, said", UNITS.values(), ids=UNITS)
def test_a_wrong_unit_or_sign_is_said(record, loop, factor, signals, said):
    assert said in refusal(scaled(record, factor, *signals), loop)


def test_degrees_are_said(record, loop):
    turning = replace(loop, joint="revolute", start={})
    assert "in degrees; give rad" in refusal(scaled(record, 180.0 / np.pi, "q", "q_ref"), turning)


@pytest.mark.parametrize(
    "change, said",
    [
        ({"kp": 2.0}, "kp -50 %: 160.2, not 320.4"),
        ({"kv": 0.5}, "kv +100 %: 243."),
        ({"kp": 0.5, "kv": 0.5}, "kv +100 %"),
    ],
)
def test_wrong_gains_are_put_right_and_named(twin, loop, change, said):
    wrong = with_gains(loop, **{k: f * loop.controller.settings[k] for k, f in change.items()})
    found = iv.diagnose(twin, wrong)
    text = " ".join(f.text for f in found.findings)
    assert said in text and "goes on with the record's; correct [controller]" in text
    assert found.effects[0] == "controller-mismatch" and "asymmetric-viscous" in found.effects
    shown = found.parameters["controller-mismatch"]
    assert shown == {k: pytest.approx(1.0 / f - 1.0, abs=5e-3) for k, f in change.items()}


def test_a_wrong_kind_of_controller_is_put_right_and_named(twin, loop):
    settings = {"kp": 2e4, "kd": 243.45}
    wrong = replace(loop, controller=replace(loop.controller, kind="pd", settings=settings))
    found = iv.diagnose(twin, wrong)
    text = " ".join(f.text for f in found.findings)
    assert "the record shows kind cascade-pd, kp = 160.2, kv = 243." in text
    assert found.effects == ("controller-mismatch", "asymmetric-viscous")
    shown = found.parameters["controller-mismatch"]
    assert shown == pytest.approx({"law.kp": 160.18, "law.kv": 243.45}, rel=2e-3)


def test_a_law_without_velocity_reference_is_a_cascade_by_another_name(twin, loop):
    kp, kv = (loop.controller.settings[k] for k in ("kp", "kv"))
    other = replace(loop.controller, kind="pd", settings={"kp": kp * kv, "kd": kv})
    still = twin.replace(dq_ref=1e-12 * np.sin(twin.t))
    found = parity.check(still, replace(loop, controller=other))
    assert found.after < 1e-6 and not found.found


def test_a_command_that_no_law_explains_is_refused_with_what_was_tried(twin, loop):
    noise = np.random.default_rng(0).normal(0.0, 3.0, twin.nu.shape)
    text = refusal(twin.replace(nu=np.cumsum(noise, axis=0) / 300.0), loop)
    assert (
        "no kind of law gives all of it either; R2 of each where it was fitted: " in text
        and "cascade-pd" in text
    )


def test_the_sign_and_size_of_the_drive_gain_are_said(record, loop):
    assert "sign of the command and of [drive] gain" in refusal(record, replace(loop, gain=-35.15))
    assert "units and [drive] gain" in refusal(record, replace(loop, gain=1000.0 * loop.gain))


# -- motion ----------------------------------------------------------------------------------------
def test_too_little_motion_is_said(record, loop):
    assert "at least 3 s" in refusal(record.slice(0, 2000), loop)


def test_what_is_at_fault_comes_before_notes_about_the_controller(record, loop):
    unknown = replace(loop, controller=Controller("identify", {}))
    found = iv.diagnose(record.slice(0, 2000), unknown)
    assert "at least 3 s" in found.findings[0].text and found.findings[0].fatal


def test_a_slow_clock_for_a_short_time_is_told_what_is_too_little(twin, loop):
    """62.5 Hz and 6 s: enough to estimate from, too little to name effects."""
    own = {name: x[:6000:16, 0] for name, x in twin.signals.items()}
    record = iv.Record.from_dict({"t": twin.t[:6000:16], **own})
    slow = replace(loop, controller=Controller("none", {}))
    assert iv.IDIMLS().fit(record, slow).params["inertia"] == pytest.approx(95.0, rel=0.1)
    assert "samples show motion to compare" in refusal(record, slow)


def test_standstill_is_said(twin, loop):
    q_ref = np.full(SAMPLES, 0.1)
    shaken = 0.2 * np.sign(np.sin(20.0 * twin.t))[:, None]
    noise = 5e-8 * np.round(np.random.default_rng(0).normal(0.0, 1.0, (SAMPLES, 1)))
    still = twin.replace(q=0.1 + noise, q_ref=q_ref, nu=shaken + 1e-3 * noise, added=shaken)
    assert "does not move" in refusal(still, loop)


def test_a_blocked_axis_is_said(twin, loop):
    noise = 5e-8 * np.random.default_rng(0).normal(0.0, 1.0, (SAMPLES, 1))
    law = loop.controller.law(twin.dt)
    q = 0.1 * np.abs(noise) / np.max(np.abs(noise)) * 1e-3 + twin.q_ref[0]
    seen = Seen.of(loop.controller, twin.replace(q=q), twin.nu).inputs
    nu = np.clip(law.command(seen, law.settled(seen[0])), -10, 10)
    assert "blocked or not enabled" in refusal(twin.replace(q=q, nu=nu), loop)


def test_most_of_the_record_at_rest_is_said(twin, loop):
    assert "s show motion" in refusal(moved(loop, twin, np.clip(0.1 * twin.t, 0.0, 0.04)), loop)


def test_one_direction_is_said_and_leaves_one_friction(twin, loop):
    q_ref = 0.02 * twin.t + 0.004 * np.sin(np.pi * twin.t)
    found = iv.diagnose(moved(loop, twin, q_ref), loop)
    assert any("count as one" in f.text and not f.fatal for f in found.findings)
    assert found.shrink is not None and "offset" not in found.theta


def test_where_one_of_two_records_moves_one_way_the_other_is_diagnosed_alone(twin, loop):
    """On both the model would lack its offset: a gap of a healthy axis."""
    back = moved(loop, twin, twin.q_ref[:, 0]).replace(name="back")
    forth = moved(loop, twin, 0.01 * twin.t).replace(name="forth")
    for record, holdout in ((back, forth), (forth, back)):
        found = iv.diagnose(record, loop, holdout=holdout)
        (text,) = [f.text for f in found.findings if "one direction only" in f.text]
        assert text.startswith("forth: ") and "back is diagnosed alone" in text
        assert found.verdict == "adequate" and "offset" in found.theta


def test_where_one_of_two_records_hardly_moves_the_other_is_diagnosed_alone(twin, loop):
    moves = moved(loop, twin, twin.q_ref[:, 0]).replace(name="moves")
    stands = moved(loop, twin, np.clip(0.1 * twin.t, 0.0, 0.04)).replace(name="stands")
    for record, holdout in ((moves, stands), (stands, moves)):
        found = iv.diagnose(record, loop, holdout=holdout)
        (text,) = [f.text for f in found.findings if "show motion to compare" in f.text]
        assert text.startswith("stands: ") and "moves is diagnosed alone" in text
        assert found.verdict == "adequate" and found.name == "moves"


def test_one_direction_is_enough_for_a_model_without_offset(twin, loop):
    q_ref = 0.02 * twin.t + 0.004 * np.sin(np.pi * twin.t)
    record, model = moved(loop, twin, q_ref), loop.with_terms("inertia", "viscous", "coulomb")
    (found,) = preflight.inspect(record, model, parity.check(record, model))
    assert "one direction only" in found.text and not found.fatal


@pytest.mark.parametrize("heights", [(0.0, 3e-3, 1e-3, 4e-3), (0.0, 2e-3, 4e-3, 6e-3)])
def test_steps_are_judged_by_their_way_and_by_the_motion_that_follows(twin, loop, heights):
    """They take one sample each, in either direction, and the axis moves after them."""
    step = SAMPLES // len(heights)
    slow = with_gains(loop, kp=5.0)  # 1/s
    record = moved(slow, twin, np.repeat(heights, step))
    assert preflight.one_way(record) == (min(np.diff(heights)) > 0.0)
    counts, q = usable(record, slow), record.q[:, 0]
    for k in range(2, len(heights)):  # after the first the initial state shows
        part = slice(k * step, (k + 1) * step)
        far = np.abs(q[part] - q[part][-1]) > 0.2 * abs(heights[k] - heights[k - 1])
        assert np.sum(far) > 200 and np.mean(counts[part][far]) > 0.9
        assert np.mean(counts[part]) < 0.7


# -- limits ----------------------------------------------------------------------------------------
def test_a_command_at_its_limit_is_said(twin, loop):
    limited = replace(loop, controller=replace(loop.controller, limit=1.5))
    text = refusal(moved(limited, twin, twin.q_ref), limited)
    assert "sits at its limit in" in text and "gentler references" in text


def test_a_limit_that_nobody_declared_is_named_where_nothing_can_be_simulated(twin, loop):
    """Where the command hardly ever leaves it, nothing controls the axis; the limit shows."""
    tight = replace(loop, controller=replace(loop.controller, limit=0.8))
    found = iv.diagnose(moved(tight, twin, twin.q_ref), loop)
    (text,) = [f.text for f in found.findings if f.fatal]
    assert "the command is cut at 0.8 in" in text and "[controller] limit" in text
    assert found.shrink is None and (found.verdict, found.block) == ("partial", "controller")
    assert found.parameters == {"saturation": {"limit": pytest.approx(0.8)}}
    assert effects_text(found) == ["saturation: limit 0.8 (98 % likely)"]
    assert "(nothing was simulated)" in found.summary()
    assert "closes by itself" not in found.summary()  # no table of nothing


def test_a_command_beyond_its_limit_is_said(record, loop):
    top = 0.6 * float(np.quantile(np.abs(record.nu), 0.999))
    low = replace(loop, controller=replace(loop.controller, limit=top))
    assert "correct [controller] limit" in refusal(record, low)


# -- hold-outs -------------------------------------------------------------------------------------
def test_a_holdout_that_is_the_record_is_said(record, loop):
    assert "holds the same samples" in refusal(record, loop, record.replace(name="copy"))


def test_a_holdout_that_overlaps_is_said(twin, loop):
    part = twin.slice(3000, None).replace(name="part")
    assert "part shares" in refusal(twin.slice(0, 6000), loop, part)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_nor_is_one_that_has_some_of_the_same_samples(twin, count):
    """At another rate, from wherever it begins; of another motion it has none."""
    for start in (3000, 3001, 3004):
        few = {k: x[start::count] for k, x in twin.signals.items()}
        part = iv.Record(twin.t[start::count], name="part", **few)
        for pair in ((twin, part), (part, twin)):
            assert ["holds the same" in f.text for f in preflight.overlap(*pair)] == [True]
            short = twin.slice(4000, 4000 + 400 * count)
            assert preflight.overlap(short, part) and preflight.overlap(part, short)
        other = part.replace(q=part.q[::-1], q_ref=part.q_ref[::-1], nu=part.nu[::-1])
        assert preflight.overlap(twin, other) == []


@pytest.mark.parametrize(
    "factor, signals, said",
    [(1e3, ("q", "q_ref"), "in mm"), (-1.0, ("nu",), "opposite sign")],
)
def test_a_holdout_in_other_units_is_named(twin, loop, factor, signals, said):
    other = moved(loop, twin, twin.q_ref)
    text = refusal(twin, loop, scaled(other, factor, *signals))
    assert text.startswith("other: ") and said in text


@pytest.mark.parametrize(("low", "high", "size"), [(8.0, 16.0, 7e-4), (16.0, 24.0, 4e-4)])
def test_a_link_that_swings_against_its_drive_is_no_other_axis(twin, loop, low, high, size):
    """Across its resonance it shows a negative inertia, and above that of the drive alone."""
    swing = {"frequency_hz": 14.0, "damping": 0.03, "load_share": 0.65, "load_friction": 0.3}
    soft, t = loop.with_effect(EFFECTS["flexibility"], **swing), twin.t - twin.t[0]
    slow = 0.08 * np.sin(2.0 * np.pi * 0.31 * t) + 0.03 * np.sin(2.0 * np.pi * 0.83 * t)
    sweep = np.sin(2.0 * np.pi * t * (low + (high - low) * t / (2.0 * t[-1])))
    fast = size * sweep * np.minimum(t, 1.0) + 0.04 * np.sin(2.0 * np.pi * 0.2 * t)
    theta = soft.values(THETA)
    pair = moved(soft, twin, slow, theta, "slow"), moved(soft, twin, fast, theta, "fast", 2)
    gap = iv.diagnose(pair[0], loop, pair[1])
    assert gap.effects == ("flexibility",) and not any(f.fatal for f in gap.findings)
    assert gap.parameters["flexibility"]["frequency_hz"] == pytest.approx(14.0, rel=0.2)


def test_a_holdout_of_another_axis_is_said(twin, loop):
    light = {"inertia": 40.0, "viscous": 50.0, "coulomb": 5.0, "offset": 1.0}
    text = refusal(twin, loop, moved(loop, twin, twin.q_ref, light))
    assert "different inertias" in text and "twin 95" in text and "other 40" in text
    slower = moved(with_gains(loop, kp=80.0), twin, twin.q_ref, light)
    assert "different inertias" in refusal(twin, loop, slower)


@pytest.mark.parametrize("force", [23.0, 26.0])
def test_an_axis_that_does_not_follow_its_reference_is_no_other_axis(twin, loop, force):
    """What it commands is far from what moves it, so its inertia says nothing."""
    free = replace(loop, controller=replace(loop.controller, limit=np.inf))
    weak = free.with_effect("inner-saturation", force=force)
    text = refusal(twin, free, moved(weak, twin, twin.q_ref))
    assert "does not follow its reference (other by" in text and "inertias" not in text


# -- what is no fault ------------------------------------------------------------------------------
@pytest.mark.parametrize("record", ["twin", "emps", "emps_pulses"], indirect=True)
def test_a_sound_record_has_no_finding(record, loop):
    assert preflight.inspect(record, loop, parity.check(record, loop)) == []


def test_two_records_of_one_axis_are_a_pair(emps, emps_pulses):
    assert preflight.overlap(emps, emps_pulses) == []


@pytest.mark.parametrize("joint, unit", [(j, u) for j, us in plausible._UNITS.items() for u in us])
def test_a_hint_knows_the_unit(twin, loop, joint, unit):
    """Of whatever is larger or smaller than the SI unit."""
    times = 1.0 / parse(unit).factor
    assert f"in {unit}" in plausible.looks_like(1.05 / times, joint, "q")
    axis, other = replace(loop, joint=joint), scaled(twin, times, "q", "q_ref")
    assert f"in {unit}" in plausible.wrong_unit(other, axis)


# -- a controller that is to be identified ---------------------------------------------------------
def test_an_identified_controller_says_nothing_of_itself(twin, loop):
    unknown = replace(loop, controller=Controller("identify", {}, limit=10.0))
    found = iv.diagnose(twin, unknown)
    assert found.effects == iv.diagnose(twin, loop).effects and found.shrink is not None
    (note,) = [f for f in found.findings if "identified" in f.text]
    assert not note.fatal and "cannot confirm it" in note.text
    assert found.parity[0].mismatch == {} and found.parity[0].before < 1e-6


@pytest.mark.parametrize("times", [1.5, 2.0])
def test_an_added_input_of_another_size_is_no_other_law(emps_pulses, loop, times):
    wrong = emps_pulses.replace(added=emps_pulses.added / times)
    shown = parity.check(wrong, loop)
    assert not preflight.inspect(wrong, loop, shown)
    for taken, what in ((True, "goes on with that"), (False, "that of the axis file is kept")):
        (found,) = preflight.other_law(shown, taken)
        assert f"the added input acts with {1.015 * times:.2g}" in found.text
        assert what in found.text and not found.fatal and "kind" not in found.text


def test_the_holdout_judges_an_identified_controller(twin, loop):
    unknown = replace(loop, controller=Controller("identify", {}, limit=10.0))
    other = moved(with_gains(loop, kp=80.0), twin, twin.q_ref)
    found = iv.diagnose(twin, unknown, other)
    text = " ".join(f.text for f in found.findings)
    assert "other: the record shows other controller settings" in text
    assert "controller-mismatch" in found.effects


# -- the command -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "change, said",
    [
        (lambda f: f.assign(q=f["q"].where(f.index != 57)), "q is NaN at row 57"),
        (lambda f: f.drop(columns="q"), "q"),
        (lambda f: f.drop(columns="q_ref"), "has no q_ref"),
        (lambda f: f.drop(columns="nu"), "nu and tau"),
        (lambda f: f[:150], "fewer than 200"),
        (lambda f: f.assign(q_ref=0.1), "q_ref is constant"),
    ],
)
def test_a_file_that_is_no_record_is_one_line(twin, tmp_path, capsys, change, said):
    file = tmp_path / "log.csv"
    change(twin.slice(0, 1000).to_frame()).to_csv(file, index=False)
    status = run(["diagnose", str(file), "--axis", "emps"])
    out, err = capsys.readouterr()
    assert (status, out, err.count("\n")) == (2, "", 1) and said in err


@pytest.mark.parametrize(("rest", "unit"), [(0.05, True), (0.3, False)])
def test_a_share_of_the_law_beside_much_else_is_no_unit(twin, loop, rest, unit):
    """Below an R2 of 0.98 what is beside the law is a remainder, and its factor says nothing."""
    size = rest * float(np.std(twin.nu))
    bent = twin.nu + size * np.sqrt(2.0) * np.sin(2.0 * np.pi * 3.1 * twin.t[:, None])
    record = twin.replace(nu=1000.0 * bent)
    wide = replace(loop, controller=replace(loop.controller, limit=np.inf))
    told = preflight.inspect(record, wide, parity.check(record, wide))
    assert any("as if nu were in mV" in f.text for f in told) == unit
