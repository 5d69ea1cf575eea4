"""The linear programs of a feasible set |y - X theta| <= bound, by HiGHS."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from ivtools.errors import EstimationError

Array = NDArray[np.float64]

SLACK = 1e-9  # relative tolerance of the linear programs


def column_scale(X: Array) -> Array:
    """Return the norms (p,) of the columns; 1 for a column of zeros."""
    norms = np.linalg.norm(X, axis=0)
    return np.where(norms > 0.0, norms / np.sqrt(len(X)), 1.0)


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
    >>> smallest_bound(X, y, np.ones(3))
    (2.0, array([2.]), array([0, 2]))
    """
    scale = column_scale(X)
    A = X / scale
    sides = np.vstack([np.column_stack([A, -bound]), np.column_stack([-A, -bound])])
    p = X.shape[1]
    found = _solve(np.append(np.zeros(p), 1.0), sides, np.concatenate([y, -y]), p)
    multipliers = np.abs(found.ineqlin.marginals).reshape(2, -1).sum(axis=0)
    rows = np.flatnonzero(multipliers > 1e-9 * max(multipliers.max(), 1e-300))
    return float(found.x[-1]), found.x[:-1] / scale, rows


def tightest_box(X: Array, y: Array, bound: Array) -> Array:
    """Return the least and the largest value (2, p) of each parameter in the set."""
    scale = column_scale(X)
    A, b = _faces(X / scale, y, bound)
    p = X.shape[1]
    ends = [[s * _solve(s * unit, A, b, p).fun for unit in np.eye(p)] for s in (1.0, -1.0)]
    return np.asarray(ends) / scale


def chebyshev_centre(X: Array, y: Array, bound: Array) -> tuple[Array, float]:
    """Return the centre (p,) of the largest ball in the set, and its radius, N or N m.

    The ball is one of unit-norm columns, so that the units of the parameters do not matter.
    """
    scale = column_scale(X)
    A, b = _faces(X / scale, y, bound)
    p = X.shape[1]
    sides = np.column_stack([A, np.linalg.norm(A, axis=1)])
    found = _solve(np.append(np.zeros(p), -1.0), sides, b, p)
    return found.x[:-1] / scale, float(found.x[-1])


def middle_centre(X: Array, y: Array, bound: Array, radius: float, box: Array) -> Array:
    """Return, of the centres (p,) of balls of this radius, the one nearest to the box's middle.

    Rows of one parameter alone may limit the ball; it can then slide along all the others. The
    distance is the largest of any parameter, in the width of the box (2, p).
    """
    scale = column_scale(X)
    A, b = _faces(X / scale, y, bound)
    p = X.shape[1]
    middle, half = 0.5 * (box[0] + box[1]) * scale, 0.5 * (box[1] - box[0]) * scale
    half = np.maximum(half, 1e-12 * np.maximum(np.abs(middle), 1e-300))
    one = np.ones((p, 1))
    sides = np.vstack([
        np.column_stack([A, np.zeros(len(A))]),
        np.column_stack([np.diag(1.0 / half), -one]),
        np.column_stack([np.diag(-1.0 / half), -one]),
    ])  # fmt: skip
    room = b - (1.0 - 1e-7) * radius * np.linalg.norm(A, axis=1)
    ends = np.concatenate([room, middle / half, -middle / half])
    return np.asarray(_solve(np.append(np.zeros(p), 1.0), sides, ends, p).x[:-1] / scale)


def _faces(A: Array, y: Array, bound: Array) -> tuple[Array, Array]:
    """Return the set as A theta <= b."""
    return np.vstack([A, -A]), np.concatenate([bound + y, bound - y])


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
