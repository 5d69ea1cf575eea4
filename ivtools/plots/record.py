"""A record as it was logged: position and reference, velocity, command."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ivtools.plots.style import COLOURS, WIDTH_MM, Sheet, legend_above, line, look, sheet

if TYPE_CHECKING:
    from ivtools.record import Record

_ROWS = (("q", "q_ref"), ("dq", "dq_ref"), ("nu", "added"), ("tau", "load"))


def record(logged: Record, joint: int = 0, *, width_mm: float = WIDTH_MM) -> Sheet:
    """Draw what was logged of one joint; a velocity that was not is differenced.

    Parameters
    ----------
    logged : Record
    joint : int
        Counted from 0.
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
                line(axes, logged.t, signals[beside], color=COLOURS["model"], label=beside)
            line(axes, logged.t, signals[main], color=COLOURS["measured"], label=main)
            legend_above(axes)
            axes.set_ylabel(main)
        panels[-1].set_xlabel("time, s")
    return figure
