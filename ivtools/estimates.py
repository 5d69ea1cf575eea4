"""Estimates: parameters with their covariance, and every figure that follows from the two.

The vocabulary is that of statsmodels and linearmodels; where the two differ, both names are there.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import stdtr, stdtrit

from ivtools.display import Displayed
from ivtools.errors import EstimationError

Array = NDArray[np.float64]

WITHHELD = "has not converged: the values are no estimates, and have no standard errors"


class Estimates(Displayed):
    """Parameters with a covariance. What has not converged has none: it is NaN, and a note says so.

    Attributes
    ----------
    params : Series (p,)
        Estimates by parameter name, SI.
    cov : DataFrame (p, p)
        Covariance of the estimates; NaN if they have not converged.
    converged : bool
        Whether the iteration met its tolerance.
    units : tuple of str (p,)
        Units of the parameters.
    notes : tuple of str
        Remarks, one line each.
    """

    params: pd.Series
    cov: pd.DataFrame
    converged: bool
    units: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Withhold the covariance of what has not converged."""
        others = tuple(note for note in self.notes if note != WITHHELD)
        if not self.converged:
            object.__setattr__(self, "cov", self.cov * math.nan)
        if not self.converged or others != self.notes:
            object.__setattr__(self, "notes", (WITHHELD,) * (not self.converged) + others)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter names."""
        return tuple(self.params.index)

    @property
    def degrees_of_freedom(self) -> pd.Series:
        """Degrees of freedom of the standard errors; infinite where these count as known."""
        return pd.Series(math.inf, index=self.params.index, name="degrees_of_freedom")

    @property
    def std_errors(self) -> pd.Series:
        """Standard errors of the estimates."""
        variances = np.diag(self.cov.to_numpy())
        return pd.Series(np.sqrt(variances), index=self.params.index, name="std_errors")

    @property
    def bse(self) -> pd.Series:
        """Standard errors, by statsmodels' name."""
        return self.std_errors.rename("bse")

    @property
    def relative_std(self) -> pd.Series:
        """Standard errors as a share of the estimates, in %; infinite for an estimate of 0."""
        with np.errstate(divide="ignore"):
            return (100.0 * self.std_errors / self.params.abs()).rename("relative_std")

    @property
    def tstats(self) -> pd.Series:
        """Estimates over their standard errors."""
        return (self.params / self.std_errors).rename("tstats")

    @property
    def tvalues(self) -> pd.Series:
        """Estimates over their standard errors, by statsmodels' name."""
        return self.tstats.rename("tvalues")

    @property
    def pvalues(self) -> pd.Series:
        """Two-sided p-values of a parameter of 0, by Student's distribution."""
        tails = 2.0 * stdtr(self.degrees_of_freedom.to_numpy(), -self.tstats.abs().to_numpy())
        return pd.Series(tails, index=self.params.index, name="pvalues")

    def cov_params(self) -> pd.DataFrame:
        """Return the covariance of the estimates, by statsmodels' name."""
        return self.cov

    def conf_int(self, alpha: float = 0.05) -> pd.DataFrame:
        """Return confidence intervals by Student's distribution.

        Parameters
        ----------
        alpha : float
            One less the level, as in statsmodels: 0.05 gives intervals of 95 %.

        Returns
        -------
        DataFrame (p, 2)
            Columns lower and upper.

        Raises
        ------
        EstimationError
            If alpha does not lie between 0 and 1.

        Examples
        --------
        ::

            fit.conf_int()      # 95 %
            fit.conf_int(0.01)  # 99 %
        """
        reach = critical_values(self.degrees_of_freedom, alpha) * self.std_errors
        return pd.DataFrame({"lower": self.params - reach, "upper": self.params + reach})

    def frame(self, alpha: float = 0.05) -> pd.DataFrame:
        """Return parameters, units, standard errors and confidence intervals side by side."""
        columns = {
            "unit": pd.Series(self.units or ("",) * len(self.params), index=self.params.index),
            "params": self.params,
            "std_errors": self.std_errors,
            "relative_std": self.relative_std,
        }
        return pd.DataFrame(columns).join(self.conf_int(alpha))


def critical_values(degrees_of_freedom: pd.Series | Array | float, alpha: float = 0.05) -> Any:
    """Return the two-sided critical values of Student's distribution; infinite freedom is normal.

    Raises
    ------
    EstimationError
        If alpha does not lie between 0 and 1.

    Examples
    --------
    >>> round(float(critical_values(math.inf)), 4), round(float(critical_values(10.0)), 4)
    (1.96, 2.2281)
    """
    if not 0.0 < alpha < 1.0:
        raise EstimationError(
            f"alpha = {alpha} must lie between 0 and 1; 0.05 gives intervals of 95 %"
        )
    return stdtrit(degrees_of_freedom, 1.0 - 0.5 * alpha)
