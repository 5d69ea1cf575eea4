"""Standard parameters that can exist, nearest to an estimate of the base parameters."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import EstimationError
from .inertia import cvxpy, pseudo_inertia, standard

Array = NDArray[np.float64]

LEAST = 0.01  # of the prior: a link is not lighter than that, or nothing could be simulated
_NOTHING = 1e-9  # of the largest parameter: the least eigenvalue of a link without a prior
_PULL = 1e-6  # of the prior, where the estimate leaves a direction free


def nearest(
    matrix: Array,
    theta: Array,
    metric: Array | None = None,
    prior: Array | None = None,
    lower: Array | None = None,
    pull: float = _PULL,
    deviation: Array | None = None,
) -> Array:
    """Return the standard parameters of links that can exist, nearest to base parameters.

    Minimises ``|metric (theta - matrix phi)|^2 + pull |phi - prior|^2``, scaled, so that every
    link's pseudo-inertia has no negative eigenvalue, nor one below a hundredth of the prior's: a
    semidefinite program.

    Parameters
    ----------
    matrix : (n_base, 10 n + k) ndarray
        Base parameters are ``matrix @ phi``: links first, then k others, as frictions.
    theta : (n_base,) ndarray
        The estimate.
    metric : (m, n_base) ndarray, optional
        What distances are measured with, such as the R of a QR of the observation matrix, which
        makes it the norm of the force; default: each parameter relative to its size.
    prior : (10 n + k,) ndarray, optional
        Where the parameters go that the estimate does not know, such as those of the drawing;
        default: small ones.
    lower : (k,) ndarray, optional
        Bounds of the others; default: none.
    pull : float
        Weight of the prior.
    deviation : (10 n + k,) ndarray, optional
        Standard deviations of the prior, infinite where it says nothing, in place of that weight;
        the metric has to be that of unit noise then.

    Returns
    -------
    (10 n + k,) ndarray

    Raises
    ------
    MissingExtraError
        If cvxpy is not installed.
    EstimationError
        If the solver fails.

    References
    ----------
    C. D. Sousa, R. Cortesao, Int. J. Robotics Research 33(6), 2014; P. M. Wensing, S. Kim,
    J.-J. E. Slotine, IEEE Robotics and Automation Letters 3(1), 2018.
    """
    cp, others = cvxpy(), 0 if lower is None else len(lower)
    n = (matrix.shape[1] - others) // 10
    metric = np.diag(1.0 / np.maximum(np.abs(theta), _small(theta))) if metric is None else metric
    size = max(float(np.linalg.norm(metric @ theta)), 1e-300)
    phi = cp.Variable(matrix.shape[1])
    wanted = np.zeros(matrix.shape[1]) if prior is None else prior
    scale = np.maximum(np.abs(wanted), _small(theta if prior is None else wanted))
    weight = np.sqrt(pull / len(scale)) / scale if deviation is None else 1.0 / (size * deviation)
    cost = cp.sum_squares(metric @ (matrix @ phi - theta) / size)
    cost += cp.sum_squares(cp.multiply(weight, phi - wanted))
    rules = []
    for i in range(n):
        link = [phi[10 * i + k] for k in range(10)]
        least = _floor(wanted[10 * i : 10 * (i + 1)]) + _NOTHING * np.abs(theta).max() * np.eye(4)
        rules.append(pseudo_inertia(link) >> least)
    if lower is not None:
        bounded = np.flatnonzero(np.isfinite(lower))
        rules += [phi[10 * n + bounded] >= lower[bounded]] if len(bounded) else []
    task = cp.Problem(cp.Minimize(cost), rules)
    try:
        task.solve(solver=cp.CLARABEL)
    except cp.error.SolverError as error:
        raise EstimationError(f"no consistent parameters were found: {error}") from error
    if phi.value is None:
        raise EstimationError(f"no consistent parameters were found: {task.status}")
    return np.asarray(phi.value, dtype=float)


def sizes(inertias: Array) -> Array:
    """Return the natural size of each standard parameter of links, (n, 10).

    A product of inertia or a moment that is 0 is not known better than those that are not: its size
    is that of the second moments along its two axes, and of the mass.

    Examples
    --------
    >>> sizes(np.array([[4.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 2.0, 0.0, 2.0]])).tolist()
    [[4.0, 2.0, 2.0, 2.0, 2.0, 1.0, 1.0, 2.0, 1.0, 2.0]]
    """
    moments = [np.abs(np.diag(pseudo_inertia(link.tolist()))) for link in inertias]
    return np.abs([standard(np.sqrt(np.outer(m, m))) for m in moments])


def _floor(link: Array) -> Array:
    """Return the least pseudo-inertia of a link, (4, 4): a share of its prior's possible part."""
    values, vectors = np.linalg.eigh(pseudo_inertia(link.tolist()))
    return np.asarray(LEAST * (vectors * np.maximum(values, 0.0)) @ vectors.T, dtype=float)


def _small(theta: Array) -> float:
    """Return what counts as small beside these parameters."""
    return 1e-3 * max(float(np.abs(theta).max(initial=0.0)), 1e-12)


def possible(inertias: Array, tolerance: float = 1e-9) -> bool:
    """Whether bodies with these standard parameters (n, 10) can exist.

    Examples
    --------
    >>> possible(np.array([[1.0, 0.0, 0.0, 0.0, 0.4, 0.0, 0.0, 0.4, 0.0, 0.4]]))
    True
    >>> possible(np.array([[1.0, 0.0, 0.0, 0.0, 0.4, 0.0, 0.0, 0.1, 0.0, 0.1]]))
    False
    """
    for link in np.reshape(inertias, (-1, 10)):
        values = np.linalg.eigvalsh(pseudo_inertia(link.tolist()))
        if values[0] < -tolerance * max(float(values[-1]), 1e-12):
            return False
    return True
