"""Instrumental variables for the inverse dynamic model: instruments from the simulated loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import EstimationError
from ivtools.estimators.base import Estimator
from ivtools.estimators.contradiction import possible
from ivtools.estimators.iteration import (
    SMALL_SHARE,
    Start,
    check_iteration,
    relative_change,
    starting_values,
)
from ivtools.estimators.least_squares import joint_weights
from ivtools.estimators.step import FAR, Path, Step, System, norm
from ivtools.linalg import Weights, solve_iv
from ivtools.loop import ClosedLoop
from ivtools.results import FitResults

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]

HELD = 3e-3  # a step that moves a parameter by less changes no observed direction any more
AVERAGED = 8  # steps after which one goes half the way: what circles, or repels, then settles
NEGLIGIBLE = 0.1  # standard errors: a late step that moves no parameter by more is the last
_HALVINGS = 6


@dataclass(frozen=True)
class IDIMIV(Estimator):
    """Instrumental variables: Z from the closed loop simulated at the last estimate, iterated.

    The simulated loop knows the reference and not the noise, so Z moves with X and not with the
    error: what biases least squares in closed loop is gone. What is left are errors of the model
    of the measurement (see `IDIMBCIV`).

    Parameters
    ----------
    cov_type : {"hac", "robust", "classical"}
        Covariance of the estimates.
    tol : float
        The iteration ends when the relative change of every parameter and of the norm of the
        residual is below this.
    max_iter : int
        Most steps.
    start : {"axis", "ls"} or mapping
        Starting values: the axis file's, those of least squares, or by name.
    scale_gain : bool
        While a step moves a parameter by more than 10 %, simulate the loop with its gain scaled
        to the inertia (`Problem.scaled_loop`): far starts converge, and to the same estimate.
    filtered : bool
        Band-pass the simulated position as the measured one; False takes the simulated velocity
        and acceleration as they are, as much of the literature does.
    weighted : bool, optional
        Weigh the rows by the residual of their joint; default: where there are several.
    robust : {None, "huber"}
        "huber" gives rows with large errors less weight.

    References
    ----------
    A. Janot, P.-O. Vandanjon, M. Gautier, "A generic instrumental variable approach for
    industrial robot identification", IEEE Trans. Control Syst. Technol. 22(1), 2014;
    M. A. Krasnoselskii, Uspekhi Mat. Nauk 10, 1955; W. R. Mann, Proc. AMS 4, 1953: averaged steps.

    Examples
    --------
    >>> import ivtools as iv
    >>> loop = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    >>> fit = IDIMIV(start={"inertia": 50.0}).fit(iv.Problem(iv.datasets.twin(), loop))
    >>> fit.converged, bool(abs(fit.params["inertia"] - 95.0) < 0.5)
    (True, True)
    """

    key: ClassVar[str] = "idim-iv"
    robots: ClassVar[bool] = True
    chooses: ClassVar[bool] = True

    tol: float = 1e-4
    max_iter: int = 30
    start: Start = "axis"
    scale_gain: bool = True
    filtered: bool = True
    weighted: bool | None = None
    robust: Literal["huber"] | None = None

    def __post_init__(self) -> None:
        """Refuse settings that make no sense."""
        check_iteration(self.tol, self.max_iter)
        if self.robust not in (None, "huber"):
            raise EstimationError(f"robust = {self.robust!r} is unknown; use 'huber' or None")

    def estimate(self, problem: Problem) -> FitResults:
        """Iterate Z(theta_k)' (y - X theta_(k+1)) = 0."""
        path = self._iterate(problem, starting_values(problem, self.start))
        return self._results(problem, path)

    def _iterate(self, problem: Problem, theta: Array) -> Path:
        """Iterate from theta (p,) until nothing changes, or no step leads on.

        Where friction holds the axis, the simulated motion jumps with theta, and there may be no
        fixed point to the last digit: late steps are averaged (Krasnoselskii, Mann), and one that
        is small beside the standard errors ends the iteration.
        """
        last, n_iter, tries, converged, failure = None, 0, 0, False, ""
        misfits: list[float] = []
        while not converged and n_iter < self.max_iter:
            late = last is not None and (last.late or n_iter >= AVERAGED)
            step, tried, failure = self._step(problem, theta, last, late)
            n_iter, tries = n_iter + 1, tries + tried
            if step is None:
                break
            converged = self._settled(last, step)
            theta, last = 0.5 * (step.at + step.theta) if step.late else step.theta, step
            misfits += [] if step.scaled else [self.misfit(step)]
        return Path(last, n_iter, tries, converged, failure, tuple(misfits))

    def misfit(self, step: Step) -> float:
        """Return how badly the loop simulated at a step's point fits; 0 if that is not known."""
        return 0.0

    def system(
        self, problem: Problem, theta: Array, scale_gain: bool = False, X: Array | None = None
    ) -> System:
        """Return the equations and the instruments simulated at theta (p,).

        Where X depends on theta, the X (N, p) of an earlier step can be given, and is held.
        """
        Z = problem.instruments(
            within_bounds(problem, theta), filtered=self.filtered, scale_gain=scale_gain
        )
        return System(problem.X, problem.y, Z, problem.row_joints, problem.t)

    def row_weights(self, system: System, resids: Array, last: Step) -> Weights | None:
        """Return the weights of the rows for this residual (N,), after the last step."""
        weighted = system.joints.any() if self.weighted is None else self.weighted
        weights = joint_weights(resids, system.joints) if weighted else None
        if self.robust:
            weights = huber(resids, weights)
        return weights

    def notes(self, problem: Problem, step: Step) -> tuple[str, ...]:
        """Return remarks on the last step."""
        return ()

    def extras(self, problem: Problem, step: Step) -> dict[str, Any]:
        """Return what the method has to say beside its estimate."""
        return {}

    def _step(
        self, problem: Problem, theta: Array, last: Step | None, late: bool
    ) -> tuple[Step | None, int, str]:
        """Step from theta, or from nearer to the last point if that leads nowhere.

        The steps of an approach grow shorter (Deuflhard's natural monotonicity test); one that is
        longer than the last has gone too far. Where none is shorter, averaged steps go on.

        Returns
        -------
        The step, the simulations that it took, and why there is none.

        References
        ----------
        P. Deuflhard, *Newton Methods for Nonlinear Problems*, 2004, section 3.3.
        """
        far = self.scale_gain and not late and (last is None or not last.near)
        step, failure = None, ""
        anchor = None if last is None else last.at
        for tried in range(1, _HALVINGS + 1):
            try:
                step = self._solve(problem, theta, last, far, late)
                if not step.lengthens(last):
                    return step, tried, ""
            except EstimationError as error:  # unstable, at rest, or without inertia
                failure = str(error)
            anchor = starting_values(problem, "ls") if anchor is None else anchor
            theta = 0.5 * (theta + anchor)
        return step and step._replace(late=True), _HALVINGS, "" if step else failure

    def _solve(
        self, problem: Problem, theta: Array, last: Step | None, far: bool, late: bool
    ) -> Step:
        held = last is not None and last.change <= HELD  # else a sample on the brink may flip on
        system = self.system(problem, theta, far, last.system.X if last and held else None)
        if not (np.isfinite(system.Z).all() and np.isfinite(system.y).all()):
            raise EstimationError("the simulated loop runs away at these parameters")
        weights = None
        if last is not None and last.near:
            weights = self.row_weights(system, system.y - system.X @ theta, last)
        new = solve_iv(system.X, system.y, system.Z, weights, problem.names)  # (p,)
        step = Step(theta, new, system, weights, 0.0, far, late)
        change = relative_change(theta, new, system.X, system.y)
        return step._replace(change=min(change, FAR * step.moved) if late else change)

    def _settled(self, last: Step | None, step: Step) -> bool:
        """Whether the parameters and the norm of the residual have stopped to change."""
        if last is not None and step.late and step.change <= FAR * NEGLIGIBLE:
            return True
        if last is None or not last.near or step.change > self.tol:
            return False
        old, new = np.linalg.norm(last.resids), np.linalg.norm(step.resids)
        return bool(abs(new - old) <= self.tol * max(float(new), SMALL_SHARE * norm(step.system.y)))

    def _results(self, problem: Problem, path: Path) -> FitResults:
        step = path.step
        status: dict[str, Any] = {
            "n_iter": path.n_iter,
            "n_simulations": path.n_simulations,
            "converged": path.converged,
        }
        failed = (f"the last step failed: {path.failure}",) if path.failure else ()
        if step is None:  # no loop to take instruments from
            X, y = problem.X, problem.y
            theta = solve_iv(X, y, names=problem.names)
            status["notes"] = (*failed, "the values are those of least squares")
            return FitResults.from_solution(
                self.key, theta, X, y, problem=problem, cov_type=self.cov_type, **status
            )
        return FitResults.from_solution(
            self.key,
            step.theta,
            step.system.X,
            step.system.y,
            Z=step.system.Z,
            weights=step.weights,
            t=step.system.t,
            problem=problem,
            cov_type=self.cov_type,
            notes=(*failed, *self.notes(problem, step)),
            extras=self.extras(problem, step),
            **status,
        )


def within_bounds(problem: Problem, theta: Array) -> Array:
    """Return theta (p,) with every parameter inside its physical bounds, for a simulation.

    Raises
    ------
    EstimationError
        If the inertia is not positive: nothing can be simulated.
    """
    if isinstance(problem.loop, ClosedLoop):  # a robot is made possible link by link
        inertia = theta[problem.names.index("inertia")] if "inertia" in problem.names else np.nan
        if not inertia > 0.0:
            raise EstimationError(f"inertia is {inertia:.4g}; a simulation needs a positive one")
    return possible(problem, theta)


def huber(resids: Array, weights: Array | None = None) -> Array:
    """Return Huber's weights (N,) of a residual (N,), times the weights given.

    Examples
    --------
    >>> huber(np.array([0.1, -0.1, 0.2, -0.2, 50.0])).round(3)
    array([1.   , 1.   , 1.   , 1.   , 0.008])
    """
    from statsmodels.robust.norms import HuberT
    from statsmodels.robust.scale import mad

    scaled = resids if weights is None else resids * np.sqrt(weights)
    scale = float(mad(scaled, center=0.0))
    factor = HuberT().weights(scaled / scale) if scale > 0.0 else np.ones_like(resids)
    return factor if weights is None else factor * weights
