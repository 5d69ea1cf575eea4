"""The transfer-function methods by name, with the structures that an axis asks for."""

from __future__ import annotations

from importlib import import_module

from ivtools.errors import EstimationError
from ivtools.estimators.base import FUNCTIONS, METHODS
from ivtools.estimators.transfer_function import SRIVC


def function_class(key: str) -> type[SRIVC]:
    """Return the class of a transfer-function method by its name on the command line.

    Examples
    --------
    >>> function_class("rivbj").__name__
    'RIVBJ'
    """
    if key not in FUNCTIONS:
        known = ", ".join([*METHODS, *FUNCTIONS])
        raise EstimationError(f"method {key!r} is unknown; use one of {known}")
    module, name = FUNCTIONS[key].split(":")
    found: type[SRIVC] = getattr(import_module(f"ivtools.estimators.{module}"), name)
    return found


def function_cases(key: str) -> tuple[SRIVC, ...]:
    """Return a method's estimators of the plainest structures that a rigid axis has.

    Command to position (two poles, one of them an integrator), command to velocity (one pole), and
    reference to position (the whole loop, two poles); a sampled model with two poles has a zero.

    Examples
    --------
    >>> [(case.input, case.output) for case in function_cases("srivc")]
    [('nu', 'q'), ('nu', 'dq'), ('q_ref', 'q')]
    >>> len(function_cases("clsrivc"))  # the plant inside its loop
    1
    """
    method = function_class(key)
    sampled = int(method(poles=2).hold == "euler")
    position = method(poles=2, zeros=sampled, integrators=1)
    if key == "clsrivc":
        return (position,)
    loop = {"poles": 2, "zeros": sampled, "input": "q_ref", "offset": False}
    if not sampled:
        loop["hold"] = "foh"
    return position, method(poles=1, output="dq"), method(**loop)  # type: ignore[arg-type]
