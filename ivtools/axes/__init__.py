"""Registered axes: everything known about an axis, as an axis file.

``iv.axes.emps()`` is the loop of ``emps.toml`` beside this file; every axis file in this folder is
a function of that name, ``iv.axes.laas_motor()`` of ``laas-motor.toml``.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import AxisError

if TYPE_CHECKING:
    from ..loop import ClosedLoop

_FOUND = sorted(path.stem for path in Path(__file__).parent.glob("*.toml"))
#: Axis files by name; the one that examples use comes first.
FILES = {
    name: Path(__file__).parent / f"{name}.toml"
    for name in sorted(_FOUND, key=lambda name: name != "emps")
}


def path(name: str) -> Path:
    """Return the axis file of a registered axis.

    Raises
    ------
    AxisError
        If there is none of that name; the message lists the known ones.
    """
    if name not in FILES:
        raise AxisError(f"{name!r} is not a registered axis; known axes: {', '.join(FILES)}")
    return FILES[name]


def __getattr__(name: str) -> Callable[[], ClosedLoop]:
    stem = name.replace("_", "-")
    if stem not in FILES:
        raise AttributeError(f"module 'ivtools.axes' has no attribute {name!r}")

    def axis() -> ClosedLoop:
        from ..loop import ClosedLoop

        return ClosedLoop.from_file(FILES[stem])

    axis.__name__ = axis.__qualname__ = name
    axis.__doc__ = f"Return the loop of the registered axis {stem}."
    return axis
