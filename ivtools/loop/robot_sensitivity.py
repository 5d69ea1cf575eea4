"""How the commands of a robot answer to its parameters, along one simulation of it.

A small change of a parameter is a small force along the motion. The loops answer to it as linear
ones do whose masses change with the pose: all parameters are followed at once, in the time of a
few simulations, where one simulation of the robot per parameter takes one each.
"""

# Compiled functions carry no annotations: Numba infers them, and mypy cannot see through it.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..compiled import cached, compiled
from ..pipeline import Motion
from ..record import Record
from .robot_engine import laws
from .simulation import Simulation

if TYPE_CHECKING:
    from .robot_loop import RobotLoop

Array = NDArray[np.float64]

_EVERY = 0.01  # s between the poses at which the change of forces with the motion is taken
_SMALL = 1e-6  # rad or m, and rad/s or m/s, by which the motion is changed for it


def answers(
    loop: RobotLoop, record: Record, values: Mapping[str, float], simulation: Simulation
) -> Array:
    """Return the change of each command by a unit of each parameter, (n, n_samples, p), N or N m.

    Limits of the commands are left out, and what the joints' terms beyond viscous and dry friction
    change with the motion.

    Parameters
    ----------
    loop : RobotLoop
    record : Record
        Drives the simulation.
    values : mapping
        Of every parameter.
    simulation : Simulation
        Of the loop on that record with these values.
    """
    motion = Motion(simulation.q, simulation.dq, simulation.ddq)
    n, dt = loop.n_joints, record.dt
    forces = loop.regressor(motion, simulation.tau, simulation.t - simulation.t[0])
    own = [loop.joint_values(j, values) for j in range(n)]
    still = motion.dq == 0.0
    M = loop.mass_matrix(motion.q, values)
    M[still] = 0.0
    M.transpose(0, 2, 1)[still] = 0.0
    M[:, np.arange(n), np.arange(n)] += still
    every = max(round(_EVERY / dt), 1)
    stiffness, damping = _rates(loop, values, Motion(*(x[::every] for x in motion)))
    damping = damping + np.diag([v.get("viscous", 0.0) for v in own])
    gains = np.array([axis.gain for axis in loop.axes])
    timing = np.array(
        [(a.delay + v.get("drive-timing.delay", 0.0), v.get("drive-timing.lag", 0.0))
         for a, v in zip(loop.axes, own, strict=True)]
    )  # fmt: skip
    law = laws(loop, record, own, "record")
    out = np.empty(forces.shape)
    _follow(
        dt, law.gains, law.taps, law.A, law.B, law.C, law.delay, gains, timing / dt,
        np.linalg.inv(M), stiffness, damping, every, motion.dq, motion.ddq,
        np.ascontiguousarray(forces), out,
    )  # fmt: skip
    return out


def _rates(loop: RobotLoop, values: Mapping[str, float], at: Motion) -> tuple[Array, Array]:
    """Return how the links' forces change with position and velocity, (m, n, n) each."""
    phi, T = loop.inertias(values), loop._T

    def asked(q: Array, dq: Array) -> Array:
        q, dq, ddq = (loop._to_joints(x) for x in (q, dq, at.ddq))
        return np.asarray(loop.robot.torques(q, dq, ddq, phi) @ T)

    steps = _SMALL * np.eye(loop.n_joints)
    stiffness = [(asked(at.q + s, at.dq) - asked(at.q - s, at.dq)) / 2 / _SMALL for s in steps]
    damping = [(asked(at.q, at.dq + s) - asked(at.q, at.dq - s)) / 2 / _SMALL for s in steps]
    return np.stack(stiffness, axis=2), np.stack(damping, axis=2)


@cached()
def _follow(
    dt, gains, taps, A, B, C, delay, drive, timing, inverse, stiffness, damping, every, dq, ddq,
    forces, out,
):  # fmt: skip
    """Follow the changes of all parameters through the loop; fill out (n, n_samples, p).

    `timing` is each drive's delay and lag in samples.
    """
    n, samples, p = forces.shape
    q, v, lagging = np.zeros((n, p)), np.zeros((n, p)), np.zeros((n, p))
    inner, push = np.zeros((n, C.shape[1], p)), np.zeros((n, p))
    rows = taps.shape[1] + int(np.max(delay) + np.max(timing[:, 0])) + 2  # that are kept
    seen, said = np.zeros((rows, n, p)), np.zeros((rows, n, p))
    for k in range(samples):
        then = min(k + 1, samples - 1)
        for j in range(n):
            seen[k % rows, j] = q[j]
            said[k % rows, j] = _said(k, j, seen, gains, taps, A, B, C, inner)
            out[j, k] = drive[j] * said[(k - delay[j]) % rows, j]
            push[j] = _sent(k - delay[j], j, said, drive, timing, lagging)
            push[j] -= 0.5 * (forces[j, k] + forces[j, then])
        m = min(k // every, len(stiffness) - 1)
        push -= stiffness[m] @ q + damping[m] @ v
        for j in range(n):
            if dq[k, j] == 0.0:  # it stands still
                push[j] = 0.0
                v[j] = 0.0
        a = inverse[k] @ push
        q += dt * (v + 0.5 * dt * a)
        v += dt * a
        for j in range(n):
            if dq[k, j] * dq[then, j] <= 0.0 and dq[k, j] != 0.0:
                _turn(j, v, ddq[k], ddq[then], dq[then])


@compiled
def _said(k, j, seen, gains, taps, A, B, C, inner):
    """Return what the law of joint j makes of its motion, (p,), and move its states on."""
    rows, speed = len(seen), np.zeros(seen.shape[2])
    for b in range(min(taps.shape[1], k + 1)):
        speed += taps[j, b] * seen[(k - b) % rows, j]
    q = seen[k % rows, j]
    value = gains[j, 0] * q + gains[j, 1] * speed
    if C.shape[1]:
        value += C[j] @ inner[j]
        inner[j] = A[j] @ inner[j] + np.outer(B[j, :, 0], q) + np.outer(B[j, :, 1], speed)
    return value


@compiled
def _sent(k, j, said, drive, timing, lagging):
    """Return the mean force of drive j over a sample, (p,), behind its delay and lag."""
    whole = int(timing[j, 0])
    part, rows = timing[j, 0] - whole, len(said)
    asked = (1.0 - part) * said[(k - whole) % rows, j] + part * said[(k - whole - 1) % rows, j]
    asked *= drive[j]
    if timing[j, 1] <= 0.0:
        return asked
    decay = np.exp(-1.0 / timing[j, 1])
    lead = lagging[j] - asked
    lagging[j] = asked + lead * decay
    return asked + lead * (1.0 - decay) * timing[j, 1]


@compiled
def _turn(j, v, before, after, speed):
    """Let joint j reverse a little earlier or later: dry friction turns round then, or holds it.

    Between both times all joints have the one acceleration instead of the other, (n,).
    """
    own = v[j].copy()
    for i in range(len(v)):
        jump = (after[i] - before[i]) / before[j] if before[j] != 0.0 else 0.0
        if i == j:
            jump = -1.0 if speed[j] == 0.0 else min(max(jump, -1.0), 0.0)
        if speed[i] != 0.0 or i == j:
            v[i] += jump * own
