"""Limits: how far, how fast and how hard each joint may move."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import AxisError
from ..robot.robot import Robot

Array = NDArray[np.float64]

KEYS = ("lower", "upper", "speed", "acceleration", "effort")
RISE = 0.25  # s in which a joint reaches its speed, where no acceleration is stated


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of the joints, (n,) each, SI.

    Parameters
    ----------
    lower, upper : (n,) ndarray
        Positions, m or rad.
    speed, acceleration : (n,) ndarray
        m/s and m/s2, or rad/s and rad/s2.
    effort : (n,) ndarray
        Force or torque, N or N m; infinite where there is none.
    names : tuple of str, (n,)

    Raises
    ------
    AxisError
        If a joint has no range, or a speed that is no number above 0.

    Examples
    --------
    >>> one = Limits.of({"lower": 0.0, "upper": 0.2, "speed": 0.3}, ("axis",))
    >>> one.acceleration.tolist()
    [1.2]
    """

    lower: Array
    upper: Array
    speed: Array
    acceleration: Array
    effort: Array
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        for j, name in enumerate(self.names):
            low, high = float(self.lower[j]), float(self.upper[j])
            if not (np.isfinite(low) and np.isfinite(high) and low < high):
                raise AxisError(
                    f"{name}: the positions {low:g} to {high:g} are no range; state lower and "
                    "upper in a [limits] table"
                )
            for key in ("speed", "acceleration"):
                if not 0.0 < float(getattr(self, key)[j]) < np.inf:
                    raise AxisError(f"{name}: no {key} is known; state it in a [limits] table")
            if not float(self.effort[j]) > 0.0:
                raise AxisError(f"{name}: effort is {self.effort[j]:g}; it must be above 0")

    @classmethod
    def of(
        cls,
        common: Mapping[str, float],
        names: tuple[str, ...],
        own: Mapping[str, Mapping[str, float]] | None = None,
        robot: Robot | None = None,
    ) -> Limits:
        """Collect limits: those of each joint, before those of all, before those of the model.

        Parameters
        ----------
        common : mapping
            Of all joints, by the names of `KEYS`.
        names : sequence of str
        own : mapping of str to mapping, optional
            Of single joints.
        robot : Robot, optional
            Its file says ranges, speeds and efforts.
        """
        own = own or {}
        for name in own:
            if name not in names:
                raise AxisError(f"limits of {name!r}: there is no such joint; {', '.join(names)}")
        values = {key: np.full(len(names), np.nan) for key in KEYS}
        for j, name in enumerate(names):
            stated = {**common, **own.get(name, {})}
            if robot is not None:
                joint = robot.joints[j]
                stated = {k: getattr(joint, k) for k in KEYS if hasattr(joint, k)} | stated
            stated.setdefault("effort", np.inf)
            if "speed" in stated:
                stated.setdefault("acceleration", stated["speed"] / RISE)
            for key in KEYS:
                values[key][j] = stated.get(key, np.nan)
        return cls(**values, names=names)

    @classmethod
    def from_tables(
        cls, tables: Mapping[str, Any], names: tuple[str, ...], robot: Robot | None = None
    ) -> Limits:
        """Read the tables [limits] and [joint.NAME.limits] of a file."""
        own = {
            name: checked(f"joint.{name}.limits", content["limits"])
            for name, content in tables.get("joint", {}).items()
            if "limits" in content
        }
        return cls.of(checked("limits", tables.get("limits", {})), names, own, robot)

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.names)


def checked(table: str, content: Any) -> dict[str, float]:
    """Return a table of limits after refusing what is not known."""
    if not isinstance(content, Mapping):
        raise AxisError(f"[{table}] is not a table")
    for key, value in content.items():
        if key not in KEYS:
            raise AxisError(f"[{table}] does not know {key!r}; it knows: {', '.join(KEYS)}")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise AxisError(f"[{table}] {key} = {value!r} is not a number")
    return {key: float(value) for key, value in content.items()}
