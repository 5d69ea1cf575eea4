"""Steps: how one or two masses move while their directions of motion and their contact stay.

What is linear is solved exactly: one mass against viscous friction in closed form, two masses on a
spring by the series of their vibration. What is not, the laws of the effects and a bristle, enters
at two points of the step, its start and two thirds of it, from where a straight line through both
has the right impulse to third order (Radau's rule). Within a step the drive force is a straight
line, too.

Every step has the same arguments, so that `integrator` can locate events around any of them: the
state x = (q1, v1, q2, v2, z), the mode (s1, s2, side) of directions and contact, the length h, the
drive force at the start and its rate.
"""

# Compiled functions carry no annotations: Numba infers them, and mypy cannot see through it.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from __future__ import annotations

import numpy as np

from ..compiled import compiled, inlined
from ..physics.friction import bristle_deflection, bristle_rate
from .mechanics import LOADS, extra_resistance, friction_level, link_force, plain_line, rates

_LATE = 2.0 / 3.0
# how far two loads may lie apart between which the sums are straight: by so much differs what
# spring and damper do over a step, as the square of an angle
_NEAR = 0.3
_FIFTH, _SIXTH, _SEVENTH = 1.0 / 5.0, 1.0 / 6.0, 1.0 / 7.0  # dividing takes five times as long


@inlined
def _shift(x, h, k):
    return (
        x[0] + h * k[0],
        x[1] + h * k[1],
        x[2] + h * k[2],
        x[3] + h * k[3],
        x[4] + h * k[4],
    )


@compiled
def runge_kutta(x, h, tau, rise, t, p, on, user):
    """Move under friction that takes the sign of the velocity as it comes, by the classical rule.

    Also return the motor's acceleration at the start.
    """
    end = tau + rise * h
    middle = 0.5 * (tau + end)
    k1 = rates(x, tau, t, p, on, user)
    k2 = rates(_shift(x, 0.5 * h, k1), middle, t + 0.5 * h, p, on, user)
    k3 = rates(_shift(x, 0.5 * h, k2), middle, t + 0.5 * h, p, on, user)
    k4 = rates(_shift(x, h, k3), end, t + h, p, on, user)
    x = _shift(_shift(x, h / 6.0, k1), h / 3.0, k2)
    return _shift(_shift(x, h / 3.0, k3), h / 6.0, k4), k1[1]


# --- what is linear: one mass ------------------------------------------------------------------


@inlined
def phi(z):
    """Return phi1(z) = (1 - exp(-z))/z and phi2(z) = (1 - phi1(z))/z."""
    if abs(z) < 0.02:  # six terms of the series are exact to rounding
        rest = 1.0 - _FIFTH * z * (1.0 - _SIXTH * z * (1.0 - _SEVENTH * z))
        phi2 = 0.5 - _SIXTH * z * (1.0 - 0.25 * z * rest)
    else:
        phi2 = (1.0 + np.expm1(-z) / z) / z
    return 1.0 - z * phi2, phi2


@inlined
def _phi3(z):
    """Return phi3(z) = (1/2 - phi2(z))/z, by its series where z is small."""
    if abs(z) < 0.02:
        rest = 1.0 - _FIFTH * z * (1.0 - _SIXTH * z * (1.0 - _SEVENTH * z))
        return _SIXTH * (1.0 - 0.25 * z * rest)
    return (0.5 - phi(z)[1]) / z


@inlined
def glide(s, h, p):
    """Return how one rigid mass moves in direction s over h, friction linear in the velocity.

    The acceleration at the start is a = (tau - level) / M - rate v, and the force on its way adds
    the jerk j; with z = h rate the velocity gains a h phi1(z) + j h^2 phi2(z), the position
    h v + a h^2 phi2(z) + j h^3 phi3(z). Returned are level, rate and the factors of a and j.
    """
    level, slope = plain_line(s, p)
    rate = slope / p["inertia"]
    phi1, phi2 = phi(h * rate)
    return level, rate, h * phi1, h * h * phi2, h * h * h * _phi3(h * rate)


@inlined
def glided(q, v, h, tau, inertia, glide):
    """Return position, velocity and first acceleration of a motion under a held force."""
    level, rate, to_speed, to_place, _ = glide
    a = (tau - level) / inertia - rate * v
    return q + (h * v + to_place * a), v + to_speed * a, a


@inlined
def one_mass_step(q, v, z, s, h, tau, rise, t, glide, p, on, user):
    """Move one mass in direction s, given its `glide`; return q, v, z and the acceleration."""
    if not on["beyond"]:
        q, v, a = glided(q, v, h, tau, p["inertia"], glide)
        jerk = rise / p["inertia"]
        return q + jerk * glide[4], v + jerk * glide[3], z, a
    rod = bristle(q, v, z, h, tau, t, p, on, user)
    force = beyond(q, v, s, tau, t, rod, p, on, user)
    at, later = glided(q, v, h, tau - force, p["inertia"], glide), _LATE * h
    place, speed = q + later * (v + 0.5 * later * at[2]), v + later * at[2]
    late = beyond(place, speed, s, tau + rise * later, t + later, rod, p, on, user)
    jerk = (rise - (late - force) / later) / p["inertia"]
    place, speed = at[0] + jerk * glide[4], at[1] + jerk * glide[3]
    return place, speed, deflection(place, rod, p), at[2]


@inlined
def one_mass(x, mode, h, tau, rise, t, p, on, user):
    """Move one mass; also return its acceleration at the start."""
    if mode[0] == 0.0:
        return x, 0.0
    q, v, z, a = one_mass_step(
        x[0], x[1], x[4], mode[0], h, tau, rise, t, glide(mode[0], h, p), p, on, user
    )
    return (q, v, 0.0, 0.0, z), a


# --- what is linear: two masses ----------------------------------------------------------------


@inlined
def _swing(x, h, a1, a2, jerk, drag1, drag2, pull1, pull2, damp1, damp2, terms):
    """Sum the series of two masses on a spring; return the states at the end and late.

    The n-th terms r of the positions and u of the velocities follow from those before: r from u by
    integration, u by the law of motion.
    """
    q1, v1, q2, v2 = x[0], x[1], x[2], x[3]
    late_q1, late_v1, late_q2, late_v2 = q1, v1, q2, v2
    r1, r2, u1, u2, part = h * v1, h * v2, h * a1, h * a2, _LATE
    for n in range(2, terms + 2):
        q1, q2, v1, v2 = q1 + r1, q2 + r2, v1 + u1, v2 + u2
        late_q1, late_q2 = late_q1 + part * r1, late_q2 + part * r2
        late_v1, late_v2 = late_v1 + part * u1, late_v2 + part * u2
        stretch, g = r1 - r2, h / n
        r1, r2 = g * u1, g * u2
        u1, u2 = (  # as sums of products, which wait for each other least
            (g * jerk - g * pull1 * stretch) + (g * damp1 * u2 - g * (damp1 + drag1) * u1),
            g * pull2 * stretch + (g * damp2 * u1 - g * (damp2 + drag2) * u2),
        )
        part, jerk = part * _LATE, 0.0
    return (q1, v1, q2, v2, x[4]), (late_q1, late_v1, late_q2, late_v2)


@inlined
def _place(s):
    """Return where what belongs to a direction stands: back, at rest, ahead; NaN is at rest."""
    return 2 if s > 0.0 else (0 if s < 0.0 else 1)


@inlined
def _weights(s1, s2, p):
    """Return by what a force moves motor and load, 1/kg or 1/(kg m2): nothing that stands."""
    return 1.0 / p["motor"] if s1 != 0.0 else 0.0, 1.0 / p["load"] if s2 != 0.0 else 0.0


@inlined
def _vibration(x, h, a1, a2, jerk, mode, slopes, p):
    """Sum the series of two masses in one mode, which friction slows by these slopes."""
    w1, w2 = _weights(mode[0], mode[1], p)
    k, c = (p["k"], p["c"]) if mode[2] != 0.0 else (0.0, 0.0)
    drag1, drag2 = w1 * (1.0 - p["share"]) * slopes[0], w2 * p["share"] * slopes[1]
    return _swing(
        x, h, a1, a2, jerk, drag1, drag2, w1 * k, w2 * k, w1 * c, w2 * c, p["terms"]
    )  # fmt: skip


@compiled
def forget(p):
    """Begin with no sums, for a load that stays as it is."""
    p["lightness"], p["spacing"], p["node"], p["onwards"] = 1.0 / p["load"], 0.0, 0, 0.0
    p["there"][:] = 0


@compiled
def spread(least, most, h, p):
    """Choose loads from the least to the most for which series are summed up, over h at most."""
    p["lightness"] = 1.0 / most
    p["spacing"] = (1.0 / least - 1.0 / most) / (LOADS - 1)
    if p["spacing"] * h * (h * p["k"] + p["c"]) > _NEAR:
        p["spacing"] = -1.0  # too few of them: each step sums its own


@inlined
def laden(load, p):
    """Take another load, between two of those for which series are summed up.

    Between them the sums are straight lines over 1 / load, on which they depend smoothly. What they
    are applied to, the accelerations at the start, is that of the load itself.
    """
    p["load"] = load
    if p["spacing"] > 0.0:
        nodes = (1.0 / load - p["lightness"]) / p["spacing"]
        p["node"] = min(int(nodes), LOADS - 2)
        p["onwards"] = nodes - p["node"]


@compiled
def sum_up(node, span, s1, s2, touching, h, p):
    """Sum the series of two moving masses over h, once for all steps of its length.

    The series is linear in both velocities and accelerations and the motor's jerk at the start, so
    it is a matrix of five columns: of the ways of both, what their velocities gain, and the same
    late in the step.
    """
    i, j, lines = 1 if s1 > 0.0 else 0, 1 if s2 > 0.0 else 0, p["lines"]
    mode, slopes = (s1, s2, float(touching)), (lines[_place(s1), 1], lines[_place(s2), 1])
    load, unit, sums = p["load"], np.zeros(5), p["sums"][node, span, i, j, touching]
    p["load"] = 1.0 / (p["lightness"] + node * p["spacing"])
    for column in range(5):
        unit[:] = 0.0
        unit[column] = 1.0
        x = 0.0, unit[0], 0.0, unit[1], 0.0
        end, late = _vibration(x, h, unit[2], unit[3], unit[4], mode, slopes, p)
        for row in range(4):
            sums[row, column] = end[row]
            sums[4 + row, column] = late[row]
    p["load"], p["there"][node, span, i, j, touching] = load, 1


@inlined
def _sums(node, span, s1, s2, touching, h, p):
    """Return the sums of `sum_up`."""
    i, j = 1 if s1 > 0.0 else 0, 1 if s2 > 0.0 else 0
    if not p["there"][node, span, i, j, touching]:
        sum_up(node, span, s1, s2, touching, h, p)
    return p["sums"][node, span, i, j, touching]


@inlined
def _row(row, sums, v1, v2, a1, a2, jerk):
    """Return one of the sums."""
    return (
        sums[row, 0] * v1 + sums[row, 1] * v2
        + (sums[row, 2] * a1 + sums[row, 3] * a2) + sums[row, 4] * jerk
    )  # fmt: skip


@inlined
def _moved(x, row, sums, a1, a2, jerk):
    """Return the state to which the sums from this row on lead."""
    q1, v1, q2, v2, z = x
    return (
        q1 + _row(row, sums, v1, v2, a1, a2, jerk),
        _row(row + 1, sums, v1, v2, a1, a2, jerk),
        q2 + _row(row + 2, sums, v1, v2, a1, a2, jerk),
        _row(row + 3, sums, v1, v2, a1, a2, jerk),
        z,
    )


@inlined
def _towards(x, y, share):
    """Return the state that lies this share of the way from x to y."""
    return _shift(x, share, (y[0] - x[0], y[1] - x[1], y[2] - x[2], y[3] - x[3], y[4] - x[4]))


@compiled
def two_masses(x, mode, h, tau, rise, t, p, on, user, span=-1):
    """Move two masses; also return the motor's acceleration at the start.

    Over one of the two `span` lengths of a sample, for which series are summed up where both move,
    or any other.
    """
    s1, s2, side = mode
    w1, w2 = _weights(s1, s2, p)
    i, j, lines = _place(s1), _place(s2), p["lines"]
    level1, slope1, level2, slope2 = lines[i, 0], lines[i, 1], lines[j, 0], lines[j, 1]
    own = 1.0 - p["share"]
    rod = bristle(x[0], x[1], x[4], h, tau, t, p, on, user)
    f1, f2 = _beyond_both(x, mode, tau, t, rod, p, on, user)
    link = link_force(x, side, p)
    a1 = w1 * (tau - link - own * (level1 + slope1 * x[1]) - f1 - p["shift"])
    a2 = w2 * (link - p["share"] * (level2 + slope2 * x[3]) - f2 + p["shift"])
    jerk, middle = w1 * rise * h, (0.0, 0.0, 0.0, 0.0)
    if span < 0 or p["spacing"] < 0.0:
        y, middle = _vibration(x, h, a1, a2, jerk, mode, (slope1, slope2), p)
    else:
        touching, onwards = 1 if side != 0.0 else 0, p["onwards"]
        sums = _sums(p["node"], span, s1, s2, touching, h, p)
        y = _moved(x, 0, sums, a1, a2, jerk)
        if onwards > 0.0:
            more = _sums(p["node"] + 1, span, s1, s2, touching, h, p)
            y = _towards(y, _moved(x, 0, more, a1, a2, jerk), onwards)
        if on["beyond"]:
            late = _moved(x, 4, sums, a1, a2, jerk)
            if onwards > 0.0:
                late = _towards(late, _moved(x, 4, more, a1, a2, jerk), onwards)
            middle = late[0], late[1], late[2], late[3]
    if not on["beyond"]:
        return y, a1
    later = _LATE * h
    g1, g2 = _beyond_both(middle, mode, tau + rise * later, t + later, rod, p, on, user)
    jerk1, jerk2, half, third = w1 * (f1 - g1) / later, w2 * (f2 - g2) / later, h * h / 2, h**3 / 6
    q1 = y[0] + jerk1 * third
    z = deflection(q1, rod, p)
    return (q1, y[1] + jerk1 * half, y[2] + jerk2 * third, y[3] + jerk2 * half, z), a1


# --- what is not linear ------------------------------------------------------------------------


@inlined
def bristle(q, v, z, h, tau, t, p, on, user):
    """Return where the bristle starts, its deflection, and the friction it slides at, N."""
    if not on["presliding"]:
        return q, z, 0.0
    return q, z, friction_level(q + 0.5 * h * v, tau, t + 0.5 * h, p, on, user)


@inlined
def deflection(q, rod, p):
    """Return the deflection of the bristle at q, m or rad."""
    start, z, level = rod
    return bristle_deflection(z, q - start, level, p["bristle"]) if level > 0.0 else z


@inlined
def beyond(q, v, s, tau, t, rod, p, on, user):
    """Return the force that opposes the motor beyond plain friction, N."""
    force = (1.0 - p["share"]) * extra_resistance(q, v, s, tau, t, p, on, user)
    if on["presliding"]:
        z, level = deflection(q, rod, p), rod[2]
        rate = bristle_rate(z, v, level, p["bristle"])
        force += p["bristle"] * z + p["presliding.damping"] * rate - s * level
    return force


@inlined
def _beyond_both(x, mode, tau, t, rod, p, on, user):
    """Return the forces that oppose motor and load beyond plain friction, N."""
    if not on["beyond"]:
        return 0.0, 0.0
    load = 0.0
    if p["share"] > 0.0:
        load = p["share"] * extra_resistance(x[2], x[3], mode[1], tau, t, p, on, user)
    return beyond(x[0], x[1], mode[0], tau, t, rod, p, on, user), load
