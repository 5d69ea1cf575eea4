"""Mechanics: the forces of every term, summed for one or two masses.

The laws of `ivtools.physics` are composed into compiled sums; a flag says which act. A user's own
laws go through one slot.
"""

# Compiled functions carry no annotations: Numba infers them, and mypy cannot see through it.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from __future__ import annotations

import numpy as np
from numba import cfunc, float64, njit, types

from ..physics import TERMS
from ..physics.friction import bristle_rate
from ..physics.transmission import coupling

# Parameters and flags travel as records: fields have names, and a record is a bare pointer, where
# an array would be reference-counted at every call.
_SWITCHES = ("own", "effects", "held", "structure", "sign")
OWN = tuple(f"own.{i}" for i in range(12))  # room for the parameters of a user's own laws
PARAMETERS = np.dtype(
    [(n, float) for n in (*(n for t in TERMS.values() for n in t.names), "gain", "delay", *OWN)]
)
FLAGS = np.dtype([("laws", np.int64), *((name, bool) for name in (*TERMS, *_SWITCHES))])

_ALWAYS = ("viscous", "coulomb", "asymmetric-friction", "offset")
STRUCTURAL = ("presliding", "flexibility", "backlash")  # more than one rigid mass
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
    return njit(readers[len(names) - 1])


def _sum(names):
    """Compose the force laws of these terms into one compiled sum."""
    if not names:
        return njit(lambda q, v, s, tau, t, p: 0.0)
    before, term = _sum(names[:-1]), TERMS[names[-1]]
    law, fields = njit(error_model="numpy")(term.law), _fields(term.names)

    @njit(error_model="numpy", forceinline=True)
    def total(q, v, s, tau, t, p):
        return before(q, v, s, tau, t, p) + law(q, v, 0.0, s, tau, t, *fields(p))

    return total


def _one_of(names):
    """Compile the choice of one of these terms' laws by its bit; LLVM makes a jump table of it."""
    if not names:
        return njit(lambda bit, q, v, s, tau, t, p: 0.0)
    before, term, own_bit = _one_of(names[:-1]), TERMS[names[-1]], BITS[names[-1]]
    law, fields = njit(error_model="numpy")(term.law), _fields(term.names)

    @njit(error_model="numpy", forceinline=True)
    def chosen(bit, q, v, s, tau, t, p):
        if bit == own_bit:
            return law(q, v, 0.0, s, tau, t, *fields(p))
        return before(bit, q, v, s, tau, t, p)

    return chosen


BITS = {n: 1 << i for i, n in enumerate(n for n, t in TERMS.items() if t.law and n not in PLAIN)}
_first, _second, _third = (_fields(OWN[i : i + 4]) for i in (0, 4, 8))
plain_resistance = _sum(_ALWAYS)
_law = _one_of(tuple(BITS))


@njit(error_model="numpy")
def _law_of(bit, q, v, s, tau, t, p):
    return _law(bit, q, v, s, tau, t, p)


@cfunc(SCALAR_LAW)
def no_law(q, v, s, tau, t, own):
    """Stand in the slot of a user's own law."""
    return 0.0


def user_law(terms):
    """Compile the sum of a user's own laws for the kernel's slot."""

    def chain(terms):
        if not terms:
            return njit(lambda q, v, s, tau, t, own: 0.0)
        before, law = chain(terms[:-1]), njit(error_model="numpy")(terms[-1].law)
        first = sum(len(t.names) for t in terms[:-1])
        last = first + len(terms[-1].names)

        @njit(error_model="numpy")
        def total(q, v, s, tau, t, own):
            values = own[first:last]
            return before(q, v, s, tau, t, own) + law(q, v, 0.0, s, tau, t, *values)

        return total

    total = chain(terms)
    return cfunc(SCALAR_LAW)(lambda q, v, s, tau, t, own: total(q, v, s, tau, t, own))


@njit(error_model="numpy", forceinline=True)
def extra_resistance(q, v, s, tau, t, p, on, user):
    """Return the force of the effects that oppose a motion in direction s, N."""
    f, laws = 0.0, on["laws"]
    while laws:
        bit = laws & -laws
        f += _law_of(bit, q, v, s, tau, t, p)
        laws ^= bit
    if on["own"]:
        f += _own_law(q, v, s, tau, t, p, user)
    return f


@njit(error_model="numpy")
def _own_law(q, v, s, tau, t, p, user):
    return user(q, v, s, tau, t, (*_first(p), *_second(p), *_third(p)))


@njit(error_model="numpy")
def resistance(q, v, s, tau, t, p, on, user):
    """Return the force opposing a motion in direction s, N."""
    return plain_resistance(q, v, s, tau, t, p) + extra_resistance(q, v, s, tau, t, p, on, user)


@njit(error_model="numpy")
def masses_of(p, on):
    """Return (m1, m2, friction share of the load, k, c, gap) of the one or two masses."""
    m = p["inertia"]
    if on["backlash"]:
        r, share, hz, zeta, gap = (
            p["backlash.load_share"],
            p["backlash.load_friction"],
            p["backlash.contact_hz"],
            p["backlash.damping"],
            p["backlash.gap"],
        )
    elif on["flexibility"]:
        r, share, hz, zeta, gap = (
            p["flexibility.load_share"],
            p["flexibility.load_friction"],
            p["flexibility.frequency_hz"],
            p["flexibility.damping"],
            0.0,
        )
    else:
        return m, m, 0.0, 0.0, 0.0, 0.0
    reduced = m * r * (1.0 - r)
    w = 2.0 * np.pi * hz
    return m * (1.0 - r), m * r, share, reduced * w * w, 2.0 * zeta * reduced * w, gap


@njit(error_model="numpy", forceinline=True)
def nets(x, s1, s2, tau, t, p, on, user, masses):
    """Return the net forces on motor and load, N, and the bristle's rate, m/s."""
    q1, v1, q2, v2, z = x
    share = masses[2]
    rate = 0.0
    motor = (1.0 - share) * resistance(q1, v1, s1, tau, t, p, on, user)
    if on["presliding"]:
        up = resistance(q1, 0.0, 1.0, tau, t, p, on, user)
        level = 0.5 * (1.0 - share) * (up - resistance(q1, 0.0, -1.0, tau, t, p, on, user))
        rate = bristle_rate(z, v1, level, p["presliding.stiffness"])
        motor += p["presliding.stiffness"] * z + p["presliding.damping"] * rate - s1 * level
    if not (on["flexibility"] or on["backlash"]):
        return tau - motor, 0.0, rate
    link = coupling(q1 - q2, v1 - v2, masses[3], masses[4], masses[5])
    load = 0.0
    if share > 0.0:
        load = share * resistance(q2, v2, s2, tau, t, p, on, user)
    return tau - motor - link, link - load, rate


@njit(error_model="numpy", forceinline=True)
def rates(x, s1, s2, tau, t, p, on, user, masses):
    """Return dx/dt of the state x = (q1, v1, q2, v2, z); a mass with direction 0 stands still."""
    if on["presliding"] or on["sign"]:
        s1 = np.sign(x[1])
    net1, net2, rate = nets(x, s1, s2, tau, t, p, on, user, masses)
    a1 = net1 / masses[0] if s1 != 0.0 or on["presliding"] or on["sign"] else 0.0
    a2 = net2 / masses[1] if s2 != 0.0 else 0.0
    return x[1], a1, x[3], a2, rate
