"""FeasibleSet: the polytope of the parameters that a bound on the error allows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from ivtools.display import Displayed
from ivtools.errors import EstimationError, ShapeError
from ivtools.estimators.linear_programs import (
    SLACK,
    chebyshev_centre,
    middle_centre,
    smallest_bound,
    tightest_box,
)
from ivtools.tables import Text, dashed, table, two_columns

if TYPE_CHECKING:
    pass

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class FeasibleSet(Displayed):
    """Every theta with |y - X theta| <= bound, described by linear programs.

    Attributes
    ----------
    names, units : tuple of str (p,)
        Parameters.
    X, y, bound : (N, p), (N,), (N,) ndarray
        The rows and their bounds, N or N m.
    lower, upper : Series (p,)
        The tightest box around the set; NaN if it is empty.
    centre : Series (p,)
        Chebyshev centre: furthest from every face, in the scale of unit-norm columns; of several,
        the one nearest to the middle of the box. Of an empty set, the centre of the smallest
        bound that leaves something.
    radius : float
        Distance of the centre from the faces, N or N m; 0 for an empty set.
    smallest : float
        The smallest factor on the bound that leaves something; above 1 the set is empty.
    rows : ndarray of int
        The p + 1 rows, or fewer, that alone decide `smallest`: of an empty set, they cannot all
        respect the bound, whatever the parameters.
    t : (N,) ndarray or None
        Time of the rows, s.

    Examples
    --------
    >>> found = FeasibleSet.of(np.array([[1.0], [1.0], [2.0]]), [1.0, 2.0, 3.0], 1.0)
    >>> found.lower.tolist(), found.upper.tolist()
    ([1.0], [2.0])
    """

    figure: ClassVar[str] = "feasible_set"
    content: ClassVar[tuple[str, ...]] = (
        "names", "units", "lower", "upper", "centre", "radius", "smallest", "empty", "notes",
    )  # fmt: skip

    names: tuple[str, ...]
    units: tuple[str, ...]
    X: Array
    y: Array
    bound: Array
    lower: pd.Series
    upper: pd.Series
    centre: pd.Series
    radius: float
    smallest: float
    rows: NDArray[np.intp]
    t: Array | None = None

    @classmethod
    def of(
        cls,
        X: ArrayLike,
        y: ArrayLike,
        bound: ArrayLike,
        *,
        names: Sequence[str] | None = None,
        units: Sequence[str] | None = None,
        t: Array | None = None,
    ) -> FeasibleSet:
        """Solve the linear programs of a set.

        Parameters
        ----------
        X, y : (N, p), (N,) array_like
            Observation matrix and measurements.
        bound : float or (N,) array_like
            Largest error of each row, positive.
        names, units : sequence of str, optional
        t : (N,) ndarray, optional
            Time of the rows, s.

        Raises
        ------
        EstimationError
            If a bound is not positive or the set is unbounded: columns depend on each other.
        ShapeError
            If the shapes do not fit.
        """
        X, y = np.asarray(X, dtype=float), np.asarray(y, dtype=float)
        if X.ndim != 2 or y.shape != X.shape[:1]:
            raise ShapeError(f"X is {X.shape} and y {y.shape}; they need (N, p) and (N,)")
        limits = np.broadcast_to(np.asarray(bound, dtype=float), y.shape)
        if not np.all(limits > 0.0):
            raise EstimationError(f"bound = {np.min(limits)} must be positive in every row")
        names = tuple(names or (f"theta{i}" for i in range(X.shape[1])))
        smallest, theta, rows = smallest_bound(X, y, limits)
        empty = smallest > 1.0 + SLACK
        index = pd.Index(list(names))
        box = np.full((2, len(names)), np.nan) if empty else tightest_box(X, y, limits)
        radius = 0.0
        if not empty:
            radius = chebyshev_centre(X, y, limits)[1]
            theta = middle_centre(X, y, limits, radius, box)
        lower, upper, centre = (pd.Series(v, index=index) for v in (*box, theta))
        units = tuple(units or ("",) * len(names))
        return cls(names, units, X, y, limits, lower, upper, centre, radius, smallest, rows, t)

    @property
    def empty(self) -> bool:
        """Whether no parameter vector respects the bound: it is falsified."""
        return self.smallest > 1.0 + SLACK

    def contains(self, theta: Mapping[str, float] | ArrayLike) -> bool:
        """Whether a parameter vector is in the set."""
        if isinstance(theta, Mapping | pd.Series):
            theta = [theta[name] for name in self.names]
        error = np.abs(self.y - self.X @ np.asarray(theta, dtype=float))
        return bool(np.all(error <= self.bound * (1.0 + SLACK)))

    def vertices(self) -> Array:
        """Return the corners of the polytope, (n_vertices, p); none of an empty set."""
        from scipy.spatial import HalfspaceIntersection

        p = len(self.names)
        if self.empty:
            return np.zeros((0, p))
        if p == 1:
            return np.array([self.lower.to_numpy(), self.upper.to_numpy()])
        width = np.maximum((self.upper - self.lower).to_numpy(), 1e-300)
        centre = self.centre.to_numpy()
        rest = self.y - self.X @ centre  # the set around its centre, each side of the box 1 long
        A = np.vstack([self.X, -self.X]) * width
        b = np.concatenate([self.bound + rest, self.bound - rest])
        size = np.linalg.norm(A, axis=1)
        faces = np.column_stack([A, -b])[size > 0.0] / size[size > 0.0, None]
        corners = HalfspaceIntersection(faces, np.zeros(p)).intersections
        return centre + width * np.unique(corners.round(12), axis=0)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the set says, one line each."""
        if not self.empty:
            box = ", ".join(f"{n} {self.lower[n]:.5g} to {self.upper[n]:.5g}" for n in self.names)
            least = self.smallest * self.bound.max()
            return (
                f"bound {self.bound.max():.4g}; the least that leaves anything is {least:.4g}",
                f"box: {box}",
            )
        where = ", ".join(
            str(k) if self.t is None else f"{k} (t = {self.t[k]:.3f} s)" for k in self.rows
        )
        return (
            f"EMPTY: no parameters keep every row within the bound; {self.smallest:.4g} times the "
            "bound would leave one",
            f"rows that contradict each other: {where}",
        )

    def frame(self) -> pd.DataFrame:
        """Return the box: columns unit, lower, upper, centre, width."""
        unit = pd.Series(self.units, index=self.lower.index)
        columns = {"unit": unit, "lower": self.lower, "upper": self.upper, "centre": self.centre}
        return pd.DataFrame({**columns, "width": self.upper - self.lower})

    def summary(self) -> Text:
        """Return a table of at most 80 columns."""
        frame = self.frame()
        rows = [
            [str(name), unit, *(dashed(v, ".6g") for v in values)]
            for name, unit, values in zip(
                frame.index, self.units, frame.drop(columns="unit").to_numpy(float), strict=True
            )
        ]
        head = two_columns(
            [
                ("Rows", str(len(self.y))),
                ("Largest bound", f"{self.bound.max():.6g}"),
                ("Empty", "YES" if self.empty else "no"),
                ("Smallest bound, relative", f"{self.smallest:.4g}"),
            ]
        )
        header = ["", "unit", "lower", "upper", "centre", "width"]
        return table("Feasible set", head, header, rows, self.notes, left=2)

    def __repr__(self) -> str:
        if self.empty:
            return f"<FeasibleSet: empty, {self.smallest:.4g} times the bound would do>"
        box = (f"{n} [{self.lower[n]:.5g}, {self.upper[n]:.5g}]" for n in self.names)
        return f"<FeasibleSet: {', '.join(box)}>"
