"""Figures of results that are neither a fit nor a comparison: sets, fronts, transfer functions."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from ivtools.plots.style import (
    COLOURS,
    WIDTH_MM,
    Sheet,
    legend_above,
    line,
    look,
    readable,
    sheet,
)
from ivtools.units import JOINTS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ivtools.estimators.drive_gain_results import DriveGain
    from ivtools.estimators.feasible_set import Array, FeasibleSet
    from ivtools.estimators.pareto_front import ParetoFront
    from ivtools.estimators.transfer_results import TransferFunctionResults
    from ivtools.leaderboard import Leaderboard


def feasible_set(
    found: FeasibleSet, truth: dict[str, float] | None = None, *, width_mm: float = WIDTH_MM
) -> Sheet:
    """Draw the projections of a feasible set on every pair of parameters, its box and centre.

    Parameters
    ----------
    found : FeasibleSet
    truth : dict, optional
        True parameters, drawn as a cross.
    width_mm : float

    Examples
    --------
    >>> from ivtools.estimators.feasible_set import FeasibleSet
    >>> X = np.column_stack([np.arange(9.0), np.ones(9)])
    >>> len(feasible_set(FeasibleSet.of(X, X @ [2.0, 1.0], 0.5)).axes)
    1
    """
    corners, pairs = found.vertices(), list(combinations(range(len(found.names)), 2))
    columns = min(2, max(1, len(pairs)))
    rows = max(1, -(-len(pairs) // columns))
    with look():
        figure = sheet(width_mm, 12.0 + 34.0 * rows)
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for ax, (i, j) in zip(axes, pairs, strict=False):
            _projection(ax, found, corners, i, j)
            if truth is not None:
                ax.plot(truth[found.names[i]], truth[found.names[j]], "x", color=COLOURS["truth"],
                        ms=4)  # fmt: skip
        for ax in axes[len(pairs) :]:
            ax.remove()
        verdict = "empty" if found.empty else f"bound up to {found.bound.max():.3g}"
        figure.suptitle(f"Feasible set: {verdict}", fontsize=7.5)
    return figure


def _projection(ax: Axes, found: FeasibleSet, corners: Array, i: int, j: int) -> None:
    """Draw one projection of the corners, their hull filled."""
    from scipy.spatial import ConvexHull

    names, units = found.names, found.units
    if len(corners) > 2:
        points = corners[:, [i, j]]
        hull = points[ConvexHull(points, qhull_options="QJ").vertices]
        ax.fill(*hull.T, color=COLOURS["measured"], alpha=0.5, lw=0.6)
    ax.plot(found.centre.iloc[i], found.centre.iloc[j], "o", color=COLOURS["model"], ms=3)
    ax.set_xlabel(_named(names[i], units[i]), fontsize=6)
    ax.set_ylabel(_named(names[j], units[j]), fontsize=6)


def _named(name: str, unit: str) -> str:
    """Return a name with its unit, on two lines where one would be too long for a panel."""
    if not unit:
        return name
    return f"{name},{chr(10) if len(name) > 9 else ' '}{readable(unit)}"


def pareto(front: ParetoFront, *, width_mm: float = WIDTH_MM) -> Sheet:
    """Draw a Pareto front, its first objective against the others, its knee marked.

    Examples
    --------
    >>> from ivtools.estimators.pareto_front import ParetoFront
    >>> errors = np.array([[0.0, 1.0], [0.2, 0.2], [1.0, 0.0]])
    >>> names = ("force", "position")
    >>> front = ParetoFront(("a",), ("",), names, np.zeros((3, 1)), errors, 3, True)
    >>> len(pareto(front).axes)
    1
    """
    first, *others = front.objectives
    with look():
        figure = sheet(width_mm, 12.0 + 28.0 * len(others))
        axes = figure.subplots(len(others), 1, sharex=True, squeeze=False).ravel()
        for j, (ax, name) in enumerate(zip(axes, others, strict=True), start=1):
            ax.plot(front.errors[:, 0], front.errors[:, j], ".", color=COLOURS["measured"], ms=3)
            ax.plot(*front.errors[front.knee, [0, j]], "o", color=COLOURS["model"], ms=4)
            ax.set_ylabel(f"{name} error, %")
        axes[-1].set_xlabel(f"{first} error, %")
        figure.align_ylabels()
        figure.suptitle(f"Pareto front of {len(front.theta)} points, knee marked", fontsize=7.5)
    return figure


def transfer_function(results: TransferFunctionResults, *, width_mm: float = WIDTH_MM) -> Sheet:
    """Draw the measured output and that of the free-running transfer function.

    Examples
    --------
    >>> import ivtools as iv
    >>> from ivtools.estimators.transfer_function import SRIVC
    >>> problem = iv.Problem(iv.datasets.twin(), iv.axes.emps())
    >>> len(transfer_function(SRIVC(poles=2, input="q_ref").fit(problem)).axes)
    2
    """
    unit = JOINTS[results.problem.loop.joint].length
    names = {"q": f"position, {unit}", "dq": f"velocity, {unit}/s"}
    quantity = names.get(results.estimator.output, "output")
    with look():
        figure = sheet(width_mm, 60.0)
        top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
        line(top, results.t, results.y, color=COLOURS["measured"], lw=1.7, label="measured")
        line(top, results.t, results.simulated, color=COLOURS["model"], lw=0.7, label="model")
        line(bottom, results.t, results.resids, color=COLOURS["error"], lw=0.6)
        top.set_ylabel(quantity)
        bottom.set_ylabel(quantity.replace(quantity.split(",")[0], "error"))
        bottom.set_xlabel("time, s")
        legend_above(top)
        title = f"{results.method.upper()}, {results.structure}: {results.relative_error:.3g} %"
        figure.suptitle(title, fontsize=7.5)
        figure.align_ylabels()
    return figure


def leaderboard(board: Leaderboard, *, width_mm: float = 1.5 * WIDTH_MM) -> Sheet:
    """Draw the free-run errors beside the force errors in closed loop.

    Examples
    --------
    >>> from ivtools.leaderboard import OTHERS, Leaderboard
    >>> len(leaderboard(Leaderboard(OTHERS)).axes)
    2
    """
    colours = dict(zip(("ours", "measured", "read"), COLOURS["series"], strict=False))
    entries = board.entries[::-1]
    with look():
        figure = sheet(width_mm, 14.0 + 4.0 * len(entries))
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1.5, 1.0))
        at = np.arange(len(entries))
        for source, colour in colours.items():
            mine = [i for i in at if entries[i].source == source]
            left.barh(mine, [entries[i].rmse_mm for i in mine], color=colour, label=source)
            right.barh(mine, np.nan_to_num([entries[i].force for i in mine]), color=colour)
        left.set_yticks(at, [entry.label for entry in entries])
        left.set_xlabel("free run, mm")
        right.set_xlabel("force in closed loop, %")
        legend_above(left)
    return figure


def drive_gain(found: DriveGain, *, width_mm: float = WIDTH_MM) -> Sheet:
    """Draw the drive gain with each block of rows left out, and its 95 % interval.

    Examples
    --------
    >>> import pandas as pd
    >>> from ivtools.estimators.drive_gain_results import DriveGain
    >>> none = pd.Series(dtype=float)
    >>> gain = DriveGain(35.0, 0.1, none, none, 20.0, 35.1, 1.0, 100, np.full(40, 35.0))
    >>> len(drive_gain(gain).axes)
    1
    """
    lower, upper = found.conf_int()
    with look():
        figure = sheet(width_mm, 42.0)
        ax = figure.subplots()
        ax.axhspan(lower, upper, color=COLOURS["measured"], alpha=0.3, lw=0, label="95 %")
        ax.axhline(found.gain, color=COLOURS["model"], label="estimate")
        ax.axhline(found.stated, color=COLOURS["truth"], ls="--", lw=0.7, label="axis file")
        ax.plot(found.replicates, ".", color=COLOURS["error"], ms=3)
        if len(found.replicates):
            ax.set_xlabel("block of rows left out")
        else:
            ax.set_xticks([])
        ax.set_ylabel(f"drive gain, {found.unit}")
        legend_above(ax)
    return figure
