"""One physical effect, one place: columns, force and table agree."""

import copy
import pickle

import numpy as np
import pytest

from ivtools import axes
from ivtools.errors import AxisError
from ivtools.physics import EFFECTS, TERMS, Parameter, Term, find
from ivtools.physics.friction import bristle_deflection, bristle_rate
from ivtools.physics.transmission import contact, contact_margin, push

RNG = np.random.default_rng(2)
N = 400
Q, DQ, DDQ = RNG.normal(0.0, [[0.1], [0.1], [1.0]], (3, N))
TAU, T = RNG.normal(0.0, 30.0, N), np.arange(N) * 1e-3
LAWS = [term for term in TERMS.values() if term.law is not None]
DOCUMENTED = [
    "asymmetric-viscous", "stribeck", "presliding", "polynomial-viscous", "sqrt-viscous",
    "position-friction", "load-friction", "friction-drift", "offset-drift", "spring", "cogging",
    "torque-ripple", "gravity", "regularised-coulomb", "inner-saturation", "flexibility",
    "backlash", "drive-timing", "saturation", "drive-asymmetry",
    "dead-zone", "encoder-eccentricity", "controller-mismatch", "disturbance",
]  # fmt: skip
SCALES = {
    "damping",
    "force",
    "peak",
    "per force",
    "speed",
    "stroke",
    "time",
    "step",
    "command",
    "stiffness",
    "one",
}


@pytest.mark.parametrize("term", LAWS, ids=lambda term: term.name)
def test_columns_times_parameters_are_the_force(term):
    values = {
        name: value for name, value in zip(term.names, RNG.uniform(0.5, 2.0, 9), strict=False)
    }
    linear = [n for n, p in zip(term.names, term.parameters, strict=True) if p.linear]
    force = term.force(Q, DQ, DDQ, values.values(), TAU, T)
    columns = term.columns(Q, DQ, DDQ, TAU, T, values)
    assert columns.shape == (N, len(linear))
    if linear:
        theta = [values[name] for name in linear]
        assert columns @ theta == pytest.approx(force, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("term", LAWS, ids=lambda term: term.name)
def test_dry_friction_only_ever_opposes_the_motion(term):
    """At standstill a law knows the direction from its sign, and the force changes with it."""
    values = [p.neutral if not p.linear else 1.0 for p in term.parameters]
    ahead, back = (
        float(np.squeeze(term.law(0.01, 0.0, 0.0, s, 2.0, 1.0, *values))) for s in (1, -1)
    )
    assert ahead >= back


@pytest.mark.parametrize("term", LAWS, ids=lambda term: term.name)
def test_only_what_is_dry_depends_on_the_direction_at_standstill(term):
    """Whatever its parameters are, and wherever, however loaded and whenever the axis stands."""
    rng, differs = np.random.default_rng(5), 0
    for _ in range(200):
        (q, tau), t = rng.normal(0.0, 3.0, 2), rng.uniform(0.1, 9.0)
        values = [np.clip(rng.lognormal(), p.lower, p.upper) for p in term.parameters]
        ahead, back = (term.law(q, 0.0, 0.0, s, tau, t, *values) for s in (1.0, -1.0))
        differs += ahead != back
    assert term.net or term.dry == (differs > 0)


def test_every_documented_effect_is_known():
    assert sorted(EFFECTS) == sorted(DOCUMENTED)


def test_names_are_unique_and_prefixed_by_their_effect():
    names = [name for term in TERMS.values() for name in term.names]
    assert len(names) == len(set(names))
    assert all(name.startswith(f"{term.name}.") for term in EFFECTS.values() for name in term.names)


@pytest.mark.parametrize("term", TERMS.values(), ids=lambda term: term.name)
def test_terms_say_where_they_come_from_and_bound_their_parameters(term):
    assert term.equation and term.source
    for p in term.parameters:
        assert p.lower < p.upper
        assert p.lower <= p.neutral <= p.upper
        assert "{" not in p.unit_for("prismatic") + p.unit_for("revolute")
        assert p.scale in SCALES


def test_units_follow_the_joint():
    loop = axes.emps()
    assert loop.units["inertia"] == "kg"
    turning = loop.with_terms("inertia", "viscous", "coulomb", "gravity")
    assert Parameter("x", "{F} s/{L}").unit_for("revolute") == "N m s/rad"
    assert turning.names[-1] == "gravity.cos"


def test_unknown_terms_are_an_error_that_lists_the_known_ones():
    with pytest.raises(AxisError, match="'stribek' is not a term; known terms: .*stribeck"):
        find(["stribek"])


def test_what_depends_on_the_position_or_the_time_says_so():
    local = {"spring", "gravity", "position-friction", "offset-drift", "friction-drift"}
    assert {name for name, term in TERMS.items() if term.local} == local


def test_what_is_not_a_force_has_no_law():
    with pytest.raises(AxisError, match="with_effect"):
        TERMS["backlash"].force(Q, DQ, DDQ, [])


def test_a_term_stands_for_itself():
    mine = Term("mine", "mechanics", (Parameter("a", "{F}"),), "a", "here", law=lambda *x: x[-1])
    assert find([mine, "inertia"]) == (mine, TERMS["inertia"])


@pytest.mark.parametrize("speed", [0.02, -0.05])
def test_the_deflection_of_a_bristle_solves_its_equation(speed):
    level, s0, z, steps = 20.0, 5e5, 1e-5, 20000
    times = np.linspace(0.0, 5e-3, steps + 1)
    found = z
    for h in np.diff(times):
        half = found + 0.5 * h * bristle_rate(found, speed, level, s0)
        found += h * bristle_rate(half, speed, level, s0)
    exact = bristle_deflection(z, speed * times[-1], level, s0)
    assert found == pytest.approx(exact, rel=1e-6)
    assert bristle_deflection(z, 1.0, level, s0) == pytest.approx(level / s0)  # it slides
    assert bristle_deflection(z, 1.0, 0.0, s0) == z  # nothing to slide on


def test_contacts_push_and_never_pull():
    k, c, gap = 1e5, 300.0, 1e-3
    for stretch, rate in zip(RNG.normal(0.0, 1e-3, 200), RNG.normal(0.0, 0.3, 200), strict=True):
        side = contact(stretch, rate, k, c, gap)
        force = push(stretch, rate, side, k, c, gap)
        assert force * side >= 0.0
        assert (side == 0.0) == (abs(stretch) <= 0.5 * gap or force * np.sign(stretch) <= 0.0)
        margin = contact_margin(stretch, rate, side, k, c, gap)
        assert margin >= 0.0
        assert contact(stretch, rate, k, c, 0.0) != 0.0  # joined for good


@pytest.mark.parametrize("term", TERMS.values(), ids=lambda term: term.name)
def test_a_term_of_ours_is_itself_after_pickling(term):
    assert pickle.loads(pickle.dumps(term)) is term and copy.deepcopy(term) is term


def test_a_term_of_the_user_s_own_takes_its_law_along():
    law = eval("lambda q, dq, ddq, sign, tau, t, a: 3.0 * a * dq")
    own = Term("mine", "mechanics", (Parameter("a", "{F}"),), "3 a dq", "nobody", law=law)
    sent = pickle.loads(pickle.dumps(own))
    assert sent == own and sent.law(0.0, 2.0, 0.0, 1.0, 0.0, 0.0, 5.0) == 30.0


def test_friction_of_a_simulator_takes_up_its_share_of_the_drive_force_at_rest():
    law, zero = TERMS["regularised-coulomb"], np.zeros(3)
    tau = np.array([1.0, -2.0, 30.0])
    held = law.force(zero, zero, zero, (5.0, 0.01, 0.93 / 5.0), tau)
    assert np.allclose(held, [0.93, -1.86, 5.0])
