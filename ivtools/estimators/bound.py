"""The Cramer-Rao bound: the least variance that an unbiased estimate can have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ivtools.errors import EstimationError
from ivtools.linalg import influence
from ivtools.linalg.noise import NoiseModel
from ivtools.loop.bandwidth import axis_response

if TYPE_CHECKING:
    from ivtools.loop import ClosedLoop
    from ivtools.problem import Problem

Array = NDArray[np.float64]

MEMORY = 400  # samples after which the closed loop has forgotten its noise
STEP = 1e-3  # of the finite differences, as a share of a parameter
_GRID = 4096  # frequencies of the noise spectrum


def cramer_rao(
    problem: Problem,
    theta: Mapping[str, float],
    *,
    position_noise: float,
    force_noise: float,
    quantum: float = 0.0,
) -> pd.DataFrame:
    """Return the smallest covariance of an unbiased estimate from the record's reference.

    The measured position of the closed loop is that of the simulation, q_s(theta), plus the noise
    that passes the loop, whose spectrum follows from the loop's responses. With S the
    sensitivities of q_s and W the filter that whitens that noise, the bound is the inverse of
    (W S)'(W S). Noise that dry friction makes out of noise at a reversal is not in it, and
    neither is what the noise itself excites. benchmarks/consistency.py checks it: generalised
    least squares of the linearised loop attains it.

    Parameters
    ----------
    problem : Problem
        Gives the loop and the reference; what was measured does not matter.
    theta : mapping
        True parameters.
    position_noise, force_noise : float
        Standard deviations per sample, in m or rad and in N or N m.
    quantum : float
        Resolution of the encoder, in m or rad.

    Returns
    -------
    DataFrame (p, p)
        Covariance; the root of its diagonal bounds the standard errors.

    Raises
    ------
    EstimationError
        If there is no noise of the position.

    References
    ----------
    L. Ljung, *System Identification: Theory for the User*, 2nd ed., 1999, sections 7.4 and 13.7.

    Examples
    --------
    >>> import ivtools as iv
    >>> record = iv.datasets.twin()
    >>> problem = iv.Problem(record, iv.axes.emps().with_terms("inertia", "asymmetric-friction"))
    >>> bound = cramer_rao(problem, record.theta_true, position_noise=1e-6, force_noise=2.0)
    >>> bool(0.01 < np.sqrt(bound.loc["inertia", "inertia"]) < 0.1)
    True
    """
    sigma = float(np.hypot(position_noise, quantum / np.sqrt(12.0)))
    if not sigma > 0.0:
        raise EstimationError("without noise of the position there is no bound; give its deviation")
    names = list(problem.names)
    S = sensitivities(problem, theta)  # (n_samples, p)
    acov = position_autocovariance(problem.loop, theta, problem.record.dt, sigma, force_noise)
    model = NoiseModel.from_autocovariance(acov)
    rows = influence(model(S)) * model.sigma  # (n_samples, p)
    return pd.DataFrame(rows.T @ rows, index=names, columns=names)


def sensitivities(problem: Problem, theta: Mapping[str, float]) -> Array:
    """Return the derivatives of the simulated position, (n_samples, p), by central differences."""
    values = {name: float(theta[name]) for name in problem.names}
    columns = []
    for name in problem.names:
        h = STEP * max(abs(values[name]), 1e-3 * max(map(abs, values.values())))
        ends = [problem.simulate({**values, name: values[name] + d}).q[:, 0] for d in (h, -h)]
        columns.append((ends[0] - ends[1]) / (2.0 * h))
    return np.column_stack(columns)


def position_autocovariance(
    loop: ClosedLoop, theta: Mapping[str, float], dt: float, position: float, force: float
) -> Array:
    """Return the autocovariance (MEMORY + 1,) of the noise of the measured position.

    The loop is taken without dry friction, with the mean of the viscous friction of both
    directions. With P the response of the position to a force and C that of the force to the
    measured position, a force d reaches the position as q = H d, H = P/(1 - C P), and a position
    error w the measured position as (1 + C H) w.
    """
    viscous = [value for name, value in theta.items() if name.startswith("viscous")]
    z = np.exp(1j * np.pi * np.arange(1, _GRID + 1) / _GRID)  # the mode at z = 1 is left out
    P = axis_response(theta["inertia"], float(np.mean(viscous or [0.0])), loop.delay, dt, z)
    C = loop.gain * loop.controller.law(dt).response(z) * z**-loop.controller.delay
    H = P / (1.0 - C * P)
    power = np.abs(H) ** 2 * force**2 + np.abs(1.0 + C * H) ** 2 * position**2
    return np.fft.irfft(np.concatenate([power[:1], power]))[: MEMORY + 1]
