"""What all figures share: size, letters, colours, units, and how they are written."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from html import escape
from io import BytesIO
from pathlib import Path
from threading import RLock
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ..files import write
from ..units import prefixed

Array = NDArray[np.float64]

MM = 1.0 / 25.4  # inches
WIDTH_MM = 80.0  # one column of a journal

#: Colours that the colour-blind tell apart (Okabe, Ito 2008), and grey levels that differ too.
COLOURS = {
    "measured": "#56b4e9",
    "model": "#a03c00",
    "error": "#4d4d4d",
    "truth": "#000000",
    "series": ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"),
}
#: Colours that a page has its own of, light or dark.
_THEMED = {
    "#ffffff": "paper",
    "#000000": "ink",
    "#e4e4e4": "grid",
    "#4d4d4d": "error",
    "#56b4e9": "measured",
    "#a03c00": "model",
    "#57606a": "soft",
    "#c8c8c8": "other",
    "#009e73": "reference",
}
MARKERS = "osD^vP*X"
_STRETCHES = 800  # that a picture of a long signal tells apart

_STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 7.0,
    "axes.titlesize": 7.5,
    "axes.labelsize": 7.0,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "legend.fontsize": 6.5,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "lines.linewidth": 0.9,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "svg.fonttype": "path",
    "svg.hashsalt": "ivtools",
    "agg.path.chunksize": 20000,
}
_FREE: Mapping[str, dict[str, Any]] = {  # the same figure is the same file
    "svg": {"Date": None},
    "pdf": {"CreationDate": None},
    "png": {"Software": None},
}


class Sheet(Figure):
    """A matplotlib Figure that shows itself in a notebook without pyplot."""

    def _repr_png_(self) -> bytes:
        return encode(self, "png", dpi=160)


_DRAWING = RLock()


@contextmanager
def look() -> Iterator[None]:
    """Apply the style to what is drawn inside the block, and to nothing else.

    One thread draws at a time: Matplotlib's settings are those of the whole process.
    """
    with _DRAWING, mpl.rc_context(_STYLE):
        yield


def sheet(width_mm: float, height_mm: float) -> Sheet:
    """Return an empty figure of this size; call it inside `look`."""
    return Sheet(figsize=(width_mm * MM, height_mm * MM), layout="constrained", dpi=200)


def line(axes: Axes, t: Array, x: Array, **options: Any) -> None:
    """Draw a signal; of one with many samples the least and greatest of each stretch."""
    t, x = np.ravel(t), np.ravel(x)
    if len(t) > 4 * _STRETCHES:
        starts = np.linspace(0, len(t), _STRETCHES + 1).astype(int)[:-1]
        t = np.repeat(t[starts], 2)
        x = np.stack([np.fmin.reduceat(x, starts), np.fmax.reduceat(x, starts)], axis=1).ravel()
    axes.plot(t, x, **options)


def parted(t: Array, *signals: Array) -> tuple[Array, ...]:
    """Return time and signals with a NaN where rows are left out: no line is drawn there.

    Examples
    --------
    >>> t, x = parted(np.array([0.0, 1.0, 2.0, 9.0]), np.ones(4))
    >>> t.tolist(), x.tolist()
    ([0.0, 1.0, 2.0, 5.5, 9.0], [1.0, 1.0, 1.0, nan, 1.0])
    """
    steps = np.diff(t)
    after = np.flatnonzero(steps > 5.0 * np.median(steps)) + 1 if steps.size else np.arange(0)
    middles = 0.5 * (t[after - 1] + t[after])
    return np.insert(t, after, middles), *(np.insert(x, after, np.nan) for x in signals)


def fit_to_inner(axes: Axes, *errors: Array) -> None:
    """Scale an error axis to all but the record's ends, where filters ring.

    What is larger there runs off the axes, in sight.
    """
    known = [x[np.isfinite(x)] for x in map(np.ravel, errors)]
    x = np.concatenate(known)
    inner = np.concatenate([_inner(error) for error in known])
    low, high = float(inner.min()), float(inner.max())
    if np.ptp(x) > 1.5 * (high - low) > 0.0:
        margin = 0.15 * (high - low)
        axes.set_ylim(low - margin, high + margin)


def _inner(x: Array) -> Array:
    """Return a signal without a fiftieth at either end."""
    return x[len(x) // 50 : -(len(x) // 50) or None]


def legend_above(axes: Axes, columns: int = 3) -> None:
    """Put the legend between the axes and their title, where it hides nothing."""
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=columns,
        borderaxespad=0.1,
        handlelength=1.4,
        columnspacing=1.0,
        handletextpad=0.5,
    )


def readable(unit: str) -> str:
    """Return a unit as it is printed on an axis: m/s2 becomes m/s².

    Examples
    --------
    >>> readable("kg m2")
    'kg m²'
    """
    return unit.replace("2", "²").replace("3", "³")


def units_of(joint: str) -> dict[str, str]:
    """Return the units of the signals of a prismatic or revolute joint."""
    length, force = ("m", "N") if joint == "prismatic" else ("rad", "N m")
    return {
        "position": length,
        "velocity": f"{length}/s",
        "acceleration": f"{length}/s2",
        "force": force,
        "torque": force,
    }


def scaled(x: Array, unit: str) -> tuple[float, str]:
    """Return a factor and the unit that make a small signal readable: 2e-5 m is 20 µm.

    Examples
    --------
    >>> scaled(np.array([2e-5, -1e-5]), "m")
    (1000000.0, 'µm')
    >>> scaled(np.array([3.0]), "N m")
    (1.0, 'N m')
    """
    return prefixed(float(np.max(np.abs(x), initial=0.0)), unit)


def encode(figure: Figure, kind: str = "svg", dpi: int = 200) -> bytes:
    """Return a figure as an SVG, PDF or PNG file."""
    buffer = BytesIO()
    with look():
        figure.savefig(buffer, format=kind, dpi=dpi, metadata=_FREE.get(kind))
    return buffer.getvalue()


def inline(figure: Figure, name: str, alt: str) -> str:
    """Return a figure as an SVG element of a page, in the page's own colours.

    Parameters
    ----------
    figure : Figure
    name : str
        Makes the identifiers of the element its own.
    alt : str
        What it shows, for those who cannot see it.
    """
    text = encode(figure, "svg").decode("utf-8")
    text = text[text.index("<svg") :]
    text = re.sub(r' xmlns(:\w+)?="[^"]*"', "", text)  # a page knows them
    text = re.sub(r"\s*<metadata>.*?</metadata>", "", text, count=1, flags=re.DOTALL)
    text = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{re.sub(r'[^A-Za-z0-9]', '-', name)}-", text)
    for colour, variable in _THEMED.items():
        text = text.replace(colour, f"var(--{variable})")
    return text.replace("<svg", f'<svg role="img" aria-label="{escape(alt, quote=True)}"', 1)


def save(figure: Figure, path: str | Path, dpi: int = 200) -> Path:
    """Write a figure; the suffix of the path says as what.

    Parameters
    ----------
    figure : Figure
        As the functions of `ivtools.plots` return it.
    path : str or Path
        Ends in svg, pdf or png; its folder is made.
    dpi : int
        Pixels per inch of what is drawn in pixels.

    Returns
    -------
    Path
    """
    path = Path(path)
    return write(path, encode(figure, path.suffix[1:] or "svg", dpi))
