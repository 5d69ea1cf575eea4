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
_EDGE = 2  # samples at either end of which derivatives of a reference take some beyond it
_NONE = 1e-10  # of the largest singular value: states that together do nothing to the command
KNOWN, MEASURED = slice(0, 3), slice(3, 5)  # of the inputs: before a simulation, and in it


@dataclass(frozen=True, eq=False)
class Clipped:
    """Where a recorded command was clipped.

    Parameters
    ----------
    side : ndarray, (n_samples,)
        The sign of the command where it was, 0 elsewhere.
    limit : float
        At which.
    sure : bool
        It was clipped at all these samples; else at those where the law itself gives more.
    """

    side: Array
    limit: float
    sure: bool = True

    @classmethod
    def of(cls, command: Array, limit: float, least: float, sure: bool = True) -> Clipped:
        """Return where a command, (n_samples,), sits at a limit: from the least of it on."""
        at = np.abs(command) >= _AT_LIMIT * least
        return cls(np.where(at, np.sign(command), 0.0), limit, sure)


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

    def command(self, inputs: Array, state: Array, clipped: Clipped | None = None) -> Array:
        """Return the command, before its limit, that the inputs make, (n_samples,).

        Parameters
        ----------
        inputs : (n_samples, 5) ndarray
        state : (n,) ndarray
            At the first sample.
        clipped : Clipped, optional
            Nowhere by default.
        """
        return self._march(inputs, state, clipped)[0]

    def began(
        self,
        inputs: Array,
        command: Array,
        clipped: Clipped | None = None,
        near: Array | None = None,
    ) -> Array:
        """Return the state, (n,), in which the law began, so that it gives these commands.

        Parameters
        ----------
        inputs : (n_samples, 5) ndarray
        command : (n_samples,) ndarray
            The law's own recorded command.
        clipped : Clipped, optional
            Nowhere by default.
        near : (n,) ndarray, optional
            A first guess, from which the states are found that were held; the settled state by
            default.
        """
        start = self.settled(inputs[0], float(command[0])) if near is None else near
        if not len(self.C):
            return start
        given, free = self.freely(inputs, start, clipped)
        if not (np.isfinite(free).all() and np.isfinite(given).all()):  # an unstable law
            return start
        rows = np.ones(len(command), dtype=bool)
        if clipped is not None and (clipped.side == 0.0).any():
            rows = clipped.side == 0.0
        edge = max(len(self.taps), _EDGE)  # velocities there, and derivatives, rest on a guess
        if rows.sum() > 4 * edge:
            rows[:edge] = rows[len(rows) - _EDGE :] = False
        size = np.maximum(np.max(np.abs(free), axis=0), 1e-300)
        free /= size
        # what the states can do to the command, whatever they are; of it, what is seen
        _, much, states = np.linalg.svd(np.linalg.qr(free, mode="r"), full_matrices=False)
        acts = much > _NONE * much[0]
        does = free @ (states[acts].T / much[acts]) * rows[:, np.newaxis]
        energy, ways = np.linalg.eigh(does.T @ does)
        seen = energy > _SILENT**2  # noise would be all of the others
        told = ways[:, seen]
        change = told @ (told.T @ (does.T @ (command - given)) / energy[seen]) / much[acts]
        found = start + states[acts].T @ change / size
        return found if np.isfinite(found).all() else start

    def freely(
        self, inputs: Array, state: Array, clipped: Clipped | None = None
    ) -> tuple[Array, Array]:
        """Return the command from a state on, (n_samples,), and its answers to that.

        Those are (n_samples, n), to a unit of each state.
        """
        given, frozen = self._march(inputs, state, clipped)
        answers = [self._free(e, frozen, clipped) for e in np.eye(len(state))]
        return given, np.array(answers).reshape(len(state), len(given)).T

    def settled(self, inputs: Array, command: float | None = None) -> Array:
        """Return the state, (n,), that stays as it is with these inputs, and gives this command."""
        rows, wanted = np.eye(len(self.C)) - self.A, self.B @ inputs
        if command is not None:
            rows = np.vstack([rows, self.C])
            wanted = np.append(wanted, command - self.D @ inputs)
        return np.asarray(np.linalg.lstsq(rows, wanted, rcond=None)[0], dtype=float)

    def _march(
        self, inputs: Array, state: Array, clipped: Clipped | None
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Return the command, and which states were held, (n_samples, n)."""
        frozen = np.zeros((len(inputs), len(self.C)), dtype=bool)
        if not len(self.C):
            return inputs @ self.D, frozen
        return self._run(inputs @ self.B.T, inputs @ self.D, state, clipped, frozen, False), frozen

    def _free(self, state: Array, frozen: NDArray[np.bool_], clipped: Clipped | None) -> Array:
        """Return the command that a state makes by itself, held where the command was clipped."""
        n = len(frozen)
        alone = None if clipped is None else replace(clipped, limit=0.0)
        return self._run(np.zeros((n, len(self.C))), np.zeros(n), state, alone, frozen, True)

    def _run(
        self,
        driven: Array,
        direct: Array,
        state: Array,
        clipped: Clipped | None,
        frozen: NDArray[np.bool_],
        given: bool,
    ) -> Array:
        """Return the command, given what the inputs add to the states and to it."""
        from .march import march

        n = len(direct)
        where = Clipped(np.zeros(n), np.inf) if clipped is None else clipped
        out = np.empty(n)
        march(
            np.ascontiguousarray(self.A),
            driven,
            direct,
            self.C,
            self.back,
            self.hold,
            np.array(state, dtype=float),
            where.side,
            where.limit,
            frozen,
            given,
            given or where.sure,
            out,
        )
        return out
