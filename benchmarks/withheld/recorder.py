"""Recorder: what the selection of a diagnosis saw, beside its answer."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch


@contextmanager
def attributions() -> Iterator[list[Any]]:
    """Give the attributions of the diagnoses that run meanwhile, in their order."""
    from importlib import import_module

    named = import_module("ivtools.gap.diagnose.named")  # a function hides the room
    attribute, seen = named.attribute, []

    def noted(*args: Any) -> Any:
        seen.append(attribute(*args))
        return seen[-1]

    with patch.object(named, "attribute", noted):
        yield seen


def names(found: Any, truth: Collection[str]) -> Iterator[dict[str, Any]]:
    """Yield the evidence for the best effect of every round, given as a name or not.

    Parameters
    ----------
    found : Attribution
    truth : collection of str
        The effects that are there: a name is right if it or what is not told from it is.
    """
    from ivtools.gap.fit import cost

    for r in found.rounds:
        if r.best is None:
            continue
        alike = {r.best.name, *(t.name for t in r.twins(cost(found.held)))}
        told = {"name": r.best.name, "given": r.best.name in found.named}
        yield {**told, "right": bool(alike & {*truth}), **found.proof(r, r.best).to_dict()}
