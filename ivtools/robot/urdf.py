"""URDF: links and joints of an XML file, read by the standard library."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from math import inf
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import AxisError
from ..xml_file import parsed
from .assembly import Edge, assemble
from .inertia import body, moved
from .robot import Robot

Array = NDArray[np.float64]


def read(path: str | Path, joints: Sequence[str] | None = None) -> Robot:
    """Read a URDF file; see `Robot.from_urdf`."""
    try:
        return _robot(_parsed(Path(path)), joints)
    except AxisError as error:
        raise AxisError(f"URDF {path}: {error}") from error


def _parsed(path: Path) -> ET.Element:
    root = parsed(path)
    if root.tag != "robot":
        raise AxisError(f"<{root.tag}> is no robot; expand xacro files to URDF first")
    return root


def _robot(root: ET.Element, joints: Sequence[str] | None) -> Robot:
    links: dict[str, Array] = {}
    for link in root.findall("link"):
        name = _text(link, "name", "a link")
        if name in links:
            raise AxisError(f"link {name!r} is there twice; names must be unique")
        links[name] = _inertia(link, f"link {name!r}")
    edges = [_edge(joint) for joint in root.findall("joint")]
    implied = {e.parent for e in edges if e.parent == "world"} - set(links)  # often not written
    links.update({name: np.zeros((4, 4)) for name in implied})
    return assemble(root.get("name") or "robot", links, edges, joints)


def _inertia(link: ET.Element, what: str) -> Array:
    """Return the pseudo-inertia of a link in its own frame; zero if the file has none."""
    inertial = link.find("inertial")
    if inertial is None:
        return np.zeros((4, 4))
    mass = _number(inertial.find("mass"), "value", 0.0, what)
    tensor = inertial.find("inertia")
    xx, xy, xz, yy, yz, zz = (
        _number(tensor, key, 0.0, what) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    if mass < 0.0:
        raise AxisError(f"{what} has the mass {mass:g} kg; it cannot be negative")
    P = body(mass, np.zeros(3), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    return moved(P, *_origin(inertial, what))


def _edge(joint: ET.Element) -> Edge:
    name = _text(joint, "name", "a joint")
    what = f"joint {name!r}"
    kind = _text(joint, "type", what)
    limit, dynamics, mimic = (joint.find(tag) for tag in ("limit", "dynamics", "mimic"))
    turning = kind == "continuous" or limit is None
    limits = {
        "lower": -inf if turning else _number(limit, "lower", 0.0, what),
        "upper": inf if turning else _number(limit, "upper", 0.0, what),
        "speed": _number(limit, "velocity", 0.0, what) or inf,
        "effort": _number(limit, "effort", 0.0, what) or inf,
        "damping": _number(dynamics, "damping", 0.0, what),
        "friction": _number(dynamics, "friction", 0.0, what),
    }
    rotation, position = _origin(joint, what)
    return Edge(
        name,
        kind,
        _text(joint.find("parent"), "link", f"{what}, <parent>"),
        _text(joint.find("child"), "link", f"{what}, <child>"),
        rotation,
        position,
        _vector(joint.find("axis"), "xyz", (1.0, 0.0, 0.0), what),
        limits,
        "" if mimic is None else mimic.get("joint", "another"),
    )


def _origin(element: ET.Element, what: str) -> tuple[Array, Array]:
    """Return the rotation (3, 3) and position (3,) of <origin>; none is the identity."""
    origin = element.find("origin")
    zero = (0.0, 0.0, 0.0)
    roll, pitch, yaw = _vector(origin, "rpy", zero, what)
    return _turn(2, yaw) @ _turn(1, pitch) @ _turn(0, roll), _vector(origin, "xyz", zero, what)


def _turn(axis: int, angle: float) -> Array:
    """Return the rotation (3, 3) about a coordinate axis."""
    R, (i, j) = np.eye(3), ((1, 2), (2, 0), (0, 1))[axis]
    R[i, i] = R[j, j] = np.cos(angle)
    R[i, j], R[j, i] = -np.sin(angle), np.sin(angle)
    return R


def _text(element: ET.Element | None, key: str, what: str) -> str:
    value = None if element is None else element.get(key)
    if not value:
        raise AxisError(f"{what} lacks the attribute {key!r}")
    return value


def _number(element: ET.Element | None, key: str, default: float, what: str) -> float:
    value = None if element is None else element.get(key)
    return default if value is None else float(_numbers(value, 1, key, what)[0])


def _vector(
    element: ET.Element | None, key: str, default: tuple[float, float, float], what: str
) -> Array:
    value = None if element is None else element.get(key)
    return np.array(default) if value is None else _numbers(value, 3, key, what)


def _numbers(text: str, count: int, key: str, what: str) -> Array:
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        need = "a finite number" if count == 1 else f"{count} finite numbers"
        raise AxisError(f"{what} has {key} = {text[:60]!r}; give {need}")
    return values
