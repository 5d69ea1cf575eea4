"""Inertia of a rigid body: ten standard parameters, or one pseudo-inertia matrix.

The pseudo-inertia is the second moment of the mass in homogeneous coordinates, P = sum of
m (x, 1)(x, 1)'. Moving a body is a congruence, joining bodies a sum, and a body can exist if its P
has no negative eigenvalue: the three things that a robot's links need.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import MissingExtraError

Array = NDArray[np.float64]

STANDARD = ("M", "MX", "MY", "MZ", "XX", "XY", "XZ", "YY", "YZ", "ZZ")
"""Standard parameters of a link, about the origin of its frame: kg, kg m, kg m2."""


def pseudo_inertia(link: Sequence[Any]) -> Any:
    """Return the pseudo-inertia (4, 4) of a rigid link, positive semidefinite if it can exist.

    Parameters
    ----------
    link : sequence of 10
        m, m cx, m cy, m cz, Ixx, Ixy, Ixz, Iyy, Iyz, Izz about the link frame, kg, kg m, kg m2;
        numbers or cvxpy expressions.

    Returns
    -------
    ndarray or cvxpy expression, (4, 4)

    References
    ----------
    P. M. Wensing, S. Kim, J.-J. E. Slotine, "Linear matrix inequalities for physically consistent
    inertial parameter identification", IEEE Robotics and Automation Letters 3(1), 2018.

    Examples
    --------
    >>> ball = [1.0, 0.0, 0.0, 0.0, 0.4, 0.0, 0.0, 0.4, 0.0, 0.4]
    >>> bool(np.linalg.eigvalsh(pseudo_inertia(ball)).min() > 0.0)
    True
    """
    m, hx, hy, hz, xx, xy, xz, yy, yz, zz = link
    rows = [
        [0.5 * (yy + zz - xx), -xy, -xz, hx],
        [-xy, 0.5 * (xx + zz - yy), -yz, hy],
        [-xz, -yz, 0.5 * (xx + yy - zz), hz],
        [hx, hy, hz, m],
    ]
    if all(isinstance(entry, int | float | np.floating) for entry in link):
        return np.array(rows, dtype=float)
    return cvxpy().bmat(rows)


def standard(P: Array) -> Array:
    """Return the standard parameters (10,) of a pseudo-inertia (4, 4).

    Examples
    --------
    >>> ball = [1.0, 0.0, 0.0, 0.0, 0.4, 0.0, 0.0, 0.4, 0.0, 0.4]
    >>> bool(np.allclose(standard(pseudo_inertia(ball)), ball))
    True
    """
    I = np.trace(P[:3, :3]) * np.eye(3) - P[:3, :3]  # noqa: E741
    return np.array([P[3, 3], *P[:3, 3], *I[0], I[1, 1], I[1, 2], I[2, 2]])


def moved(P: Array, rotation: Array, position: Array) -> Array:
    """Return the pseudo-inertia in another frame: x becomes rotation x + position.

    Examples
    --------
    >>> point = np.diag([0.0, 0.0, 0.0, 2.0])  # 2 kg at the origin
    >>> standard(moved(point, np.eye(3), np.array([0.5, 0.0, 0.0]))).tolist()
    [2.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.5]
    """
    T = homogeneous(rotation, position)
    return T @ P @ T.T


def homogeneous(rotation: Array, position: Array) -> Array:
    """Return the homogeneous matrix (4, 4) of a displacement."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, position
    return T


def body(mass: float, centre: Array, tensor: Array) -> Array:
    """Return the pseudo-inertia of a body.

    Parameters
    ----------
    mass : float
        kg.
    centre : (3,) array_like
        Centre of mass, m.
    tensor : (3, 3) array_like
        Inertia about the centre of mass, kg m2.
    """
    P, I = np.zeros((4, 4)), np.asarray(tensor, dtype=float)  # noqa: E741
    P[:3, :3] = 0.5 * np.trace(I) * np.eye(3) - I
    P[3, 3] = mass
    return moved(P, np.eye(3), np.asarray(centre, dtype=float))


def described(phi: Array) -> dict[str, Any]:
    """Return mass (kg), centre of mass (m) and inertia about it (kg m2) of standard parameters."""
    P = pseudo_inertia(np.asarray(phi, dtype=float).tolist())
    mass = P[3, 3]
    centre = P[:3, 3] / mass if mass > 0.0 else np.zeros(3)
    central = moved(P, np.eye(3), -centre)[:3, :3]
    tensor = np.trace(central) * np.eye(3) - central
    return {"mass": float(mass), "com": centre.tolist(), "inertia": tensor.tolist()}


def cvxpy() -> Any:
    """Return cvxpy, or say which extra has it."""
    try:
        import cvxpy
    except ImportError:
        raise MissingExtraError("cvxpy", "methods") from None
    return cvxpy
