"""A digital controller in somebody else's simulation: one sample after the other."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np

from ivtools.loop.controllers.seen import fed, references

if TYPE_CHECKING:
    from ivtools.loop import ClosedLoop
    from ivtools.record import Record


class DigitalLaw:
    """The control law of a loop along a record's reference, fed with positions as they come.

    The positions before the first lie where it lies, and the law's own states begin settled.

    Parameters
    ----------
    loop : ClosedLoop
    record : Record
        Gives the reference, the added input, and what else the law knows beforehand.

    Raises
    ------
    AxisError
        If the controller is still to be identified.
    RecordError
        If the record lacks what the law needs.
    """

    def __init__(self, loop: ClosedLoop, record: Record) -> None:
        self.controller = controller = loop.controller
        self.law = law = controller.law(record.dt)
        feed = fed(controller, record, loop.joint)
        known = np.column_stack([*references(record, controller), feed])
        self._direct, self._driven = law.known(known)
        q, still = float(record.q[0, 0]), np.array([0.0])
        self._past = deque([q] * len(law.taps), maxlen=len(law.taps))
        self._state = law.settled(np.concatenate([known[0], [q], still]))
        self._late: deque[float] = deque()
        self._added = np.zeros(len(known)) if record.added is None else record.added[:, 0]

    def __call__(self, k: int, q: float, dq: float) -> float:
        """Return the command of sample k, added input included.

        Parameters
        ----------
        k : int
        q, dq : float
            Position as measured and velocity, m and m/s or rad and rad/s.
        """
        law, limit = self.law, self.controller.limit
        self._past.appendleft(q)
        logged = self.controller.velocity == "logged"
        seen = np.array([q, dq if logged else float(law.taps @ np.array(self._past))])
        value = float(self._direct[k] + law.D[3:] @ seen + law.C @ self._state)
        sent = min(max(value, -limit), limit)
        self._move(self._driven[k] + law.B[:, 3:] @ seen, sent - value)
        self._late.append(sent)
        late = self._late.popleft() if len(self._late) > self.controller.delay else self._late[0]
        return late + float(self._added[k])

    def _move(self, driven: np.ndarray, cut: float) -> None:
        """Move the law's states on; integrators rest while they would drive a clipped command."""
        law, old = self.law, self._state
        new = law.A @ old + driven + law.back * cut
        if cut:
            stay = law.hold & (law.C * (new - old) * np.sign(-cut) > 0.0)
            new = np.where(stay, old, new)
        self._state = new
