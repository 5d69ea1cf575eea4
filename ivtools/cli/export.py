"""``ivtools export``: a diagnosis, for other tools."""

from __future__ import annotations

import json as jsons
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ivtools.cli import options
from ivtools.cli.output import show
from ivtools.errors import AxisError, DataError
from ivtools.files import write

if TYPE_CHECKING:
    from ivtools.loop import ClosedLoop

app = typer.Typer(help="Write what a diagnosis found into a model of another tool.")

Found = Annotated[
    Path, typer.Option("--diagnosis", metavar="FILE", help="What `ivtools diagnose --json` wrote.")
]
Out = Annotated[Path, typer.Option("--out", metavar="FILE", help="The new file.")]
Joint = Annotated[str, typer.Option("--joint", metavar="NAME", help="The joint that was measured.")]


@app.command("mjcf")
def mjcf(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="A MuJoCo model (MJCF).")],
    joint: Joint,
    diagnosis: Found,
    out: Out,
    actuator: Annotated[
        str | None, typer.Option("--actuator", metavar="NAME", help="That drives the joint.")
    ] = None,
) -> None:
    """Write a diagnosis into a MuJoCo model: what it cannot hold becomes a comment."""
    from ivtools.simulators.mjcf import closed_loop
    from ivtools.simulators.mjcf_export import export

    content = _read(diagnosis)
    loop = _diagnosed(closed_loop(model, joint, actuator), content)
    theta, changes = _values(content)
    made = export(model, joint, loop, theta, actuator=actuator, changes=changes)
    made.write(out)
    told = [f"{out}: {len(made.native)} terms, {', '.join(made.native)}"]
    told += [f"not held by MuJoCo, a comment in the file: {name}" for name in made.lost]
    show("\n".join(told))


@app.command("urdf")
def urdf(
    model: Annotated[Path, typer.Argument(metavar="MODEL", help="A URDF.")],
    joint: Joint,
    diagnosis: Found,
    out: Out,
) -> None:
    """Write viscous and Coulomb friction into a URDF, which holds no more than that."""
    from ivtools.simulators.urdf_export import export

    theta, changes = _values(_read(diagnosis))
    xml, lost = export(model, joint, theta, changes)
    write(out, xml)
    show("\n".join([f"{out}: damping and friction of {joint}", *lost]))


@app.command("json")
def json(
    axis: options.Axis = None, diagnosis: Found = Path(), out: Out = Path("model.json")
) -> None:
    """Write equations and SI values of the diagnosed loop, for any tool."""
    from ivtools.simulators.plain import described

    loop, content = _own(axis, diagnosis)
    text = jsons.dumps(described(loop, content["theta"]), indent=2, allow_nan=False)
    write(out, text + "\n")
    show(f"{out}: {len(loop.terms)} terms")


@app.command("python")
def python(
    axis: options.Axis = None, diagnosis: Found = Path(), out: Out = Path("model.py")
) -> None:
    """Write the diagnosed force law and its loop as a Python file that needs NumPy only."""
    from ivtools.simulators.plain import program

    loop, content = _own(axis, diagnosis)
    write(out, program(loop, content["theta"]))
    show(f"{out}: force(q, dq, ddq, tau, t) and simulate(t, q_ref)")


def _own(axis: str | None, diagnosis: Path) -> tuple[ClosedLoop, dict[str, Any]]:
    """Return the diagnosed loop of an axis file."""
    from ivtools.cli.case import load_axis

    if axis is None:
        raise DataError("--axis is missing: the axis file that the diagnosis used")
    content = _read(diagnosis)
    return _diagnosed(load_axis(axis), content), content


def _read(file: Path) -> dict[str, Any]:
    """Read the JSON of a diagnosis.

    Raises
    ------
    DataError
        If it is not one, or found no model.
    """
    try:
        content = jsons.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise DataError(f"{file} cannot be read as JSON: {str(error)[:100]}") from error
    theta = content.get("theta") if isinstance(content, dict) else None
    numbers = isinstance(theta, dict) and all(isinstance(v, int | float) for v in theta.values())
    if not (numbers and theta):
        raise DataError(
            f"{file} holds no model; give what `ivtools diagnose ... --json {file.name}` wrote "
            "of a record that could be compared"
        )
    return content


def _diagnosed(loop: ClosedLoop, content: dict[str, Any]) -> ClosedLoop:
    """Return a loop with the effects that a diagnosis named."""
    from ivtools.physics import EFFECTS

    for name in content.get("effects", []):
        if name not in EFFECTS:
            raise AxisError(f"the diagnosis names {name!r}, which is no effect of this version")
        if EFFECTS[name].parameters and name not in [t.name for t in loop.terms]:
            loop = loop.with_effect(name)
    return loop


def _values(content: dict[str, Any]) -> tuple[dict[str, float], dict[str, float] | None]:
    """Return values of the effects, and changes of the base parameters if a simulator was seen."""
    changes = content.get("changes")
    if not changes:
        return content["theta"], None
    named = tuple(f"{effect}." for effect in content.get("effects", []))
    base = {name: c["change"] for name, c in changes.items() if not name.startswith(named)}
    return {name: c["real"] - c["simulator"] for name, c in changes.items()}, base
