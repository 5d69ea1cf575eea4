"""What a simulated loop did, and how far it is from what was measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..columns import column_name
from ..display import Displayed
from ..errors import RecordError, ShapeError
from ..limits import LARGEST
from ..pipeline import Motion, Pipeline
from ..pipelines import Pipelines
from ..record import Record
from ..tables import Text, table
from ..units import JOINTS, quantity

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .closed_loop import ClosedLoop
    from .model import Theta
    from .robot_loop import RobotLoop

Array = NDArray[np.float64]

LOST = 20.0  # % of the position; a loop that follows stays below 1 %


@dataclass(frozen=True, eq=False, repr=False)
class Simulation(Displayed):
    """Signals of a simulated closed loop.

    Parameters
    ----------
    t : ndarray, (n_samples,)
        Time, s.
    q, dq, ddq : ndarray, (n_samples, n_joints)
        Position as the encoder reports it, velocity and acceleration of the motor; m or rad.
    nu : ndarray, (n_samples, n_joints)
        Command, added input included.
    tau : ndarray, (n_samples, n_joints)
        Force that belongs to the command, drive gain times nu, N or N m.
    loop : ClosedLoop or RobotLoop
        The loop that was simulated.
    breaks : tuple of int
        Samples at which it began anew, as `Record.breaks`.
    place : ndarray, (n_samples,), optional
        The positions at which forces that depend on the position acted.
    """

    content: ClassVar[tuple[str, ...]] = ("t", "q", "dq", "ddq", "nu", "tau")
    figure: ClassVar[str] = "simulation"

    t: Array
    q: Array
    dq: Array
    ddq: Array
    nu: Array
    tau: Array
    loop: ClosedLoop | RobotLoop
    breaks: tuple[int, ...] = ()
    place: Array | None = None

    @property
    def where(self) -> Array:
        """Where forces that depend on the position acted, m or rad, (n_samples,)."""
        return self.q[:, 0] if self.place is None else self.place

    @property
    def motion(self) -> Motion:
        """Position, velocity and acceleration."""
        return Motion(self.q, self.dq, self.ddq)

    @property
    def finite(self) -> bool:
        """Whether the simulated loop stayed finite, and its squares are numbers still."""
        last = np.abs([*self.nu[-1], *self.q[-1]])
        return bool((last <= LARGEST).all())

    def relative_error(
        self, record: Record, pipeline: Pipeline | Pipelines | None = None
    ) -> dict[str, float]:
        """Return 100 ||measured - simulated|| / ||measured||, in per cent.

        The measured position is band-passed by the pipeline, whose trimmed samples do not count;
        the simulated signals are exact and stay as they are (equation 11 of the EMPS report).

        Parameters
        ----------
        record : Record
            The measured record.
        pipeline : Pipeline, optional
            Default: the one that the loop's bandwidth asks for.

        Returns
        -------
        dict
            Keys ``position``, ``velocity``, ``acceleration``, ``force``.

        Raises
        ------
        ShapeError
            If record and simulation differ in length.
        """
        if record.n_samples != len(self.t):
            raise ShapeError(
                f"the record has {record.n_samples} samples and the simulation {len(self.t)}; "
                "compare a simulation with the record that drove it"
            )
        pipeline = (pipeline or self.loop.pipeline(record)).broken(record.breaks)
        rows = pipeline.inside(record.n_samples)
        measured = (
            *pipeline.differentiate(record.q, record.dt),
            self.loop.force(record),
        )
        simulated = (*self.motion, self.tau)
        names = ("position", "velocity", "acceleration", "force")
        return {
            name: 100.0 * float(np.linalg.norm(m[rows] - s[rows]) / np.linalg.norm(m[rows]))
            for name, m, s in zip(names, measured, simulated, strict=True)
        }

    def joint(self, j: int, record: Record) -> Simulation:
        """Return what one joint of a robot did, counted from 0, as the simulation of its axis.

        Parameters
        ----------
        j : int
        record : Record
            The robot's, which drove the simulation.
        """
        signals = (self.q, self.dq, self.ddq, self.nu, self.tau)
        q, dq, ddq, nu, tau = (x[:, j : j + 1] for x in signals)
        return Simulation(self.t, q, dq, ddq, nu, tau, self.loop.axis(j, record))

    def to_record(
        self,
        name: str = "simulation",
        theta_true: dict[str, float] | None = None,
        q_ref: Array | None = None,
        added: Array | None = None,
    ) -> Record:
        """Return the simulated signals as a record, as if they had been measured.

        Raises
        ------
        RecordError
            If the simulated loop diverged.
        """
        if not self.finite:
            raise RecordError("the simulated loop is unstable; check the gains and the inertia")
        return Record(
            t=self.t,
            q=self.q,
            q_ref=q_ref,
            nu=self.nu,
            added=added,
            name=name,
            theta_true=theta_true,
            breaks=self.breaks,
        )

    def summary(self) -> Text:
        """Return the range of each signal, joint by joint."""
        rows, n = [], self.q.shape[1]
        for j in range(n):
            length, force, _ = JOINTS[self.loop.kind_of(j)]
            units = (length, f"{length}/s", f"{length}/s2", "", force)
            for name, unit in zip(self.content[1:], units, strict=True):
                x = getattr(self, name)[:, j]
                rows.append([column_name(name, j, n), unit, f"{x.min():.4g}", f"{x.max():.4g}"])
        span = quantity(float(np.ptp(self.t)), "s")
        title = f"Simulation of {self.loop.name}: {len(self.t)} samples, {span}"
        notes = () if self.finite else ("it is unstable; check the gains and the inertia",)
        return table(title, [], ["", "unit", "from", "to"], rows, notes, left=2)

    @property
    def drawn(self) -> bool:
        """Whether it has a figure: one that diverged has none."""
        return self.finite

    def plot(self, record: Record | None = None, **options: Any) -> Figure:
        """Return the figure of simulated against measured signals, or of the simulated alone."""
        if record is not None:
            return super().plot(record=record, **options)
        return self.to_record().plot(**options)


def over_stretches(
    loop: ClosedLoop | RobotLoop,
    record: Record,
    theta: Theta | None,
    noises: Mapping[str, ArrayLike | None],
    initial: Any,
    **options: Any,
) -> Simulation:
    """Simulate each stretch of a record with breaks, all behind the first from its own state.

    Where a stretch diverges, the rest is not simulated and infinite.
    """
    known, signals = loop.known(record), np.full((5, *record.q.shape), np.inf)
    for rows, part in zip(record.stretches, record.parts, strict=True):
        own: dict[str, Any] = {
            n: None if x is None else np.asarray(x)[rows] for n, x in noises.items()
        }
        made = known.simulate(part, theta, initial=initial, **own, **options)
        if not made.finite:
            break
        signals[:, rows] = made.q, made.dq, made.ddq, made.nu, made.tau
        initial = "record"
    q, dq, ddq, nu, tau = signals
    return Simulation(record.t, q, dq, ddq, nu, tau, known, record.breaks)
