"""What iterations of a problem share: where they start and when they stop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import EstimationError
from ivtools.linalg import solve_iv

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]
Start = Literal["axis", "ls"] | Mapping[str, float]

SMALL_SHARE = 1e-3  # of the force: parameters that contribute less are measured against it


def starting_values(problem: Problem, start: Start = "axis") -> Array:
    """Return the starting values, (p,), in the order of the columns of X.

    Parameters
    ----------
    problem : Problem
    start : {"axis", "ls"} or mapping
        Those of the axis file with least squares for the rest, least squares, or values by name
        with the axis file's for the rest.

    Raises
    ------
    EstimationError
        If a name is not a parameter of the problem, or a value is not finite.
    """
    if isinstance(start, str):
        if start not in ("axis", "ls"):
            raise EstimationError(f"start = {start!r} is unknown; use 'axis', 'ls' or a mapping")
        if start == "ls":
            return solve_iv(problem.X, problem.y, names=problem.names)
        start = {}
    if unknown := [name for name in start if name not in problem.names]:
        raise EstimationError(
            f"start names {', '.join(unknown)}; the parameters are {', '.join(problem.names)}"
        )
    values = np.array([float({**problem.start, **start}[name]) for name in problem.names])
    if not np.isfinite(values).all():
        raise EstimationError(f"start holds {values}; starting values must be finite")
    return values


def check_iteration(tol: float, max_iter: int) -> None:
    """Refuse a tolerance or a number of iterations that makes no sense."""
    if not 0.0 < tol < 1.0:
        raise EstimationError(f"tol = {tol} must lie between 0 and 1")
    if max_iter < 1:
        raise EstimationError(f"max_iter = {max_iter} must be 1 or more")


def relative_change(old: Array, new: Array, X: Array, y: Array) -> float:
    """Return the largest relative change of a parameter.

    A parameter near zero has no relative change of its own; one that contributes less than a
    thousandth of the force is measured against that thousandth.

    Parameters
    ----------
    old, new : (p,) ndarray
        Parameters before and after the step.
    X, y : (N, p), (N,) ndarray
        Observation matrix and force.

    Examples
    --------
    >>> X, y = np.ones((4, 1)), np.full(4, 100.0)
    >>> relative_change(np.array([100.0]), np.array([101.0]), X, y)
    0.00990...
    >>> relative_change(np.array([0.0]), np.array([1e-5]), X, y)
    0.0001
    """
    effect = np.linalg.norm(X, axis=0)  # (p,)
    floor = SMALL_SHARE * np.linalg.norm(y)
    size = np.maximum(np.abs(new) * effect, floor)
    moved = np.abs(new - old) * effect
    return float(np.max(np.divide(moved, size, out=np.zeros_like(moved), where=size > 0.0)))
