"""The estimators: frozen configurations whose `fit(problem)` returns a new FitResults."""

from importlib import import_module
from typing import Any

from ivtools.estimators.base import METHODS as METHODS
from ivtools.estimators.base import Estimator as Estimator
from ivtools.estimators.base import estimator_class
from ivtools.estimators.base import reduce as reduce

_CLASSES = {target.split(":")[1]: name for name, target in METHODS.items()}
_OTHERS = {
    "StateDependentFriction": "state_dependent",
    "FrictionCurve": "friction_curve",
    "FeasibleSet": "feasible_set",
    "ParetoFront": "pareto_front",
    "SRIVC": "transfer_function",
    "RIVC": "box_jenkins",
    "SRIV": "box_jenkins",
    "RIVBJ": "box_jenkins",
    "CLSRIVC": "closed_loop_srivc",
    "FUNCTIONS": "base",
    "function_cases": "functions",
    "search_structures": "structure",
    "DriveGain": "drive_gain_results",
}

__all__ = ["METHODS", "Estimator", "reduce", *_CLASSES, *_OTHERS]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    if name in _OTHERS:
        return getattr(import_module(f"ivtools.estimators.{_OTHERS[name]}"), name)
    if name not in _CLASSES:
        raise AttributeError(f"module 'ivtools.estimators' has no attribute {name!r}")
    return estimator_class(_CLASSES[name])
