"""What iterations of a problem share: where they start, how they come near, when they stop."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import AxisError, EstimationError
from ivtools.linalg import solve_iv

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]
Start = Literal["axis", "ls"] | Mapping[str, float]

SMALL_SHARE = 1e-3  # of the force: parameters that contribute less are measured against it
FAR = 0.1  # a step that changes theta by more than this share is far from the solution
_HALVINGS = 8
_WORSE = 1.1  # the simulated error may grow by this factor before a step is shortened


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


class Point(NamedTuple):
    """The simulated loop at some parameters.

    Attributes
    ----------
    theta : ndarray, (p,)
    X : ndarray, (N, p)
        Observation matrix of the simulated motion.
    error : float
        Norm of the measured less the simulated force, N or N m.
    """

    theta: Array
    X: Array
    error: float


class Way:
    """The iteration's view of a problem; it counts what it costs.

    Parameters
    ----------
    problem : Problem
    filtered : bool
        Band-pass the simulated position.
    """

    def __init__(self, problem: Problem, filtered: bool) -> None:
        self.problem, self.filtered = problem, filtered
        self.n_iter = self.n_simulations = 0

    def simulate(self, theta: Array) -> Point:
        """Return the simulated loop at theta (p,).

        Raises
        ------
        EstimationError
            If it is unstable.
        """
        self.n_simulations += 1
        with np.errstate(all="ignore"):  # what overflows is reported below
            X, y_s = self.problem.simulated_rows(theta, filtered=self.filtered)
            error = float(np.linalg.norm(self.problem.y - y_s))
        if not np.isfinite(error) or not np.isfinite(X).all():
            raise EstimationError("the simulated loop is unstable at these parameters")
        return Point(theta, X, error)

    def simulate_scaled(self, theta: Array) -> Array:
        """Return the observation matrix (N, p) of the loop with its gain scaled to the inertia."""
        self.n_simulations += 1
        with np.errstate(all="ignore"):
            X = self.problem.instruments(theta, filtered=self.filtered, scale_gain=True)
        if not np.isfinite(X).all():
            raise EstimationError("the simulated loop is unstable at these parameters")
        return X

    def solve(self, X: Array) -> Array:
        """Return the least-squares solution of y = X_s theta, (p,)."""
        self.n_iter += 1
        return solve_iv(X, self.problem.y, names=self.problem.names)

    def towards(self, theta: Array, at: Point) -> tuple[Point | None, bool]:
        """Return the point at theta, or one nearer to `at` if that one is no better."""
        for halving in range(_HALVINGS):
            new: Point | None
            try:
                new = self.simulate(theta)
            except (AxisError, EstimationError):  # no inertia, or unstable
                new = None
            if new is not None and new.error <= _WORSE * at.error:
                return new, halving > 0
            theta = 0.5 * (theta + at.theta)
        return None, True


def near(way: Way, theta: Array, max_iter: int) -> Point:
    """Iterate with the gain scaled to the inertia until a step is small, and return that point.

    Raises
    ------
    EstimationError
        If the loop cannot be simulated at theta, whatever its gain.
    """
    first, old = theta, None
    try:
        while way.n_iter < max_iter:
            theta, X = _simulated(way.simulate_scaled, theta, old)
            old, theta = theta, way.solve(X)
            if relative_change(old, theta, X, way.problem.y) <= FAR:
                break
        return _simulated(way.simulate, theta, old)[1]
    except (AxisError, EstimationError) as error:
        return _started(way, first, error)


def better(way: Way, at: Point, theta: Array) -> Point:
    """Return the loop simulated at theta (p,) if that fits better than a point, else the point."""
    try:
        other = way.simulate(theta)
    except (AxisError, EstimationError):
        return at
    return other if other.error < at.error else at


def _started(way: Way, theta: Array, error: Exception) -> Point:
    """Return the loop simulated where the iteration began, which led nowhere."""
    try:
        return way.simulate(theta)
    except (AxisError, EstimationError):
        names = way.problem.names
        values = ", ".join(f"{n} {v:.4g}" for n, v in zip(names, theta, strict=True))
        raise EstimationError(f"no simulation to start from at {values}: {error}") from error


def _simulated(simulate: Callable[[Array], Any], theta: Array, old: Array | None) -> Any:
    """Return theta and the loop simulated at it, or nearer to the old theta if it cannot be."""
    for _ in range(_HALVINGS):
        try:
            return theta, simulate(theta)
        except (AxisError, EstimationError):  # no inertia, or unstable
            theta = theta if old is None else 0.5 * (theta + old)
    return theta, simulate(theta)
