"""The first page of a log: what is used of it, in which units, and the controller's law."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .errors import IVToolsError
from .plots.parity import parity_chart
from .plots.record import record_chart
from .report import Card, Page
from .suitability import Suitability
from .tables import Text, sentence, table
from .units import quantity

if TYPE_CHECKING:
    from .loop import ClosedLoop
    from .loop.identification import ControllerFit

_SIGNALS = "What was logged, in SI units; a velocity that was not is the difference of positions."
_PARITY = (
    "Controller parity: the recorded command against the law fed with the measured position, and "
    "their difference. No model of the axis takes part, so a difference is the controller's or the "
    "log's."
)


def log_page(
    found: Suitability, fit: ControllerFit | None = None, doubts: Sequence[str] = ()
) -> Page:
    """Return the page of a log.

    Parameters
    ----------
    found : Suitability
        Of the record and its loop, whose controller is a law, or "none".
    fit : ControllerFit, optional
        How the law was read from the record, if it was.
    doubts : sequence of str
        What the first look was not sure of.
    """
    record, loop = found.record, found.loop
    out = Page(f"The log {record.name}", repr(record), _card(found, loop, doubts))
    chart = record_chart(record, loop.joint, caption=_SIGNALS)
    out.add("Signals", *record.of_itself, tables=[found.summary()], figures=[chart])
    if loop.controller.kind == "none":
        out.add("Controller", "No law is known; the command is taken as it is.")
        return out
    tables = [_stated(loop) if fit is None else fit.summary()]
    try:
        rate = found.parity.oversampling if found.parity else 1
        figures = [parity_chart(record, loop, caption=_PARITY, oversampling=rate)]
    except IVToolsError as error:
        out.add("Controller", f"The law cannot be compared with the command: {error}.")
        return out
    out.add("Controller", tables=tables, figures=figures)
    return out


def _stated(loop: ClosedLoop) -> Text:
    """Return the settings of a law that was not fitted."""
    law = loop.controller
    rows = []
    for name, value in law.settings.items():
        for k, line in enumerate(np.atleast_2d(np.asarray(value, dtype=float))):  # of a matrix
            rows.append([name * (k == 0), ", ".join(f"{x:.6g}" for x in line)])
    rows += [["delay, samples", f"{law.delay}"], ["limit", f"{law.limit:g}"]]
    return table(f"Controller, as stated: {law.kind}", [], ["", "value"], rows)


def _card(found: Suitability, loop: ClosedLoop, doubts: Sequence[str]) -> Card:
    """Return whether the log suffices, and what to look at."""
    record, parity = found.record, found.parity
    rate = f"{record.n_samples} samples at {record.sampling_hz:.6g} Hz"
    facts = [("Log", f"{rate}, {quantity(record.n_samples * record.dt, 's', 3)}")]
    law = loop.controller.kind
    if parity is not None:
        explained = 100.0 * (1.0 - parity.before**2)
        settings = ", ".join(loop.controller.words)
        law += f" ({settings}): explains {explained:.4g} % of the command's power"
    facts.append(("Controller", law))
    remarks = tuple(dict.fromkeys((*found.advice, *doubts)))
    if found.sufficient and not remarks:
        return Card("The log suffices.", tuple(facts), label="The log in short")
    verdict = "The log suffices; check this." if found.sufficient else "Look at this first."
    lines = tuple(map(sentence, remarks))
    return Card(verdict, tuple(facts), lines, "doubt", "The log in short")
