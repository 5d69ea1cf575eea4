"""Goodness: how well an estimate fits the rows that it was made from."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ivtools import linalg

Array = NDArray[np.float64]


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
    y, resids : (N,) ndarray
        What was fitted, and what is left of it, in N or N m.
    Z : (N, m) ndarray or None
        Instruments.
    weights : (N,) ndarray, callable or None
        Inverse variances of the rows, or a function that whitens columns.
    t : (N,) ndarray or None
        Time of the rows, in s.
    """

    params: pd.Series
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

        Defined where the estimate minimises a sum of squares with weights by row; NaN where it has
        instruments or filters the rows, for then it maximises no likelihood.
        """
        if self.Z is not None or callable(self.weights):
            return math.nan
        white = linalg.reweighted(self.resids, self.weights)
        n, logs = self.nobs, 0.0 if self.weights is None else float(np.sum(np.log(self.weights)))
        variance = float(white @ white) / n
        if not variance > 0.0:
            return math.inf
        return 0.5 * (logs - n * (math.log(2.0 * math.pi * variance) + 1.0))

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
