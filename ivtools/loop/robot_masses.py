"""Masses of a robot that can exist: felt by its drives, positive definite, link by link."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..errors import AxisError
from ..record import Record
from ..robot.consistent import nearest, sizes
from .model import Array, Theta

if TYPE_CHECKING:
    from .robot_loop import RobotLoop

SINGULAR = (
    "the mass matrix of these parameters is not positive definite: nothing can be simulated; take "
    "parameters of links that can exist"
)
_LEAST = 1e-3  # eigenvalue of a mass matrix whose diagonal is 1
_POSES = 50  # of a record, at which the mass matrix is looked at


def felt_inertias(loop: RobotLoop, record: Record, theta: Theta | None = None) -> Array:
    """Return the inertia that each drive feels on a record, (n,), kg m2 or kg.

    Raises
    ------
    AxisError
        If the mass matrix is not positive definite there.
    """
    rows = np.linspace(0, record.n_samples - 1, _POSES).astype(int)
    M = loop.mass_matrix(record.q[rows], theta)
    size = np.sqrt(np.maximum(np.diagonal(M, axis1=1, axis2=2), 1e-300))
    unit = M / size[:, :, np.newaxis] / size[:, np.newaxis, :]
    if np.linalg.eigvalsh(unit).min() <= _LEAST:  # between the poses it could be indefinite
        raise AxisError(SINGULAR)
    return np.asarray(1.0 / np.diag(np.linalg.inv(M.mean(axis=0))), dtype=float)


def possible(
    loop: RobotLoop, values: Mapping[str, float], record: Record, rows: Callable[[], Array]
) -> dict[str, float]:
    """Return the nearest values that can be simulated on a record.

    Bounds hold, and the mass matrix is positive definite wherever the robot moves. Where it is
    not, the links are replaced by the nearest ones that can exist, measured by the force along
    the record, the robot's own as the prior.

    Parameters
    ----------
    values : mapping
        Of every parameter.
    record : Record
    rows : callable
        Returns the observation matrix of the record, (N, p).

    Raises
    ------
    MissingExtraError
        If that takes cvxpy and it is not installed.
    """
    bounds = loop.parameters
    found = {k: min(max(v, bounds[k].lower), bounds[k].upper) for k, v in values.items()}
    try:
        felt_inertias(loop, record, found)
    except AxisError:
        theta = consistent(loop, found, rows()) @ loop.base.matrix.T
        found |= dict(zip(loop.base.names, theta.tolist(), strict=True))
    return found


def consistent(
    loop: RobotLoop,
    theta: Theta,
    X: Array | None = None,
    pull: float = 1e-6,
    deviation: Array | None = None,
) -> Array:
    """Return parameters of links that can exist, nearest to these; see `RobotLoop.consistent`."""
    values = loop.values(theta)
    wanted = np.array([values[name] for name in loop.base.names])
    own = [loop._own_parameters[name].lower for name in loop._own_names]
    prior = np.concatenate([loop.robot.inertias.ravel(), loop._own_starts()])
    metric = None
    if X is not None:
        metric = np.zeros((min(X.shape), len(wanted)))
        metric[:, loop.free] = np.linalg.qr(X, mode="r")
    return nearest(loop.base.matrix, wanted, metric, prior, np.array(own), pull, deviation)


def prior_deviation(loop: RobotLoop, share: float) -> Array:
    """Return the standard deviation of the robot file's parameters, (10 n + k,).

    Of the links a share of their natural sizes; of the joints' own parameters it says nothing.
    """
    links = share * sizes(loop.robot.inertias)
    least = 1e-6 * links.reshape(-1, 10).max(axis=0)  # of a link without mass
    own = np.full(len(loop._own_names), np.inf)
    return np.concatenate([np.maximum(links, least).ravel(), own])
