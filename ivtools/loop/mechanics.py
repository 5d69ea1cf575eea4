"""Mechanics: the forces of every term, summed for one or two masses.

The laws of `ivtools.physics` are composed into compiled sums; a flag says which act. A user's own
laws go through one slot.
"""

# Compiled functions carry no annotations: Numba infers them, and mypy cannot see through it.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from __future__ import annotations

import numpy as np
from numba import cfunc, float64, types

from ..compiled import compiled, inlined
from ..physics import TERMS
from ..physics.transmission import contact, push

# Parameters and flags travel as records: fields have names, and a record is a bare pointer, where
# an array would be reference-counted at every call.
_SWITCHES = ("own", "effects", "beyond", "two", "sign", "turns")
OWN = tuple(f"own.{i}" for i in range(12))  # room for the parameters of a user's own laws
# what follows from the parameters: two inertias, the share of the friction that sits on the load,
# what of the offset and of outside forces it takes over from the motor, stiffness, damping and gap
# between the masses, the stiffness of a bristle, how far apart the place of spatial forces is from
# the position, and the force from outside in what is given as tau, which no drive transmits
_DERIVED = ("motor", "load", "share", "shift", "k", "c", "gap", "bristle", "apart", "outside")
_NAMES = (*(n for t in TERMS.values() for n in t.names), "gain", "delay", *OWN, *_DERIVED)
# integration steps per sample, terms of the series of a vibration, and the node at hand: loads for
# which series are summed up, evenly over 1 / load from `lightness` on by `spacing`, which is
# negative where they are too few, and how far the load is from it towards the next one
LOADS = 17
_COUNTS = (("steps", np.int64), ("terms", np.int64), ("node", np.int64))
_NODES = ("lightness", "spacing", "onwards")
# sums of `steps.sum_up`, and whether they are there: by load, before and after the drive's delay,
# by whether motor and load move ahead, and by whether they touch
_MODES = (LOADS, 2, 2, 2, 2)
_SUMS = (("sums", float, (*_MODES, 8, 5)), ("there", np.int8, _MODES))
_LINES = ("lines", float, (3, 2))  # plain friction of two masses by direction, see `plain_line`
PARAMETERS = np.dtype([*((n, float) for n in (*_NAMES, *_NODES)), *_COUNTS, *_SUMS, _LINES])
FLAGS = np.dtype([("laws", np.int64), *((name, bool) for name in (*TERMS, *_SWITCHES))])

_ALWAYS = ("viscous", "coulomb", "asymmetric-friction", "offset")
TWO_MASSES = ("flexibility", "backlash")
PLAIN = (*_ALWAYS, "inertia")  # terms that need no flag

_OWN = types.UniTuple(float64, len(OWN))
SCALAR_LAW = float64(float64, float64, float64, float64, float64, _OWN)


def _fields(names):
    """Compile the reading of up to four of the parameter record's fields."""
    a, b, c, d = (*names, *names[:1] * 4)[:4]
    readers = (
        lambda p: (p[a],),
        lambda p: (p[a], p[b]),
        lambda p: (p[a], p[b], p[c]),
        lambda p: (p[a], p[b], p[c], p[d]),
    )
    return inlined(readers[len(names) - 1])


def _sum(names):
    """Compose the force laws of these terms into one compiled sum."""
    if not names:
        return inlined(lambda q, v, s, tau, t, p: 0.0)
    before, term = _sum(names[:-1]), TERMS[names[-1]]
    law, fields = inlined(term.law), _fields(term.names)

    @inlined
    def total(q, v, s, tau, t, p):
        return before(q, v, s, tau, t, p) + law(q, v, 0.0, s, tau, t, *fields(p))

    return total


def _one_of(names):
    """Compile the choice of one of these terms' laws by its bit; LLVM makes a jump table of it."""
    if not names:
        return inlined(lambda bit, q, v, s, tau, t, p: 0.0)
    before, term, own_bit = _one_of(names[:-1]), TERMS[names[-1]], BITS[names[-1]]
    law, fields = inlined(term.law), _fields(term.names)

    @inlined
    def chosen(bit, q, v, s, tau, t, p):
        if bit == own_bit:
            return law(q, v, 0.0, s, tau, t, *fields(p))
        return before(bit, q, v, s, tau, t, p)

    return chosen


BITS = {n: 1 << i for i, n in enumerate(n for n, t in TERMS.items() if t.law and n not in PLAIN)}
_NET = sum(BITS[n] for n in BITS if TERMS[n].net)  # one at most: two would have to be solved
_DRY = sum(BITS[n] for n in BITS if TERMS[n].dry)
_first, _second, _third = (_fields(OWN[i : i + 4]) for i in (0, 4, 8))
plain_resistance = _sum(_ALWAYS)
_law = _one_of(tuple(BITS))


@cfunc(SCALAR_LAW)
def no_law(q, v, s, tau, t, own):
    """Stand in the slot of a user's own law."""
    return 0.0


def user_law(terms):
    """Compile the sum of a user's own laws for the kernel's slot."""

    def chain(terms):
        if not terms:
            return inlined(lambda q, v, s, tau, t, own: 0.0)
        before, law = chain(terms[:-1]), inlined(terms[-1].law)
        first = sum(len(t.names) for t in terms[:-1])
        last = first + len(terms[-1].names)

        @compiled
        def total(q, v, s, tau, t, own):
            values = own[first:last]
            return before(q, v, s, tau, t, own) + law(q, v, 0.0, s, tau, t, *values)

        return total

    total = chain(terms)
    return cfunc(SCALAR_LAW)(lambda q, v, s, tau, t, own: total(q, v, s, tau, t, own))


@inlined
def extra_resistance(q, v, s, tau, t, p, on, user):
    """Return the force of the effects that oppose a motion in direction s, N."""
    return _of_laws(on["laws"], q, v, s, tau, t, p, on, user)


@compiled
def _of_laws(laws, q, v, s, tau, t, p, on, user):
    """Return the force of these of the laws, by their bits, and of a user's own."""
    f, net, place, sent = 0.0, laws & _NET, q + p["apart"], tau - p["outside"]
    laws &= ~_NET
    while laws:
        bit = laws & -laws
        f += _law(bit, place, v, s, sent, t, p)
        laws ^= bit
    if on["own"]:
        f += _own_law(place, v, s, sent, t, p, user)
    if net:
        drives = tau - f - plain_resistance(q, v, s, tau, t, p)
        f += _law(net, place, v, s, drives, t, p)
    return f


@compiled
def _own_law(q, v, s, tau, t, p, user):
    return user(q, v, s, tau, t, (*_first(p), *_second(p), *_third(p)))


@compiled
def resistance(q, v, s, tau, t, p, on, user):
    """Return the force opposing a motion in direction s, N."""
    return plain_resistance(q, v, s, tau, t, p) + extra_resistance(q, v, s, tau, t, p, on, user)


@inlined
def plain_line(s, p):
    """Return plain friction in direction s as a straight line over velocity: level and slope."""
    level = plain_resistance(0.0, 0.0, s, 0.0, 0.0, p)
    return level, plain_resistance(0.0, 1.0, s, 0.0, 0.0, p) - level


_MAX_STEPS = 64
_MAX_TERMS = 40
LIGHTEST = 0.1  # of the mean inertia of a load: what is lighter is not told from its drive
_REACH = 2.0  # a series converges well over an angle of two radians
_BRISTLE_REACH = 0.4  # angle of the bristle's vibration in a step


@compiled
def _terms(angle):
    """Return how many terms of its series a vibration through this angle needs."""
    n, term = 1, angle
    while term > 1e-9 and n < _MAX_TERMS:
        n += 1
        term *= angle / n
    return max(n, 4)


@compiled
def _drag(p):
    """Return the greatest rate at which viscous friction slows one of two masses, 1/s."""
    slope = max(abs(plain_line(1.0, p)[1]), abs(plain_line(-1.0, p)[1]))
    return slope * max((1.0 - p["share"]) / p["motor"], p["share"] / p["load"])


@compiled
def _joint(p, on):
    """Return how the axis is divided: load's shares of mass, friction, offset, Hz, damping, gap."""
    if on["backlash"]:
        return (
            p["backlash.load_share"],
            p["backlash.load_friction"],
            p["backlash.load_offset"],
            p["backlash.contact_hz"],
            p["backlash.damping"],
            p["backlash.gap"],
        )
    if on["flexibility"]:
        return (
            p["flexibility.load_share"],
            p["flexibility.load_friction"],
            p["flexibility.load_friction"],
            p["flexibility.frequency_hz"],
            p["flexibility.damping"],
            0.0,
        )
    return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0


@compiled
def derive(dt, n, p, on):
    """Derive the masses and how finely their motion is resolved: by at least n steps per sample.

    A stiffness beyond what the greatest number of steps resolves is as good as rigid, and is
    lowered to that one.
    """
    m, (r, share, offset, hz, zeta, gap) = p["inertia"], _joint(p, on)
    p["motor"], p["load"], p["share"], p["gap"] = m * (1.0 - r), m * r, share, gap
    p["shift"] = (share - offset) * p["offset"]
    damped, reduced = max(1.0, 2.0 * zeta), m * r * (1.0 - r)
    w = min(2.0 * np.pi * hz, _MAX_STEPS * _REACH / (damped * dt))
    p["k"], p["c"] = reduced * w * w, 2.0 * zeta * reduced * w
    angle = (w * damped + _drag(p)) * dt if r > 0.0 else 0.0
    steps = max(n, min(int(np.ceil(angle / _REACH)), _MAX_STEPS))
    if on["presliding"]:
        fastest = _MAX_STEPS * _BRISTLE_REACH / dt
        p["bristle"] = min(p["presliding.stiffness"], p["motor"] * fastest * fastest)
        bristle = np.sqrt(p["bristle"] / p["motor"]) * dt
        steps = max(steps, int(np.ceil(bristle / _BRISTLE_REACH)))
    p["steps"], p["terms"] = steps, _terms(angle / steps)
    if on["two"]:
        for i in range(3):
            p["lines"][i, 0], p["lines"][i, 1] = plain_line(i - 1.0, p)


@inlined
def with_swing(mean, more):
    """Return the inertia of a load that has so much more than its mean, and some in any case."""
    return max(mean + more, LIGHTEST * mean)


@inlined
def link_force(x, side, p):
    """Return the force between the two masses, N, that touch on this side."""
    return push(x[0] - x[2], x[1] - x[3], side, p["k"], p["c"], p["gap"])


@compiled
def friction_level(q, tau, t, p, on, user):
    """Return the dry friction of the motor between its two directions, N."""
    dry = on["laws"] & _DRY  # other laws would cancel
    width = plain_resistance(q, 0.0, 1.0, tau, t, p) - plain_resistance(q, 0.0, -1.0, tau, t, p)
    if dry or on["own"]:
        width += _of_laws(dry, q, 0.0, 1.0, tau, t, p, on, user)
        width -= _of_laws(dry, q, 0.0, -1.0, tau, t, p, on, user)
    return 0.5 * (1.0 - p["share"]) * width


@compiled
def motor_net(x, s, link, tau, t, p, on, user):
    """Return the net force on the motor, or the only mass, that moves in direction s, N.

    A bristle takes the place of the dry friction; its damping is nothing at standstill, which is
    where this is asked with one.
    """
    against = (1.0 - p["share"]) * resistance(x[0], x[1], s, tau, t, p, on, user) + p["shift"]
    if on["presliding"]:
        against += p["bristle"] * x[4] - s * friction_level(x[0], tau, t, p, on, user)
    return tau - against - link


@compiled
def load_net(x, s, link, tau, t, p, on, user):
    """Return the net force on the load that moves in direction s, N."""
    if p["share"] > 0.0:
        link -= p["share"] * resistance(x[2], x[3], s, tau, t, p, on, user)
    return link + p["shift"]


@compiled
def held_link(q, v, a, pull, p, on, user):
    """Return where the load is when it moves with the motor, and a force pulls at it, m or rad.

    The motor pushes it along against that force, its friction and its inertia: across a gap, on
    the side on which it then is, and by a spring as far as that stretches.
    """
    up, down = 1.0 if v >= 0.0 else -1.0, 1.0 if v > 0.0 else -1.0  # neither where it rests
    friction = 0.5 * (
        resistance(q, v, up, 0.0, 0.0, p, on, user) + resistance(q, v, down, 0.0, 0.0, p, on, user)
    )
    link = pull + p["share"] * friction - p["shift"] + p["load"] * a
    return q - 0.5 * np.sign(link) * p["gap"] - link / p["k"]


@inlined
def rates(x, tau, t, p, on, user):
    """Return dx/dt of the state x = (q1, v1, q2, v2, z), friction by the sign of the velocity."""
    if not on["two"]:
        a1 = motor_net(x, np.sign(x[1]), 0.0, tau, t, p, on, user) / p["motor"]
        return x[1], a1, x[3], 0.0, 0.0
    side = contact(x[0] - x[2], x[1] - x[3], p["k"], p["c"], p["gap"])
    link = link_force(x, side, p)
    a1 = motor_net(x, np.sign(x[1]), link, tau, t, p, on, user) / p["motor"]
    a2 = load_net(x, np.sign(x[3]), link, tau, t, p, on, user) / p["load"]
    return x[1], a1, x[3], a2, 0.0
