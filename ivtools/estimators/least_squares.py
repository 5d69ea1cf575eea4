"""Least squares of the inverse dynamic identification model (IDIM): ordinary, weighted, robust."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import EstimationError
from ivtools.estimators.base import Estimator
from ivtools.estimators.iteration import relative_change
from ivtools.linalg import solve_iv
from ivtools.results import FitResults

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]

TOLERANCE = 1e-4  # change of a parameter at which the weights have settled


@dataclass(frozen=True)
class IDIMLS(Estimator):
    """Ordinary least squares, theta = argmin norm(y - X theta).

    Biased in closed loop by whatever noise of the position passes the pipeline; the reference
    that every other method is compared with.

    Parameters
    ----------
    cov_type : {"hac", "robust", "classical"}
        Covariance of the estimates; the classical one is that of the EMPS report.

    References
    ----------
    M. Gautier, "Dynamic identification of robots with power model", ICRA 1997;
    A. Janot, M. Gautier, M. Brunot, "Data set and reference models of EMPS", 2019.

    Examples
    --------
    ::

        IDIMLS(cov_type="classical").fit(problem).summary()
    """

    key: ClassVar[str] = "idim-ls"
    robots: ClassVar[bool] = True

    def estimate(self, problem: Problem) -> FitResults:
        """Solve y (N,) = X (N, p) theta (p,) + e (N,)."""
        X, y = problem.X, problem.y
        theta = solve_iv(X, y, names=problem.names)
        return FitResults.from_solution(
            self.key, theta, X, y, problem=problem, cov_type=self.cov_type
        )


@dataclass(frozen=True)
class IDIMWLS(Estimator):
    """Weighted least squares: each joint by the deviation of its error, iterated.

    With one joint and no robust weights this is `IDIMLS`.

    Parameters
    ----------
    cov_type : {"hac", "robust", "classical"}
        Covariance of the estimates.
    robust : {None, "huber"}
        "huber" gives rows with large errors less weight, iterated (IRLS) by statsmodels' RLM.
    max_iter : int
        Most iterations of the weights.

    References
    ----------
    M. Gautier, ICRA 1997; P. J. Huber, E. M. Ronchetti, *Robust Statistics*, 2nd ed., 2009.

    Examples
    --------
    ::

        IDIMWLS(robust="huber").fit(problem).params
    """

    key: ClassVar[str] = "idim-wls"
    robots: ClassVar[bool] = True

    robust: Literal["huber"] | None = None
    max_iter: int = 100

    def __post_init__(self) -> None:
        """Refuse a norm that is not known."""
        if self.robust not in (None, "huber"):
            raise EstimationError(f"robust = {self.robust!r} is unknown; use 'huber' or None")

    def estimate(self, problem: Problem) -> FitResults:
        """Solve the system with its rows divided by the deviation of their joint."""
        X, y = problem.X, problem.y
        theta, weights, n_iter, converged = self._weighted(problem)
        if self.robust:
            factor, n_iter, converged = huber_weights(X, y, weights, self.max_iter)
            weights = weights * factor
            theta = solve_iv(X, y, weights=weights, names=problem.names)
        return FitResults.from_solution(
            self.key,
            theta,
            X,
            y,
            problem=problem,
            weights=weights,
            cov_type=self.cov_type,
            n_iter=n_iter,
            converged=converged,
        )

    def _weighted(self, problem: Problem) -> tuple[Array, Array, int, bool]:
        """Iterate estimate (p,) and weights (N,) of the joints until the estimate stays."""
        X, y = problem.X, problem.y
        theta = solve_iv(X, y, names=problem.names)
        for n_iter in range(1, self.max_iter + 1):  # noqa: B007
            weights = joint_weights(y - X @ theta, problem.row_joints)
            old, theta = theta, solve_iv(X, y, weights=weights, names=problem.names)
            if settled := relative_change(old, theta, X, y) <= TOLERANCE:
                break
        return theta, weights, n_iter, settled


def joint_weights(resids: Array, joints: NDArray[np.intp]) -> Array:
    """Return the inverse variance of the residual (N,) of each row's joint.

    Parameters
    ----------
    resids : (N,) ndarray
        Residual of a first fit, in N or N m.
    joints : (N,) ndarray of int
        Joint of each row.

    Returns
    -------
    (N,) ndarray
        1 for every row if no joint has an error.

    Examples
    --------
    >>> joint_weights(np.array([1.0, -1.0, 2.0, -2.0]), np.array([0, 0, 1, 1]))
    array([1.  , 1.  , 0.25, 0.25])
    """
    count = np.bincount(joints)
    variance = np.bincount(joints, resids**2) / np.maximum(count, 1)
    floor = variance.max() * np.finfo(float).eps  # an exact joint must not weigh infinitely
    if floor == 0.0:
        return np.ones_like(resids)
    return 1.0 / np.maximum(variance, floor)[joints]


def huber_weights(X: Array, y: Array, weights: Array, max_iter: int) -> tuple[Array, int, bool]:
    """Return Huber's weights (N,) of the weighted rows, the iterations and whether they settled.

    Examples
    --------
    >>> X, y = np.ones((9, 1)), np.array([0.0, 1.0, -1.0, 0.5, -0.5, 0.2, -0.2, 0.0, 50.0])
    >>> factor, _, converged = huber_weights(X, y, np.ones(9), 100)
    >>> bool(factor[-1] < 0.05), converged
    (True, True)
    """
    from statsmodels.robust.norms import HuberT
    from statsmodels.robust.robust_linear_model import RLM

    root = np.sqrt(weights)
    fit = RLM(y * root, X * root[:, None], M=HuberT()).fit(maxiter=max_iter)
    n_iter = int(fit.fit_history["iteration"])
    return np.asarray(fit.weights), n_iter, n_iter < max_iter
