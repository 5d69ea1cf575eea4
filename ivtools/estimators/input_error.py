"""Input error: the force of the simulated loop against the measured one (DIDIM, CLIE)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from ivtools.estimators.base import Estimator
from ivtools.estimators.iteration import (
    Point,
    Start,
    Way,
    check_iteration,
    near,
    relative_change,
    starting_values,
)
from ivtools.estimators.sensitivities import Signal
from ivtools.estimators.simulated_error import SimulatedError
from ivtools.loop import RobotLoop
from ivtools.results import WITHHELD, FitResults

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]

NO_INTERVALS = (
    "no standard errors: didim neglects how the simulated motion depends on the parameters; "
    "idim-iv has intervals"
)


@dataclass(frozen=True)
class DIDIM(Estimator):
    """Direct and inverse dynamic identification models: y = X_s(theta_k) theta, iterated.

    X_s is the observation matrix of the simulated closed loop, so only the force is measured.
    It is a Gauss-Newton step on the simulated force that neglects how the simulated motion
    depends on theta, which is little as long as the controller makes it follow its reference.

    Parameters
    ----------
    cov_type : {"hac", "robust", "classical"}
        Covariance of the estimates, with X_s as the observation matrix.
    tol : float
        The iteration ends when the relative change of every parameter, and the change of the
        norm of the residual relative to that of y, are below this.
    max_iter : int
        Most solutions of the regression.
    start : {"axis", "ls"} or mapping
        Starting values: the axis file's, those of least squares, or by name.
    scale_gain : bool
        While a step changes theta by more than 10 %, simulate the loop with its gain scaled to
        the inertia (`Problem.scaled_loop`): convergence from far off, to the same result.
    filtered : bool, optional
        Band-pass the simulated position. The simulation is free of noise and y does not pass that
        filter, so X_s need not either; but a force that the pipeline shifts to the time of the
        differences asks for differences on this side as well. Default: if it is shifted.

    References
    ----------
    M. Gautier, A. Janot, P.-O. Vandanjon, "A new closed-loop output error method for parameter
    identification of robot dynamics", IEEE Trans. Control Syst. Technol. 21(2), 2013.

    Examples
    --------
    >>> import ivtools as iv
    >>> problem = iv.Problem(iv.datasets.twin(), iv.axes.emps())
    >>> fit = DIDIM(start={"inertia": 50, "viscous": 50, "coulomb": 5, "offset": 0}).fit(problem)
    >>> fit.converged, bool(abs(fit.params["inertia"] - 95.0) < 1.0)
    (True, True)
    """

    key: ClassVar[str] = "didim"
    robots: ClassVar[bool] = True
    chooses: ClassVar[bool] = True

    tol: float = 1e-4
    max_iter: int = 20
    start: Start = "axis"
    scale_gain: bool = True
    filtered: bool | None = None

    def __post_init__(self) -> None:
        """Refuse a tolerance or a number of iterations that makes no sense."""
        check_iteration(self.tol, self.max_iter)

    def estimate(self, problem: Problem) -> FitResults:
        """Iterate y (N,) = X_s(theta_k) (N, p) theta_(k+1) (p,)."""
        theta = starting_values(problem, self.start)
        shifted = problem.pipeline.force_shift != 0.0
        filtered = shifted if self.filtered is None else self.filtered
        way = Way(problem, filtered)
        at = near(way, theta, self.max_iter) if self.scale_gain else way.simulate(theta)
        rho, halved, converged = np.inf, False, False
        while not converged and way.n_iter < self.max_iter:
            theta, last = way.solve(at.X), rho  # (p,)
            rho = float(np.linalg.norm(problem.y - at.X @ theta))
            converged = self._settled(problem, at, theta, rho, last)
            if not converged:
                new, shortened = way.towards(theta, at)
                if new is None:
                    break
                at, halved = new, halved or shortened
        notes = ("steps were shortened on the way",) if halved else ()
        results = FitResults.from_solution(
            self.key,
            theta if converged else at.theta,
            at.X,
            problem.y,
            problem=problem,
            cov_type=self.cov_type,
            n_iter=way.n_iter,
            n_simulations=way.n_simulations,
            converged=converged,
            notes=notes,
        )
        if not isinstance(problem.loop, RobotLoop):
            return results
        unknown = results.cov * np.nan
        said = (*results.notes, NO_INTERVALS)
        return replace(results, cov=unknown, cov_type=WITHHELD, notes=said)

    def _settled(self, problem: Problem, at: Point, theta: Array, rho: float, last: float) -> bool:
        """Whether parameters (p,) and norm of the residual have stopped to change."""
        same = abs(rho - last) <= self.tol * float(np.linalg.norm(problem.y))
        return same and relative_change(at.theta, theta, at.X, problem.y) <= self.tol


@dataclass(frozen=True)
class CLIE(SimulatedError):
    """Closed-loop input error: nonlinear least squares on the simulated force.

    What `DIDIM` does, with the dependence of the simulated motion on theta taken into account;
    and any parameter of the loop can be estimated.

    Parameters
    ----------
    cov_type, signal, parameters, start, starts, spread, tol, max_iter, n_jobs, step
        As for `SimulatedError`.

    References
    ----------
    M. Brunot, A. Janot, F. Carrillo, J. Cheong, J.-P. Noel, "Output error methods for robot
    identification", J. Dynamic Systems, Measurement and Control 142(3), 2020.

    Examples
    --------
    >>> import ivtools as iv
    >>> loop = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    >>> fit = CLIE().fit(iv.Problem(iv.datasets.twin(), loop))
    >>> fit.converged, bool(abs(fit.params["inertia"] - 95.0) < 0.3)
    (True, True)
    """

    key: ClassVar[str] = "clie"
    chooses: ClassVar[bool] = True

    signal: Signal | None = "force"
