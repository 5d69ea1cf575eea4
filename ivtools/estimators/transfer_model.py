"""A transfer function with what makes its output complete: offset, initial conditions, delay."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ivtools.estimators.continuous import Hold, derivatives, free_response, respond

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Model:
    """A(s) y = B(s) u(t - delay) + offset + initial conditions, or the same in delta.

    What the record does not show from before its first sample, the state at that sample, acts as
    impulses there and of their derivatives: A(s) y = ... + c0 + c1 s ..., as many as poles.

    Attributes
    ----------
    A, B : ndarray
        Polynomials, highest power first; A is monic.
    offset : float
        A constant input.
    initial : ndarray, (number of poles,)
        c0, c1 ...; none stands for zeros.
    delay : float
        Of the input, s.
    """

    A: Array
    B: Array
    offset: float = 0.0
    initial: Array = field(default_factory=lambda: np.zeros(0))
    delay: float = 0.0

    def respond(self, u: Array, dt: float, hold: Hold) -> Array:
        """Return the output (n_samples,) for an input, initial conditions included."""
        out = respond(self.B, self.A, u, dt, hold, self.delay)
        if self.offset != 0.0:
            out += respond([self.offset], self.A, np.ones(len(u)), dt, held(hold))
        if self.initial.any():
            out += free_response(self.A, len(u), dt, hold) @ self.initial
        return out

    def lateness(self, u: Array, F: Array, dt: float, hold: Hold) -> Array:
        """Return what the filtered equation gains per second of delay, (n_samples,)."""
        m = len(self.B) - 1
        U = derivatives(u, F, dt, hold, self.delay)
        return -U[:, m + 1 : 0 : -1] @ self.B

    def settled_on(self, u: Array, y: Array, dt: float, hold: Hold) -> Array:
        """Return the output (n_samples,) from the initial conditions that suit y best."""
        rest = Model(self.A, self.B, self.offset, delay=self.delay).respond(u, dt, hold)
        free = free_response(self.A, len(u), dt, hold)
        size = np.maximum(np.linalg.norm(free, axis=0), np.finfo(float).tiny)
        return rest + free / size @ np.linalg.lstsq(free / size, y - rest, rcond=None)[0]


def held(hold: Hold) -> Hold:
    """Return how a constant runs between samples."""
    return "euler" if hold == "euler" else "zoh"
