"""The measured force against the reconstructed one (the EMPS report's figures 3 and 4)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ivtools.plots.style import (
    COLOURS,
    WIDTH_MM,
    Sheet,
    fit_to_inner,
    legend_above,
    line,
    look,
    sheet,
    units_of,
)

if TYPE_CHECKING:
    from ivtools.problem import Problem
    from ivtools.results import FitResults


def force(
    results: FitResults,
    problem: Problem | None = None,
    *,
    title: str | None = None,
    width_mm: float = WIDTH_MM,
) -> Sheet:
    """Draw the measured and the reconstructed force over time, their difference below.

    Parameters
    ----------
    results : FitResults
        The estimate.
    problem : Problem, optional
        Another record to reconstruct with it (cross-test); default: its own.
    title : str, optional
        Default: method and relative error.
    width_mm : float
        Width of the figure, mm.

    Returns
    -------
    Figure

    Examples
    --------
    >>> import ivtools as iv
    >>> fit = iv.IDIMLS().fit(iv.Problem(iv.datasets.twin(), iv.axes.emps()))
    >>> len(force(fit).axes)
    2
    """
    own = problem or results.problem
    y = results.y if problem is None else problem.y
    model = results.fitted if problem is None else problem.X @ results.params.to_numpy()
    joint = own.loop.joint if own is not None else "prismatic"
    t = results.t if problem is None else problem.t
    t = np.arange(len(y), dtype=float) if t is None else t
    name, unit = ("Force", "N") if joint == "prismatic" else ("Torque", "N m")
    signal = results.extras.get("signal", "force") if problem is None else "force"
    if signal != "force":  # what output error compares
        name, unit = signal.capitalize(), units_of(joint)[signal]
    relative = 100.0 * np.linalg.norm(y - model) / np.linalg.norm(y)
    with look():
        figure = sheet(width_mm, 62.0)
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
        line(top, t, y, color=COLOURS["measured"], lw=1.7, label="measured")
        line(top, t, model, color=COLOURS["model"], lw=0.7, label="reconstructed")
        line(bottom, t, y - model, color=COLOURS["error"], lw=0.6)
        fit_to_inner(bottom, y - model)
        top.set_ylabel(f"{name} ({unit})")
        bottom.set_ylabel(f"Error ({unit})")
        top.tick_params(bottom=False)
        bottom.set_xlabel("Time (s)" if own is not None else "Row")
        legend_above(top)
        what = "cross-test" if problem is not None else "relative error"
        figure.suptitle(title or f"{results.method.upper()}: {what} {relative:.3g} %", fontsize=7.5)
        figure.align_ylabels()
    return figure
