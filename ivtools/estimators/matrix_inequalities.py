"""Least squares under linear matrix inequalities, by cvxpy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

from ivtools.errors import EstimationError
from ivtools.linalg import solve_iv
from ivtools.robot.inertia import cvxpy as _cvxpy
from ivtools.robot.inertia import pseudo_inertia as pseudo_inertia

Array = NDArray[np.float64]
Matrices = Callable[[Sequence[Any]], Sequence[Any]]

_ACTIVE = 1e-6  # of a constraint, relative to the deviation of its column


def solve_lmi(
    X: Array,
    y: Array,
    Z: Array | None,
    lower: Array,
    upper: Array,
    matrices: Matrices | None = None,
    names: Sequence[str] | None = None,
) -> tuple[Array, tuple[str, ...]]:
    """Minimise norm(P (y - X theta)) under inequalities; P projects on Z (on X if Z is None).

    Parameters
    ----------
    X, y, Z : (N, p), (N,), (N, m) or None
        The regression.
    lower, upper : (p,) ndarray
        Bounds; infinite ones are none.
    matrices : callable, optional
        Linear matrix inequalities, see `LMILS`.
    names : sequence of str, optional
        Of the columns, for messages.

    Returns
    -------
    theta : (p,) ndarray
    active : tuple of str
        Parameters on a bound.

    Raises
    ------
    MissingExtraError
        If cvxpy is not installed.
    EstimationError
        If no parameters respect the inequalities.

    Examples
    --------
    >>> X, y = np.eye(3)[:, :2], np.array([1.0, -2.0, 0.0])
    >>> theta, active = solve_lmi(X, y, None, np.zeros(2), np.full(2, np.inf), names=["a", "b"])
    >>> theta.round(6).tolist(), active
    ([1.0, 0.0], ('b',))
    """
    cvxpy = _cvxpy()
    names = list(names or (f"theta{i}" for i in range(X.shape[1])))
    free = solve_iv(X, y, Z, names=names)  # (p,)
    scale = np.linalg.norm(X, axis=0)
    Q = qr(X if Z is None else Z / np.linalg.norm(Z, axis=0), mode="economic")[0]  # (N, m)
    A = (Q.T @ X) / scale  # (m, p): the cost is norm(A (x - x_free))
    size = max(float(np.linalg.norm(scale * free)), 1e-300)
    x = cvxpy.Variable(len(names))  # (theta - free) * scale / size
    theta = [free[i] + x[i] * (size / scale[i]) for i in range(len(names))]
    sides = [(theta[i] - b) * s * scale[i] / size
             for s, ends in ((1.0, lower), (-1.0, upper))
             for i, b in enumerate(ends) if np.isfinite(b)]  # fmt: skip
    rules = [cvxpy.diag(cvxpy.hstack(sides)) >> 0] if sides else []
    rules += [matrix >> 0 for matrix in (matrices(theta) if matrices else ())]
    task = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares(A @ x)), rules)
    tight = {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-11}
    task.solve(solver=cvxpy.CLARABEL, **tight)
    if x.value is None:
        raise EstimationError(f"the matrix inequalities are {task.status}: no parameters respect "
                              "them; loosen a bound")  # fmt: skip
    found = free + x.value * size / scale
    reach = _ACTIVE * size / scale
    low, high = found - lower <= reach, upper - found <= reach
    found, active = np.where(low, lower, np.where(high, upper, found)), low | high
    return found, tuple(name for name, on in zip(names, active, strict=True) if on)
