"""The simulated loop against the measured one (the EMPS report's figures 5 and 6)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

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
    loop = simulated.loop
    pipeline = pipeline or loop.pipeline(record)
    head, tail = pipeline.trim
    rows = slice(head, record.n_samples - tail)
    measured = (*pipeline.differentiate(record.q, record.dt), loop.force(record))
    errors = simulated.relative_error(record, pipeline)
    units, t = units_of(loop.joint), record.t[rows]
    columns = 2 if width_mm >= 140.0 else 1
    with look():
        figure = sheet(width_mm, 96.0 + 72.0 * (columns == 1))
        figure.get_layout_engine().set(hspace=0.0, h_pad=0.012)  # type: ignore[union-attr, call-arg]
        panels = _panels(figure, columns)
        signals = zip(errors, measured, (*simulated.motion, simulated.tau), strict=True)
        for (main, strip), (name, real, model) in zip(panels, signals, strict=True):
            shown = "torque" if name == "force" and loop.joint == "revolute" else name
            _panel(main, strip, t, (real[rows], model[rows]), shown, units[name])
            main.set_title(f"{errors[name]:.3g} %", loc="right", fontsize=6.5, pad=2.5)
        for _, strip in panels[-columns:]:
            strip.set_xlabel("Time (s)")
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


def _panel(
    main: Axes, strip: Axes, t: Array, signals: tuple[Array, Array], name: str, unit: str
) -> None:
    """Draw one signal (n, 1), measured and simulated, and its error in a unit that fits."""
    measured, simulated = signals
    error = measured - simulated
    factor, small = scaled(error, unit)
    line(main, t, measured, color=COLOURS["measured"], lw=1.7, label="measured")
    line(main, t, simulated, color=COLOURS["model"], lw=0.7, label="simulated")
    line(strip, t, factor * error, color=COLOURS["error"], lw=0.6)
    fit_to_inner(strip, factor * error)
    main.set_ylabel(f"{name.capitalize()}\n({readable(unit)})")
    strip.set_ylabel(f"Error\n({readable(small)})")
    strip.locator_params(axis="y", nbins=3)
    main.locator_params(axis="y", nbins=5)
