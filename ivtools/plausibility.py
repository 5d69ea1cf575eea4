"""Signs that a record and an axis file do not belong together: units, gains, sign."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ivtools.errors import IVToolsError

if TYPE_CHECKING:
    from ivtools.loop import ClosedLoop
    from ivtools.record import Record

ABSURD = 20.0  # ratio of commands; gains that are merely wrong stay below


def doubts(record: Record, loop: ClosedLoop) -> tuple[str, ...]:
    """Return what is absurd about a record on this axis, one line each.

    The control law of the axis file, fed with the recorded positions, is compared with the
    recorded command: a position in millimetres makes it a thousand times too large.

    Parameters
    ----------
    record : Record
    loop : ClosedLoop

    Examples
    --------
    >>> import ivtools as iv
    >>> record, loop = iv.datasets.twin(), iv.axes.emps()
    >>> doubts(record, loop)
    ()
    >>> "1e+03 times" in doubts(record.replace(q=1e3 * record.q, q_ref=1e3 * record.q_ref), loop)[0]
    True
    """
    commands = _commands(record, loop)
    if commands is None:
        return ()
    expected, recorded = commands
    ratio = float(np.std(expected) / np.std(recorded))
    found = []
    units = "m? mm?" if loop.joint == "prismatic" else "rad? degrees?"
    if not 1.0 / ABSURD < ratio < ABSURD:
        found.append(
            f"the controller of the axis file would command {ratio:.2g} times what was recorded; "
            f"check the units of q ({units}) and of the command, and the gains"
        )
    elif np.corrcoef(expected, recorded)[0, 1] < -0.5:
        found.append(
            "the recorded command has the opposite sign of the axis file's controller; check the "
            "sign of the command and of the position"
        )
    return tuple(found)


def _commands(record: Record, loop: ClosedLoop) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the command by the control law and the recorded one, (n_samples,) each, V."""
    if record.n_joints != 1 or record.q_ref is None:
        return None
    try:
        law = loop.controller.law(record.dt)
        recorded = loop.command(record)[:, 0]
    except IVToolsError:  # a law that is still to be identified
        return None
    if record.added is not None:
        recorded = recorded - record.added[:, 0]
    q_ref = record.q_ref[:, 0]
    dq_ref = np.gradient(q_ref, record.dt) if record.dq_ref is None else record.dq_ref[:, 0]
    delay = loop.controller.delay
    with np.errstate(over="ignore", invalid="ignore"):
        expected = law(q_ref, dq_ref, record.q[:, 0])
    expected, recorded = expected[: len(expected) - delay], recorded[delay:]
    usable = np.isfinite(expected).all() and np.ptp(recorded) > 0.0 and np.ptp(expected) > 0.0
    return (expected, recorded) if usable else None
