"""DriveGain: a drive gain, how sure it is, and how it shows itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ivtools.display import Displayed
from ivtools.estimates import critical_values
from ivtools.tables import Text, table, two_columns

if TYPE_CHECKING:
    pass

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class DriveGain(Displayed):
    """A drive gain with its deviation.

    Attributes
    ----------
    gain, std_error : float
        Force per unit of command, N/V or N m/V, and its standard error.
    params, std_errors : Series
        Parameters of the unloaded axis at that gain; friction that the payload adds has the suffix
        ``_loaded``.
    mass : float
        The known payload, kg or kg m2.
    stated : float
        The gain in the axis file.
    relative_error : float
        Residual of the system over the measured force, in %.
    nobs : int
        Rows of both records.
    replicates : (k,) ndarray
        The gain with each block of rows left out; empty if the method has no jackknife.
    unit : str
    method : str
        "tls", or the key of the method whose two inertias it was taken from.
    """

    figure: ClassVar[str] = "drive_gain"

    gain: float
    std_error: float
    params: pd.Series
    std_errors: pd.Series
    mass: float
    stated: float
    relative_error: float
    nobs: int
    replicates: Array
    unit: str = "N/V"
    method: str = "tls"

    def conf_int(self, alpha: float = 0.05) -> tuple[float, float]:
        """Return the confidence interval of the gain; alpha is one less its level.

        By Student's distribution of one block less than there are, or the normal one.
        """
        freedom = len(self.replicates) - 1
        reach = float(critical_values(freedom if freedom > 0 else math.inf, alpha)) * self.std_error
        return self.gain - reach, self.gain + reach

    def summary(self) -> Text:
        """Return a table of at most 80 columns."""
        lower, upper = self.conf_int()
        head = two_columns(
            [
                (f"Drive gain, {self.unit}", f"{self.gain:.5g} +- {self.std_error:.2g}"),
                ("95 %", f"[{lower:.5g}, {upper:.5g}]"),
                ("In the axis file", f"{self.stated:.5g}"),
                ("Payload", f"{self.mass:g}"),
                ("Method", self.method),
                ("Relative error", f"{self.relative_error:.3f} %"),
            ]
        )
        rows = [
            [name, f"{value:.6g}", f"{std:.2g}"]
            for name, value, std in zip(
                self.params.index, self.params.to_list(), self.std_errors.to_list(), strict=True
            )
        ]
        return table("Drive gain", head, ["", "value", "std error"], rows)

    def to_dict(self) -> dict[str, Any]:
        """Return the content as plain objects, ready for JSON."""
        return {
            "gain": self.gain,
            "std_error": self.std_error,
            "interval": list(self.conf_int()),
            "unit": self.unit,
            "stated": self.stated,
            "mass": self.mass,
            "method": self.method,
            "params": {str(k): float(v) for k, v in self.params.items()},
            "std_errors": {str(k): float(v) for k, v in self.std_errors.items()},
            "relative_error": self.relative_error,
            "nobs": self.nobs,
        }

    def __repr__(self) -> str:
        return f"<DriveGain {self.gain:.5g} +- {self.std_error:.2g} {self.unit}>"
