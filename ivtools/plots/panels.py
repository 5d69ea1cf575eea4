"""Panels of the figures of a diagnosis: each draws one view into axes that it is given."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.patches import Patch

from ivtools.errors import DataError
from ivtools.plots.style import COLOURS, legend_above, line, readable, scaled, units_of
from ivtools.units import JOINTS, plain_number, prefixed

if TYPE_CHECKING:
    from ivtools.gap.diagnosis import Diagnosis
    from ivtools.gap.quantify import Shrink, Traces
    from ivtools.gap.verdict import Ranked

_BEFORE, _AFTER = str(COLOURS["error"]), str(COLOURS["model"])
_FLOOR, _TWIN, _OTHER, _EVENT = "#009e73", "#e69f00", "#c8c8c8", "#f0e442"
_RIGHT = "#9a9a9a"
_FAINT = 0.25
#: Below zero, zero, above: the middle is grey, so that it is quiet on light and dark paper.
_SIGNED = LinearSegmentedColormap.from_list("signed", ("#2166ac", "#a9a9a9", "#c22b1f"))
_WAYS = ((_AFTER, ">"), (str(COLOURS["measured"]), "<"))  # forwards, backwards
#: What a curve is drawn over, and the kind of its unit.
_ALONG = {
    "q": ("position", "position"),
    "dq": ("speed", "velocity"),
    "load": ("load", "force"),
    "drive": ("force of the drive", "force"),
}
_SHOWN = 10  # effects of a ranking
_BESIDE: dict[str, Any] = {
    "textcoords": "offset points",
    "va": "center",
    "fontsize": 6.0,
    "color": "#57606a",
}
_TIGHT: dict[str, Any] = {
    "borderaxespad": 0.1,
    "handlelength": 1.4,
    "columnspacing": 1.0,
    "handletextpad": 0.5,
}
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


def traces_of(diagnosis: Diagnosis) -> Traces:
    """Return the signals of a diagnosis; a `DataError` if it could not compare any."""
    if diagnosis.traces is None:
        raise DataError("the record did not allow a comparison; its findings say why")
    return diagnosis.traces


def _unit(diagnosis: Diagnosis) -> str:
    return JOINTS[diagnosis.loop.joint].force


def _sides(diagnosis: Diagnosis, before: Any, after: Any) -> list[tuple[Any, str, str]]:
    """Return what to draw, its colour and label: before and after, or one if nothing is named.

    Nothing is drawn of a loop that diverges.
    """
    if not diagnosis.effects:
        return [(before, _AFTER, "simulated")]
    if diagnosis.shrink is not None and diagnosis.shrink.diverges:
        return [(after, _AFTER, "after")]
    return [(before, _BEFORE, "before"), (after, _AFTER, "after")]


def error_over_time(axes: Axes, diagnosis: Diagnosis) -> None:
    """Draw the force error over time, faint where it does not count."""
    traces = traces_of(diagnosis)
    t, keep = traces.record.t, traces.keep
    for values, colour, label in _sides(diagnosis, traces.before, traces.after):
        line(axes, t, np.where(keep, np.nan, values), color=colour, linewidth=0.5, alpha=_FAINT)
        line(axes, t, np.where(keep, values, np.nan), color=colour, linewidth=0.5, label=label)
    for k, (start, stop) in enumerate(events(diagnosis)):
        once = "stands out once" if k == 0 else None
        axes.axvspan(start, stop, color=_EVENT, alpha=0.5, linewidth=0, label=once)
    size = 1.3 * np.quantile(np.abs(traces.before[keep]), 0.999)
    axes.set_ylim(-size, size)
    axes.set_xlabel("time, s")
    axes.set_ylabel(f"force error, {_unit(diagnosis)}")
    legend_above(axes)


def events(diagnosis: Diagnosis) -> list[tuple[float, float]]:
    """Return the stretches of the judging record that stand out and do not come again."""
    return [(a, b) for level in diagnosis.floors[-1:] if level.isolated for a, b in level.events]


def shares_by_region(axes: Axes, diagnosis: Diagnosis) -> None:
    """Draw the share of the energy, before and after, and of the time, by region."""
    shown = [r for r in diagnosis.regions if r.name in _PARTS]
    y = np.arange(len(shown))[::-1]
    both = _sides(diagnosis, [r.energy for r in shown], [r.after for r in shown])
    for place, (shares, colour, label) in zip((0.27, 0.0), both, strict=False):
        label = label if diagnosis.effects else "share of the error's energy"
        axes.barh(y + place, [100 * x for x in shares], 0.26, color=colour, label=label)
    axes.barh(
        y - 0.27 * (len(both) - 1),
        [100 * r.time for r in shown],
        0.26,
        color=_OTHER,
        label="share of time",
    )
    axes.set_yticks(y, [r.name for r in shown])
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel(f"share of the energy{' before' if diagnosis.effects else ''}, %")
    legend_above(axes)


def error_in_the_plane(axes: Axes, diagnosis: Diagnosis) -> None:
    """Draw the error before over position and velocity."""
    traces = traces_of(diagnosis)
    q = traces.record.q[:, 0]
    v = np.gradient(q, traces.record.dt)
    v = np.convolve(v, np.ones(15) / 15, mode="same")
    kept = np.flatnonzero(traces.keep)
    rows = kept[:: max(len(kept) // 5000, 1)]
    size = np.quantile(np.abs(traces.before[rows]), 0.98)
    units = units_of(diagnosis.loop.joint)
    q_factor, q_unit = scaled(q, units["position"])
    v_factor, v_unit = scaled(v, units["velocity"])
    points = axes.scatter(
        q_factor * q[rows],
        v_factor * v[rows],
        c=traces.before[rows],
        s=2.0,
        cmap=_SIGNED,
        vmin=-size,
        vmax=size,
        rasterized=True,
        linewidths=0,
    )
    axes.set_xlabel(f"position, {q_unit}")
    axes.set_ylabel(f"velocity, {v_unit}")
    assert axes.figure is not None
    before = " before" if diagnosis.effects else ""
    axes.set_title(f"force error{before}, {_unit(diagnosis)}", loc="left")
    axes.figure.colorbar(points, ax=axes, aspect=30, pad=0.02, extend="both")


def spectrum(axes: Axes, diagnosis: Diagnosis) -> None:
    """Draw the amplitude density of the error before and after, and of the floor."""
    hz, before, after, floor = traces_of(diagnosis).spectra
    both = _sides(diagnosis, before, after)
    for values, colour, label in (*both, (floor, _FLOOR, "floor")):
        axes.loglog(hz[1:], values[1:], color=colour, label=label)
    axes.set_xlabel("frequency, Hz")
    axes.set_ylabel(f"force error, {readable(_unit(diagnosis))}/√Hz")
    legend_above(axes)


def ranking(axes: Axes, diagnosis: Diagnosis) -> None:
    """Draw what each effect closes by itself."""
    shown = _chosen(diagnosis)[::-1]
    twins = {x: e for e, others in diagnosis.ambiguous_with.items() for x in others}
    for y, ranked in enumerate(shown):
        closed = 100 * ranked.closed
        mine, twin = ranked.effect in diagnosis.effects, twins.get(ranked.effect)
        axes.barh(
            y,
            closed,
            color=_AFTER if mine else _TWIN if twin else _OTHER,
            alpha=1.0 if ranked.held_out else 0.45,
            hatch=None if ranked.held_out else "////",
            edgecolor="white",
            linewidth=0.0,
        )
        told = f"may also be {twin}" if twin else ""
        if ranked.effect in diagnosis.beside:
            told = "named beside the others"
        axes.annotate(told, (closed, y), (3, 0), **_BESIDE)
    axes.set_yticks(range(len(shown)), [r.effect for r in shown])
    axes.tick_params(axis="y", length=0)
    axes.set_xlim(0.0, max(2.1 * 100 * max((r.closed for r in shown), default=0.0), 10.0))
    room = 140.0 if twins or diagnosis.beside else 102.0
    axes.set_xlim(right=min(axes.get_xlim()[1], room))
    axes.set_xlabel("closes by itself, % of the reducible gap")
    keys = [
        Patch(color=_AFTER, label="named"),
        Patch(color=_OTHER, label="not named"),
        Patch(facecolor=_OTHER, alpha=0.45, hatch="////", edgecolor="white", label="not fitted"),
    ]
    axes.legend(handles=keys, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, **_TIGHT)


def _chosen(diagnosis: Diagnosis) -> list[Ranked]:
    """Return the effects to show: the best ones, and whatever is named; largest first."""
    twins = {x for others in diagnosis.ambiguous_with.values() for x in others}
    needed = {*diagnosis.effects, *twins}
    first = [r for r in diagnosis.ranking if r.effect in needed]
    rest = [r for r in diagnosis.ranking if r.effect not in needed]
    return sorted([*first, *rest][:_SHOWN], key=lambda r: -r.closed)


def nameless(axes: Axes, diagnosis: Diagnosis) -> None:
    """Draw the mean of the force without a name over a signal, forwards and backwards."""
    left = diagnosis.nameless
    if left is None or not left.curve:
        raise DataError("there is no force without a name that has a curve")
    x, *ways = np.array(left.curve).T
    units = units_of(diagnosis.loop.joint)
    what, unit = _ALONG[left.along][0], units[_ALONG[left.along][1]]
    x_factor, x_unit = scaled(x, unit)
    factor, force_unit = scaled(np.array(ways), left.unit)
    looks = zip(ways, _WAYS, ("-", "--"), ("forwards", "backwards"), strict=True)
    for y, (colour, marker), dashes, label in looks:
        axes.plot(
            x_factor * x, factor * y, dashes, color=colour, marker=marker, markersize=3, label=label
        )
    axes.axhline(0.0, color=_OTHER, linewidth=0.6, zorder=1)
    within = " within a period" if left.period else ""
    axes.set_xlabel(f"{what}{within}, {readable(x_unit)}")
    axes.set_ylabel(f"force without a name, {readable(force_unit)}")
    legend_above(axes)


def before_and_after(axes: Axes, diagnosis: Diagnosis) -> None:
    """Draw the force error before and after, its interval, and the floor."""
    s = _found(diagnosis)
    before = s.after if s.diverges else s.before
    factor, unit = prefixed(max(before, s.after), s.unit)
    before, after, right, floor = (factor * x for x in (before, s.after, s.corrected, s.floor))
    bars = [(label, value, c) for value, c, label in _sides(diagnosis, before, after)]
    if s.put_right and diagnosis.effects:
        bars.insert(1, ("controller\nput right", right, _RIGHT))
    low, high = (factor * x for x in s.interval)
    last = len(bars) - 1
    for x, (_, value, colour) in enumerate(bars):
        axes.bar(x, value, 0.6, color=colour)
        top = value if x < last else max(value, high)
        axes.annotate(
            plain_number(value), (x, top), (0, 2), ha="center", textcoords="offset points"
        )
    if diagnosis.effects:
        reach = [[max(after - low, 0.0)], [max(high - after, 0.0)]]
        axes.errorbar([last], [after], reach, color="black", capsize=3)
    axes.axhline(floor, color=_FLOOR, linestyle="--")
    axes.annotate(
        f"floor {plain_number(floor, 2)}",
        (last + 0.5, floor),
        (0, 2),
        textcoords="offset points",
        color=_FLOOR,
    )
    axes.set_xlim(-0.5, last + 1.2)
    axes.set_ylim(0.0, 1.15 * max(before, after, high))
    axes.set_xticks(range(len(bars)), [name for name, _, _ in bars])
    axes.grid(False, axis="x")
    axes.set_ylabel(f"force error, {unit} rms")
    closed = f"{100 * s.closed:.0f} % of the reducible gap closed"
    axes.set_title(closed if diagnosis.effects else "nothing is named", loc="left")


def _found(diagnosis: Diagnosis) -> Shrink:
    if diagnosis.shrink is None:
        raise DataError("the record did not allow a comparison; its findings say why")
    return diagnosis.shrink


def worst_second(traces: Traces) -> slice:
    """Return the second with the largest energy of the error before."""
    width = min(round(1.0 / traces.record.dt), len(traces.before) // 2)
    energy = np.where(traces.keep, traces.before, 0.0) ** 2
    at = int(np.argmax(np.convolve(energy, np.ones(width), mode="valid")))
    return slice(at, at + width)


def force(axes: Axes, diagnosis: Diagnosis, rows: slice) -> None:
    """Draw measured and simulated force."""
    traces = traces_of(diagnosis)
    t = traces.record.t[rows]
    simulated = (traces.measured - error for error in (traces.before, traces.after))
    measured = traces.measured[rows]
    axes.plot(t, measured, color=str(COLOURS["measured"]), linewidth=2.0, label="measured")
    for values, colour, name in _sides(diagnosis, *simulated):
        label = f"simulated {name}" if diagnosis.effects else name
        axes.plot(t, values[rows], color=colour, linewidth=0.8, label=label)
    axes.set_ylabel(f"force, {_unit(diagnosis)}")
    legend_above(axes)


def difference(axes: Axes, diagnosis: Diagnosis, rows: slice) -> None:
    """Draw measured minus simulated force."""
    traces = traces_of(diagnosis)
    t = traces.record.t[rows]
    for values, colour, _ in _sides(diagnosis, traces.before, traces.after):
        axes.plot(t, values[rows], color=colour, linewidth=0.8)
    axes.set_ylabel(f"difference, {_unit(diagnosis)}")
