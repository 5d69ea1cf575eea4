"""Physical consistency: least squares and instrumental variables under matrix inequalities."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ivtools.errors import EstimationError
from ivtools.estimators.base import Estimator
from ivtools.estimators.least_squares import joint_weights
from ivtools.estimators.matrix_inequalities import Matrices, solve_lmi
from ivtools.linalg import CovType, norms_of, reweighted, solve_iv
from ivtools.loop import RobotLoop
from ivtools.loop.robot_masses import prior_deviation
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
    is pulled towards the robot's own file, or all of it as far as a `prior` says. Where the free
    estimate is physical it is the estimate: biased by encoder noise as least squares is, and where
    a bound is active by the bound.

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
    prior : float, optional
        Of a robot: how well its file, from a drawing, knows the links, as a standard deviation
        relative to their natural sizes; 0.3 is 30 %. The estimate is the mean of both, each
        weighed by how well it is known, and so are the standard errors; ``extras["from_prior"]``
        and a note say what came from the prior. Default: the file decides what the record leaves
        free, and nothing else.

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
    prior: float | None = None

    def estimate(self, problem: Problem) -> FitResults:
        """Minimise norm(y - X theta) over the physical parameters."""
        if isinstance(problem.loop, RobotLoop):
            return self._informed(problem, nearest_links(problem, None, self.prior, self.cov_type))
        theta, active = self._solve(problem, None)
        return self._results(problem, theta, active)

    def _informed(self, problem: Problem, links: NearestLinks, **status: Any) -> FitResults:
        """Return the results of a robot, with what a prior makes of their covariance."""
        weights = links.weights
        results = self._results(problem, links.theta, (), links.notes, weights=weights, **status)
        if links.from_prior is None:
            return results
        share = pd.Series(links.from_prior, results.params.index)
        left = np.sqrt(1.0 - share)
        cov = results.cov.mul(left, axis=0).mul(left, axis=1)
        return replace(results, cov=cov, extras={**results.extras, "from_prior": share})

    def _solve(self, problem: Problem, Z: Array | None) -> tuple[Array, tuple[str, ...]]:
        """Return the constrained estimate (p,) and the names of the bounds it touches."""
        if self.prior is not None:
            raise EstimationError("a prior is that of a robot's links; one axis has none")
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
    cov_type, matrices, least_inertia, prior
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
        found: NearestLinks | None = None
        start = np.array([problem.start[name] for name in problem.names])
        theta = np.clip(start, lower, upper)  # (p,)
        scale = np.linalg.norm(problem.X, axis=0)
        for n_iter in range(1, self.max_iter + 1):  # noqa: B007
            Z = problem.simulated_rows(theta, scale_gain=not links)[0]  # (N, p)
            if links:
                active: tuple[str, ...] = ()
                found = nearest_links(problem, Z, self.prior, self.cov_type)
                new = found.theta
            else:
                new, active = self._solve(problem, Z)
            done = np.all(scale * np.abs(new - theta) <= self.tol * np.linalg.norm(scale * new))
            theta = new
            if done:
                break
        status: dict[str, Any] = {
            "Z": Z, "n_iter": n_iter, "n_simulations": n_iter, "converged": bool(done)
        }  # fmt: skip
        if found is not None:
            return self._informed(problem, found, **status)
        return self._results(problem, theta, active, **status)


class NearestLinks(NamedTuple):
    """Links that can exist, nearest to an estimate.

    Attributes
    ----------
    theta : (p,) ndarray
        Their base parameters.
    notes : tuple of str
        What to say.
    weights : (N,) ndarray
        Inverse variances of the rows.
    from_prior : (p,) ndarray or None
        Share of each parameter's variance that a prior took away: 1 where only it knows.
    """

    theta: Array
    notes: tuple[str, ...]
    weights: Array
    from_prior: Array | None = None


def nearest_links(
    problem: Problem, Z: Array | None, prior: float | None = None, cov_type: CovType = "hac"
) -> NearestLinks:
    """Return the possible links that fit best, beside what a prior knows of them.

    With P the projection on Z (on X if it is None), norm(P (y - X theta)) is least at the free
    estimate, and grows from there as norm(P X (theta - free)): what `RobotLoop.consistent` takes.
    Beside a prior distances are measured by the covariance of the free estimate.
    """
    X, y = problem.X, problem.y
    loop: Any = problem.loop
    weights = joint_weights(y - X @ solve_iv(X, y, names=problem.names), problem.row_joints)
    free = solve_iv(X, y, Z, weights, problem.names)
    rows = reweighted(X, weights)  # (N, p)
    if Z is not None:
        rows = np.linalg.qr(reweighted(Z, weights) / norms_of(Z))[0].T @ rows  # (p, p)
    if prior is not None:
        fit = FitResults.from_solution(
            "", free, X, y, problem=problem, Z=Z, weights=weights, cov_type=cov_type
        )
        return _beside(prior, loop, fit, rows, weights)
    phi = loop.consistent(dict(zip(problem.names, free.tolist(), strict=True)), rows)
    theta = (loop.base.matrix @ phi)[loop.free]
    away = 100.0 * float(np.linalg.norm(X @ (theta - free)) / np.linalg.norm(y))
    said = (
        f"links that can exist, {away:.2g} % of the force away from the estimate without that; "
        "what the record leaves free is the robot file's"
    )
    return NearestLinks(theta, (said,), weights)


def _beside(prior: float, loop: Any, fit: FitResults, rows: Array, weights: Array) -> NearestLinks:
    """Return the possible links between a free estimate and a prior, each as well as it is known.

    With normal errors of both, the precision of the standard parameters is M'RM + D^-2, M being the
    matrix of the base parameters, R the rows' normal matrix, D the prior's deviations. Errors that
    hang together make rows worth less: by the median ratio of the estimate's variances to theirs.
    """
    if not prior > 0.0:
        raise EstimationError(f"prior is {prior}; it is a relative deviation, above 0")
    deviation = prior_deviation(loop, prior)  # (10 n + k,)
    R = np.linalg.qr(rows, mode="r")  # (p, p)
    plain = np.sum(np.linalg.inv(R) ** 2, axis=1)
    R /= np.sqrt(np.median(fit.std_errors**2 / plain))
    phi = loop.consistent(dict(fit.params), R, deviation=deviation)
    M = loop.base.matrix[loop.free]  # (p, 10 n + k)
    precision = (R @ M).T @ (R @ M) + np.diag(deviation**-2.0)
    size = np.sqrt(np.maximum(np.diag(precision), 1e-300))
    known = np.linalg.pinv(precision / size / size[:, np.newaxis], rcond=1e-12, hermitian=True)
    both = (M / size) @ known @ (M / size).T  # (p, p)
    alone = np.sum(np.linalg.inv(R) ** 2, axis=1)
    share = np.clip(1.0 - np.diag(both) / alone, 0.0, 1.0)
    number = len(share) - float(np.trace(R @ both @ R.T))
    most = [f"{n} {100.0 * s:.0f} %" for n, s in zip(fit.names, share, strict=True) if s > 0.5]
    said = (
        f"links that can exist, between the estimate and a robot file known to {100 * prior:g} %",
        f"{number:.1f} of {len(share)} directions are the prior's: "
        + (f"most of what is known of {', '.join(most)}" if most else "of no parameter the most"),
    )
    return NearestLinks(M @ phi, said, weights, share)


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
