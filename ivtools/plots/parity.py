"""The recorded command against what the control law makes of the measured position."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ivtools.gap.between import interpolated
from ivtools.gap.parity import Signals
from ivtools.plots.chart import Chart, Panel, Series, inner_limits, worst

if TYPE_CHECKING:
    from ivtools.loop import ClosedLoop
    from ivtools.record import Record


def parity_chart(record: Record, loop: ClosedLoop, *, caption: str, oversampling: int = 1) -> Chart:
    """Return the command, recorded and by the law, and their difference, as a chart.

    Parameters
    ----------
    record : Record
        With a reference.
    loop : ClosedLoop
        Its controller is a law.
    caption : str
        Of the chart on its page.
    oversampling : int
        Samples of the controller from one sample of the log to the next.

    Examples
    --------
    >>> import ivtools as iv
    >>> made = parity_chart(iv.datasets.twin(), iv.axes.emps(), caption="The law.")
    >>> [panel.quantity for panel in made.panels]
    ['command', 'command less law']
    """
    signals = Signals(interpolated(record, oversampling), loop)
    error = signals.error(loop.controller, loop.controller.delay, 0.0)[::oversampling]
    recorded = signals.command[::oversampling]
    both = (
        Series("recorded", recorded, "measured"),
        Series("by the law", recorded - error, "model"),
    )
    error = np.where(np.isfinite(error), error, np.nan)
    panels = (
        Panel("command", "", both),
        Panel("command less law", "", (Series("difference", error, "error"),), inner_limits(error)),
    )
    return Chart("parity", record.t, panels, caption, worst(record.t, error))
