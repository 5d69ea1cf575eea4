"""The Cramer-Rao bound: the least variance that an unbiased estimate can have."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are
from scipy.signal import lfilter, ss2tf

from ivtools.errors import EstimationError

if TYPE_CHECKING:
    from ivtools.loop import ClosedLoop, Simulation

Array = NDArray[np.float64]

_RESOLUTION = 1e-12  # m or rad: what a position without noise is taken to resolve


@dataclass(frozen=True)
class Noise:
    """What disturbs a record, and no one knows.

    Attributes
    ----------
    position, force : float
        Standard deviations per sample, in m or rad and in N or N m.
    quantum : float
        Resolution of the encoder, m or rad: white, of variance quantum^2/12.
    pole : float
        Of the first-order filter that colours the force; 0 is white.
    """

    position: float = 0.0
    force: float = 0.0
    quantum: float = 0.0
    pole: float = 0.0


@dataclass(frozen=True)
class Predictor:
    """The steady Kalman filter that predicts the measured position of an axis by one sample.

    Attributes
    ----------
    A, B, gain : ndarray, (n, n), (n,), (n,)
        Of position, velocity and, if it is coloured, the random force; B is that of a known force.
    deviation : float
        Of the prediction error, m or rad.
    """

    A: Array
    B: Array
    gain: Array
    deviation: float

    @classmethod
    def of(cls, inertia: float, viscous: float, dt: float, noise: Noise) -> Predictor:
        """Solve the Riccati equation of an inertia with viscous friction.

        Raises
        ------
        EstimationError
            If there is no noise, or no steady filter.
        """
        A, B = _axis(inertia, viscous, dt, noise.pole)
        Q = np.zeros_like(A)
        if noise.pole:
            Q[2, 2] = noise.force**2 * (1.0 - noise.pole**2)
        else:
            Q[:2, :2] = noise.force**2 * np.outer(B[:2], B[:2])
        R = noise.position**2 + noise.quantum**2 / 12.0
        if not (R > 0.0 or Q.any()):
            raise EstimationError("without any noise there is no bound; give its deviation")
        R += _RESOLUTION**2
        if not Q.any():
            return cls(A, B, np.zeros(len(A)), float(np.sqrt(R)))
        try:  # position in units of its noise: the equation is then well scaled
            P = solve_discrete_are(A.T, np.eye(len(A), 1), Q / R, np.eye(1))
        except np.linalg.LinAlgError as error:
            raise EstimationError(f"the axis has no steady Kalman filter: {error}") from error
        variance = float(P[0, 0]) + 1.0
        return cls(A, B, A @ P[:, 0] / variance, float(np.sqrt(variance * R)))

    def errors(self, position: Array, force: Array) -> Array:
        """Return measured less predicted positions (n_samples,) over their deviation.

        Of a position and the force that is known to act, N or N m. Both are taken to have been 0
        before. Linear: what noise makes is ``errors(its position, -its force)``.
        """
        predicted = self._to_position(self.gain, position) + self._to_position(self.B, force)
        return np.asarray((position - predicted) / self.deviation)

    def sensitivities(self, columns: Array) -> Array:
        """Return the derivatives of `errors` (n_samples, p) for the factors of opposing forces."""
        return self._to_position(self.B, columns) / self.deviation

    def _to_position(self, entry: Array, signal: Array) -> Array:
        """Return what the filter makes of a signal that enters its state here."""
        C = np.eye(1, len(self.A))
        closed = self.A - self.gain[:, None] @ C
        b, a = ss2tf(closed, entry[:, None], C, np.zeros((1, 1)))
        return np.asarray(lfilter(b[0], a, signal, axis=0))


def predictor(loop: ClosedLoop, theta: Mapping[str, float], dt: float, noise: Noise) -> Predictor:
    """Return the predictor of a loop's axis; of the viscous friction it knows the mean."""
    viscous = [value for name, value in theta.items() if name.startswith("viscous")]
    return Predictor.of(theta["inertia"], float(np.mean(viscous or [0.0])), dt, noise)


def known_columns(loop: ClosedLoop, theta: Mapping[str, float], simulation: Simulation) -> Array:
    """Return the observation matrix (n_samples, p) of the motion that follows from what is known.

    Its acceleration is that of the known forces: the true one has the random force in it, which the
    prediction errors have as well.
    """
    columns = loop.regressor(simulation.motion, simulation.tau, simulation.t)
    values = np.array([loop.values(theta)[name] for name in loop.names])
    i, moving = loop.names.index("inertia"), simulation.dq[:, 0] != 0.0
    others = columns @ values - columns[:, i] * values[i]
    driven = (simulation.tau[:, 0] - others) / values[i]
    columns[moving, i] = driven[moving]
    return np.asarray(columns)


def cramer_rao(
    loop: ClosedLoop, theta: Mapping[str, float], simulations: Iterable[Simulation], noise: Noise
) -> pd.DataFrame:
    """Return the smallest covariance of an unbiased estimate from one record.

    The likelihood of a closed-loop record is that of the one-step predictions of the position:
    the command is known from the position, so no information is lost in it. A Kalman filter for
    the axis makes the predictions; their sensitivity to a parameter is its column of the
    observation matrix, as a force, through the filter's error dynamics. The information is averaged
    over simulated records, so what noise that the controller sees excites is in it.
    benchmarks/consistency.py checks it: the linear estimate from these predictions attains it.

    Parameters
    ----------
    loop : ClosedLoop
    theta : mapping
        True parameters.
    simulations : iterable of Simulation
        Motions of the axis; several differ by their noise.
    noise : Noise

    Returns
    -------
    DataFrame (p, p)
        Covariance; the root of its diagonal bounds the standard errors.

    Raises
    ------
    EstimationError
        If there is no noise, an effect that is not a force law, no steady filter, or if the motion
        says nothing about a parameter.

    References
    ----------
    G. C. Goodwin, R. L. Payne, *Dynamic System Identification*, 1977, ch. 6;
    K. J. Astrom, "Maximum likelihood and prediction error methods", Automatica 16, 1980.

    Examples
    --------
    >>> import ivtools as iv
    >>> twin, loop = iv.datasets.twin(), iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    >>> motion = loop.simulate(twin, twin.theta_true)
    >>> bound = cramer_rao(loop, twin.theta_true, [motion], Noise(position=1e-6, force=2.0))
    >>> bool(0.01 < np.sqrt(bound.loc["inertia", "inertia"]) < 0.1)
    True
    """
    if any(term.law is None for term in loop.terms):
        raise EstimationError("the model has an effect that is not a force law")
    values, names = loop.values(theta), list(loop.names)
    information, count = np.zeros((len(names), len(names))), 0
    for simulation in simulations:
        dt = float(simulation.t[1] - simulation.t[0])
        columns = known_columns(loop, values, simulation)  # (n_samples, p)
        psi = predictor(loop, values, dt, noise).sensitivities(columns)
        information, count = information + psi.T @ psi, count + 1
    scale = np.sqrt(np.diag(information) / count)  # units must not matter
    correlation = information / count / np.outer(scale, scale) if scale.all() else 0.0 * information
    if np.linalg.matrix_rank(correlation, hermitian=True) < len(names):
        raise EstimationError("the motion does not tell the parameters apart")
    inverse = np.linalg.inv(correlation)
    return pd.DataFrame(inverse / np.outer(scale, scale), index=names, columns=names)


def _axis(inertia: float, viscous: float, dt: float, pole: float) -> tuple[Array, Array]:
    """Return A and B (force to state) of position, velocity and, if coloured, the random force."""
    decay = np.exp(-viscous * dt / inertia)
    reach = -np.expm1(-viscous * dt / inertia) * inertia / viscous if viscous else dt
    drop = (dt - reach) / viscous if viscous else 0.5 * dt**2 / inertia
    A = np.array([[1.0, reach], [0.0, decay]])
    B = np.array([drop, reach / inertia])
    if not pole:
        return A, B
    wide = np.zeros((3, 3))
    wide[:2, :2], wide[:2, 2], wide[2, 2] = A, B, pole
    return wide, np.append(B, 0.0)
