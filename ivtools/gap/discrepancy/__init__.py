"""Discrepancy: a force that repeats and is none of the known effects.

smooth         forces that any axis may have, as hat functions of its state and of its past
laws           the one of them that predicts held-out data best, and what it says of names
discrepancy    that one described, instead of named
"""

from .discrepancy import Discrepancy, describe
from .laws import Laws, Spline, advantage, beside_law, least_t, nothing, stands
from .smooth import (
    Basis,
    Columns,
    a_line,
    friction_waves,
    further_waves,
    smooth_rest,
    unlike_smooth,
)

__all__ = [
    "Basis",
    "Columns",
    "Discrepancy",
    "Laws",
    "Spline",
    "a_line",
    "advantage",
    "beside_law",
    "describe",
    "friction_waves",
    "further_waves",
    "least_t",
    "nothing",
    "smooth_rest",
    "stands",
    "unlike_smooth",
]
