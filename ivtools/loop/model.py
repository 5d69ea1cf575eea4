"""The dynamic model: terms, their parameters, and the observation matrix."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import AxisError, ShapeError, shown
from ..limits import LARGEST
from ..physics import Parameter, Term
from ..pipeline import Motion

Array = NDArray[np.float64]
Theta = Mapping[str, float] | ArrayLike


class Model:
    """What `ClosedLoop` knows of the dynamic model."""

    terms: tuple[Term, ...]
    joint: str
    start: Mapping[str, float]

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        """Every parameter by its full name."""
        return {n: p for t in self.terms for n, p in t.by_name.items()}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns of the observation matrix: what the force is linear in."""
        return tuple(n for t in self.terms if t.law is not None for n in t.linear)

    @property
    def units(self) -> dict[str, str]:
        """Unit of every parameter."""
        return {name: p.unit_for(self.joint) for name, p in self.parameters.items()}

    def values(self, theta: Theta | None = None) -> dict[str, float]:
        """Return the value of every parameter.

        Parameters
        ----------
        theta : mapping, Series or array_like, optional
            Values by name, or in the order of `names`. What it lacks comes from `start`; the
            parameters of an effect, and shape parameters, may also keep their neutral values.

        Raises
        ------
        AxisError
            If a name is unknown, a value missing or not finite.
        ShapeError
            If an array has the wrong length.
        """
        known, names = self.parameters, self.names
        if theta is None:
            given: dict[str, float] = {}
        elif hasattr(theta, "items"):
            given = {str(k): self._number(str(k), v) for k, v in theta.items()}
        else:
            array = np.ravel(np.asarray(theta, dtype=float))
            if len(array) != len(names):
                raise ShapeError(
                    f"theta has {len(array)} values and the model {len(names)} parameters: "
                    f"{', '.join(names)}"
                )
            given = dict(zip(names, array.tolist(), strict=True))
        for key, value in given.items():
            if key not in known:
                raise AxisError(
                    f"parameter {key!r} is not in the model, whose are: {', '.join(known)}"
                )
            if not abs(value) <= LARGEST:
                raise AxisError(
                    f"parameter {key} is {value:g}; it must be finite, and at most {LARGEST:g}"
                )
        return {n: self._value(n, p, given) for n, p in known.items()}

    @staticmethod
    def _number(name: str, value: Any) -> float:
        try:
            return float(value)
        except (TypeError, ValueError, OverflowError):
            raise AxisError(
                f"parameter {name} is {shown(repr(value))}; it must be a number"
            ) from None

    def _value(self, name: str, parameter: Parameter, given: Mapping[str, float]) -> float:
        if name in given:
            return given[name]
        if name in self.start:
            return float(self.start[name])
        if parameter.linear and any(t.base and name in t.names for t in self.terms):
            raise AxisError(
                f"parameter {name!r} has no value; give theta, or a starting value in [model.start]"
            )
        return parameter.neutral

    def regressor(self, motion: Motion, tau: ArrayLike = 0.0, t: ArrayLike = 0.0) -> Array:
        """Return the observation matrix along a trajectory, (n_samples, n_parameters).

        Parameters
        ----------
        motion : Motion
            Position, velocity, acceleration of the joint.
        tau, t : array_like, optional
            Drive force and time, for terms that depend on them.
        """
        out = np.empty((len(motion.q), len(self.names)), order="F")  # filtered column by column
        first = 0
        for block in self.blocks(motion, tau, t):
            last = first + block.shape[1]
            out[:, first:last], first = block, last
        return out

    def blocks(self, motion: Motion, tau: ArrayLike = 0.0, t: ArrayLike = 0.0) -> Iterator[Array]:
        """Yield the observation matrix term by term, for records too long for all of it."""
        q, dq, ddq = (np.ravel(a) for a in motion)
        for term in self.terms:
            if term.law is not None:
                yield term.columns(q, dq, ddq, np.ravel(tau), np.ravel(t), self.start)

    @property
    def substeps(self) -> int:
        """Integration steps per sample that the terms need."""
        return max(term.substeps for term in self.terms)
