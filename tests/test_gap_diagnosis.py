"""The diagnosis answers as interfaces.md says, on records whose truth is known."""

import json
from dataclasses import replace

import numpy as np
import pytest

import ivtools as iv
from ivtools.gap import VERDICTS, parity, preflight

THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}


@pytest.fixture(scope="module")
def loop():
    return iv.axes.emps()


def measured(loop, seed, effect=None, push=None, **values):
    """Return a noisy record of the loop with one more effect in it."""
    given = iv.datasets.twin()
    truth = loop.with_effect(effect, **values) if effect else loop
    noise = np.random.default_rng(seed).normal(0.0, 2.0, given.n_samples)
    if push is not None:
        noise = noise + push
    sim = truth.simulate(given, THETA, initial="rest", force_noise=noise, quantum=5e-8)
    return given.replace(q=sim.q, nu=sim.nu, name=f"seed {seed}")


@pytest.fixture(scope="module")
def asymmetric(loop):
    records = [measured(loop, s, "asymmetric-viscous", delta=-35.0) for s in (1, 2)]
    return iv.diagnose(records[0], loop, holdout=records[1])


def test_a_known_effect_is_named(asymmetric):
    assert asymmetric.verdict == "explained"
    assert asymmetric.effects == ("asymmetric-viscous",)
    assert asymmetric.parameters["asymmetric-viscous"]["delta"] == pytest.approx(-35.0, rel=0.05)
    assert asymmetric.block == "mechanics"
    assert asymmetric.shrink.closed > 0.9


def test_the_card_has_the_value_of_the_summary_and_what_to_do(asymmetric):
    card = asymmetric.page().card
    value = asymmetric.value("asymmetric-viscous", "delta")
    assert ("Effects", f"asymmetric-viscous: delta {value} (99 % likely)") in card.facts
    assert f"delta {value}" in str(asymmetric.summary())
    assert "ivtools export" in card.next[0]


def test_an_adequate_model_has_no_figure_of_what_hardly_matters(loop):
    found = iv.diagnose(measured(loop, 5), loop, holdout=measured(loop, 6))
    page = found.page()
    assert found.verdict == "adequate" and "as it is" in page.card.next[0]
    (which,) = (s for s in page.sections if s.title == "Which effect")
    assert which.folded and not which.figures


def test_two_records_of_one_motion_show_the_floor_between_them(asymmetric):
    """With the effect in the model nothing but the noise differs, between the runs and from it."""
    one, two = asymmetric.floors
    assert one.between == two.between == pytest.approx(asymmetric.shrink.after, rel=0.05)
    assert one.level == one.between
    assert asymmetric.shrink.floor == pytest.approx(one.between, rel=0.05)


def test_the_json_has_the_agreed_form(asymmetric):
    found = json.loads(json.dumps(asymmetric.to_dict()))
    assert found["verdict"] in VERDICTS
    assert set(found) >= {
        "verdict",
        "effects",
        "ambiguous_with",
        "parameters",
        "where",
        "shrink",
        "ranking",
        "advice",
    }
    assert found["where"]["block"] == "mechanics"
    assert set(found["where"]["regions"][0]) >= {"region", "energy", "time"}
    assert set(found["shrink"]) >= {
        "signal",
        "unit",
        "before",
        "after",
        "interval",
        "floor",
        "closed",
        "held_out",
    }
    assert set(found["ranking"][0]) >= {"effect", "closed", "p_value"}
    assert found["ambiguous_with"] == {"asymmetric-viscous": []}


def test_summary_and_page_show_the_answer(asymmetric, tmp_path):
    assert "asymmetric-viscous" in asymmetric.summary()
    assert len(asymmetric.plot().axes) == 4
    page = asymmetric.to_html(tmp_path / "gap.html").read_text(encoding="utf-8")
    assert "Explained: the named effects close the gap" in page and page.count("</figure>") == 8
    assert "on seed 1" in page and "on seed 2" in page  # the values on either side


def test_the_summary_keeps_within_the_line_whatever_the_names_and_sizes(asymmetric):
    tiny = replace(
        asymmetric.shrink, before=1.2345e-5, after=1.2345e-6, interval=(1.1e-6, 1.3e-6), unit="N m"
    )
    sides = ("a-record-with-a-long-name-" * 3, "another-" * 9)
    replicas = tuple(replace(r, sides=sides) for r in asymmetric.replicas)
    long = replace(asymmetric, name="x" * 200, shrink=tiny, replicas=replicas)
    assert max(map(len, long.summary().splitlines())) <= 80


def test_it_says_whether_a_name_replicates_in_both_directions(asymmetric):
    assert "replicates in both directions" in asymmetric.summary()
    found = asymmetric.to_dict()["replicates"]["asymmetric-viscous"]
    assert found["replicates"] is True
    for side, name in zip(found["sides"], ("seed 1", "seed 2"), strict=True):
        assert side["side"] == name and side["delta"] == pytest.approx(-35.0, rel=0.1)


def test_nothing_missing_is_adequate(loop):
    found = iv.diagnose(measured(loop, 3), loop, holdout=measured(loop, 4))
    assert (found.verdict, found.effects) == ("adequate", ())


def test_a_push_from_outside_is_not_an_effect(loop):
    n = iv.datasets.twin().n_samples
    push = np.zeros(n)
    push[9000:9600] = 15.0
    found = iv.diagnose(measured(loop, 5, push=push), loop, holdout=measured(loop, 6))
    assert (found.verdict, found.effects, found.block) == ("non-repeatable", (), "outside")
    assert any(8.8 < start < 9.3 for f in found.floors for start, _ in f.events)


def test_one_record_judges_itself_and_says_that_it_is_weaker(loop):
    found = iv.diagnose(measured(loop, 7, "asymmetric-viscous", delta=-35.0), loop)
    assert found.effects == ("asymmetric-viscous",)
    assert not found.shrink.held_out and any("no hold-out" in line for line in found.advice)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: r.replace(nu=-r.nu), "opposite sign"),
        (lambda r: r.replace(nu=1000.0 * r.nu), "check the unit of nu"),
        (lambda r: r.replace(nu=r.nu / 1000.0), "times what the controller gives"),
        (lambda r: r.slice(0, 2000), "at least 3 s"),
    ],
)
def test_bad_input_is_reported_instead_of_an_effect(loop, change, words):
    found = iv.diagnose(change(iv.datasets.twin()), loop)
    assert found.effects == () and any(words in f.text for f in found.findings)
    assert json.loads(json.dumps(found.to_dict()))["shrink"] is None
    assert "verdict" in found.summary()


def test_wrong_gains_are_the_axis_files_fault(loop):
    wrong = replace(loop, controller=replace(loop.controller, settings={"kp": 80.0, "kv": 243.45}))
    record = iv.datasets.twin()
    shown = parity.check(record, wrong)
    (found,) = preflight.other_law(shown)
    assert "kp +100 %" in found.text and not preflight.inspect(record, wrong, shown)


def test_a_record_without_reference_is_refused(loop):
    record = iv.datasets.twin()
    bare = iv.Record(record.t, q=record.q, nu=record.nu)
    with pytest.raises(iv.errors.RecordError, match="no q_ref"):
        iv.diagnose(bare, loop)


def test_a_term_of_your_own_takes_part(loop):
    from ivtools.physics import Parameter, Term

    own = Term(
        "wind",
        "mechanics",
        (Parameter("size", "{F}"),),
        "a |q| dq",
        "a test",
        law=lambda q, dq, ddq, sign, tau, t, a: a * np.abs(q) * dq,
    )
    assert iv.diagnose(iv.datasets.twin(), loop, extra=(own,)).effects == ("asymmetric-viscous",)


def test_the_emps_tells_of_asymmetric_friction_in_both_directions(loop, emps, emps_pulses):
    ahead = iv.diagnose(emps, loop, holdout=emps_pulses)
    assert "asymmetric-viscous" in ahead.effects
    assert ahead.shrink.after < 0.55 * ahead.shrink.before
    deltas = ahead.replication["asymmetric-viscous.delta"]
    assert deltas[0] == pytest.approx(deltas[1], rel=0.1)
