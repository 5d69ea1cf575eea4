"""A chart: signals over time that a page zooms, in panels that share their time axis.

A page cannot hold every sample of every signal, so a chart keeps all samples where it matters and
elsewhere the least and the greatest of each stretch, which look the same at that width.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

STRETCHES = 1200  # of a decimated record: two values each, more than a wide screen has pixels
WHOLE = 4000  # samples that are kept as they are, around what is `near`


@dataclass(frozen=True)
class Series:
    """One signal of a panel.

    Attributes
    ----------
    label : str
    values : ndarray, (n_samples,)
        In the panel's unit; NaN is a gap.
    role : str
        Says the colour: measured, model, before, after, error or reference.
    """

    label: str
    values: Array
    role: str


@dataclass(frozen=True)
class Panel:
    """Signals of one quantity.

    Attributes
    ----------
    quantity, unit : str
        The axis is labelled "quantity, unit".
    series : tuple of Series
    limits : (float, float) or None
        Range of the axis while the whole record is shown; None fits the signals.
    """

    quantity: str
    unit: str
    series: tuple[Series, ...]
    limits: tuple[float, float] | None = None


@dataclass(frozen=True)
class Region:
    """A stretch of time that a reader can jump to, s; shaded if it stands out."""

    start: float
    stop: float
    label: str
    shaded: bool = True


@dataclass(frozen=True)
class Chart:
    """A figure on a page whose time axis can be zoomed.

    Attributes
    ----------
    name : str
        Of the still picture's file when it is saved beside the page.
    t : ndarray, (n_samples,)
        Time, s.
    panels : tuple of Panel
    caption : str
        What it shows; also its text for those who cannot see it.
    regions : tuple of Region
        What the reader can jump to; their samples are kept whole as far as there is room.
    still : Figure or None
        The same as a picture for print.
    across : str
        Label of the horizontal axis.

    Examples
    --------
    >>> t = np.arange(50_000) / 1000
    >>> panel = Panel("force", "N", (Series("measured", np.sin(t), "measured"),))
    >>> Chart("force", t, (panel,), "A force.", (Region(3.0, 4.0, "here"),)).rows.size < 9_000
    True
    """

    name: str
    t: Array
    panels: tuple[Panel, ...]
    caption: str
    regions: tuple[Region, ...] = ()
    still: Figure | None = None
    across: str = "time, s"
    wide = True

    @property
    def alt(self) -> str:
        """The text in place of the chart."""
        return self.caption

    @cached_property
    def rows(self) -> NDArray[np.intp]:
        """Samples whose time is kept, (n,): two of each stretch, or the samples themselves."""
        starts, _, middles = self._stretches
        return np.sort(np.concatenate([starts, middles]))

    @cached_property
    def _stretches(self) -> tuple[NDArray[np.intp], NDArray[np.bool_], NDArray[np.intp]]:
        """Where stretches begin, which are longer than two samples, and the middles of those.

        Regions are stretches of one sample each, the first ones first, as long as there is room.
        """
        n = len(self.t)
        if n <= max(4 * STRETCHES, WHOLE):
            return np.arange(n), np.zeros(n, dtype=bool), np.arange(0)
        kept, room = [np.linspace(0, n, STRETCHES + 1).astype(int)[:-1]], WHOLE
        for region in self.regions:
            start, stop = np.searchsorted(self.t, (region.start, region.stop))
            stop = min(stop, start + room)
            kept.append(np.arange(start, min(stop + 1, n)))
            room -= stop - start
        starts = np.unique(np.concatenate(kept))
        length = np.diff(starts, append=n)
        starts = np.sort(np.concatenate([starts, starts[length == 2] + 1]))
        length = np.diff(starts, append=n)
        pairs = length > 2
        return starts, pairs, starts[pairs] + length[pairs] // 2

    def window(self, start: float, stop: float) -> Chart:
        """Return the part between two times, s, and a sample beside it at either end."""
        first, last = (int(i) for i in np.searchsorted(self.t, (start, stop)))
        first = max(min(first - 1, len(self.t) - 2), 0)
        rows = slice(first, max(last + 1, first + 2))
        panels = tuple(
            replace(p, series=tuple(replace(s, values=s.values[rows]) for s in p.series))
            for p in self.panels
        )
        return replace(self, t=self.t[rows], panels=panels)

    def content(self) -> dict[str, Any]:
        """Return what the page's script draws: texts, and arrays as base64."""
        begin = float(self.t[0]) if len(self.t) else 0.0
        return {
            "across": self.across,
            "begin": begin,
            "complete": not self._stretches[1].any(),
            "t": _packed((self.t[self.rows] - begin), np.float64),
            "panels": [
                {
                    "label": f"{panel.quantity}, {panel.unit}" if panel.unit else panel.quantity,
                    "unit": panel.unit,
                    "limits": panel.limits,
                    "series": [
                        {
                            "label": s.label,
                            "role": s.role,
                            "values": _packed(self.thinned(s.values)),
                        }
                        for s in panel.series
                    ],
                }
                for panel in self.panels
            ],
            "regions": [
                {"start": r.start, "stop": r.stop, "label": r.label, "shaded": r.shaded}
                for r in self.regions
            ],
        }

    def thinned(self, values: Array) -> Array:
        """Return a signal at the kept rows: a stretch's least, then its greatest value, (n,)."""
        values, (starts, pairs, middles) = np.ravel(values), self._stretches
        low, high = _extremes(values, starts)
        out = values[self.rows]
        out[np.searchsorted(self.rows, starts[pairs])] = low[pairs]
        out[np.searchsorted(self.rows, middles)] = high[pairs]
        return out


def _extremes(values: Array, starts: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return least and greatest of each stretch, NaN where all is."""
    low = np.minimum.reduceat(np.where(np.isnan(values), np.inf, values), starts)
    high = np.maximum.reduceat(np.where(np.isnan(values), -np.inf, values), starts)
    empty = low > high
    return np.where(empty, np.nan, low), np.where(empty, np.nan, high)


def _packed(values: Array, kind: type = np.float32) -> str:
    """Return numbers as base64 of their bytes, least byte first."""
    array = np.ascontiguousarray(values, dtype=np.dtype(kind).newbyteorder("<"))
    return b64encode(array.tobytes()).decode("ascii")


def inner_limits(*errors: Array) -> tuple[float, float] | None:
    """Return limits for all but the record's ends, where filters ring; None if they are alike."""
    kept = [x[len(x) // 50 : -(len(x) // 50) or None] for x in map(np.ravel, errors)]
    inner = np.concatenate([x[np.isfinite(x)] for x in kept])
    if not inner.size or not np.ptp(inner):
        return None
    margin = 0.15 * float(np.ptp(inner))
    return float(inner.min()) - margin, float(inner.max()) + margin


def worst(t: Array, error: Array, seconds: float = 1.0) -> tuple[Region, ...]:
    """Return the stretch of this length, s, in which the error has the most energy."""
    dt = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    width = round(seconds / dt) if dt > 0.0 else 0
    if not 1 < width < len(t) // 2:
        return ()
    energy = np.convolve(np.nan_to_num(np.ravel(error)) ** 2, np.ones(width), mode="valid")
    start = int(np.argmax(energy))
    label = f"worst second, {t[start]:.1f} s" if seconds == 1.0 else f"worst, {t[start]:.1f} s"
    return (Region(float(t[start]), float(t[start + width - 1]), label, shaded=False),)


def stills(figures: Iterable[Any]) -> list[tuple[str, Figure]]:
    """Return name and picture of every figure that has one."""
    found = ((f.name, f.still if isinstance(f, Chart) else f.figure) for f in figures)
    return [(name, figure) for name, figure in found if figure is not None]
