"""Approach: from any start to where the iterations of the simulated loop converge."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import AxisError, EstimationError
from ivtools.estimators.iteration import relative_change
from ivtools.linalg import solve_iv

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]

FAR = 0.1  # a step that changes theta by more than this share is far from the solution
_HALVINGS = 8
_WORSE = 1.1  # the simulated error may grow by this factor before a step is shortened


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
    names = way.problem.names
    try:
        while way.n_iter < max_iter:
            old, X = theta, way.simulate_scaled(theta)
            theta = way.solve(X)
            if relative_change(old, theta, X, way.problem.y) <= FAR:
                break
        return way.simulate(theta)
    except (AxisError, EstimationError) as error:
        values = ", ".join(f"{n} {v:.4g}" for n, v in zip(names, theta, strict=True))
        raise EstimationError(f"no simulation to start from at {values}: {error}") from error
