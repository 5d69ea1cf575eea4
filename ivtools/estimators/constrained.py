"""Physical consistency: least squares and instrumental variables under matrix inequalities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ivtools.estimators.base import Estimator
from ivtools.estimators.matrix_inequalities import Matrices, solve_lmi
from ivtools.results import FitResults

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LMILS(Estimator):
    """Least squares under linear matrix inequalities: the nearest physical parameters.

    Every parameter keeps its physical bounds (inertia above 0, frictions not below 0), written as
    one diagonal matrix inequality; more inequalities, such as the pseudo-inertia of a robot's
    links, come from `matrices`. Where the unconstrained estimate is physical it is the estimate:
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

    matrices: Matrices | None = None
    least_inertia: float = 1e-3

    def estimate(self, problem: Problem) -> FitResults:
        """Minimise norm(y - X theta) over the physical parameters."""
        theta, active = self._solve(problem, None)
        return self._results(problem, theta, active)

    def _solve(self, problem: Problem, Z: Array | None) -> tuple[Array, tuple[str, ...]]:
        """Return the constrained estimate (p,) and the names of the bounds it touches."""
        lower, upper = bounds(problem, self.least_inertia)
        return solve_lmi(problem.X, problem.y, Z, lower, upper, self.matrices, problem.names)

    def _results(
        self, problem: Problem, theta: Array, active: tuple[str, ...], **status: Any
    ) -> FitResults:
        """Return the results, with a note on every bound that is touched."""
        notes = tuple(f"{name} is on its physical bound" for name in active)
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

    tol: float = 1e-4
    max_iter: int = 20

    def estimate(self, problem: Problem) -> FitResults:
        """Simulate, fill Z (N, p), solve under the inequalities, repeat."""
        lower, upper = bounds(problem, self.least_inertia)
        start = np.array([problem.start[name] for name in problem.names])
        theta = np.clip(start, lower, upper)  # (p,)
        scale = np.linalg.norm(problem.X, axis=0)
        for n_iter in range(1, self.max_iter + 1):  # noqa: B007
            Z = problem.simulated_rows(theta, scale_gain=True)[0]  # (N, p)
            new, active = self._solve(problem, Z)
            done = np.all(scale * np.abs(new - theta) <= self.tol * np.linalg.norm(scale * new))
            theta = new
            if done:
                break
        status = {"Z": Z, "n_iter": n_iter, "n_simulations": n_iter, "converged": bool(done)}
        return self._results(problem, theta, active, **status)


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
