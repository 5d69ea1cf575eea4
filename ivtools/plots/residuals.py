"""What several results leave unexplained, one strip each, on one scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ivtools.comparison_table import labels_of
from ivtools.plots.style import (
    COLOURS,
    WIDTH_MM,
    Sheet,
    fit_to_inner,
    legend_above,
    line,
    look,
    sheet,
)

if TYPE_CHECKING:
    from ivtools.results import FitResults


def residuals(
    results: Sequence[FitResults],
    *,
    labels: Sequence[str] | None = None,
    width_mm: float = WIDTH_MM,
) -> Sheet:
    """Draw the force as the last result has it, and below what each result leaves of it.

    Parameters
    ----------
    results : sequence of FitResults
        Of one record, through one pipeline.
    labels : sequence of str, optional
        One per result; default: its method.
    width_mm : float
        Width of the figure, mm.

    Returns
    -------
    Figure

    Examples
    --------
    >>> import ivtools as iv
    >>> fit = iv.IDIMLS().fit(iv.Problem(iv.datasets.twin(), iv.axes.emps()))
    >>> len(residuals([fit]).axes)
    2
    """
    fits = list(results)
    names = labels or [label.upper() for label in labels_of(fits)]
    problem = fits[-1].problem
    times = [np.arange(fit.nobs, dtype=float) if fit.t is None else fit.t for fit in fits]
    revolute = problem is not None and problem.loop.joint == "revolute"
    quantity, unit = ("torque", "N m") if revolute else ("force", "N")
    with look():
        figure = sheet(width_mm, 34.0 + 17.0 * len(fits))
        heights = [1.7] + [1.0] * len(fits)
        top, *strips = figure.subplots(1 + len(fits), 1, sharex=True, height_ratios=heights)
        line(top, times[-1], fits[-1].y, color=COLOURS["measured"], lw=1.7, label="measured")
        line(top, times[-1], fits[-1].fitted, color=COLOURS["model"], lw=0.7, label="reconstructed")
        top.set_ylabel(f"{quantity}, {unit}")
        legend_above(top)
        for strip, fit, t, name in zip(strips, fits, times, names, strict=True):
            line(strip, t, fit.resids, color=COLOURS["error"], lw=0.6)
            strip.set_title(f"{name}: {fit.relative_error:.2f} %", loc="left", fontsize=6.5, pad=2)
            strip.set_ylabel(f"error, {unit}")
            strip.sharey(strips[0])
        fit_to_inner(strips[0], *(fit.resids for fit in fits))
        for axes in (top, *strips[:-1]):
            axes.tick_params(bottom=False)
        strips[-1].set_xlabel("time, s" if problem is not None else "row")
        figure.align_ylabels()
    return figure
