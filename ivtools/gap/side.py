"""Side: one fold with what the attribution needs of it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .candidates import Scales
from .fold import Fold
from .response import Response

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Side:
    """One fold with what the attribution needs of it.

    Parameters
    ----------
    fold : Fold
    response : Response
        Of the command to a force.
    scales : Scales
    rough : float
        Share of the record that no smooth law of the state explains.
    simulated : dict
        Change of the force error, N or N m, (n_samples,), by effect and starting point: what the
        screening has simulated once and need not again.
    """

    fold: Fold
    response: Response
    scales: Scales
    rough: float = 0.0
    simulated: dict[tuple[object, ...], Array] = field(default_factory=dict)
