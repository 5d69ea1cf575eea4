"""Study files: the named studies, and those that users write in TOML or Python."""

from __future__ import annotations

import runpy
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

from ivtools import axes
from ivtools.errors import IVToolsError, shown
from ivtools.estimators.base import estimator_class
from ivtools.limits import check_content, read_text
from ivtools.loop import ClosedLoop
from ivtools.loop.axis_file import from_tables as loop_of
from ivtools.pipeline import Pipeline
from ivtools.settings import fitted, table, value
from ivtools.study.case import Case
from ivtools.study.reference import KINDS
from ivtools.study.run import Study

FILES = {path.stem: path for path in sorted((Path(__file__).parent / "named").glob("*.toml"))}
NAMES = tuple(FILES)
"""The studies that come with the package."""

_TOP = ("title", "question", "seeds", "estimators", "case", "vary")
_NUMBERS = ("sampling_hz", "encoder_noise", "quantum", "force_noise", "force_noise_pole")
_VALUES = ("theta", "start", "expected")
_MODEL = ("axis", "terms", "effects")
_CASE = (*_MODEL, "fitted", "reference", "holdout", "pipeline", *_NUMBERS, *_VALUES)
MOST_CASES = 10_000


def load(source: str | Path, seeds: int | None = None) -> Study:
    """Return a study by name, or from a file.

    A TOML file describes the study; a Python file defines it as ``study``, with estimators of
    your own if you like. The documentation has both formats.

    Parameters
    ----------
    source : str or Path
        One of `NAMES`, or a ``.toml`` or ``.py`` file.
    seeds : int, optional
        Repetitions per case, instead of what the file says.

    Raises
    ------
    IVToolsError
        If there is no such study, or its file says something that is not understood.

    Examples
    --------
    >>> study = load("noise", seeds=3)
    >>> study.seeds, study.cases[0].name
    (3, 'encoder_noise 1e-08')
    """
    path = FILES.get(str(source), Path(source))
    if not path.is_file():
        raise IVToolsError(
            f"{source} is neither a named study ({', '.join(NAMES)}) nor a study file; "
            "give a .toml or .py file"
        )
    study = _from_python(path) if path.suffix == ".py" else _from_toml(path)
    return study if seeds is None else replace(study, seeds=seeds)


def from_tables(tables: Mapping[str, Any]) -> Study:
    """Make the study that the tables of a TOML file describe."""
    table(tables, _TOP, "a study file")
    check_content("the study", dict(tables))
    given = value(tables.get("estimators", []), tuple[Any, ...], "estimators")
    estimators = dict(map(_estimator, given))
    if len(estimators) < len(given):
        raise IVToolsError("two estimators have one name; give each a label")
    return Study(
        list(_cases(table(tables.get("case", {}), _CASE, "[case]"), tables.get("vary", {}))),
        estimators,
        value(tables.get("seeds", 100), int, "seeds"),
        value(tables.get("title", ""), str, "title"),
        value(tables.get("question", ""), str, "question"),
    )


def _from_toml(path: Path) -> Study:
    try:
        return from_tables(tomllib.loads(read_text(path)))
    except IVToolsError as error:
        raise type(error)(f"{path}: {error}") from error
    except OSError as error:
        raise IVToolsError(f"{path} cannot be read: {error.strerror}") from error
    except ValueError as error:  # what a parser refuses
        raise IVToolsError(f"{path} is not TOML: {shown(str(error), 200)}") from error


def _from_python(path: Path) -> Study:
    try:
        study = runpy.run_path(str(path)).get("study")
    except Exception as error:
        raise IVToolsError(f"{path} does not run: {type(error).__name__}: {error}") from error
    if not isinstance(study, Study):
        raise IVToolsError(f"{path} defines no study; it must end with: study = Study(...)")
    return study


def _estimator(entry: Any) -> tuple[str, Any]:
    """Return label and estimator of ``"idim-iv"`` or ``{method = "idim-iv", label = ..., ...}``."""
    settings = {"method": entry} if isinstance(entry, str) else entry
    if not isinstance(settings, Mapping) or "method" not in settings:
        raise IVToolsError(f"estimator {shown(repr(entry))} has no method")
    kind = estimator_class(value(settings["method"], str, "method of an estimator"))
    label = value(settings.get("label", kind.key), str, "label of an estimator")
    given = {k: v for k, v in settings.items() if k not in ("method", "label")}
    return label, kind(**fitted(kind, given, f"estimator {label}"))


def _cases(common: Mapping[str, Any], vary: Mapping[str, Any]) -> Iterator[Case]:
    """Yield every combination of what varies."""
    if not isinstance(vary, Mapping):
        raise IVToolsError(f"[vary] is {shown(repr(vary))}; it is a table of what varies")
    choices = [list(_choices(name, values)) for name, values in vary.items()]
    if prod(map(len, choices)) > MOST_CASES:
        raise IVToolsError(f"[vary] makes {prod(map(len, choices))} cases; at most {MOST_CASES}")
    for chosen in product(*choices):
        settings: dict[str, Any] = dict(common)
        for _, changes in chosen:
            for key, one in changes.items():
                _put(settings, key, one)
        factors = dict(zip(vary, (one for one, _ in chosen), strict=True))
        name = ", ".join(f"{k.split('.')[-1]} {_short(v)}" for k, v in factors.items()) or "case"
        try:
            yield _case(name, settings, factors)
        except TypeError as error:
            raise IVToolsError(f"case {name}: {error}") from error


def _choices(name: str, values: Any) -> Iterator[tuple[Any, Mapping[str, Any]]]:
    """Yield each value of a factor and what it changes in the case."""
    if isinstance(values, list) and values:
        yield from ((value, {name: value}) for value in values)
    elif isinstance(values, Mapping) and all(isinstance(v, Mapping) for v in values.values()):
        yield from ((_number(key), changes) for key, changes in values.items())
    else:
        raise IVToolsError(
            f"[vary] {name} = {shown(repr(values))}; give a list of values, or a table per variant"
        )


def _number(name: str) -> float | str:
    try:
        return float(name)
    except ValueError:
        return name


def _put(settings: dict[str, Any], key: str, value: Any) -> None:
    """Set a key, where ``pipeline.cutoff_hz`` reaches into a table."""
    name, _, inner = key.partition(".")
    whole = settings.get(name, {})
    if inner and not isinstance(whole, Mapping):
        raise IVToolsError(f"[vary] {key}: {name} = {shown(repr(whole))} is no table")
    settings[name] = {**whole, inner: value} if inner else value


def _case(name: str, settings: Mapping[str, Any], factors: Mapping[str, Any]) -> Case:
    table(settings, _CASE, f"case {name}")
    other = settings.get("fitted")
    if other is not None:
        table(other, _MODEL, "fitted")
        other = _loop({"axis": settings.get("axis", "emps"), **other})
    options: dict[str, Any] = {
        k: _reference(settings[k]) for k in ("reference", "holdout") if k in settings
    }
    options |= {k: value(settings[k], float, k) for k in _NUMBERS if k in settings}
    options |= {k: value(settings[k], Mapping[str, float], k) for k in _VALUES if k in settings}
    rows = value(settings.get("pipeline", {}), Mapping[str, Any], "pipeline")
    plain = {key: None if one == "none" else one for key, one in rows.items()}
    options["pipeline"] = fitted(Pipeline, plain, "pipeline")
    options.setdefault("theta", {})
    return Case(name, _loop(settings), fitted=other, factors=factors, **options)


def _loop(settings: Mapping[str, Any]) -> ClosedLoop:
    axis = settings.get("axis", "emps")
    if isinstance(axis, Mapping):  # the tables of an axis file
        loop = loop_of(axis)
    else:
        axis = value(axis, str, "axis")
        loop = ClosedLoop.from_file(axes.path(axis) if axis in axes.FILES else axis)
    if "terms" in settings:
        loop = loop.with_terms(*value(settings["terms"], tuple[str, ...], "terms"))
    effects = value(settings.get("effects", {}), Mapping[str, Mapping[str, float]], "effects")
    for effect, values in effects.items():
        loop = loop.with_effect(effect, **values)
    return loop


def _reference(settings: Mapping[str, Any]) -> Any:
    given = dict(value(settings, Mapping[str, Any], "a reference"))
    kind = value(given.pop("kind", "trapezoids"), str, "reference: kind")
    if kind not in KINDS:
        names = ", ".join(KINDS)
        raise IVToolsError(f"reference kind {shown(kind)!r} is unknown; use one of {names}")
    return KINDS[kind](**fitted(KINDS[kind], given, f"reference {kind}"))


def _short(value: Any) -> str:
    number = isinstance(value, int | float) and abs(value) < 1e300
    return f"{value:g}" if number else shown(str(value), 200)
