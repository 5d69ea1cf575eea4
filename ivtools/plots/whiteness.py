"""What the residual still knows: its autocorrelation and its spectrum."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy import signal

from ivtools.plots.style import COLOURS, Sheet, look, readable, sheet, units_of

if TYPE_CHECKING:
    from ivtools.results import FitResults

Array = NDArray[np.float64]

WIDTH_MM = 160.0
LAGS = 40


View = Literal["autocorrelation", "spectrum"]


def whiteness(results: FitResults, only: View | None = None) -> Sheet:
    """Draw the autocorrelation of the residual, with the band of white noise, and its spectrum.

    Parameters
    ----------
    results : FitResults
    only : {"autocorrelation", "spectrum"}, optional
        Draw one of the two, half as wide.

    Returns
    -------
    Figure

    Examples
    --------
    >>> import ivtools as iv
    >>> fit = iv.IDIMLS().fit(iv.Problem(iv.datasets.twin(), iv.axes.emps()))
    >>> len(whiteness(fit).axes)
    2
    """
    e = np.ravel(results.resids) - float(np.mean(results.resids))
    step = None if results.t is None else float(np.median(np.diff(results.t)))
    problem = results.problem
    joint = problem.loop.joint if problem is not None else "prismatic"
    with look():
        views = ("autocorrelation", "spectrum") if only is None else (only,)
        figure = sheet(0.5 * WIDTH_MM * len(views), 58.0)
        for axes, view in zip(figure.subplots(1, len(views), squeeze=False)[0], views, strict=True):
            if view == "autocorrelation":
                _autocorrelation(axes, e, step)
            else:
                _spectrum(axes, e, step, readable(units_of(joint)[results.signal]))
    return figure


def _autocorrelation(axes: Axes, e: Array, step: float | None) -> None:
    lags = np.arange(min(LAGS, len(e) - 1) + 1)
    power = float(e @ e) or 1.0
    values = [float(e[: len(e) - k] @ e[k:]) / power for k in lags]
    band = 1.96 / np.sqrt(len(e))
    scale = 1.0 if step is None else 1e3 * step
    axes.axhspan(-band, band, color="#c8c8c8", alpha=0.6, linewidth=0, label="95 % if white")
    axes.vlines(scale * lags, 0.0, values, color=COLOURS["model"], linewidth=1.1)
    axes.plot(scale * lags, values, "o", color=COLOURS["model"], markersize=2.2, label="residual")
    axes.set_xlabel("lag, rows" if step is None else "lag, ms")
    axes.set_ylabel("autocorrelation")
    axes.legend(loc="upper right")


def _spectrum(axes: Axes, e: Array, step: float | None, unit: str) -> None:
    hz, density = signal.welch(e, fs=1.0 / step if step else 1.0, nperseg=min(512, len(e)))
    axes.loglog(hz[1:], np.sqrt(density[1:]), color=COLOURS["model"])
    axes.set_xlabel("frequency, Hz" if step else "frequency, per row")
    axes.set_ylabel(f"residual, {unit}/√Hz" if step else f"residual, {unit}")
