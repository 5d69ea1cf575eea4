"""The compiled closed loop of a robot: a law and a drive per joint, and the arm that they share."""

# Compiled functions carry no annotations: Numba infers them, and mypy cannot see through it.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiled import cached, compiled, inlined, lent
from ..robot.dynamics import Frames, Tree
from .arm import Arm, Room, State, advance, copy
from .integrator import drive_delay, lagging
from .kernel import measure, move_on
from .mechanics import derive, plain_line

Array = NDArray[np.float64]

_STIFF = 2.0  # viscous friction brakes by so many time constants in a step at most
_MOST_STEPS = 200


class Laws(NamedTuple):
    """The laws of all joints along a record: `engine.Driven`, one row each, padded with zeros."""

    known: Array
    gains: Array
    taps: Array
    sensed: NDArray[np.bool_]
    known_inner: Array
    A: Array
    B: Array
    C: Array
    back: Array
    hold: NDArray[np.bool_]
    inner: Array
    delay: NDArray[np.int64]
    limit: Array
    q: Array
    v: Array
    a: Array
    first: Array


class Outside(NamedTuple):
    """What acts on the loop from outside, (n, n_samples) each; an empty one is nothing.

    Attributes
    ----------
    added : ndarray
        Added to the commands.
    force : ndarray
        Added to the forces of the drives, N or N m.
    noise : ndarray
        Added to the measured positions, m or rad.
    """

    added: Array
    force: Array
    noise: Array


class Work(NamedTuple):
    """Room for a simulation, lent by Python.

    Attributes
    ----------
    here, there : Room
    x, y : State
    rows : (8, n) ndarray
        One value per joint of this and that.
    seen, law, sent : (n, ...) ndarray
        Positions measured, the laws' commands and those of the drives, with what came before.
    following : (n_states,) ndarray
    """

    here: Room
    there: Room
    x: State
    y: State
    rows: Array
    seen: Array
    law: Array
    sent: Array
    following: Array


@inlined
def _lent_arm(a):
    t = a.tree
    tree = Tree(lent(t.parent), lent(t.slides), lent(t.rotation), lent(t.position), lent(t.gravity))
    return Arm(
        tree, lent(a.phi), lent(a.armature), lent(a.coupling), a.coupled, lent(a.p), lent(a.on)
    )


@inlined
def _lent_room(r):
    f = r.at
    at = Frames(lent(f.R), lent(f.p), lent(f.motion), lent(f.wrench), lent(f.body))
    return Room(
        at,
        lent(r.M),
        lent(r.L),
        lent(r.bias),
        lent(r.level),
        lent(r.slope),
        lent(r.force),
        lent(r.a),
        lent(r.u),
        lent(r.f),
        lent(r.w),
    )


@inlined
def _lent_state(x):
    return State(lent(x.q), lent(x.v), lent(x.z))


@compiled
def _steps(dt, least, p, on):
    """Derive what each joint needs; return the number of steps per sample that all need."""
    steps = least
    for j in range(p.size):
        derive(dt, least if on[j]["effects"] else 1, p[j], on[j])
        steps = max(steps, p[j]["steps"])
        slope = max(abs(plain_line(1.0, p[j])[1]), abs(plain_line(-1.0, p[j])[1]))
        rate = slope / p[j]["inertia"]
        steps = max(steps, min(int(np.ceil(rate * dt / _STIFF)), _MOST_STEPS))
    return steps


@compiled
def _spans(dt, p, on):
    """Return the times within a sample at which a drive's delay has passed, and its ends."""
    times = [0.0, dt]
    for j in range(p.size):
        part = drive_delay(dt, p[j], on[j])[1] * dt
        if part > 0.0:
            times.append(part)
    return np.unique(np.array(times))


@compiled
def _counts(dt, steps, spans):
    """Return the number of steps in each span."""
    counts = np.empty(spans.size - 1, np.int64)
    for i in range(counts.size):
        share = (spans[i + 1] - spans[i]) / dt
        counts[i] = max(int(np.ceil(steps * share - 1e-9)), 1)
    return counts


@compiled
def _lags(h, p, on):
    """Return lagging forces as straight lines over a step: first, last, decay per joint."""
    lines = np.zeros((p.size, 3))
    for j in range(p.size):
        if on[j]["drive-timing"] and p[j]["drive-timing.lag"] > 0.0:
            lines[j, 0], lines[j, 1], lines[j, 2] = lagging(h / p[j]["drive-timing.lag"])
    return lines


@compiled
def _begin(dt, laws, whole, w, arm):
    """Fill in what the controllers had seen and sent before the record."""
    p, on, past = arm.p, arm.on, laws.taps.shape[1] - 1
    w.x.q[:], w.x.v[:], w.x.z[:] = laws.q, laws.v, 0.0
    for j in range(p.size):
        for i in range(past):
            before = laws.q[j] - (past - i) * dt * laws.v[j]
            w.seen[j, i] = measure(before, 0.0, 0.0, p[j], on[j])
        w.law[j, : laws.delay[j]] = laws.first[j, : laws.delay[j]]
        w.sent[j, : whole[j] + 1] = laws.first[j, laws.delay[j]]
        w.rows[0, j] = p[j]["gain"] * laws.first[j, laws.delay[j]]


@compiled
def _control(laws, outside, quantum, whole, w, k, p, on, out):
    """Measure, and let every law say its command for sample k."""
    past, states = laws.taps.shape[1] - 1, laws.C.shape[1]
    for j in range(p.size):
        noise = outside.noise[j, k] if outside.noise.size else 0.0
        q = measure(w.x.q[j], noise, quantum[j], p[j], on[j])
        w.seen[j, past + k] = out[0, j, k] = q
        out[1, j, k] = w.x.v[j]
        limit, sensed = laws.limit[j], laws.sensed[j]
        speed = w.x.v[j] if sensed else 0.0
        for i in range(0 if sensed else past + 1):
            speed += laws.taps[j, i] * w.seen[j, past + k - i]
        value = laws.known[j, k] + laws.gains[j, 0] * q + laws.gains[j, 1] * speed
        for i in range(states):
            value += laws.C[j, i] * laws.inner[j, i]
        if states:
            excess = value - min(max(value, -limit), limit)
            move_on(
                laws.inner[j],
                w.following,
                laws.known_inner[j, k],
                laws.A[j],
                laws.B[j],
                laws.C[j],
                q,
                speed,
                excess,
                laws.back[j],
                laws.hold[j],
            )
        w.law[j, laws.delay[j] + k] = value
        value = min(max(w.law[j, k], -limit), limit)
        value += outside.added[j, k] if outside.added.size else 0.0
        w.sent[j, whole[j] + 1 + k] = out[3, j, k] = value


@compiled
def _finite(x):
    return np.isfinite(np.sum(x.q) + np.sum(x.v))


@cached()
def run(dt, least, laws, outside, quantum, arm, user, work, out):
    """Simulate the closed loop; fill out (4, n, n_samples) with q, dq, ddq, nu.

    Returns whether the mass matrix stayed positive definite; where it did not, and behind a motion
    that is not finite, the rest of out is not finite. The states of the laws are used up.
    """
    n, samples = laws.known.shape
    arm, x, y = _lent_arm(arm), _lent_state(work.x), _lent_state(work.y)
    here, there = _lent_room(work.here), _lent_room(work.there)
    p, on = arm.p, arm.on
    steps, spans = _steps(dt, least, p, on), _spans(dt, p, on)
    counts, whole, parts = _counts(dt, steps, spans), np.empty(n, np.int64), np.empty(n)
    lines = np.empty((counts.size, n, 3))
    for i in range(counts.size):
        lines[i] = _lags((spans[i + 1] - spans[i]) / counts[i], p, on)
    for j in range(n):
        whole[j], parts[j] = drive_delay(dt, p[j], on[j])
        parts[j] *= dt
    _begin(dt, laws, whole, work, arm)
    rows, sent = lent(work.rows), lent(work.sent)
    force, target, lead, tau = rows[0], rows[1], rows[2], rows[3]
    rise, mode, after, a = rows[4], rows[5], rows[6], rows[7]
    known = False
    for k in range(samples):
        _control(laws, outside, quantum, whole, work, k, p, on, out)
        for i in range(counts.size):
            h = (spans[i + 1] - spans[i]) / counts[i]
            for j in range(n):
                p[j]["outside"] = outside.force[j, k] if outside.force.size else 0.0
                new = k + 1 if spans[i] >= parts[j] else k
                target[j] = p[j]["gain"] * sent[j, new]
                lead[j] = force[j] - target[j]
            for m in range(counts[i]):
                for j in range(n):
                    tau[j] = target[j] + lead[j] * lines[i, j, 0]
                    tau[j] += p[j]["outside"]
                    rise[j] = lead[j] * (lines[i, j, 1] - lines[i, j, 0]) / h
                    lead[j] *= lines[i, j, 2]
                t = k * dt + spans[i] + m * h
                good, known = advance(
                    arm, here, there, x, y, mode, after, h, tau, rise, t, user, a, known
                )
                if not good:
                    out[:, :, k:] = np.nan
                    return not _finite(x)
                copy(y, x)
                if i == 0 and m == 0:
                    for j in range(n):
                        out[2, j, k] = a[j]
            for j in range(n):
                force[j] = target[j] + lead[j]
        if not _finite(x):
            out[:, :, k + 1 :] = np.nan
            return True
    return True
