"""The simulated loop against the measured one (the EMPS report's figures 5 and 6)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ivtools.errors import DataError
from ivtools.plots.chart import Chart, Panel, Series, inner_limits, worst
from ivtools.plots.style import (
    COLOURS,
    WIDTH_MM,
    Sheet,
    fit_to_inner,
    legend_above,
    line,
    look,
    readable,
    scaled,
    sheet,
    units_of,
)

if TYPE_CHECKING:
    from ivtools.loop import Simulation
    from ivtools.pipeline import Pipeline
    from ivtools.record import Record

Array = NDArray[np.float64]


def simulation(
    simulated: Simulation,
    record: Record,
    pipeline: Pipeline | None = None,
    *,
    title: str | None = None,
    width_mm: float = WIDTH_MM,
) -> Sheet:
    """Draw position, velocity, acceleration and force, simulated and measured, with their errors.

    Parameters
    ----------
    simulated : Simulation
        What the loop did.
    record : Record
        What the axis did.
    pipeline : Pipeline, optional
        Band-passes the measured position; default: the one that the loop's bandwidth asks for.
    title : str, optional
    width_mm : float
        Width of the figure, mm; from 140 mm on the panels stand two by two.

    Returns
    -------
    Figure
        Each panel names its relative error; a strip below shows the error over time.

    Examples
    --------
    >>> import ivtools as iv
    >>> loop, record = iv.axes.emps(), iv.datasets.twin()
    >>> theta = {"inertia": 95, "viscous": 200, "coulomb": 20, "offset": 0}
    >>> len(simulation(loop.simulate(record, theta), record).axes)
    8
    """
    t, signals = _signals(simulated, record, pipeline)
    columns = 2 if width_mm >= 140.0 else 1
    with look():
        figure = sheet(width_mm, 96.0 + 72.0 * (columns == 1))
        figure.get_layout_engine().set(hspace=0.0, h_pad=0.012)  # type: ignore[union-attr, call-arg]
        panels = _panels(figure, columns)
        for (main, strip), signal in zip(panels, signals, strict=True):
            _panel(main, strip, t, signal)
        for _, strip in panels[-columns:]:
            strip.set_xlabel("time, s")
        legend_above(panels[0][0])
        if title:
            figure.suptitle(title, fontsize=7.5)
        for column in range(columns):
            figure.align_ylabels([axes for pair in panels[column::columns] for axes in pair])
    return figure


def _panels(figure: Sheet, columns: int) -> list[tuple[Axes, Axes]]:
    """Return four pairs of axes: a signal, and the strip of its error."""
    grid = figure.add_gridspec(4 // columns, columns)
    pairs: list[tuple[Axes, Axes]] = []
    for k in range(4):
        inner = grid[k // columns, k % columns].subgridspec(2, 1, height_ratios=(2.0, 1.0))
        main = figure.add_subplot(inner[0], sharex=pairs[0][0] if pairs else None)
        strip = figure.add_subplot(inner[1], sharex=main)
        last = k >= 4 - columns
        main.tick_params(bottom=False, labelbottom=False)
        strip.tick_params(bottom=last, labelbottom=last)
        pairs.append((main, strip))
    return pairs


def simulation_chart(
    simulated: Simulation, record: Record, pipeline: Pipeline | None = None, *, caption: str
) -> Chart:
    """Return `simulation` as a chart that can be zoomed: a panel a signal, and the force error.

    Parameters
    ----------
    simulated, record, pipeline
        As for `simulation`.
    caption : str
        Of the chart on its page.
    """
    t, signals = _signals(simulated, record, pipeline)
    panels = []
    for s in signals:
        factor, unit = scaled(s.measured, s.unit)
        pair = (
            Series("measured", factor * s.measured, "measured"),
            Series("simulated", factor * s.simulated, "model"),
        )
        panels.append(Panel(s.quantity, readable(unit), pair))
    last = signals[-1]
    error = Series("error", last.error, "error")
    panels.append(
        Panel(f"{last.quantity} error", readable(last.unit), (error,), inner_limits(last.error))
    )
    still = simulation(simulated, record, pipeline, width_mm=160.0)
    return Chart("simulation", t, tuple(panels), caption, worst(t, last.error), still)


class _Signal(NamedTuple):
    """One signal, measured and simulated, (n,) each, and its relative error in per cent."""

    quantity: str
    unit: str
    measured: Array
    simulated: Array
    relative_error: float

    @property
    def error(self) -> Array:
        return self.measured - self.simulated


def _signals(
    simulated: Simulation, record: Record, pipeline: Pipeline | None
) -> tuple[Array, list[_Signal]]:
    """Return the time, s, and the signals to compare, both without the trimmed samples."""
    loop = simulated.loop
    if len(loop.joints) > 1:
        raise DataError("a simulation is set against a record joint by joint; plot it by itself")
    used = pipeline or loop.pipeline(record)
    head, tail = used.trim
    rows = slice(head, record.n_samples - tail)
    measured = (*used.differentiate(record.q, record.dt), loop.force(record))
    errors, units = simulated.relative_error(record, used), units_of(loop.joint)
    rename = {"force": "torque"} if loop.joint == "revolute" else {}
    signals = [
        _Signal(rename.get(name, name), units[name], x[rows, 0], model[rows, 0], errors[name])
        for name, x, model in zip(errors, measured, (*simulated.motion, simulated.tau), strict=True)
    ]
    return record.t[rows], signals


def _panel(main: Axes, strip: Axes, t: Array, signal: _Signal) -> None:
    """Draw one signal, measured and simulated, and its error in a unit that fits."""
    factor, small = scaled(signal.error, signal.unit)
    line(main, t, signal.measured, color=COLOURS["measured"], lw=1.7, label="measured")
    line(main, t, signal.simulated, color=COLOURS["model"], lw=0.7, label="simulated")
    line(strip, t, factor * signal.error, color=COLOURS["error"], lw=0.6)
    fit_to_inner(strip, factor * signal.error)
    main.set_title(f"{signal.relative_error:.3g} %", loc="right", fontsize=6.5, pad=2.5)
    main.set_ylabel(f"{signal.quantity},\n{readable(signal.unit)}")
    strip.set_ylabel(f"error,\n{readable(small)}")
    strip.locator_params(axis="y", nbins=3)
    main.locator_params(axis="y", nbins=5)
