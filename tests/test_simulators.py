"""A user's own simulator: what it lacks is found, and written back into it."""

from dataclasses import replace

import numpy as np
import pytest

import ivtools as iv
from ivtools.errors import DataError, IVToolsError, RecordError
from ivtools.gap.simulator import confirm
from ivtools.simulators.difference import difference, homed, together

THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}


@pytest.fixture(scope="module")
def loop() -> iv.ClosedLoop:
    return iv.axes.emps()


@pytest.fixture(scope="module")
def short(twin) -> iv.Record:
    return twin.slice(0, 12_000)


def log(loop, record, noise=0.0, **theta) -> iv.Record:
    """The loop along a record's reference, as if it had been logged."""
    rng = np.random.default_rng(5)
    done = loop.simulate(
        record,
        {**THETA, **theta},
        position_noise=1e-7 * rng.normal(size=record.n_samples) * (noise > 0.0),
        force_noise=noise * rng.normal(size=record.n_samples),
    )
    return done.to_record("log", q_ref=record.q_ref)


def test_the_difference_of_a_log_to_itself_is_the_model(loop, short):
    sim = log(loop, short)
    found = difference(sim, sim, loop)
    model = loop.simulate(sim, found.base.params.to_dict())
    assert np.allclose(found.record.q, model.q, atol=1e-12)
    assert np.allclose(found.record.nu, model.nu, atol=1e-9)
    assert found.base.params["inertia"] == pytest.approx(95.0, rel=2e-3)


def test_a_simulator_that_is_the_axis_lacks_nothing(loop, short):
    real = log(loop, short, noise=1.0)
    gap = iv.diagnose(real, loop, simulated=log(loop, short))
    assert gap.verdict == "adequate" and gap.effects == () and gap.surplus == ()
    for name, change in gap.changes.items():
        assert abs(change.change) < 4.0 * change.std_error + 1e-3 * abs(change.real), name


def test_intervals_of_changes_hold_what_was_changed(loop, short):
    real = log(loop, short, noise=1.0)
    gap = iv.diagnose(real, loop, simulated=log(loop, short, inertia=90.0, viscous=220.0))
    assert gap.effects == ()
    for name, true in {"inertia": 5.0, "viscous": -20.0, "coulomb": 0.0, "offset": 0.0}.items():
        change = gap.changes[name]
        assert change.interval[0] < true < change.interval[1], name
        reach = change.interval[1] - change.change
        assert 1.96 * change.std_error < reach < 2.3 * change.std_error
    assert gap.to_dict()["changes"]["inertia"]["interval"] == list(gap.changes["inertia"].interval)


def test_a_spring_by_a_pendulum_over_a_short_arc_is_said_by_both_names(loop, short):
    hinge = replace(loop, joint="revolute").with_terms(*(t.name for t in loop.terms), "gravity")
    weight = {"gravity.sin": 400.0, "gravity.cos": 0.0}
    axis = hinge.with_effect("spring", stiffness=150.0, curvature=0.0)
    real = log(axis, short, noise=1.0, **weight)
    gap = iv.diagnose(real, hinge, simulated=log(hinge, short, **weight))
    assert gap.effects == () and gap.ambiguous_with["gravity"] == ["spring"]
    assert gap.changes["gravity.sin"].change == pytest.approx(150.0, rel=0.05)
    (said,) = [text for text in gap.advice if text.startswith("gravity changes, or")]
    assert "spring (stiffness 15" in said and "the records cannot tell" in said
    alone = iv.diagnose(log(hinge, short, noise=1.0, **weight), hinge, simulated=log(hinge, short))
    assert "gravity changes, or your simulator lacks spring" in " ".join(alone.advice)


def test_an_effect_that_only_the_axis_has_is_named(loop, short):
    axis = loop.with_effect("cogging", cosine=2.5, sine=1.0, period=0.004)
    real = log(axis, short, noise=1.0)
    gap = iv.diagnose(real, loop, simulated=log(loop, short, inertia=90.0))
    assert gap.effects == ("cogging",) and not gap.surplus
    change = gap.changes["inertia"]
    assert change.change == pytest.approx(5.0, abs=0.5)
    assert change.simulator == pytest.approx(90.0, rel=0.01)
    content = gap.to_dict()
    assert content["changes"]["cogging.period"]["real"] == pytest.approx(0.004, rel=1e-2)
    assert "your simulator lacks: cogging" in content["advice"]


def test_a_load_that_swings_in_both_hides_nothing(loop, short):
    """A pendulum under the cart: to the model a soft second mass, and no change of its own."""
    load = {"frequency_hz": 1.7, "damping": 0.02, "load_share": 0.15, "load_friction": 0.0}
    both = loop.with_effect("flexibility", **load)
    axis = both.with_effect("asymmetric-viscous", delta=-30.0)
    given = {f"flexibility.{name}": value for name, value in load.items()}
    real = log(axis, short, noise=1.0, **given)
    gap = iv.diagnose(real, loop, simulated=log(both, short, inertia=90.0, **given))
    assert gap.effects == ("asymmetric-viscous",)
    assert not any(name.startswith("flexibility") for name in gap.changes)
    low, high = gap.changes["inertia"].interval
    assert low < 5.0 < high and high - low < 2.0
    assert any("a load swings at 1.7 Hz in your simulator" in text for text in gap.advice)


def test_an_effect_that_only_the_simulator_has_is_called_that(loop, short):
    much = loop.with_effect("stribeck", force=12.0, speed=0.02)
    gap = iv.diagnose(log(loop, short, noise=0.5), loop, simulated=log(much, short))
    assert gap.effects == gap.surplus == ("stribeck",)
    change = gap.changes["stribeck.force"]
    assert change.real == 0.0 and change.simulator > 0.0 and change.change < 0.0


def test_logs_of_another_rate_and_length_are_brought_together(loop, short):
    real, sim = short.slice(0, 9000), log(loop, short).slice(0, 11_000)
    own = {"q": sim.q[::2], "nu": sim.nu[::2], "q_ref": sim.q_ref[::2]}
    thin = iv.Record(t=sim.t[::2], **own, extra={"load_q": sim.q[::2, 0]})
    one, two, notes = together(real, thin)
    assert one.n_samples == two.n_samples == 9000 and len(notes) == 1
    assert np.allclose(two.q, sim.q[:9000], atol=1e-5)
    assert np.allclose(two.extra["load_q"], two.q[:, 0])  # a law may look at further columns
    assert "was brought to the record's instants" in notes[0]


@pytest.mark.parametrize(
    "own, added",
    [
        ({}, 0.0),
        ({"feedforward": {"acceleration": 2.0, "velocity": 5.0, "coulomb": 0.5}}, 0.0),
        ({"feedforward": {"gravity": 1.0}}, 0.0),
        ({"limit": 0.6}, 0.0),
        ({"delay": 3}, 0.0),
        ({}, 1.5),
    ],
    ids=["law", "feed-forward", "constant", "limit", "delay", "added"],
)
@pytest.mark.parametrize("away", [2e-3, 2e-5, 0.0])
def test_a_position_counted_from_elsewhere_is_told_by_all_that_the_law_sees(
    loop, short, own, added, away
):
    axis = replace(loop, controller=replace(loop.controller, **own))
    pulses = added * np.sign(np.sin(3.0 * short.t))
    done = axis.simulate(short.replace(added=pulses), THETA)
    sim = done.to_record("log", q_ref=short.q_ref, added=pulses)
    home, notes = homed(sim, sim.replace(q=sim.q + away), axis)
    assert np.allclose(home.q, sim.q, atol=1e-9) and len(notes) == (away > 0.0)


@pytest.mark.parametrize("factor, unit", [(1e3, "mm"), (180 / np.pi, "degrees"), (1e-3, "km")])
def test_another_unit_is_said(short, factor, unit):
    other = short.replace(q_ref=factor * short.q_ref)
    with pytest.raises(RecordError, match=unit):
        together(short, other)


def test_another_reference_is_refused(short):
    with pytest.raises(RecordError, match="another reference"):
        together(short, short.replace(q_ref=short.q_ref[::-1]))


def test_too_little_in_common_is_refused(short):
    with pytest.raises(RecordError, match="simulate the whole record"):
        together(short, short.slice(0, 100 + 200))


def every(record, step) -> iv.Record:
    parts = {name: x[::step] for name, x in record.signals.items()}
    return iv.Record(t=record.t[::step], **parts, name=record.name)


def late(record, start) -> iv.Record:
    parts = {name: x[start:] for name, x in record.signals.items()}
    return iv.Record(t=record.t[: len(record.t) - start], **parts, name=record.name)


def elsewhere(loop, record) -> iv.Record:
    return log(loop, record.replace(q=np.r_[record.q[:1] + 5e-4, record.q[1:]]), inertia=90.0)


HANDLED = {
    "half the rate": lambda loop, sim: every(sim, 2),
    "longer": lambda loop, sim: sim,
    "shorter": lambda loop, sim: sim.slice(0, 7000),
    "another clock": lambda loop, sim: iv.Record(t=sim.t + 100.0, **sim.signals),
    "no reference": lambda loop, sim: iv.Record(t=sim.t, q=sim.q, nu=sim.nu),
    "a force": lambda loop, sim: iv.Record(t=sim.t, q=sim.q, q_ref=sim.q_ref, tau=35.15 * sim.nu),
    "counted from elsewhere": lambda loop, sim: sim.replace(q=sim.q + 2e-3),
    "starts elsewhere": elsewhere,
    "20 samples early": lambda loop, sim: late(sim, 20),
    "noisy": lambda loop, sim: log(loop, sim, noise=0.5, inertia=90.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [True, False], ids=["cogging", "nothing"])
@pytest.mark.parametrize("awkward", HANDLED)
def test_awkward_logs_of_a_simulator_make_no_wrong_names(loop, short, awkward, hidden):
    axis = loop.with_effect("cogging", cosine=2.5, sine=1.0, period=0.004) if hidden else loop
    real, sim = log(axis, short, noise=1.0), log(loop, short, inertia=90.0)
    real = real.slice(0, 9000) if awkward == "longer" else real
    gap = iv.diagnose(real, loop, simulated=HANDLED[awkward](loop, sim))
    assert gap.effects == (("cogging",) if hidden else ()) and not gap.surplus


SAID = {
    "a third of the rate": (lambda sim: every(sim, 3), "has 333.3 Hz, the record 1000 Hz"),
    "mm": (lambda sim: sim.replace(q=1e3 * sim.q, q_ref=1e3 * sim.q_ref), "looks like mm"),
    "mm, no reference": (lambda sim: iv.Record(t=sim.t, q=1e3 * sim.q, nu=sim.nu), "like mm"),
    "a force as command": (lambda sim: sim.replace(nu=35.15 * sim.nu), "name its column tau"),
    "the other sign": (lambda sim: sim.replace(q=-sim.q, q_ref=-sim.q_ref), "another reference"),
    "half a second early": (lambda sim: late(sim, 500), "another reference"),
}


@pytest.mark.parametrize("awkward", SAID)
def test_logs_that_cannot_be_compared_are_refused_for_the_true_reason(loop, short, awkward):
    change, match = SAID[awkward]
    real, sim = log(loop, short, noise=1.0), log(loop, short, inertia=90.0)
    with pytest.raises(RecordError, match=match):
        iv.diagnose(real, loop, simulated=change(sim))


def test_the_record_itself_as_simulation_lacks_nothing(loop, short):
    real = log(loop, short, noise=1.0)
    gap = iv.diagnose(real, loop, simulated=real)
    assert gap.verdict == "adequate" and not gap.effects
    assert all(abs(c.change) < 1e-4 * max(abs(c.real), 100.0) for c in gap.changes.values())


@pytest.mark.parametrize("give", ["record", "frame", "mapping", "simulation"])
def test_any_function_is_a_simulator(loop, short, give):
    def follow(record):
        done = loop.simulate(record, THETA)
        made = done.to_record("mine", q_ref=record.q_ref)
        mapping = {"q": done.q[:, 0], "nu": done.nu[:, 0]}
        forms = {"record": made, "frame": made.to_frame(), "mapping": mapping, "simulation": done}
        return forms[give]

    mine = iv.Simulator.from_function(follow, THETA)
    assert isinstance(mine, iv.Simulator) and isinstance(loop, iv.Simulator)
    back = mine.simulate(short)
    assert np.allclose(back.q, loop.simulate(short, THETA).q, atol=1e-12)
    assert np.array_equal(back.q_ref, short.q_ref)


def test_a_simulator_that_can_be_run_confirms_its_changes(loop, short, tmp_path):
    real = log(loop.with_effect("cogging", cosine=2.5, sine=1.0, period=0.004), short, noise=1.0)
    start = {**THETA, "inertia": 90.0}
    gap = iv.diagnose(real, loop, simulated=replace(loop, start=start))
    assert gap.effects == ("cogging",)
    shown = gap.confirmed
    assert shown.before > 1.5 * shown.after
    assert shown.after == pytest.approx(shown.predicted, rel=0.1)
    assert shown.text in " ".join(gap.summary().split())
    assert shown.text[1:] in gap.to_html(tmp_path / "gap.html").read_text(encoding="utf-8")
    assert gap.to_dict()["confirmed"]["after"] == shown.after

    def changed(gap):
        return lambda record: replace(gap.loop, start=gap.theta).simulate(record)

    def follow(record):
        return loop.simulate(record, start)

    mine = iv.Simulator.from_function(follow, start, change=changed)
    assert np.allclose(mine.simulate_changed(real, gap).nu, changed(gap)(real).nu)
    unable = confirm(gap, iv.Simulator.from_function(follow), real)
    assert unable.before == pytest.approx(shown.before) and np.isnan(unable.after)
    assert "make them" in unable.text and unable.to_dict()["after"] is None


@pytest.mark.parametrize("wrong", [3.0, None, {"q": np.zeros(3)}, {"x": np.zeros(3)}, "text"])
def test_what_is_no_log_is_said_in_one_line(short, wrong):
    mine = iv.Simulator.from_function(lambda record: wrong)
    with pytest.raises(IVToolsError) as error:
        mine.simulate(short)
    assert "\n" not in str(error.value) and isinstance(error.value, DataError | IVToolsError)
