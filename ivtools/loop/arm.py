"""Arm: how coupled joints move, from one instant to the next, with dry friction in each.

Within a step the mass matrix is that of its start. What is linear then, viscous friction and the
held forces, is solved by its series; what is not, the change of mass matrix, centrifugal forces,
gravity and effects, enters at two points, the start and two thirds of the step, as in `steps`.

A joint at rest is held while friction can: it leaves the Cholesky factor of the mass matrix.
Which joints hold is a complementarity problem, solved by principal pivoting, whose least-index
rule ends for a positive definite matrix (Murty 1974). Reversals and break-aways are located by
secants inside the step, as in `integrator`. With one joint this is what those two modules do.
"""

# Compiled functions carry no annotations: Numba infers them, and mypy cannot see through it.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiled import compiled, inlined
from ..robot.dynamics import Frames, Tree, frames, move, place, react, weigh
from .mechanics import friction_level, plain_line, resistance
from .steps import beyond, bristle, deflection

Array = NDArray[np.float64]

_LATE = 2.0 / 3.0
_MAX_EVENTS = 8  # per joint and step
_MAX_TERMS = 40
_NOTHING = 1e-17


class Arm(NamedTuple):
    """What moves.

    Attributes
    ----------
    tree : Tree
    phi : (n, 10) ndarray
        Standard parameters of the links.
    armature : (n,) ndarray
        Inertia of the drives, kg m2 or kg.
    coupling : (n, n) ndarray
        Joint positions are ``coupling @ q``; q belongs to the drives.
    coupled : bool
        Whether `coupling` is other than the identity.
    p, on : (n,) ndarray of records
        Parameters and flags of each joint's terms, `mechanics.PARAMETERS` and `FLAGS`.
    """

    tree: Tree
    phi: Array
    armature: Array
    coupling: Array
    coupled: bool
    p: NDArray[np.void]
    on: NDArray[np.void]


class State(NamedTuple):
    """Positions and velocities of the drives, and deflections of their bristles, (n,) each."""

    q: Array
    v: Array
    z: Array


class Room(NamedTuple):
    """Room for the dynamics at one state, used again and again.

    Attributes
    ----------
    at : Frames
    M, L : (n, n) ndarray
        Mass matrix, and the inverse of its Cholesky factor without the joints that are held.
    bias : (n,) ndarray
        Forces that the motion asks for without acceleration.
    level, slope, force : (n,) ndarray
        Friction as a straight line over velocity, and the forces beyond it.
    a, u, f, w : (n,) ndarray
        Acceleration, and scratch.
    """

    at: Frames
    M: Array
    L: Array
    bias: Array
    level: Array
    slope: Array
    force: Array
    a: Array
    u: Array
    f: Array
    w: Array


@inlined
def room(n):
    """Return room for n joints."""
    return Room(
        frames(n),
        np.empty((n, n)),
        np.empty((n, n)),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty(n),
    )


@inlined
def state(n):
    """Return a state of n joints, at rest."""
    return State(np.zeros(n), np.zeros(n), np.zeros(n))


@inlined
def copy(x, y):
    """Copy state x into y."""
    for i in range(x.q.size):
        y.q[i], y.v[i], y.z[i] = x.q[i], x.v[i], x.z[i]


# --- dynamics at one state ---------------------------------------------------------------------


@compiled
def _through(T, x):
    """Return T x."""
    out = np.zeros(x.size)
    for i in range(x.size):
        for j in range(x.size):
            out[i] += T[i, j] * x[j]
    return out


@compiled
def _back(T, x):
    """Replace x by T' x."""
    out = np.zeros(x.size)
    for i in range(x.size):
        for j in range(x.size):
            out[i] += T[j, i] * x[j]
    x[:] = out


@inlined
def required(arm, r, v, a, out):
    """Fill out with the forces that a motion asks for, the frames being in place."""
    if arm.coupled:
        move(arm.tree, _through(arm.coupling, v), _through(arm.coupling, a), r.at)
        react(arm.tree, arm.phi, r.at, out)
        _back(arm.coupling, out)
    else:
        move(arm.tree, v, a, r.at)
        react(arm.tree, arm.phi, r.at, out)
    for i in range(out.size):
        out[i] += arm.armature[i] * a[i]


@inlined
def put(arm, r, q):
    """Put the frames of the links for positions q of the drives."""
    if arm.coupled:
        place(arm.tree, _through(arm.coupling, q), r.at)
    else:
        place(arm.tree, q, r.at)


@inlined
def settle(arm, r, x):
    """Fill in mass matrix and bias at a state."""
    n = x.q.size
    put(arm, r, x.q)
    weigh(arm.tree, arm.phi, r.at, r.M)
    if arm.coupled:
        for i in range(n):
            _back(arm.coupling, r.M[i])
        for j in range(n):
            r.u[:] = r.M[:, j]
            _back(arm.coupling, r.u)
            r.M[:, j] = r.u
    for i in range(n):
        r.M[i, i] += arm.armature[i]
        r.u[i] = 0.0
    required(arm, r, x.v, r.u, r.bias)


@inlined
def factor(r, mode):
    """Fill r.L with the inverse of the Cholesky factor of the mass matrix of the joints that move.

    Returns whether the matrix is positive definite. A step solves with it some seven times, and a
    product has no row that waits for the one before, as a substitution has.
    """
    n, L = mode.size, r.L
    for i in range(n):
        for j in range(i + 1):
            held = mode[i] == 0.0 or mode[j] == 0.0
            total = (1.0 if i == j else 0.0) if held else r.M[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = total * L[j, j]
            elif total > 0.0:
                L[i, i] = 1.0 / np.sqrt(total)  # already that of the inverse
            else:
                return False
    for i in range(n):
        for j in range(i):
            total = 0.0
            for k in range(j, i):
                total -= L[i, k] * L[k, j]
            L[i, j] = total * L[i, i]
    return True


@inlined
def solve(L, b):
    """Replace b by the accelerations under it, `L` being what `factor` has filled in."""
    n = b.size
    for i in range(n - 1, -1, -1):
        total = 0.0
        for k in range(i + 1):
            total += L[i, k] * b[k]
        b[i] = total
    for i in range(n):
        total = 0.0
        for k in range(i, n):
            total += L[k, i] * b[k]
        b[i] = total


@compiled
def _settled(arm, r, x):
    """Do as `settle`, called: for what happens now and then."""
    settle(arm, r, x)


@compiled
def _factored(r, mode):
    """Do as `factor`, called."""
    return factor(r, mode)


# --- which joints hold ---------------------------------------------------------------------------


@compiled
def _resists(arm, j, x, s, tau, t, user):
    """Return the force with which joint j at rest resists to move in direction s."""
    p, on = arm.p[j], arm.on[j]
    force = resistance(x.q[j], x.v[j], s, tau[j], t, p, on, user)
    if on["presliding"]:
        force += p["bristle"] * x.z[j] - s * friction_level(x.q[j], tau[j], t, p, on, user)
    return force


@compiled
def _pushed(arm, r, x, mode, tau, t, user):
    """Fill r.a with the accelerations in a mode, and r.f with what is left on held joints."""
    n = mode.size
    for i in range(n):
        r.f[i] = tau[i] - r.bias[i]
        r.a[i] = 0.0
        if mode[i] != 0.0:
            r.a[i] = r.f[i] - _resists(arm, i, x, mode[i], tau, t, user)
    solve(r.L, r.a)
    for i in range(n):
        if mode[i] == 0.0:
            for j in range(n):
                r.f[i] -= r.M[i, j] * r.a[j]


@compiled
def _flip(arm, r, x, mode, fixed, tau, t, user):
    """Return the first joint whose direction does not fit its forces, and the one that does."""
    for i in range(mode.size):
        if x.v[i] != 0.0 or i == fixed:
            continue
        if mode[i] != 0.0:
            if mode[i] * r.a[i] < 0.0:
                return i, 0.0
        elif r.f[i] > _resists(arm, i, x, 1.0, tau, t, user):
            return i, 1.0
        elif r.f[i] < _resists(arm, i, x, -1.0, tau, t, user):
            return i, -1.0
    return -1, 0.0


@compiled
def _decide(arm, r, x, mode, fixed, tau, t, user):
    """Fill in the directions of joints at rest, 0 where a joint is held, and factor.

    `fixed` is a joint whose direction in `mode` is known, -1 for none.
    """
    for i in range(mode.size):
        if i != fixed:
            mode[i] = np.sign(x.v[i])
    good = _factored(r, mode)
    for _ in range(2 ** min(mode.size, 6)):
        _pushed(arm, r, x, mode, tau, t, user)
        i, s = _flip(arm, r, x, mode, fixed, tau, t, user)
        if i < 0:
            break
        mode[i] = s
        good &= _factored(r, mode)
    return good


@inlined
def _any_held(mode):
    held = False
    for i in range(mode.size):
        held |= mode[i] == 0.0
    return held


@compiled
def _margins(arm, r, x, mode, tau, t, user, out):
    """Fill out with how far each joint is from leaving its mode; negative once it has.

    Also fill r.w with the direction in which a held joint is pulled.
    """
    for i in range(mode.size):
        out[i] = mode[i] * x.v[i]
    if not _any_held(mode):
        return
    _settled(arm, r, x)
    _factored(r, mode)
    _pushed(arm, r, x, mode, tau, t, user)
    for i in range(mode.size):
        if mode[i] == 0.0:
            up = _resists(arm, i, x, 1.0, tau, t, user)
            down = _resists(arm, i, x, -1.0, tau, t, user)
            out[i] = min(up - r.f[i], r.f[i] - down)
            r.w[i] = np.sign(r.f[i] - 0.5 * (up + down))


# --- a step in one mode --------------------------------------------------------------------------


@inlined
def _forces(arm, r, x, mode, h, tau, t, user):
    """Fill in friction and the forces beyond it at the start of a step, and its acceleration."""
    for i in range(mode.size):
        r.a[i] = r.slope[i] = r.force[i] = 0.0
        if mode[i] == 0.0:
            continue
        p, on = arm.p[i], arm.on[i]
        r.level[i], r.slope[i] = plain_line(mode[i], p)
        if on["beyond"]:
            rod = bristle(x.q[i], x.v[i], x.z[i], h, tau[i], t, p, on, user)
            r.force[i] = beyond(x.q[i], x.v[i], mode[i], tau[i], t, rod, p, on, user)
        r.a[i] = tau[i] - r.level[i] - r.force[i] - r.slope[i] * x.v[i] - r.bias[i]
    solve(r.L, r.a)


@inlined
def _late(arm, r, x, mode, h, tau, rise, t, user):
    """Fill r.f with the rate of the force over the step, less that of what the step neglects."""
    n, later = mode.size, _LATE * h
    q, v = r.u, r.w
    for i in range(n):
        q[i] = x.q[i] + later * (x.v[i] + 0.5 * later * r.a[i])
        v[i] = x.v[i] + later * r.a[i]
    put(arm, r, q)
    required(arm, r, v, r.a, r.f)
    for i in range(n):
        if mode[i] == 0.0:
            r.f[i] = 0.0
            continue
        change = r.f[i] - r.bias[i]
        for j in range(n):
            change -= r.M[i, j] * r.a[j]
        p, on = arm.p[i], arm.on[i]
        if on["beyond"]:
            rod = bristle(x.q[i], x.v[i], x.z[i], h, tau[i], t, p, on, user)
            force = tau[i] + rise[i] * later
            change += beyond(q[i], v[i], mode[i], force, t + later, rod, p, on, user) - r.force[i]
        r.f[i] = rise[i] - change / later


@inlined
def step(arm, r, x, y, mode, h, tau, rise, t, user):
    """Move from state x to y over h in one mode; r.M, r.L and r.bias belong to x.

    The n-th terms r of the positions and u of the velocities follow from those before: r from u
    by integration, u by the law of motion.
    """
    n = mode.size
    _forces(arm, r, x, mode, h, tau, t, user)
    if h <= 0.0:
        copy(x, y)
        return
    _late(arm, r, x, mode, h, tau, rise, t, user)
    for i in range(n):
        r.u[i] = h * r.a[i]
        r.w[i] = h * x.v[i]
        y.q[i], y.v[i] = x.q[i], x.v[i]
    for term in range(2, _MAX_TERMS):
        small, g = True, h / term
        for i in range(n):
            y.q[i] += r.w[i]
            y.v[i] += r.u[i]
            r.w[i] = g * r.u[i]
            more = h * r.f[i] if term == 2 else 0.0
            r.u[i] = g * (more - r.slope[i] * r.u[i])
            small &= abs(r.u[i]) + abs(r.w[i]) <= _NOTHING
        if small:
            break
        solve(r.L, r.u)
    for i in range(n):
        p, on = arm.p[i], arm.on[i]
        y.z[i] = x.z[i]
        if mode[i] != 0.0 and on["presliding"]:
            rod = bristle(x.q[i], x.v[i], x.z[i], h, tau[i], t, p, on, user)
            y.z[i] = deflection(y.q[i], rod, p)


@compiled
def _stepped(arm, r, x, y, mode, h, tau, rise, t, user):
    """Do as `step`, called."""
    step(arm, r, x, y, mode, h, tau, rise, t, user)


# --- events ------------------------------------------------------------------------------------


@inlined
def _first(before, after):
    """Return which margin is the first to be used up, on straight lines; -1 if none is."""
    which, earliest = -1, 2.0
    for i in range(before.size):
        if after[i] < 0.0:
            start = max(before[i], 0.0)
            share = start / (start - after[i])
            if share < earliest:
                which, earliest = i, share
    return which


@compiled
def _locate(arm, r, there, x, y, mode, which, margins, h, tau, rise, t, user):
    """Move from x to y, where joint `which` leaves its mode; return the time that it takes.

    `margins` are its margins at x and behind the event; they are nearly straight over a step.
    """
    n = mode.size
    a, va, b, vb, c = 0.0, max(margins[0], 0.0), h, margins[1], 0.0
    found, force = np.empty(n), np.empty(n)
    for _ in range(5):
        c = a + (b - a) * va / (va - vb)
        _stepped(arm, r, x, y, mode, c, tau, rise, t, user)
        if mode[which] != 0.0:
            margin = mode[which] * y.v[which]
        else:
            for i in range(n):
                force[i] = tau[i] + rise[i] * c
            _margins(arm, there, y, mode, force, t + c, user, found)
            margin = found[which]
        if margin > 0.0:
            a, va = c, margin
        else:
            b, vb = c, margin
        if va == vb or vb == 0.0:
            break
    return c


@compiled
def _any(margins):
    negative = False
    for i in range(margins.size):
        negative |= margins[i] < 0.0
    return negative


@compiled
def _through_events(arm, r, there, x, y, mode, after, h, tau, rise, t, user):
    """Move on from x over h, stopping at every event; y is where one mode has led.

    Returns whether `there` has been settled where y ends. The arguments x, mode and tau are used
    up.
    """
    n = mode.size
    force = there.force  # which no margin needs
    for i in range(n):
        force[i] = tau[i] + rise[i] * h
    _margins(arm, there, y, mode, force, t + h, user, after)
    if not _any(after):
        return _any_held(mode)
    before, middle = np.empty(n), state(n)
    for _ in range(_MAX_EVENTS * n):
        pulls = there.w.copy()  # behind the event
        _margins(arm, there, x, mode, tau, t, user, before)
        which = _first(before, after)
        broke = mode[which] == 0.0
        edges = (before[which], after[which])
        used = _locate(arm, r, there, x, middle, mode, which, edges, h, tau, rise, t, user)
        for i in range(n):
            tau[i] += rise[i] * used
            force[i] = tau[i] + rise[i] * (h - used)
        h, t = h - used, t + used
        copy(middle, x)
        x.v[which] = 0.0
        _settled(arm, r, x)
        if broke:
            mode[which] = pulls[which]
        _decide(arm, r, x, mode, which if broke else -1, tau, t, user)
        _stepped(arm, r, x, y, mode, h, tau, rise, t, user)
        _margins(arm, there, y, mode, force, t + h, user, after)
        if not _any(after):
            return _any_held(mode)
    # so many events are chatter about standstill: what rests now rests to the end of the step
    for i in range(n):
        mode[i] = np.sign(x.v[i])
    _factored(r, mode)
    _stepped(arm, r, x, y, mode, h, tau, rise, t, user)
    return False


@inlined
def advance(arm, r, there, x, y, mode, after, h, tau, rise, t, user, a, known):
    """Move from x to y over h, through whatever happens; fill a with the first acceleration.

    `known` says whether `there` has been settled at x. Returns whether the mass matrix was positive
    definite, and whether `there` has been settled at y. x, mode and tau may be used up.
    """
    n = mode.size
    if known:
        r.M[:], r.bias[:] = there.M, there.bias
    else:
        settle(arm, r, x)
    for i in range(n):
        mode[i] = np.sign(x.v[i])
    resting = _any_held(mode)
    good = _decide(arm, r, x, mode, -1, tau, t, user) if resting else factor(r, mode)
    step(arm, r, x, y, mode, h, tau, rise, t, user)
    stays = not _any_held(mode)
    for i in range(n):
        a[i] = r.a[i]
        stays &= mode[i] * y.v[i] > 0.0
    known = False
    if not stays:
        known = _through_events(arm, r, there, x, y, mode, after, h, tau, rise, t, user)
    return good, known
