"""Discrepancy: a force that repeats and is none of the known effects.

smooth         forces that any axis may have, as hat functions of its state and of its past
discrepancy    the one that predicts held-out data best, described instead of named
"""

from .discrepancy import (
    Discrepancy,
    Laws,
    Spline,
    advantage,
    beside_law,
    describe,
    least_t,
    nothing,
    stands,
)
from .smooth import Basis, Columns, a_line, beside, other_waves, smooth_rest, unlike_smooth

__all__ = [
    "Basis",
    "Columns",
    "Discrepancy",
    "Laws",
    "Spline",
    "a_line",
    "advantage",
    "beside",
    "beside_law",
    "describe",
    "least_t",
    "nothing",
    "other_waves",
    "smooth_rest",
    "stands",
    "unlike_smooth",
]
