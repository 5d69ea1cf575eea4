"""Alignment: the delay between the recorded force and the motion, estimated from the record."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import EstimationError
from ivtools.estimators.compensated import settled_rows
from ivtools.estimators.instrumental import within_bounds
from ivtools.estimators.iteration import Start, starting_values
from ivtools.linalg import influence

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]


def force_shift(problem: Problem, start: Start = "ls", search: tuple[int, int] = (-2, 4)) -> float:
    """Return the shift of the force that leaves the smallest residual of instrumental variables.

    A command held over its sample acts half a sample after it is recorded, so a loop without any
    delay gives 0.5; what exceeds it is a delay of the drive, or of the record. The residual is
    linear in the shift between whole samples, so the best shift there has a closed form.

    Parameters
    ----------
    problem : Problem
        Its own `force_shift` does not matter.
    start : {"axis", "ls"} or mapping
        Parameters that the instruments are simulated with.
    search : tuple of int
        First and last shift considered, in samples.

    Returns
    -------
    float
        Shift in samples, for `Pipeline.force_shift`.

    Raises
    ------
    EstimationError
        If the search is empty.

    Examples
    --------
    >>> import ivtools as iv
    >>> loop = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    >>> round(force_shift(iv.Problem(iv.datasets.twin(), loop)), 1)
    0.5
    """
    first, last = search
    if not first < last:
        raise EstimationError(f"search = {search} is empty; give a first shift below the last")
    E = _residuals(problem, start, range(first, last + 1))  # (N, last - first + 1)
    best = (np.inf, 0.0)
    for i, lag in enumerate(range(first, last)):
        step = E[:, i + 1] - E[:, i]  # e(lag + part) = e(lag) + part step
        part = float(np.clip(-(step @ E[:, i]) / (step @ step), 0.0, 1.0))
        best = min(best, (float(np.linalg.norm(E[:, i] + part * step)), lag + part))
    return best[1]


def aligned(problem: Problem, **options: object) -> Problem:
    """Return the problem with the force shifted by `force_shift`, measured and simulated alike."""
    shift = force_shift(problem, **options)  # type: ignore[arg-type]
    return replace(problem, pipeline=replace(problem.pipeline, force_shift=shift))


def _residuals(problem: Problem, start: Start, lags: range) -> Array:
    """Return the residuals (N, k) of instrumental variables for each whole shift of the force."""
    theta = within_bounds(problem, starting_values(problem, start))
    pipeline, kept = problem.pipeline, settled_rows(problem)
    Z = problem.instruments(theta)[kept]  # (N, p)
    force = problem.loop.force(problem.record)
    shifted = [replace(pipeline, force_shift=float(lag)).align(force) for lag in lags]
    Y = pipeline.rows(np.hstack(shifted), problem.speed)[kept]  # (N, k)
    X = problem.X[kept]
    residuals: Array = Y - X @ (influence(X, Z).T @ Y)
    return residuals
