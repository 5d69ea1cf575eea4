"""The estimators: frozen configurations whose `fit(problem)` returns a new FitResults."""

from typing import Any

from ivtools.estimators.base import METHODS as METHODS
from ivtools.estimators.base import Estimator as Estimator
from ivtools.estimators.base import estimator_class
from ivtools.estimators.base import reduce as reduce

_CLASSES = {target.split(":")[1]: name for name, target in METHODS.items()}

__all__ = ["METHODS", "Estimator", "reduce", *_CLASSES]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    if name not in _CLASSES:
        raise AttributeError(f"module 'ivtools.estimators' has no attribute {name!r}")
    return estimator_class(_CLASSES[name])
