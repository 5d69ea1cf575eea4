"""Integrator: from one sample to the next.

A reversal is located inside the step, where the exact rule of dry friction decides whether the axis
stays or leaves: it leaves only in a direction in which the force exceeds the friction there. No
smoothing constant, no chatter, and the answer converges with the step at the method's order.
"""

# Compiled functions carry no annotations: Numba infers them, and mypy cannot see through it.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from __future__ import annotations

import numpy as np
from numba import njit

from .mechanics import masses_of, nets, resistance
from .steps import (
    closed_form,
    force_at,
    forces,
    glide,
    glided,
    one_mass,
    one_mass_step,
    runge_kutta,
)

_MAX_EVENTS, _MAX_SUBSTEPS = 8, 64


@njit(error_model="numpy")
def _direction(up, down):
    """Return the direction in which a mass at rest leaves; 0 if it stays."""
    return 1.0 if up > 0.0 else (-1.0 if down < 0.0 else 0.0)


@njit(error_model="numpy", forceinline=True)
def _rigid_directions(x, tau, t, p, on, user, masses):
    """Return the directions of motion (s1, s2) of motor and load; 0 is standstill."""
    if x[1] != 0.0:
        return np.sign(x[1]), 0.0
    up = tau - resistance(x[0], 0.0, 1.0, tau, t, p, on, user)
    down = tau - resistance(x[0], 0.0, -1.0, tau, t, p, on, user)
    return _direction(up, down), 0.0


@njit(error_model="numpy")
def _directions(x, tau, t, p, on, user, masses):
    """Do the same for two masses; a bristle has no standstill and gives 0 for its mass."""
    if on["sign"]:  # friction as its formula says, with no rule of standstill
        return 0.0, 0.0
    s1 = np.sign(x[1]) if not on["presliding"] else 0.0
    s2 = np.sign(x[3]) if on["flexibility"] or on["backlash"] else 0.0
    if x[1] == 0.0 and not on["presliding"]:
        up, _, _ = nets(x, 1.0, s2, tau, t, p, on, user, masses)
        down, _, _ = nets(x, -1.0, s2, tau, t, p, on, user, masses)
        s1 = _direction(up, down)
    if x[3] == 0.0 and (on["flexibility"] or on["backlash"]):
        _, up, _ = nets(x, s1, 1.0, tau, t, p, on, user, masses)
        _, down, _ = nets(x, s1, -1.0, tau, t, p, on, user, masses)
        s2 = _direction(up, down)
    return s1, s2


def _build(step, directions):
    """Compile the advance over one sample around a plain step and its rule of standstill."""

    @njit(error_model="numpy")
    def reversal(x, y, s1, s2, h, drive, at, t, p, on, user, masses):
        """Return the state and time at which the first of the velocities reaches zero."""
        motor = x[1] / (x[1] - y[1]) if y[1] * s1 < 0.0 else 2.0
        load = x[3] / (x[3] - y[3]) if y[3] * s2 < 0.0 else 2.0
        first = 1 if motor <= load else 3
        a, va, b, vb, c = 0.0, x[first], h, y[first], 0.0
        for _ in range(4):  # the velocity is nearly straight over a step: secants are enough
            c = a + (b - a) * va / (va - vb)
            y, _ = step(x, s1, s2, c, drive, at, t, p, on, user, masses)
            if y[first] * va > 0.0:
                a, va = c, y[first]
            else:
                b, vb = c, y[first]
            if va == vb or vb == 0.0:
                break
        return (y[0], y[1] * (first != 1), y[2], y[3] * (first != 3), y[4]), c

    @njit(error_model="numpy")
    def past_reversals(x, y, s1, s2, h, drive, at, t, p, on, user, masses):
        """Integrate over h, stopping at every reversal on the way; y is where a step led."""
        for _ in range(_MAX_EVENTS):
            x, used = reversal(x, y, s1, s2, h, drive, at, t, p, on, user, masses)
            h, at, t = h - used, at + used, t + used
            s1, s2 = directions(x, forces(drive, at, h)[0], t, p, on, user, masses)
            y, _ = step(x, s1, s2, h, drive, at, t, p, on, user, masses)
            if y[1] * s1 >= 0.0 and y[3] * s2 >= 0.0:
                return y
        # so many events are chatter about standstill: what rests now rests to the end of the step
        y, _ = step(x, np.sign(x[1]), np.sign(x[3]), h, drive, at, t, p, on, user, masses)
        return y

    @njit(error_model="numpy")
    def advance(x, h, drive, at, t, p, on, user, masses):
        """Integrate over h; also return the motor's acceleration at the start."""
        s1, s2 = directions(x, forces(drive, at, h)[0], t, p, on, user, masses)
        y, a = step(x, s1, s2, h, drive, at, t, p, on, user, masses)
        if y[1] * s1 >= 0.0 and y[3] * s2 >= 0.0:
            return y, a
        return past_reversals(x, y, s1, s2, h, drive, at, t, p, on, user, masses), a

    return advance


_rigid = _build(closed_form, _rigid_directions)
_general = _build(one_mass, _rigid_directions)
_structure = _build(runge_kutta, _directions)


@njit(error_model="numpy", forceinline=True)
def glides(dt, p):
    """Return what `rigid_step` needs to know of motions ahead and back over a whole sample."""
    return glide(1.0, dt, p), glide(-1.0, dt, p)


@njit(error_model="numpy", forceinline=True)
def rigid_step(q, v, tau, dt, ahead_and_back, p, on, user):
    """Advance one rigid mass over one sample under a held force; also return the acceleration."""
    ahead, back = ahead_and_back
    place, speed, a = glided(q, v, dt, tau, p["inertia"], ahead if v > 0.0 else back)
    if v * speed > 0.0:  # no reversal on the way
        return place, speed, a
    held = (tau, 0.0, 0.0, 0.0)
    x, a = _rigid((q, v, 0.0, 0.0, 0.0), dt, held, 0.0, 0.0, p, on, user, (0.0,) * 6)
    return x[0], x[1], a


@njit(error_model="numpy")
def _substeps(x, h, n, p, on, user):
    """Return how many steps this span needs: a moving bristle is stiff."""
    if on["presliding"]:
        up = resistance(x[0], 0.0, 1.0, 0.0, 0.0, p, on, user)
        level = 0.5 * (up - resistance(x[0], 0.0, -1.0, 0.0, 0.0, p, on, user))
        if level > 0.0:
            stiff = p["presliding.stiffness"] * abs(x[1]) * h / (1.5 * level)
            return min(max(n, int(np.ceil(stiff))), _MAX_SUBSTEPS)
    return n


@njit(error_model="numpy")
def drive_delay(dt, p, on):
    """Return the drive's delay as whole samples and the fraction of one that is left."""
    delay = (p["delay"] + (p["drive-timing.delay"] if on["drive-timing"] else 0.0)) / dt
    whole = np.floor(delay + 1e-9)
    return int(whole), max(delay - whole, 0.0)


@njit(error_model="numpy")
def _segment(x, force, command, span, slope, disturbance, t, n, p, on, user):
    """Advance over a span in which the command is held, or ramps."""
    lag = p["drive-timing.lag"] if on["drive-timing"] else 0.0
    target = p["gain"] * command
    drive = (target + disturbance, force - target, lag, p["gain"] * slope)
    masses, steps = masses_of(p, on), _substeps(x, span, n, p, on, user)
    h, acceleration = span / steps, 0.0
    for i in range(steps):
        if on["structure"]:
            x, a = _structure(x, h, drive, i * h, t + i * h, p, on, user, masses)
        else:
            x, a = _general(x, h, drive, i * h, t + i * h, p, on, user, masses)
        acceleration = a if i == 0 else acceleration
    return x, force_at(drive, span) - disturbance, acceleration


@njit(error_model="numpy")
def plant_step(x, force, old, new, part, slope, disturbance, t, dt, n, p, on, user):
    """Advance drive and mechanics over one sample.

    Parameters
    ----------
    x : tuple of 5 float
        Positions and velocities of motor and load, and the bristle's deflection.
    force : float
        Drive force at the start of the sample, N; it matters only if the drive lags.
    old, new : float
        The command before and after the drive's delay has passed within this sample.
    part : float
        The fraction of the sample at which it has passed.
    slope : float
        Slope of the command, 1/s (0 for a held one).
    disturbance : float
        Force from outside over the sample, N.
    t, dt : float
        Time at the start of the sample and its length, s.
    n : int
        Integration steps per sample.
    p, on, user
        Parameters, flags, and the slot of a user's own law.

    Returns
    -------
    x, force : the same at the end of the sample
    acceleration : float
        Acceleration at the start of the sample, m/s2 or rad/s2.
    """
    if not on["effects"]:
        tau = p["gain"] * new + disturbance
        q, v, acceleration = rigid_step(x[0], x[1], tau, dt, glides(dt, p), p, on, user)
        return (q, v, 0.0, 0.0, 0.0), force, acceleration
    if on["held"] and n == 1 and x[1] != 0.0:
        tau, s = p["gain"] * new + disturbance, np.sign(x[1])
        q, v, acceleration = one_mass_step(x[0], x[1], s, dt, tau, tau, tau, t, p, on, user)
        if v * s > 0.0:  # no reversal on the way
            return (q, v, 0.0, 0.0, 0.0), force, acceleration
    if part == 0.0:  # a command that switches inside the sample makes two segments
        return _segment(x, force, new, dt, slope, disturbance, t, n, p, on, user)
    first, rest = part * dt, dt - part * dt
    x, force, acceleration = _segment(x, force, old, first, slope, disturbance, t, n, p, on, user)
    late, t = new + slope * first, t + first
    x, force, _ = _segment(x, force, late, rest, slope, disturbance, t, n, p, on, user)
    return x, force, acceleration
