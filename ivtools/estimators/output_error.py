"""Output error: the motion of the simulated axis against the measured one (CLOE, OLOE)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ivtools.estimators.sensitivities import Signal
from ivtools.estimators.simulated_error import SimulatedError

if TYPE_CHECKING:
    from ivtools.loop import ClosedLoop
    from ivtools.problem import Problem


@dataclass(frozen=True)
class CLOE(SimulatedError):
    """Closed-loop output error: nonlinear least squares on the simulated position.

    The controller hides most of what the parameters do to the position, so it takes a good
    encoder; the force (`CLIE`) shows the same parameters in the open.

    Parameters
    ----------
    signal : {None, "position", "velocity"}
        Default: the position if the controller holds it, else the velocity. Behind a velocity
        loop the position integrates all noise.
    cov_type, parameters, start, starts, spread, tol, max_iter, n_jobs, step
        As for `SimulatedError`.

    References
    ----------
    M. Brunot, A. Janot, F. Carrillo, J. Cheong, J.-P. Noel, "Output error methods for robot
    identification", J. Dynamic Systems, Measurement and Control 142(3), 2020.

    Examples
    --------
    ::

        CLOE().fit(problem).summary()
    """

    key: ClassVar[str] = "cloe"

    signal: Signal | None = None

    def signal_of(self, problem: Problem) -> Signal:
        """Return the signal that is compared: the one that the controller holds."""
        held = holds_position(problem.loop, problem.record.dt)
        return self.signal or ("position" if held else "velocity")


@dataclass(frozen=True)
class OLOE(SimulatedError):
    """Open-loop output error: the axis alone, driven by the recorded command.

    For comparison. Nothing pulls the simulated axis back to the record: its position integrates
    every error, a small change of friction decides whether it sticks, the sum of squares has many
    minima, and the noise of the command, which the controller makes of the position's, biases it.

    Parameters
    ----------
    cov_type, signal, parameters, start, starts, spread, tol, max_iter, n_jobs, step
        As for `SimulatedError`; the signal is the position or the velocity.

    References
    ----------
    M. Brunot et al., as for `CLOE`.

    Examples
    --------
    ::

        OLOE().fit(problem).params
    """

    key: ClassVar[str] = "oloe"

    signal: Signal | None = "position"
    starts: int = 3
    spread: float = 0.05

    def compared(self, problem: Problem) -> Problem:
        """Return the axis without its controller, starting at rest."""
        return open_loop(problem)


def holds_position(loop: ClosedLoop, dt: float) -> bool:
    """Whether the controller answers a constant error of the position, and not its change alone.

    Examples
    --------
    >>> import ivtools as iv
    >>> from ivtools.loop.controllers import Controller
    >>> loop = iv.axes.emps()
    >>> speed = replace(loop, controller=Controller("p-velocity", {"kv": 1.0}))
    >>> holds_position(loop, 1e-3), holds_position(speed, 1e-3)
    (True, False)
    """
    z = np.exp(1j * np.pi * np.array([1e-6, 1e-5]))  # two frequencies far below any mode
    slow, fast = np.abs(loop.controller.law(dt).response(z))
    return bool(slow > 0.5 * fast)


def open_loop(problem: Problem) -> Problem:
    """Return a problem whose axis is driven by the recorded command, not by a controller.

    The axis starts at the first measured position, at rest: an initial velocity that is
    read from a noisy encoder makes the open loop drift.

    Examples
    --------
    >>> import ivtools as iv
    >>> record = iv.datasets.twin()
    >>> problem = open_loop(iv.Problem(record, iv.axes.emps()))
    >>> sim = problem.simulate({"inertia": 95, "viscous": 200, "coulomb": 20, "offset": 0})
    >>> bool((sim.nu == record.nu).all())
    True
    """
    from ivtools.loop.controllers import Controller

    return replace(
        problem,
        loop=replace(problem.loop, controller=Controller("none", {})),
        simulation={"initial": (float(problem.record.q[0, 0]), 0.0), **problem.simulation},
    )
