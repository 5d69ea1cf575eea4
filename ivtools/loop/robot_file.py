"""Robot files: everything known about a robot and its joints' controllers, in TOML.

The tables of an axis file, ``[controller]``, ``[drive]`` and ``[model]``, are defaults for every
joint; ``[joint.NAME.controller]`` and so on say what is different in one.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .. import limits
from ..errors import AxisError, DataError
from ..robot.mjcf import SUFFIXES
from ..robot.robot import Robot
from .axis_file import TABLES, axis_tables, from_tables, number, record_format, toml_table
from .robot_loop import RobotLoop

_ROBOT = ("name", "urdf", "mjcf", "joints", "transmission", "gravity")
_TOOL = ("link", "mass", "com", "inertia")
_SHARED = ("controller", "drive", "model")
_KNOWN = ("robot", "tool", "record", *_SHARED, "joint", "start", "limits")  # limits: for excite


def read(path: str | Path) -> RobotLoop:
    """Read a robot file.

    Raises
    ------
    AxisError
        If the file cannot be read, is not TOML, lacks a key, has an unknown one, or its model of
        the robot is at fault.
    """
    try:
        tables = tomllib.loads(limits.read_text(Path(path)))
        limits.check_content("the file", tables)
    except (DataError, OSError) as error:
        reason = getattr(error, "strerror", None) or error
        raise AxisError(f"robot file {path}: {reason}; give the path of a TOML file") from error
    except (ValueError, RecursionError) as error:
        raise AxisError(f"robot file {path} is not TOML: {error}") from error
    try:
        return from_robot_tables(tables, Path(path).parent)
    except AxisError as error:
        raise AxisError(f"robot file {path}: {error}") from error


def from_robot_tables(tables: Mapping[str, Any], folder: Path) -> RobotLoop:
    """Make the loop that the tables of a robot file describe; `folder` is where its model is."""
    for name in tables:
        if name not in _KNOWN:
            raise AxisError(f"[{name}] is not known; known tables: {', '.join(_KNOWN)}")
    table = _table("robot", tables.get("robot", {}), _ROBOT)
    robot = _robot(table, folder)
    if "tool" in tables:
        robot = _with_tool(robot, _table("tool", tables["tool"], _TOOL))
    own = _mapping("joint", tables.get("joint", {}))
    for name, content in own.items():
        robot.joint(name)
        _table(f"joint.{name}", content, (*_SHARED, "limits"))
    axes = [_axis(tables, own.get(name, {}), name) for name in robot.names]
    joints = ["prismatic" if j.kind == "prismatic" else "revolute" for j in robot.joints]
    log = record_format(_table("record", tables.get("record", {}), TABLES["record"]), joints)
    start = {
        k: number("start", k, v) for k, v in _mapping("start", tables.get("start", {})).items()
    }
    return RobotLoop(
        robot,
        axes,
        name=str(table.get("name", robot.name)),
        transmission=_transmission(table.get("transmission"), robot.n_joints),
        start=start,
        log=log,
    )


def _robot(table: Mapping[str, Any], folder: Path) -> Robot:
    """Return the robot that a [robot] table names."""
    models = [key for key in ("urdf", "mjcf") if key in table]
    if len(models) != 1 or not isinstance(table[models[0]], str):
        raise AxisError('[robot] needs one of urdf = "FILE" and mjcf = "FILE"')
    joints = table.get("joints")
    if joints is not None and not (
        isinstance(joints, list) and joints and all(isinstance(j, str) for j in joints)
    ):
        raise AxisError(f"[robot] joints = {joints!r}; give a list of names")
    file = folder / table[models[0]]
    robot = Robot.from_urdf(file, joints) if models == ["urdf"] else Robot.from_mjcf(file, joints)
    if "gravity" in table:
        x, y, z = _numbers("robot", "gravity", table["gravity"], 3)
        robot = robot.with_gravity((x, y, z))
    return robot


def _with_tool(robot: Robot, table: Mapping[str, Any]) -> Robot:
    for key in ("link", "mass"):
        if key not in table:
            raise AxisError(f"[tool] {key} is missing; a tool has a link and a mass")
    com = _numbers("tool", "com", table.get("com", [0.0, 0.0, 0.0]), 3)
    rows = table.get("inertia", [[0.0] * 3] * 3)
    if not isinstance(rows, list) or len(rows) != 3:
        raise AxisError(f"[tool] inertia = {rows!r}; give 3 rows of 3 numbers")
    tensor = [_numbers("tool", "inertia", row, 3) for row in rows]
    return robot.with_tool(str(table["link"]), number("tool", "mass", table["mass"]), com, tensor)


def _transmission(rows: Any, n: int) -> list[list[float]] | None:
    if rows is None:
        return None
    if not isinstance(rows, list) or len(rows) != n:
        raise AxisError(f"[robot] transmission = {rows!r}; give {n} rows of {n} numbers")
    return [_numbers("robot", "transmission", row, n) for row in rows]


def _axis(tables: Mapping[str, Any], own: Mapping[str, Any], name: str) -> Any:
    """Return the axis of one joint: the defaults, and what is different in it."""
    merged: dict[str, Any] = {"axis": {"name": name, "joint": "revolute"}}
    for key in _SHARED:
        default, change = (_mapping(key, t.get(key, {})) for t in (tables, own))
        if key == "controller" and change.get("kind", default.get("kind")) != default.get("kind"):
            default = {}  # the settings of another kind say nothing
        merged[key] = {**default, **change}
        if key == "model":
            both = {
                k: v
                for table in (default, change)
                for k, v in _mapping("model.start", table.get("start", {})).items()
            }
            merged[key] |= {"start": both} if both else {}
    merged["model"].setdefault("terms", ["inertia", "viscous", "coulomb", "offset"])
    merged["drive"].setdefault("gain", 1.0)
    merged["controller"].setdefault("kind", "identify")
    try:
        return from_tables(merged)
    except AxisError as error:
        raise AxisError(f"joint {name}: {error}") from error


def write(loop: RobotLoop, model: str) -> str:
    """Return the robot file of a loop.

    Parameters
    ----------
    loop : RobotLoop
    model : str
        Path of the URDF or MJCF file that the robot comes from, as the file is to name it.
    """
    kind = "mjcf" if model.endswith(SUFFIXES) else "urdf"
    robot: dict[str, Any] = {"name": loop.name, kind: model, "joints": list(loop.joints)}
    if loop.transmission is not None:
        robot["transmission"] = [[float(x) for x in row] for row in loop._T]
    tables: dict[tuple[str, ...], Mapping[str, Any]] = {
        ("robot",): robot,
        ("record",): loop.log.to_dict(),
    }
    for joint, axis in zip(loop.joints, loop.axes, strict=True):
        for name in _SHARED:
            tables["joint", joint, name] = axis_tables(axis)[name]
        tables["joint", joint, "model", "start"] = axis.start
    tables["start",] = loop.start
    notes = "".join(f"# {note}\n" for note in loop.notes)
    blocks = [toml_table(parts, content) for parts, content in tables.items() if content]
    return notes + "\n" * bool(notes) + "\n\n".join(blocks) + "\n"


def _table(name: str, content: Any, known: tuple[str, ...]) -> Mapping[str, Any]:
    """Return a table after refusing keys that are not known."""
    for key in _mapping(name, content):
        if key not in known:
            raise AxisError(f"[{name}] does not know {key!r}; it knows: {', '.join(known)}")
    return _mapping(name, content)


def _mapping(name: str, content: Any) -> Mapping[str, Any]:
    if not isinstance(content, Mapping):
        raise AxisError(f"{name} = {content!r} is not a table; write [{name}]")
    return content


def _numbers(table: str, key: str, value: Any, count: int) -> list[float]:
    if not isinstance(value, list) or len(value) != count:
        raise AxisError(f"[{table}] {key} = {value!r}; give {count} numbers")
    return [number(table, key, x) for x in value]
