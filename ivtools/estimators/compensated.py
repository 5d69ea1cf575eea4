"""Bias compensation: instrumental variables that are right where the measurement's model is not."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import ConvergenceWarning, EstimationError, IVToolsError
from ivtools.estimators.base import Estimator
from ivtools.estimators.instrumental import IDIMIV, within_bounds
from ivtools.estimators.iteration import starting_values
from ivtools.estimators.least_squares import IDIMLS
from ivtools.estimators.step import Path, Step, System, norm
from ivtools.results import FitResults

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]

WORSE = 1.25  # of the least misfit on the way: what fits worse is another solution
EXACT = 1e-7  # of the force: what is left below this is the arithmetic's, not noise
SETTLING_ROWS = 3  # decimated rows at either end that its filter's start and stop reach


@dataclass(frozen=True)
class IDIMBCIV(IDIMIV):
    """Bias-compensated instrumental variables: right where the measurement's model is not.

    Noise apart, y = X theta does not hold exactly: the command is held over a sample, the
    position passes a low-pass and differences that the force does not, sign(dq) is a guess around
    standstill. No instrument removes such errors, for they move with it. But the simulated loop,
    through the same pipeline, makes them as well: at the true theta, y_s - X_s theta *is* the
    error. So each step solves

        Z' (y - (y_s - X_s theta_k) - X theta) = 0,    Z = X_s(theta_k).

    On a record without noise it returns theta to the accuracy of the simulation. Two more
    sources of error are closed. The direction of motion is that of the axis itself on both sides,
    which an observer reads from the recorded command (`Problem.paired_rows`): noise of the encoder
    shakes the axis through the controller, and around a reversal neither the measured velocity
    nor a simulation without noise knows which way it goes. And the rows at the ends, where filters
    extrapolate noise, are left out.

    The principle is that of bias-compensating estimators and of indirect inference, with one
    noise-free simulation in the place of the binding function.

    Parameters
    ----------
    cov_type, tol, max_iter, start, scale_gain, filtered, weighted, robust
        As for `IDIMIV`.

    References
    ----------
    C. Gourieroux, A. Monfort, E. Renault, "Indirect inference", J. Applied Econometrics 8, 1993;
    P. Stoica, T. Soderstrom, "Bias correction in least-squares identification", Int. J. Control
    35(3), 1982.

    Examples
    --------
    >>> import ivtools as iv
    >>> loop = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    >>> record = iv.datasets.twin()
    >>> fit = IDIMBCIV().fit(iv.Problem(record, loop))
    >>> [round(float(fit.params[name] / true), 2) for name, true in record.theta_true.items()]
    [1.0, 1.0, 1.0, 1.0, 1.0]
    """

    key: ClassVar[str] = "idim-bciv"
    robots: ClassVar[bool] = False

    def estimate(self, problem: Problem) -> FitResults:
        """Iterate from the start, then from other estimates; else give the input error's.

        The equations may have more solutions than one, or none that the iteration is drawn to.
        Where the simulated loop fits worse than at a point on the way, the solution is not the
        axis; a start from an estimate that cannot be far off then finds the right one.
        """
        starts = [starting_values(problem, self.start)]
        paths = [self._iterate(problem, starts[0])]
        fallback = None
        for other in self._others():
            if _sound(paths):
                break
            fallback = _tried(other, problem) or fallback
            start = None if fallback is None else fallback.params.to_numpy()
            if start is not None and not any(np.allclose(start, s, 1e-9, 0.0) for s in starts):
                paths.append(self._iterate(problem, start))
                starts.append(start)
        best = _sound(paths)
        if best is None:
            return self._unsettled(problem, paths[0], fallback)
        spent = sum(path.n_simulations for path in paths)
        return self._results(problem, best._replace(n_simulations=spent))

    def misfit(self, step: Step) -> float:
        """Return the norm of the measured less the simulated force at a step's point."""
        return norm(step.system.y - step.system.Z @ step.at)

    def _others(self) -> Iterator[Estimator]:
        """Yield methods that start another iteration, the surest last."""
        from ivtools.estimators.input_error import CLIE

        yield IDIMLS()
        yield IDIMIV(scale_gain=self.scale_gain)
        yield CLIE()

    def _unsettled(self, problem: Problem, path: Path, fallback: FitResults | None) -> FitResults:
        """Return the last other estimate under this method's name, as not converged."""
        if fallback is None:
            return self._results(problem, path._replace(converged=False))
        theta = fallback.params.reindex(problem.names).to_numpy()
        return FitResults.from_solution(
            self.key,
            theta,
            problem.X,
            problem.y,
            problem=problem,
            cov_type=self.cov_type,
            n_iter=path.n_iter,
            n_simulations=path.n_simulations,
            converged=False,
            notes=(f"no solution that holds was found; the values are those of {fallback.method}",),
        )

    def system(
        self, problem: Problem, theta: Array, scale_gain: bool = False, X: Array | None = None
    ) -> System:
        """Return the compensated equations and the instruments simulated at theta (p,)."""
        at, kept = within_bounds(problem, theta), settled_rows(problem)
        X_s, y_s = problem.paired_instruments(at, filtered=self.filtered, scale_gain=scale_gain)
        y = problem.y - (y_s - X_s @ at)  # (N,)
        X = problem.observed_rows(at)[kept] if X is None else X
        return System(X, y[kept], X_s[kept], problem.row_joints[kept], problem.t[kept])

    def notes(self, problem: Problem, step: Step) -> tuple[str, ...]:
        """Say what was compensated."""
        error = step.system.y - self._measured(problem)
        size = 100.0 * np.linalg.norm(error) / np.linalg.norm(step.system.y)
        return (f"y is less the error that the simulated loop makes as well, {size:.3f} % of it",)

    def _measured(self, problem: Problem) -> Array:
        """Return the measured force at the rows that are used, (N,)."""
        return problem.y[settled_rows(problem)]


def _sound(paths: list[Path]) -> Path | None:
    """Return the path that ended where the loop fits best, if none fitted clearly better."""
    least = min((misfit for path in paths for misfit in path.misfits), default=np.inf)
    ended = [path for path in paths if path.converged]
    best = min(ended, key=lambda path: path.misfits[-1], default=None)
    if best is None or best.step is None:
        return None
    rounding = EXACT * norm(best.step.system.y)
    return best if best.misfits[-1] <= WORSE * least + rounding else None


def _tried(method: Estimator, problem: Problem) -> FitResults | None:
    """Return the fit of another method; None if it fails as well."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        try:
            fit = method.fit(problem, check=False)
        except IVToolsError:
            return None
    return fit if np.isfinite(fit.params.reindex(problem.names).to_numpy()).all() else None


def settled_rows(problem: Problem) -> NDArray[np.intp]:
    """Return the rows that no filter has extrapolated into.

    The decimation filter rings over some rows at either end, unless they are blank. The band-pass
    spoils what the pipeline trims at its head, at the tail as well, where most of that are the
    same rows.
    """
    pipeline, record = problem.pipeline, problem.record
    head, tail = pipeline.trim
    rings = pipeline.decimation > 1 and not pipeline.blank
    ringing = SETTLING_ROWS * pipeline.decimation if rings else 0
    t, settled = problem.t, np.zeros(len(problem.y), dtype=bool)
    for s in record.stretches:
        first = record.t[s.start] + (head + ringing - 0.5) * record.dt
        last = record.t[s.stop - 1] - (max(head, tail + ringing) - 0.5) * record.dt
        settled |= (t > first) & (t < last)
    kept = np.flatnonzero(settled)
    if len(kept) <= len(problem.names):
        raise EstimationError(
            f"{len(kept)} rows are left between the ends; take a longer record, or decimate less"
        )
    return kept
