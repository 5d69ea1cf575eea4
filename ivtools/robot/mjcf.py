"""MJCF: links and joints of a MuJoCo model, as MuJoCo compiles it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import suppress
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import AxisError, IVToolsWarning, MissingExtraError, shown
from ..xml_file import check_counts
from .assembly import Edge, assemble
from .inertia import body
from .robot import Robot

Array = NDArray[np.float64]

SUFFIXES = (".xml", ".mjcf")  # of its files
_KINDS = ("floating", "ball", "prismatic", "revolute")  # in MuJoCo's order


def engine() -> Any:
    """Return the module mujoco, or say what to install.

    What it warns of is ours to say; else it writes a file into the user's folder.
    """
    try:
        import mujoco
    except ImportError as error:
        raise MissingExtraError("mujoco", "mujoco") from error
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(_warned)
    return mujoco


def _warned(text: str) -> None:
    """Pass on a warning; where warnings are errors it is none, for MuJoCo cannot be unwound."""
    with suppress(IVToolsWarning):
        told = shown(" ".join(text.split()), 200)
        warnings.warn(f"MuJoCo: {told}", IVToolsWarning, stacklevel=2)


def read(path: str | Path, joints: Sequence[str] | None = None) -> Robot:
    """Read a MuJoCo model; see `Robot.from_mjcf`."""
    mujoco = engine()
    try:
        check_counts(Path(path))
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, OSError) as error:
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise AxisError(f"MJCF {path}: {reason}") from error
    try:
        return _robot(model, Path(path).stem, joints)
    except AxisError as error:
        raise AxisError(f"MJCF {path}: {error}") from error


def _robot(model: Any, name: str, joints: Sequence[str] | None) -> Robot:
    if model.neq:
        raise AxisError(
            f"{model.neq} equality constraints close chains or couple joints; remove <equality>"
        )
    links, edges = {"world": np.zeros((4, 4))}, []
    for b in range(1, model.nbody):
        link = _name(model.body(b), "body", b)
        tensor = _rotation(model.body_iquat[b])
        links[link] = body(
            model.body_mass[b],
            model.body_ipos[b],
            tensor @ np.diag(model.body_inertia[b]) @ tensor.T,
        )
        edges += _edges(model, b, link, links)
    x, y, z = (float(g) for g in model.opt.gravity)
    return assemble(name, links, edges, joints, (x, y, z))


def _edges(model: Any, b: int, link: str, links: dict[str, Array]) -> list[Edge]:
    """Return the edges to a body: one per joint, each about its own anchor, then a fixed one."""
    carrier = model.body_parentid[b]
    parent = _name(model.body(carrier), "body", carrier) if carrier else "world"
    rotation, position = _rotation(model.body_quat[b]), np.array(model.body_pos[b])
    anchor, found = np.zeros(3), []
    for j in range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b]):
        name, kind = _name(model.joint(j), "joint", j), _KINDS[model.jnt_type[j]]
        position = position + rotation @ (model.jnt_pos[j] - anchor)
        axis, zero = np.array(model.jnt_axis[j]), float(model.qpos0[model.jnt_qposadr[j]])
        if kind == "revolute":  # the drawn pose is at the reference position, not at 0
            rotation = rotation @ _about(axis, -zero)
        elif kind == "prismatic":
            position = position - rotation @ axis * zero
        child = f"{link} behind {name}"
        links[child] = np.zeros((4, 4))
        found.append(Edge(name, kind, parent, child, rotation, position, axis, _limits(model, j)))
        parent, rotation, position = child, np.eye(3), np.zeros(3)
        anchor = np.array(model.jnt_pos[j])
    found.append(
        Edge(f"to {link}", "fixed", parent, link, rotation, position - rotation @ anchor, anchor)
    )
    return found


def _limits(model: Any, j: int) -> dict[str, float]:
    d, limited = model.jnt_dofadr[j], bool(model.jnt_limited[j])
    forced = bool(model.jnt_actfrclimited[j])
    return {
        "lower": float(model.jnt_range[j, 0]) if limited else -inf,
        "upper": float(model.jnt_range[j, 1]) if limited else inf,
        "effort": float(model.jnt_actfrcrange[j, 1]) if forced else inf,
        "damping": float(np.ravel(model.dof_damping[d])[0]),
        "friction": float(model.dof_frictionloss[d]),
        "armature": float(model.dof_armature[d]),
    }


def _name(item: Any, what: str, index: int) -> str:
    return item.name or f"{what}{index}"


def _rotation(quaternion: Array) -> Array:
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _about(axis: Array, angle: float) -> Array:
    axis = axis / np.linalg.norm(axis)
    return _rotation(np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)]))
