"""Settings from a file, as the fields of a class want them: each of its type, or an error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from math import isnan
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from ivtools.errors import IVToolsError, shown

_WORDS = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a text",
    NoneType: "none",
}
_LARGEST = 2**53  # of a whole number


def fitted(kind: type, given: Any, what: str) -> dict[str, Any]:
    """Return settings as the fields of a dataclass want them: lists as tuples, 1 as 1.0.

    Parameters
    ----------
    kind : type
        The dataclass.
    given : mapping
        As a TOML or JSON file has them.
    what : str
        Their name, for the error.

    Raises
    ------
    IVToolsError
        A key is unknown, or a value of another type.

    Examples
    --------
    >>> from ivtools.pipeline import Pipeline
    >>> fitted(Pipeline, {"decimation": 20.0}, "pipeline")
    Traceback (most recent call last):
    ivtools.errors.IVToolsError: pipeline: decimation = 20.0; it is a whole number
    """
    hints = get_type_hints(kind)
    known = table(given, [f.name for f in fields(kind)], what)
    return {key: value(one, hints[key], f"{what}: {key}") for key, one in known.items()}


def table(given: Any, known: Any, what: str) -> Mapping[str, Any]:
    """Return a table whose keys are known.

    Raises
    ------
    IVToolsError
        It is no table, or has another key.
    """
    if not isinstance(given, Mapping):
        raise IVToolsError(f"{what} = {_short(given)}; it is a table of keys and values")
    for key in given:
        if key not in known:
            names = ", ".join(known)
            raise IVToolsError(f"{what} does not know {_short(key)}; it knows: {names}")
    return given


def value(given: Any, hint: Any, what: str) -> Any:
    """Return a value as a type wants it.

    Raises
    ------
    IVToolsError
        It is of another type, or not a number.
    """
    try:
        return _value(given, hint)
    except (TypeError, OverflowError):
        raise IVToolsError(f"{what} = {_short(given)}; it is {_words(hint)}") from None


def _short(given: Any) -> str:
    try:
        return shown(repr(given))
    except ValueError:  # an integer too long to print
        return "a number of thousands of digits"


def _value(given: Any, hint: Any) -> Any:
    origin, parts = get_origin(hint), get_args(hint)
    if hint is Any:
        return given
    if origin in (Union, UnionType):
        return _any_of(given, parts)
    if origin is Literal:
        return _if(given in parts and isinstance(given, str), given)
    if origin is tuple:
        return _tuple(given, parts)
    if origin is not None and issubclass(origin, Mapping):
        _if(isinstance(given, Mapping), given)
        return {str(k): _value(v, parts[1]) for k, v in given.items()}
    if hint is float and isinstance(given, int) and not isinstance(given, bool):
        return float(given)
    if hint is int:
        _if(not isinstance(given, bool) and isinstance(given, int) and abs(given) < _LARGEST, given)
    if hint is float:
        _if(isinstance(given, float) and not isnan(given), given)
    return _if(hint in _WORDS and isinstance(given, hint), given)


def _if(right: bool, given: Any) -> Any:
    if not right:
        raise TypeError
    return given


def _any_of(given: Any, hints: Sequence[Any]) -> Any:
    for hint in hints:
        try:
            return _value(given, hint)
        except TypeError:
            continue
    raise TypeError


def _tuple(given: Any, parts: tuple[Any, ...]) -> tuple[Any, ...]:
    _if(isinstance(given, list | tuple), given)
    hints = [parts[0]] * len(given) if parts[1:] == (...,) else list(parts)
    _if(len(hints) == len(given), given)
    return tuple(_value(v, hint) for v, hint in zip(given, hints, strict=True))


def _words(hint: Any) -> str:
    """Return what a type wants, for people."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return " or ".join(_words(part) for part in parts)
    if origin is Literal:
        return " or ".join(map(repr, parts))
    if origin is tuple:
        many = parts[1:] == (...,)
        return f"a list, each {_words(parts[0])}" if many else f"a list of {len(parts)}"
    if origin is not None and issubclass(origin, Mapping):
        return f"a table, each value {_words(parts[1])}"
    return _WORDS.get(hint, "not for a file")
