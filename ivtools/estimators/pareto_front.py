"""ParetoFront: the parameter vectors that no other one beats in every objective."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ivtools.display import Displayed
from ivtools.tables import Text, table, two_columns

if TYPE_CHECKING:
    pass

Array = NDArray[np.float64]

SHOWN = 12  # rows of the table


@dataclass(frozen=True, eq=False, repr=False)
class ParetoFront(Displayed):
    """Compromises between objectives.

    Attributes
    ----------
    names, units, objectives : tuple of str
        Parameters (p,) and errors (m,).
    theta : (k, p) ndarray
        Parameter vectors, sorted by the first objective.
    errors : (k, m) ndarray
        Their errors, relative, in %.
    n_simulations : int
        What the search cost.
    settled : bool
        Whether the front had all but stopped to move.
    """

    figure: ClassVar[str] = "pareto"
    content: ClassVar[tuple[str, ...]] = (
        "names", "units", "objectives", "theta", "errors", "knee", "n_simulations", "settled",
    )  # fmt: skip

    names: tuple[str, ...]
    units: tuple[str, ...]
    objectives: tuple[str, ...]
    theta: Array
    errors: Array
    n_simulations: int
    settled: bool

    @property
    def knee(self) -> int:
        """Index of the point nearest to the ideal one, errors scaled by their range."""
        ideal, worst = self.errors.min(axis=0), self.errors.max(axis=0)
        scaled = (self.errors - ideal) / np.where(worst > ideal, worst - ideal, 1.0)
        return int(np.argmin(np.linalg.norm(scaled, axis=1)))

    def frame(self) -> pd.DataFrame:
        """Return one row per point: parameters, then errors in %."""
        columns = [*self.names, *(f"{name}_error" for name in self.objectives)]
        return pd.DataFrame(np.hstack([self.theta, self.errors]), columns=columns)

    def dominates(self, errors: Array) -> float:
        """Return the share of the points (k, m) that some point of the front beats or equals."""
        worse = np.all(self.errors[:, None] <= np.asarray(errors)[None], axis=2)
        return float(np.mean(worse.any(axis=0)))

    def summary(self) -> Text:
        """Return a table of at most 80 columns: the ends of the front, its knee, some between."""
        shown = np.unique(np.linspace(0, len(self.theta) - 1, SHOWN).astype(int))
        names = self.names if len(self.names) <= 4 else ()  # what 80 columns hold
        shown = np.unique([*shown, self.knee, *self.errors.argmin(axis=0)])
        rows = [
            [
                "knee" if i == self.knee else str(i),
                *(f"{v:.5g}" for v in self.theta[i, : len(names)]),
                *(f"{v:.4g}" for v in self.errors[i]),
            ]
            for i in shown
        ]
        head = two_columns(
            [
                ("Points", str(len(self.theta))),
                ("Simulations", str(self.n_simulations)),
                ("Settled", "yes" if self.settled else "NO"),
            ]
        )
        header = ["", *(name[:9] for name in names), *(f"{n[:5]} %" for n in self.objectives)]
        notes = () if names else ("the parameters are in frame()",)
        return table("Pareto front", head, header, rows, notes)

    def __repr__(self) -> str:
        ends = (
            f"{name} {low:.4g} to {high:.4g} %"
            for name, low, high in zip(
                self.objectives, self.errors.min(axis=0), self.errors.max(axis=0), strict=True
            )
        )
        return f"<ParetoFront of {len(self.theta)} points: {', '.join(ends)}>"


def not_dominated(errors: Array) -> NDArray[np.bool_]:
    """Return which points (k, m) no other one beats in every objective.

    Examples
    --------
    >>> not_dominated(np.array([[1.0, 2.0], [2.0, 1.0], [2.0, 3.0]])).tolist()
    [True, True, False]
    """
    better = np.all(errors[:, None] <= errors[None], axis=2)
    better &= np.any(errors[:, None] < errors[None], axis=2)
    return ~better.any(axis=0)


def hypervolume(errors: Array, reference: Array) -> float:
    """Return the volume that points (k, m) dominate below a reference (m,), m = 1, 2 or 3.

    Examples
    --------
    >>> hypervolume(np.array([[0.0, 0.5], [0.5, 0.0]]), np.array([1.0, 1.0]))
    0.75
    """
    errors = errors[np.all(errors < reference, axis=1)]
    if not len(errors):
        return 0.0
    if errors.shape[1] == 1:
        return float(reference[0] - errors.min())
    order = np.argsort(errors[:, -1])  # slabs of the last objective, each of the points below it
    errors = errors[order]
    tops = np.append(errors[1:, -1], reference[-1])
    slabs = [
        (top - point[-1]) * hypervolume(errors[: i + 1, :-1], reference[:-1])
        for i, (point, top) in enumerate(zip(errors, tops, strict=True))
        if top > point[-1]
    ]
    return float(sum(slabs))
