"""Study files: the named studies, and those that users write in TOML or Python."""

from __future__ import annotations

import runpy
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from itertools import product
from pathlib import Path
from typing import Any

from ivtools import axes
from ivtools.errors import IVToolsError
from ivtools.estimators.base import estimator_class
from ivtools.loop import ClosedLoop
from ivtools.study.case import Case
from ivtools.study.reference import KINDS
from ivtools.study.run import Study

FILES = {path.stem: path for path in sorted((Path(__file__).parent / "named").glob("*.toml"))}
NAMES = tuple(FILES)
"""The studies that come with the package."""

_TOP = ("title", "question", "seeds", "estimators", "case", "vary")
_NUMBERS = ("sampling_hz", "encoder_noise", "quantum", "force_noise", "force_noise_pole")
_TABLES = ("theta", "pipeline", "start", "expected")
_MODEL = ("axis", "terms", "effects")
_CASE = (*_MODEL, "fitted", "reference", "holdout", *_NUMBERS, *_TABLES)


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
    _known("a study file", tables, _TOP)
    estimators = dict(map(_estimator, tables.get("estimators", [])))
    if len(estimators) < len(tables.get("estimators", [])):
        raise IVToolsError("two estimators have one name; give each a label")
    return Study(
        list(_cases(tables.get("case", {}), tables.get("vary", {}))),
        estimators,
        tables.get("seeds", 100),
        str(tables.get("title", "")),
        str(tables.get("question", "")),
    )


def _from_toml(path: Path) -> Study:
    try:
        return from_tables(tomllib.loads(path.read_text(encoding="utf-8")))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise IVToolsError(f"{path} is not TOML: {error}") from error
    except IVToolsError as error:
        raise type(error)(f"{path}: {error}") from error


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
    settings = {"method": entry} if isinstance(entry, str) else dict(entry)
    if "method" not in settings:
        raise IVToolsError(f"estimator {entry!r} has no method")
    kind = estimator_class(settings.pop("method"))
    label = settings.pop("label", kind.key)
    _known(f"estimator {label}", settings, [f.name for f in fields(kind)])
    return label, kind(**settings)


def _cases(common: Mapping[str, Any], vary: Mapping[str, Any]) -> Iterator[Case]:
    """Yield every combination of what varies."""
    choices = [list(_choices(name, values)) for name, values in vary.items()]
    for chosen in product(*choices):
        settings: dict[str, Any] = dict(common)
        for _, changes in chosen:
            for key, value in changes.items():
                _put(settings, key, value)
        factors = dict(zip(vary, (value for value, _ in chosen), strict=True))
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
            f"[vary] {name} = {values!r}; give a list of values, or one table per variant"
        )


def _number(name: str) -> float | str:
    try:
        return float(name)
    except ValueError:
        return name


def _put(settings: dict[str, Any], key: str, value: Any) -> None:
    """Set a key, where ``pipeline.cutoff_hz`` reaches into a table."""
    table, _, inner = key.partition(".")
    settings[table] = {**settings.get(table, {}), inner: value} if inner else value


def _case(name: str, settings: Mapping[str, Any], factors: Mapping[str, Any]) -> Case:
    _known(f"case {name}", settings, _CASE)
    fitted = settings.get("fitted")
    if fitted is not None:
        _known("fitted", fitted, _MODEL)
        fitted = _loop({"axis": settings.get("axis", "emps"), **fitted})
    options: dict[str, Any] = {
        k: _reference(settings[k]) for k in ("reference", "holdout") if k in settings
    }
    options |= {k: float(settings[k]) for k in _NUMBERS if k in settings}
    for key in {*_TABLES} & {*settings}:
        options[key] = {name: _plain(value) for name, value in settings[key].items()}
    options.setdefault("theta", {})
    return Case(name, _loop(settings), fitted=fitted, factors=factors, **options)


def _loop(settings: Mapping[str, Any]) -> ClosedLoop:
    axis = str(settings.get("axis", "emps"))
    loop = ClosedLoop.from_file(axes.path(axis) if axis in axes.FILES else axis)
    if "terms" in settings:
        loop = loop.with_terms(*settings["terms"])
    for effect, values in settings.get("effects", {}).items():
        loop = loop.with_effect(effect, **values)
    return loop


def _reference(settings: Mapping[str, Any]) -> Any:
    given = dict(settings)
    kind = given.pop("kind", "trapezoids")
    if kind not in KINDS:
        raise IVToolsError(f"reference kind {kind!r} is unknown; use one of {', '.join(KINDS)}")
    _known(f"reference {kind}", given, [f.name for f in fields(KINDS[kind])])
    return KINDS[kind](**{k: tuple(v) if isinstance(v, list) else v for k, v in given.items()})


def _plain(value: Any) -> Any:
    """Return a TOML value as the pipeline wants it: TOML has no None and no tuple."""
    if value == "none":
        return None
    return tuple(value) if isinstance(value, list) else value


def _short(value: Any) -> str:
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def _known(what: str, given: Mapping[str, Any], known: Any) -> None:
    if not isinstance(given, Mapping):
        raise IVToolsError(f"{what} is {given!r}; it is a table of keys and values")
    for key in given:
        if key not in known:
            raise IVToolsError(f"{what} does not know {key!r}; it knows: {', '.join(known)}")
