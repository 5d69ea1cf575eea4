"""Goodness: how well an estimate fits the rows that it was made from."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ivtools import linalg

Array = NDArray[np.float64]

ORTHOGONAL = 0.05  # cosine between a column and the residual up to which a sum of squares is least


class ErrorFigures(NamedTuple):
    """Size of the error y - X theta.

    Attributes
    ----------
    norm : float
        Euclidean norm, in N or N m.
    relative : float
        100 norm / norm(y), in %.
    std : float
        Standard deviation (ddof 1), in N or N m.
    """

    norm: float
    relative: float
    std: float

    @classmethod
    def of(cls, error: Array, y: Array) -> ErrorFigures:
        """Measure an error (N,) against the measurement y (N,)."""
        norm, size = float(np.linalg.norm(error)), float(np.linalg.norm(y))
        relative = 100.0 * norm / size if size else (math.inf if norm else 0.0)
        return cls(norm, relative, float(np.std(error, ddof=1)))


class Goodness:
    """The residual of an estimate, and what follows from it.

    Attributes
    ----------
    params : Series (p,)
    X : (N, p) ndarray
        Columns.
    y, resids : (N,) ndarray
        What was fitted, and what is left of it, in N or N m.
    Z : (N, m) ndarray or None
        Instruments.
    weights : (N,) ndarray, callable or None
        Inverse variances of the rows, or a function that whitens columns.
    t : (N,) ndarray or None
        Time of the rows, in s.
    converged : bool
    """

    params: pd.Series
    converged: bool
    X: Array
    y: Array
    resids: Array
    Z: Array | None
    weights: linalg.Weights | None
    t: Array | None

    @property
    def nobs(self) -> int:
        """Number of rows of the regression."""
        return len(self.y)

    @property
    def fitted(self) -> Array:
        """What the estimate makes of y (N,): X theta, or the simulated signal."""
        return self.y - self.resids

    @property
    def resid(self) -> pd.Series:
        """Residual by time, N or N m: `resids` by statsmodels' name."""
        return pd.Series(self.resids, index=self._times, name="resid")

    @property
    def fittedvalues(self) -> pd.Series:
        """What the estimate makes of y, by time: `fitted` by statsmodels' name."""
        return pd.Series(self.fitted, index=self._times, name="fittedvalues")

    @property
    def _times(self) -> pd.Index:
        return pd.RangeIndex(self.nobs) if self.t is None else pd.Index(self.t, name="t")

    @property
    def llf(self) -> float:
        """Log-likelihood of Gaussian errors at their most likely variance.

        Defined where the estimate minimises a sum of squares with weights by row: its residual is
        orthogonal to the columns. NaN where it has instruments, filters the rows, keeps to a bound
        or has not converged, for then it maximises no likelihood.
        """
        if self.Z is not None or callable(self.weights) or not self.converged:
            return math.nan
        X, e = (linalg.reweighted(a, self.weights) for a in (self.X, self.resids))
        size = np.linalg.norm(X, axis=0) * np.linalg.norm(e)
        if np.any(np.abs(X.T @ e) > ORTHOGONAL * size):
            return math.nan
        return gaussian_llf(e, self.weights)

    @property
    def aic(self) -> float:
        """Akaike's information criterion, -2 llf + 2 p."""
        return 2.0 * len(self.params) - 2.0 * self.llf

    @property
    def bic(self) -> float:
        """Schwarz's information criterion, -2 llf + p log N."""
        return math.log(self.nobs) * len(self.params) - 2.0 * self.llf

    @property
    def errors(self) -> ErrorFigures:
        """Norm, relative size and standard deviation of the residual."""
        return ErrorFigures.of(self.resids, self.y)

    @property
    def relative_error(self) -> float:
        """100 norm(y - X theta) / norm(y), in %."""
        return self.errors.relative


def gaussian_llf(white: Array, weights: Array | None = None) -> float:
    """Return the log-likelihood of white Gaussian errors (N,) at their most likely variance.

    With the weights by row that made them white.

    Examples
    --------
    >>> round(gaussian_llf(np.array([1.0, -1.0])), 4)
    -2.8379
    """
    n, logs = len(white), 0.0 if weights is None else float(np.sum(np.log(weights)))
    variance = float(white @ white) / n
    if not variance > 0.0:
        return math.inf
    return 0.5 * (logs - n * (math.log(2.0 * math.pi * variance) + 1.0))
