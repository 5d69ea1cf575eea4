"""Fit: Gauss-Newton on the whitened simulated-command error.

The sensitivities come from simulations that are driven by the noise-free reference, so they act
as instruments: the estimate is consistent in closed loop.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..linalg import solve_iv
from ..loop import ClosedLoop
from ..problem import Problem
from .candidates import Scales
from .fold import Fold

Array = NDArray[np.float64]

_TOL = 1e-4  # relative decrease of the cost that ends the search
_STEP = 0.01  # finite difference, in natural units
_REACH = 3.0  # largest step of a shape parameter, as a factor


@dataclass(frozen=True, eq=False)
class Fit:
    """Values that make a loop reproduce the command of a fold.

    Parameters
    ----------
    fold : Fold
    loop : ClosedLoop
    values : mapping
        Value of every parameter.
    free : tuple of str
        Parameters that were fitted.
    e : ndarray, (n_kept,)
        Whitened error.
    J : ndarray, (n_kept, n_free)
        Derivative of `e`.
    """

    fold: Fold
    loop: ClosedLoop
    values: dict[str, float]
    free: tuple[str, ...]
    e: Array
    J: Array

    @property
    def cost(self) -> float:
        """Mean square of the whitened error; 1 is the floor."""
        return float(self.e @ self.e) / len(self.e)


def steps(fold: Fold, loop: ClosedLoop, scales: Scales) -> dict[str, float]:
    """Return the finite-difference step of every parameter of a loop."""
    out = {}
    for term in loop.terms:
        shape = {p.name: loop.start.get(n, p.neutral) for n, p in zip(term.names, term.parameters, strict=True)}
        for i, name in enumerate(term.names):
            p = term.parameters[i]
            size = abs(shape[p.name]) or scales.natural(term, i, shape)
            out[name] = _STEP * (scales.natural(term, i, shape) if p.linear else size)
    return out


def jacobian(fold: Fold, loop: ClosedLoop, values: Mapping[str, float], free: Sequence[str],
             step: Mapping[str, float], e: Array) -> Array:
    """Return the derivative of the whitened error by forward differences, (n_kept, n_free)."""
    bounds = loop.parameters
    signed = [s if values[n] + s <= bounds[n].upper else -s for n in free for s in (step[n],)]
    points = [{**values, n: values[n] + s} for n, s in zip(free, signed, strict=True)]
    if not points:
        return np.empty((len(e), 0))
    return (fold.errors(loop, points) - e[:, None]) / np.asarray(signed)


def gauss_newton(
    fold: Fold,
    loop: ClosedLoop,
    values: Mapping[str, float],
    free: Sequence[str],
    step: Mapping[str, float],
    iterations: int = 8,
) -> Fit:
    """Minimise the whitened simulated-command error over the free parameters.

    Parameters
    ----------
    fold, loop
        What is compared.
    values : mapping
        Starting values of all parameters.
    free : sequence of str
        Names of those that are fitted.
    step : mapping
        Finite-difference steps, as `steps` gives them.
    iterations : int
        At most so many Jacobians.

    Returns
    -------
    Fit
    """
    values, free = dict(values), tuple(free)
    e = fold.error(loop, values)
    J = jacobian(fold, loop, values, free, step, e)
    for _ in range(iterations):
        move = _solve(J, e, np.array([step[n] for n in free]))
        trial, e_new = _search(fold, loop, values, free, move, e)
        gain = 1.0 - (e_new @ e_new) / (e @ e)
        if trial is None or gain <= 0.0:
            break
        values, e = trial, e_new
        if gain < _TOL:
            break
        J = jacobian(fold, loop, values, free, step, e)
    return Fit(fold, loop, values, free, e, J)


def _solve(J: Array, e: Array, units: Array) -> Array:
    """Return the Gauss-Newton step, damped in directions that the record does not show."""
    A = J * units
    scale = np.linalg.norm(A, axis=0)
    scale[scale == 0.0] = 1.0
    return -units / scale * np.linalg.lstsq(A / scale, e, rcond=1e-5)[0]


def _search(fold: Fold, loop: ClosedLoop, values: dict[str, float], free: Sequence[str],
            move: Array, e: Array) -> tuple[dict[str, float] | None, Array]:
    """Halve the step until the cost falls."""
    for factor in (1.0, 0.4, 0.1, 0.02):
        trial = {**values}
        for name, change in zip(free, move, strict=True):
            trial[name] = _bounded(loop, name, values[name], factor * change)
        e_new = fold.error(loop, trial)
        if e_new @ e_new < e @ e:
            return trial, e_new
    return None, e


def _bounded(loop: ClosedLoop, name: str, value: float, change: float) -> float:
    """Move a parameter within its bounds; one that must be positive moves by a factor at most."""
    p, new = loop.parameters[name], value + change
    if name == "inertia" or (not p.linear and p.lower >= 0.0 and value > 0.0):
        new = float(np.clip(new, value / _REACH, value * _REACH))
    return float(np.clip(new, p.lower, p.upper))


def start(fold: Fold, loop: ClosedLoop) -> dict[str, float]:
    """Return starting values from the inverse model by least squares."""
    problem = Problem(fold.record, loop)
    theta = solve_iv(problem.X, problem.y, names=problem.names)
    found = dict(zip(problem.names, theta.tolist(), strict=True))
    for name, p in loop.parameters.items():
        if name in found:
            found[name] = float(np.clip(found[name], p.lower, p.upper))
    return loop.values({n: v for n, v in found.items()})
