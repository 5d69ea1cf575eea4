"""Information: what a motion tells of the parameters, and how that changes with the motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import AxisError
from ..loop import ClosedLoop, RobotLoop
from ..pipeline import Motion
from .limits import Limits

Array = NDArray[np.float64]
Criterion = Literal["condition", "d", "a"]

_SHARE = 1e-6  # of the limits: step of the differences
_OVER = 30.0  # weight of an effort beyond its limit
_EFFORT = 0.97  # of the limit, at which that begins
_SOFT = 0.03  # of a joint's speed limit: within it a softened dry friction turns


class Cost(NamedTuple):
    """A criterion at some motion, and its derivative by position, velocity and acceleration."""

    value: float
    slopes: Motion


@dataclass(frozen=True, eq=False)
class Information:
    """The observation matrix of a loop's motions and what it is worth.

    Parameters
    ----------
    loop : ClosedLoop or RobotLoop
    limits : Limits
        Efforts beyond them cost.
    criterion : {"condition", "d", "a"}
        Condition number of the observation matrix; volume of the confidence ellipsoid; sum of the
        relative variances. The latter two take the noise of a joint as proportional to its effort.
    power : float
        Sharpness of the condition number: that of the norm of the eigenvalues that stands for
        the largest one, for the largest has no derivative where two are equal.
    soft : bool
        Whether dry friction turns smoothly with the velocity. As a step it has no derivative at a
        reversal, and gradient searches end there.
    """

    loop: ClosedLoop | RobotLoop
    limits: Limits
    criterion: Criterion = "condition"
    power: float = 4.0
    soft: bool = False

    def matrix(self, motion: Motion) -> Array:
        """Return the observation matrix, (n_joints, n_samples, p)."""
        X = self.loop.regressor(motion)
        X = X if X.ndim == 3 else X[np.newaxis]
        if self.soft:
            for joint, column in zip(*self._dry.nonzero(), strict=True):
                speed = _SOFT * self.limits.speed[joint]
                X[joint, :, column] = np.tanh(motion.dq[:, joint] / speed)
        return X

    @cached_property
    def _dry(self) -> NDArray[np.bool_]:
        """Which columns are the sign of which joint's velocity, (n_joints, p)."""
        limits, shape = self.limits, (64, self.limits.n_joints)
        rng = np.random.default_rng(0)
        q = rng.uniform(limits.lower, limits.upper, shape)
        motion = Motion(q, *(rng.uniform(-x, x, shape) for x in self._sizes[1:]))
        X = replace(self, soft=False).matrix(motion)
        return np.asarray((np.sign(motion.dq).T[:, :, np.newaxis] == X).all(axis=1))

    def condition(self, motion: Motion) -> float:
        """Return the condition number of the observation matrix, in SI units."""
        X = self.matrix(motion)
        return float(np.linalg.cond(X.reshape(-1, X.shape[2])))

    def effort(self, motion: Motion) -> Array:
        """Return the force that the loop's starting values ask for, (n_samples, n_joints)."""
        return np.asarray((self.matrix(motion) @ self._theta).T, dtype=float)

    @cached_property
    def _theta(self) -> Array:
        """Starting values; not numbers if the loop has none and nothing asks for them."""
        try:
            values = self.loop.values()
        except AxisError:
            if np.isfinite(self.limits.effort).any() or self.criterion == "a":
                raise
            values = dict.fromkeys(self.loop.names, np.nan)
        return np.array([values[name] for name in self.loop.names])

    def __call__(self, motion: Motion) -> Cost:
        """Return the criterion of a motion and its derivative."""
        around, steps = self._around(motion)
        X = around[:, 0]
        rows = (X * self._weights[:, np.newaxis, np.newaxis]).reshape(-1, X.shape[2])
        value, S = self._scored(rows.T @ rows)
        excess, pushed = self._excess(X)
        by = 2.0 * (self._weights[:, np.newaxis, np.newaxis] ** 2 * X) @ S  # (joints, n, p)
        if pushed is not None:
            by += pushed[:, :, np.newaxis] * self._theta
        worth = np.einsum("jknp,jnp->kn", around, by)
        slopes = (worth[1:] - worth[0]) / steps.ravel()[:, np.newaxis]
        n, joints = motion.q.shape
        return Cost(value + excess, Motion(*slopes.reshape(3, joints, n).transpose(0, 2, 1)))

    def _around(self, motion: Motion) -> tuple[Array, Array]:
        """Return the matrix as it is and with each signal changed, (joints, 1 + 3 joints, n, p).

        With the steps, (3, joints). Each sample has rows of its own, so one difference per signal
        and joint serves all samples; the changed motions follow each other as if they were one.
        """
        n, joints = motion.q.shape
        steps = _SHARE * np.array(self._sizes)
        moved = [np.tile(signal, (1 + 3 * joints, 1)) for signal in motion]
        for k in range(3 * joints):
            signal, joint = divmod(k, joints)
            moved[signal][(k + 1) * n : (k + 2) * n, joint] += steps[signal, joint]
        return self.matrix(Motion(*moved)).reshape(joints, 1 + 3 * joints, n, -1), steps

    @property
    def _sizes(self) -> tuple[Array, Array, Array]:
        limits = self.limits
        return limits.upper - limits.lower, limits.speed, limits.acceleration

    @property
    def _weights(self) -> Array:
        known = np.isfinite(self.limits.effort)
        if self.criterion == "condition" or not known.all():
            return np.ones(self.limits.n_joints)
        return np.asarray(1.0 / self.limits.effort, dtype=float)

    def _scored(self, G: Array) -> tuple[float, Array]:
        """Return the criterion of the information matrix (p, p) and its derivative by it."""
        values, V = np.linalg.eigh(G)
        values = np.maximum(values, 1e-14 * values[-1])
        if self.criterion == "d":
            return -float(np.log(values).sum()), -(V / values) @ V.T
        if self.criterion == "a":
            scale = np.maximum(np.abs(self._theta), 1e-3 * np.abs(self._theta).max())
            W = V / values @ V.T / scale
            total = float(np.sum(np.diag(W) / scale))
            return np.log(total), -(W @ W.T) / total
        logs, p = np.log(values), self.power
        up, down = np.exp(p * (logs - logs[-1])), np.exp(p * (logs[0] - logs))
        value = logs[-1] - logs[0] + float(np.log(up.sum()) + np.log(down.sum())) / p
        slope = (up / up.sum() - down / down.sum()) / values
        return 0.5 * value, 0.5 * (V * slope) @ V.T  # of the matrix itself, not of its square

    def _excess(self, X: Array) -> tuple[float, Array | None]:
        """Return what efforts beyond their limits cost, and its derivative by them (joints, n)."""
        most = self.limits.effort[:, np.newaxis]
        if not np.isfinite(most).any():
            return 0.0, None
        effort = X @ self._theta
        over = np.maximum(np.abs(effort) / most - _EFFORT, 0.0)
        return float(_OVER * (over**2).sum()), 2.0 * _OVER * over * np.sign(effort) / most
