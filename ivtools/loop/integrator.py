"""Integrator: from one sample to the next.

A step ends where its mode does: a mass reverses, breaks away, or meets the other one across a gap.
Each such event is located inside the step; at standstill the exact rule of dry friction decides
whether a mass stays or leaves: it leaves only in a direction in which the force exceeds the
friction there. No smoothing constant, no chatter, and the answer converges with the step.
"""

# Compiled functions carry no annotations: Numba infers them, and mypy cannot see through it.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..compiled import compiled, inlined
from ..physics.transmission import contact, contact_margin
from .mechanics import derive, link_force, load_net, motor_net
from .steps import forget, glide, glided, one_mass, one_mass_step, phi, runge_kutta, two_masses

_MAX_EVENTS = 8
_INSIDE = np.inf  # margin of what cannot happen


class Pace(NamedTuple):
    """How a span of the sample is integrated: so many steps of length h."""

    steps: int
    h: float  # s
    ahead: tuple  # `glide` of one rigid mass in both directions
    back: tuple
    first: float  # a lagging force as a straight line over a step: at its start, at its end,
    last: float
    decay: float  # and what remains of it for the next step
    span: int  # of the two in a sample, before and after the drive's delay


@compiled
def _pace(span, length, dt, p, on):
    steps = int(np.ceil(p["steps"] * length / dt - 1e-9))
    h = length / max(steps, 1)
    first = last = decay = 0.0
    if on["drive-timing"] and p["drive-timing.lag"] > 0.0:
        first, last, decay = lagging(h / p["drive-timing.lag"])
    return Pace(steps, h, glide(1.0, h, p), glide(-1.0, h, p), first, last, decay, span)


@compiled
def lagging(z):
    """Return a force that decays as exp(-z t/h), as a straight line over a step of length h.

    It may decay within a fraction of the step; the line has the same impulse and the same first
    moment, which is smooth in the lag down to none. Returned are its ends, and exp(-z).
    """
    mean, moment = phi(z)
    first = 6.0 * moment - 2.0 * mean
    return first, 2.0 * mean - first, np.exp(-z)


@compiled
def drive_delay(dt, p, on):
    """Return the drive's delay as whole samples and the fraction of one that is left."""
    delay = (p["delay"] + (p["drive-timing.delay"] if on["drive-timing"] else 0.0)) / dt
    whole = np.floor(delay + 1e-9)
    return int(whole), max(delay - whole, 0.0)


@compiled
def plan(dt, n, p, on):
    """Derive what the integrator needs; return the pace before and after the drive's delay."""
    derive(dt, n if on["effects"] else 1, p, on)  # a rigid axis is exact in one step
    first = drive_delay(dt, p, on)[1] * dt
    if on["two"]:
        forget(p)
    return _pace(0, first, dt, p, on), _pace(1, dt - first, dt, p, on)


@inlined
def heavier(inertia, planned, dt, n, p, on):
    """Give one mass another inertia; what depends on it is worked out where a step needs it.

    The bristle of one decides how long its steps are.
    """
    p["inertia"] = p["motor"] = inertia
    return plan(dt, n, p, on) if on["presliding"] else planned


@inlined
def _glide_of(s, pace, p, on):
    """Return how one rigid mass glides in direction s over a step."""
    if on["turns"]:
        return glide(1.0 if s > 0.0 else -1.0, pace.h, p)
    return pace.ahead if s > 0.0 else pace.back


# --- modes: directions of motion, and the side of contact --------------------------------------


@compiled
def _motor_leaving(x, link, tau, t, p, on, user):
    """Return the net force on the motor if it moved ahead, and if it moved back."""
    up = motor_net(x, 1.0, link, tau, t, p, on, user)
    return up, motor_net(x, -1.0, link, tau, t, p, on, user)


@compiled
def _load_leaving(x, link, tau, t, p, on, user):
    """Do the same for the load."""
    up = load_net(x, 1.0, link, tau, t, p, on, user)
    return up, load_net(x, -1.0, link, tau, t, p, on, user)


@inlined
def _direction(leaving):
    """Return the direction in which a mass at rest leaves; 0 if it stays."""
    up, down = leaving
    return 1.0 if up > 0.0 else (-1.0 if down < 0.0 else 0.0)


@inlined
def _held(leaving):
    """Return how much more force holds a mass at rest, N."""
    up, down = leaving
    return min(-up, down)


@compiled
def _mode(x, side, tau, t, p, on, user):
    """Return the mode (s1, s2, side): directions of motion, 0 at standstill, and the contact."""
    s1, s2 = np.sign(x[1]), 0.0
    link = link_force(x, side, p)
    if s1 == 0.0:
        s1 = _direction(_motor_leaving(x, link, tau, t, p, on, user))
    if on["two"]:
        s2 = np.sign(x[3])
        if s2 == 0.0:
            s2 = _direction(_load_leaving(x, link, tau, t, p, on, user))
    return s1, s2, side


@compiled
def _margins(x, mode, tau, t, p, on, user):
    """Return how far motor, load and contact are from leaving the mode; negative once they have."""
    s1, s2, side = mode
    motor, load, meeting = s1 * x[1], s2 * x[3], _INSIDE
    link = link_force(x, side, p)
    if s1 == 0.0:
        motor = _held(_motor_leaving(x, link, tau, t, p, on, user))
    if not on["two"]:
        return motor, _INSIDE, _INSIDE
    if s2 == 0.0:
        load = _held(_load_leaving(x, link, tau, t, p, on, user))
    if p["gap"] > 0.0:
        stretch, rate = x[0] - x[2], x[1] - x[3]
        meeting = contact_margin(stretch, rate, side, p["k"], p["c"], p["gap"])
    return motor, load, meeting


# --- events ------------------------------------------------------------------------------------


@inlined
def _step(x, mode, h, tau, rise, t, p, on, user):
    """Move over h in one mode; also return the motor's acceleration at the start."""
    if h <= 0.0:
        return x, 0.0
    if on["two"]:
        return two_masses(x, mode, h, tau, rise, t, p, on, user)
    return one_mass(x, mode, h, tau, rise, t, p, on, user)


@inlined
def _first(before, after):
    """Return which margin is the first to be used up, on straight lines."""
    which, earliest = 0, 2.0
    for i in range(3):
        if after[i] < 0.0:
            start = max(before[i], 0.0)
            if start / (start - after[i]) < earliest:
                which, earliest = i, start / (start - after[i])
    return which


@compiled
def _event(x, mode, after, h, tau, rise, t, p, on, user):
    """Return state and time of the first event, and which it is; `after` are margins behind it."""
    before = _margins(x, mode, tau, t, p, on, user)
    which = _first(before, after)
    a, va, b, vb, c, y = 0.0, max(before[which], 0.0), h, after[which], 0.0, x
    for _ in range(4):  # margins are nearly straight over a step: secants are enough
        c = a + (b - a) * va / (va - vb)
        y, _ = _step(x, mode, c, tau, rise, t, p, on, user)
        margin = _margins(y, mode, tau + rise * c, t + c, p, on, user)[which]
        if margin > 0.0:
            a, va = c, margin
        else:
            b, vb = c, margin
        if va == vb or vb == 0.0:
            break
    return y, c, which


@compiled
def _breaking_away(i, x, side, tau, t, p, on, user):
    """Return the direction in which the motor (0) or the load (1) is pulled."""
    link = link_force(x, side, p)
    if i == 0:
        up, down = _motor_leaving(x, link, tau, t, p, on, user)
    else:
        up, down = _load_leaving(x, link, tau, t, p, on, user)
    return np.sign(up + down)


@compiled
def _after(x, which, pulled, side, tau, t, p, on, user):
    """Return state and mode after a reversal, a break-away or a change of contact."""
    q1, v1, q2, v2, z = x
    if which == 2:
        side = 0.0 if side != 0.0 else np.sign(q1 - q2)
        return x, _mode(x, side, tau, t, p, on, user)
    x = (q1, v1 if which else 0.0, q2, v2 if which == 0 else 0.0, z)
    s1, s2, _ = _mode(x, side, tau, t, p, on, user)
    if pulled != 0.0:
        return x, (s1 if which else pulled, s2 if which == 0 else pulled, side)
    return x, (s1, s2, side)


@compiled
def _past_events(x, y, mode, margins, h, tau, rise, t, p, on, user):
    """Move over h, stopping at every event on the way; y is where a step in one mode has led."""
    for _ in range(_MAX_EVENTS):
        here, used, which = _event(x, mode, margins, h, tau, rise, t, p, on, user)
        pulled = 0.0
        if which < 2 and mode[which] == 0.0:  # it breaks away, as the force behind the event wants
            pulled = _breaking_away(which, y, mode[2], tau + rise * h, t + h, p, on, user)
        h, t, tau = h - used, t + used, tau + rise * used
        x, mode = _after(here, which, pulled, mode[2], tau, t, p, on, user)
        y, _ = _step(x, mode, h, tau, rise, t, p, on, user)
        margins = _margins(y, mode, tau + rise * h, t + h, p, on, user)
        if min(margins) >= 0.0:
            return y
    # so many events are chatter about standstill: what rests now rests to the end of the step
    mode = np.sign(x[1]), np.sign(x[3]), mode[2]
    return _step(x, mode, h, tau, rise, t, p, on, user)[0]


@compiled
def _through(x, h, tau, rise, t, p, on, user):
    """Move over h, through whatever happens; also return the motor's first acceleration."""
    side = 0.0
    if on["two"]:
        side = contact(x[0] - x[2], x[1] - x[3], p["k"], p["c"], p["gap"])
    mode = _mode(x, side, tau, t, p, on, user)
    y, a = _step(x, mode, h, tau, rise, t, p, on, user)
    margins = _margins(y, mode, tau + rise * h, t + h, p, on, user)
    if min(margins) >= 0.0:
        return y, a
    return _past_events(x, y, mode, margins, h, tau, rise, t, p, on, user), a


# --- from one sample to the next ---------------------------------------------------------------


@inlined
def rigid_step(q, v, tau, pace, p, on, user):
    """Advance one rigid mass over one sample under a held force; also return the acceleration."""
    glides = _glide_of(v, pace, p, on)
    place, speed, a = glided(q, v, pace.h, tau, p["inertia"], glides)
    if v * speed > 0.0:  # no reversal on the way
        return place, speed, a
    x, a = _through((q, v, 0.0, 0.0, 0.0), pace.h, tau, 0.0, 0.0, p, on, user)
    return x[0], x[1], a


@inlined
def _advance(x, tau, rise, t, pace, p, on, user):
    """Move over one step; also return the motor's acceleration at the start."""
    h = pace.h
    if on["sign"]:
        return runge_kutta(x, h, tau, rise, t, p, on, user)
    if x[1] != 0.0 and not on["two"]:
        s = np.sign(x[1])
        glides = _glide_of(s, pace, p, on)
        q, v, z, a = one_mass_step(x[0], x[1], x[4], s, h, tau, rise, t, glides, p, on, user)
        if v * s > 0.0:  # no reversal on the way
            return (q, v, 0.0, 0.0, z), a
    if on["two"] and x[1] != 0.0 and x[3] != 0.0:
        k, c, gap = p["k"], p["c"], p["gap"]
        side = contact(x[0] - x[2], x[1] - x[3], k, c, gap) if gap > 0.0 else 1.0
        mode = np.sign(x[1]), np.sign(x[3]), side
        y, a = two_masses(x, mode, h, tau, rise, t, p, on, user, pace.span)
        moves = y[1] * mode[0] > 0.0 and y[3] * mode[1] > 0.0  # nothing happens on the way
        if moves and (gap <= 0.0 or contact_margin(y[0] - y[2], y[1] - y[3], side, k, c, gap) > 0):
            return y, a
    return _through(x, h, tau, rise, t, p, on, user)


@inlined
def _segment(x, force, command, slope, disturbance, t, pace, p, on, user):
    """Advance over a span in which the command is held, or ramps."""
    target, rise, h = p["gain"] * command, p["gain"] * slope, pace.h
    lagging, acceleration = force - target, 0.0
    for i in range(pace.steps):
        tau = target + disturbance + rise * (i * h) + lagging * pace.first
        over = rise + lagging * (pace.last - pace.first) / h
        x, a = _advance(x, tau, over, t + i * h, pace, p, on, user)
        lagging, acceleration = lagging * pace.decay, a if i == 0 else acceleration
    return x, target + rise * (pace.steps * h) + lagging, acceleration


@inlined
def plant_step(x, force, old, new, slope, disturbance, t, plan, p, on, user):
    """Advance drive and mechanics over one sample.

    Parameters
    ----------
    x : tuple of 5 float
        Positions and velocities of motor and load, and the bristle's deflection.
    force : float
        Drive force at the start of the sample, N; it matters only if the drive lags.
    old, new : float
        The command before and after the drive's delay has passed within this sample.
    slope : float
        Slope of the command, 1/s (0 for a held one).
    disturbance : float
        Force from outside over the sample, N.
    t : float
        Time at the start of the sample, s.
    plan : tuple
        The pace before and after the delay has passed, from `plan`.
    p, on, user
        Parameters, flags, and the slot of a user's own law.

    Returns
    -------
    x, force : the same at the end of the sample
    acceleration : float
        Acceleration at the start of the sample, m/s2 or rad/s2.
    """
    before, after = plan
    if not on["effects"]:
        tau = p["gain"] * new + disturbance
        q, v, acceleration = rigid_step(x[0], x[1], tau, after, p, on, user)
        return (q, v, 0.0, 0.0, 0.0), force, acceleration
    if before.steps == 0:
        return _segment(x, force, new, slope, disturbance, t, after, p, on, user)
    x, force, a = _segment(x, force, old, slope, disturbance, t, before, p, on, user)
    passed = before.steps * before.h
    late, t = new + slope * passed, t + passed
    x, force, _ = _segment(x, force, late, slope, disturbance, t, after, p, on, user)
    return x, force, a
