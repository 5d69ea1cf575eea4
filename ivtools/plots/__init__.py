"""Figures: one function each, returning a matplotlib Figure that a paper can print.

Figures are 80 mm wide, one column of a journal, with 7 pt letters; `style.save` writes them as
SVG, PDF or PNG; what runs over time is also made as a `chart.Chart`, which a page can zoom. No
function here touches pyplot or its state.
"""

from __future__ import annotations

from ivtools.plots.force import force, force_chart
from ivtools.plots.friction_curve import friction_curve
from ivtools.plots.joint_forces import joint_forces, joint_simulation
from ivtools.plots.methods import (
    drive_gain,
    feasible_set,
    leaderboard,
    pareto,
    transfer_function,
)
from ivtools.plots.parameters import parameters
from ivtools.plots.residuals import residuals
from ivtools.plots.simulation import simulation, simulation_chart
from ivtools.plots.style import Sheet, save
from ivtools.plots.whiteness import whiteness

__all__ = [
    "Sheet",
    "drive_gain",
    "feasible_set",
    "force",
    "force_chart",
    "joint_forces",
    "joint_simulation",
    "friction_curve",
    "leaderboard",
    "parameters",
    "pareto",
    "residuals",
    "save",
    "simulation",
    "simulation_chart",
    "transfer_function",
    "whiteness",
]
