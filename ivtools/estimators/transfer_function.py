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
    free_response,
    reflect,
    reflect_delta,
)
from ivtools.estimators.transfer_model import Model, held
from ivtools.estimators.transfer_results import System, TransferFunctionResults
from ivtools.linalg import solve_iv

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]
Signal = Literal["q_ref", "nu", "q", "dq"]

_SETTLING = 10  # iterations after which the noise model is held: it may alternate
_KINK = 0.05  # of a step: at whole steps a held input has a kink, where a delay never settles
_LATEST = 0.05  # of the record: the largest delay that is looked for


@dataclass(frozen=True)
class SRIVC:
    """Simplified refined instrumental variables for a continuous-time transfer function.

    Filters input and output by 1/A, takes the noise-free output of the last model as instruments,
    solves, repeats. Statistically efficient if the output error is white. Unbiased whatever the
    error is as long as the input does not know it; biased from command to position or velocity of
    a closed loop, whose command carries the noise (see `CLSRIVC`), unless that noise is white.
    The state at the first sample is estimated with the rest: what is known of a signal starts
    there, in the filters as well.

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
        Estimate a constant input beside the measured one. Without offset and integrator the output
        is 0 where the input has been 0 for long.
    hold : {"zoh", "foh"}
        How the input runs between samples: held as a command is, or straight.
    initial : {"estimate", "rest"}
        Estimate the state at the first sample, or take the axis to rest there.
    delay : float or "estimate"
        Of the input, s; in discrete time whole samples.
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
    initial: Literal["estimate", "rest"] = "estimate"
    delay: float | Literal["estimate"] = 0.0
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
        known = isinstance(self.delay, int | float)
        if self.delay != "estimate" and not (known and 0.0 <= float(self.delay) < np.inf):
            raise EstimationError(f"delay = {self.delay!r} must be 0 or more, s, or 'estimate'")
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
        EstimationError
            If samples are missing in it: a filter runs through all.
        """
        if problem.record.breaks:
            raise EstimationError(
                f"{self.key} takes one stretch without missing samples; give record.longest, or "
                'read it with [record] gaps = "longest"'
            )
        start = perf_counter()
        u, y = signal(problem, self.input), signal(problem, self.output)
        level = float(y[0]) if self.offset or self.integrators else 0.0  # which those absorb
        model, system, n_iter, converged = self.iterate(u, y - level, problem)
        if not converged:
            warnings.warn(
                f"{self.key} has not converged in {n_iter} iterations; take fewer poles and zeros",
                ConvergenceWarning,
                stacklevel=2,
            )
        simulated = level + self.run(model, u, y - level, problem.record.dt)
        return TransferFunctionResults.of(
            self, model, y, simulated, system, problem,
            n_iter=n_iter, converged=converged, runtime=perf_counter() - start,
        )  # fmt: skip

    def run(self, model: Model, u: Array, y: Array, dt: float) -> Array:
        """Return the free-running output (n_samples,) of a model that began as y did."""
        if self.initial == "rest":
            return model.respond(u, dt, self.hold)
        return model.settled_on(u, y, dt, self.hold)

    def iterate(self, u: Array, y: Array, problem: Problem) -> tuple[Model, System, int, bool]:
        """Return the model, the system that it solves, the iterations and whether they met."""
        dt = problem.record.dt
        model = self._start(u, y, dt)
        for n_iter in range(1, self.max_iter + 1):  # noqa: B007
            X, target = self._rows(u, y, model, dt)  # (N, p), (N,)
            Z, _ = self._rows(*self.noise_free(model, u, problem), model, dt)  # (N, p)
            if n_iter <= _SETTLING:
                whiten = self._whitener(model, u, y, dt)
            system = System(whiten(X), whiten(target), whiten(Z))
            old, theta = self.coefficients(model), solve_iv(*system)
            near = not self._moves or abs(theta[len(self.names) - 1]) <= _KINK * dt
            if self._moves:
                theta[len(self.names) - 1] *= 0.5 ** max(n_iter - _SETTLING, 0)
            model = self._model(theta, dt, model)
            new = self.coefficients(model)
            weight = np.linalg.norm(system.X[:, : len(new)], axis=0)  # (p,)
            change = np.linalg.norm(weight * (new - old)) / np.linalg.norm(weight * new)
            if near and change <= self.tol:
                return model, system, n_iter, True
        return model, system, self.max_iter, False

    def noise_free(self, model: Model, u: Array, problem: Problem) -> tuple[Array, Array]:
        """Return input and output of the last model: what the instruments are made of."""
        return u, model.respond(u, problem.record.dt, self.hold)

    def _whitener(self, model: Model, u: Array, y: Array, dt: float) -> Callable[[Array], Array]:
        """Return what makes the error of the rows white: nothing, the output error is taken so."""
        return lambda columns: columns

    def _start(self, u: Array, y: Array, dt: float) -> Model:
        """Return the best of several state-variable-filter estimates, by its simulation."""
        if self.start is not None:
            theta = np.asarray(self.start, dtype=float)
            delay = float(theta[-1]) if self.delay == "estimate" else 0.0
            return self._model(theta, dt, Model(np.ones(1), np.ones(1), delay=delay))
        if self.delay != "estimate":
            return self._first(u, y, dt, float(self.delay))
        late = self._coarsely(u, y, dt)
        if self._moves:
            return self._first(u, y, dt, dt * late)
        near = [self._first(u, y, dt, dt * k) for k in range(max(late - 2, 0), late + 3)]
        models = [self._iterated(model, u, y, dt) for model in near]
        return min(models, key=lambda model: self._misfit(model, u, y, dt))

    def _coarsely(self, u: Array, y: Array, dt: float) -> int:
        """Return the delay in samples whose first estimate simulates best: a grid, then halving."""
        most = max(int(_LATEST * len(y)), 2)
        tried: dict[int, float] = {}
        candidates = {0, *np.geomspace(1.0, most, 12).astype(int).tolist()}
        while candidates:
            for late in candidates:
                tried[late] = self._misfit(self._first(u, y, dt, dt * late), u, y, dt)
            known, best = sorted(tried), min(tried, key=tried.__getitem__)
            k = known.index(best)
            beside = known[max(k - 1, 0)], known[min(k + 1, len(known) - 1)]
            candidates = {(best + other) // 2 for other in beside} - set(known)
        return best

    def _iterated(self, model: Model, u: Array, y: Array, dt: float, count: int = 5) -> Model:
        """Return a model after some steps without a noise model."""
        for _ in range(count):
            X, target = self._rows(u, y, model, dt)
            Z, _ = self._rows(u, model.respond(u, dt, self.hold), model, dt)
            model = self._model(solve_iv(X, target, Z), dt, model)
        return model

    def _first(self, u: Array, y: Array, dt: float, delay: float) -> Model:
        """Return the best of several state-variable-filter estimates, by its simulation."""
        models = []
        for speed in np.geomspace(2.0, 0.2 / dt, 7):  # rad/s
            F = np.asarray(np.poly(np.full(self.poles, -speed)), dtype=float)
            model = Model(F, np.zeros(self.zeros + 1), delay=delay)
            X, target = self._rows(u, y, model, dt)
            used = [i for i, name in enumerate(self._columns) if name != "delay"]
            theta = np.zeros(len(self._columns))
            theta[used] = solve_iv(X[:, used], target)
            models.append(self._model(theta, dt, model))
        return min(models, key=lambda model: self._misfit(model, u, y, dt))

    def _misfit(self, model: Model, u: Array, y: Array, dt: float) -> float:
        return float(np.linalg.norm(y - model.respond(u, dt, self.hold)))

    def _rows(self, u: Array, y: Array, model: Model, dt: float) -> tuple[Array, Array]:
        """Return X (N, p) and target (N,) of s^n y = -a s^(n-1) y ... + b s^m u ... + offset.

        Filtered by 1/A of a model, so that a white output error stays white from the first sample.
        """
        n, m, k, F = self.poles, self.zeros, self.integrators, model.A
        straight: Hold = "euler" if self.hold == "euler" else "foh"
        Y, U = derivatives(y, F, dt, straight), derivatives(u, F, dt, self.hold, model.delay)
        columns = [-Y[:, n - 1 : k - 1 if k else None : -1][:, : n - k], U[:, m::-1][:, : m + 1]]
        if self.offset:
            columns.append(derivatives(np.ones(len(y)), F, dt, held(self.hold))[:, :1])
        if self._moves:
            columns.append(model.lateness(u, F, dt, self.hold)[:, np.newaxis])
        if self.initial == "estimate":
            columns.append(free_response(F, len(y), dt, self.hold))
        return np.hstack(columns), Y[:, n]

    def _model(self, theta: Array, dt: float, last: Model) -> Model:
        """Return the model of a solution, unstable roots reflected."""
        values = dict(zip(self._columns, theta.tolist(), strict=False))
        free = self.poles - self.integrators
        A = self._stable(np.concatenate([[1.0], theta[:free]]), dt)
        A = np.concatenate([A, np.zeros(self.integrators)])
        B = theta[free : free + self.zeros + 1]
        moved = float(np.clip(values.get("delay", 0.0), -dt, dt)) if last.B.any() else 0.0
        initial = theta[len(self.names) :]
        return Model(A, B, values.get("offset", 0.0), initial, max(last.delay + moved, 0.0))

    def _stable(self, A: Array, dt: float) -> Array:
        """Return A with unstable roots reflected."""
        return reflect_delta(A, dt) if self.hold == "euler" else reflect(A)

    def coefficients(self, model: Model) -> Array:
        """Return the free coefficients (p,) of a model, in the order of `names`."""
        free = self.poles - self.integrators
        offset, delay = [model.offset] * self.offset, [model.delay] * self._moves
        return np.concatenate([model.A[1 : free + 1], model.B, offset, delay])

    @property
    def _moves(self) -> bool:
        """Whether the delay is a parameter that changes continuously."""
        return isinstance(self.delay, str) and self.hold != "euler"

    @property
    def _columns(self) -> tuple[str, ...]:
        """Names of the columns: the coefficients, and the initial conditions."""
        count = self.poles if self.initial == "estimate" else 0
        return (*self.names, *(f"c{i}" for i in range(count)))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free coefficients: a1 ..., b0 ..., offset, delay."""
        a = [f"a{i + 1}" for i in range(self.poles - self.integrators)]
        b = [f"b{i}" for i in range(self.zeros + 1)]
        return (*a, *b, *["offset"] * self.offset, *["delay"] * self._moves)


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
