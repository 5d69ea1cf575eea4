"""Direct dynamic model: the acceleration regressed on what causes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import EstimationError
from ivtools.estimators.base import Estimator
from ivtools.estimators.instrumental import IDIMIV, within_bounds
from ivtools.estimators.step import System
from ivtools.linalg import solve_iv
from ivtools.results import FitResults

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]


def direct_regressor(X: Array, y: Array, inertia: int) -> Array:
    """Return the observation matrix W (N, p) of the direct model from the inverse one.

    ``ddq = W b`` with W = (tau, minus the other columns of X) and
    b = (1/M, Fv/M, Fc/M, offset/M ...), where y = tau and column `inertia` of X is ddq.

    Regressing ddq on W, or with instruments Z, and mapping b back to theta is the same as solving
    the inverse model y = X theta with instruments W, or Z: the two residuals differ by the factor
    -M alone, so that Z'(ddq - W b) = 0 and Z'(y - X theta) = 0 have one solution, and the delta
    method for theta(b) gives the covariance of that instrumental variable estimate.

    Examples
    --------
    >>> direct_regressor(np.array([[2.0, 3.0]]), np.array([5.0]), inertia=0)
    array([[ 5., -3.]])
    """
    W = -X
    W[:, inertia] = y
    return W


def inertia_column(problem: Problem) -> int:
    """Return the column of the inertia.

    Raises
    ------
    EstimationError
        If the model has none: nothing is then accelerated.
    """
    if "inertia" not in problem.names:
        raise EstimationError(
            f"the model has no inertia but {', '.join(problem.names)}; the direct model needs one"
        )
    return problem.names.index("inertia")


@dataclass(frozen=True)
class DDMLS(Estimator):
    """Least squares of the direct dynamic model, ddq = b tau - (Fv/M) dq - (Fc/M) sign(dq) - ...

    The noise of the acceleration, by far the largest, is on the left; that of the force is on the
    right and correlates with it through the controller: biased in closed loop, otherwise than
    `IDIMLS`. Parameters, residual and covariance are those of the inverse model.

    Parameters
    ----------
    cov_type : {"hac", "robust", "classical"}
        Covariance of the estimates, by the delta method (see `direct_regressor`).

    References
    ----------
    M. Brunot, 2015, for the EMPS axis; the identity with an instrumental variable estimate of the
    inverse model is derived in `direct_regressor`.

    Examples
    --------
    ::

        DDMLS().fit(problem).params
    """

    key: ClassVar[str] = "ddm-ls"

    def estimate(self, problem: Problem) -> FitResults:
        """Solve ddq (N,) = W (N, p) b (p,) as W' (y - X theta) = 0."""
        W = direct_regressor(problem.X, problem.y, inertia_column(problem))
        theta = solve_iv(problem.X, problem.y, W, names=problem.names)
        return FitResults.from_solution(
            self.key,
            theta,
            problem.X,
            problem.y,
            Z=W,
            problem=problem,
            cov_type=self.cov_type,
            extras={"invalid_instruments": "the method regresses on the measured force"},
        )


@dataclass(frozen=True)
class DDMIV(IDIMIV):
    """Instrumental variables of the direct dynamic model: W of the simulated loop, iterated.

    Where the simulated force is what its model says, that is away from standstill, the instruments
    span those of `IDIMIV`, and so the two estimates agree.

    Parameters
    ----------
    cov_type, tol, max_iter, start, scale_gain, filtered, weighted, robust
        As for `IDIMIV`.

    References
    ----------
    As for `DDMLS`.

    Examples
    --------
    >>> import ivtools as iv
    >>> loop = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    >>> fit = DDMIV().fit(iv.Problem(iv.datasets.twin(), loop))
    >>> fit.converged, bool(abs(fit.params["inertia"] - 95.0) < 0.5)
    (True, True)
    """

    key: ClassVar[str] = "ddm-iv"
    robots: ClassVar[bool] = False

    def estimate(self, problem: Problem) -> FitResults:
        """Iterate W(theta_k)' (ddq - W b) = 0 as W(theta_k)' (y - X theta) = 0."""
        inertia_column(problem)
        return super().estimate(problem)

    def system(
        self, problem: Problem, theta: Array, scale_gain: bool = False, X: Array | None = None
    ) -> System:
        """Return the equations, and W simulated at theta (p,) as their instruments."""
        column = inertia_column(problem)
        X_s, y_s = problem.simulated_rows(
            within_bounds(problem, theta), filtered=self.filtered, scale_gain=scale_gain
        )
        Z = direct_regressor(X_s, y_s, column)  # (N, p)
        return System(problem.X, problem.y, Z, problem.row_joints, problem.t)
