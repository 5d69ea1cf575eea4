"""Recorder: what the selection of a diagnosis saw, beside its answer."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch


@contextmanager
def attributions() -> Iterator[list[Any]]:
    """Give the attributions of the diagnoses that run meanwhile, in their order."""
    from importlib import import_module

    begun = import_module("ivtools.gap.diagnose.begun")  # a function hides the room
    attribute, seen = begun.attribute, []

    def noted(*args: Any) -> Any:
        seen.append(attribute(*args))
        return seen[-1]

    with patch.object(begun, "attribute", noted):
        yield seen
