"""Identify the dynamics of a controlled axis, simulate it, and name what the simulation lacks.

The public names are loaded when they are first used, so ``import ivtools`` is quick::

    import ivtools as iv

    record = iv.datasets.emps()
    problem = iv.Problem(record, iv.axes.emps())
    print(iv.IDIMLS().fit(problem).summary())
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # for type checkers and editors; at run time __getattr__ does it
    from ivtools import axes as axes
    from ivtools import datasets as datasets
    from ivtools import errors as errors
    from ivtools import estimators as estimators
    from ivtools.comparison import compare as compare
    from ivtools.estimators.compensated import IDIMBCIV as IDIMBCIV
    from ivtools.estimators.instrumental import IDIMIV as IDIMIV
    from ivtools.estimators.least_squares import IDIMLS as IDIMLS
    from ivtools.estimators.least_squares import IDIMWLS as IDIMWLS
    from ivtools.estimators.refined import IDIMPIV as IDIMPIV
    from ivtools.hypothesis import TestResult as TestResult
    from ivtools.loop import ClosedLoop as ClosedLoop
    from ivtools.loop import RobotLoop as RobotLoop
    from ivtools.pipeline import Pipeline as Pipeline
    from ivtools.problem import Problem as Problem
    from ivtools.record import Record as Record
    from ivtools.results import FitResults as FitResults
    from ivtools.robot import Robot as Robot
    from ivtools.simulators import MujocoSimulator as MujocoSimulator
    from ivtools.simulators import Simulator as Simulator

__version__ = "1.0.0"

_MODULES = ("axes", "datasets", "errors", "estimators", "plots")
_ESTIMATORS = [  # fmt: skip
    "IDIMLS",
    "IDIMWLS",
    "IDIMIV",
    "IDIMBCIV",
    "IDIMPIV",
    "DIDIM",
    "CLIE",
    "CLOE",
    "OLOE",
    "DDMLS",
    "DDMIV",
    "ML",
    "SetMembership",
    "LMILS",
    "LMIIV",
    "NSGA2",
    "SRIVC",
    "RIVC",
    "CLSRIVC",
    "SRIV",
    "RIVBJ",
    "StateDependentFriction",
]
_NAMES = {
    "Record": "record",
    "Pipeline": "pipeline",
    "ClosedLoop": "loop",
    "Robot": "robot",
    "RobotLoop": "loop",
    "Problem": "problem",
    "FitResults": "results",
    "TestResult": "hypothesis",
    "compare": "comparison",
    **dict.fromkeys(_ESTIMATORS, "estimators"),
    "drive_gain": "estimators.drive_gain",
    "Case": "study",
    "Study": "study",
    "Simulator": "simulators",
    "MujocoSimulator": "simulators",
    "diagnose": "gap",
    "diagnose_fleet": "gap",
    "diagnose_robot": "gap",
}

__all__ = sorted([*_MODULES, *_NAMES])  # noqa: PLE0605


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"ivtools.{name}")
    if name not in _NAMES:
        raise AttributeError(f"module 'ivtools' has no attribute {name!r}")
    value = getattr(import_module(f"ivtools.{_NAMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
