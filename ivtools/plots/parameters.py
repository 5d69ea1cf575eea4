"""Parameters of several results side by side, with their confidence intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from ivtools.comparison_table import labels_of
from ivtools.plots.style import COLOURS, MARKERS, WIDTH_MM, Sheet, look, readable, sheet

if TYPE_CHECKING:
    from ivtools.comparison import Comparison
    from ivtools.results import FitResults


def parameters(
    results: Comparison | Sequence[FitResults],
    *,
    truth: Mapping[str, float] | None = None,
    level: float = 0.95,
    width_mm: float = WIDTH_MM,
) -> Sheet:
    """Draw every parameter in a panel of its own: one point and interval per result.

    Parameters
    ----------
    results : Comparison or sequence of FitResults
        Of one record, by different methods or models.
    truth : mapping of str to float, optional
        True values, drawn as dashed lines.
    level : float
        Of the confidence intervals.
    width_mm : float
        Width of the figure, mm.

    Returns
    -------
    Figure

    Examples
    --------
    >>> import ivtools as iv
    >>> fit = iv.IDIMLS().fit(iv.Problem(iv.datasets.twin(), iv.axes.emps()))
    >>> len(parameters([fit]).axes)
    4
    """
    fits = list(results if isinstance(results, Sequence) else results.results)
    names = list(dict.fromkeys(name for fit in fits for name in fit.names))
    labels = [
        label if fit.converged else f"{label} (not converged)"
        for label, fit in zip(labels_of(fits), fits, strict=True)
    ]
    rows = -(-len(names) // 2)
    with look():
        figure = sheet(width_mm, 10.0 + rows * (11.5 + 3.6 * len(fits)))
        panels = np.ravel(figure.subplots(rows, 2, squeeze=False, sharey=True))
        for axes, name in zip(panels, names, strict=False):
            _panel(axes, name, fits, level)
            if truth and name in truth:
                axes.axvline(truth[name], color=COLOURS["truth"], lw=0.9, ls=(0, (4, 2)))
        for axes in panels[len(names) :]:
            axes.set_visible(False)
        panels[0].set_yticks(range(len(fits)), labels)
        panels[0].set_ylim(len(fits) - 0.5, -0.5)
        known = " (dashed: true value)" if truth and set(truth) & set(names) else ""
        figure.suptitle(f"Estimates with {100 * level:g} % intervals{known}", fontsize=7.5)
    return figure


def _panel(axes: Axes, name: str, fits: Sequence[FitResults], level: float) -> None:
    """Draw one parameter of every result that has it."""
    unit = ""
    for k, fit in enumerate(fits):
        if name not in fit.names:
            continue
        unit = dict(zip(fit.names, fit.units, strict=False)).get(name, unit)
        value, ends = float(fit.params[name]), fit.conf_int(1.0 - level)
        reach = [[value - float(ends["lower"][name])], [float(ends["upper"][name]) - value]]
        axes.errorbar(
            value,
            k,
            xerr=np.nan_to_num(np.asarray(reach)),
            fmt=MARKERS[k % len(MARKERS)],
            mfc=None if fit.converged else "none",
            color=COLOURS["series"][k % len(COLOURS["series"])],
            ms=3.4,
            lw=1.1,
            capsize=2.0,
        )
    axes.set_xlabel(f"{shown_name(name)}, {readable(unit)}" if unit else shown_name(name))
    axes.margins(x=0.12)
    axes.locator_params(axis="x", nbins=4)
    axes.grid(axis="y", visible=False)


def shown_name(name: str) -> str:
    """Return a parameter's name as it is printed.

    Examples
    --------
    >>> shown_name("viscous_pos")
    'viscous (+)'
    """
    for end, sign in (("_pos", " (+)"), ("_neg", " (\u2212)")):
        if name.endswith(end):
            return name.removesuffix(end) + sign
    return name.replace("_", " ")
