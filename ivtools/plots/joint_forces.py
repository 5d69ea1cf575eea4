"""The measured forces of a robot's joints against the reconstructed or simulated ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ivtools.plots.style import (
    COLOURS,
    Sheet,
    fit_to_inner,
    legend_above,
    line,
    look,
    parted,
    sheet,
)
from ivtools.units import JOINTS

if TYPE_CHECKING:
    from ivtools.loop import Simulation
    from ivtools.problem import Problem
    from ivtools.record import Record
    from ivtools.results import FitResults

Array = NDArray[np.float64]
Rows = Sequence[tuple[str, Array, Array, Array]]  # per joint: unit, t, measured, model, (N,) each

WIDTH_MM = 160.0  # two columns of a journal
_JOINT_MM = 26.0


def joint_forces(
    results: FitResults, problem: Problem | None = None, *, title: str | None = None
) -> Sheet:
    """Draw per joint the measured and the reconstructed force, their difference beside them.

    Parameters
    ----------
    results : FitResults
        Of a robot.
    problem : Problem, optional
        Another record to reconstruct with it (cross-test); default: its own.
    title : str, optional
        Default: method and relative error.

    Returns
    -------
    Figure
    """
    shown = problem or results.problem
    assert shown is not None  # a robot's fit has its problem
    model = shown.X @ results.params.to_numpy()
    rows = []
    for j in range(len(shown.loop.joints)):
        own = shown.row_joints == j
        rows.append((_unit(shown.loop.kind_of(j)), shown.t[own], shown.y[own], model[own]))
    what = "cross-test" if problem is not None else "relative error"
    error = 100.0 * np.linalg.norm(shown.y - model) / np.linalg.norm(shown.y)
    said = title or f"{results.method.upper()}: {what} {error:.3g} %"
    return _drawn(rows, shown.loop.joints, "reconstructed", said)


def joint_simulation(simulation: Simulation, record: Record, *, title: str | None = None) -> Sheet:
    """Draw per joint the measured and the simulated force, their difference beside them.

    Parameters
    ----------
    simulation : Simulation
        Of a robot's loop.
    record : Record
        What it is compared with.
    title : str, optional
    """
    loop = simulation.loop
    force = loop.force(record)  # (n_samples, n_joints)
    rows = [
        (_unit(loop.kind_of(j)), record.t, force[:, j], simulation.tau[:, j])
        for j in range(len(loop.joints))
    ]
    return _drawn(rows, loop.joints, "simulated", title or f"{loop.name}, simulated")


def _unit(kind: str) -> str:
    return JOINTS[kind].force


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _drawn(rows: Rows, names: Sequence[str], model: str, title: str) -> Sheet:
    with look():
        figure = sheet(WIDTH_MM, 14.0 + _JOINT_MM * len(rows))
        panels = figure.subplots(len(rows), 2, sharex=True, squeeze=False)
        for (left, right), (unit, t, y, fitted), name in zip(panels, rows, names, strict=True):
            t, y, fitted = parted(t, y, fitted)
            line(left, t, y, color=COLOURS["measured"], lw=1.5, label="measured")
            line(left, t, fitted, color=COLOURS["model"], lw=0.7, label=model)
            error = y - fitted
            line(right, t, error, color=COLOURS["error"], lw=0.6)
            known = error[np.isfinite(error)]
            if len(known):
                fit_to_inner(right, known)
                rms, whole = _rms(known), _rms(y[np.isfinite(error)])
                share = f", {100.0 * rms / whole:.3g} %" if whole > 0.0 else ""
                right.set_title(f"{rms:.3g} {unit} rms{share}", loc="right")
            left.set_ylabel(f"{name}, {unit}")
            right.set_ylabel(f"error, {unit}")
        for bottom in panels[-1]:
            bottom.set_xlabel("time, s")
        legend_above(panels[0, 0])
        figure.suptitle(title, fontsize=7.5)
        figure.align_ylabels()
    return figure
