"""``ivtools effects`` and ``ivtools methods``: what there is."""

from __future__ import annotations

from textwrap import wrap
from typing import TYPE_CHECKING, Any

from ivtools.cli import options
from ivtools.cli.output import show, write_json

if TYPE_CHECKING:
    from ivtools.physics import Term


def effects(json: options.Json = None) -> None:
    """List the effects that can be added to a model, with their equations."""
    from ivtools.physics import EFFECTS

    write_json({name: _content(term) for name, term in EFFECTS.items()}, json)
    show(*(_entry(term) for term in EFFECTS.values()), json_file=json)


def _entry(term: Term) -> str:
    """Return an effect as a few lines of at most 80 columns."""
    units = ", ".join(f"{p.name} [{p.unit_for('prismatic')}]" for p in term.parameters)
    lines = [f"{term.name} ({term.block})"]
    for text in (term.equation, f"parameters: {units}", f"source: {term.source}"):
        lines += wrap(text, 80, initial_indent="    ", subsequent_indent="      ")
    return "\n".join(lines)


def _content(term: Term) -> dict[str, Any]:
    """Return an effect as plain objects."""
    parameters = {
        name: {"unit": p.unit_for("prismatic"), "lower": p.lower, "upper": p.upper}
        for name, p in term.by_name.items()
    }
    return {
        "block": term.block,
        "equation": term.equation,
        "parameters": parameters,
        "source": term.source,
    }


def methods(json: options.Json = None) -> None:
    """List the estimators, with what each does."""
    from importlib import import_module

    from ivtools.estimators.base import FUNCTIONS, METHODS
    from ivtools.tables import table

    told = {}
    for key, place in {**METHODS, **FUNCTIONS}.items():
        module, name = place.split(":")
        found = getattr(import_module(f"ivtools.estimators.{module}"), name)
        told[key] = {"class": name, "about": (found.__doc__ or "").strip().split("\n")[0]}
    write_json(told, json)
    rows = []
    for key, about in told.items():
        first, *more = wrap(about["about"], 46) or [""]
        rows += [[key, about["class"], first], *(["", "", line] for line in more)]
    text = table("Methods", [], ["--method", "class", "what it does"], rows, left=3)
    show(text, json_file=json)
