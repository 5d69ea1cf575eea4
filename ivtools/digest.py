"""Stable names: a digest that is the same on every machine, and the seeds that follow from it."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ivtools.physics import TERMS, Term

if TYPE_CHECKING:
    from ivtools.loop import ClosedLoop


def digest(*parts: Any) -> str:
    """Return the SHA-256 of what the parts say, as 64 hexadecimal digits.

    Examples
    --------
    >>> digest({"a": 1.0, "b": (2, 3)})[:8] == digest({"b": [2, 3], "a": 1.0})[:8]
    True
    """
    text = json.dumps([canonical(p) for p in parts], sort_keys=True, allow_nan=True)
    return hashlib.sha256(text.encode()).hexdigest()


def seed_sequence(*parts: Any) -> np.random.SeedSequence:
    """Return the seed sequence that belongs to these parts, on every machine the same."""
    return np.random.SeedSequence(int(digest(*parts), 16))


def canonical(value: Any) -> Any:
    """Return a value as plain JSON: what it says, not where it lives or how it was made.

    A field that a dataclass got "later" (its metadata) counts only where it is not plain: seeds
    that were drawn before stay.
    """
    if isinstance(value, Term):
        return _term(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        said = {f.name: (f, getattr(value, f.name)) for f in dataclasses.fields(value)}
        fields = {
            name: canonical(x)
            for name, (f, x) in said.items()
            if not (f.metadata.get("later") and x == f.default)
        }
        return [type(value).__qualname__, fields]
    if isinstance(value, Mapping):
        return {str(k): canonical(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        data = np.ascontiguousarray(value)
        return ["array", str(data.dtype), data.shape, hashlib.sha256(data.tobytes()).hexdigest()]
    if isinstance(value, list | tuple):
        return [canonical(v) for v in value]
    if isinstance(value, np.generic):
        return value.item()
    if value is None or isinstance(value, str | int | float | bool):
        return value
    if callable(value):
        return _function(value)
    return [type(value).__qualname__, canonical(getattr(value, "__dict__", {}))]


def loop_text(loop: ClosedLoop) -> list[Any]:
    """Return what a loop says about the physics: all but its name, columns and starting values."""
    return canonical([loop.controller, loop.gain, loop.terms, loop.joint, loop.delay])


def _term(term: Term) -> Any:
    if TERMS.get(term.name) is term:
        return term.name
    return [term.name, term.equation, canonical(term.parameters), _function(term.law)]


def _function(function: Any) -> Any:
    code = getattr(function, "__code__", None)
    name = getattr(function, "__qualname__", type(function).__qualname__)
    return name if code is None else [name, code.co_code.hex(), [repr(c) for c in code.co_consts]]
