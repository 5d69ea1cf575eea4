"""Simulated error: nonlinear least squares on a signal of the simulated loop."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import AxisError, EstimationError
from ivtools.estimators.base import Estimator
from ivtools.estimators.iteration import (
    Start,
    Way,
    better,
    check_iteration,
    near,
    starting_values,
)
from ivtools.estimators.sensitivities import STEP, Signal, SimulatedSignal, scans
from ivtools.results import FitResults

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]

ALIKE = 0.95  # cosine of what a parameter does to the motion and of what another start does
SHOWN_ROWS = 10  # independent rows per parameter, for standard errors from an error that drifts
EXACT = 1e-6  # of the signal: an error below this is the arithmetic's, not noise
_PROMISE = 0.05  # share of the error that one more linear step may promise to remove at a minimum
_STILL = 1e-4  # or such a step may be as large as this, in sizes of the parameters


class Minimum(NamedTuple):
    """Where a search ended.

    Attributes
    ----------
    theta : ndarray, (p,)
    error : ndarray, (N,)
        Measured less simulated signal.
    J : ndarray, (N, p)
        Sensitivities of the simulated signal.
    model : SimulatedSignal
    n_iter, n_simulations : int
    converged : bool
    """

    theta: Array
    error: Array
    J: Array
    model: SimulatedSignal
    n_iter: int
    n_simulations: int
    converged: bool


@dataclass(frozen=True)
class SimulatedError(Estimator):
    """Nonlinear least squares on the measured less the simulated signal.

    Every parameter of the loop can be estimated, those that no regression is linear in (a delay,
    a Stribeck speed, the frequency of a flexible mode) included. Of these, the ones without a
    starting value in the loop are scanned, and the best points of the scan start a search each.

    Parameters
    ----------
    cov_type : {"hac", "robust", "classical"}
        Covariance of the estimates, with the sensitivities as the observation matrix.
    signal : {"force", "position", "velocity"}
        What is compared.
    parameters : tuple of str, optional
        What is estimated; default: every parameter of the loop but the nuisances of its effects.
        The others keep their values.
    start : {"axis", "ls"} or mapping
        Starting values of what the force is linear in; a few input-error steps with scaled gain
        precede the search.
    starts : int
        Searches at most, from the best starting points; the best result counts.
    spread : float
        If there are fewer starting points, others are drawn around the best with this relative
        deviation, always the same ones; 0 draws none.
    tol : float
        A search ends when a step changes the parameters, or the sum of squares, by less.
    max_iter : int
        Most steps of a search.
    n_jobs : int
        Threads for the simulations of one step; -1 is one per core.
    step : float
        Finite difference of the sensitivities, in values of a parameter that alone would make
        the whole force; a larger one smooths a rugged sum of squares.

    References
    ----------
    L. Ljung, *System Identification*, 2nd ed., 1999, ch. 10; M. A. Branch, T. F. Coleman, Y. Li,
    SIAM J. Scientific Computing 21(1), 1999: the search, as in scipy.
    """

    signal: Signal | None = "force"
    parameters: tuple[str, ...] | None = None
    start: Start = "axis"
    starts: int = 2
    spread: float = 0.0
    tol: float = 1e-6
    max_iter: int = 50
    n_jobs: int = -1
    step: float = STEP

    def __post_init__(self) -> None:
        """Refuse settings that make no sense."""
        check_iteration(self.tol, self.max_iter)
        if self.starts < 1:
            raise EstimationError(f"starts = {self.starts} must be 1 or more")

    def estimate(self, problem: Problem) -> FitResults:
        """Minimise the norm of y (N,) - y_s(theta) (N,) from each starting point."""
        known = problem.loop.parameters
        free = self.parameters or tuple(n for n, p in known.items() if not p.nuisance)
        points, spent = self._starting_points(problem, free)
        compared = self.compared(problem)
        found = [self._search(compared, free, point) for point in points]
        best = min(found, key=lambda m: float(m.error @ m.error))
        spent += sum(m.n_simulations for m in found)
        return self._results(problem, best, spent)

    def compared(self, problem: Problem) -> Problem:
        """Return the problem whose simulation is compared with the record."""
        return problem

    def signal_of(self, problem: Problem) -> Signal:
        """Return the signal that is compared."""
        return self.signal or "force"

    def _starting_points(
        self, problem: Problem, free: tuple[str, ...]
    ) -> tuple[list[dict[str, float]], int]:
        """Return the most promising starting values, and the simulations that it took."""
        ranked: list[tuple[float, dict[str, float]]] = []
        spent, failure = 0, EstimationError("no parameter is free")
        for shapes in scans(problem, free):
            loop = replace(problem.loop, start={**problem.loop.start, **shapes})
            way = Way(replace(problem, loop=loop), filtered=False)
            try:
                start = starting_values(problem, self.start)
                if (
                    problem.record.q_ref is None
                ):  # no loop to approach in, and an open one needs none
                    ranked.append((0.0, loop.values(start)))
                    continue
                at = better(way, near(way, start, self.max_iter), start)
            except (AxisError, EstimationError) as error:
                failure = EstimationError(str(error))
                continue
            finally:
                spent += way.n_simulations
            found = dict(zip(problem.names, at.theta.tolist(), strict=True))
            values = {**loop.values(start), **{n: v for n, v in found.items() if n in free}}
            ranked.append((at.error, values))
        if not ranked:
            raise failure
        ranked.sort(key=lambda pair: pair[0])
        points = [values for _, values in ranked[: self.starts]]
        return [*points, *self._around(points, free)], spent

    def _around(
        self, points: list[dict[str, float]], free: tuple[str, ...]
    ) -> Iterator[dict[str, float]]:
        """Yield further starting points around the best, up to `starts` in all."""
        rng = np.random.default_rng(20130301)
        for _ in range(self.starts - len(points) if self.spread > 0.0 else 0):
            factors = np.exp(self.spread * rng.standard_normal(len(free)))
            changes = dict(zip(free, factors.tolist(), strict=True))
            yield {name: v * changes.get(name, 1.0) for name, v in points[0].items()}

    def _search(
        self, problem: Problem, free: tuple[str, ...], values: Mapping[str, float]
    ) -> Minimum:
        """Search from one point."""
        held = {name: v for name, v in values.items() if name not in free}
        threads = self.n_jobs if self.n_jobs > 0 else os.cpu_count() or 1
        signal = self.signal_of(problem)
        model = SimulatedSignal(problem, free, held, signal, threads, self.step)
        start = np.clip([values[n] for n in free], *model.bounds)
        if not np.isfinite(model(start)).all():
            raise EstimationError(f"the simulation is unstable at the starting values {values}")
        found = self._minimise(model, start)
        theta = found.x * model.sizes
        simulated, J = model.sensitivities(theta)
        rest, steps = model.measured - simulated, int(found.njev)
        inside = ~pressed(theta, model)  # (p,), those that no bound stopped
        settled = found.status > 0 and stationary(
            J[:, inside], rest, theta[inside], model.sizes[inside]
        )
        cost = 1 + int(found.nfev) + (steps + 1) * (len(free) + 1)
        return Minimum(theta, rest, J, model, steps, cost, bool(settled))

    def _minimise(self, model: SimulatedSignal, start: Array) -> Any:
        """Minimise the relative error by the trust-region method of scipy, theta in its sizes."""
        from scipy.optimize import least_squares

        unit = float(np.linalg.norm(model.measured)) or 1.0

        def error(x: Array) -> Array:
            return (model(x * model.sizes) - model.measured) / unit

        def jacobian(x: Array) -> Array:
            return model.sensitivities(x * model.sizes)[1] * model.sizes / unit

        with np.errstate(all="ignore"):  # a step into instability is rejected
            return least_squares(
                error,
                start / model.sizes,
                jacobian,
                bounds=(model.bounds[0] / model.sizes, model.bounds[1] / model.sizes),
                x_scale="jac",
                ftol=self.tol,
                xtol=self.tol,
                gtol=None,
                max_nfev=self.max_iter,
            )

    def _results(self, problem: Problem, best: Minimum, spent: int) -> FitResults:
        """Complete the minimum; the sensitivities take the place of X."""
        model = best.model
        linear = best.error + best.J @ best.theta  # (N,), of which best.error is the residual
        hidden = list(hardly_shown(best)) if model.signal != "force" else []
        drift = list(drifting(best)) if model.signal != "force" else []
        results = FitResults.from_solution(
            self.key,
            best.theta,
            best.J,
            linear,
            names=model.free,
            units=problem.units,
            cov_type=self.cov_type,
            n_iter=best.n_iter,
            n_simulations=spent,
            converged=best.converged and not hidden and not drift,
            notes=(
                f"the error is that of the simulated {model.signal}",
                *hidden,
                *drift,
                *at_bounds(best),
            ),
            extras={"signal": model.signal},
        )
        return replace(results, y=model.measured, problem=problem)


def hardly_shown(found: Minimum) -> Iterator[str]:
    """Yield a remark for each parameter that the motion cannot tell from the controller's start.

    Integral action takes back what a constant force does to the motion: behind it an offset is
    another state of the integrator, and the record's first commands alone tell the two apart.
    """
    problem = found.model.problem
    if not len(problem.loop.controller.law(problem.record.dt).C):  # no state, no start
        return
    begun = found.model.by_start(found.theta)  # (N,)
    sizes = np.linalg.norm(begun) * np.linalg.norm(found.J, axis=0)  # (p,)
    alike = np.abs(begun @ found.J) / np.maximum(sizes, np.finfo(float).tiny)
    for name, cosine in zip(found.model.free, alike, strict=True):
        if cosine > ALIKE:
            yield (
                f"{name} does to the {found.model.signal} what another start of the controller's "
                "integrator does, and the first commands alone tell the two apart: estimate it "
                "from the force (clie)"
            )


def drifting(found: Minimum) -> Iterator[str]:
    """Yield a remark if the error wanders, so that its rows say next to nothing of its variance.

    What no controller holds integrates the noise: a position behind a velocity loop, the motion of
    an open one. Regressions on a random walk find what is not there, with small standard errors.

    References
    ----------
    C. W. J. Granger, P. Newbold, "Spurious regressions in econometrics", J. Econometrics 2, 1974.
    """
    scale = np.linalg.norm(found.model.measured)
    rows, needed = independent_rows(found.error), SHOWN_ROWS * len(found.theta)
    if rows < needed and np.linalg.norm(found.error) > EXACT * scale:
        yield (
            f"the error drifts: its {len(found.error)} rows count as {rows:.0f}, which is too few "
            "for standard errors; compare the force (clie)"
        )


def independent_rows(error: Array) -> float:
    """Return how many independent rows have a mean as sure as that of a series (N,).

    Examples
    --------
    >>> noise = np.random.default_rng(0).standard_normal(4000)
    >>> independent_rows(noise) > 3000.0, independent_rows(noise.cumsum()) < 40.0
    (True, True)
    """
    n, centred = len(error), error - error.mean()
    power = np.abs(np.fft.rfft(centred, 2 * n)) ** 2
    acov = np.fft.irfft(power)[:n]
    below = np.flatnonzero(acov <= 0.0)
    last = int(below[0]) if len(below) else n
    return float(n / (1.0 + 2.0 * np.sum(acov[1:last]) / acov[0])) if acov[0] > 0.0 else float(n)


def stationary(J: Array, error: Array, theta: Array, sizes: Array) -> bool:
    """Whether a search ended at a minimum and not where it got stuck.

    There, one more Gauss-Newton step either removes little of the error or hardly moves.

    Examples
    --------
    >>> J, error = np.eye(3)[:, :1], np.array([0.0, 1.0, 1.0])
    >>> stationary(J, error, np.ones(1), np.ones(1)), stationary(J, J[:, 0], np.ones(1), np.ones(1))
    (True, False)
    """
    unit = np.maximum(np.linalg.norm(J, axis=0), np.finfo(float).tiny)  # (p,)
    step = np.linalg.lstsq(J / unit, error)[0]
    removed = np.linalg.norm(J / unit @ step) <= _PROMISE * np.linalg.norm(error)
    small = np.abs(step / unit) <= _STILL * np.maximum(sizes, np.abs(theta))
    return bool(removed or small.all())


def pressed(theta: Array, model: SimulatedSignal) -> NDArray[np.bool_]:
    """Return which parameters (p,) lie at a bound, to a thousandth of their size."""
    lower, upper = model.bounds
    pressed: NDArray[np.bool_] = np.minimum(theta - lower, upper - theta) <= 1e-3 * model.sizes
    return pressed


def at_bounds(found: Minimum) -> Iterator[str]:
    """Yield a remark for each parameter that a bound stopped."""
    stopped = pressed(found.theta, found.model)
    for name, value, stop in zip(found.model.free, found.theta, stopped, strict=True):
        if stop:
            yield f"{name} lies at its bound, {value:.4g}"
