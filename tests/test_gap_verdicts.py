"""What a verdict rests on: changed settings, a third judge, a tolerance, a smaller force error."""

import json
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import signal

import ivtools as iv
from benchmarks import moves
from ivtools.errors import DataError, IVToolsError, RecordError
from ivtools.gap.attribute import Supposed
from ivtools.gap.attribute.kept import names_kept, outmatched
from ivtools.gap.attribute.rounds import pvalues
from ivtools.gap.discrepancy import Basis, Columns, Discrepancy, Laws, Spline, stands
from ivtools.gap.fit import Fit
from ivtools.gap.preflight import identifiable, overlap
from ivtools.gap.quantify import Shrink
from ivtools.gap.rules import Rules
from ivtools.gap.verdict import lowers, no_better, remainder
from ivtools.linalg.swing import Swing
from ivtools.physics import EFFECTS, Parameter, Term
from ivtools.plots.gap import gap as gap_figure
from ivtools.plots.gap import nameless, nameless_of

discrepancy = sys.modules["ivtools.gap.discrepancy.discrepancy"]
BASE = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
SECONDS = 16.0


def record(seed, loop=None, **base):
    """Return a record of the EMPS with other base parameters, in force noise of 0.6 N."""
    loop = loop or iv.axes.emps()
    return moves.record(loop, loop.values({**BASE, **base}), SECONDS, seed)


def hills(q, dq, ddq, sign, tau, t, size):
    """A bumpy track: a force over position that no effect of the library is."""
    return size * (np.sin(40.0 * q) * np.cos(17.0 * q + 1.0) + 0.6 * np.sin(71.0 * q))


HILLS = Term("hills", "mechanics", (Parameter("size", "{F}"),), "bumps", "a test", law=hills)


def test_names_must_lower_the_error_by_enough_to_be_worth_a_word():
    shrink = Shrink("N", 1.0, 0.9997, 1.0, (0.9, 1.1), 0.99, False, 1.0, (0.9, 1.1), 20.0, {})
    assert not lowers(shrink, simulated=True, removed=0.02)
    assert lowers(shrink, simulated=False, removed=0.02)
    assert lowers(shrink, simulated=True, removed=0.1)  # stands out of fast noise
    assert lowers(replace(shrink, after=0.99), simulated=True, removed=0.02)
    assert not lowers(replace(shrink, after=1.0), simulated=False, removed=0.02)


@pytest.mark.parametrize(("name", "value"), [("inertia", 112.0), ("coulomb", 15.0)])
def test_a_changed_setting_is_said_and_is_not_adequate(name, value):
    gap = iv.diagnose(record(1), iv.axes.emps(), record(2, **{name: value}))
    assert gap.verdict == "non-repeatable" and gap.effects == ()
    assert list(gap.changed) == [name]
    found = json.loads(json.dumps(gap.to_dict()))["changed"][name]
    assert found["record"] == pytest.approx(BASE[name], rel=0.03)
    assert found["holdout"] == pytest.approx(value, rel=0.03)
    assert f"non-repeatable (between the records, {name} changed)" in gap.summary()
    assert "a changed setting, not a missing effect" in " ".join(gap.summary().split())
    doubtful = replace(gap.changed[name], sure=False)
    assert "a changed setting, or the work of a missing effect" in doubtful.said(name)


def test_what_raises_the_error_has_no_small_p_value():
    """The t value is of the best multiple of an effect, which may be there and fitted wrongly."""
    shown = [SimpleNamespace(name=n, t=[50.0, 40.0], gain=g) for n, g in (("a", 0.2), ("b", -0.2))]
    first = SimpleNamespace(trials=shown, scores=[np.ones((2, 30))] * 2)
    assert pvalues(first) == {"a": 0.0, "b": 1.0}


@pytest.fixture(scope="module")
def judged():
    loop = iv.axes.emps().with_effect("asymmetric-viscous", delta=-40.0)
    one, two, three = (record(seed, loop) for seed in (3, 4, 5))
    return iv.diagnose(one, iv.axes.emps(), two, judge=three)


def test_a_third_record_judges_with_clean_figures(judged):
    shrink = judged.to_dict()["shrink"]
    third = shrink["judged"]
    assert third["before"] > 1.2 * third["after"]
    assert third["interval"][0] < third["after"] < third["interval"][1]
    assert third["after_frozen"] == pytest.approx(third["after"], rel=0.1)
    assert third["interval_frozen"][0] < third["after_frozen"] < third["interval_frozen"][1]
    assert shrink["after_frozen"] == pytest.approx(shrink["after"], rel=0.1)
    assert "which only judges" in judged.summary()


def test_a_judge_in_other_units_is_refused_by_its_name():
    one, two, three = (record(seed).replace(name=f"run {seed}") for seed in (3, 4, 5))
    wrong = three.replace(q=1e3 * three.q)
    gap = iv.diagnose(one, iv.axes.emps(), two, judge=wrong)
    (fault,) = [f for f in gap.findings if f.fatal]
    assert gap.shrink is None and fault.text.startswith("run 5: ")


def test_the_gap_is_said_in_newtons_and_per_cent_of_the_force(judged):
    gap = judged.to_dict()["gap"]
    assert gap["unit"] == "N" and gap["before"] == judged.shrink.before
    assert gap["percent_of_force"] == pytest.approx(100 * gap["before"] / judged.shrink.force)
    assert "% of the force" in judged.summary()


def test_a_judge_that_speaks_against_the_names_is_in_the_verdict(judged):
    assert "larger than before" not in judged.why
    much = 2.0 * judged.shrink.judged.before
    worse = replace(judged.shrink.judged, after=much, interval=(0.9 * much, 1.1 * much))
    against = replace(judged, shrink=replace(judged.shrink, judged=worse))
    assert f"on {worse.record}, which only judges, the error is larger than before" in against.why
    assert against.why in " ".join(against.summary().split())
    most = 2.0 * judged.shrink.before
    frozen = replace(judged.shrink, after_frozen=most, interval_frozen=(0.9 * most, 1.1 * most))
    handed = replace(judged, shrink=frozen)
    assert "base parameters the error is larger than before" in handed.why


def test_a_loop_that_diverges_as_declared_has_an_answer_all_the_same(tmp_path):
    loop = iv.axes.emps().with_effect("asymmetric-viscous", delta=-40.0)
    one, two = record(6, loop), record(7, loop)
    slow = replace(iv.axes.emps().controller, delay=9, limit=np.inf)
    gap = iv.diagnose(one, replace(iv.axes.emps(), controller=slow), two)
    assert gap.effects == ("asymmetric-viscous",) and gap.shrink.diverges
    assert gap.shrink.closed == 1.0 and "the simulation diverges" in gap.summary()
    json.dumps(gap.to_dict(), allow_nan=False)
    page = gap.to_html(tmp_path / "gap.html").read_text()
    assert "diverges → " in page and "with the controller put right" in page


def test_what_is_closed_is_said_of_names_only():
    """A record that judges itself tunes the model on its halves: that closes nothing."""
    loop = iv.axes.emps().with_effect(HILLS, size=6.0)
    gap = iv.diagnose(record(8, loop), iv.axes.emps())
    assert gap.effects == () and gap.shrink.after == gap.shrink.before


@pytest.mark.parametrize(("after", "word"), [(0.9999, "too little"), (1.2, "a rise")])
def test_names_that_fall_are_said_with_what_they_do(after, word):
    shrink = Shrink("N", 1.0, after, 1.0, (0.9, 1.1), 0.99, False, 1.0, (0.9, 1.1), 20.0, {})
    values = {"saturation": {"limit": 5.25}, "controller-mismatch": {"kp": 0.1}}
    said = no_better(["saturation", "controller-mismatch"], values, shrink).text
    assert word in said and "saturation (at 5.25), controller-mismatch in the model" in said


def test_a_force_that_has_a_suspect_is_not_said_to_come_from_outside():
    """Whether or not it is described: the ranking shows how far the suspect closes."""
    fit = SimpleNamespace(cost=5.0)
    fit.common = fit
    shrink = Shrink("N", 1.0, 1.0, 1.0, (0.9, 1.1), 0.2, False, 1.0, (0.9, 1.1), 20.0, {})
    found = SimpleNamespace(held=(fit, fit), supposed=None)
    assert "something outside may make it" in remainder(found, shrink, described=False).text
    assert remainder(found, shrink, described=True) is None
    found.supposed = Supposed("presliding", {}, 0.8)
    for described in (False, True):
        said = remainder(found, shrink, described).text
        assert said.startswith("presliding by itself removes 80 %") and "outside" not in said
    assert "stretches" not in said
    found.supposed = found.supposed._replace(eventful=True)
    assert "the stretches that stand out included" in remainder(found, shrink, False).text


def test_a_judge_takes_part_in_nothing():
    loop = iv.axes.emps()
    one, two = record(6, loop), record(7, loop)
    assert "holds the same samples" in iv.diagnose(one, loop, two, judge=two).summary()
    with pytest.raises(RecordError, match="leave it out with simulated"):
        iv.diagnose(one, loop, simulated=two, judge=two)


@pytest.mark.parametrize("tolerance", [-1.0, np.nan, np.inf])
def test_a_tolerance_is_a_number_from_0_on(tolerance):
    loop = iv.axes.emps()
    with pytest.raises(IVToolsError, match="give a number, 0 or more"):
        iv.diagnose(record(6, loop), loop, tolerance=tolerance)


def test_where_nothing_is_named_nothing_is_closed():
    loop = iv.axes.emps()
    gap = iv.diagnose(record(6, loop), loop, record(7, loop))
    assert gap.verdict == "adequate" and gap.shrink.after <= gap.shrink.before
    assert "closed" not in gap.summary() and "first record's base parameters" in gap.summary()


@pytest.mark.parametrize("turned", [False, True])
def test_a_limit_that_one_record_hardly_meets_is_judged_on_the_other(turned):
    loop = iv.axes.emps()
    theta = loop.values(BASE)
    fast, slow = record(31), moves.record(loop, theta, SECONDS, 32, (0.0, 0.004))
    limit = 1.02 * float(np.max(np.abs(slow.nu)))
    assert limit < 0.6 * float(np.max(np.abs(fast.nu)))
    limited = replace(loop, controller=replace(loop.controller, limit=limit))
    cut = moves.record(limited, theta, SECONDS, 31)
    pair = (slow, cut) if turned else (cut, slow)
    gap = iv.diagnose(pair[0], loop, pair[1])
    assert gap.effects == ("saturation",) and gap.verdict == "explained"
    assert gap.shrink.after < 0.8 * gap.shrink.before
    assert gap.parameters["saturation"]["limit"] == pytest.approx(limit, rel=1e-3)


@pytest.mark.parametrize("share", [0.5, 0.7, 0.85])
def test_what_a_limit_does_counts_where_the_command_is_at_it(share):
    loop = iv.axes.emps()
    theta = loop.values(BASE)
    limit = share * min(float(np.max(np.abs(record(seed).nu))) for seed in (31, 32))
    limited = replace(loop, controller=replace(loop.controller, limit=limit))
    one, two = (moves.record(limited, theta, SECONDS, seed) for seed in (31, 32))
    gap = iv.diagnose(one, loop, two)
    assert gap.effects == ("saturation",) and gap.replicas
    without = loop.gain * (two.nu - loop.simulate(two, theta).nu)[200:]
    assert gap.shrink.before == pytest.approx(float(np.sqrt(np.mean(without**2))), rel=0.15)
    assert gap.shrink.after < 0.5 * gap.shrink.before and gap.shrink.closed > 0.9
    third = moves.record(limited, theta, SECONDS, 33)
    judged = iv.diagnose(one, loop, two, judge=third).shrink.judged
    assert judged.before > 2.0 * judged.after


def test_of_one_record_the_limit_counts_in_the_half_that_judges():
    loop = iv.axes.emps()
    theta = loop.values(BASE)
    limit = 0.45 * float(np.max(np.abs(record(31).nu)))
    limited = replace(loop, controller=replace(loop.controller, limit=limit))
    one = moves.record(limited, theta, SECONDS, 31)
    gap = iv.diagnose(one, loop)
    assert gap.effects == ("saturation",)
    error = loop.gain * (one.nu - loop.simulate(one, theta).nu)[:, 0]
    half = gap.traces.keep
    assert 0.3 < np.mean(half) < 0.7 and np.any(np.abs(one.nu[half]) > 0.999 * limit)
    true = float(np.sqrt(np.mean(error[half] ** 2)))
    assert gap.shrink.before == pytest.approx(true, rel=0.15)


def test_a_gap_below_the_tolerance_is_negligible_in_words():
    loop = iv.axes.emps().with_effect("asymmetric-viscous", delta=-40.0)
    one, two = record(6, loop), record(7, loop)
    assert "negligible" not in iv.diagnose(one, iv.axes.emps(), two).summary()
    wide = iv.diagnose(one, iv.axes.emps(), two, tolerance=50.0)
    assert "negligible" in wide.summary() and wide.effects == ("asymmetric-viscous",)


@pytest.mark.parametrize(
    ("verdict", "held_out", "said"),
    [
        ("adequate", True, "gap: negligible"),
        ("unexplained", True, "gap: on the hold-out negligible"),
        ("unexplained", False, "gap: negligible"),
        ("non-repeatable", True, "gap: but for stretches that stand out, negligible"),
    ],
)
def test_a_gap_that_only_the_other_record_has_is_negligible_on_the_holdout(verdict, held_out, said):
    loop = iv.axes.emps()
    gap = iv.diagnose(record(6, loop), loop, record(7, loop))
    shrink = replace(gap.shrink, held_out=held_out)
    assert said in replace(gap, verdict=verdict, shrink=shrink).summary()


@pytest.fixture(scope="module")
def hilly():
    loop = iv.axes.emps().with_effect(HILLS, size=6.0)
    return iv.diagnose(record(8, loop), iv.axes.emps(), record(9, loop))


def test_what_has_no_name_is_described(hilly):
    left = hilly.to_dict()["discrepancy"]
    assert hilly.effects == () and left is not None
    assert left["over"][0] == "q" and left["repeats"] and left["unit"] == "N"
    assert 1.5 < left["rms"] < 6.0
    assert hilly.verdict == "unexplained" and "left: a force of" in hilly.summary()
    assert "left:" not in replace(hilly, verdict="adequate").summary()  # it lacks next to nothing


def hump(q, dq, ddq, sign, tau, t, size):
    """A hump on the way, wider than the knots of a spline over position are apart."""
    return size * np.exp(-(((q - 0.1) / 0.03) ** 2))


HUMP = Term("hump", "mechanics", (Parameter("size", "{F}"),), "a hump", "a test", law=hump)


def test_what_any_law_would_leave_is_the_noise_where_the_force_is_smooth():
    loop = iv.axes.emps().with_effect(HUMP, size=5.0)
    gap = iv.diagnose(record(8, loop), iv.axes.emps(), record(9, loop))
    left, judged = gap.to_dict()["discrepancy"], gap.traces.record
    true = loop.simulate(judged, loop.values({**BASE, "hump.size": 5.0}))
    noise = (loop.force(judged) - loop.gain * true.nu)[gap.traces.keep]
    least = float(np.sqrt(np.mean(noise**2)))
    assert left["before"] == pytest.approx(gap.shrink.after, rel=0.02)  # where both have been
    assert left["after"] < 0.2 * gap.shrink.after
    assert left["after"] == pytest.approx(least, rel=0.1)
    assert left["after"] < 1.2 * gap.shrink.floor
    told = f"smooth static law would leave about {left['after']:.2g} of {left['before']:.2g} N rms"
    assert told in " ".join(gap.summary().split())


def test_what_is_finer_than_the_knots_of_a_law_is_left(hilly):
    left = hilly.discrepancy
    assert 1.5 * hilly.shrink.floor < left.after < 0.2 * left.before


def test_with_nothing_left_there_is_no_force_without_a_name():
    gap = iv.diagnose(record(1), iv.axes.emps(), record(2))
    assert gap.discrepancy is None and gap.to_dict()["discrepancy"] is None
    assert "What has no name" not in gap.page().html() and nameless_of(gap) == ()
    with pytest.raises(DataError, match="no force without a name"):
        nameless(gap)


def test_the_curve_of_a_force_without_a_name_is_drawn_with_its_units(hilly):
    (axes,) = nameless(hilly).axes
    forwards, backwards = axes.get_lines()[:2]
    assert [forwards.get_label(), backwards.get_label()] == ["forwards", "backwards"]
    assert axes.get_xlabel() == "position, m" and axes.get_ylabel().endswith(", N")
    x = np.array(hilly.discrepancy.curve)[:, 0]
    true = np.interp(x, x, hills(x, *[None] * 5, size=6.0))
    assert np.corrcoef(forwards.get_ydata(), true)[0, 1] > 0.9
    small = replace(
        hilly.discrepancy, curve=((1e-3, 2e-3, -1e-3), (4e-3, 5e-3, -2e-3)), period=5e-3
    )
    (axes,) = nameless(replace(hilly, discrepancy=small)).axes
    assert axes.get_xlabel() == "position within a period, mm"
    assert axes.get_ylabel() == "force without a name, mN"
    assert nameless_of(replace(hilly, discrepancy=replace(small, curve=()))) == ()
    page = hilly.page()
    section = next(s for s in page.sections if s.title == "What has no name")
    assert [f.name for f in section.figures] == ["nameless"]
    assert len(gap_figure(hilly).axes) == 5


@pytest.mark.parametrize(
    ("over", "signals", "said"),
    [
        (("q",), ("q",), "position and direction"),
        (("state", "q"), ("q", "dq"), "position and speed together, and direction"),
        (("gain", "drive"), ("load", "q", "dq", "drive"),
         "load times position or speed and the force of the drive"),
        (("warm", "heat"), ("dq", "past"), "how much moved before"),
        (("past", "swing", "load", "wave", "q"), ("past", "ddq", "load", "q", "dq"),
         "the motion before, the swing of a load, load and others"),
    ],
)  # fmt: skip
def test_at_most_three_signals_of_a_force_without_a_name_are_told(over, signals, said):
    found = Discrepancy(1.9e-3, "N", over, 0.5, 2.5e-3, 0.9e-3, ())
    assert found.signals == signals and found.to_dict()["over"] == list(signals)
    kind = "smooth law with a memory" if "past" in signals else "smooth static law"
    assert found.text == (
        f"a force of 1.9 mN rms repeats over {said} and is not among the known effects; "
        f"a {kind} would leave about 0.9 of 2.5 mN rms"
    )
    assert replace(found, after=2.6e-3).leaves == "all of 2.5 mN rms"
    hardly = Discrepancy(1.9e-3, "N", over, 0.5, 2.5e-3, 2.49e-3, ())
    assert hardly.text.endswith("would leave nearly all of 2.5 mN rms")


def frayed(q, dq, ddq, sign, tau, t, size):
    """A way that is worn beyond two thirds of the stroke: bumps, and only there."""
    return size * np.sin(900.0 * q) * sign * (q > 0.16)


FRAYED = Term("frayed", "mechanics", (Parameter("size", "{F}"),), "worn end", "a test", law=frayed)


def test_a_gap_that_only_one_record_can_show_is_no_force_from_outside():
    loop = iv.axes.emps().with_effect(FRAYED, size=6.0)
    theta = loop.values(BASE)
    far, near = (moves.record(loop, theta, SECONDS, 30, (0.0, end)) for end in (0.24, 0.15))
    gap = iv.diagnose(far, iv.axes.emps(), near)
    assert gap.effects == () and gap.verdict == "unexplained"
    assert "only one of the records covers" in " ".join(gap.summary().split())
    assert gap.block != "outside"


def test_a_curve_is_of_what_the_base_model_has_not(hilly):
    """A law has friction and offset as well, of any size that the base model takes back."""
    left = hilly.discrepancy
    ways = np.array(left.curve)[:, 1:]
    assert 0.3 * left.rms < np.sqrt(np.mean(ways**2)) < 2.0 * left.rms
    one = iv.datasets.twin()
    run = iv.axes.emps().simulate(one, BASE)
    fold = SimpleNamespace(keep=np.ones(one.n_samples, bool), record=one)
    dq = run.dq[:, 0]
    force = 100.0 * np.sign(dq) + 30.0 * dq - 5.0
    assert np.max(np.abs(discrepancy._beyond(force, SimpleNamespace(fold=fold), run))) < 1e-6


def test_a_curve_needs_both_directions():
    """A spindle that turns one way only has none; standing is no direction."""
    rng = np.random.default_rng(1)
    grid, x, force = np.linspace(0.0, 1.0, 5), rng.uniform(0.0, 1.0, 200), rng.normal(size=200)
    one_way = np.where(np.arange(200) < 20, 0.0, 1.0)
    assert discrepancy._means(grid, x, one_way, force) == ()
    assert len(discrepancy._means(grid, x, one_way - 0.5, force)) == 5


def worn(q, dq, ddq, sign, tau, t, size):
    """Friction that is periodic over position: no effect of the library is."""
    return size * np.cos(2.0 * np.pi * q / 0.007) * sign


WORN = Term("worn", "mechanics", (Parameter("size", "{F}"),), "worn spots", "a test", law=worn)


def test_periodic_friction_is_not_taken_for_cogging():
    loop = iv.axes.emps().with_effect(WORN, size=2.5)
    records = record(10, loop), record(11, loop)
    gap = iv.diagnose(records[0], iv.axes.emps(), records[1])
    assert gap.effects == ()
    assert gap.discrepancy.over[0] == "wave"
    assert gap.discrepancy.period == pytest.approx(0.007, rel=1e-2)
    x, forwards, backwards = np.array(gap.discrepancy.curve).T
    assert np.corrcoef(forwards, np.cos(2.0 * np.pi * x / 0.007))[0, 1] > 0.9
    assert np.corrcoef(forwards, backwards)[0, 1] < -0.9
    found = iv.diagnose(records[0], iv.axes.emps(), records[1], extra=(WORN,))
    assert found.effects == ("worn",)  # it is there to be seen


def uneven(q, dq, ddq, sign, tau, t, size):
    """A drive whose gain depends on the position."""
    return -size * tau * np.sin(25.0 * q)


UNEVEN = Term("uneven", "drive", (Parameter("size", "1"),), "a drive's gain", "a test", law=uneven)


def test_a_drive_gain_over_position_is_described_and_not_named():
    loop = iv.axes.emps().with_effect(UNEVEN, size=0.08)
    gap = iv.diagnose(record(16, loop), iv.axes.emps(), record(17, loop))
    assert gap.effects == () and gap.verdict == "unexplained"
    assert "gain" in gap.discrepancy.over and "load times position or speed" in gap.summary()


@pytest.mark.parametrize("force", [3.0, 6.0])
def test_a_law_of_the_drive_is_described_and_not_named(force):
    """A dead zone looks like regularised friction where the drive turns with the velocity."""
    loop = iv.axes.emps().with_effect("dead-zone", force=force)
    one, two = record(16, loop), record(17, loop)
    gap = iv.diagnose(one, iv.axes.emps(), two, without=("dead-zone",))
    assert gap.effects == () and gap.verdict == "unexplained"
    assert gap.discrepancy.over[0] == "drive" and "the force of the drive" in gap.summary()
    assert iv.diagnose(one, iv.axes.emps(), two).effects == ("dead-zone",)


def moved_by(seed, force_of):
    """Return a record with a force of the run without it; N of its velocity, acceleration, step."""
    loop, plain = iv.axes.emps(), record(seed)
    alone = loop.simulate(plain, BASE)
    force = force_of(alone.dq[:, 0], alone.ddq[:, 0], plain.dt)
    noise = np.random.default_rng(seed).normal(size=plain.n_samples)
    run = loop.simulate(plain, BASE, force_noise=force + 0.6 * noise)
    return iv.Record(plain.t, q=run.q, q_ref=plain.q_ref, nu=run.nu)


def belted(dq, ddq, dt):
    """A force that a move leaves behind and that fades within 0.5 s."""
    a = np.exp(-dt / 0.5)
    return -40.0 * signal.lfilter([1.0 - a], [1.0, -a], dq)


def test_a_force_with_a_memory_is_described_and_not_adequate():
    gap = iv.diagnose(moved_by(12, belted), iv.axes.emps(), moved_by(13, belted))
    assert gap.effects == () and gap.verdict == "unexplained"
    assert gap.discrepancy.over[0] == "past" and "the motion before" in gap.summary()


def carrying(dq, ddq, dt):
    """What a load does that hangs from the axis and swings at 0.9 Hz."""
    return 2000.0 * Swing(0.9, 0.01).of(ddq, dt)[:, 1]


def test_a_load_that_hangs_from_the_axis_is_no_noise():
    gap = iv.diagnose(moved_by(14, carrying), iv.axes.emps(), moved_by(15, carrying))
    assert gap.effects == () and gap.verdict == "unexplained"
    assert gap.discrepancy.over[0] == "swing" and "the swing of a load" in gap.summary()
    assert gap.shrink.floor < 0.5 * gap.shrink.before


def worn_in(before):
    """Friction that falls with what the axis did in the last 3 s, which `before` had begun."""

    def force(dq, ddq, dt):
        a = np.exp(-dt / 3.0)
        heat = signal.lfilter([1.0 - a], [1.0, -a], np.abs(dq) / 0.4, zi=[a * before])[0]
        return 10.0 * heat * np.sign(dq)

    return force


@pytest.mark.parametrize("starts", [(0.0, 0.5), (0.5, 0.0)])
def test_friction_that_was_warm_before_the_record_is_described_and_not_named(starts):
    one, two = (moved_by(18 + k, worn_in(before)) for k, before in enumerate(starts))
    gap = iv.diagnose(one, iv.axes.emps(), two)
    assert gap.effects == () and gap.discrepancy.over[0] == "warm"
    assert "how much moved before" in gap.summary()


NOISE, SHAPE = np.random.default_rng(2).normal(size=2000), np.sin(np.arange(2000) / 7.0)


def left(size, shape=SHAPE):
    """Return a stand-in of a fit that leaves so much of a shape in noise."""
    e = NOISE + size * shape
    sums = SimpleNamespace(block_sums=lambda x: x.reshape(40, 50).sum(axis=1))
    basis = np.full((2000, 1), 2000**-0.5)
    return Leaves(e, basis, fold=sums, cost=float(np.mean(e**2)))


class Leaves(SimpleNamespace):
    """A stand-in of a fit that a weak reference can hold; alone it has no base parameters."""

    __hash__ = object.__hash__
    beyond_base = Fit.beyond_base

    def __init__(self, e, basis=None, **more):
        super().__init__(e=e, basis=np.zeros((len(e), 0)) if basis is None else basis, **more)


def spline(size, over=("q", "past"), shape=SHAPE):
    """Return a force without a name that leaves so much of it."""
    return Spline(over, 0.0, (NOISE + size * shape,))


def test_a_name_falls_where_a_force_without_one_explains_more():
    base, rules, gone = (left(3.0),), Rules(), (spline(0.0), spline(0.0))
    assert outmatched(base, (left(1.7),), *gone, rules)
    assert not outmatched(base, (left(0.5),), *gone, rules)  # equivalent
    assert outmatched(base, (left(0.5),), spline(0.0, ("q",)), spline(0.0), rules)  # one law is
    assert not outmatched(base, (left(1.7),), spline(0.8), spline(0.0), rules)  # both are there
    few = np.where(np.arange(2000) < 300, SHAPE, 0.0)  # in six blocks only
    assert not outmatched((left(3.0, few),), (left(2.0, few),), *gone, rules)
    assert outmatched((left(9.0, few),), (left(6.0, few),), *gone, rules)  # most of it


def test_a_name_that_spares_a_force_without_one_a_signal_may_fall_a_little_short():
    base, held, three = (left(3.0),), (left(1.7),), ("q", "past", "dq")
    plain = spline(0.0, three)
    assert outmatched(base, held, plain, spline(0.0, three), Rules())
    assert not outmatched(base, held, plain, spline(0.5), Rules())
    assert outmatched(base, held, plain, spline(1.2), Rules())  # more than a little
    assert outmatched(base, held, spline(0.0), spline(0.5, ("q",)), Rules())  # two are few


@pytest.mark.parametrize("seed", range(20))
def test_an_effect_stands_beside_a_force_without_a_name_that_only_resembles_it(seed):
    """Both folds of random laws: one effect is there beside the law, another is near the law."""
    rng = np.random.default_rng(seed)
    folds = []
    for _ in (0, 1):
        law = rng.normal(size=(2000, 6))
        force = law @ rng.normal(size=6)
        true, like = rng.normal(size=2000), force + 0.5 * rng.normal(size=2000)
        folds.append((law, true, like, force + true * rng.uniform(0.5, 2.0)))

    def rest(errors):
        both = zip(errors, folds, strict=True)
        return [e - law @ np.linalg.lstsq(law, e, rcond=None)[0] for e, (law, *_) in both]

    def fits(*errors):
        return [Leaves(e) for e in errors]

    laws = SimpleNamespace(fitted=lambda fits: Spline(("q",), 0.0, (), rest=rest))
    before = fits(*(e for *_, e in folds))
    names = {}
    for name, change in {"true": [f[1] for f in folds], "like": [f[2] for f in folds]}.items():
        amplitude = [x @ f.e / (x @ x) for x, f in zip(change, before, strict=True)]
        held = fits(*(f.e - a * x for f, a, x in zip(before, amplitude, change, strict=True)))
        names[name] = stands(before, held, laws)
    assert names == {"true": True, "like": False}


@pytest.mark.parametrize(
    ("effect", "most", "names"),
    [("friction-drift", "q", 0), ("cogging", "q", 1), ("cogging", "heat", 0)],
)
def test_an_effect_of_time_or_use_falls_where_friction_that_remembers_use_does_better(
    effect, most, names, monkeypatch
):
    base, held = (left(3.0),), (left(0.9),)
    law, both = spline(0.6, (most,)), spline(0.2)
    laws = SimpleNamespace(fitted=lambda f: law if f is base else both, of_use=lambda f: law)
    monkeypatch.setattr(Laws, "of", lambda fits: laws)
    term = EFFECTS[effect]
    trial = SimpleNamespace(term=term, name=effect, unlike=0.9)  # no law of the state could have it
    assert names_kept([base, held], laws, [(trial,)], Rules())[:2] == (names, names)
    timed = trial.term.of_time  # with nothing left there is no law to see it by
    found = names_kept([base, held], None, [(trial,)], Rules())[:2]
    assert found == ((0, 0) if timed else (1, 1))


@pytest.mark.parametrize(
    ("effect", "over", "first", "even", "kept"),
    [
        ("position-friction", ("q",), 1.0, 0.01, True),
        ("position-friction", ("q",), 1.0, 0.2, False),  # a force by direction
        ("position-friction", ("q", "past"), 0.97, 0.01, True),  # and little else
        ("position-friction", ("q", "past"), 0.8, 0.01, False),
        ("position-friction", ("dq",), 1.0, 0.01, False),
        ("load-friction", ("q",), 1.0, 0.01, False),
    ],
)
def test_friction_over_position_is_not_outdone_by_its_own_curve(
    effect, over, first, even, kept, monkeypatch
):
    base, held = (left(3.0),), (left(0.9),)
    law, both = replace(spline(0.6, over), even=lambda: even, first=first), spline(0.7, ("q",))
    laws = SimpleNamespace(fitted=lambda f: law if f is base else both)
    monkeypatch.setattr(Laws, "of", lambda fits: laws)
    term = EFFECTS[effect]
    trial = SimpleNamespace(term=term, name=effect, unlike=0.0, stands=lambda laws: False)
    told = names_kept([base, held], laws, [(trial,)], Rules())
    assert (told.unsurpassed, told.certain) == ((1, {effect}) if kept else (0, set()))
    told = names_kept([base, held], laws, [(trial,)], Rules(), effect)  # by a further sensor
    assert told == (1, 1, {effect})


@pytest.mark.parametrize("use", [2.0, 0.6])
def test_an_effect_of_time_that_beats_use_is_held_against_the_other_laws(use, monkeypatch):
    """Of them none has much; use and the force of the drive together would do better."""
    base, held = (left(3.0),), (left(0.9),)
    law, plain, both = spline(0.5, ("heat", "drive")), spline(2.8, ("dq",)), spline(0.9)
    others = SimpleNamespace(fitted=lambda f: plain if f is base else both)
    laws = SimpleNamespace(
        fitted=lambda f: law if f is base else both,
        of_use=lambda f: spline(use),
        without_use=others,
    )
    monkeypatch.setattr(Laws, "of", lambda fits: laws)
    term = EFFECTS["friction-drift"]
    trial = SimpleNamespace(term=term, name=term.name, unlike=0.0, stands=lambda laws: False)
    told = names_kept([base, held], laws, [(trial,)], Rules())
    assert told[:2] == ((1, 1) if use > 0.9 else (0, 0))


@pytest.mark.parametrize(("use", "names"), [(1.2, 2), (0.3, 0)])
def test_what_changes_with_use_may_be_a_drift_that_gets_the_second_name(use, names, monkeypatch):
    """Beside the first one friction that warms up is what is left, unless it is the drift."""
    models = [(left(3.0),), (left(1.5),), (left(0.8),)]
    law, others = spline(1.3, ("heat",)), spline(2.8, ("dq",))
    rest = SimpleNamespace(fitted=lambda f: others if f is models[0] else spline(0.8))
    laws = SimpleNamespace(
        fitted=lambda f: law if f is models[0] else spline(0.8),
        of_use=lambda f: spline(1.3 if f is models[0] else use),
        without_use=rest,
    )
    monkeypatch.setattr(Laws, "of", lambda fits: laws)
    pair = [
        SimpleNamespace(term=EFFECTS[n], name=n, unlike=0.0, stands=lambda laws: False)
        for n in ("spring", "friction-drift")
    ]
    assert names_kept(models, laws, [(t,) for t in pair], Rules())[:2] == (names, names)


def test_forces_that_remember_have_one_unit_on_every_fold():
    run = iv.axes.emps().simulate(iv.datasets.twin(), BASE)
    slow = SimpleNamespace(where=run.where, dq=0.5 * run.dq, tau=0.5 * run.tau, t=run.t)
    basis = Basis.of([run, slow])
    fast, half = basis.parts(run), basis.parts(slow)
    np.testing.assert_allclose(half["heat"][:, 0], 0.5 * fast["heat"][:, 0])
    np.testing.assert_allclose(half["gain"][:, 0], 0.5 * fast["gain"][:, 0])


def test_hat_functions_add_up_to_one():
    run = iv.axes.emps().simulate(iv.datasets.twin(), BASE)
    basis = Basis.of([run])
    assert np.allclose(basis.hats("q", run.q[:, 0]).sum(axis=1), 1.0)
    for name, columns in basis.parts(run).items():
        assert np.isfinite(basis.penalty(name, columns.shape[1])).all()


def test_columns_that_the_base_model_has_as_well_say_nothing():
    rng = np.random.default_rng(0)
    J, own = rng.normal(size=(500, 3)), rng.normal(size=(500, 4))
    doubled = np.column_stack([J @ rng.normal(size=(3, 20)), np.zeros(500), own])
    Q = np.linalg.qr(J)[0]
    columns = Columns(SimpleNamespace(basis=Q), doubled)
    x = rng.normal(size=(500, 2))
    x -= Q @ (Q.T @ x)
    whole = np.column_stack([J, own])
    expected = x - whole @ np.linalg.lstsq(whole, x, rcond=None)[0]
    np.testing.assert_allclose(columns.left(x), expected, atol=1e-12)


def test_standing_still_with_a_coarse_encoder_is_not_the_same_record():
    t = np.arange(8000) * 1e-3
    rest = np.where((t % 2.0) < 1.0, 0.0, np.sin(np.pi * (t % 2.0)))
    noise = np.random.default_rng(0)
    one, two = (
        iv.Record(t, q=1e-3 * np.round(100 * rest), q_ref=0.1 * rest, nu=n)
        for n in (np.where(rest == 0.0, 0.0, noise.normal(size=8000)) for _ in (0, 1))
    )
    assert overlap(one, two) == overlap(two, one) == []
    assert overlap(one, one)[0].fatal


def test_one_direction_of_motion_leaves_one_friction():
    t = np.arange(8000) * 1e-3
    there = iv.Record(t, q=t, q_ref=t, nu=np.sin(t))
    assert "offset" not in identifiable([there], iv.axes.emps()).names
    back = iv.Record(t, q=np.sin(t), q_ref=np.sin(t), nu=np.sin(t))
    assert identifiable([back], iv.axes.emps()).names == iv.axes.emps().names


def test_friction_that_remembers_use_is_a_law_of_its_own():
    assert Spline(("warm", "dq"), 0.1, ()).of_use and Spline(("heat",), 0.1, ()).of_use
    assert not Spline(("dq", "heat"), 0.1, ()).of_use and not Spline((), 0.0, ()).of_use
    timed = {name for name, term in EFFECTS.items() if term.of_time}
    assert timed == {"friction-drift", "offset-drift"}
