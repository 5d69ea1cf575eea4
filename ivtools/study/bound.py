"""The Cramer-Rao bound: the smallest deviation that any unbiased estimator can reach."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are
from scipy.signal import lfilter, ss2tf

if TYPE_CHECKING:
    import pandas as pd

    from ivtools.study.case import Case

Array = NDArray[np.float64]

REALISATIONS = 3  # of the noise: it moves the axis and so adds information of its own
_RESOLUTION = 1e-12  # m or rad: what a position without noise is taken to resolve


def cramer_rao(case: Case) -> pd.Series:
    """Return the smallest deviation of each identified parameter, in its unit.

    The likelihood of a closed-loop record is that of the one-step predictions of the position:
    the command is known from the position, so no information is lost in it. A Kalman filter for
    the axis (double integrator with viscous friction, random force, encoder noise) makes the
    predictions; their sensitivity to a parameter is its column of the observation matrix, as a
    force divided by the inertia, through the filter's error dynamics. The quantiser counts as
    white noise of variance quantum^2/12. The information is averaged over simulated records, so
    what the noise itself excites is in it. `ivtools.estimators.bound` has the bound of what the
    reference excites, from the spectrum of the closed loop; the two agree where noise is small.

    Parameters
    ----------
    case : Case

    Returns
    -------
    Series
        NaN where the identified model is not the true one, where there is no noise at all, where
        the true model has an effect that is not a force law, or where the filter has no
        stationary state.

    References
    ----------
    G. C. Goodwin, R. L. Payne, *Dynamic System Identification*, 1977, ch. 6;
    K. J. Astrom, "Maximum likelihood and prediction error methods", Automatica 16, 1980.

    Examples
    --------
    >>> import ivtools as iv
    >>> theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    >>> loop = iv.axes.emps()
    >>> quiet, loud = (iv.Case("", loop, theta, force_noise=f).bound() for f in (1.0, 2.0))
    >>> bool(abs(loud["inertia"] / quiet["inertia"] - 2.0) < 0.02)
    True
    """
    import pandas as pd

    names = list(case.model.names)
    nothing = case.encoder_noise == case.quantum == case.force_noise == 0.0
    opaque = any(term.law is None for term in case.loop.terms)
    if nothing or opaque or not case.well_specified:
        return pd.Series(np.nan, index=names, name="bound")
    try:
        information = sum(_information(case, seed) for seed in range(REALISATIONS)) / REALISATIONS
        scale = np.sqrt(np.diag(information))  # units must not matter
        inverse = np.linalg.solve(information / np.outer(scale, scale), np.eye(len(names)))
    except np.linalg.LinAlgError:  # no stationary filter, or records that say nothing
        return pd.Series(np.nan, index=names, name="bound")
    return pd.Series(np.sqrt(np.diag(inverse)) / scale, index=names, name="bound")


def _information(case: Case, seed: int) -> Array:
    """Return the Fisher information (p, p) of one record."""
    simulation = case.simulation(seed)
    values = case.loop.values(case.theta)
    dt = 1.0 / case.sampling_hz
    forces = case.loop.regressor(simulation.motion, simulation.tau, simulation.t)  # (n, p)
    viscous = np.mean([v for k, v in values.items() if k.startswith("viscous")] or [0.0])
    A, B = _axis(values["inertia"], float(viscous), dt, case.force_noise_pole)
    Q = np.zeros_like(A)
    if case.force_noise_pole:
        Q[2, 2] = case.force_noise**2 * (1.0 - case.force_noise_pole**2)
    else:
        Q[:2, :2] = case.force_noise**2 * np.outer(B[:2], B[:2])
    R = case.encoder_noise**2 + case.quantum**2 / 12.0 + _RESOLUTION**2
    C = np.eye(1, len(A))
    gain, variance = _kalman(A, C, Q, R)
    b, a = ss2tf(A - gain @ C, -B[:, None], C, np.zeros((1, 1)))
    psi = np.asarray(lfilter(b[0], a, forces, axis=0)) / np.sqrt(variance)  # (n, p)
    return psi.T @ psi


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


def _kalman(A: Array, C: Array, Q: Array, R: float) -> tuple[Array, float]:
    """Return the gain (n, 1) and the variance of the innovation of the stationary filter."""
    if not Q.any():
        return np.zeros((len(A), 1)), R
    units = np.sqrt(R)  # position in units of its noise: the equation is then well scaled
    P = solve_discrete_are(A.T, C.T, Q / units**2, np.eye(1))
    variance = float((C @ P @ C.T)[0, 0]) + 1.0
    return A @ P @ C.T / variance, variance * R
