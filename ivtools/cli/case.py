"""From the names on the command line to a record, its loop and a model of it."""

from __future__ import annotations

import json
import sys
import tomllib
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ivtools import limits
from ivtools.cli.options import Friction
from ivtools.errors import AxisError, DataError, RecordWarning, shown

if TYPE_CHECKING:
    from ivtools.loop import ClosedLoop, RobotLoop
    from ivtools.record import Record

_FRICTION = ("viscous", "coulomb", "offset", "asymmetric-friction")


def load(
    record: str,
    axis: str | None = None,
    data: Path | None = None,
    friction: Friction | None = None,
    known: bool = True,
    robot: Path | None = None,
) -> tuple[Record, ClosedLoop | Any]:
    """Return the record and the loop that a command names.

    Parameters
    ----------
    record, axis, data, friction, robot
        As on the command line.
    known : bool
        Whether a controller that is to be identified is, from the record.

    Raises
    ------
    IVToolsError
        One of them cannot be found, read or used.
    """
    exists(record, axis, robot)
    from ivtools import datasets
    from ivtools.gap.preflight import doubts

    if robot is not None:
        return _load_robot(record, robot, axis, data, friction, known)
    loop = load_axis(axis or own_axis(record))
    found = datasets.load(record, data, loop.log)
    loop = loop.known(found) if known else loop
    for doubt in doubts(found, loop):
        warnings.warn(f"{found.name}: {doubt}", RecordWarning, stacklevel=2)
    return found, with_friction(loop, friction)


def _load_robot(
    record: str,
    robot: Path,
    axis: str | None,
    data: Path | None,
    friction: Friction | None,
    known: bool,
) -> tuple[Record, RobotLoop]:
    """Return the record and the loop of a robot."""
    from ivtools import datasets
    from ivtools.loop import RobotLoop
    from ivtools.loop.encoders import doubts

    if axis is not None:
        raise AxisError("--axis and --robot exclude each other; a robot file has its joints' axes")
    loop = RobotLoop.from_file(robot)
    found = datasets.load(record, data, loop.log)
    loop = loop.known(found) if known else loop
    for doubt in doubts(loop, found) if found.n_joints == loop.n_joints else ():
        warnings.warn(f"{found.name}: {doubt}", RecordWarning, stacklevel=2)
    if friction is not None:
        loop = replace(loop, axes=[with_friction(axis, friction) for axis in loop.axes], start={})
    return found, loop


def exists(record: str, axis: str | None = None, robot: Path | None = None) -> None:
    """Refuse names of nothing, before what is slow to import or to read.

    Raises
    ------
    DataError, AxisError
    """
    from ivtools.registry import REGISTRY

    if record not in REGISTRY and not _there(record):
        known = ", ".join(REGISTRY)
        raise DataError(f"{record}: there is no such file and no such data set ({known})")
    if robot is None:
        axis_path(axis or own_axis(record))


def _there(path: str | Path) -> bool:
    try:
        return Path(path).expanduser().exists()
    except (OSError, RuntimeError, ValueError):
        return True  # the reader says what is wrong with it


def axis_path(axis: str) -> Path:
    """Return the file of an axis that is named, if there is one."""
    from ivtools import axes

    if axis in axes.FILES:
        return axes.FILES[axis]
    if not _there(axis):
        raise AxisError(
            f"{axis}: No such file, and no registered axis; registered: {', '.join(axes.FILES)}"
        )
    return Path(axis)


def load_axis(axis: str) -> ClosedLoop:
    """Return a registered axis, or that of an axis file."""
    path = axis_path(axis)
    from ivtools.loop import ClosedLoop

    return ClosedLoop.from_file(path)


def own_axis(record: str) -> str:
    """Return the axis that a data set was recorded on."""
    from ivtools.registry import REGISTRY

    if record in REGISTRY and REGISTRY[record].axis:
        return REGISTRY[record].axis
    raise AxisError(
        f"the axis of {record} is not known; give --axis FILE (ivtools axis emps prints an example)"
    )


def with_friction(loop: ClosedLoop, friction: Friction | str | None) -> ClosedLoop:
    """Return the loop with this friction model in place of its own.

    The asymmetric model has no offset: its columns already hold one.
    """
    if friction is None:
        return loop
    model = _FRICTION[3:] if friction == Friction.ASYMMETRIC else _FRICTION[:3]
    rest = [term for term in loop.terms if term.name not in _FRICTION]
    inertia = [term for term in rest if term.name == "inertia"]
    others = [term for term in rest if term.name != "inertia"]
    return loop.with_terms(*inertia, *model, *others)


def load_theta(file: Path) -> dict[str, float]:
    """Read parameters: a JSON of `identify`, or a JSON or TOML mapping of names to numbers.

    Raises
    ------
    DataError
        The file cannot be read, or holds no parameters.
    """
    try:
        text = limits.read_text(file)
        content = tomllib.loads(text) if file.suffix == ".toml" else json.loads(text)
    except DataError as error:
        raise DataError(f"parameter file {file}: {error}") from error
    except OSError as error:
        raise DataError(
            f"parameter file {file}: {error.strerror or error}; give a JSON file of identify"
        ) from error
    except (ValueError, RecursionError) as error:
        raise DataError(f"parameter file {file} is neither JSON nor TOML: {error}") from error
    return _numbers(file, content)


def _numbers(file: Path, content: Any) -> dict[str, float]:
    """Return the parameters in a file's content."""
    if isinstance(content, Mapping) and isinstance(content.get("params"), Mapping):
        content = content["params"]
    if not isinstance(content, Mapping) or not content:
        raise DataError(
            f'parameter file {file} holds no parameters; write {{"inertia": 95.1, ...}}'
        )
    for name, value in content.items():
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not abs(value) <= sys.float_info.max:
            told = shown(str(value) if isinstance(value, str | float) else type(value).__name__)
            raise DataError(f"parameter file {file}: {shown(name)} is {told}; give a finite number")
    return {str(name): float(value) for name, value in content.items()}
