"""A simulator of one's own that can be run: its logs, and what the changes bring."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

from ...errors import IVToolsError
from ...linalg import rms
from ...loop import ClosedLoop
from ...record import Record
from ...simulators.protocol import Simulator, logged
from ...units import JOINTS, quantity
from ..fold import usable

if TYPE_CHECKING:
    from ..diagnosis import Diagnosis


@dataclass(frozen=True)
class Confirmation:
    """Force errors of a simulator on one record, before and after the changes were made in it.

    Attributes
    ----------
    record : str
    before, after : float
        Rms of measured less simulated force where both can be compared: without the transient of
        the initial state, the command at its limit and standstill. NaN after, if the changed
        simulator does not run.
    predicted : float
        What the diagnosis expects after the changes; NaN if it cannot say.
    unit : str
    note : str
        Why there is no figure after.
    """

    record: str
    before: float
    predicted: float
    after: float
    unit: str
    note: str = ""

    def to_dict(self) -> dict[str, Any]:
        """Return the content as plain objects, ready for JSON."""
        return {k: None if v != v else v for k, v in asdict(self).items()}

    @property
    def text(self) -> str:
        """The figures in a sentence."""
        before = quantity(self.before, self.unit, 3)
        if self.note:
            return f"your simulator errs by {before} on {self.record}; the changes: {self.note}"
        expected = quantity(self.predicted, self.unit, 3)
        return (
            f"your simulator errs by {before} on {self.record}, with the changes by "
            f"{quantity(self.after, self.unit, 3)} ({expected} expected)"
        )


def run(simulator: Simulator, record: Record) -> Record:
    """Return the log of a simulator on a record's reference."""
    return logged(simulator.simulate(record), record)


def confirm(found: Diagnosis, simulator: Simulator, real: Record) -> Confirmation:
    """Run a simulator as it is and with a diagnosis in it.

    Parameters
    ----------
    found : Diagnosis
        Of what the simulator lacks.
    simulator : Simulator
        Its ``simulate_changed(record, found)`` runs it with the changes, if it has one.
    real : Record
        The holdout, or the record itself.
    """

    def error(log: Record) -> float:
        """Return the rms of measured less simulated force where both can be compared."""
        n = min(log.n_samples, real.n_samples)
        force = found.loop.force(real)[:n] - found.loop.force(log)[:n]
        return rms(force[counts[:n]])

    counts = usable(real, found.loop)
    s, after, note = found.shrink, float("nan"), ""
    before = error(run(simulator, real))
    try:
        after = error(_changed(simulator, real, found))
    except (IVToolsError, OSError) as failure:
        note = str(failure)
    predicted = float("nan") if s is None else s.after_frozen if s.held_out else s.after
    unit = JOINTS[found.loop.joint].force
    return Confirmation(real.name, before, float(predicted), after, unit, note)


def _changed(simulator: Simulator, record: Record, found: Diagnosis) -> Record:
    """Return the log of a simulator with the changes made in it."""
    if isinstance(simulator, ClosedLoop):
        return run(_with(simulator, found), record)
    way = getattr(simulator, "simulate_changed", None)
    if way is None:
        raise IVToolsError("make them yourself; a simulator with simulate_changed shows what comes")
    return logged(way(record, found), record)


def _with(loop: ClosedLoop, found: Diagnosis) -> ClosedLoop:
    """Return a loop of ours with the changes."""
    known, edits = {t.name for t in loop.terms}, found.edits
    terms = [t for t in loop.terms if t.name not in found.surplus]
    terms += [t for t in found.loop.terms if t.name not in known and {*t.names} & {*edits}]
    start = {n: v for t in terms for n in t.names if (v := loop.start.get(n)) is not None}
    ours = {n for t in terms for n in t.names}
    start |= {n: start.get(n, 0.0) + edit for n, edit in edits.items() if n in ours}
    return replace(loop, terms=tuple(terms), start=start)
