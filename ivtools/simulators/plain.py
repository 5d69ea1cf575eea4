"""A diagnosed loop for any other tool: equations and SI values, or a Python program of its own."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from ivtools.errors import AxisError
from ivtools.loop import ClosedLoop
from ivtools.physics import Term
from ivtools.units import JOINTS

TEMPLATE = Path(__file__).parent / "program.txt"
#: Effects that are no force over the motion, and that the program knows how to simulate.
_KNOWN = ("drive-timing", "saturation")


def described(loop: ClosedLoop, theta: Mapping[str, float]) -> dict[str, Any]:
    """Return equations and values of a loop as plain objects, ready for JSON.

    Parameters
    ----------
    loop : ClosedLoop
    theta : mapping
        Values of its parameters, SI.
    """
    values = loop.values(theta)
    controller = loop.controller
    return {
        "axis": loop.name,
        "joint": loop.joint,
        "equation": "drive force = sum of the terms' forces; each opposes the motion",
        "drive": {"gain": loop.gain, "delay": {"value": loop.delay, "unit": "s"}},
        "controller": {
            "kind": controller.kind,
            "settings": {k: np.asarray(v).tolist() for k, v in controller.settings.items()},
            "velocity_filter": list(controller.velocity_filter),
            "delay": {"value": controller.delay, "unit": "samples"},
            "limit": controller.limit if np.isfinite(controller.limit) else None,
        },
        "terms": [_described(term, values, loop.joint) for term in loop.terms],
    }


def _described(term: Term, values: Mapping[str, float], joint: str) -> dict[str, Any]:
    parameters = {
        p.name: {"value": values[n] if np.isfinite(values[n]) else None, "unit": p.unit_for(joint)}
        for n, p in term.by_name.items()
    }
    return {
        "name": term.name,
        "block": term.block,
        "equation": term.equation,
        "source": term.source,
        "parameters": parameters,
    }


def program(loop: ClosedLoop, theta: Mapping[str, float], dt: float = 1e-3) -> str:
    """Return a Python file with the force law and the closed loop; it needs NumPy only.

    Parameters
    ----------
    loop : ClosedLoop
    theta : mapping
    dt : float
        Sampling step of the controller, s.

    Raises
    ------
    AxisError
        If the loop has an effect that the program cannot simulate: a second mass, a bristle, an
        encoder error, or a law of your own whose source is not at hand.
    """
    values = loop.values(theta)
    missing = [t.name for t in loop.terms if t.law is None and t.name not in _KNOWN]
    if missing:
        raise AxisError(
            f"{', '.join(missing)} is more than a force over the motion; export json has its "
            "equation, export mjcf a model that holds it"
        )
    terms = sorted(loop.terms, key=lambda t: t.net)  # last what takes up what the others leave
    laws = {term.name.replace("-", "_"): term for term in terms if term.law is not None}
    law = loop.controller.law(dt)
    calls = [
        f"    total = total + {name}(q, dq, ddq, sign, tau{' - total' * term.net}, t, "
        + ", ".join(repr(values[n]) for n in term.names)
        + f")  # {_units(term, loop.joint)}"
        for name, term in laws.items()
        if name != "inertia"
    ]
    return TEMPLATE.read_text(encoding="utf-8").format(
        title=f"{loop.name}: the force law and the closed loop",
        laws="\n\n\n".join(_sources({n: t for n, t in laws.items() if n != "inertia"})),
        calls="\n".join(calls),
        inertia=values["inertia"],
        unit=JOINTS[loop.joint].force,
        gain=loop.gain,
        delay=loop.delay + values.get("drive-timing.delay", 0.0),
        lag=values.get("drive-timing.lag", 0.0),
        limit=min(loop.controller.limit, values.get("saturation.limit", float("inf"))),
        late=loop.controller.delay,
        dt=dt,
        **{key: np.asarray(getattr(law, key)).tolist() for key in ("D", "taps", "A", "C", "back")},
        B=np.asarray(law.B).tolist(),
        hold=np.asarray(law.hold).tolist(),
        sensed=law.sensed,
    )


def _units(term: Term, joint: str) -> str:
    return ", ".join(f"{p.name} {p.unit_for(joint)}" for p in term.parameters)


def _sources(laws: Mapping[str, Term]) -> list[str]:
    """Return the laws of terms as functions of their own, and before them what they call."""
    helpers: dict[str, str] = {}
    for term in laws.values():
        _help(term.law, helpers)
    functions = (_source(name, term.law, term.equation) for name, term in laws.items())
    return [*helpers.values(), *functions]


def _help(law: Any, helpers: dict[str, str]) -> None:
    """Add the source of the functions that a law calls, of whatever module."""
    for name in law.__code__.co_names:
        called = law.__globals__.get(name)
        called = getattr(called, "py_func", called)  # a compiled one has its source
        if isinstance(called, FunctionType) and name not in helpers:
            summary = (inspect.getdoc(called) or name).splitlines()[0]
            helpers[name] = _source(name, called, summary)
            _help(called, helpers)


def _source(name: str, law: Any, summary: str) -> str:
    """Return a law, or what it calls, as a function of its own."""
    node = _node(law)
    arguments = ", ".join(a.arg for a in node.args.args)
    text = f'    """{summary}"""\n'
    if isinstance(node, ast.Lambda):
        return f"def {name}({arguments}):\n{text}    return {ast.unparse(node.body)}"
    body = node.body[1:] if ast.get_docstring(node) else node.body
    lines = "\n".join(ast.unparse(statement) for statement in body).splitlines()
    return f"def {name}({arguments}):\n{text}" + "\n".join(f"    {line}" for line in lines)


def _node(law: Any) -> ast.Lambda | ast.FunctionDef:
    """Return the syntax of a law."""
    code = law.__code__
    try:
        tree = _tree(inspect.getsourcefile(law) or "")
    except (OSError, SyntaxError, TypeError) as error:
        raise AxisError(f"the source of the law {law.__qualname__} is not at hand") from error
    names = list(code.co_varnames[: code.co_argcount])
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Lambda | ast.FunctionDef)
            and _line(node) == code.co_firstlineno
            and [a.arg for a in node.args.args] == names
        ):
            return node
    raise AxisError(f"the source of the law {law.__qualname__} is not at hand")


def _line(node: ast.Lambda | ast.FunctionDef) -> int:
    """Return the line on which a function begins, its decorators included."""
    return min([node.lineno, *(d.lineno for d in getattr(node, "decorator_list", []))])


@cache
def _tree(file: str) -> ast.Module:
    return ast.parse(Path(file).read_text(encoding="utf-8"))
