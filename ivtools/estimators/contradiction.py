"""Contradiction: whether instruments that know nothing of the noise deny an estimate.

Least squares solves its equations whatever the encoder, and an iteration may settle at a solution
that is not the axis. One step of instrumental variables from there, Z' (y - X (theta + d)) = 0 with
Z of the loop simulated at theta, says how far off it is, with a standard error.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import IVToolsError
from ivtools.linalg import covariance, influence, score_covariance
from ivtools.loop import ClosedLoop

if TYPE_CHECKING:
    from ivtools.problem import Problem
    from ivtools.results import FitResults

Array = NDArray[np.float64]

SURE = 4.0  # standard errors of the difference: more is no chance
BIASED = 3.0  # standard errors of the estimate: more, and its interval is wrong
SLIGHT = 0.01  # of a parameter's value: less may be the error of the rows that instruments leave
ASTRAY = 0.15  # of a parameter's value: more is another axis


def checked(results: FitResults, problem: Problem) -> FitResults:
    """Return a result as not converged, with the reason, if instruments contradict it.

    Of least squares on the measured motion it is the Durbin-Wu-Hausman test of each parameter: the
    difference is known better than either estimate. It counts where the difference is larger than
    three of the standard errors that it makes wrong, or than 15 % of the parameter. Of a method
    that simulates, the errors of both estimates count; and of one that compares the force, 15 %
    alone: what the model lacks moves the two apart as well.

    Parameters
    ----------
    results : FitResults
        Of a method without simulated instruments of its own; others are returned as they are.
    problem : Problem
        Of one axis with a reference; else there is nothing to simulate.

    References
    ----------
    J. A. Hausman, "Specification tests in econometrics", Econometrica 46, 1978.
    """
    simulated, own = results.n_simulations > 0, results.Z is not None
    if not results.converged or (simulated and own) or {*results.names} != {*problem.names}:
        return results
    if not _simulable(problem):
        return results
    theta = results.params.reindex(problem.names).to_numpy()
    std = results.std_errors.reindex(problem.names).to_numpy()
    try:
        moved, sure = correction(problem, theta, std if simulated else results.Z)
    except IVToolsError:  # no loop to take instruments from
        return results
    moved = possible(problem, theta + moved) - theta
    size = np.abs(theta + moved)
    far = np.abs(moved) > ASTRAY * size
    if not simulated:
        far |= np.abs(moved) > BIASED * std
    elif results.signal != "force":
        far |= (np.abs(moved) > BIASED * std) & (np.abs(moved) > SLIGHT * size)
    denied = np.flatnonzero(far & (np.abs(moved) > SURE * sure))
    if not len(denied):
        return results
    j = denied[np.argmax(np.abs(moved[denied]) / size[denied])]
    note = (
        f"contradicted by instruments: {problem.names[j]} is {-100.0 * moved[j] / size[j]:+.3g} % "
        f"off by them, {abs(moved[j]) / sure[j]:.0f} standard errors of the difference; use "
        "idim-bciv or idim-piv"
    )
    return replace(results, converged=False, notes=(note, *results.notes))


def possible(problem: Problem, theta: Array) -> Array:
    """Return theta (p,) with every parameter inside its physical bounds."""
    bounds = [problem.loop.parameters[name] for name in problem.names]
    return np.clip(theta, [b.lower for b in bounds], [b.upper for b in bounds])


def _on_bound(problem: Problem, theta: Array) -> NDArray[np.bool_]:
    """Return which parameters (p,) lie on one of their bounds."""
    bounds = [problem.loop.parameters[name] for name in problem.names]
    pairs = zip(theta, bounds, strict=True)
    return np.array([np.isclose(v, [b.lower, b.upper], atol=0.0).any() for v, b in pairs])


def _simulable(problem: Problem) -> bool:
    """Whether a loop of one axis can be simulated from a reference that knows no noise."""
    loop = getattr(problem, "loop", None)
    closed = isinstance(loop, ClosedLoop) and loop.controller.kind != "none"
    return closed and problem.record.q_ref is not None


def correction(problem: Problem, theta: Array, other: Array | None = None) -> tuple[Array, Array]:
    """Return how instruments move an estimate theta (p,), and the standard errors of that, (p,).

    Parameters
    ----------
    other : (p,) or (N, p) ndarray, optional
        Standard errors of theta, which then count as independent; or what took the place of the
        instruments in its equations, by default X: they share the rows, and the difference counts.
    """
    X, y, Z = problem.X, problem.y, problem.instruments(theta)
    whole = theta + influence(X, Z).T @ (y - X @ theta)  # (p,)
    free = ~(_on_bound(problem, theta) & (possible(problem, whole) != whole))  # (p,)
    rows = influence(X[:, free], Z[:, free])  # (N, q); what instruments press on a bound stays
    moved, sure = np.zeros_like(theta), np.full_like(theta, np.inf)
    moved[free] = rows.T @ (y - X @ theta)
    resids = y - X @ (theta + moved)
    if other is not None and other.ndim == 1:
        variance = np.diag(covariance(X[:, free], resids, Z[:, free]))
        variance = variance + np.nan_to_num(other[free]) ** 2
    else:
        own = influence(X[:, free], None if other is None else other[:, free])
        variance = np.diag(score_covariance((rows - own) * resids[:, np.newaxis], "hac"))
    sure[free] = np.sqrt(variance)
    return moved, sure
