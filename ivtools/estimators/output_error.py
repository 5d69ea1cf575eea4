"""Output error: the motion of the simulated axis against the measured one (CLOE, OLOE)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from ivtools.estimators.sensitivities import Signal
from ivtools.estimators.simulated_error import SimulatedError

if TYPE_CHECKING:
    from ivtools.problem import Problem


@dataclass(frozen=True)
class CLOE(SimulatedError):
    """Closed-loop output error: nonlinear least squares on the simulated position.

    The controller hides most of what the parameters do to the position, so it takes a good
    encoder; the force (`CLIE`) shows the same parameters in the open.

    Parameters
    ----------
    cov_type, signal, parameters, start, starts, spread, tol, max_iter, n_jobs, step
        As for `SimulatedError`; the signal is the position or the velocity.

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

    signal: Signal = "position"


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

    signal: Signal = "position"
    starts: int = 3
    spread: float = 0.05

    def compared(self, problem: Problem) -> Problem:
        """Return the axis without its controller, starting at rest."""
        return open_loop(problem)


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
