"""Physical consistency: least squares and instrumental variables under matrix inequalities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ivtools.estimators.base import Estimator
from ivtools.estimators.least_squares import joint_weights
from ivtools.estimators.matrix_inequalities import Matrices, solve_lmi
from ivtools.linalg import norms_of, reweighted, solve_iv
from ivtools.loop import RobotLoop
from ivtools.results import FitResults

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LMILS(Estimator):
    """Least squares under linear matrix inequalities: the nearest physical parameters.

    Every parameter keeps its physical bounds (inertia above 0, frictions not below 0), written as
    one diagonal matrix inequality; more inequalities come from `matrices`. Of a robot every link's
    pseudo-inertia has to be possible, rows are weighted by joint, and what the record leaves free
    is pulled towards the robot's own file. Where the free estimate is physical it is the estimate:
    biased by encoder noise as least squares is, and where a bound is active by the bound.

    Parameters
    ----------
    cov_type : {"hac", "robust", "classical"}
        Covariance, inequalities ignored: at an active one the error is one-sided.
    matrices : callable, optional
        Given the parameters in order (cvxpy expressions), returns symmetric matrices that have to
        be positive semidefinite; see `matrix_inequalities.pseudo_inertia`.
    least_inertia : float
        The inertia is at least this share of the mean absolute force over the mean absolute
        acceleration: "positive" needs a number.

    References
    ----------
    G. Calafiore, M. Indri, "Robust calibration and control of robotic manipulators", American
    Control Conference, 2000; C. D. Sousa, R. Cortesao, "Physical feasibility of robot base inertial
    parameter identification: a linear matrix inequality approach", Int. J. Robotics Research 33(6),
    2014.

    Examples
    --------
    >>> import ivtools as iv
    >>> problem = iv.Problem(iv.datasets.twin(), iv.axes.emps())
    >>> ls, lmi = iv.IDIMLS().fit(problem), LMILS().fit(problem)
    >>> bool((abs(lmi.params / ls.params - 1.0) < 1e-6).all())
    True
    """

    key: ClassVar[str] = "lmi-ls"
    robots: ClassVar[bool] = True

    matrices: Matrices | None = None
    least_inertia: float = 1e-3

    def estimate(self, problem: Problem) -> FitResults:
        """Minimise norm(y - X theta) over the physical parameters."""
        if isinstance(problem.loop, RobotLoop):
            theta, notes = nearest_links(problem, None)
            return self._results(problem, theta, (), notes)
        theta, active = self._solve(problem, None)
        return self._results(problem, theta, active)

    def _solve(self, problem: Problem, Z: Array | None) -> tuple[Array, tuple[str, ...]]:
        """Return the constrained estimate (p,) and the names of the bounds it touches."""
        lower, upper = bounds(problem, self.least_inertia)
        return solve_lmi(problem.X, problem.y, Z, lower, upper, self.matrices, problem.names)

    def _results(
        self,
        problem: Problem,
        theta: Array,
        active: tuple[str, ...],
        notes: tuple[str, ...] = (),
        **status: Any,
    ) -> FitResults:
        """Return the results, with a note on every bound that is touched."""
        notes = (*notes, *(f"{name} is on its physical bound" for name in active))
        return FitResults.from_solution(
            self.key,
            theta,
            problem.X,
            problem.y,
            problem=problem,
            cov_type=self.cov_type,
            notes=notes,
            extras={"active": active},
            **status,
        )


@dataclass(frozen=True)
class LMIIV(LMILS):
    """Instrumental variables under linear matrix inequalities.

    Minimises norm(Z (Z'Z)^-1 Z'(X theta - y)) with the regressor of the simulated loop as Z. The
    inequalities keep every iterate an axis that can be simulated. Unbiased as `IDIMIV` is where no
    bound is active; biased towards the inside where one is.

    Parameters
    ----------
    cov_type, matrices, least_inertia
        See `LMILS`.
    tol : float
        Relative change of the parameters at which the iteration ends.
    max_iter : int
        Most iterations.

    References
    ----------
    As for `LMILS`; A. Janot, P.-O. Vandanjon, M. Gautier, "A generic instrumental variable approach
    for industrial robot identification", IEEE Trans. Control Syst. Technol. 22(1), 2014.

    Examples
    --------
    >>> import ivtools as iv
    >>> loop = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    >>> fit = LMIIV().fit(iv.Problem(iv.datasets.twin(), loop))
    >>> fit.converged, fit.extras["active"]
    (True, ())
    """

    key: ClassVar[str] = "lmi-iv"
    chooses: ClassVar[bool] = True

    tol: float = 1e-4
    max_iter: int = 20

    def estimate(self, problem: Problem) -> FitResults:
        """Simulate, fill Z (N, p), solve under the inequalities, repeat."""
        lower, upper = bounds(problem, self.least_inertia)
        links = isinstance(problem.loop, RobotLoop)  # which can be simulated wherever they are
        notes: tuple[str, ...] = ()
        start = np.array([problem.start[name] for name in problem.names])
        theta = np.clip(start, lower, upper)  # (p,)
        scale = np.linalg.norm(problem.X, axis=0)
        for n_iter in range(1, self.max_iter + 1):  # noqa: B007
            Z = problem.simulated_rows(theta, scale_gain=not links)[0]  # (N, p)
            if links:
                active: tuple[str, ...] = ()
                new, notes = nearest_links(problem, Z)
            else:
                new, active = self._solve(problem, Z)
            done = np.all(scale * np.abs(new - theta) <= self.tol * np.linalg.norm(scale * new))
            theta = new
            if done:
                break
        status = {"Z": Z, "n_iter": n_iter, "n_simulations": n_iter, "converged": bool(done)}
        return self._results(problem, theta, active, notes, **status)


def nearest_links(problem: Problem, Z: Array | None) -> tuple[Array, tuple[str, ...]]:
    """Return the base parameters (p,) of the possible links that fit best, and what to say.

    With P the projection on Z (on X if it is None), norm(P (y - X theta)) is least at the free
    estimate, and grows from there as norm(P X (theta - free)): what `RobotLoop.consistent` takes.
    """
    X, y = problem.X, problem.y
    loop: Any = problem.loop
    weights = joint_weights(y - X @ solve_iv(X, y, names=problem.names), problem.row_joints)
    free = solve_iv(X, y, Z, weights, problem.names)
    rows = reweighted(X, weights)  # (N, p)
    if Z is not None:
        rows = np.linalg.qr(reweighted(Z, weights) / norms_of(Z))[0].T @ rows  # (p, p)
    phi = loop.consistent(dict(zip(problem.names, free.tolist(), strict=True)), rows)
    theta = (loop.base.matrix @ phi)[loop.free]
    away = 100.0 * float(np.linalg.norm(X @ (theta - free)) / np.linalg.norm(y))
    said = (
        f"links that can exist, {away:.2g} % of the force away from the estimate without that; "
        "what the record leaves free is the robot file's"
    )
    return theta, (said,)


def bounds(problem: Problem, least_inertia: float = 1e-3) -> tuple[Array, Array]:
    """Return the physical bounds (p,), (p,) of the parameters of X.

    Examples
    --------
    >>> import ivtools as iv
    >>> lower, _ = bounds(iv.Problem(iv.datasets.twin(), iv.axes.emps()))
    >>> [bool(least > 0.0) for least in lower], lower[1:].tolist()
    ([True, False, False, False], [0.0, 0.0, -inf])
    """
    known = problem.loop.parameters
    lower = np.array([known[name].lower for name in problem.names])
    upper = np.array([known[name].upper for name in problem.names])
    if "inertia" in problem.names:
        i = problem.names.index("inertia")
        moved = np.mean(np.abs(problem.X[:, i]))
        lower[i] = least_inertia * np.mean(np.abs(problem.y)) / moved if moved > 0.0 else 0.0
    return lower, upper


def unphysical(results: FitResults) -> tuple[str, ...]:
    """Return the parameters of an estimate that lie outside their physical bounds.

    Examples
    --------
    >>> import ivtools as iv
    >>> unphysical(iv.IDIMLS().fit(iv.Problem(iv.datasets.twin(), iv.axes.emps())))
    ()
    """
    if results.problem is None:
        return ()
    lower, upper = (pd.Series(b, index=results.params.index) for b in bounds(results.problem, 0.0))
    outside = (results.params < lower) | (results.params > upper)
    return tuple(str(name) for name in results.params.index[outside])
