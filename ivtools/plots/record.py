"""A record as it was logged: position and reference, velocity, command."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ivtools.columns import UNITS
from ivtools.plots.chart import Chart, Panel, Series
from ivtools.plots.style import (
    COLOURS,
    WIDTH_MM,
    Sheet,
    legend_above,
    line,
    look,
    readable,
    scaled,
    sheet,
)

if TYPE_CHECKING:
    from ivtools.guess.first import FirstAxis
    from ivtools.record import Record
    from ivtools.suitability import Suitability

_ROWS = (("q", "q_ref"), ("dq", "dq_ref"), ("nu", "added"), ("tau", "load"))
_QUANTITIES = {"q": "position", "dq": "velocity", "nu": "command", "tau": "force"}
_BESIDE = {"q_ref": "reference", "dq_ref": "reference", "added": "added", "load": "outside force"}


def record(
    logged: Record, joint: int = 0, *, kind: str | None = None, width_mm: float = WIDTH_MM
) -> Sheet:
    """Draw what was logged of one joint; a velocity that was not is differenced.

    Parameters
    ----------
    logged : Record
    joint : int
        Counted from 0.
    kind : {"prismatic", "revolute"}, optional
        Says the units; without it they are not written, as a record does not know them.
    width_mm : float
        Width of the figure, mm.

    Examples
    --------
    >>> import ivtools as iv
    >>> len(record(iv.datasets.twin()).axes)
    3
    """
    signals = {name: x[:, joint] for name, x in logged.signals.items()}
    signals.setdefault("dq", np.gradient(signals["q"], logged.dt))
    rows = [row for row in _ROWS if row[0] in signals]
    with look():
        figure = sheet(width_mm, 22.0 * len(rows) + 8.0)
        panels = np.atleast_1d(figure.subplots(len(rows), sharex=True))
        for axes, (main, beside) in zip(panels, rows, strict=True):
            if beside in signals:
                label = f"{_BESIDE[beside]} ({beside})"
                line(axes, logged.t, signals[beside], color=COLOURS["model"], label=label)
            said = main if main in logged.signals else "difference of q"
            line(axes, logged.t, signals[main], color=COLOURS["measured"], label=said)
            legend_above(axes)
            unit = UNITS[main][kind == "revolute"] if kind is not None and main in UNITS else ""
            axes.set_ylabel(f"{_QUANTITIES[main]}, {readable(unit)}" if unit else _QUANTITIES[main])
        panels[-1].set_xlabel("time, s")
    return figure


def in_units(found: FirstAxis | Suitability, **options: Any) -> Sheet:
    """Draw the record of a result, as `record` does, with the units that its loop says."""
    return record(found.record, kind=found.loop.joint, **options)


def record_chart(logged: Record, joint: str, *, caption: str) -> Chart:
    """Return what was logged of one joint as a chart: a panel a quantity.

    Parameters
    ----------
    logged : Record
        Of one joint.
    joint : {"prismatic", "revolute"}
        Says the units.
    caption : str
        Of the chart on its page.

    Examples
    --------
    >>> import ivtools as iv
    >>> made = record_chart(iv.datasets.twin(), "prismatic", caption="The twin.")
    >>> [(panel.quantity, panel.unit) for panel in made.panels]
    [('position', 'm'), ('velocity', 'm/s'), ('command', '')]
    """
    signals = {name: x[:, 0] for name, x in logged.signals.items()}
    signals.setdefault("dq", np.gradient(signals["q"], logged.dt))
    panels = []
    for main, beside in _ROWS:
        if main not in signals:
            continue
        unit = UNITS[main][joint == "revolute"] if main in UNITS else ""
        factor, shown = scaled(signals[main], unit) if unit else (1.0, "")
        pairs = [(main, "measured" if main in ("q", "dq", "tau") else "recorded", "measured")]
        pairs += [(beside, _BESIDE[beside], "reference")] if beside in signals else []
        series = tuple(Series(label, factor * signals[n], role) for n, label, role in pairs)
        panels.append(Panel(_QUANTITIES[main], readable(shown), series))
    return Chart("record", logged.t, tuple(panels), caption)
