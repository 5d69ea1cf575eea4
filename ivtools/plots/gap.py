"""The sim-to-real gap at a glance: where it sits, which effect it is, how far it closes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from ivtools.plots import panels
from ivtools.plots.chart import Chart, Panel, Region, Series, inner_limits, worst
from ivtools.plots.style import Sheet, look, readable, scaled, sheet, units_of

if TYPE_CHECKING:
    from ivtools.gap.diagnosis import Diagnosis

Array = NDArray[np.float64]

WIDTH_MM = 170.0  # two columns
_NARROW_MM = 90.0  # two beside each other on a page, one on a phone


def gap(diagnosis: Diagnosis) -> Sheet:
    """Draw the answer: error over time, ranking, before and after, and the worst second.

    Below them, where a force is left that has no name, its curve.

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
        more = bool(nameless_of(diagnosis))
        figure = sheet(WIDTH_MM, 165.0 if more else 115.0)
        grid = figure.add_gridspec(3 if more else 2, 2, width_ratios=(3, 2))
        above = [figure.add_subplot(grid[k // 2, k % 2]) for k in range(4)]
        panels.error_over_time(above[0], diagnosis)
        panels.ranking(above[1], diagnosis)
        panels.force(above[2], diagnosis, panels.worst_second(panels.traces_of(diagnosis)))
        above[2].set_xlabel("time, s")
        panels.before_and_after(above[3], diagnosis)
        if more:
            panels.nameless(figure.add_subplot(grid[2, :]), diagnosis)
        figure.suptitle(_title(diagnosis), fontsize=8)
    return figure


def error(diagnosis: Diagnosis) -> Sheet:
    """Draw the force error over time, faint where it does not count."""
    return _one(panels.error_over_time, diagnosis)


def regions(diagnosis: Diagnosis) -> Sheet:
    """Draw the share of the error's energy by region of the motion."""
    return _one(panels.shares_by_region, diagnosis)


def plane(diagnosis: Diagnosis) -> Sheet:
    """Draw the error over position and velocity."""
    return _one(panels.error_in_the_plane, diagnosis)


def spectrum(diagnosis: Diagnosis) -> Sheet:
    """Draw the spectrum of the error, and of the floor."""
    return _one(panels.spectrum, diagnosis)


def which(diagnosis: Diagnosis) -> Sheet:
    """Draw the ranking of the effects."""
    return _one(panels.ranking, diagnosis)


def before_and_after(diagnosis: Diagnosis) -> Sheet:
    """Draw the gap before and after."""
    return _one(panels.before_and_after, diagnosis)


def nameless(diagnosis: Diagnosis) -> Sheet:
    """Draw the force without a name over the signal that tells most of it."""
    return _one(panels.nameless, diagnosis)


def _one(panel: Callable[[Axes, Diagnosis], None], diagnosis: Diagnosis) -> Sheet:
    with look():
        figure = sheet(_NARROW_MM, 65.0)
        panel(figure.subplots(), diagnosis)
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

    factor, unit = scaled(traces.measured, units[quantity])
    forces = (
        Series("measured", factor * traces.measured, "measured"),
        *pair(lambda error: factor * (traces.measured - error)),
    )
    fine, error_unit = scaled(before[traces.keep], units[quantity])
    motion = [
        Panel(what, readable(unit), (Series(what, factor * x, "measured"),))
        for what, x in (("position", q), ("velocity", dq))
        for factor, unit in [scaled(x, units[what])]
    ]
    shown = (  # a simulation may begin with a jump, beside which nothing would be seen
        Panel(quantity, readable(unit), forces, inner_limits(*(s.values for s in forces))),
        Panel(
            f"{quantity} error",
            readable(error_unit),
            pair(lambda error: fine * error),
            inner_limits(fine * keep),
        ),
        *motion,
    )
    events = tuple(
        Region(a, b, f"{a:.1f}–{b:.1f} s stands out") for a, b in panels.events(diagnosis)
    )
    return Chart(name, record.t, shown, caption, (*worst(record.t, keep), *events[:8]))


def worst_second(diagnosis: Diagnosis) -> Sheet:
    """Draw the forces around the worst second, and their difference."""
    with look():
        figure = sheet(_NARROW_MM, 65.0)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        rows = panels.worst_second(panels.traces_of(diagnosis))
        panels.force(upper, diagnosis, rows)
        panels.difference(lower, diagnosis, rows)
        lower.set_xlabel("time, s")
    return figure


Drawn = tuple[str, Callable[[Any], Sheet], str]  # name, function and caption of a figure

#: Figures of a page, by the question that they answer.
WHERE: tuple[Drawn, ...] = (
    ("error", error, "The force error over time, faint where it does not count."),
    (
        "regions",
        regions,
        "Share of the error's energy by region of the motion, against the share of the time: an "
        "effect sits where the one is larger than the other.",
    ),
    ("plane", plane, "The error over position and velocity."),
    ("spectrum", spectrum, "The spectrum of the error, and of the floor."),
)
WHICH: tuple[Drawn, ...] = (
    (
        "which",
        which,
        "Share of the reducible gap that each effect closes by itself, on held-out data; hatched "
        "where it is estimated to first order.",
    ),
)
HOW_FAR: tuple[Drawn, ...] = (
    (
        "how-far",
        before_and_after,
        "Force error on held-out data, with the floor and, where something is named, the 95 % "
        "interval.",
    ),
    (
        "worst-second",
        worst_second,
        "Measured and simulated force around the worst second; below, their difference.",
    ),
)

_NAMELESS: Drawn = (
    "nameless",
    nameless,
    "The force that the drive must make beyond the model, and that is not among the known effects: "
    "its mean over one signal, forwards and backwards, whatever else it depends on.",
)


def nameless_of(diagnosis: Diagnosis) -> tuple[Drawn, ...]:
    """Return the figure of a force without a name, if one has a curve: of two directions."""
    left = diagnosis.nameless
    return (_NAMELESS,) if left is not None and left.curve else ()


def _title(diagnosis: Diagnosis) -> str:
    named = ", ".join(diagnosis.effects) or "no effect named"
    return f"{diagnosis.name}: {diagnosis.verdict} ({named})"
