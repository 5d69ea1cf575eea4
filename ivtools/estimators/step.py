"""A step of an iterated instrumental-variable estimate, and the path of its steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ivtools.linalg import Weights, covariance

Array = NDArray[np.float64]

FAR = 0.1  # a step that moves a parameter by more is far from convergence
STEADY = 1e-2  # a step that moves a parameter by less is near


class System(NamedTuple):
    """The equations of one step, y = X theta + e, and their instruments.

    Attributes
    ----------
    X, y, Z : (N, p), (N,), (N, p) ndarray
    joints : (N,) ndarray of int
        Joint of each row.
    t : (N,) ndarray
        Time of each row, s.
    """

    X: Array
    y: Array
    Z: Array
    joints: NDArray[np.int_]
    t: Array


class Step(NamedTuple):
    """One step: the system simulated at `at` (p,) and its solution `theta` (p,).

    `scaled` says whether the loop had its gain scaled; `change` is the largest relative change of
    a parameter. A `late` step is one of many: there, FAR is no less than a standard error.
    """

    at: Array
    theta: Array
    system: System
    weights: Weights | None
    change: float
    scaled: bool
    late: bool = False

    @property
    def near(self) -> bool:
        """Whether the solution is near enough for weights and for the loop's own gain."""
        return self.change <= FAR or self.weights is not None

    @property
    def resids(self) -> Array:
        """Residual of the solution, (N,), N or N m."""
        return self.system.y - self.system.X @ self.theta

    @property
    def length(self) -> float:
        """How far the step moves the force of the simulated motion, N or N m."""
        return norm(self.system.Z @ (self.theta - self.at))

    @property
    def moved(self) -> float:
        """How far the step moves a parameter, at most, in standard errors."""
        X, _, Z = self.system[:3]
        variance = np.diag(covariance(X, self.resids, Z, weights=self.weights))  # (p,)
        moved = np.abs(self.theta - self.at)
        errors = np.divide(moved, np.sqrt(variance), where=moved > 0.0, out=0.0 * moved)
        return float(np.max(errors))

    def lengthens(self, last: Step | None) -> bool:
        """Whether this step is longer than the last one, which an approach is not.

        Steps of other weights, or of a loop with its gain scaled, do not compare; nor do small
        ones, as a sample that turns its direction changes the equations.
        """
        if last is None or last.scaled or self.scaled or self.late:
            return False
        if self.weights is not last.weights:
            return False
        return self.change > STEADY and self.length > last.length


class Path(NamedTuple):
    """Where an iteration has got to: its last step, what it took, and why it stopped.

    `misfits` are those of its points (`IDIMIV.misfit`), the last one's last.
    """

    step: Step | None
    n_iter: int
    n_simulations: int
    converged: bool
    failure: str
    misfits: tuple[float, ...]


def norm(x: Array) -> float:
    """Return the Euclidean norm."""
    return float(np.linalg.norm(x))
