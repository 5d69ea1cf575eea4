"""FrictionCurve: friction over velocity, with its band."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, overload

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from ivtools.display import Displayed
from ivtools.errors import EstimationError
from ivtools.estimates import critical_values
from ivtools.tables import Text, dashed, table, two_columns

if TYPE_CHECKING:
    pass

Array = NDArray[np.float64]

_UNITS = {"prismatic": ("m/s", "N"), "revolute": ("rad/s", "N m")}


@dataclass(frozen=True, eq=False, repr=False)
class FrictionCurve(Displayed):
    """Friction over velocity, and what was estimated beside it.

    Attributes
    ----------
    velocity, force, std_error : (n,) ndarray
        Points of the curve in rising order of velocity (m/s or rad/s), friction with the offset of
        the force (N or N m), and its standard error, which allows for autocorrelated residuals.
    params, std_errors : Mapping
        Inertia and whatever else does not depend on the velocity alone, SI.
    resids, speed : (N,) ndarray
        Residual of the rows (N or N m) and their velocity.
    joint, name : str
        Kind of joint, and the record.
    r2, relative_error : float
        1 - var(resids)/var(y), and 100 norm(resids)/norm(y), in %.
    min_speed : float
        Slower rows were left out.
    n_passes : int
    converged : bool
    runtime : float
        In s.
    """

    figure: ClassVar[str] = "friction_curve"
    content: ClassVar[tuple[str, ...]] = (
        "params", "std_errors", "relative_error", "r2", "converged",
        "velocity", "force", "std_error",
    )  # fmt: skip

    velocity: Array
    force: Array
    std_error: Array
    params: Mapping[str, float]
    std_errors: Mapping[str, float]
    resids: Array
    speed: Array
    joint: str
    name: str
    r2: float
    relative_error: float
    min_speed: float
    n_passes: int
    converged: bool
    runtime: float

    def __post_init__(self) -> None:
        """Withhold the standard errors of what has not converged."""
        if not self.converged:
            object.__setattr__(self, "std_error", np.full_like(self.std_error, math.nan))
            object.__setattr__(self, "std_errors", dict.fromkeys(self.std_errors, math.nan))

    @property
    def units(self) -> tuple[str, str]:
        """Units of velocity and force."""
        return _UNITS[self.joint]

    @overload
    def __call__(self, velocity: float) -> float: ...
    @overload
    def __call__(self, velocity: Array) -> Array: ...
    def __call__(self, velocity: ArrayLike) -> float | Array:
        """Return the friction at a velocity inside the range of the record; NaN outside it.

        Between the slowest motions of both directions nothing was observed, hence NaN as well.
        """
        v = np.asarray(velocity, dtype=float)
        inside = (v >= self.velocity[0]) & (v <= self.velocity[-1])
        slow = (v > self._gap[0]) & (v < self._gap[1])
        force = np.where(inside & ~slow, np.interp(v, self.velocity, self.force), np.nan)
        return float(force) if force.ndim == 0 else force

    @property
    def _gap(self) -> tuple[float, float]:
        """Slowest velocities on either side of 0."""
        below, above = self.velocity[self.velocity < 0.0], self.velocity[self.velocity > 0.0]
        return (
            float(below[-1]) if len(below) else -np.inf,
            float(above[0]) if len(above) else np.inf,
        )

    def branches(self) -> pd.DataFrame:
        """Return the straight line nearest to each branch of the curve.

        Returns
        -------
        DataFrame
            Rows "positive", "negative"; columns "coulomb" (magnitude at 0), "viscous" (slope),
            "bend" (largest distance of the curve from its line): a bend that is large beside the
            curve's band says that Coulomb and viscous friction are not all.
        """
        rows = {}
        for name, side in (("positive", self.velocity > 0.0), ("negative", self.velocity < 0.0)):
            if np.count_nonzero(side) < 3:
                continue
            v, f, weight = self.velocity[side], self.force[side], 1.0 / self.std_error[side]
            slope, level = np.polynomial.Polynomial.fit(v, f, 1, w=weight).convert().coef[::-1]
            bend = float(np.max(np.abs(f - level - slope * v)))
            rows[name] = {"coulomb": np.sign(v[0]) * level, "viscous": slope, "bend": bend}
        return pd.DataFrame.from_dict(rows, orient="index")

    def asymmetry(self, n: int = 9, alpha: float = 0.05) -> pd.DataFrame:
        """Return how far the friction of both directions differs, at n speeds.

        Returns
        -------
        DataFrame
            Columns speed, forward, backward (magnitude), difference, lower, upper: the odd part of
            the curve is 0 for an axis whose only asymmetry is an offset that does not depend on
            the speed.

        Raises
        ------
        EstimationError
            If the axis moved in one direction only.
        """
        least, most = self._common()
        speed = np.linspace(least, most, n)
        ahead, back = self(speed), -self(-speed)
        std = np.hypot(*(np.interp(s * speed, self.velocity, self.std_error) for s in (1, -1)))
        reach = float(critical_values(math.inf, alpha)) * std
        gap = ahead - back
        return pd.DataFrame(
            {"speed": speed, "forward": ahead, "backward": back, "difference": gap,
             "lower": gap - reach, "upper": gap + reach}
        )  # fmt: skip

    def _common(self) -> tuple[float, float]:
        if not (self.velocity[0] < 0.0 < self.velocity[-1]):
            raise EstimationError("the axis moves in one direction only; nothing can be compared")
        low, high = self._gap
        return max(-low, high), min(-float(self.velocity[0]), float(self.velocity[-1]))

    def to_frame(self, alpha: float = 0.05) -> pd.DataFrame:
        """Return the curve as columns velocity, force, std_error, lower, upper."""
        reach = float(critical_values(math.inf, alpha)) * self.std_error
        return pd.DataFrame(
            {"velocity": self.velocity, "force": self.force, "std_error": self.std_error,
             "lower": self.force - reach, "upper": self.force + reach}
        )  # fmt: skip

    def summary(self, points: int = 5) -> Text:
        """Return the curve at a few speeds as a table."""
        speed_unit, force_unit = self.units
        v = np.concatenate(
            [
                side[np.linspace(0, len(side) - 1, min(points, len(side))).astype(int)]
                for side in (self.velocity[self.velocity < 0], self.velocity[self.velocity > 0])
                if len(side)
            ]
        )
        curve = self.to_frame().set_index("velocity")
        rows = [
            [f"{x:.4g}"]
            + [dashed(curve.loc[x, c], ".4g") for c in ("force", "std_error", "lower", "upper")]
            for x in v
        ]
        header = [f"velocity, {speed_unit}", f"friction, {force_unit}", "std error", "[0.025"]
        return table(
            "Friction over velocity", two_columns(self._status()), [*header, "0.975]"], rows, [],
            left=0,
        )  # fmt: skip

    def _status(self) -> list[tuple[str, str]]:
        params = [
            (name, f"{v:.5g} +- {dashed(self.std_errors[name], '.2g')}")
            for name, v in self.params.items()
        ]
        return [
            *params,
            ("Rows", str(len(self.resids))),
            ("Relative error", f"{self.relative_error:.4f} %"),
            ("R2", f"{self.r2:.6f}"),
            ("Converged", f"{'yes' if self.converged else 'NO'} ({self.n_passes} passes)"),
            ("Slower left out", f"{self.min_speed:.3g} {self.units[0]}"),
        ]

    def __repr__(self) -> str:
        low, high = self.velocity[0], self.velocity[-1]
        return (
            f"<FrictionCurve {self.name}: {low:.3g} to {high:.3g} {self.units[0]}, "
            f"relative error {self.relative_error:.3f} %>"
        )
