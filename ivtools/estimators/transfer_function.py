"""Transfer functions by refined instrumental variables: the iteration, and SRIVC.

`box_jenkins` adds noise models and discrete time, `closed_loop_srivc` the closed loop.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import ConvergenceWarning, EstimationError, RecordError
from ivtools.estimators.continuous import (
    Hold,
    derivatives,
    exponents,
    reflect,
    reflect_delta,
    respond,
)
from ivtools.estimators.transfer_results import TransferFunctionResults
from ivtools.linalg import solve_iv

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]
Signal = Literal["q_ref", "nu", "q", "dq"]

_SETTLE = 0.1  # most of the record that a filter's transient may cost
_SETTLING = 10  # iterations after which noise model and rows are held: they may alternate


@dataclass(frozen=True)
class Model:
    """A(s) y = B(s) u + offset, or the same in delta, with what the iteration needs of it.

    Attributes
    ----------
    A, B : ndarray
        Polynomials, highest power first; A is monic.
    offset : float
    """

    A: Array
    B: Array
    offset: float

    def respond(self, u: Array, dt: float, hold: Hold) -> Array:
        """Return the response (n_samples,) from rest; a constant input stands for the offset."""
        noise_free = respond(self.B, self.A, u, dt, hold)
        if self.offset == 0.0:
            return noise_free
        held: Hold = "euler" if hold == "euler" else "zoh"
        return noise_free + respond([self.offset], self.A, np.ones(len(u)), dt, held)


@dataclass(frozen=True)
class SRIVC:
    """Simplified refined instrumental variables for a continuous-time transfer function.

    Filters input and output by 1/A, takes the noise-free output of the last model as instruments,
    solves, repeats. Statistically efficient if the output error is white. Unbiased whatever the
    error is as long as the input does not know it; biased from command to position or velocity of
    a closed loop, whose command carries the noise (see `CLSRIVC`): by -1.7 % where a coloured
    disturbance of 3 mm acts on the position of the EMPS, not visibly where an encoder's white noise
    of 10 um does. Intervals are too narrow where noise acts on the force (they cover 60 to 80 %).

    Parameters
    ----------
    poles, zeros : int
        Degrees of A and B.
    integrators : int
        How many of the poles are known to be at s = 0.
    input, output : {"nu", "q_ref"}, {"q", "dq"}
        Signals of the record; "dq" is the backward difference of the position if the record has no
        velocity.
    offset : bool
        Estimate a constant input beside the measured one.
    hold : {"zoh", "foh"}
        How the input runs between samples: held as a command is, or straight.
    start : sequence of float, optional
        Starting coefficients in the order of `names`. Default: the best of several
        state-variable-filter estimates.
    tol : float
        Relative change of the coefficients at which the iteration ends.
    max_iter : int
        Most iterations.

    References
    ----------
    P. C. Young, A. J. Jakeman, "Refined instrumental variable methods of recursive time-series
    analysis, part III: extensions", Int. J. Control 31(4), 1980; P. C. Young, *Recursive Estimation
    and Time-Series Analysis*, Springer, 2011, ch. 8.

    Examples
    --------
    >>> import ivtools as iv
    >>> problem = iv.Problem(iv.datasets.twin(), iv.axes.emps())
    >>> fit = SRIVC(poles=2, zeros=0, input="q_ref").fit(problem)
    >>> fit.converged, fit.relative_error < 2.0
    (True, True)
    """

    key: ClassVar[str] = "srivc"

    poles: int = 1
    zeros: int = 0
    integrators: int = 0
    input: Signal = "nu"
    output: Signal = "q"
    offset: bool = True
    hold: Hold = "zoh"
    start: Sequence[float] | None = None
    tol: float = 1e-4
    max_iter: int = 50

    def __post_init__(self) -> None:
        """Refuse a structure that is none."""
        if not 1 <= self.poles <= 8:
            raise EstimationError(f"poles = {self.poles} must be 1 to 8")
        if not 0 <= self.zeros <= self.poles - (self.hold != "foh"):
            raise EstimationError(f"zeros = {self.zeros} must be 0 to {self.poles - 1}")
        if not 0 <= self.integrators <= self.poles:
            raise EstimationError(f"integrators = {self.integrators} must be 0 to {self.poles}")
        if self.start is not None and len(self.start) != len(self.names):
            raise EstimationError(
                f"start has {len(self.start)} values; the structure has {', '.join(self.names)}"
            )

    def fit(self, problem: Problem) -> TransferFunctionResults:
        """Estimate the transfer function of a problem's record.

        Raises
        ------
        RecordError
            If the record lacks a signal.
        """
        start = perf_counter()
        u, y = signal(problem, self.input), signal(problem, self.output)
        first = y[0]
        model, Z, rows, n_iter, converged = self.iterate(u, y - first, problem)
        if not converged:
            warnings.warn(
                f"{self.key} has not converged in {n_iter} iterations; take fewer poles and zeros",
                ConvergenceWarning,
                stacklevel=2,
            )
        simulated = first + model.respond(u, problem.record.dt, self.hold)
        return TransferFunctionResults.of(
            self, model, y, simulated, rows, Z, problem, self._memory(model, problem),
            n_iter=n_iter, converged=converged, runtime=perf_counter() - start,
        )  # fmt: skip

    def iterate(
        self, u: Array, y: Array, problem: Problem
    ) -> tuple[Model, Array, tuple[Array, Array], int, bool]:
        """Return the model, the instruments, the rows (X, target), iterations and convergence."""
        dt = problem.record.dt
        model = self._start(u, y, dt)
        for n_iter in range(1, self.max_iter + 1):  # noqa: B007
            F = self._stable(model.A, dt, least=20.0 / (len(y) * dt))  # a filter has to forget
            X, target = self._rows(u, y, F, dt)  # (N, p), (N,)
            Z, _ = self._rows(*self.noise_free(model, u, problem), F, dt)  # (N, p)
            if n_iter <= _SETTLING:
                whiten = self._whitener(model, u, y, dt)
                keep = slice(self._settled(F, dt, len(y)), None)
            X, target, Z = whiten(X), whiten(target), whiten(Z)
            X, target, Z = X[keep], target[keep], Z[keep]
            old, model = self.coefficients(model), self._model(solve_iv(X, target, Z), dt)
            new, weight = self.coefficients(model), np.linalg.norm(X, axis=0)  # (p,), (p,)
            if np.linalg.norm(weight * (new - old)) <= self.tol * np.linalg.norm(weight * new):
                return model, Z, (X, target), n_iter, True
        return model, Z, (X, target), self.max_iter, False

    def noise_free(self, model: Model, u: Array, problem: Problem) -> tuple[Array, Array]:
        """Return input and output of the last model: what the instruments are made of."""
        return u, model.respond(u, problem.record.dt, self.hold)

    def _whitener(self, model: Model, u: Array, y: Array, dt: float) -> Callable[[Array], Array]:
        """Return what makes the error of the rows white: nothing, the output error is taken so."""
        return lambda columns: columns

    def _start(self, u: Array, y: Array, dt: float) -> Model:
        """Return the best of several state-variable-filter estimates, by its simulation."""
        if self.start is not None:
            return self._model(np.asarray(self.start, dtype=float), dt)
        best, least = None, np.inf
        for speed in np.geomspace(2.0, 0.2 / dt, 7):  # rad/s
            F = np.asarray(np.poly(np.full(self.poles, -speed)), dtype=float)
            X, target = self._rows(u, y, F, dt)
            keep = slice(self._settled(F, dt, len(y)), None)
            model = self._model(solve_iv(X[keep], target[keep]), dt)
            error = float(np.linalg.norm(y - model.respond(u, dt, self.hold)))
            if best is None or error < least:
                best, least = model, error
        assert best is not None
        return best

    def _stable(self, A: Array, dt: float, least: float = 0.0) -> Array:
        """Return A with unstable roots reflected, all of them decaying by `least`, 1/s, or more."""
        return reflect_delta(A, dt, least) if self.hold == "euler" else reflect(A, least)

    def _settled(self, F: Array, dt: float, n: int) -> int:
        """Return the samples after which a filter 1/F has forgotten its start."""
        slowest = np.min(np.abs(exponents(np.roots(F), dt, self.hold).real))
        return int(min(8.0 / (slowest * dt), _SETTLE * n))

    def _memory(self, model: Model, problem: Problem) -> int:
        """Return the lags over which the error of the rows is correlated by their own filter."""
        dt, n = problem.record.dt, problem.record.n_samples
        F = self._stable(model.A, dt, least=20.0 / (n * dt))
        slowest = np.min(np.abs(exponents(np.roots(F), dt, self.hold).real))
        return int(min(3.0 / (slowest * dt), 0.25 * n))

    def _rows(self, u: Array, y: Array, F: Array, dt: float) -> tuple[Array, Array]:
        """Return X (N, p) and target (N,) of s^n y = -a s^(n-1) y ... + b s^m u ... + offset."""
        n, m, k = self.poles, self.zeros, self.integrators
        straight: Hold = "euler" if self.hold == "euler" else "foh"
        held: Hold = "euler" if self.hold == "euler" else "zoh"
        Y, U = derivatives(y, F, dt, straight), derivatives(u, F, dt, self.hold)
        columns = [-Y[:, n - 1 : k - 1 if k else None : -1][:, : n - k], U[:, m::-1][:, : m + 1]]
        if self.offset:
            columns.append(derivatives(np.ones(len(y)), F, dt, held)[:, :1])
        return np.hstack(columns), Y[:, n]

    def _model(self, theta: Array, dt: float) -> Model:
        """Return the model of a solution, unstable roots reflected."""
        free = self.poles - self.integrators
        A = self._stable(np.concatenate([[1.0], theta[:free]]), dt)
        A = np.concatenate([A, np.zeros(self.integrators)])
        B = theta[free : free + self.zeros + 1]
        return Model(A, B, float(theta[-1]) if self.offset else 0.0)

    def coefficients(self, model: Model) -> Array:
        """Return the free coefficients (p,) of a model, in the order of the columns."""
        free = self.poles - self.integrators
        offset = [model.offset] if self.offset else []
        return np.concatenate([model.A[1 : free + 1], model.B, offset])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free coefficients: a1 ..., b0 ..., offset."""
        a = [f"a{i + 1}" for i in range(self.poles - self.integrators)]
        b = [f"b{i}" for i in range(self.zeros + 1)]
        return (*a, *b, *(["offset"] if self.offset else []))


def signal(problem: Problem, name: Signal) -> Array:
    """Return a signal (n_samples,) of the problem's record.

    Raises
    ------
    RecordError
        If the record lacks it.
    """
    record = problem.record
    if name == "nu":
        return problem.loop.command(record)[:, 0]
    if name == "dq" and record.dq is None:
        q = record.q[:, 0]
        return np.diff(q, prepend=2.0 * q[0] - q[1]) / record.dt
    column = getattr(record, name)
    if column is None:
        raise RecordError(f"the record has no {name}; choose another input or output")
    return np.asarray(column[:, 0])
