"""Estimator: what every method has in common, and the register of the methods."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from importlib import import_module
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ivtools.errors import ConvergenceWarning, EstimationError, IVToolsError
from ivtools.estimators.contradiction import checked
from ivtools.linalg import CovType
from ivtools.loop import ClosedLoop, RobotLoop
from ivtools.methods import FUNCTIONS as FUNCTIONS
from ivtools.methods import METHODS as METHODS
from ivtools.methods import method
from ivtools.record import Record

if TYPE_CHECKING:
    from ivtools.problem import Problem
    from ivtools.results import FitResults


@dataclass(frozen=True)
class Estimator(ABC):
    """A method with its settings; one object serves any number of fits in any process.

    A method states its `key` and how to `estimate`; it never filters, prints or plots.

    Parameters
    ----------
    cov_type : {"hac", "robust", "classical"}
        Covariance of the estimates (see `ivtools.linalg.covariance`).
    """

    key: ClassVar[str]
    robots: ClassVar[bool] = False
    """Whether the method knows more than one joint."""
    chooses: ClassVar[bool] = False
    """Whether the loop simulated at the estimate chooses the rows of a second one."""

    cov_type: CovType = "hac"

    def fit(
        self, problem: Problem | Record, loop: ClosedLoop | None = None, *, check: bool = True
    ) -> FitResults:
        """Estimate the parameters of a problem.

        Parameters
        ----------
        problem : Problem or Record
            Record, closed loop and pipeline; it is not changed.
        loop : ClosedLoop, optional
            With a record in place of a problem: its loop.
        check : bool
            Whether a result that instruments contradict (`ivtools.estimators.contradiction`)
            counts as not converged. A study, which knows the truth, has it off.

        Returns
        -------
        FitResults
            With the time that it took.

        Raises
        ------
        EstimationError
            If the equations have no solution.

        Warns
        -----
        ConvergenceWarning
            If the iteration stopped before its tolerance; `converged` is then False.

        Raises
        ------
        EstimationError
            If the problem is a robot's and the method is for one axis.
        """
        problem = _problem(problem, loop)
        if not self.robots and isinstance(problem.loop, RobotLoop):
            raise EstimationError(
                f"{self.key} is for one axis; robots are identified by idim-ls, idim-wls, idim-iv, "
                "didim, lmi-ls and lmi-iv"
            )
        start = perf_counter()
        try:
            results = self._chosen(problem, self.estimate(problem))
        except np.linalg.LinAlgError as error:
            raise EstimationError(
                f"{self.key} cannot solve its equations ({error}); the record shows too little, or "
                "a signal is out of all proportion"
            ) from error
        if not results.converged:
            self._warn(f"in {results.n_iter} iterations; start closer, or allow more")
        elif check:
            results = checked(results, problem)
            if not results.converged:
                self._warn(f"to what can be true: {results.notes[1]}")
        return replace(results, runtime=perf_counter() - start)

    def _chosen(self, problem: Problem, first: FitResults) -> FitResults:
        """Estimate again from there, on the rows that noise has not chosen.

        `Problem.masked_by` says why. Without a mask, or a simulation, the first estimate is all;
        nor is a search repeated that had more to find than the problem's own parameters. A second
        estimate that does not converge stands, though the first had: that one's friction may be
        biased by more than its errors say.
        """
        axis = self.chooses and isinstance(problem.loop, ClosedLoop)
        if not (axis and problem.masked and {*first.names} == {*problem.names}):
            return first
        near = {"start": first.params.to_dict(), "scale_gain": False}
        known = {f.name for f in fields(self)}
        again = replace(self, **{k: v for k, v in near.items() if k in known})  # type: ignore[arg-type]
        try:
            second = again.estimate(problem.masked_by(first.params))
        except IVToolsError:  # nothing to simulate there
            return first
        return replace(
            second,
            problem=problem,
            n_iter=first.n_iter + second.n_iter,
            n_simulations=first.n_simulations + second.n_simulations + 1,
        )

    def _warn(self, how: str) -> None:
        warnings.warn(f"{self.key} has not converged {how}", ConvergenceWarning, stacklevel=3)

    @abstractmethod
    def estimate(self, problem: Problem) -> FitResults:
        """Return the estimate; `fit` adds the time and the warning."""


def _problem(given: Problem | Record, loop: ClosedLoop | None) -> Problem:
    """Return the problem that was given, or that of a record and its loop."""
    from ivtools.problem import Problem

    if isinstance(given, Record) and loop is not None:
        return Problem(given, loop)
    if isinstance(given, Record | ClosedLoop | Mapping | str | Path | np.ndarray):
        kind = type(given).__name__
        raise EstimationError(
            f"fit was given a {kind}; give Problem(record, loop), or record and loop"
        )
    if loop is not None:
        raise EstimationError("fit was given a Problem, which has its loop; give no other")
    return given


def estimator_class(key: str) -> type[Estimator]:
    """Return the class of a method by its name on the command line.

    Examples
    --------
    >>> estimator_class("idim-ls")()
    IDIMLS(cov_type='hac')
    """
    module, name = method(key).split(":")
    found: type[Estimator] = getattr(import_module(f"ivtools.estimators.{module}"), name)
    return found


def reduce(problem: Problem, estimator: Estimator, limit: float = 10.0) -> FitResults:
    """Drop the parameters that the record does not show, the least significant first, and refit.

    Parameters
    ----------
    problem : Problem
        With every parameter.
    estimator : Estimator
        The method of each fit.
    limit : float
        Relative deviation, in %, above which a parameter is dropped.

    Returns
    -------
    FitResults
        Of the reduced model; its notes name what was dropped.

    References
    ----------
    W. Khalil, E. Dombre, *Modeling, Identification and Control of Robots*, 2002, ch. 12.

    Examples
    --------
    ::

        essential = reduce(problem, IDIMLS(), limit=10.0)
    """
    results, dropped = estimator.fit(problem), []
    while results.converged and results.not_identifiable(limit) and len(results.names) > 1:
        worst = str(results.relative_std.fillna(float("inf")).idxmax())
        dropped.append(f"dropped {worst}: relative deviation {results.relative_std[worst]:.1f} %")
        problem = problem.select([name for name in results.names if name != worst])
        results = estimator.fit(problem)
    return replace(results, notes=(*results.notes, *dropped))
