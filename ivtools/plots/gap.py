"""The sim-to-real gap at a glance: where it sits, which effect it is, how far it closes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import SubFigure
from numpy.typing import NDArray

from ivtools.plots import panels
from ivtools.plots.chart import Chart, Panel, Region, Series, inner_limits, worst
from ivtools.plots.style import Sheet, look, readable, scaled, sheet, units_of

if TYPE_CHECKING:
    from ivtools.gap.diagnosis import Diagnosis

Array = NDArray[np.float64]

WIDTH_MM = 170.0  # two columns


def gap(diagnosis: Diagnosis) -> Sheet:
    """Draw the answer: error over time, ranking, before and after, and the worst second.

    Parameters
    ----------
    diagnosis : Diagnosis

    Returns
    -------
    Figure

    Raises
    ------
    DataError
        If the record did not allow a comparison.
    """
    with look():
        figure = sheet(WIDTH_MM, 115.0)
        axes = figure.subplots(2, 2, width_ratios=(3, 2))
        panels.error_over_time(axes[0, 0], diagnosis)
        panels.ranking(axes[0, 1], diagnosis)
        panels.force(axes[1, 0], diagnosis, panels.worst_second(panels.traces_of(diagnosis)))
        axes[1, 0].set_xlabel("time, s")
        panels.before_and_after(axes[1, 1], diagnosis)
        figure.suptitle(_title(diagnosis), fontsize=8)
    return figure


def where(diagnosis: Diagnosis) -> Sheet:
    """Draw where the gap sits: over time, position and velocity, by region, and in frequency."""
    with look():
        figure = sheet(WIDTH_MM, 115.0)
        upper, lower = (
            row.subplots(1, 2, width_ratios=(3, 2)) for row in _parts(figure.subfigures(2, 1))
        )
        panels.error_over_time(upper[0], diagnosis)
        panels.shares_by_region(upper[1], diagnosis)
        panels.error_in_the_plane(lower[0], diagnosis)
        panels.spectrum(lower[1], diagnosis)
    return figure


def which(diagnosis: Diagnosis) -> Sheet:
    """Draw the ranking of the effects."""
    with look():
        figure = sheet(110.0, 70.0)
        panels.ranking(figure.subplots(), diagnosis)
    return figure


def over_time(diagnosis: Diagnosis, name: str, caption: str) -> Chart:
    """Return the judged record as a chart: motion, forces measured and simulated, and the error.

    What stands out once is shaded, and can be jumped to, as the worst second can.
    """
    traces = panels.traces_of(diagnosis)
    record, units = traces.record, units_of(diagnosis.loop.joint)
    quantity = "force" if diagnosis.loop.joint == "prismatic" else "torque"
    before, after = traces.before, traces.after
    changed = bool(diagnosis.effects)
    keep = np.where(traces.keep, before, np.nan)
    q, dq = record.q[:, 0], np.gradient(record.q[:, 0], record.dt)

    def pair(signal: Callable[[Array], Array]) -> tuple[Series, ...]:
        both = (Series("before", signal(before), "before"), Series("after", signal(after), "after"))
        return both if changed else (Series("simulated", signal(before), "model"),)

    forces = (
        Series("measured", traces.measured, "measured"),
        *pair(lambda error: traces.measured - error),
    )
    motion = [
        Panel(what, readable(unit), (Series(what, factor * x, "measured"),))
        for what, x in (("position", q), ("velocity", dq))
        for factor, unit in [scaled(x, units[what])]
    ]
    shown = (
        Panel(quantity, readable(units[quantity]), forces),
        Panel(
            f"{quantity} error", readable(units[quantity]), pair(lambda e: e), inner_limits(keep)
        ),
        *motion,
    )
    events = tuple(
        Region(a, b, f"{a:.1f}–{b:.1f} s stands out") for a, b in panels.events(diagnosis)
    )
    return Chart(name, record.t, shown, caption, (*worst(record.t, keep), *events[:8]))


def how_far(diagnosis: Diagnosis) -> Sheet:
    """Draw the gap before and after, and the forces around the worst second."""
    with look():
        figure = sheet(WIDTH_MM, 80.0)
        left, right = _parts(figure.subfigures(1, 2, width_ratios=(2, 3)))
        panels.before_and_after(left.subplots(), diagnosis)
        upper, lower = right.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        rows = panels.worst_second(panels.traces_of(diagnosis))
        panels.force(upper, diagnosis, rows)
        panels.difference(lower, diagnosis, rows)
        lower.set_xlabel("time, s")
    return figure


#: Name, function and caption of every figure of a page.
SET = (
    (
        "where",
        where,
        "Where the gap sits. Top: force error over time (faint where it does not count: transient, "
        "limit, standstill, or the stretches that the effects were fitted to), and the share of "
        "its energy by region against the share of the time. Bottom: the error before, over "
        "position and velocity, and its spectrum.",
    ),
    (
        "which",
        which,
        "Which effect: share of the reducible gap that each effect closes alone, on held-out data; "
        "hatched where it is the screening's estimate.",
    ),
    (
        "how-far",
        how_far,
        "How far: force error on held-out data, with 95 % interval and floor; measured and "
        "simulated force around the worst second, and their difference below.",
    ),
)


def _parts(found: Any) -> list[SubFigure]:
    """Return subfigures, whatever matplotlib says that they are."""
    return list(found)


def _title(diagnosis: Diagnosis) -> str:
    named = ", ".join(diagnosis.effects) or "no effect named"
    return f"{diagnosis.name}: {diagnosis.verdict} ({named})"
