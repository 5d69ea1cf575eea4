"""Steps: how one or two masses move over a span in which their directions of motion stay.

In closed form where it is one rigid mass with friction linear in the velocity, else by the
classical Runge-Kutta method. Every step has the same arguments, so that `integrator` can locate
reversals around any of them.
"""

# Compiled functions carry no annotations: Numba infers them, and mypy cannot see through it.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from __future__ import annotations

import numpy as np
from numba import njit

from .mechanics import extra_resistance, plain_resistance, rates


@njit(error_model="numpy", forceinline=True)
def _shift(x, h, k):
    return (
        x[0] + h * k[0],
        x[1] + h * k[1],
        x[2] + h * k[2],
        x[3] + h * k[3],
        x[4] + h * k[4],
    )


@njit(error_model="numpy", forceinline=True)
def force_at(drive, t):
    """Return the drive force at time t of the segment: held, ramped, or lagging."""
    target, jump, lag, slope = drive
    if lag > 0.0:
        return target + jump * np.exp(-t / lag)
    return target + slope * t


@njit(error_model="numpy", forceinline=True)
def phi(z):
    """Return phi1(z) = (1 - exp(-z))/z and phi2(z) = (1 - phi1(z))/z."""
    if abs(z) < 0.02:  # six terms of the series are exact to rounding
        phi2 = 0.5 - z / 6 * (1.0 - z / 4 * (1.0 - z / 5 * (1.0 - z / 6 * (1.0 - z / 7))))
    else:
        phi2 = (1.0 + np.expm1(-z) / z) / z
    return 1.0 - z * phi2, phi2


@njit(error_model="numpy", forceinline=True)
def forces(drive, at, h):
    """Return the drive force at the start, the middle and the end of a step.

    A lagging force may decay within a fraction of the step. It enters as the straight line with
    the same impulse and the same first moment, which is smooth in the lag down to none.
    """
    target, jump, lag, slope = drive
    start, end = target + slope * at, target + slope * (at + h)
    if lag > 0.0:
        mean, moment = phi(h / lag)
        jump *= np.exp(-at / lag)
        first = 6.0 * moment - 2.0 * mean
        start, end = start + jump * first, end + jump * (2.0 * mean - first)
    return start, 0.5 * (start + end), end


@njit(error_model="numpy")
def runge_kutta(x, s1, s2, h, drive, at, t, p, on, user, masses):
    """Move one or two masses, and a bristle; also return the motor's acceleration at the start."""
    start, middle, end = forces(drive, at, h)
    k1 = rates(x, s1, s2, start, t, p, on, user, masses)
    k2 = rates(_shift(x, 0.5 * h, k1), s1, s2, middle, t + 0.5 * h, p, on, user, masses)
    k3 = rates(_shift(x, 0.5 * h, k2), s1, s2, middle, t + 0.5 * h, p, on, user, masses)
    k4 = rates(_shift(x, h, k3), s1, s2, end, t + h, p, on, user, masses)
    x = _shift(_shift(x, h / 6.0, k1), h / 3.0, k2)
    return _shift(_shift(x, h / 3.0, k3), h / 6.0, k4), k1[1]


@njit(error_model="numpy")
def one_mass_step(q, v, s, h, start, middle, end, t, p, on, user):
    """Move one mass in direction s; return position, velocity and the first acceleration."""
    half, w = 0.5 * h, 1.0 / p["inertia"] if s != 0.0 else 0.0
    level = plain_resistance(0.0, 0.0, s, 0.0, 0.0, p)
    rate = w * (plain_resistance(0.0, 1.0, s, 0.0, 0.0, p) - level)
    a1 = w * (start - level - extra_resistance(q, v, s, start, t, p, on, user)) - rate * v
    v2, q2 = v + half * a1, q + half * v
    f2 = extra_resistance(q2, v2, s, middle, t + half, p, on, user)
    a2 = w * (middle - level - f2) - rate * v2
    v3, q3 = v + half * a2, q + half * v2
    f3 = extra_resistance(q3, v3, s, middle, t + half, p, on, user)
    a3 = w * (middle - level - f3) - rate * v3
    v4, q4 = v + h * a3, q + h * v3
    f4 = extra_resistance(q4, v4, s, end, t + h, p, on, user)
    a4 = w * (end - level - f4) - rate * v4
    return q + h / 6.0 * (v + 2.0 * (v2 + v3) + v4), v + h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4), a1


@njit(error_model="numpy", forceinline=True)
def one_mass(x, s1, s2, h, drive, at, t, p, on, user, masses):
    """Move one mass under any force, by Runge-Kutta."""
    start, middle, end = forces(drive, at, h)
    q, v, a = one_mass_step(x[0], x[1], s1, h, start, middle, end, t, p, on, user)
    return (q, v, 0.0, 0.0, 0.0), a


@njit(error_model="numpy", forceinline=True)
def glide(s, h, p):
    """Return how one rigid mass moves in direction s over h, friction linear in the velocity.

    The acceleration at the start is a = (tau - level) / M - rate v; with z = h rate the velocity
    gains a h phi1(z), the position h v + a h^2 phi2(z); exact under a held force. Returned are
    level, rate and both factors of a.
    """
    level = plain_resistance(0.0, 0.0, s, 0.0, 0.0, p)
    rate = (plain_resistance(0.0, 1.0, s, 0.0, 0.0, p) - level) / p["inertia"]
    phi1, phi2 = phi(h * rate)
    return level, rate, h * phi1, h * h * phi2


@njit(error_model="numpy", forceinline=True)
def glided(q, v, h, tau, inertia, glide):
    """Return position, velocity and first acceleration of a motion that `glide` describes."""
    level, rate, to_speed, to_place = glide
    a = (tau - level) / inertia - rate * v
    return q + (h * v + to_place * a), v + to_speed * a, a


@njit(error_model="numpy")
def closed_form(x, s1, s2, h, drive, at, t, p, on, user, masses):
    """Move one rigid mass under a held force."""
    if s1 == 0.0:
        return x, 0.0
    q, v, a = glided(x[0], x[1], h, drive[0], p["inertia"], glide(s1, h, p))
    return (q, v, 0.0, 0.0, 0.0), a
