"""Figures of a robot's fit that one axis does not have: per joint, and per link."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ivtools.errors import IVToolsError
from ivtools.loop import RobotLoop
from ivtools.units import JOINTS

if TYPE_CHECKING:
    from ivtools.results import FitResults


def joint_figures(fit: FitResults) -> dict[str, dict[str, float]]:
    """Return relative error (%) and rmse (N m or N) of the force per joint; none for one axis.

    Parameters
    ----------
    fit : FitResults
    """
    problem = fit.problem
    if problem is None or not isinstance(problem.loop, RobotLoop):
        return {}
    joints = problem.row_joints
    if len(joints) != len(fit.resids):
        return {}
    found = {}
    for j, name in enumerate(problem.loop.joints):
        error, force = fit.resids[joints == j], fit.y[joints == j]
        found[name] = {
            "relative_error": 100.0 * float(np.linalg.norm(error) / np.linalg.norm(force)),
            "rmse": float(np.sqrt(np.mean(error**2))),
        }
    return found


def joint_notes(fit: FitResults) -> list[str]:
    """Return one line per joint with its errors."""
    lines = []
    for j, (name, error) in enumerate(joint_figures(fit).items()):
        assert fit.problem is not None
        unit = JOINTS[fit.problem.loop.kind_of(j)].force
        share, rmse = error["relative_error"], error["rmse"]
        lines.append(f"{name}: {share:.2f} % of the force, {rmse:.3g} {unit} rms")
    return lines


def robot_dict(fit: FitResults) -> dict[str, Any]:
    """Return what a robot's JSON has beside an axis's: joints, base, standard; {} for one axis."""
    problem = fit.problem
    if problem is None or not isinstance(problem.loop, RobotLoop):
        return {}
    loop, values = problem.loop, {str(k): float(v) for k, v in fit.params.items()}
    links = len(loop.robot.standard_names)
    base = {n for n, c in zip(loop.base.names, loop.base.columns, strict=True) if c < links}
    try:
        consistent = loop.consistent(values, fit.X)[:links]
        standard: dict[str, Any] = {"standard": loop.robot.links(consistent.reshape(-1, 10))}
    except IVToolsError as error:  # no cvxpy, or no solution
        standard = {"standard": None, "standard_reason": str(error)}
    return {
        "joints": joint_figures(fit),
        "base": {name: value for name, value in values.items() if name in base},
        "formulas": {n: f for n, f in loop.base.formulas.items() if n in base},
    } | standard
