"""Sensitivities: how the signals of the simulated loop depend on its parameters.

Forward differences, one simulation per parameter. The compiled loop runs without Python's lock,
so the simulations of one Jacobian share the cores as threads.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import EstimationError
from ivtools.physics.sizes import sizes

if TYPE_CHECKING:
    from ivtools.loop import Simulation
    from ivtools.physics import Parameter
    from ivtools.problem import Problem

Array = NDArray[np.float64]
Signal = Literal["force", "position", "velocity"]

STEP = 1e-4  # finite difference, in sizes of a parameter


@dataclass(frozen=True, eq=False)
class SimulatedSignal:
    """One signal of the loop of a problem as a function of some of its parameters.

    Measured and simulated signals take the same way through the pipeline.

    Parameters
    ----------
    problem : Problem
    free : sequence of str
        Names of the parameters that vary, p of them.
    held : mapping
        Values of the others, by name.
    signal : {"force", "position", "velocity"}
    n_jobs : int
        Threads.
    step : float
        Finite difference, in sizes of a parameter.

    Examples
    --------
    >>> import ivtools as iv
    >>> problem = iv.Problem(iv.datasets.twin(), iv.axes.emps())
    >>> force = SimulatedSignal(problem, problem.names, {})
    >>> force.sensitivities(np.array([95.0, 200.0, 20.0, 0.0]))[1].shape == problem.X.shape
    True
    """

    problem: Problem
    free: Sequence[str]
    held: Mapping[str, float]
    signal: Signal = "force"
    n_jobs: int = 1
    step: float = STEP

    def __post_init__(self) -> None:
        """Refuse names that the loop does not know."""
        if self.signal not in get_args(Signal):
            raise EstimationError(f"signal = {self.signal!r} is none of {get_args(Signal)}")
        unknown = [name for name in self.free if name not in self.problem.loop.parameters]
        if unknown:
            known = ", ".join(self.problem.loop.parameters)
            raise EstimationError(
                f"{unknown[0]!r} is not a parameter of the loop, whose are {known}"
            )

    @cached_property
    def measured(self) -> Array:
        """The measured signal, (N,), N or N m, m or rad, m/s or rad/s."""
        if self.signal == "force":
            return self.problem.y
        motion = self.problem.motion
        return self._rows(motion.q if self.signal == "position" else motion.dq)[:, 0]

    def __call__(self, theta: Array) -> Array:
        """Return the simulated signal at theta (p,), (N,); NaN where the loop is unstable."""
        return self._simulated([theta])[:, 0]

    def sensitivities(self, theta: Array) -> tuple[Array, Array]:
        """Return the simulated signal (N,) and its derivative by theta, (N, p)."""
        step = np.diag(self._steps(theta))  # (p, p)
        signals = self._simulated([theta, *(theta + step)])  # (N, 1 + p)
        return signals[:, 0], (signals[:, 1:] - signals[:, :1]) / np.diag(step)

    def by_start(self, theta: Array) -> Array:
        """Return how the signal depends on the command with which the record begins, (N,).

        It tells the controller's own state at the start, which an integrator keeps.
        """
        problem = self.problem
        record, command = problem.record, problem.loop.command(problem.record)
        shift = self.step * float(np.max(np.abs(command)))
        begun = replace(self, problem=replace(problem, record=replace(record, nu=command + shift)))
        change: Array = begun(theta) - self(theta)
        return change / shift if shift > 0.0 else change

    @cached_property
    def sizes(self) -> Array:
        """The value of each parameter that would be noticed, SI, (p,)."""
        X, force = self.problem.X, np.linalg.norm(self.problem.y)
        columns = dict(zip(self.problem.names, np.linalg.norm(X, axis=0), strict=True))
        shapes = scales(self.problem)
        return np.array(
            [
                force / columns[name] if columns.get(name) else natural(parameter, shapes)
                for name, parameter in self._parameters.items()
            ]
        )

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds, (p,), of the parameters that the force is not linear in."""
        p = {n: p for n, p in self._parameters.items() if n == "inertia" or not p.linear}
        lower = [p[name].lower if name in p else -np.inf for name in self.free]
        upper = [p[name].upper if name in p else np.inf for name in self.free]
        return np.array(lower), np.array(upper)

    @property
    def _parameters(self) -> dict[str, Parameter]:
        return {name: self.problem.loop.parameters[name] for name in self.free}

    def _steps(self, theta: Array) -> Array:
        """Return the finite differences (p,), backward where forward would leave the bounds."""
        step = self.step * np.maximum(self.sizes, np.abs(theta))
        return np.where(theta + step > self.bounds[1], -step, step)

    def _simulated(self, thetas: Sequence[Array]) -> Array:
        """Return the signal at several parameter vectors as columns, (N, m)."""
        with ThreadPoolExecutor(min(self.n_jobs, len(thetas))) as pool:
            simulations = list(pool.map(self._simulate, thetas))
        name = "tau" if self.signal == "force" else "q"
        signals = np.hstack([getattr(s, name) for s in simulations])  # (n_samples, m)
        with np.errstate(all="ignore"):  # an unstable loop is reported as NaN
            return self._rows(self._conditioned(signals))

    def _conditioned(self, signals: Array) -> Array:
        pipeline, dt = self.problem.pipeline, self.problem.record.dt
        if self.signal == "force":
            return pipeline.align(signals)
        motion = pipeline.differentiate(signals, dt)
        return motion.q if self.signal == "position" else motion.dq

    def _simulate(self, theta: Array) -> Simulation:
        return self.problem.simulate({**self.held, **dict(zip(self.free, theta, strict=True))})

    def _rows(self, signals: Array) -> Array:
        problem = self.problem
        return problem.pipeline.rows(signals, problem.speed)


def scales(problem: Problem) -> dict[str, float]:
    """Return what a parameter's search values are multiples of, SI, by `Parameter.scale`.

    Those of the measured motion.
    """
    record, command = problem.record, problem.loop.command(problem.record)
    return sizes(record, record.q, problem.motion.dq, problem.force, command)


def natural(parameter: Parameter, units: Mapping[str, float]) -> float:
    """Return the size of a parameter: its scale, or the least of its search values but 0."""
    values = [x for x in parameter.scan if x > 0.0]
    return units[parameter.scale] * min(values, default=1.0)


def scans(problem: Problem, names: Sequence[str], limit: int = 60) -> Iterator[dict[str, float]]:
    """Yield starting values of the parameters that the force is not linear in.

    Of a whole loop, as it states them where it does; `gap.library.scans` has those of one effect.

    Parameters
    ----------
    problem : Problem
    names : sequence of str
        Parameters in question; those with a starting value in the loop have that one alone.
    limit : int
        At most so many combinations, evenly drawn from all.
    """
    loop, units = problem.loop, scales(problem)
    shapes = {n: p for n, p in loop.parameters.items() if n in names and not p.linear}
    grids = [
        [loop.start[n]] if n in loop.start else [x * units[p.scale] for x in p.scan]
        for n, p in shapes.items()
    ]
    points = list(product(*grids))
    for i in np.unique(np.linspace(0, len(points) - 1, min(limit, len(points))).astype(int)):
        yield dict(zip(shapes, points[i], strict=True))
