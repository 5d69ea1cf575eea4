"""Which effects earn a name: what one large effect must not hide, and what is not ambiguous."""

import ast
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import ivtools as iv
from benchmarks import moves
from benchmarks.withheld.cases import draw
from benchmarks.withheld.suites import Task
from ivtools.gap import rules
from ivtools.gap.attribute import Attribution, Evidence, attribution, probability
from ivtools.gap.attribute.rounds import Round
from ivtools.gap.candidate import Trial
from ivtools.gap.library import Scales
from ivtools.gap.rules import LIKELY, Rules
from ivtools.loop.axis_file import from_tables
from ivtools.physics import EFFECTS, Parameter, Term

GAP = Path(rules.__file__).parent
#: Numbers of formulas and of per cent, and what no threshold is below: guards against zero.
ANYWHERE, NOTHING = {0.0, 0.5, 1.0, 2.0, 100.0}, 1e-5
#: Numbers outside of the rules that decide nothing either.
HARMLESS = {
    "advice.py": {1.7},  # phases of a dither
    "diagnosis.py": {60, 0.01},  # letters of a line; per cent
    "fleet/fleet.py": {4},  # lines of a table
    "floor/events.py": {1.4826},  # normal deviation of a median one
    "floor/floor.py": {9.0},  # of Wilson, Hilferty
    "page.py": {0.1, 10.0},  # digits of a share
    "parity/gains.py": {1e-3},  # a finite difference
    "verdict/answer.py": {0.01},  # per cent
}
SECONDS = 16.0
BASE = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}


def records(**effects):
    """Return two records of an axis with these effects, in force noise of 0.6 N."""
    loop, theta = iv.axes.emps(), dict(BASE)
    for name, values in effects.items():
        term = name.replace("_", "-")
        loop = loop.with_effect(term, **values)
        theta |= {f"{term}.{k}": v for k, v in values.items()}
    return [moves.record(loop, theta, SECONDS, seed) for seed in (1, 2)]


@pytest.fixture(scope="module")
def lines_and_drift():
    one, two = records(
        cogging={"cosine": 1.5, "sine": 0.5, "period": 0.004},
        friction_drift={"coulomb_rate": 0.06, "viscous_rate": 0.0},
    )
    return iv.diagnose(one, iv.axes.emps(), two)


def test_a_small_drift_is_named_beside_strong_cogging(lines_and_drift):
    """A line over position once passed for coloured noise, and hid whatever was smaller."""
    assert lines_and_drift.verdict == "explained"
    assert set(lines_and_drift.effects) == {"cogging", "friction-drift"}
    assert lines_and_drift.parameters["cogging"]["period"] == pytest.approx(0.004, rel=5e-3)
    drift = lines_and_drift.parameters["friction-drift"]
    change = (drift["coulomb_rate"] + drift["coulomb_curvature"] * SECONDS) * SECONDS
    assert change == pytest.approx(0.06 * SECONDS, rel=0.15)


def test_every_name_comes_with_a_probability(lines_and_drift):
    found = lines_and_drift.to_dict()
    assert set(found["probability"]) == set(found["effects"])
    assert all(0.5 < p < 1.0 for p in found["probability"].values())
    assert all(e["gain"] > 0.0 and e["t"] > 5.0 for e in found["evidence"].values())


def test_without_a_wrong_controller_nothing_is_put_right(lines_and_drift):
    shrink = lines_and_drift.shrink
    assert shrink.corrected == pytest.approx(shrink.before, rel=0.02)
    assert shrink.after < shrink.corrected


def test_effects_of_the_same_size_are_not_ambiguous_for_that():
    """Asymmetric and curved friction remove as much, but not the same."""
    one, two = records(asymmetric_viscous={"delta": -26.0}, sqrt_viscous={"force": 60.0})
    gap = iv.diagnose(one, iv.axes.emps(), two)
    assert set(gap.effects) == {"asymmetric-viscous", "sqrt-viscous"}
    assert "sqrt-viscous" not in gap.ambiguous_with["asymmetric-viscous"]
    assert gap.ambiguous_with["asymmetric-viscous"] == []


class Tried(SimpleNamespace):
    """A stand-in of a trial that is like all others, but better by this t value than they are."""

    sound = True

    def correlation(self, other):
        return 0.9

    def advantage(self, other):
        return 5.0


@pytest.mark.parametrize(
    ("left", "names", "twins"),
    [
        (1.3, ("sqrt-viscous", "polynomial-viscous"), ("sqrt-viscous", "polynomial-viscous")),
        (1.3, ("sqrt-viscous", "spring", "gravity"), ("sqrt-viscous", "spring", "gravity")),
        (1.3, ("spring",), ("spring",)),
        (1.01, ("sqrt-viscous", "polynomial-viscous"), ()),
    ],
)
def test_what_is_left_may_decide_between_twins(left, names, twins):
    """Whatever t value tells them apart; it does where nothing else is left."""
    base = (SimpleNamespace(cost=left),)
    best, *others = (
        Tried(name=n, term=EFFECTS[n], gain=g, held=base)
        for n, g in zip(("stribeck", *names), (0.1, 0.098, 0.097, 0.096), strict=False)
    )
    tried = Round(Rules(), {}, (best, *others), qualified=(best,))
    assert tuple(t.name for t in tried.twins(left)) == twins


def test_evidence_counts_in_the_right_direction():
    weak = Evidence(gain=0.03, t=7.0, disagreement=1.5, rival=0.9, share=0.1, left=1.5,
                    unlike=0.5, evenness=0.3)  # fmt: skip
    for better in (
        {"t": 50.0},
        {"disagreement": 1.0},
        {"rival": 0.0},
        {"gain": 0.5},
        {"evenness": 1.0},
        {"stands": True},
    ):
        assert probability(Evidence(**{**weak.to_dict(), **better})) > probability(weak)
    assert probability(replace(weak, surpassed=True)) < probability(weak)


def test_a_load_that_rattles_needs_few_blocks_if_nothing_else_looks_like_it():
    proof = Evidence(gain=0.2, t=2.5, disagreement=1.3, rival=0.2, share=0.3, left=3.0,
                     unlike=0.95, evenness=0.03)  # fmt: skip
    assert probability(proof) < LIKELY < probability(replace(proof, apart=True))
    assert probability(replace(proof, apart=True, rival=0.5)) < LIKELY
    assert probability(replace(proof, apart=True, surpassed=True)) < LIKELY


@pytest.mark.parametrize(
    ("left", "first", "stands", "taken"),
    [
        (1.02, 0.99, False, ()),
        (1.1, 0.99, False, ()),
        (1.4, 0.99, False, ("two",)),
        (1.4, 0.5, True, ("one",)),
        (1.4, 0.5, False, ("one", "two")),
    ],
)
def test_a_further_name_is_not_slight_beside_what_all_leave(
    left, first, stands, taken, monkeypatch
):
    """The first that is likely is none: it is not held against what it is found beside.

    Beside one that falls it must stand beside a smooth law, which takes that one's place.
    """
    trial = SimpleNamespace(removed=0.05, stands=lambda laws: stands and laws == "smooth laws")
    pairs = {name: (None, trial) for name in ("one", "two")}
    monkeypatch.setattr(attribution, "probability", {"one": first, "two": 0.9}.get)
    monkeypatch.setattr(attribution, "common", lambda fits: fits)
    monkeypatch.setattr(attribution, "Laws", SimpleNamespace(of=lambda fits: "smooth laws"))
    found = Attribution((), (), (SimpleNamespace(cost=left),), tuple(pairs), Rules())
    vars(found).update(winners=pairs, _empty=set(), evidence={name: name for name in pairs})
    assert found.doubtful == taken


def test_uneven_blocks_speak_only_against_a_name_that_a_smooth_law_could_stand_for():
    proof = Evidence(gain=0.06, t=12.0, disagreement=1.05, rival=0.1, share=0.9, left=1.0,
                     unlike=0.1, evenness=0.2)  # fmt: skip
    doubted = probability(proof)
    assert doubted < LIKELY < probability(replace(proof, evenness=0.9))
    assert doubted < LIKELY < probability(replace(proof, unlike=0.9))
    assert doubted < LIKELY < probability(replace(proof, stands=True))
    assert doubted < probability(replace(proof, left=1.5))  # what is left makes any blocks uneven
    assert probability(replace(proof, left=12.0, evenness=0.02)) < LIKELY  # but not without end


def test_a_likeness_that_fits_some_blocks_far_better_than_others_has_no_name():
    """As strong as any other evidence is: a smooth force 60 times the noise, called a spring."""
    spring = Evidence(gain=0.9, t=34.0, disagreement=1.06, rival=0.0, share=0.95, left=3.8,
                      explained=0.95, unlike=0.005, evenness=0.017)  # fmt: skip
    part = {"stands": True, "share": 0.4}  # as a friction did beside a spring that fell
    for same in ({}, part):
        assert probability(replace(spring, **same)) < LIKELY, same
    closes = {"share": 0.995, "gain": 0.995, "left": 160.0}  # of a gap of 200 times the noise
    for other in ({"stands": True}, {"unlike": 0.9}, {"left": 1.3, "t": 380.0}, {"evenness": 0.2}):
        assert probability(replace(spring, **other)) >= LIKELY, other
    assert probability(replace(spring, **closes)) >= LIKELY


def test_a_name_that_another_effect_outdoes_is_none_while_a_gap_is_left():
    proof = Evidence(gain=0.3, t=60.0, disagreement=1.1, rival=1.6, share=0.7, left=1.3,
                     explained=0.7, unlike=0.9, evenness=0.3)  # fmt: skip
    assert probability(proof) < 0.5
    assert probability(replace(proof, rival=1.0)) > 0.9  # it did as well, and was told from it
    assert probability(replace(proof, explained=0.95)) > 0.9  # beside others it closed the gap


@pytest.mark.parametrize("effect", ["flexibility", "backlash"])
def test_a_second_mass_that_is_hardly_one_has_no_name(effect):
    """With the friction on it, it is friction that yields."""
    shape = {"gap": 1e-4} if effect == "backlash" else {}
    record, loop = iv.datasets.twin(), iv.axes.emps().with_effect(effect, **shape)
    for share, named in ((0.02, False), (0.2, True)):
        values = loop.values({**BASE, f"{effect}.load_share": share})
        fold = SimpleNamespace(scales=Scales(record, loop))
        fit = SimpleNamespace(values=values, loop=loop, fold=fold)
        assert Trial(EFFECTS[effect], (fit, fit), (), ()).inside == named


def test_an_effect_that_does_nothing_is_not_what_helped():
    """What was fitted anew beside it was: load friction of zero had a name beside a backlash."""
    loop = iv.axes.emps().with_effect("load-friction").with_effect("drive-timing")
    for effect, acting in (("load-friction", "ratio"), ("drive-timing", "lag")):
        for size in (0.0, 1e-3):
            values = loop.values({**BASE, f"{effect}.{acting}": size})
            fit = SimpleNamespace(values=values, loop=loop)
            assert Trial(EFFECTS[effect], (fit, fit), (), ()).acts == (size > 0.0)


def test_a_law_of_the_speed_that_the_library_lacks_is_not_called_two_of_them():
    """The first one comes to the floor, and the second made up for its form."""
    case = draw(Task("outside", 6301, ("sqrt-viscous",)))
    one, two = (iv.Record.from_dict(r) for r in case.records)
    gap = iv.diagnose(one, from_tables(case.axis.tables()), two, without=["sqrt-viscous"])
    assert gap.effects == ("polynomial-viscous",)  # its twin
    of_speed = {name for name, term in EFFECTS.items() if term.of_speed}
    assert of_speed == {"stribeck", "polynomial-viscous", "sqrt-viscous", "regularised-coulomb"}


def test_friction_over_position_is_told_by_its_law():
    """One of a user's own as well; it is as large at any speed, and turns with the motion."""
    assert {n for n, term in EFFECTS.items() if term.of_place} == {"position-friction"}
    forms = {
        "wave": lambda q, dq, ddq, sign, tau, t, a: a * np.sin(7.0 * q) * sign,
        "force": lambda q, dq, ddq, sign, tau, t, a: a * np.sin(7.0 * q),
        "viscous": lambda q, dq, ddq, sign, tau, t, a: a * np.sin(7.0 * q) * dq,
        "ageing": lambda q, dq, ddq, sign, tau, t, a: a * np.sin(7.0 * q) * t * sign,
    }
    own = {n: Term(n, "mechanics", (Parameter("a", "{F}"),), n, n, law=f) for n, f in forms.items()}
    assert {n for n, term in own.items() if term.of_place} == {"wave"}


def test_a_second_effect_is_looked_for_at_the_floor_too():
    """The floor, learnt without either, has some of it: what the first one leaves is below 1."""
    case = draw(Task("two", 6107, ("presliding", "spring")))
    one, two = (iv.Record.from_dict(r) for r in case.records)
    gap = iv.diagnose(one, from_tables(case.axis.tables()), two)
    assert set(gap.effects) == {"presliding", "spring"}
    assert gap.chi[1] < 0.95


def numbers(tree: ast.AST) -> Iterator[float]:
    """Yield the floats of a module, and the integers that something is compared with."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and type(node.value) is float:
            yield node.value
        for side in (node.left, *node.comparators) if isinstance(node, ast.Compare) else ():
            if isinstance(side, ast.Constant) and type(side.value) is int:
                yield side.value


@pytest.mark.parametrize(
    "file",
    [file for file in sorted(GAP.rglob("*.py")) if file != Path(rules.__file__)],
    ids=lambda file: str(file.relative_to(GAP)),
)
def test_numbers_that_decide_are_rules(file):
    found = {x for x in numbers(ast.parse(file.read_text(encoding="utf-8"))) if x > NOTHING}
    assert found <= ANYWHERE | HARMLESS.get(file.relative_to(GAP).as_posix(), set())


def test_every_rule_is_used_and_stated_once():
    tree = ast.parse(Path(rules.__file__).read_text(encoding="utf-8"))
    stated = [
        name.id
        for node in tree.body
        for name in ast.walk(node)
        if isinstance(node, ast.Assign | ast.AnnAssign)
        and isinstance(name, ast.Name)
        and isinstance(name.ctx, ast.Store)
    ]
    others = (f.read_text(encoding="utf-8") for f in GAP.rglob("*.py") if f.name != "rules.py")
    used = set(re.findall(r"\w+", "".join(others)))
    assert len(stated) == len({*stated}) > 200
    assert not {*stated} - used
