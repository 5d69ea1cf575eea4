"""Fit: Gauss-Newton on the whitened simulated-command error.

The sensitivities come from simulations that are driven by the noise-free reference, so they act
as instruments: the estimate is consistent in closed loop.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, minimize

from ..limits import LARGEST
from ..linalg import as_columns, block_covariance, independent, orthonormal, rms
from ..loop import ClosedLoop, Simulation
from ..physics import Term
from ..problem import Problem
from ..record import Record
from ..workers import still_wanted, threaded
from .fold import Fold
from .response import denoised
from .rules import (
    AGAIN,
    CONVERGED,
    DEPENDENT,
    JACOBIANS,
    KEEP_JACOBIAN,
    NARROW,
    REACH,
    SHORTER,
    SIMPLEX,
    SIMPLEX_TRIES,
    STEP,
    STIFF,
    UNSHOWN,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Simulated:
    """A model that is simulated on a fold: where a descent stands.

    Parameters
    ----------
    fold : Fold
    loop : ClosedLoop
    values : mapping
        Value of every parameter.
    e : ndarray, (n_kept,)
        Whitened error.
    """

    fold: Fold
    loop: ClosedLoop
    values: dict[str, float]
    e: Array

    @classmethod
    def at(cls, fold: Fold, loop: ClosedLoop, values: dict[str, float]) -> Simulated:
        """Return a loop simulated at these values."""
        simulation = fold.simulate(loop, values)
        found = cls(fold, loop, values, fold.judged(loop, simulation))
        vars(found)["simulation"] = simulation  # it need not be made again
        return found

    @cached_property
    def simulation(self) -> Simulation:
        """The loop at these values."""
        return self.fold.simulate(self.loop, self.values)

    @cached_property
    def denoised(self) -> Simulation:
        """The simulation as laws of the state see it.

        The noise of a recorded command that drives it is the controller's answer to that of the
        encoder, which makes the error too: laws of it would explain the noise.
        """
        return denoised(self.simulation) if self.fold.driven else self.simulation

    @property
    def energy(self) -> float:
        """Sum of squares of the whitened error."""
        return float(self.e @ self.e)

    @property
    def rigid(self) -> bool:
        """Whether the model has no second mass: the linear response is that of a rigid joint."""
        return not any(t.second_mass for t in self.loop.terms)

    def jacobian(
        self, free: Sequence[str], step: Mapping[str, float], near: Fit | None = None
    ) -> Array:
        """Return the derivative of the whitened error, (n_kept, n_free).

        A parameter of a force law acts through its force along the simulated trajectory and the
        loop's linear response; one that changes the structure is simulated once more, and so is
        every one where a robot's link is behind a second mass: the response is that of a rigid
        joint. What a fit `near` by knows is taken from there.
        """
        fold, loop = self.fold, self.loop
        rigid = fold.link is None or self.rigid
        owner = {n: t for t in loop.terms for n in t.names}
        forces, J = {}, np.empty((len(self.e), len(free)))
        known = () if near is None else near.free
        for column, name in enumerate(free):
            term = owner[name]
            if near is not None and name in known:
                J[:, column] = near.J[:, known.index(name)]
            elif rigid and term.law is not None:
                forces[column] = _law_change(term, name, self.values, step[name], self.simulation)

        def simulated(name: str) -> Array:
            """Return the derivative by one parameter, from one more simulation."""
            at_top = self.values[name] + step[name] > self.largest(name)
            change = -step[name] if at_top else step[name]
            moved = {**self.values, name: self.values[name] + change}
            return (fold.error(loop, moved) - self.e) / change

        others = [k for k, name in enumerate(free) if k not in forces and name not in known]
        slopes = threaded(simulated, [free[k] for k in others])
        for column, slope in zip(others, slopes, strict=True):
            J[:, column] = slope
        if forces:
            J[:, list(forces)] = fold.answers(as_columns(forces.values()))
        return J

    def answers(self, forces: Array) -> Array:
        """Return the change of the whitened error by forces in the columns, (n_kept, m).

        Where the linear response is not the model's each is simulated.
        """
        fold = self.fold
        if self.rigid:
            return fold.answers(forces)
        natural = STEP * fold.scales.sizes["force"]

        def simulated(force: Array) -> Array:
            """Return what one does, from a little of it."""
            size = natural / max(rms(force), 1e-300)
            more = size * force + (0.0 if fold.against is None else fold.against)
            then = replace(fold, against=more).simulate(self.loop, self.values)
            return (fold.judged(self.loop, then) - self.e) / size

        return as_columns(threaded(simulated, forces.T))

    def move(self, free: Sequence[str], J: Array, units: Array) -> Array:
        """Return the Gauss-Newton step, (n_free,), in which none leaves a bound that it is at.

        The others are solved for without it: cut off afterwards, its part of the step would leave
        them with what it should have balanced.

        J. Nocedal, S. J. Wright, *Numerical Optimization*, 2nd ed., 2006, section 16.7.
        """
        low = np.array([self.loop.parameters[n].lower for n in free])
        high = np.array([self.largest(n) for n in free])
        at = np.array([self.values[n] for n in free])
        inside, move = np.ones(len(free), dtype=bool), np.zeros(len(free))
        for _ in free:
            move[:] = 0.0
            some = units[inside]  # damped in directions that the record does not show
            move[inside] = -some * normal(J[:, inside] * some, self.e)
            leaves = inside & (((at <= low) & (move < 0.0)) | ((at >= high) & (move > 0.0)))
            if not leaves.any():
                break
            inside &= ~leaves
        return move

    def lower(self, free: Sequence[str], move: Array) -> Simulated | None:
        """Return where a step, shortened until the error falls, leads to; None if it never does."""
        for factor in SHORTER:
            values = {**self.values}
            for name, change in zip(free, move, strict=True):
                values[name] = self.moved(name, factor * change)
            then = Simulated.at(self.fold, self.loop, heavy_enough(self.fold, self.loop, values))
            if then.energy < self.energy:
                return then
            if factor == 1.0 and then.energy < (1.0 + CONVERGED) * self.energy:
                break
        return None

    def moved(self, name: str, change: float) -> float:
        """Return a parameter moved within its bounds; one that must be positive by a factor."""
        p, value = self.loop.parameters[name], self.values[name]
        new = value + change
        if name == "inertia" or (not p.linear and p.lower >= 0.0 and value > 0.0):
            new = float(np.clip(new, value / REACH, value * REACH))
        largest = min(self.largest(name), LARGEST)  # an absurd step diverges, and is shortened
        return float(np.clip(new, max(p.lower, -LARGEST), largest))

    def largest(self, name: str) -> float:
        """Return the largest value of a parameter: what is stiffer is not told from it."""
        p = self.loop.parameters[name]
        return min(p.upper, STIFF * p.rigid / self.fold.record.dt)


@dataclass(frozen=True, eq=False)
class Fit(Simulated):
    """Values that make a loop reproduce the command of a fold.

    Parameters
    ----------
    free : tuple of str
        Parameters that were fitted.
    J : ndarray, (n_kept, n_free)
        Derivative of `e`.
    """

    free: tuple[str, ...]
    J: Array

    @property
    def cost(self) -> float:
        """Mean square of the whitened error; 1 is the floor."""
        return float(self.e @ self.e) / len(self.e)

    @cached_property
    def basis(self) -> Array:
        """What the free parameters can do to the error, (n_kept, n_free), orthonormal."""
        return orthonormal(self.J)

    @property
    def whole_error(self) -> Array:
        """Measured less simulated force, N or N m, (n_samples,)."""
        return self.fold.likeliest(self.loop, self.simulation)

    @cached_property
    def force_error(self) -> Array:
        """That of the samples that count, (n_kept,)."""
        return self.whole_error[self.fold.keep]

    def beyond_base(self, columns: Array | None = None) -> Array:
        """Return what the free parameters cannot imitate of whitened columns, or of the error.

        (n_kept,) or (n_kept, m).
        """
        x = self.e if columns is None else columns
        return np.asarray(x - self.basis @ (self.basis.T @ x))

    @property
    def force_rms(self) -> float:
        """Force error, N or N m rms; inf if the loop diverges."""
        return rms(self.force_error)

    @property
    def common(self) -> Fit:
        """The same model, fitted where the fold that it is compared with has been as well.

        What a law over position does elsewhere, the other record cannot say: a parabola that fits
        a stroke goes far astray beyond it, and an effect that is there would not replicate.
        """
        return self if self.fold.both is None else self._common  # one that kept itself would stay

    @cached_property
    def _common(self) -> Fit:
        """That of a fold which has been elsewhere."""
        return self.refit(self.fold.common, iterations=AGAIN)

    def refit(
        self,
        fold: Fold | None = None,
        values: Mapping[str, float] | None = None,
        free: Sequence[str] | None = None,
        iterations: int = JACOBIANS,
        near: Fit | None = None,
        narrow: Collection[str] = (),
    ) -> Fit:
        """Return the model fitted again; what is not given is as it was.

        Parameters
        ----------
        fold : Fold, optional
            Another one.
        values : mapping, optional
            Starting values of some of the parameters; the others start where they are.
        free : sequence of str, optional
            Names of those that are fitted.
        iterations, near, narrow
            As for `gauss_newton`.
        """
        fold = self.fold if fold is None else fold
        free = self.free if free is None else free
        start = {**self.values, **(values or {})}
        return gauss_newton(fold, self.loop, start, free, iterations, near, narrow)

    @cached_property
    def inverse(self) -> Inverse:
        """The inverse model of the fold's record."""
        return Inverse.of(self.fold.record, self.loop)

    @cached_property
    def _covariances(self) -> tuple[Array, Array]:
        """Covariances of the free parameters, as white noise and as blocks have it, (p, p).

        NaN of one that changes nothing.
        """
        scale = np.maximum(np.linalg.norm(self.J, axis=0), 1e-300)
        J = self.J / scale
        bread = np.linalg.pinv(J.T @ J, rcond=DEPENDENT)
        meat = block_covariance(J * self.e[:, None], self.fold.blocks)
        unit = np.outer(scale, scale)
        with np.errstate(invalid="ignore"):
            return self.cost * bread / unit, bread @ meat @ bread / unit

    @cached_property
    def _hidden(self) -> Array:
        """Share of each free parameter that lies in directions without an effect, (p,)."""
        J = self.J / np.maximum(np.linalg.norm(self.J, axis=0), 1e-300)
        size, turn = np.linalg.eigh(J.T @ J)
        return np.asarray(np.sum(turn[:, size < DEPENDENT * size[-1]] ** 2, axis=1))

    def deviation(self, names: Sequence[str]) -> float:
        """Return the standard error of a sum of free parameters.

        Blocks see noise that the whitening has not made white, but they are few and their scores
        are too small, for the fit has turned towards each of them; so the larger of both counts.
        NaN if the record does not show one of them.

        Parameters
        ----------
        names : sequence of str
            Those that are not free are known.
        """
        where = [self.free.index(name) for name in names if name in self.free]
        if np.max(self._hidden[where], initial=0.0) > UNSHOWN:
            return float("nan")
        few = len(self.fold.blocks) / max(len(self.fold.blocks) - len(self.free), 1)
        white, robust = (float(C[np.ix_(where, where)].sum()) for C in self._covariances)
        return float(np.sqrt(max(white, few * robust, 0.0)))


def of_effect(values: Mapping[str, float], effect: str) -> dict[str, float]:
    """Return the parameters of an effect by short name, of those of a model."""
    return {n.partition(".")[2]: v for n, v in values.items() if n.startswith(f"{effect}.")}


def steps(fold: Fold, loop: ClosedLoop, narrow: Collection[str] = ()) -> dict[str, float]:
    """Return the finite-difference step of every parameter, narrower of those in `narrow`."""
    out, scales = {}, fold.scales
    for term in loop.terms:
        shape = {p.name: loop.start.get(n, p.neutral) for n, p in term.by_name.items()}
        for i, (name, p) in enumerate(term.by_name.items()):
            size = scales.natural(term, i, shape)
            if not p.linear:
                size = abs(shape[p.name]) or size
            if term.search == "lines":
                if not p.linear:  # what turns the phase along the stroke
                    size *= min(size / scales.sizes["stroke"], 1.0)
                elif term.law is None:  # a larger wave folds the encoder over
                    size = shape[term.period] / (2.0 * np.pi)
            out[name] = STEP * size * (NARROW if name in narrow else 1.0)
    return out


def _law_change(
    term: Term, name: str, values: Mapping[str, float], step: float, simulation: Simulation
) -> Array:
    """Return the derivative of a force law along a simulated trajectory, (n_samples,).

    Not finite where the simulation has diverged.
    """
    q, dq, ddq = simulation.where, simulation.dq[:, 0], simulation.ddq[:, 0]
    more = (simulation.tau[:, 0], simulation.t - simulation.t[0])
    now, then = ([values[n] + step * (n == name) * on for n in term.names] for on in (0, 1))
    with np.errstate(invalid="ignore", over="ignore"):
        return (term.force(q, dq, ddq, then, *more) - term.force(q, dq, ddq, now, *more)) / step


def costs(fits: Sequence[Fit]) -> Array:
    """Return the mean square of the whitened error of each fit, (n_fits,)."""
    return np.array([f.cost for f in fits])


def cost(fits: Sequence[Fit]) -> float:
    """Return the mean square of the whitened error, mean of the folds."""
    return float(np.mean(costs(fits)))


def common(fits: Sequence[Fit]) -> tuple[Fit, ...]:
    """Return fits, one on each fold, on what both of these have in common."""
    return tuple(f.common for f in fits)


def gauss_newton(
    fold: Fold,
    loop: ClosedLoop,
    values: Mapping[str, float],
    free: Sequence[str],
    iterations: int = JACOBIANS,
    near: Fit | None = None,
    narrow: Collection[str] = (),
) -> Fit:
    """Minimise the whitened simulated-command error over the free parameters.

    Parameters
    ----------
    fold, loop
        What is compared.
    values : mapping
        Starting values of all parameters.
    free : sequence of str
        Names of those that are fitted.
    iterations : int
        At most so many Jacobians.
    near : Fit, optional
        On the same samples, near by: its Jacobian serves the first step.
    narrow : collection of str
        Parameters whose finite differences are narrow.

    Returns
    -------
    Fit
    """
    free = tuple(free)
    at = Simulated.at(fold, loop, heavy_enough(fold, loop, dict(values)))
    J = np.zeros((len(at.e), len(free)))
    if not at.simulation.finite:  # nothing to descend on: its cost says so
        return Fit(fold, loop, at.values, at.e, free, J)
    step = steps(fold, loop, narrow)
    units = np.array([step[n] for n in free])
    J = at.jacobian(free, step, near)
    for _ in range(iterations):
        then = at.lower(free, at.move(free, J, units))
        if then is None:
            break
        gain = 1.0 - then.energy / at.energy
        at = then
        if gain < CONVERGED:
            break
        if gain > KEEP_JACOBIAN:
            J = at.jacobian(free, step)
    return Fit(fold, loop, at.values, at.e, free, J)


def without_slopes(fit: Fit, narrow: Collection[str] = ()) -> Fit:
    """Return a fit that goes on from there without slopes, in all that is free and is not 0.

    Parameters
    ----------
    fit : Fit
    narrow : collection of str, optional
        Parameters whose finite differences are narrow, in the step that ends it.

    References
    ----------
    J. A. Nelder, R. Mead, The Computer Journal 7(4), 1965, with the coefficients of F. Gao, L. Han,
    Computational Optimization and Applications 51(1), 2012, for many parameters.
    """
    fold, names = fit.fold, [n for n in fit.free if fit.values[n]]
    if not names:
        return fit
    begin = np.array([fit.values[n] for n in names])
    known = [(fit.loop.parameters[n].lower, fit.largest(n)) for n in names]
    limits = np.sort([(low / x, high / x) for (low, high), x in zip(known, begin, strict=True)])

    def values(x: Array) -> dict[str, float]:
        """Return the parameters of the model at sizes relative to those where it began."""
        return {**fit.values, **dict(zip(names, (x * begin).tolist(), strict=True))}

    def left(x: Array) -> float:
        """Return the mean square of the whitened error."""
        still_wanted()
        e = fold.error(fit.loop, heavy_enough(fold, fit.loop, values(x)))
        size = float(e @ e) / len(e)
        return size if np.isfinite(size) else np.inf

    corners = 1.0 + np.vstack([np.zeros(len(begin)), SIMPLEX * np.eye(len(begin))])
    found = minimize(
        left,
        corners[0],
        method="Nelder-Mead",
        bounds=Bounds(*limits.T),
        options={"initial_simplex": corners, "adaptive": True, "maxfev": SIMPLEX_TRIES},
    )
    better = found.fun < fit.cost
    return fit.refit(values=values(found.x), iterations=1, narrow=narrow) if better else fit


def normal(A: Array, b: Array) -> Array:
    """Return the least-squares solution of few columns A (n, m), of whatever sizes.

    `b` is one signal (n,) or several (n, k); so is the solution, (m,) or (m, k).

    By their normal equations. Directions whose energy, of columns of unit length, is below
    `DEPENDENT` times the largest stay at zero; squaring the condition number costs nothing that
    would matter then. Columns that are not finite, of a loop that diverged, give zeros.
    """
    if not (np.isfinite(A).all() and np.isfinite(b).all()):
        return np.zeros((A.shape[1], *b.shape[1:]))
    alone = independent(A, DEPENDENT)
    return alone @ (alone.T @ (A.T @ b))


def heavy_enough(fold: Fold, loop: ClosedLoop, values: dict[str, float]) -> dict[str, float]:
    """Return values with which a robot's link has some inertia left in its lightest pose.

    These very values, if it has.
    """
    shares = [n for n in loop.parameters if n.endswith(".load_share") and values[n] > 0.0]
    link = values["inertia"] * (values[shares[0]] if shares else 1.0)
    if link >= fold.least_link:
        return values
    name, more = shares[0] if shares else "inertia", fold.least_link / link
    return {**values, name: min(values[name] * more, loop.parameters[name].upper)}


@dataclass(frozen=True, eq=False)
class Inverse:
    """The inverse model of a record: what of the force the measured motion explains.

    Parameters
    ----------
    problem : Problem
    """

    problem: Problem

    @classmethod
    def of(cls, record: Record, loop: ClosedLoop) -> Inverse:
        """Return that of a record."""
        return cls(Problem(record, loop, loop.pipeline(record, "record")))

    def values(
        self, term: Term | None = None, point: Mapping[str, float] | None = None
    ) -> dict[str, float]:
        """Return the parameters by least squares, with what an effect takes of the force."""
        loop, problem = self.problem.loop, self.problem
        y = problem.y if term is None else self._force(term, point or {})
        theta = normal(problem.X, y)  # beside what is in the model, columns may be dependent
        found = dict(zip(problem.names, theta.tolist(), strict=True))
        for name, p in loop.parameters.items():
            if name in found:
                found[name] = float(np.clip(found[name], p.lower, p.upper))
        return dict(loop.values(found))

    def left(self, term: Term, point: Mapping[str, float]) -> float:
        """Return the share that no acceleration explains of what the other terms leave of a force.

        Of the measured force, less what an effect takes; 1 where they leave nothing: a drive that
        delivered less than the dry friction would leave nothing of any motion, and move nothing.
        """
        y = self._force(term, point)
        basis, weight = self._basis
        rest = y - basis @ (basis.T @ y)
        energy = float(rest @ rest)
        rest = rest - weight * float(weight @ rest)
        return float(rest @ rest) / energy if energy > DEPENDENT * float(y @ y) else 1.0

    @cached_property
    def _basis(self) -> tuple[Array, Array]:
        """What all but the inertia makes, orthonormal, and what the inertia makes beside it."""
        own = np.array([name == "inertia" for name in self.problem.names])
        others, weight = orthonormal(self.problem.X[:, ~own]), self.problem.X[:, own].sum(axis=1)
        weight = weight - others @ (others.T @ weight)
        return others, weight / max(float(np.linalg.norm(weight)), 1e-300)

    def _force(self, term: Term, point: Mapping[str, float]) -> Array:
        """Return the rows of the force less what an effect takes of it, N or N m."""
        record, motion = self.problem.record, self.problem.motion
        shape = [point.get(p.name, p.neutral) for p in term.parameters]
        q, dq, ddq = motion.q[:, 0], motion.dq[:, 0], motion.ddq[:, 0]
        tau = self.problem.loop.force(record)[:, 0]
        taken = term.force(q, dq, ddq, shape, tau, record.t - record.t[0])
        pipeline = self.problem.pipeline
        return (
            self.problem.y - pipeline.rows(pipeline.align(taken[:, None]), self.problem.speed)[:, 0]
        )
