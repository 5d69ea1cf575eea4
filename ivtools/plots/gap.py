"""The sim-to-real gap at a glance: where it sits, which effect it is, how far it closes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from ivtools.errors import DataError
from ivtools.plots.style import COLOURS, Sheet, legend_above, line, look, readable, sheet

if TYPE_CHECKING:
    from ivtools.gap.diagnosis import Diagnosis, Traces

WIDTH_MM = 170.0  # two columns
_BEFORE, _AFTER = COLOURS["error"], COLOURS["model"]
_PARTS = (
    "reversal",
    "acceleration",
    "constant speed",
    "pulse edges",
    "forward",
    "backward",
    "low speed",
    "middle speed",
    "high speed",
)


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
        figure = sheet(WIDTH_MM, 110.0)
        axes = figure.subplots(2, 2, width_ratios=(3, 2))
        _error(axes[0, 0], diagnosis)
        _ranking(axes[0, 1], diagnosis)
        _worst(axes[1, 0], diagnosis)
        _shrink(axes[1, 1], diagnosis)
        figure.suptitle(_title(diagnosis), fontsize=8)
    return figure


def where(diagnosis: Diagnosis) -> Sheet:
    """Draw where the gap sits: over time, position and velocity, by region, and in frequency."""
    with look():
        figure = sheet(WIDTH_MM, 110.0)
        axes = figure.subplots(2, 2, width_ratios=(3, 2))
        _error(axes[0, 0], diagnosis)
        _regions(axes[0, 1], diagnosis)
        _plane(axes[1, 0], diagnosis)
        _spectrum(axes[1, 1], diagnosis)
    return figure


def which(diagnosis: Diagnosis) -> Sheet:
    """Draw the ranking of the effects."""
    with look():
        figure = sheet(80.0, 70.0)
        _ranking(figure.subplots(), diagnosis)
    return figure


def how_far(diagnosis: Diagnosis) -> Sheet:
    """Draw the gap before and after, and the forces around the worst second."""
    with look():
        figure = sheet(WIDTH_MM, 60.0)
        axes = figure.subplots(1, 2, width_ratios=(2, 3))
        _shrink(axes[0], diagnosis)
        _worst(axes[1], diagnosis)
    return figure


#: Name, function and caption of every figure of a page.
SET = (
    (
        "where",
        where,
        "Where the gap sits: force error over time, share of its energy by region "
        "against the share of the time, over the position-velocity plane, and spectrum",
    ),
    (
        "which",
        which,
        "Which effect: share of the reducible gap that each effect closes alone on held-out data",
    ),
    (
        "how-far",
        how_far,
        "How far: force error before and after, with its 95 % interval and the "
        "floor; measured and simulated force around the worst second",
    ),
)


def _traces(diagnosis: Diagnosis) -> Traces:
    if diagnosis.traces is None:
        raise DataError("the record did not allow a comparison; its findings say why")
    return diagnosis.traces


def _title(diagnosis: Diagnosis) -> str:
    named = ", ".join(diagnosis.effects) or "no effect named"
    return f"{diagnosis.name}: {diagnosis.verdict} ({named})"


def _unit(diagnosis: Diagnosis) -> str:
    return "N" if diagnosis.loop.joint == "prismatic" else "N m"


def _error(axes: Axes, diagnosis: Diagnosis) -> None:
    traces = _traces(diagnosis)
    t = traces.record.t
    line(axes, t, traces.before, color=_BEFORE, label="before", linewidth=0.5)
    line(axes, t, traces.after, color=_AFTER, label="after", linewidth=0.5)
    for level in diagnosis.floors[-1:]:
        for start, stop in level.events[:5]:
            axes.axvspan(start, stop, color="#f0e442", alpha=0.5, linewidth=0)
    size = 1.3 * np.quantile(np.abs(traces.before[traces.keep]), 0.999)
    axes.set_ylim(-size, size)
    axes.set_xlabel("time, s")
    axes.set_ylabel(f"force error, {_unit(diagnosis)}")
    legend_above(axes)


def _regions(axes: Axes, diagnosis: Diagnosis) -> None:
    shown = [r for r in diagnosis.regions if r.name in _PARTS]
    y = np.arange(len(shown))[::-1]
    axes.barh(y + 0.27, [100 * r.energy for r in shown], 0.26, color=_BEFORE, label="before")
    axes.barh(y, [100 * r.after for r in shown], 0.26, color=_AFTER, label="after")
    axes.barh(y - 0.27, [100 * r.time for r in shown], 0.26, color="#c8c8c8", label="time")
    axes.set_yticks(y, [r.name for r in shown])
    axes.set_xlabel("share of the error's energy, and of the time, %")
    legend_above(axes)


def _plane(axes: Axes, diagnosis: Diagnosis) -> None:
    traces = _traces(diagnosis)
    q = traces.record.q[:, 0]
    v = np.gradient(q, traces.record.dt)
    v = np.convolve(v, np.ones(15) / 15, mode="same")
    rows = np.flatnonzero(traces.keep)[:: max(len(q) // 5000, 1)]
    size = np.quantile(np.abs(traces.before[rows]), 0.98)
    points = axes.scatter(
        q[rows],
        v[rows],
        c=traces.before[rows],
        s=1.5,
        cmap="RdBu_r",
        vmin=-size,
        vmax=size,
        rasterized=True,
        linewidths=0,
    )
    length = "m" if diagnosis.loop.joint == "prismatic" else "rad"
    axes.set_xlabel(f"position, {length}")
    axes.set_ylabel(f"velocity, {length}/s")
    assert axes.figure is not None
    axes.figure.colorbar(points, ax=axes, label=f"force error before, {_unit(diagnosis)}")


def _spectrum(axes: Axes, diagnosis: Diagnosis) -> None:
    hz, before, after, floor = _traces(diagnosis).spectra
    for values, colour, label in (
        (before, _BEFORE, "before"),
        (after, _AFTER, "after"),
        (floor, "#009e73", "noise"),
    ):
        axes.loglog(hz[1:], values[1:], color=colour, label=label)
    axes.set_xlabel("frequency, Hz")
    axes.set_ylabel(f"{readable(_unit(diagnosis))}/√Hz")
    legend_above(axes)


def _ranking(axes: Axes, diagnosis: Diagnosis) -> None:
    shown = diagnosis.ranking[:10][::-1]
    twins = {x for e in diagnosis.ambiguous_with.values() for x in e}
    colours = [
        _AFTER if r.effect in diagnosis.effects else "#e69f00" if r.effect in twins else "#c8c8c8"
        for r in shown
    ]
    axes.barh(range(len(shown)), [100 * r.closed for r in shown], color=colours)
    axes.set_yticks(range(len(shown)), [r.effect for r in shown])
    axes.set_xlabel("closes alone, % of the reducible gap")
    axes.set_title("named: dark; not told from it: amber", loc="left")


def _shrink(axes: Axes, diagnosis: Diagnosis) -> None:
    s = diagnosis.shrink
    if s is None:
        raise DataError("the record did not allow a comparison; its findings say why")
    axes.bar((0, 1), (s.before, s.after), 0.6, color=(_BEFORE, _AFTER))
    low, high = s.interval
    axes.errorbar(
        [1],
        [s.after],
        [[max(s.after - low, 0.0)], [max(high - s.after, 0.0)]],
        color="black",
        capsize=3,
    )
    axes.axhline(s.floor, color="#009e73", linestyle="--", label="floor")
    axes.set_xticks((0, 1), ("before", "after"))
    axes.set_ylabel(f"force error, {s.unit} rms")
    axes.set_title(f"{100 * s.closed:.0f} % of the reducible gap closed", loc="left")


def _worst(axes: Axes, diagnosis: Diagnosis) -> None:
    traces = _traces(diagnosis)
    width = min(round(1.0 / traces.record.dt), len(traces.before) // 2)
    energy = np.convolve(
        np.where(traces.keep, traces.before, 0.0) ** 2, np.ones(width), mode="valid"
    )
    at = int(np.argmax(energy))
    rows = slice(at, at + width)
    t = traces.record.t[rows]
    axes.plot(t, traces.measured[rows], color=COLOURS["measured"], linewidth=1.6, label="measured")
    axes.plot(t, (traces.measured - traces.before)[rows], color=_BEFORE, label="before")
    axes.plot(t, (traces.measured - traces.after)[rows], color=_AFTER, label="after")
    axes.set_xlabel("time, s")
    axes.set_ylabel(f"force, {_unit(diagnosis)}")
    legend_above(axes)
