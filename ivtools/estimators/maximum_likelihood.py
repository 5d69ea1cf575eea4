"""Maximum likelihood of the inverse dynamic model, with noise in the position and in the force."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import EstimationError
from ivtools.estimators.base import Estimator
from ivtools.linalg import solve_iv
from ivtools.loop.default_pipeline import position_noise
from ivtools.pipeline import Motion, Pipeline
from ivtools.results import FitResults

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]

_STEP = 1e-6  # relative step of the differences that give the sensitivities


@dataclass(frozen=True)
class ML(Estimator):
    """Maximum likelihood: rows weighted by what the noise of position and force makes of them.

    The error of row k, e_k = phi_k theta - tau_k, has the variance v_k = B_k S B_k' with
    B_k = d e_k / d (q, dq, ddq, tau) and S the covariance of the noise after the pipeline. The
    estimate minimises 1/2 sum e_k^2 / v_k + 1/2 sum log v_k over theta and the force variance.

    With the logarithm of the determinant, as published, the measured regressor is taken as given
    and the estimate is biased like least squares (inertia -8.7 % of both at an encoder noise of
    1e-5 m behind the EMPS pipeline). Without it the cost is that of an error-in-variables model,
    consistent in open loop if S is right; in closed loop the feedback carries the encoder noise
    into the true motion, and a third of that bias stays (-2.8 %). Instruments remove all of it.

    Parameters
    ----------
    cov_type : {"hac", "robust", "classical"}
        Covariance of the estimates, weights taken as known.
    position_noise : float, optional
        Standard deviation of the white noise of the measured position, m or rad. None takes it
        from what the band-pass removes from the record.
    log_determinant : bool
        Whether log det (B S B') is part of the cost.
    start : mapping, optional
        Starting values by name; default: those of the problem.
    tol : float
        Relative change of the parameters, and of the cost, at which the iteration ends.
    max_iter : int
        Most iterations.

    References
    ----------
    M. M. Olsen, J. Swevers, W. Verdonck, "Maximum likelihood identification of a dynamic robot
    model: implementation issues", Int. J. Robotics Research 21(2), 2002.

    Examples
    --------
    >>> import ivtools as iv
    >>> loop = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    >>> fit = ML().fit(iv.Problem(iv.datasets.twin(), loop))
    >>> fit.converged, round(float(fit.params["inertia"]))
    (True, 95)
    """

    key: ClassVar[str] = "ml"

    position_noise: float | None = None
    log_determinant: bool = True
    start: Mapping[str, float] | None = None
    tol: float = 1e-8
    max_iter: int = 200

    def __post_init__(self) -> None:
        """Refuse a noise that is none."""
        if self.position_noise is not None and not 0.0 <= self.position_noise < np.inf:
            raise EstimationError(
                f"position_noise = {self.position_noise} must be a standard deviation, 0 or more"
            )

    def estimate(self, problem: Problem) -> FitResults:
        """Minimise the negative log-likelihood of y (N,), X (N, p)."""
        X, y = problem.X, problem.y
        std = self.position_noise
        if std is None:
            std = position_noise(problem.pipeline, problem.record, problem.motion)
        S = std**2 * noise_covariance(problem.pipeline, problem.record.dt)  # (3, 3)
        B = sensitivities(problem)  # (N, 3, p)
        start = {**problem.start, **(self.start or {})}
        theta = np.array([start[name] for name in problem.names])  # (p,)
        theta, variance, n_iter, converged = self._minimise(X, y, B, S, theta)
        force_std = float(np.sqrt(variance))
        notes = (
            f"position noise {std:.3g}, force noise {force_std:.3g} on the rows (deviations)",
            "biased like least squares: log det is in the cost"
            if self.log_determinant
            else "error in variables: in closed loop a part of the least-squares bias stays",
        )
        return FitResults.from_solution(
            self.key,
            theta,
            X,
            y,
            problem=problem,
            weights=1.0 / row_variance(B, S, theta, variance),
            cov_type=self.cov_type,
            n_iter=n_iter,
            converged=converged,
            notes=notes,
            extras={"position_noise": std, "force_noise": force_std},
        )

    def _minimise(
        self, X: Array, y: Array, B: Array, S: Array, theta: Array
    ) -> tuple[Array, float, int, bool]:
        """Return theta, the force variance, iterations and convergence: Gauss-Newton steps.

        The weights follow theta; what their change adds to the gradient moves the target y.
        """
        least = _floor(X, y)
        for n_iter in range(1, self.max_iter + 1):
            variance = self._force_variance(y - X @ theta, position_part(B, S, theta), least)
            v = row_variance(B, S, theta, variance)  # (N,)
            e = X @ theta - y  # (N,)
            slope = np.einsum("nip,ij,nj->np", B, S, B @ theta)  # (N, p): half of dv/dtheta
            pull = (slope * (self.log_determinant / v - e**2 / v**2)[:, None]).sum(axis=0)  # (p,)
            gradient = X.T @ (e / v) + pull
            root = 1.0 / np.sqrt(v)
            scale = np.linalg.norm(X * root[:, None], axis=0)
            A = X * root[:, None] / scale  # (N, p)
            step = np.linalg.solve(A.T @ A, gradient / scale) / scale
            theta = theta - step
            if np.all(np.abs(step) * scale <= self.tol * np.linalg.norm(scale * theta)):
                return theta, variance, n_iter, True
        return theta, variance, self.max_iter, False

    def _force_variance(self, e: Array, part: Array, least: float) -> float:
        """Return the force variance at these residuals, given what position noise explains.

        With the logarithm it is the maximiser of the likelihood (Newton on a scalar); without it
        the likelihood has none, and the residual's mean square decides.
        """
        variance = max(float(np.mean(e**2) - np.mean(part)), least)
        if not self.log_determinant:
            return variance
        for _ in range(50):
            v = variance + part
            weights = 1.0 / v**2
            new = max(float(np.sum(weights * (e**2 - part)) / np.sum(weights)), least)
            if abs(new - variance) <= 1e-10 * variance:
                break
            variance = new
        return variance


def _floor(X: Array, y: Array) -> float:
    """Return the least force variance: a record without noise must not divide by zero."""
    e = y - X @ solve_iv(X, y)
    return max(1e-6 * float(np.mean(e**2)), 1e-20 * float(np.mean(y**2)))


def position_part(B: Array, S: Array, theta: Array) -> Array:
    """Return the variance (N,) of each row that the noise of the position makes."""
    b = B @ theta  # (N, 3)
    return np.asarray(np.einsum("ni,ij,nj->n", b, S, b))


def row_variance(B: Array, S: Array, theta: Array, force: float) -> Array:
    """Return B_k S B_k' (N,), the variance of each row's error, N^2 or (N m)^2.

    Examples
    --------
    >>> B, S = np.ones((2, 3, 1)), np.diag([0.0, 0.0, 4.0])
    >>> row_variance(B, S, np.array([3.0]), 1.0)
    array([37., 37.])
    """
    return position_part(B, S, theta) + force


def sensitivities(problem: Problem) -> Array:
    """Return d phi / d (q, dq, ddq) at the rows, (N, 3, p).

    The direction of motion is held, so dry friction contributes nothing at a reversal: mask the
    reversals where that matters (``min_speed`` of the pipeline).
    """
    motion, tau = problem.motion, problem.force
    t = problem.record.t - problem.record.t[0]
    rows = problem.pipeline.samples(problem.record.n_samples, problem.speed)
    at = Motion(*(signal[rows] for signal in motion))
    blocks = [_slope(problem, at, tau[rows], t[rows], name) for name in Motion._fields]
    return np.stack(blocks, axis=1)


def _slope(problem: Problem, motion: Motion, tau: Array, t: Array, name: str) -> Array:
    """Return the derivative (N, p) of the observation matrix by one signal, relative steps."""
    signal = getattr(motion, name)
    signal = np.where(signal == 0.0, np.finfo(float).tiny ** 0.5, signal)
    ahead, back = (1.0 + _STEP) * signal, (1.0 - _STEP) * signal
    sides = [problem.loop.regressor(motion._replace(**{name: s}), tau, t) for s in (ahead, back)]
    return np.asarray((sides[0] - sides[1]) / (ahead - back))


def noise_covariance(pipeline: Pipeline, dt: float) -> Array:
    """Return the covariance (3, 3) of the rows' q, dq, ddq per unit variance of the position.

    White noise of the measured position goes through band-pass and decimation; the impulse
    responses of the pipeline, one per phase of the decimation, give it exactly.

    Examples
    --------
    >>> S = noise_covariance(Pipeline(None, 1), 0.5)
    >>> np.round(S, 12).tolist()
    [[1.0, 0.0, -2.0], [0.0, 2.0, 0.0], [-2.0, 0.0, 6.0]]
    """
    phases, n = pipeline.decimation, max(4096, 200 * pipeline.decimation)
    if pipeline.cutoff_hz is not None:
        n = max(n, int(20.0 / (pipeline.cutoff_hz * dt)))
    impulses = np.zeros((n, phases))
    impulses[n // 2 + np.arange(phases), np.arange(phases)] = 1.0
    plain = replace(pipeline, trim=(0, 0), min_speed=0.0)
    signals = [plain.rows(s).ravel() for s in plain.differentiate(impulses, dt)]
    responses = np.column_stack(signals)
    return responses.T @ responses
