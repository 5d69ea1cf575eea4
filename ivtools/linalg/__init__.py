"""Linear algebra of the estimators: one solver, its covariances, and models of the noise."""

from __future__ import annotations

from ivtools.linalg.autocovariance import segment_starts
from ivtools.linalg.columns import (
    abs_diag_r,
    as_columns,
    base_columns,
    fir,
    independent,
    orthonormal,
    projection,
    rms,
)
from ivtools.linalg.covariance import Covariance, Stack, covariance, estimate_covariance
from ivtools.linalg.long_run import (
    CovType,
    automatic_bandwidth,
    block_covariance,
    long_run_variance,
    score_covariance,
)
from ivtools.linalg.metric import Metric
from ivtools.linalg.noise import NoiseModel
from ivtools.linalg.solve import (
    RANK_TOLERANCE,
    Weights,
    check_system,
    influence,
    norms_of,
    reweighted,
    solve_iv,
    weighted,
)

__all__ = [
    "RANK_TOLERANCE",
    "CovType",
    "Covariance",
    "Stack",
    "Metric",
    "NoiseModel",
    "Weights",
    "abs_diag_r",
    "as_columns",
    "automatic_bandwidth",
    "base_columns",
    "block_covariance",
    "check_system",
    "covariance",
    "estimate_covariance",
    "fir",
    "independent",
    "influence",
    "long_run_variance",
    "norms_of",
    "orthonormal",
    "projection",
    "reweighted",
    "rms",
    "score_covariance",
    "segment_starts",
    "solve_iv",
    "weighted",
]
