"""Axis files: everything known about an axis, in TOML."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from .. import limits
from ..columns import SIGNALS, UNITS
from ..errors import AxisError, DataError, IVToolsError
from ..physics import TERMS
from ..pipeline import Pipeline
from ..record_format import RecordFormat, signal_of
from ..units import parse
from .closed_loop import ClosedLoop
from .controllers import KINDS, Controller
from .controllers.controller import COMMON
from .controllers.filters import LoopFilter

TABLES: dict[str, tuple[str, ...]] = {
    "axis": ("name", "joint"),
    "record": tuple(f.name for f in fields(RecordFormat)),
    "controller": COMMON,
    "drive": ("gain", "delay"),
    "model": ("terms", "start"),
    "pipeline": ("rule", *(f.name for f in fields(Pipeline) if f.name != "breaks")),
    "limits": ("lower", "upper", "speed", "acceleration", "effort"),  # for excite
}
#: What a number alone in these keys is for.
_RELATIVE = {"rated": ("%",), "counts_per_unit": ("counts", "counts/s")}
_REQUIRED = {"controller": ("kind",), "drive": ("gain",)}
_SETTINGS = {key for kind in KINDS.values() for key in kind.settings}


def read(path: str | Path) -> ClosedLoop:
    """Read an axis file.

    Raises
    ------
    AxisError
        If the file cannot be read, is not TOML, lacks a key, or has an unknown one.
    """
    try:
        tables = tomllib.loads(limits.read_text(Path(path)))
        limits.check_content("the file", tables)
    except DataError as error:
        raise AxisError(f"axis file {path}: {error}") from error
    except OSError as error:
        raise AxisError(
            f"axis file {path}: {error.strerror or error}; give the path of a TOML file"
        ) from error
    except (ValueError, RecursionError) as error:  # not TOML, not UTF-8, not a path
        raise AxisError(f"axis file {path} is not TOML: {error}") from error
    try:
        return from_tables(tables)
    except AxisError as error:
        raise AxisError(f"axis file {path}: {error}") from error


def from_tables(tables: Mapping[str, Any]) -> ClosedLoop:
    """Make the loop that the tables of an axis file describe."""
    _check(tables)
    axis, drive = tables.get("axis", {}), tables["drive"]
    model = tables.get("model", {})
    terms = model.get("terms", ["inertia", "viscous", "coulomb", "offset"])
    if not (isinstance(terms, list) and terms and all(isinstance(t, str) for t in terms)):
        raise AxisError(f"[model] terms = {terms!r}; give a list of term names")
    start = _mapping("model.start", model.get("start", {}))
    joint = _text("axis", "joint", axis.get("joint", "prismatic"))
    return ClosedLoop(
        controller=_controller(tables["controller"]),
        gain=number("drive", "gain", drive["gain"]),
        terms=tuple(terms),
        name=_text("axis", "name", axis.get("name", "axis")),
        joint=joint,
        delay=number("drive", "delay", drive.get("delay", 0.0)),
        start={key: number("model.start", key, value) for key, value in start.items()},
        log=record_format(tables.get("record", {}), [joint]),
        rows={k: tuple(v) if k == "trim" else v for k, v in tables.get("pipeline", {}).items()},
    )


def _check(tables: Mapping[str, Any]) -> None:
    """Refuse what is unknown, and name what is missing."""
    for table, content in tables.items():
        if table not in TABLES:
            raise AxisError(f"[{table}] is not known; known tables: {', '.join(TABLES)}")
        known = {*TABLES[table], *(_SETTINGS if table == "controller" else ())}
        for key in _mapping(table, content):
            if key not in known:
                raise AxisError(
                    f"[{table}] does not know {key!r}; it knows: {', '.join(sorted(known))}"
                )
    for table, keys in _REQUIRED.items():
        for key in keys:
            if key not in tables.get(table, {}):
                raise AxisError(f"[{table}] {key} is missing; every axis needs it")


def _controller(table: Mapping[str, Any]) -> Controller:
    settings = {k: v for k, v in table.items() if k in _SETTINGS}
    taps = table.get("velocity_filter", [1.0])
    if not isinstance(taps, list):
        raise AxisError(f"[controller] velocity_filter = {taps!r}; give a list of FIR weights")
    if not isinstance(table["kind"], str):
        raise AxisError(f"[controller] kind = {table['kind']!r}; give one of {', '.join(KINDS)}")
    return Controller(
        kind=table["kind"],
        settings={
            k: v if isinstance(v, list) else number("controller", k, v) for k, v in settings.items()
        },
        velocity_filter=tuple(number("controller", "velocity_filter", v) for v in taps),
        delay=table.get("delay", 0),
        limit=number("controller", "limit", table.get("limit", float("inf"))),
        velocity=_text("controller", "velocity", table.get("velocity", "differences")),
        filter=LoopFilter.of(_mapping("controller.filter", table["filter"]))
        if "filter" in table
        else None,
        feedforward=_gains("feedforward", table),
        feedback=_gains("feedback", table),
        anti_windup=_text("controller", "anti_windup", table.get("anti_windup", "clamp")),
        reference_derivative=_text(
            "controller", "reference_derivative", table.get("reference_derivative", "central")
        ),
    )


def record_format(table: Mapping[str, Any], joints: Sequence[str]) -> RecordFormat:
    """Return what the [record] table says about files.

    Parameters
    ----------
    table : mapping
    joints : sequence of str
        ``"prismatic"`` or ``"revolute"``, by joint.

    Raises
    ------
    AxisError
    """
    columns = {k: _text("record.columns", k, v) for k, v in _inner(table, "columns").items()}
    for key in columns:
        if signal_of(key) not in ("t", *SIGNALS):
            raise AxisError(
                f"[record.columns] {key!r} is not a signal; known: t, {', '.join(SIGNALS)}"
            )
    units = {k: _text("record.units", k, v) for k, v in _inner(table, "units").items()}
    scales = {
        name: _per_signal(name, table[name], units)
        for name in ("rated", "counts_per_unit")
        if name in table
    }
    rest = {k: v for k, v in table.items() if k in ("torque_constant", "rate")}
    numbers = {k: number("record", k, v) for k, v in rest.items()}
    told: dict[str, Any] = {k: _text("record", k, table.get(k, "refuse")) for k in ("gaps", "rows")}
    for key in ("resample", "unwrap"):
        told[key] = table.get(key, False)
        if not isinstance(told[key], bool):
            raise AxisError(f"[record] {key} = {told[key]!r}; it is true or false")
    try:
        log = RecordFormat(columns, units, **scales, **numbers, **told)  # type: ignore[arg-type]
    except IVToolsError as error:
        raise AxisError(str(error)) from error
    _check_joints(log, joints)
    return log


def _inner(table: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    return _mapping(f"record.{name}", table.get(name, {}))


def _per_signal(name: str, value: Any, units: Mapping[str, str]) -> Mapping[str, float]:
    """Return a number of each signal; one alone is that of every signal in such units."""
    if isinstance(value, Mapping):
        return {key: number(f"record.{name}", key, scale) for key, scale in value.items()}
    scale = number("record", name, value)
    return {key: scale for key, unit in units.items() if parse(unit).si in _RELATIVE[name]}


def _check_joints(log: RecordFormat, joints: Sequence[str]) -> None:
    """Refuse units of an angle on a prismatic joint, and of a length on a revolute one."""
    for key, unit in log.units.items():
        column = re.search(r"\d+$", key)
        index = int(column[0]) - 1 if column and len(column[0]) < 4 else 0
        joint = joints[index] if 0 <= index < len(joints) else joints[0]
        wrong = "rad" if joint == "prismatic" else "m"
        if parse(unit).si.split("/")[0] == wrong and signal_of(key) in UNITS:
            other = "revolute" if wrong == "rad" else "prismatic"
            raise AxisError(
                f'[record] units = {{ {key} = "{unit}" }} and a {joint} joint do not fit; '
                f'is it {other}? (joint = "{other}"); else name another unit'
            )


def _gains(name: str, table: Mapping[str, Any]) -> dict[str, float]:
    given = _mapping(f"controller.{name}", table.get(name, {}))
    return {k: number(f"controller.{name}", k, v) for k, v in given.items()}


def _mapping(name: str, value: Any) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise AxisError(f"[{name}] is {value!r}; it is a table of keys and values")
    return value


def number(table: str, key: str, value: Any) -> float:
    """Return a number of a file.

    Raises
    ------
    AxisError
        It is none.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise AxisError(f"[{table}] {key} = {value!r} is not a number")
    try:
        return float(value)
    except OverflowError as error:
        raise AxisError(f"[{table}] {key} is too large for a number") from error


def _text(table: str, key: str, value: Any) -> str:
    if not isinstance(value, str):
        raise AxisError(f"[{table}] {key} = {value!r} is not a text; put it in quotes")
    return value


def write(loop: ClosedLoop) -> str:
    """Return the axis file of a loop; see `ClosedLoop.to_toml`."""
    tables = {tuple(name.split(".")): content for name, content in axis_tables(loop).items()}
    blocks = [toml_table(parts, content) for parts, content in tables.items() if content]
    notes = "\n".join(f"# {note}" for note in loop.notes)
    return "\n\n".join([notes] * bool(notes) + blocks) + "\n"


def axis_tables(loop: ClosedLoop) -> dict[str, Mapping[str, Any]]:
    """Return the tables of a loop's axis file.

    Raises
    ------
    AxisError
        If the model has a term of your own, which a file cannot hold.
    """
    for term in loop.terms:
        if TERMS.get(term.name) is not term:
            raise AxisError(f"{term.name} is a term of your own; an axis file cannot hold it")
    return {
        "axis": {"name": loop.name, "joint": loop.joint},
        "record": loop.log.to_dict(),
        "controller": controller_table(loop.controller),
        "drive": {"gain": loop.gain, "delay": loop.delay},
        "model": {"terms": [term.name for term in loop.terms]},
        "model.start": loop.start,
        "pipeline": {k: list(v) if k == "trim" else v for k, v in loop.rows.items()},
    }


def controller_table(controller: Controller) -> dict[str, Any]:
    """Return the table of a controller."""
    return {
        "kind": controller.kind,
        **{k: np.asarray(v, dtype=float).tolist() for k, v in controller.settings.items()},
        "velocity_filter": list(controller.velocity_filter),
        "delay": controller.delay,
        "limit": controller.limit,
        **_surroundings(controller),
    }


def toml_table(parts: Sequence[str], content: Mapping[str, Any]) -> str:
    """Return a table in TOML; `parts` are its name and those of the tables around it."""
    head = ".".join(_key(part) for part in parts)
    return "\n".join([f"[{head}]", *(f"{_key(k)} = {toml(v)}" for k, v in content.items())])


def _surroundings(controller: Controller) -> dict[str, Any]:
    """Return what a controller has beside its law, as far as it differs from what is plain."""
    plain = Controller("none", {})
    values = {
        "velocity": controller.velocity,
        "anti_windup": controller.anti_windup,
        "reference_derivative": controller.reference_derivative,
        "filter": controller.filter.table if controller.filter else {},
        "feedforward": dict(controller.feedforward),
        "feedback": dict(controller.feedback),
    }
    return {k: v for k, v in values.items() if v and v != getattr(plain, k)}


def toml(value: Any, digits: int | None = None) -> str:
    """Return a value in TOML; of its numbers so many digits, or all."""
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{_key(k)} = {toml(v, digits)}' for k, v in value.items())} }}"
    if isinstance(value, list):
        return f"[{', '.join(toml(v, digits) for v in value)}]"
    if isinstance(value, int):
        return repr(value)
    return repr(float(value)) if digits is None else f"{value:.{digits}g}"


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _quoted(name)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
