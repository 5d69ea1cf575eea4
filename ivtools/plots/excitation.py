"""A reference of every joint: position, velocity and the effort that it asks for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ivtools.plots.style import COLOURS, WIDTH_MM, Sheet, line, look, sheet

if TYPE_CHECKING:
    from ivtools.excitation import Excitation

Array = NDArray[np.float64]
_UNITS = {"position": ("m", "rad"), "velocity": ("m/s", "rad/s"), "effort": ("N", "N m")}


def excitation(
    found: Excitation, *, kind: str | None = None, width_mm: float = 2.0 * WIDTH_MM
) -> Sheet:
    """Draw a row per joint, with its limits as dashed lines where they are near.

    Parameters
    ----------
    found : Excitation
    kind : {"prismatic", "revolute"}, optional
        Of all joints: says the units, which are not written without it.
    width_mm : float
        Width of the figure, mm.
    """
    limits, names = found.limits, found.limits.names
    columns: tuple[tuple[str, Array, tuple[Array, Array]], ...] = (
        ("position", found.motion.q, (limits.lower, limits.upper)),
        ("velocity", found.motion.dq, (-limits.speed, limits.speed)),
        ("effort", found.effort, (-limits.effort, limits.effort)),
    )
    if not np.any(found.effort):  # the model has no values: no effort is known
        columns = columns[:2]
    height = 18.0 * len(names) + (30.0 if len(names) == 1 else 10.0)
    with look():
        figure = sheet(width_mm, height)
        panels = figure.subplots(len(names), len(columns), sharex=True, squeeze=False)
        for row, (axes_row, name) in enumerate(zip(panels, names, strict=True)):
            for axes, (what, signal, edges) in zip(axes_row, columns, strict=True):
                line(axes, found.t, signal[:, row], color=COLOURS["model"])
                low, high = axes.get_ylim()
                for edge in edges:
                    if low - (high - low) < edge[row] < high + (high - low):
                        axes.axhline(edge[row], color=COLOURS["error"], linestyle="--", lw=0.6)
                if row == 0:
                    unit = _UNITS[what][kind == "revolute"] if kind is not None else ""
                    axes.set_title(f"{what}, {unit}" if unit else what)
                if row == len(names) - 1:
                    axes.set_xlabel("time, s")
            axes_row[0].set_ylabel(name)
    return figure
