"""A reference of every joint: position, velocity and the effort that it asks for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ivtools.plots.style import COLOURS, WIDTH_MM, Sheet, line, look, sheet

if TYPE_CHECKING:
    from ivtools.excitation import Excitation


def excitation(found: Excitation, *, width_mm: float = 2.0 * WIDTH_MM) -> Sheet:
    """Draw a row per joint, with its limits as dashed lines where they are near.

    Parameters
    ----------
    found : Excitation
    width_mm : float
        Width of the figure, mm.
    """
    limits, names = found.limits, found.limits.names
    columns = (
        ("position", found.motion.q, (limits.lower, limits.upper)),
        ("velocity", found.motion.dq, (-limits.speed, limits.speed)),
        ("effort", found.effort, (-limits.effort, limits.effort)),
    )
    with look():
        figure = sheet(width_mm, 18.0 * len(names) + 10.0)
        panels = figure.subplots(len(names), 3, sharex=True, squeeze=False)
        for row, (axes_row, name) in enumerate(zip(panels, names, strict=True)):
            for axes, (what, signal, edges) in zip(axes_row, columns, strict=True):
                line(axes, found.t, signal[:, row], color=COLOURS["model"])
                low, high = axes.get_ylim()
                for edge in edges:
                    if low - (high - low) < edge[row] < high + (high - low):
                        axes.axhline(edge[row], color=COLOURS["error"], linestyle="--", lw=0.6)
                if row == 0:
                    axes.set_title(what)
                if row == len(names) - 1:
                    axes.set_xlabel("time, s")
            axes_row[0].set_ylabel(name)
    return figure
