"""The measured force against the reconstructed one (the EMPS report's figures 3 and 4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ivtools.plots.chart import Chart, Panel, Series, inner_limits, worst
from ivtools.plots.joint_forces import joint_forces
from ivtools.plots.style import (
    COLOURS,
    WIDTH_MM,
    Sheet,
    fit_to_inner,
    legend_above,
    line,
    look,
    parted,
    readable,
    sheet,
    units_of,
)

if TYPE_CHECKING:
    from ivtools.problem import Problem
    from ivtools.results import FitResults

Array = NDArray[np.float64]


def force(
    results: FitResults,
    problem: Problem | None = None,
    *,
    joint: int | None = None,
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
    joint : int, optional
        Of a robot, counted from 0: its rows alone; default: all joints (see `joint_forces`).
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
    if joint is None and own is not None and len(own.loop.joints) > 1:
        return joint_forces(results, problem, title=title)
    shown = _Shown.of(results, problem, joint)
    t, y, model = shown.t, shown.y, shown.model
    with look():
        figure = sheet(width_mm, 62.0)
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
        line(top, t, y, color=COLOURS["measured"], lw=1.7, label="measured")
        line(top, t, model, color=COLOURS["model"], lw=0.7, label="reconstructed")
        line(bottom, t, y - model, color=COLOURS["error"], lw=0.6)
        fit_to_inner(bottom, y - model)
        top.set_ylabel(f"{shown.quantity}, {shown.unit}")
        bottom.set_ylabel(f"error, {shown.unit}")
        top.tick_params(bottom=False)
        bottom.set_xlabel(shown.across)
        legend_above(top)
        what = "cross-test" if problem is not None else "relative error"
        error = f"{results.method.upper()}: {what} {shown.relative_error:.3g} %"
        figure.suptitle(title or error, fontsize=7.5)
        figure.align_ylabels()
    return figure


def force_chart(
    results: FitResults,
    problem: Problem | None = None,
    *,
    name: str,
    caption: str,
    joint: int | None = None,
    title: str | None = None,
    limits: tuple[float, float] | None = None,
) -> Chart:
    """Return `force` as a chart that can be zoomed; the worst second is a region of its own.

    Parameters
    ----------
    results, problem, joint, title
        As for `force`.
    name, caption : str
        Of the chart on its page.
    limits : (float, float), optional
        Of the error's axis while all is shown, for charts that are compared.
    """
    shown = _Shown.of(results, problem, joint)
    error = shown.y - shown.model
    signals = (
        Series("measured", shown.y, "measured"),
        Series("reconstructed", shown.model, "model"),
    )
    panels = (
        Panel(shown.quantity, shown.unit, signals),
        Panel(
            "error", shown.unit, (Series("error", error, "error"),), limits or inner_limits(error)
        ),
    )
    still = force(results, problem, joint=joint, title=title)
    return Chart(name, shown.t, panels, caption, worst(shown.t, error), still, shown.across)


@dataclass(frozen=True)
class _Shown:
    """What both forms of the figure show: measured and reconstructed signal, (N,) each."""

    t: Array
    y: Array
    model: Array
    quantity: str
    unit: str
    across: str

    @classmethod
    def of(cls, results: FitResults, problem: Problem | None, joint: int | None) -> _Shown:
        own = problem or results.problem
        y = results.y if problem is None else problem.y
        model = results.fitted if problem is None else problem.X @ results.params.to_numpy()
        t = results.t if problem is None else problem.t
        kind = own.loop.kind_of(joint or 0) if own is not None else "prismatic"
        quantity = "force" if kind == "prismatic" else "torque"
        if problem is None and results.signal != "force":  # what output error compares
            quantity = results.signal
        t = np.arange(len(y), dtype=float) if t is None else t
        mine = slice(None) if joint is None or own is None else own.row_joints == joint
        t, y, model = parted(t[mine], y[mine], model[mine])
        return cls(
            t=t,
            y=y,
            model=model,
            quantity=quantity,
            unit=readable(units_of(kind)[quantity]),
            across="time, s" if own is not None else "row",
        )

    @property
    def relative_error(self) -> float:
        """Return 100 ||y - model|| / ||y||, %."""
        y, model = self.y[np.isfinite(self.y)], self.model[np.isfinite(self.y)]
        return 100.0 * float(np.linalg.norm(y - model) / np.linalg.norm(y))
