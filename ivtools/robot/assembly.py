"""From links and joints as a file has them to a robot: fixed links merged, axes along z."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import AxisError
from .inertia import moved, standard
from .robot import EARTH, Joint, Place, Robot

Array = NDArray[np.float64]

MOVING = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}
MOST_JOINTS = 40  # whose base parameters take seconds; the time rises with the cube
_LONGEST = 1e6  # m, and kg: numbers beyond are slips of the unit, and overflow when multiplied


@dataclass(frozen=True)
class Edge:
    """A joint as a file has it: between two links, fixed or moving.

    Parameters
    ----------
    name, kind, parent, child : str
        `kind` as in URDF.
    rotation, position : (3, 3), (3,) ndarray
        Frame of the joint in that of the parent link, m.
    axis : (3,) ndarray
        In the joint's frame; any length.
    limits : mapping
        `lower`, `upper`, `speed`, `effort`, `damping`, `friction`, `armature` of `Joint`.
    mimic : str
        Joint that it follows, if any.
    """

    name: str
    kind: str
    parent: str
    child: str
    rotation: Array
    position: Array
    axis: Array
    limits: Mapping[str, float] = field(default_factory=dict)
    mimic: str = ""


def assemble(
    name: str,
    links: Mapping[str, Array],
    edges: Sequence[Edge],
    joints: Sequence[str] | None = None,
    gravity: tuple[float, float, float] = EARTH,
) -> Robot:
    """Return the robot of these links (name to pseudo-inertia) and edges.

    Raises
    ------
    AxisError
        If they are no tree, a joint is of a kind that is not known here, or one moves no mass.
    """
    moving = _moving(edges, joints)
    root = _root(links, edges)
    children: dict[str, list[Edge]] = {}
    for edge in edges:
        children.setdefault(edge.parent, []).append(edge)
    found: list[Joint] = []
    places = {root: Place(-1, np.eye(3), np.zeros(3))}
    waiting = children.get(root, [])[::-1]
    while waiting:  # depth first, in the order of the file
        edge = waiting.pop()
        places[edge.child] = _attach(edge, places[edge.parent], edge.name in moving, found)
        waiting += children.get(edge.child, [])[::-1]
    if not found:
        raise AxisError("no joint moves; a robot has a revolute or prismatic joint at least")
    if len(found) > MOST_JOINTS:
        raise AxisError(
            f"{len(found)} joints move, more than {MOST_JOINTS}; name those that are to be "
            "identified"
        )
    bodies = np.zeros((len(found), 4, 4))
    for link, at in places.items():
        if at.joint >= 0:
            bodies[at.joint] += moved(links[link], at.rotation, at.position)
    _check_mass(found, bodies)
    inertias = np.array([standard(P) for P in bodies])
    return Robot(name, tuple(found), inertias, gravity, places, _doubts(found, bodies))


def _attach(edge: Edge, on: Place, moves: bool, found: list[Joint]) -> Place:
    """Return where an edge puts its child; a moving one joins the joints found."""
    rotation = on.rotation @ edge.rotation
    position = on.position + on.rotation @ edge.position
    if not moves:
        return Place(on.joint, rotation, position)
    turn = upright(edge.axis)
    found.append(
        Joint(
            edge.name,
            edge.child,
            MOVING[edge.kind],
            on.joint,
            rotation @ turn,
            position,
            **edge.limits,
        )
    )
    return Place(len(found) - 1, turn.T, np.zeros(3))


def upright(axis: Array) -> Array:
    """Return the least rotation (3, 3) that takes the z-axis to this axis.

    Examples
    --------
    >>> (upright(np.array([2.0, 0.0, 0.0])) @ [0.0, 0.0, 1.0]).tolist()
    [1.0, 0.0, 0.0]
    """
    x, y, z = axis / np.linalg.norm(axis)
    if z <= -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    v = np.array([[0.0, 0.0, x], [0.0, 0.0, y], [-x, -y, 0.0]])
    return np.asarray(np.eye(3) + v + v @ v / (1.0 + z), dtype=float)


def _moving(edges: Sequence[Edge], joints: Sequence[str] | None) -> set[str]:
    """Return the joints that move, after refusing those that cannot be had."""
    names = [edge.name for edge in edges]
    for name in names:
        if names.count(name) > 1:
            raise AxisError(f"joint {name!r} is there twice; names must be unique")
    free = [edge.name for edge in edges if edge.kind != "fixed"]
    for name in joints or ():
        if name not in free:
            raise AxisError(f"no joint {name!r} moves; those that do: {', '.join(free) or 'none'}")
    moving = set(free if joints is None else joints)
    for edge in edges:
        if edge.name in moving:
            _check_kind(edge)
    return moving


def _check_kind(edge: Edge) -> None:
    what = f"joint {edge.name!r}"
    if edge.kind not in MOVING:
        raise AxisError(
            f"{what} is {edge.kind}; a robot here has a fixed base and revolute, continuous and "
            "prismatic joints: name those that move (joints=[...]), the others are held at 0"
        )
    if edge.mimic:
        raise AxisError(
            f"{what} mimics {edge.mimic!r}: that is a closed chain; name the joints that move "
            "without it (joints=[...])"
        )
    if not 0.0 < np.linalg.norm(edge.axis) < np.inf:
        raise AxisError(f"{what} has the axis {edge.axis.tolist()}; give a direction")


def _root(links: Mapping[str, Array], edges: Sequence[Edge]) -> str:
    """Return the base link, after refusing what is no tree."""
    carried: dict[str, str] = {}
    for edge in edges:
        for link in (edge.parent, edge.child):
            if link not in links:
                raise AxisError(f"joint {edge.name!r} names link {link!r}, which does not exist")
        if edge.child in carried:
            raise AxisError(
                f"link {edge.child!r} is carried by joints {carried[edge.child]!r} and "
                f"{edge.name!r}: closed chains are not known here"
            )
        carried[edge.child] = edge.name
    roots = [link for link in links if link not in carried]
    if len(roots) != 1:
        what = f"{', '.join(map(repr, roots[:5]))} are all bases" if roots else "no link is a base"
        raise AxisError(f"{what}; a robot is one tree with one base")
    return roots[0]


def _check_mass(joints: Sequence[Joint], bodies: Array) -> None:
    """Refuse a joint that moves nothing: its acceleration would be undetermined."""
    carried = np.array(bodies)
    for i in range(len(joints) - 1, -1, -1):
        if not (carried[i].any() or joints[i].armature):
            raise AxisError(
                f"joint {joints[i].name!r} moves link {joints[i].link!r} without inertia; give "
                "<inertial> to it or to what it carries"
            )
        if joints[i].parent >= 0:
            carried[joints[i].parent] += carried[i]
    if not (np.isfinite(bodies).all() and np.abs(bodies).max() < _LONGEST**2):
        raise AxisError("a link's inertia is not finite or absurdly large; check units (kg, m)")


def _doubts(joints: Sequence[Joint], bodies: Array) -> tuple[str, ...]:
    """Return which links cannot exist as the file describes them."""
    impossible: list[Any] = []
    for joint, P in zip(joints, bodies, strict=True):
        values = np.linalg.eigvalsh(P)
        if values[0] < -1e-6 * max(values[-1], 1e-12):
            impossible.append(joint.link)
    if not impossible:
        return ()
    return (f"no body has the inertia of {', '.join(impossible)}: mass or moments do not fit",)
