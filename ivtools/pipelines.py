"""Pipelines: one per joint of a robot, with the face of one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import ShapeError
from ivtools.pipeline import Motion, Pipeline

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pipelines:
    """The pipelines of a robot's joints; what `Pipeline` does with one signal, for each its own.

    Rows are stacked joint by joint. All have one trim and one decimation, so that what happens at
    one instant can be found again.

    Parameters
    ----------
    joints : tuple of Pipeline
    still : tuple of int
        Joints that stand still throughout: they have no rows, for stiction takes what it takes.

    Raises
    ------
    ShapeError
        If their trims or decimations differ.

    Examples
    --------
    >>> both = Pipelines((Pipeline(20.0, 10), Pipeline(30.0, 10)))
    >>> both.rows(np.ones((2, 2000, 3))).shape
    (400, 3)
    """

    joints: tuple[Pipeline, ...]
    still: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if len({(p.trim, p.decimation) for p in self.joints}) != 1:
            raise ShapeError("the joints' pipelines need one trim and one decimation")

    @property
    def trim(self) -> tuple[int, int]:
        """Samples dropped at the head and at the tail."""
        return self.joints[0].trim

    @property
    def decimation(self) -> int:
        """Decimation factor of all."""
        return self.joints[0].decimation

    @property
    def min_speed(self) -> float:
        """The largest of the joints' least speeds: 0 if none is masked."""
        return max(p.min_speed for p in self.joints)

    @property
    def force_shift(self) -> float:
        """The largest of the joints' delays of the force, in samples: 0 if none is aligned."""
        return max((p.force_shift for p in self.joints), key=abs)

    def broken(self, breaks: tuple[int, ...]) -> Pipelines:
        """Do as `Pipeline.broken`."""
        return Pipelines(tuple(p.broken(breaks) for p in self.joints), self.still)

    def inside(self, n: int) -> NDArray[np.bool_]:
        """Do as `Pipeline.inside`; all joints trim alike."""
        return self.joints[0].inside(n)

    def differentiate(self, q: Array, dt: float, filtered: bool = True) -> Motion:
        """Do as `Pipeline.differentiate`, joint by joint, (n, n_joints) each."""
        parts = [p.differentiate(x, dt, filtered) for p, x in zip(self.joints, q.T, strict=True)]
        return Motion(*(np.hstack(signals) for signals in zip(*parts, strict=True)))

    def align(self, tau: Array) -> Array:
        """Do as `Pipeline.align`, joint by joint, (n, n_joints)."""
        return np.column_stack([p.align(x) for p, x in zip(self.joints, tau.T, strict=True)])

    def samples(self, n: int, speed: Array | None = None) -> NDArray[np.intp]:
        """Return the samples of the stacked rows; as `Pipeline.samples`."""
        return np.concatenate([p.samples(n, s) for _, p, s in self._each(speed)])

    def row_joints(self, n: int, speed: Array | None = None) -> NDArray[np.int_]:
        """Return the joint that each row belongs to."""
        counts = {j: len(p.samples(n, s)) for j, p, s in self._each(speed)}
        return np.repeat(list(counts), list(counts.values()))

    def rows(self, columns: Array, speed: Array | None = None) -> Array:
        """Return the stacked rows of columns (n_joints, n, m); as `Pipeline.rows`."""
        found = []
        for j, pipeline, s in self._each(speed):
            X = columns[j]
            felt = np.flatnonzero(X.any(axis=0))  # most columns say nothing of a joint
            rows = pipeline.rows(np.asfortranarray(X[:, felt]), s)
            full = np.zeros((len(rows), X.shape[1]))
            full[:, felt] = rows
            found.append(full)
        return np.vstack(found)

    def _each(self, speed: Array | None) -> list[tuple[int, Pipeline, Any]]:
        """Return each joint that moves, its pipeline and its speed."""
        speeds = [None] * len(self.joints) if speed is None else list(np.asarray(speed).T)
        every = zip(range(len(self.joints)), self.joints, speeds, strict=True)
        return [one for one in every if one[0] not in self.still]
