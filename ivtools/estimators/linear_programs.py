"""The linear programs of a feasible set |y - X theta| <= bound, by HiGHS."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from ivtools.errors import EstimationError

Array = NDArray[np.float64]

SLACK = 1e-9  # relative tolerance of the linear programs


class _Normalised:
    """The rows of a set in numbers of size 1, whatever their units: what a solver's tolerances ask.

    With unit-norm columns A, theta about the least-squares solution and forces in multiples of a
    unit, x = (theta - centre) scale / unit and |rest - A x| <= bound.
    """

    def __init__(self, X: Array, y: Array, bound: Array, unit: float | None = None) -> None:
        norms = np.linalg.norm(X, axis=0)
        self.scale = np.where(norms > 0.0, norms / np.sqrt(len(X)), 1.0)  # (p,)
        self.A = X / self.scale  # (N, p)
        self.centre = np.linalg.lstsq(self.A, y)[0] / self.scale  # (p,)
        rest = y - X @ self.centre  # (N,)
        self.unit = float(unit or np.max(np.abs(rest))) or 1.0
        self.rest, self.bound = rest / self.unit, bound / self.unit

    @property
    def faces(self) -> tuple[Array, Array]:
        """The set as sides x <= ends, (2N, p) and (2N,)."""
        ends = np.concatenate([self.bound + self.rest, self.bound - self.rest])
        return np.vstack([self.A, -self.A]), ends

    def inside(self, theta: Array) -> Array:
        """Return theta (p,) in these numbers."""
        return (theta - self.centre) * self.scale / self.unit

    def outside(self, x: Array) -> Array:
        """Return theta (p,) of these numbers."""
        return self.centre + x * self.unit / self.scale


def smallest_bound(X: Array, y: Array, bound: Array) -> tuple[float, Array, NDArray[np.intp]]:
    """Minimise the factor c with |y - X theta| <= c bound.

    Returns
    -------
    factor : float
    theta : (p,) ndarray
    rows : ndarray of int
        Rows with a multiplier: no theta gives them a smaller factor.

    Examples
    --------
    >>> X, y = np.ones((3, 1)), np.array([0.0, 1.0, 4.0])
    >>> factor, theta, rows = smallest_bound(X, y, np.ones(3))
    >>> round(factor, 9), theta.round(9).tolist(), rows.tolist()
    (2.0, [2.0], [0, 2])
    """
    largest, p = float(np.max(bound)), X.shape[1]
    numbers = _Normalised(X, y, bound)
    share = bound / largest  # the factor is then one of the unit
    A, ends = numbers.A, np.concatenate([numbers.rest, -numbers.rest])
    sides = np.vstack([np.column_stack([A, -share]), np.column_stack([-A, -share])])
    found = _solve(np.append(np.zeros(p), 1.0), sides, ends, p)
    multipliers = np.abs(found.ineqlin.marginals).reshape(2, -1).sum(axis=0)
    rows = np.flatnonzero(multipliers > 1e-9 * max(multipliers.max(), 1e-300))
    return float(found.x[-1]) * numbers.unit / largest, numbers.outside(found.x[:-1]), rows


def tightest_box(X: Array, y: Array, bound: Array) -> Array:
    """Return the least and the largest value (2, p) of each parameter in the set."""
    numbers, p = _Normalised(X, y, bound, float(np.max(bound))), X.shape[1]
    A, b = numbers.faces
    ends = [[s * _solve(s * unit, A, b, p).fun for unit in np.eye(p)] for s in (1.0, -1.0)]
    return numbers.outside(np.asarray(ends))


def chebyshev_centre(X: Array, y: Array, bound: Array) -> tuple[Array, float]:
    """Return the centre (p,) of the largest ball in the set, and its radius, N or N m.

    The ball is one of unit-norm columns, so that the units of the parameters do not matter.
    """
    numbers, p = _Normalised(X, y, bound, float(np.max(bound))), X.shape[1]
    A, b = numbers.faces
    sides = np.column_stack([A, np.linalg.norm(A, axis=1)])
    found = _solve(np.append(np.zeros(p), -1.0), sides, b, p)
    return numbers.outside(found.x[:-1]), float(found.x[-1]) * numbers.unit


def middle_centre(X: Array, y: Array, bound: Array, radius: float, box: Array) -> Array:
    """Return, of the centres (p,) of balls of this radius, the one nearest to the box's middle.

    Rows of one parameter alone may limit the ball; it can then slide along all the others. The
    distance is the largest of any parameter, in the width of the box (2, p).
    """
    numbers, p = _Normalised(X, y, bound, float(np.max(bound))), X.shape[1]
    A, b = numbers.faces
    low, high = (numbers.inside(ends) for ends in box)
    middle, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-12)
    one = np.ones((p, 1))
    sides = np.vstack([
        np.column_stack([A, np.zeros(len(A))]),
        np.column_stack([np.diag(1.0 / half), -one]),
        np.column_stack([np.diag(-1.0 / half), -one]),
    ])  # fmt: skip
    room = b - (1.0 - 1e-7) * radius / numbers.unit * np.linalg.norm(A, axis=1)
    ends = np.concatenate([room, middle / half, -middle / half])
    return numbers.outside(_solve(np.append(np.zeros(p), 1.0), sides, ends, p).x[:-1])


def _solve(cost: Array, A: Array, b: Array, free: int) -> Any:
    """Solve a linear program by HiGHS; the variables after the first `free` are not negative."""
    bounds = [(None, None)] * free + [(0.0, None)] * (len(cost) - free)
    for method in ("highs-ds", "highs-ipm"):  # the second where the first loses its way
        found = linprog(cost, A, b, bounds=bounds, method=method)
        if found.status != 4:  # a numerical difficulty
            break
    if found.status == 3:
        raise EstimationError(
            "the feasible set is unbounded: columns depend on each other or nothing moves; drop a "
            "parameter"
        )
    if found.status != 0:
        raise EstimationError(f"the linear program failed: {found.message.split('.')[0]}")
    return found
