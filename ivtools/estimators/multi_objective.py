"""Multi-objective estimation: the compromise between force, position and velocity errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import EstimationError, MissingExtraError
from ivtools.estimators.base import Estimator
from ivtools.estimators.pareto_front import ParetoFront, hypervolume
from ivtools.linalg import covariance, solve_iv
from ivtools.results import FitResults

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]

OBJECTIVES = ("force", "position", "velocity")
_FAILED = 1e3  # relative error, in %, of an axis that cannot be simulated
_SETTLED = 1e-2  # relative growth of the hypervolume over the last quarter of the generations


@dataclass(frozen=True)
class NSGA2(Estimator):
    """Genetic search for the Pareto front of the simulated loop's force, position and velocity.

    No single parameter vector is best in every signal; the front has those that no other one beats
    in all of them. The estimate is the knee: the point nearest to the ideal one, each error scaled
    by its range on the front. The search needs no starting values but a box. Biased: the knee is a
    compromise, not the point of least error, and a search ends near the front, not on it; on
    simulated records the frictions are off by per cents, the inertia by tenths of one.

    Parameters
    ----------
    cov_type : {"hac", "robust", "classical"}
        Covariance of least squares at the knee's residual: a measure of the record, not of the
        search.
    bounds : mapping, optional
        Name to (lower, upper). Default: the least-squares estimate +- `span` of itself (+- 10
        standard errors at least), within the physical bounds.
    span : float
        See `bounds`.
    population, generations : int
        Their product is the number of simulations.
    seed : int
        Of the search; the same seed gives the same front.

    References
    ----------
    A. Montazeri, C. West, S. D. Monk, C. J. Taylor, "Dynamic modelling and parameter estimation of
    a hydraulic robot manipulator using a multi-objective genetic algorithm", Int. J. Control 90(4),
    2017; K. Deb, A. Pratap, S. Agarwal, T. Meyarivan, IEEE Trans. Evolutionary Computation 6(2),
    2002.

    Examples
    --------
    ::

        fit = NSGA2(population=40, generations=30).fit(problem)
        fit.extras["front"].plot()
    """

    key: ClassVar[str] = "nsga2"

    bounds: Mapping[str, tuple[float, float]] | None = None
    span: float = 0.5
    population: int = 40
    generations: int = 50
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse a search without candidates."""
        if self.population < 4 or self.generations < 1:
            raise EstimationError(
                f"population {self.population} and generations {self.generations} are too few; "
                "take at least 4 and 1"
            )

    def estimate(self, problem: Problem) -> FitResults:
        """Search, and return the knee with the front as ``extras["front"]``."""
        front = self.front(problem)
        theta = front.theta[front.knee]
        X, y = problem.X, problem.y
        return FitResults.from_solution(
            self.key,
            theta,
            X,
            y,
            problem=problem,
            cov_type=self.cov_type,
            n_iter=self.generations,
            n_simulations=front.n_simulations,
            converged=front.settled,
            notes=("knee of the Pareto front; deviations are those of least squares",),
            extras={"front": front},
        )

    def front(self, problem: Problem) -> ParetoFront:
        """Return the Pareto front.

        Raises
        ------
        MissingExtraError
            If pymoo is not installed.
        """
        lower, upper = self.box(problem)
        found, history = _search(self, problem, lower, upper)
        theta, errors = np.atleast_2d(found.X), np.atleast_2d(found.F)
        order = np.argsort(errors[:, 0])
        return ParetoFront(
            names=tuple(problem.names),
            units=tuple(problem.units[name] for name in problem.names),
            objectives=OBJECTIVES,
            theta=theta[order],
            errors=errors[order],
            n_simulations=self.population * self.generations,
            settled=_settled(history),
        )

    def box(self, problem: Problem) -> tuple[Array, Array]:
        """Return the lower and upper ends (p,), (p,) of the search."""
        theta = solve_iv(problem.X, problem.y, names=problem.names)
        cov = covariance(problem.X, problem.y - problem.X @ theta)
        reach = np.maximum(self.span * np.abs(theta), 10.0 * np.sqrt(np.diag(cov)))
        known = problem.loop.parameters
        lower = np.maximum(theta - reach, [known[name].lower for name in problem.names])
        upper = np.minimum(theta + reach, [known[name].upper for name in problem.names])
        for name, ends in (self.bounds or {}).items():
            if name not in problem.names or not ends[0] < ends[1]:
                raise EstimationError(f"bounds of {name}: {ends}; name a parameter, lower < upper")
            lower[problem.names.index(name)], upper[problem.names.index(name)] = ends
        return lower, upper


def simulated_errors(problem: Problem, theta: Array) -> Array:
    """Return the relative errors (3,) of force, position and velocity in closed loop, in %.

    Examples
    --------
    >>> import ivtools as iv
    >>> problem = iv.Problem(iv.datasets.twin(), iv.axes.emps())
    >>> simulated_errors(problem, np.array([95.0, 200.0, 20.0, -3.0])).shape
    (3,)
    """
    try:
        simulation = problem.simulate(theta)
        if not simulation.finite:
            return np.full(len(OBJECTIVES), _FAILED)
        errors = simulation.relative_error(problem.record, problem.pipeline)
    except ValueError:  # an inertia of 0
        return np.full(len(OBJECTIVES), _FAILED)
    return np.array([min(errors[name], _FAILED) for name in OBJECTIVES])


def _search(
    settings: NSGA2, problem: Problem, lower: Array, upper: Array
) -> tuple[Any, list[Array]]:
    """Run NSGA-II; return its result and the front of every generation."""
    try:
        from pymoo.algorithms.moo.nsga2 import NSGA2 as Algorithm
        from pymoo.core.problem import ElementwiseProblem
        from pymoo.optimize import minimize
    except ImportError:
        raise MissingExtraError("pymoo", "methods") from None

    class Axis(ElementwiseProblem):
        """The simulated loop as pymoo sees it."""

        def _evaluate(self, x: Array, out: dict[str, Array], *_: Any, **__: Any) -> None:
            out["F"] = simulated_errors(problem, x)

    axis = Axis(n_var=len(lower), n_obj=len(OBJECTIVES), xl=lower, xu=upper)
    history: list[Array] = []
    found = minimize(
        axis,
        Algorithm(pop_size=settings.population),
        ("n_gen", settings.generations),
        seed=settings.seed,
        callback=lambda algorithm: history.append(algorithm.opt.get("F").copy()),
        verbose=False,
    )
    return found, history


def _settled(history: list[Array]) -> bool:
    """Whether the dominated volume has all but stopped to grow."""
    before, last = history[max(0, (3 * len(history)) // 4 - 1)], history[-1]
    worst = np.maximum(before.max(axis=0), last.max(axis=0)) * 1.1
    volume = hypervolume(last, worst)
    return len(history) >= 4 and volume - hypervolume(before, worst) <= _SETTLED * volume
