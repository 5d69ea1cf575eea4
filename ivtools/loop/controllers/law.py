"""The one form of every control law: linear in what the controller sees, with states of its own.

::

    nu[k]   = C x[k] + D u[k]
    x[k+1]  = A x[k] + B u[k] + back (clip(nu[k]) - nu[k])
    u       = (q_ref, dq_ref, feed, q, dq)

`feed` is all that is known beforehand: feed-forwards and further measured columns. dq is what the
controller takes for the velocity: a sensor's, or `taps` of the present and past positions. The
states that `hold` marks, integrators, stay while the command is clipped and they would drive it
further.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

INPUTS = ("q_ref", "dq_ref", "feed", "q", "dq")
_AT_LIMIT = 1.0 - 1e-6  # of the limit, from which a command counts as clipped
_SILENT = 1e-2  # of what a start does by itself: where less is seen, it does the least it can
_NONE = 1e-10  # of the largest singular value: states that together do nothing to the command
KNOWN, MEASURED = slice(0, 3), slice(3, 5)  # of the inputs: before a simulation, and in it


@dataclass(frozen=True)
class LinearLaw:
    """A control law at its sampling rate; units are command per position or velocity.

    Parameters
    ----------
    D : ndarray, (5,)
        Gains on the inputs.
    taps : ndarray, (n_taps,)
        Weights, 1/s, of the measured position, newest first, that make the velocity.
    sensed : bool
        The velocity is that of the motion, and the taps stand for it where only positions are.
    A, B, C : ndarray, (n, n), (n, 5), (n,)
        Own states; n may be 0.
    back : ndarray, (n,)
        What the states take back of a command that is clipped.
    hold : ndarray of bool, (n,)
        The states that stay rather than drive a clipped command further.
    """

    D: Array
    taps: Array
    A: Array = field(default_factory=lambda: np.zeros((0, 0)))
    B: Array = field(default_factory=lambda: np.zeros((0, len(INPUTS))))
    C: Array = field(default_factory=lambda: np.zeros(0))
    back: Array = field(default_factory=lambda: np.zeros(0))
    hold: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))
    sensed: bool = False

    # --- composition --------------------------------------------------------------------------

    def into(self, A: Array, b: Array, c: Array, d: float) -> LinearLaw:
        """Return this law followed by a filter x+ = A x + b nu, nu' = c x + d nu."""
        n, m = len(self.C), len(c)
        above = np.hstack([self.A, np.zeros((n, m))])
        return replace(
            self,
            A=np.vstack([above, np.hstack([np.outer(b, self.C), A])]),
            B=np.vstack([self.B, np.outer(b, self.D)]),
            C=np.concatenate([d * self.C, c]),
            D=d * self.D,
            back=np.concatenate([self.back, np.zeros(m)]),
            hold=np.concatenate([self.hold, np.zeros(m, dtype=bool)]),
        )

    def known(self, known: Array) -> tuple[Array, Array]:
        """Return what the known inputs, (n_samples, 3), add to the command and to the states."""
        return known @ self.D[KNOWN], known @ self.B[:, KNOWN].T

    def response(self, z: NDArray[np.complex128], to: str = "q") -> NDArray[np.complex128]:
        """Return the transfer function from an input to the command, limits aside, (len(z),).

        That of the position includes the velocity that is made of it.
        """
        one = np.eye(len(INPUTS))[INPUTS.index(to)]
        shape = np.broadcast_to(one, (len(z), len(INPUTS))).astype(complex)
        if to == "q":
            shape[:, 4] = (z[:, np.newaxis] ** -np.arange(len(self.taps))) @ self.taps
        answer = np.asarray(shape @ self.D, dtype=complex)
        if len(self.C):
            inner = z[:, np.newaxis, np.newaxis] * np.eye(len(self.C)) - self.A
            states = np.linalg.solve(inner, (shape @ self.B.T)[:, :, np.newaxis])
            return np.asarray(answer + states[:, :, 0] @ self.C, dtype=complex)
        return answer

    def polynomials(self) -> tuple[Array, Array]:
        """Return numerator and denominator, in z^-1, of the answer to the position.

        Limits aside, and with the velocity that is made of the position.
        """
        under = np.poly(self.A) if len(self.C) else np.ones(1)

        def over(j: int) -> Array:
            fed = np.poly(self.A - np.outer(self.B[:, j], self.C)) if len(self.C) else under
            return np.asarray(fed + (self.D[j] - 1.0) * under)

        velocity = np.convolve(over(4), self.taps)
        velocity[: len(under)] += over(3)
        return velocity, np.asarray(under)

    # --- along a record -----------------------------------------------------------------------

    def velocity(self, q: Array) -> Array:
        """Return the velocity that the law makes of positions, (n_samples,).

        The positions before the record lie on the straight line through its first two samples.
        """
        before = q[0] + (q[0] - q[1]) * np.arange(len(self.taps) - 1, 0, -1)
        return np.convolve(np.concatenate([before, q]), self.taps, mode="valid")

    def command(
        self,
        inputs: Array,
        state: Array,
        side: Array | None = None,
        limit: float = np.inf,
    ) -> Array:
        """Return the command, before its limit, that the inputs make, (n_samples,).

        Parameters
        ----------
        inputs : (n_samples, 5) ndarray
        state : (n,) ndarray
            At the first sample.
        side : (n_samples,) ndarray, optional
            The sign of the command where it is known to be clipped, 0 elsewhere.
        limit : float
            At which it is clipped there.
        """
        return self._march(inputs, state, side, limit)[0]

    def began(
        self,
        inputs: Array,
        command: Array,
        side: Array | None = None,
        limit: float = np.inf,
    ) -> Array:
        """Return the state, (n,), in which the law began, so that it gives these commands.

        Parameters
        ----------
        inputs : (n_samples, 5) ndarray
        command : (n_samples,) ndarray
            The law's own recorded command, clipped where `side` says so.
        side, limit
            As for `command`.
        """
        start = self.settled(inputs[0], float(command[0]))
        if not len(self.C):
            return start
        given, frozen = self._march(inputs, start, side, limit)
        free = np.column_stack([self._free(e, frozen, side) for e in np.eye(len(start))])
        if not (np.isfinite(free).all() and np.isfinite(given).all()):  # an unstable law
            return start
        rows = np.ones(len(command), dtype=bool)
        if side is not None and (side == 0.0).any():
            rows = side == 0.0
        if rows.sum() > 4 * len(self.taps):  # the first velocities rest on a guess of the past
            rows[: len(self.taps)] = False
        left = (command - given)[rows]
        size = np.maximum(np.max(np.abs(free), axis=0), 1e-300)
        # what the states can do to the command, whatever they are; of it, what is seen
        does, much, states = np.linalg.svd(free / size, full_matrices=False)
        acts = much > _NONE * much[0]
        U, seen, V = np.linalg.svd(does[np.ix_(rows, acts)], full_matrices=False)
        told = seen > _SILENT  # noise would be all of the others
        change = V[told].T @ (U[:, told].T @ left / seen[told]) / much[acts]
        found = start + states[acts].T @ change / size
        return found if np.isfinite(found).all() else start

    def settled(self, inputs: Array, command: float | None = None) -> Array:
        """Return the state, (n,), that stays as it is with these inputs, and gives this command."""
        rows, wanted = np.eye(len(self.C)) - self.A, self.B @ inputs
        if command is not None:
            rows = np.vstack([rows, self.C])
            wanted = np.append(wanted, command - self.D @ inputs)
        return np.asarray(np.linalg.lstsq(rows, wanted, rcond=None)[0], dtype=float)

    def _march(
        self, inputs: Array, state: Array, side: Array | None, limit: float
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return the command, and which states were held, (n_samples, n)."""
        direct, frozen = inputs @ self.D, np.zeros((len(inputs), len(self.C)), dtype=bool)
        if not len(self.C):
            return direct, frozen
        from .march import march

        side = np.zeros(len(inputs)) if side is None else np.asarray(side, dtype=float)
        out = np.empty(len(inputs))
        march(
            np.ascontiguousarray(self.A),
            inputs @ self.B.T,
            direct,
            self.C,
            self.back,
            self.hold,
            np.array(state, dtype=float),
            side,
            limit,
            frozen,
            False,
            out,
        )
        return out, frozen

    def _free(self, state: Array, frozen: NDArray[np.bool_], side: Array | None) -> Array:
        """Return the command that a state makes by itself, held where the command was clipped."""
        from .march import march

        out, n = np.empty(len(frozen)), len(frozen)
        side = np.zeros(n) if side is None else np.asarray(side, dtype=float)
        march(
            np.ascontiguousarray(self.A),
            np.zeros((n, len(self.C))),
            np.zeros(n),
            self.C,
            self.back,
            self.hold,
            state.copy(),
            side,
            0.0,
            frozen,
            True,
            out,
        )
        return out


def clipped(command: Array, limit: float) -> Array:
    """Return the sign of a command where it sits at its limit, 0 elsewhere, (n_samples,)."""
    return np.where(np.abs(command) >= _AT_LIMIT * limit, np.sign(command), 0.0)
