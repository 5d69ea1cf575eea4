"""A diagnosis, written into a URDF: viscous and Coulomb friction, which is all that it can hold."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

from ivtools.errors import AxisError
from ivtools.xml_file import parsed

_HELD = {"viscous": "damping", "coulomb": "friction"}
_ELSEWHERE = {
    "inertia": "the inertia belongs to the links; a single joint does not say which",
    "offset": "URDF has no constant force",
}


def export(
    path: str | Path,
    joint: str,
    theta: Mapping[str, float],
    changes: Mapping[str, float] | None = None,
) -> tuple[str, list[str]]:
    """Return a URDF with the friction of one joint, and a line for all that it cannot hold.

    Parameters
    ----------
    path : str or Path
    joint : str
    theta : mapping
        Parameters of the diagnosed loop.
    changes : mapping, optional
        Changes against the URDF's own values, which are added to them.

    Raises
    ------
    AxisError
        The file cannot be read, or has no such joint.
    """
    root = parsed(Path(path), comments=True)
    joints = {e.get("name"): e for e in root.findall("joint")}
    if joint not in joints:
        known = ", ".join(name for name in joints if name) or "none"
        raise AxisError(f"{path} has no joint {joint!r}; it has: {known}")
    dynamics = joints[joint].find("dynamics")
    if dynamics is None:
        dynamics = ET.SubElement(joints[joint], "dynamics")
    for name, key in _HELD.items():
        own = float(dynamics.get(key) or 0.0)
        if changes is not None and name in changes:
            dynamics.set(key, f"{max(own + changes[name], 0.0):.10g}")
        elif changes is None and name in theta:
            dynamics.set(key, f"{max(theta[name], 0.0):.10g}")
    values = {**theta, **(changes or {})}
    lost = [f"not held by URDF: {n} {v:.10g}{_why(n)}" for n, v in values.items() if n not in _HELD]
    for line in lost:
        joints[joint].append(ET.Comment(f" {line} "))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n", lost


def _why(name: str) -> str:
    return f"; {_ELSEWHERE[name]}" if name in _ELSEWHERE else ""
