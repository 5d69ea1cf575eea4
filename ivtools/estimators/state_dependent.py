"""State-dependent parameters: the friction of an axis over its velocity, with no friction model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import EstimationError
from ivtools.estimators.friction_curve import FrictionCurve
from ivtools.estimators.smoother import Smooth, smooth
from ivtools.linalg import (
    automatic_bandwidth,
    base_columns,
    influence,
    long_run_variance,
    solve_iv,
)

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]

#: Terms that depend on the velocity alone, or are constant: the curve takes their place.
OF_VELOCITY = (
    "viscous",
    "coulomb",
    "asymmetric-friction",
    "offset",
    "asymmetric-viscous",
    "stribeck",
    "polynomial-viscous",
    "sqrt-viscous",
)
_ML_PASSES = 2  # the noise-variance ratio is estimated in the first passes and then held


@dataclass(frozen=True)
class StateDependentFriction:
    """Friction as a state-dependent parameter: y = X theta + f(dq), f a smooth curve.

    Backfitting: with f given, theta (inertia, gravity, whatever does not depend on the velocity
    alone) is a least-squares estimate; with theta given, the rest y - X theta is sorted by
    velocity and f is an integrated random walk in it, estimated by Kalman filter and
    fixed-interval smoother, its noise-variance ratio by maximum likelihood in the first passes
    and then held. Both directions of motion are curves of their own: nothing is assumed about
    the jump between them, so dry friction, its Stribeck peak, viscous friction and the asymmetry of
    each show as they are. The offset of the force is part of the curve.

    Parameters
    ----------
    min_speed : float, optional
        Slower samples are left out, m/s or rad/s; default: 1 % of the highest speed.
    guard : int, optional
        Samples left out on either side of a slower one, into which the decimation filter smears
        a reversal; default: twice the decimation.
    tol : float
        The passes end when R2 changes by less.
    max_passes : int
        Most passes.

    References
    ----------
    P. C. Young, *Recursive Estimation and Time-Series Analysis*, 2nd ed., 2011, ch. 11;
    A. Janot, P. C. Young, M. Gautier, "Identification and control of electro-mechanical systems
    using state-dependent parameter estimation", Int. J. Control 90(4), 2017.

    Examples
    --------
    >>> import ivtools as iv
    >>> curve = StateDependentFriction().fit(iv.Problem(iv.datasets.twin(), iv.axes.emps()))
    >>> bool(abs(curve(0.1) - 36.5) < 1.0), bool(abs(curve(-0.1) + 45.0) < 1.0)
    (True, True)
    """

    min_speed: float | None = None
    guard: int | None = None
    tol: float = 1e-6
    max_passes: int = 10

    def __post_init__(self) -> None:
        """Refuse settings that make no sense."""
        if self.min_speed is not None and not 0.0 < self.min_speed < np.inf:
            raise EstimationError(f"min_speed = {self.min_speed} must be positive and finite")
        if not 0.0 < self.tol < 1.0:
            raise EstimationError(f"tol = {self.tol} must lie between 0 and 1")
        if self.max_passes < 1:
            raise EstimationError(f"max_passes = {self.max_passes} must be 1 or more")

    def fit(self, problem: Problem) -> FrictionCurve:
        """Estimate the friction curve of a problem, which is not changed.

        Raises
        ------
        EstimationError
            If the axis does not move enough, or the model holds nothing beside friction.
        """
        start = perf_counter()
        moving = self._moving(problem)
        v, gain = _speed(moving)  # (N,), (N,)
        y, (X, names) = moving.y / gain, _beside_friction(moving)  # (N,), (N, p)
        X = X / gain[:, None]
        theta = solve_iv(X, y - _first_guess(X, y, v), names=names)  # (p,)
        curve: Smooth | None = None
        r2, converged, n = -np.inf, False, 0
        while n < self.max_passes and not converged:
            n += 1
            ratios = curve.ratios if curve is not None and n > _ML_PASSES else None
            curve = smooth(v, y - X @ theta, ratios)
            theta = solve_iv(X, y - curve.fitted, names=names)
            old, r2 = r2, _r2(y, y - X @ theta - curve.fitted)
            converged = n > _ML_PASSES and abs(r2 - old) < self.tol
        assert curve is not None  # max_passes is 1 or more
        resids = y - X @ theta - curve.fitted
        return FrictionCurve(
            velocity=curve.state,
            force=curve.level,
            std_error=curve.std_error * _inflation(resids),
            params=dict(zip(names, theta.tolist(), strict=True)),
            std_errors=dict(zip(names, _deviations(X, resids).tolist(), strict=True)),
            resids=resids,
            speed=v,
            joint=problem.loop.joint,
            name=problem.record.name,
            r2=r2,
            relative_error=100.0 * float(np.linalg.norm(resids) / np.linalg.norm(y)),
            min_speed=moving.pipeline.min_speed,
            n_passes=n,
            converged=converged,
            runtime=perf_counter() - start,
        )

    def _moving(self, problem: Problem) -> Problem:
        """Return the problem without the rows around standstill."""
        least, pipeline = self.min_speed, problem.pipeline
        if least is None:
            least = max(0.01 * float(np.max(np.abs(problem.motion.dq))), pipeline.min_speed)
        guard = 2 * pipeline.decimation if self.guard is None else self.guard
        pipeline = replace(pipeline, min_speed=least, guard=max(guard, pipeline.guard))
        return replace(problem, pipeline=pipeline)


def _speed(problem: Problem) -> tuple[Array, Array]:
    """Return the velocity of the rows, and the gain of the decimation for a constant, (N,) each.

    A regression does not notice that this gain is not quite 1, for it scales X and y alike; a
    curve over velocity does.
    """
    dq = problem.motion.dq
    rows = problem.pipeline.rows(np.hstack([dq, np.ones_like(dq)]), dq)
    return rows[:, 0] / rows[:, 1], rows[:, 1]


def _beside_friction(problem: Problem) -> tuple[Array, tuple[str, ...]]:
    """Return the columns (N, p) of all that is not a function of the velocity, and their names."""
    of_velocity = {n for t in problem.loop.terms if t.name in OF_VELOCITY for n in t.names}
    kept = [i for i, name in enumerate(problem.names) if name not in of_velocity]
    if not kept:
        raise EstimationError("the model holds friction only; add the inertia of the axis")
    return problem.X[:, kept], tuple(problem.names[i] for i in kept)


def _first_guess(X: Array, y: Array, v: Array) -> Array:
    """Return Coulomb and viscous friction with an offset, (N,), by least squares."""
    friction = np.column_stack([np.sign(v), v, np.ones_like(v)])  # (N, 3)
    friction = friction[:, base_columns(friction)]  # one direction of motion has no offset
    theta = solve_iv(np.hstack([X, friction]), y)
    guess: Array = friction @ theta[X.shape[1] :]
    return guess


def _r2(y: Array, resids: Array) -> float:
    return 1.0 - float(np.var(resids) / np.var(y))


def _inflation(resids: Array) -> float:
    """Return the factor by which autocorrelation in time widens what assumes white residuals."""
    scores = resids[:, None] - resids.mean()
    long_run = long_run_variance(scores, automatic_bandwidth(scores))[0, 0]
    return float(np.sqrt(max(long_run / (scores[:, 0] @ scores[:, 0]), 1.0)))


def _deviations(X: Array, resids: Array) -> Array:
    """Return HAC standard errors (p,) of the parameters beside the curve."""
    scores = influence(X) * resids[:, None]  # (N, p)
    return np.sqrt(np.diag(long_run_variance(scores, automatic_bandwidth(scores))))
