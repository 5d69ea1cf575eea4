"""Base parameters: what the torques depend on, each a named sum of standard parameters.

The columns of a robot's observation matrix depend on each other: of a link's ten parameters the
first joints feel a few, and others only in sums. QR with column pivoting says how many columns are
independent; which ones follows a habit of the field, so that the names are those of the books.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from ..errors import AxisError
from .inertia import STANDARD
from .robot import Robot

Array = NDArray[np.float64]

_KEEP = ("ZZ", "XX", "XY", "XZ", "YZ", "MX", "MY", "YY", "MZ", "M")
_TOLERANCE = 1e-9  # of a column of unit norm
_NOTHING = 1e-10  # coefficient, relative to the largest one of its row
_SAMPLES = 60  # per joint; each gives as many rows as there are joints


@dataclass(frozen=True, eq=False)
class Base:
    """Base parameters as sums of standard ones.

    Parameters
    ----------
    names : tuple of str, (n_base,)
        ``ZZ1R``: the R marks a parameter regrouped with others.
    standard : tuple of str, (n_standard,)
        Names of the standard parameters.
    columns : (n_base,) ndarray of int
        The column that each base parameter keeps.
    matrix : (n_base, n_standard) ndarray
        Base parameters are ``matrix @ standard``.

    Examples
    --------
    >>> import ivtools as iv
    >>> base = base_parameters(iv.Robot.six_axis())
    >>> len(base.names), base.names[0]
    (36, 'ZZ1R')
    """

    names: tuple[str, ...]
    standard: tuple[str, ...]
    columns: NDArray[np.intp]
    matrix: Array

    @property
    def formulas(self) -> dict[str, str]:
        """The sum of standard parameters that each one is."""
        return {
            name: _formula(row, self.standard, int(kept))
            for name, row, kept in zip(self.names, self.matrix, self.columns, strict=True)
        }


def base_parameters(robot: Robot, seed: int = 0) -> Base:
    """Return the base parameters of a robot's links.

    Parameters
    ----------
    robot : Robot
    seed : int
        Of the random motion on which columns are compared; the answer does not depend on it.
    """
    q, dq, ddq = random_motion(robot, seed)
    X = robot.regressor(q, dq, ddq).reshape(-1, 10 * robot.n_joints)
    return group(X, robot.standard_names, preference(robot.n_joints))


def random_motion(robot: Robot, seed: int = 0) -> tuple[Array, Array, Array]:
    """Return positions, velocities and accelerations, (n_samples, n_joints) each, all over."""
    shape = (_SAMPLES * robot.n_joints, robot.n_joints)
    q, dq, ddq = np.random.default_rng(seed).uniform(-1.0, 1.0, (3, *shape))
    return np.where(robot.tree.slides, 1.0, np.pi) * q, 3.0 * dq, 10.0 * ddq


def preference(n_joints: int) -> list[int]:
    """Return the links' columns in the order in which they are kept as base parameters."""
    order = [STANDARD.index(name) for name in _KEEP]
    return [10 * joint + i for joint in range(n_joints) for i in order]


def group(X: Array, names: Sequence[str], order: Sequence[int] | None = None) -> Base:
    """Return the independent columns of a matrix and how the others group with them.

    Parameters
    ----------
    X : (N, p) array_like
        Observation matrix of a motion that excites everything.
    names : sequence of str, (p,)
    order : sequence of int, optional
        Columns in the order in which they are kept; default: as they come.

    Raises
    ------
    AxisError
        If the motion does not say how many columns are independent.

    References
    ----------
    M. Gautier, "Numerical calculation of the base inertial parameters of robots", Journal of
    Robotic Systems 8, 1991; W. Khalil, E. Dombre, 2002, section 9.4.

    Examples
    --------
    >>> X = np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 3.0], [1.0, 2.0, 1.0]])
    >>> group(X, ["a", "b", "c"]).formulas
    {'aR': 'a + 2 b', 'c': 'c'}
    """
    order = list(range(X.shape[1])) if order is None else list(order)
    norms = np.linalg.norm(X, axis=0)
    felt = [i for i in order if norms[i] > _TOLERANCE * norms.max()]
    R = np.asarray(np.linalg.qr(X[:, felt] / norms[felt], mode="r"))
    kept = independent(R)
    pivots = np.abs(np.diag(qr(R, mode="r", pivoting=True)[0]))
    if np.count_nonzero(pivots > _TOLERANCE) != len(kept):
        raise AxisError("the rank of the observation matrix is not clear; excite more")
    rest = [i for i in range(len(felt)) if i not in set(kept)]
    ties = np.linalg.lstsq(R[:, kept], R[:, rest], rcond=None)[0]  # (n_base, n_rest)
    matrix = np.zeros((len(kept), X.shape[1]))
    for row, k in enumerate(kept):
        line = ties[row] * norms[[felt[i] for i in rest]] / norms[felt[k]]
        scaled = np.abs(ties[row])
        line[scaled < _NOTHING * max(1.0, scaled.max(initial=0.0))] = 0.0
        matrix[row, [felt[i] for i in rest]] = line
        matrix[row, felt[k]] = 1.0
    columns = np.array([felt[k] for k in kept], dtype=np.intp)
    grouped = np.count_nonzero(matrix, axis=1) > 1
    labels = tuple(names[c] + "R" * bool(g) for c, g in zip(columns, grouped, strict=True))
    return Base(labels, tuple(names), columns, matrix)


def independent(R: Array) -> list[int]:
    """Return the columns of R (m, p), of unit norm or 0, that those before them do not span."""
    span, kept = np.zeros((len(R), 0)), list[int]()
    for i, column in enumerate(R.T):
        for _ in range(2):  # twice is enough
            column = column - span @ (span.T @ column)
        if (size := np.linalg.norm(column)) > _TOLERANCE:
            span, kept = np.column_stack([span, column / size]), [*kept, i]
    return kept


def _formula(row: Array, names: Sequence[str], kept: int) -> str:
    terms = [names[kept]]
    for i in np.flatnonzero(row).tolist():
        if i != kept:
            sign, size = "-" if row[i] < 0.0 else "+", f"{abs(row[i]):.6g}"
            terms += [sign, names[i] if size == "1" else f"{size} {names[i]}"]
    return " ".join(terms)
