"""Smoother: a curve through scattered points as an integrated random walk in their state."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import EstimationError

Array = NDArray[np.float64]

_GROUPS = 250  # intervals of a branch: samples in one are averaged and weigh by their number
_LEAST = 20  # samples without which a branch is left out
_DIFFUSE = 1e6  # variance of level and slope at the start, where that of the points is 1
_LOG_RATIO = (-6.0, 8.0)  # decades of noise-variance ratio that are searched


class Smooth(NamedTuple):
    """A curve of one or two branches, state below and above 0.

    Attributes
    ----------
    state, level, std_error : ndarray, (n,)
        Points of the curve in rising order, its value there, and its standard error.
    fitted : ndarray, (N,)
        The curve at the given samples.
    ratios : tuple of float
        Noise-variance ratio of each branch.
    """

    state: Array
    level: Array
    std_error: Array
    fitted: Array
    ratios: tuple[float, ...]


class Branch(NamedTuple):
    """The same for one branch, without the samples."""

    state: Array
    level: Array
    std_error: Array
    ratio: float


def smooth(state: Array, y: Array, ratios: tuple[float, ...] | None = None) -> Smooth:
    """Estimate a curve of y over the state, with a jump at 0.

    Parameters
    ----------
    state, y : (N,) ndarray
        Samples in any order; no state is 0.
    ratios : tuple of float, optional
        Noise-variance ratio of each branch; default: by maximum likelihood.

    Raises
    ------
    EstimationError
        If fewer than 20 samples lie on both sides of 0.

    Examples
    --------
    >>> x = np.linspace(-1.0, 1.0, 400)
    >>> curve = smooth(x, np.sign(x) + x**2)
    >>> bool(np.max(np.abs(curve.fitted - np.sign(x) - x**2)) < 0.01)
    True
    """
    sides = [s for s in (state < 0.0, state > 0.0) if np.count_nonzero(s) >= _LEAST]
    if not sides:
        raise EstimationError(f"fewer than {_LEAST} samples move in either direction")
    given = ratios or (None,) * len(sides)
    branches = [_branch(state[s], y[s], r) for s, r in zip(sides, given, strict=True)]
    fitted = np.zeros_like(y)
    for side, branch in zip(sides, branches, strict=True):
        fitted[side] = np.interp(state[side], branch.state, branch.level)
    state, level, std = (np.concatenate([b[i] for b in branches]) for i in range(3))
    return Smooth(state, level, std, fitted, tuple(b.ratio for b in branches))


def _branch(state: Array, y: Array, ratio: float | None) -> Branch:
    """Estimate one branch from its samples."""
    at, mean, count = _grouped(state, y)
    walk = _IntegratedRandomWalk(at, mean, count)
    ratio = walk.likely_ratio() if ratio is None else ratio
    level, variance = walk.smoothed(ratio)
    return Branch(at, level, np.sqrt(np.maximum(variance, 0.0)), ratio)


def _grouped(state: Array, y: Array) -> tuple[Array, Array, Array]:
    """Sort by state, average what falls together; return state, mean, number of each group."""
    order = np.argsort(state, kind="stable")
    at, y = state[order], y[order]
    place = np.floor((at - at[0]) * (_GROUPS / (np.ptp(at) or 1.0)))  # (N,)
    first = np.flatnonzero(np.diff(place, prepend=-1.0))
    count = np.diff(np.append(first, len(at))).astype(float)
    mean, level = (np.add.reduceat(x, first) / count for x in (at, y))
    return mean, level, count


class _IntegratedRandomWalk:
    """Level and slope over a state; the slope walks randomly, in continuous steps of the state.

    Its smoothed level is the cubic smoothing spline through the points.
    """

    def __init__(self, at: Array, y: Array, count: Array) -> None:
        from statsmodels.tsa.statespace.kalman_smoother import KalmanSmoother

        step = np.append(np.diff(at), 0.0) / (np.ptp(at) or 1.0)  # (n,), 1 in all
        self._step, self._mean, self._unit = step, float(np.mean(y)), float(np.std(y)) or 1.0
        self._model: Any = KalmanSmoother(k_endog=1, k_states=2, k_posdef=2)
        self._model.bind((y[:, None] - self._mean) / self._unit)
        self._model["design"] = np.array([[1.0, 0.0]])
        self._model["selection"] = np.eye(2)
        transition = np.tile(np.eye(2)[:, :, None], len(step))
        transition[0, 1] = step
        self._model["transition"] = transition
        self._model["obs_cov"] = (1.0 / count)[None, None, :]
        self._model.initialize_known(np.zeros(2), _DIFFUSE * np.eye(2))

    def _set(self, ratio: float) -> None:
        h = self._step
        walk = [[h**3 / 3.0, h**2 / 2.0], [h**2 / 2.0, h]]
        self._model["state_cov"] = ratio * np.array(walk)

    def _errors(self, ratio: float) -> tuple[Array, Array]:
        """Return the one-step errors and their variances, without the two that start it."""
        self._set(ratio)
        found = self._model.filter()
        return found.forecasts_error[0, 2:], found.forecasts_error_cov[0, 0, 2:]

    def likely_ratio(self) -> float:
        """Return the ratio of the variances of walk and noise by maximum likelihood."""
        from scipy.optimize import minimize_scalar

        def cost(exponent: float) -> float:
            error, variance = self._errors(10.0**exponent)
            scale = np.mean(error**2 / variance) + np.finfo(float).tiny
            return float(len(error) * np.log(scale) + np.sum(np.log(variance)))

        found = minimize_scalar(cost, bounds=_LOG_RATIO, method="bounded", options={"xatol": 0.05})
        return 10.0 ** float(found.x)

    def smoothed(self, ratio: float) -> tuple[Array, Array]:
        """Return the smoothed level and its variance, (n,) each."""
        error, variance = self._errors(ratio)
        scale = float(np.mean(error**2 / variance))
        found = self._model.smooth()
        level = self._mean + self._unit * found.smoothed_state[0]
        return level, scale * self._unit**2 * found.smoothed_state_cov[0, 0]
