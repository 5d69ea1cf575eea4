"""A fleet at a glance: which effects by record, and how far each gap closes."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from ivtools.errors import DataError
from ivtools.plots.style import COLOURS, Sheet, look, sheet

if TYPE_CHECKING:
    from ivtools.gap.fleet import Entry, Fleet

WIDTH_MM = 170.0  # two columns
_ROW_MM, _LEAST_MM, _MOST_MM = 4.2, 55.0, 240.0
_LABELS = 60  # records that can have a label each
_EFFECTS = 12  # columns at most
_BEFORE, _AFTER = str(COLOURS["error"]), str(COLOURS["model"])
_FLOOR, _TWIN = "#009e73", "#e69f00"
_NOTHING, _FAILED = (0.5, 0.5, 0.5, 0.14), (0.0, 0.0, 0.0, 0.0)  # on light and on dark pages


def fleet(result: Fleet) -> Sheet:
    """Draw the effects by record, and the force error before and after.

    Parameters
    ----------
    result : Fleet

    Raises
    ------
    DataError
        If no record could be diagnosed.
    """
    if not result.done:
        raise DataError("no record could be diagnosed, so there is nothing to draw")
    height = min(max(_ROW_MM * len(result) + 38.0, _LEAST_MM), _MOST_MM)
    with look():
        figure = sheet(WIDTH_MM, height)
        room = min(0.4 + 0.4 * max(len(_columns(result)), 1), 3.0)
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=(room, 2))
        _matrix(left, result)
        _errors(right, result)
        figure.legend(
            handles=_keys(), loc="outside lower center", ncols=3, frameon=False, fontsize=6.5
        )
    return figure


def _columns(result: Fleet) -> list[str]:
    """Return the effects to show: the named ones, then those that cannot be told from them."""
    named = Counter(e for entry in result for e in entry.effects)
    twins = Counter(t for entry in result for t in _twins(entry) if t not in named)
    return [name for name, _ in (*named.most_common(), *twins.most_common())][:_EFFECTS]


def _twins(entry: Entry) -> set[str]:
    sets = (entry.content or {}).get("ambiguous_with", {})
    return {t for others in sets.values() for t in others}


def _matrix(axes: Axes, result: Fleet) -> None:
    names = _columns(result) or ["no effect named"]
    image = np.array([[_colour(entry, name) for name in names] for entry in result])
    if len(result) <= _LABELS:  # shapes, which take the colours of a dark page
        axes.set_xlim(-0.5, len(names) - 0.5)
        for (i, j), colour in zip(np.ndindex(image.shape[:2]), image.reshape(-1, 4), strict=True):
            axes.add_patch(Rectangle((j - 0.5, i - 0.5), 1.0, 1.0, color=tuple(colour), lw=0.0))
    else:
        axes.imshow(image, aspect="auto", interpolation="nearest")
    axes.set_xticks(range(len(names)), names, rotation=35, ha="right", rotation_mode="anchor")
    axes.set_xticks(np.arange(len(names) + 1) - 0.5, minor=True)
    axes.set_yticks(np.arange(len(result) + 1) - 0.5, minor=True)
    axes.grid(False)
    if len(result) <= _LABELS:
        axes.grid(True, which="minor", color="white", linewidth=1.0)
    axes.tick_params(which="both", length=0)
    step = max(int(np.ceil(len(result) / _LABELS)), 1)
    rows = range(0, len(result), step)
    axes.set_yticks(rows, [_label(result.entries[i]) for i in rows])
    axes.spines[:].set_visible(False)
    axes.set_title("effects", loc="left")


def _label(entry: Entry) -> str:
    name = entry.name if len(entry.name) <= 24 else f"{entry.name[:23]}…"
    if entry.content is None:
        return f"{name} (failed)"
    return name if entry.shrink else f"{name} (not judged)"


def _colour(entry: Entry, name: str) -> tuple[float, float, float, float]:
    if not entry.shrink:
        return _FAILED
    if name in entry.effects:
        return to_rgba(_AFTER)
    return to_rgba(_TWIN) if name in _twins(entry) else _NOTHING


def _errors(axes: Axes, result: Fleet) -> None:
    size = 3.2 if len(result) <= _LABELS else 1.8
    for i, entry in enumerate(result):
        s = entry.shrink
        if not s:
            continue
        axes.plot([s["before"], s["after"]], [i, i], color="#c8c8c8", linewidth=1.2, zorder=1)
        axes.plot(s["before"], i, "o", color=_BEFORE, markersize=size)
        axes.plot(s["interval"], [i, i], color=_AFTER, linewidth=2.6, alpha=0.45, zorder=2)
        axes.plot(s["after"], i, "o", color=_AFTER, markersize=size)
        axes.plot(s["floor"], i, "|", color=_FLOOR, markersize=2 * size, markeredgewidth=1.3)
    axes.set_xlim(0.0, 1.05 * axes.get_xlim()[1])
    axes.set_ylim(len(result) - 0.5, -0.5)
    axes.tick_params(axis="y", which="both", length=0)
    axes.set_xlabel(f"force error, {result.unit} rms")
    axes.set_title("before and after", loc="left")


def _keys() -> list[Patch | Line2D]:
    return [
        Patch(color=_AFTER, label="named"),
        Patch(color=_TWIN, label="cannot be told from it"),
        Patch(color=_NOTHING, label="not named"),
        _mark(_BEFORE, "o", 3.2, "before"),
        _mark(_AFTER, "o", 3.2, "after, with 95 % interval"),
        _mark(_FLOOR, "|", 6.0, "floor"),
    ]


def _mark(colour: str, marker: str, size: float, label: str) -> Line2D:
    return Line2D([], [], color=colour, linestyle="", marker=marker, markersize=size, label=label)
