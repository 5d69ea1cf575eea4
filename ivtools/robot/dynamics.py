"""Dynamics of a tree of joints: compiled Newton-Euler in the frames of the links.

Each joint moves along or about the z-axis of its link's frame, so that rotations and axes are
cheap. `place` puts the frames, `move` their velocities and accelerations; torques, observation
matrix and mass matrix follow from those. Vectors are written out by components, for the compiler
makes twice as fast a code of them as of three-element loops.

References
----------
R. Featherstone, *Rigid Body Dynamics Algorithms*, Springer 2008; W. Khalil, E. Dombre, *Modeling,
Identification and Control of Robots*, 2002, chapter 9.
"""

# Compiled functions carry no annotations: Numba infers them, and mypy cannot see through it.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiled import cached, inlined

Array = NDArray[np.float64]


class Tree(NamedTuple):
    """Joints in an order in which parents come before their children.

    Attributes
    ----------
    parent : (n,) ndarray of int
        Joint that carries each one, -1 for the base.
    slides : (n,) ndarray of bool
        Whether a joint is prismatic.
    rotation, position : (n, 3, 3), (n, 3) ndarray
        Frame of each link in that of its parent, at joint position 0.
    gravity : (3,) ndarray
        In the base frame, m/s2.
    """

    parent: NDArray[np.int64]
    slides: NDArray[np.bool_]
    rotation: Array
    position: Array
    gravity: Array


class Frames(NamedTuple):
    """Room for one configuration: reused from sample to sample.

    Attributes
    ----------
    R, p : (n, 3, 3), (n, 3) ndarray
        Frame of each link in that of its parent.
    motion : (n, 9) ndarray
        Angular velocity and acceleration, acceleration of the origin less gravity, in link frames.
    wrench : (n, 6) ndarray
        Force and moment that each joint transmits.
    body : (n, 10) ndarray
        Inertia of each link with all that it carries.
    """

    R: Array
    p: Array
    motion: Array
    wrench: Array
    body: Array


@inlined
def frames(n):
    """Return room for n joints."""
    return Frames(
        np.empty((n, 3, 3)),
        np.empty((n, 3)),
        np.empty((n, 9)),
        np.empty((n, 6)),
        np.empty((n, 10)),
    )


@inlined
def _out(R, i, x, y, z):
    """Take a vector of link i to the frame of its parent."""
    return (
        R[i, 0, 0] * x + R[i, 0, 1] * y + R[i, 0, 2] * z,
        R[i, 1, 0] * x + R[i, 1, 1] * y + R[i, 1, 2] * z,
        R[i, 2, 0] * x + R[i, 2, 1] * y + R[i, 2, 2] * z,
    )


@inlined
def _in(R, i, x, y, z):
    """Take a vector of link i's parent to the frame of link i."""
    return (
        R[i, 0, 0] * x + R[i, 1, 0] * y + R[i, 2, 0] * z,
        R[i, 0, 1] * x + R[i, 1, 1] * y + R[i, 2, 1] * z,
        R[i, 0, 2] * x + R[i, 1, 2] * y + R[i, 2, 2] * z,
    )


@inlined
def _cross(ax, ay, az, bx, by, bz):
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@inlined
def place(tree, q, at):
    """Put every link's frame at joint positions q, m or rad."""
    R, p = at.R, at.p
    for i in range(q.size):
        A = tree.rotation[i]
        if tree.slides[i]:
            for k in range(3):
                R[i, k, 0], R[i, k, 1], R[i, k, 2] = A[k, 0], A[k, 1], A[k, 2]
                p[i, k] = tree.position[i, k] + A[k, 2] * q[i]
        else:
            c, s = np.cos(q[i]), np.sin(q[i])
            for k in range(3):
                R[i, k, 0] = c * A[k, 0] + s * A[k, 1]
                R[i, k, 1] = c * A[k, 1] - s * A[k, 0]
                R[i, k, 2] = A[k, 2]
                p[i, k] = tree.position[i, k]


@inlined
def move(tree, dq, ddq, at):
    """Give every link its motion, from the base outwards; gravity is an acceleration upwards."""
    R, p, m = at.R, at.p, at.motion
    for i in range(dq.size):
        j = tree.parent[i]
        v, a = dq[i], ddq[i]
        if j < 0:
            wx = wy = wz = ux = uy = uz = 0.0
            ax, ay, az = _in(R, i, -tree.gravity[0], -tree.gravity[1], -tree.gravity[2])
        else:
            x, y, z = p[i, 0], p[i, 1], p[i, 2]
            gx, gy, gz = _cross(m[j, 0], m[j, 1], m[j, 2], x, y, z)
            hx, hy, hz = _cross(m[j, 0], m[j, 1], m[j, 2], gx, gy, gz)
            ex, ey, ez = _cross(m[j, 3], m[j, 4], m[j, 5], x, y, z)
            ax, ay, az = _in(R, i, m[j, 6] + ex + hx, m[j, 7] + ey + hy, m[j, 8] + ez + hz)
            wx, wy, wz = _in(R, i, m[j, 0], m[j, 1], m[j, 2])
            ux, uy, uz = _in(R, i, m[j, 3], m[j, 4], m[j, 5])
        if tree.slides[i]:
            ax, ay, az = ax + 2.0 * wy * v, ay - 2.0 * wx * v, az + a
        else:
            ux, uy, uz = ux + wy * v, uy - wx * v, uz + a
            wz += v
        m[i, 0], m[i, 1], m[i, 2] = wx, wy, wz
        m[i, 3], m[i, 4], m[i, 5] = ux, uy, uz
        m[i, 6], m[i, 7], m[i, 8] = ax, ay, az


@inlined
def react(tree, phi, at, out):
    """Fill out (n,) with the joint forces that the motion asks for, from the tips inwards."""
    R, p, m, f = at.R, at.p, at.motion, at.wrench
    for i in range(out.size):
        for k in range(6):
            f[i, k] = 0.0
    for i in range(out.size - 1, -1, -1):
        b = phi[i]
        wx, wy, wz, ux, uy, uz = m[i, 0], m[i, 1], m[i, 2], m[i, 3], m[i, 4], m[i, 5]
        ax, ay, az = m[i, 6], m[i, 7], m[i, 8]
        # force: m a + dw x h + w x (w x h)
        ex, ey, ez = _cross(wx, wy, wz, b[1], b[2], b[3])
        gx, gy, gz = _cross(wx, wy, wz, ex, ey, ez)
        dx, dy, dz = _cross(ux, uy, uz, b[1], b[2], b[3])
        fx = f[i, 0] + b[0] * ax + dx + gx
        fy = f[i, 1] + b[0] * ay + dy + gy
        fz = f[i, 2] + b[0] * az + dz + gz
        # moment: I dw + w x (I w) + h x a
        lx = b[4] * wx + b[5] * wy + b[6] * wz
        ly = b[5] * wx + b[7] * wy + b[8] * wz
        lz = b[6] * wx + b[8] * wy + b[9] * wz
        ex, ey, ez = _cross(wx, wy, wz, lx, ly, lz)
        gx, gy, gz = _cross(b[1], b[2], b[3], ax, ay, az)
        nx = f[i, 3] + b[4] * ux + b[5] * uy + b[6] * uz + ex + gx
        ny = f[i, 4] + b[5] * ux + b[7] * uy + b[8] * uz + ey + gy
        nz = f[i, 5] + b[6] * ux + b[8] * uy + b[9] * uz + ez + gz
        out[i] = fz if tree.slides[i] else nz
        j = tree.parent[i]
        if j >= 0:
            fx, fy, fz = _out(R, i, fx, fy, fz)
            nx, ny, nz = _out(R, i, nx, ny, nz)
            ex, ey, ez = _cross(p[i, 0], p[i, 1], p[i, 2], fx, fy, fz)
            f[j, 0] += fx
            f[j, 1] += fy
            f[j, 2] += fz
            f[j, 3] += nx + ex
            f[j, 4] += ny + ey
            f[j, 5] += nz + ez


@inlined
def _carry(b, i, j, R, p):
    """Add the inertia b[i], seen from the frame of its parent j, to b[j]."""
    m = b[i, 0]
    hx, hy, hz = _out(R, i, b[i, 1], b[i, 2], b[i, 3])
    # R I R': first the columns, then the rows
    ax, ay, az = _out(R, i, b[i, 4], b[i, 5], b[i, 6])
    bx, by, bz = _out(R, i, b[i, 5], b[i, 7], b[i, 8])
    cx, cy, cz = _out(R, i, b[i, 6], b[i, 8], b[i, 9])
    xx, xy, xz = _out(R, i, ax, bx, cx)
    _, yy, yz = _out(R, i, ay, by, cy)
    _, _, zz = _out(R, i, az, bz, cz)
    x, y, z = p[i, 0], p[i, 1], p[i, 2]
    gx, gy, gz = hx + m * x, hy + m * y, hz + m * z
    # parallel axes: with s = h + g, I grows by (p.s) 1 - the symmetric part of p s'
    sx, sy, sz = hx + gx, hy + gy, hz + gz
    dot = x * sx + y * sy + z * sz
    b[j, 0] += m
    b[j, 1] += gx
    b[j, 2] += gy
    b[j, 3] += gz
    b[j, 4] += xx + dot - x * sx
    b[j, 5] += xy - 0.5 * (x * sy + y * sx)
    b[j, 6] += xz - 0.5 * (x * sz + z * sx)
    b[j, 7] += yy + dot - y * sy
    b[j, 8] += yz - 0.5 * (y * sz + z * sy)
    b[j, 9] += zz + dot - z * sz


@inlined
def weigh(tree, phi, at, M):
    """Fill M (n, n) with the mass matrix, by composite bodies."""
    R, p, b, n = at.R, at.p, at.body, phi.shape[0]
    for i in range(n):
        for k in range(10):
            b[i, k] = phi[i, k]
        for k in range(n):
            M[i, k] = 0.0
    for i in range(n - 1, -1, -1):
        j = tree.parent[i]
        if j >= 0:
            _carry(b, i, j, R, p)
        # force and moment that a unit acceleration of this joint asks for
        if tree.slides[i]:
            fx, fy, fz = 0.0, 0.0, b[i, 0]
            nx, ny, nz = b[i, 2], -b[i, 1], 0.0
            M[i, i] = fz
        else:
            fx, fy, fz = -b[i, 2], b[i, 1], 0.0
            nx, ny, nz = b[i, 6], b[i, 8], b[i, 9]
            M[i, i] = nz
        k = i
        while j >= 0:
            fx, fy, fz = _out(R, k, fx, fy, fz)
            nx, ny, nz = _out(R, k, nx, ny, nz)
            ex, ey, ez = _cross(p[k, 0], p[k, 1], p[k, 2], fx, fy, fz)
            nx, ny, nz = nx + ex, ny + ey, nz + ez
            M[i, j] = M[j, i] = fz if tree.slides[j] else nz
            k, j = j, tree.parent[j]


@inlined
def _row(columns, k, m, ox, oy, oz, vx, vy, vz, out):
    """Fill out with what a unit of each parameter of link k asks of a joint.

    The joint moves the link's frame by (o, v) per unit of its own motion, so its force is
    v . f + o . n of that parameter alone.
    """
    wx, wy, wz, ux, uy, uz = m[k, 0], m[k, 1], m[k, 2], m[k, 3], m[k, 4], m[k, 5]
    ax, ay, az = m[k, 6], m[k, 7], m[k, 8]
    # h: v . (dw x h + w x (w x h)) + o . (h x a)
    ex, ey, ez = _cross(vx, vy, vz, ux, uy, uz)
    gx, gy, gz = _cross(ax, ay, az, ox, oy, oz)
    along, speed = wx * vx + wy * vy + wz * vz, wx * wx + wy * wy + wz * wz
    # I: o . (I dw) + (o x w) . (I w)
    cx, cy, cz = _cross(ox, oy, oz, wx, wy, wz)
    values = (
        vx * ax + vy * ay + vz * az,
        ex + gx + along * wx - speed * vx,
        ey + gy + along * wy - speed * vy,
        ez + gz + along * wz - speed * vz,
        ox * ux + cx * wx,
        ox * uy + oy * ux + cx * wy + cy * wx,
        ox * uz + oz * ux + cx * wz + cz * wx,
        oy * uy + cy * wy,
        oy * uz + oz * uy + cy * wz + cz * wy,
        oz * uz + cz * wz,
    )
    for i in range(10):
        column = columns[k, i]
        if column >= 0:
            out[column] = values[i]


@inlined
def observe(tree, columns, at, out):
    """Fill out (n, n_columns) with the observation matrix of the motion; zeros are not written.

    `columns` (n, 10) says where each standard parameter goes; -1 leaves it out.
    """
    R, p, m, n = at.R, at.p, at.motion, columns.shape[0]
    unit = at.wrench  # per joint: how it moves the links behind it
    for j in range(n):
        for k in range(j, n):
            if k == j:
                o, v = (0.0, 1.0) if tree.slides[j] else (1.0, 0.0)
                ox, oy, oz, vx, vy, vz = 0.0, 0.0, o, 0.0, 0.0, v
            else:
                i = tree.parent[k]
                if i < j or np.isnan(unit[i, 0]):  # a link that this joint does not move
                    unit[k, 0] = np.nan
                    continue
                ox, oy, oz = unit[i, 0], unit[i, 1], unit[i, 2]
                ex, ey, ez = _cross(ox, oy, oz, p[k, 0], p[k, 1], p[k, 2])
                vx, vy, vz = _in(R, k, unit[i, 3] + ex, unit[i, 4] + ey, unit[i, 5] + ez)
                ox, oy, oz = _in(R, k, ox, oy, oz)
            unit[k, 0], unit[k, 1], unit[k, 2] = ox, oy, oz
            unit[k, 3], unit[k, 4], unit[k, 5] = vx, vy, vz
            _row(columns, k, m, ox, oy, oz, vx, vy, vz, out[j])


@cached()
def torques(tree, phi, q, dq, ddq, out):
    """Fill out (n_samples, n) with the inverse dynamics along a trajectory, N or N m."""
    at = frames(q.shape[1])
    for k in range(len(q)):
        place(tree, q[k], at)
        move(tree, dq[k], ddq[k], at)
        react(tree, phi, at, out[k])


@cached()
def observations(tree, columns, q, dq, ddq, out):
    """Fill out (n_samples, n, n_columns), zeros to begin with, with the observation matrix."""
    at = frames(q.shape[1])
    for k in range(len(q)):
        place(tree, q[k], at)
        move(tree, dq[k], ddq[k], at)
        observe(tree, columns, at, out[k])


@cached()
def mass_matrices(tree, phi, q, out):
    """Fill out (n_samples, n, n) with the mass matrix along a trajectory."""
    at = frames(q.shape[1])
    for k in range(len(q)):
        place(tree, q[k], at)
        weigh(tree, phi, at, out[k])
