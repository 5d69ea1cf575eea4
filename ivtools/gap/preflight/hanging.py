"""Gravity where no control law is known: the acceleration over the angle, without a simulation.

Without a law that gives the recorded command there is no closed loop to compare with. What a
pendulum's own weight does shows all the same: below the band in which the drive shakes, its
acceleration follows the force, the friction, and the sine and cosine of the angle. Either half of
the record judges what the other one tells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...loop import ClosedLoop
from ...record import Record
from ..band import below, motion_hz
from ..rules import AGREES, MOST, SWING_EDGE

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Hanging:
    """Gravity by inverse dynamics.

    Parameters
    ----------
    sin, cos : float
        Of gravity, N m.
    inertia : (float, float)
        kg m2: regressed on the acceleration, and from it; noise of the force lies between them.
    removed : float
        Share of the acceleration that friction and force leave which it explains on the other half.
    cutoff_hz : float
        Below which it was looked for, Hz.
    """

    sin: float
    cos: float
    inertia: tuple[float, float]
    removed: float
    cutoff_hz: float

    @property
    def text(self) -> str:
        """What was found, as a sentence."""
        low, high = sorted(self.inertia)
        ratio = float(np.hypot(self.sin, self.cos)) / float(np.sqrt(low * high))
        return (
            f"gravity by inverse dynamics, below {self.cutoff_hz:.2g} Hz and without a simulation: "
            f"it explains {100 * self.removed:.0f} % of the acceleration that force and friction "
            f"leave on the other half of the record; m g l over inertia {ratio:.3g} 1/s2, inertia "
            f"{low:.3g} to {high:.3g} kg m2"
        )


def hanging(record: Record, loop: ClosedLoop) -> Hanging | None:
    """Return the gravity that a revolute axis shows and the model lacks; None if there is none."""
    if loop.joint != "revolute" or "gravity" in {t.name for t in loop.terms}:
        return None
    cutoff = motion_hz(record.q[:, 0], record.dt)
    X, a = _columns(record, loop, cutoff)
    half = len(a) // 2
    parts = (slice(0, half), slice(half, None))
    fits = [np.linalg.lstsq(X[p], a[p], rcond=None)[0] for p in parts]
    plain = [np.linalg.lstsq(X[p, :-2], a[p], rcond=None)[0] for p in parts]
    left = [float(np.sum((a[p] - X[p] @ f) ** 2)) for p, f in zip(parts, fits[::-1], strict=True)]
    rest = [float(np.sum((a[p] - X[p, :-2] @ f) ** 2)) for p, f in zip(parts, plain, strict=True)]
    removed = min(1.0 - one / max(two, 1e-300) for one, two in zip(left, rest, strict=True))
    sizes = [float(np.hypot(*f[-2:])) for f in fits]
    if removed < MOST or max(sizes) > AGREES * min(sizes):
        return None
    direct = np.linalg.lstsq(X, a, rcond=None)[0]
    force, others = X[:, 0], np.column_stack([a, X[:, 1:]])
    inverse = float(np.linalg.lstsq(others, force, rcond=None)[0][0])
    if direct[0] <= 0.0 or inverse <= 0.0:
        return None
    inertia = float(np.sqrt(inverse / direct[0]))
    return Hanging(
        -inertia * float(direct[-2]),
        -inertia * float(direct[-1]),
        (inverse, 1.0 / float(direct[0])),
        removed,
        cutoff,
    )


def _columns(record: Record, loop: ClosedLoop, cutoff: float) -> tuple[Array, Array]:
    """Return force, friction, offset, sine and cosine, (n, 6), and the acceleration, (n,)."""

    def low(x: Array) -> Array:
        """Return the slow part of a signal, (n_samples,)."""
        return below(x, cutoff, record.dt)

    q = low(record.q[:, 0])
    dq = np.gradient(q, record.dt)
    ddq = np.gradient(dq, record.dt)
    columns = [low(loop.force(record)[:, 0]), low(dq), low(np.sign(dq)), np.ones(len(q))]
    X = np.column_stack([*columns, low(np.sin(q)), low(np.cos(q))])
    edge = round(SWING_EDGE / (cutoff * record.dt))
    return X[edge : len(q) - edge], ddq[edge : len(q) - edge]
