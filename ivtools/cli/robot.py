"""``ivtools robot``: what a robot's model says, and a draft of its robot file."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ivtools.cli import options
from ivtools.cli.output import show, write_json
from ivtools.errors import AxisError

if TYPE_CHECKING:
    from ivtools.robot import Robot

app = typer.Typer(help="Robots: what a model says, and a draft of a robot file.")
Model = Annotated[
    Path,
    typer.Argument(metavar="MODEL", callback=options.present, help="URDF file, or MJCF (.xml)."),
]
Joints = Annotated[
    str | None,
    typer.Option(
        "--joints", metavar="LIST", help="Joints that move, by commas; the others stay at 0."
    ),
]


@app.command()
def info(model: Model, joints: Joints = None, json: options.Json = None) -> None:
    """Say what a model has: its joints, their limits, and its base parameters."""
    from ivtools.robot import base_parameters
    from ivtools.tables import table

    robot = read_model(model, joints)
    base = base_parameters(robot)
    header = ["", "joint", "kind", "on", "lower", "upper", "speed", "effort"]
    rows = []
    for i, joint in enumerate(robot.joints):
        on = "base" if joint.parent < 0 else robot.names[joint.parent]
        limits = (joint.lower, joint.upper, joint.speed, joint.effort)
        rows.append([str(i + 1), joint.name, joint.kind, on, *(f"{x:.4g}" for x in limits)])
    title = f"Robot {robot.name}: {robot.n_joints} joints, {len(base.names)} base parameters"
    sums = "; ".join(f"{n} = {f}" for n, f in base.formulas.items() if n.endswith("R"))
    notes = [f"base parameters: {', '.join(base.names)}", f"where {sums}", *robot.notes]
    content = {
        "name": robot.name,
        "joints": [dict(zip(header[1:], row[1:], strict=True)) for row in rows],
        "base": base.formulas,
        "links": robot.links(),
        "notes": list(robot.notes),
    }
    write_json(content, json)
    show(table(title, [], header, rows, notes, left=4), json_file=json)


@app.command()
def new(
    record: options.Record,
    urdf: Annotated[
        Path,
        typer.Option(
            "--urdf",
            metavar="MODEL",
            callback=options.present,
            help="URDF file, or MJCF (.xml).",
        ),
    ],
    joints: Joints = None,
    gain: Annotated[float, typer.Option("--gain", help="Drive gain of every joint.")] = 1.0,
    data: options.Data = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Where to; default: stdout.")
    ] = None,
) -> None:
    """Draft the robot file of a log: each joint's control law is fitted to it."""
    from ivtools import datasets
    from ivtools.files import write
    from ivtools.loop import ClosedLoop, Controller, RobotLoop

    robot = read_model(urdf, joints)
    found = datasets.load(record, data)
    opened = found.q_ref is None and found.dq_ref is None
    controller = Controller("none" if opened else "identify", {})
    terms: Any = ("inertia", "viscous", "coulomb", "offset")
    loop = RobotLoop(robot, [ClosedLoop(controller, gain, terms)] * robot.n_joints)
    loop = replace(loop.known(found), name=robot.name)
    text = loop.to_toml(_seen_from(out, urdf))
    if out is not None:
        write(out, text)
    show(f"wrote {out}" if out is not None else text.rstrip())


def _seen_from(file: Path | None, model: Path) -> str:
    """Return the path of a model as the file that names it reads it: from its own folder."""
    if file is None or model.is_absolute():
        return str(model)
    try:
        return Path(os.path.relpath(model, file.parent)).as_posix()
    except ValueError:  # on another drive
        return str(model.absolute())


def read_model(model: Path, joints: str | None = None) -> Robot:
    """Return the robot of a URDF or MJCF file."""
    from ivtools.robot import Robot
    from ivtools.robot.mjcf import SUFFIXES

    if not model.exists():
        raise AxisError(f"{model}: there is no such file; give a URDF or MJCF file")
    names = joints.replace(",", " ").split() if joints else None
    if model.suffix in SUFFIXES:
        return Robot.from_mjcf(model, names)
    return Robot.from_urdf(model, names)
