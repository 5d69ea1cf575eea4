"""``ivtools excite``: a reference that makes a record tell the parameters."""

from __future__ import annotations

import tomllib
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ivtools.cli import options
from ivtools.cli.output import progress, show, write_json
from ivtools.errors import AxisError, DataError

if TYPE_CHECKING:
    from ivtools.excitation import Excitation, Limits

_TERMS: Any = ("inertia", "viscous", "coulomb", "offset")


class Kind(StrEnum):
    """What kind of reference."""

    FOURIER = "fourier"
    STEPS = "steps"
    SWEEP = "sweep"
    BANG_BANG = "bang-bang"


class Criterion(StrEnum):
    """What a Fourier series is chosen for."""

    CONDITION = "condition"
    D = "d"
    A = "a"


def excite(
    model: Annotated[
        Path,
        typer.Argument(
            metavar="MODEL",
            callback=options.known_model,
            help="URDF or MJCF file, robot file, or axis file or registered axis.",
        ),
    ],
    limits: Annotated[
        Path | None,
        typer.Option(
            "--limits",
            metavar="FILE",
            callback=options.known_limits,
            help="TOML with tables limits and joint.NAME.limits: lower, upper, speed, "
            "acceleration, effort; before those of MODEL.",
        ),
    ] = None,
    kind: Annotated[
        Kind, typer.Option("--kind", help="Fourier series; for one axis also patterns.")
    ] = Kind.FOURIER,
    criterion: Annotated[
        Criterion,
        typer.Option("--criterion", help="Condition number, or D- or A-optimal variance."),
    ] = Criterion.CONDITION,
    seconds: Annotated[float, typer.Option("--seconds", help="Length of a period.")] = 20.0,
    rate: Annotated[float, typer.Option("--rate", help="Samples per second.")] = 1000.0,
    seed: Annotated[int, typer.Option("--seed", help="Of the random series.")] = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE",
            callback=options.file,
            help="The csv to write; its figure is put beside it.",
        ),
    ] = None,
    json: options.Json = None,
) -> None:
    """Make a reference within limits whose record tells the parameters of a robot or an axis.

    t, q_ref and dq_ref; begin at rest at its first sample.
    """
    from ivtools.excitation import fourier, pattern

    if not (seconds > 0.0 and rate > 0.0 and seconds * rate <= 1e7):
        raise DataError(
            f"{seconds:g} s at {rate:g} Hz is no reference; both are above 0, 1e7 samples at most"
        )
    loop, bounds = _loop_and_limits(model, limits)
    if kind is Kind.FOURIER:
        with progress("searching", 3) as advance:
            found = fourier(
                loop,
                bounds,
                seconds=seconds,
                rate_hz=rate,
                criterion=criterion.value,
                seed=seed,
                progress=advance,
            )
    else:
        found = pattern(loop, bounds, kind.value, seconds=seconds, rate_hz=rate, seed=seed)
    texts: list[object] = [found.summary()]
    if out is not None:
        texts.append(_written(found, out, _kind(loop)))
    write_json(found.to_dict(), json)
    show(*texts, json_file=json)


def _kind(loop: Any) -> str | None:
    """Return the kind of all joints; None if they differ."""
    kinds = {j.kind for j in loop.robot.joints} if hasattr(loop, "robot") else {loop.joint}
    return kinds.pop() if len(kinds) == 1 else None


def _written(found: Excitation, out: Path, kind: str | None) -> str:
    from ivtools.files import write
    from ivtools.plots.style import encode

    figure = write(out.with_suffix(".svg"), encode(found.plot(kind)))
    return f"reference: {write(out, found.to_csv())}\nfigure: {figure}"


def _loop_and_limits(model: Path, file: Path | None) -> tuple[Any, Limits]:
    """Return the loop that is to be excited, and how far it may go."""
    from ivtools import axes
    from ivtools.cli.case import load_axis
    from ivtools.cli.robot import read_model
    from ivtools.excitation import Limits
    from ivtools.loop import ClosedLoop, Controller, RobotLoop
    from ivtools.robot.mjcf import SUFFIXES

    tables: dict[str, Any] = {} if file is None else _tables(file)
    if model.suffix in (".urdf", *SUFFIXES):
        robot = read_model(model)
        axis = ClosedLoop(Controller("none", {}), 1.0, _TERMS, joint="revolute")
        loop: Any = RobotLoop(robot, [axis] * robot.n_joints)
        return loop, Limits.from_tables(tables, loop.joints, robot)
    name = str(model)
    own = _tables(axes.FILES.get(name, model))
    if "robot" in own:
        loop = RobotLoop.from_file(model)
        return loop, Limits.from_tables(_merged(own, tables), loop.joints, loop.robot)
    return load_axis(name), Limits.from_tables(_merged(own, tables), ("axis",))


def _merged(own: dict[str, Any], stated: dict[str, Any]) -> dict[str, Any]:
    """Return the tables of limits of two files, the second one before the first."""
    joints = {**own.get("joint", {})}
    for name, content in stated.get("joint", {}).items():
        limits = {**joints.get(name, {}).get("limits", {}), **content.get("limits", {})}
        joints[name] = {"limits": limits}
    return {"limits": {**own.get("limits", {}), **stated.get("limits", {})}, "joint": joints}


def _tables(file: Path) -> dict[str, Any]:
    from ivtools import limits

    try:
        return tomllib.loads(limits.read_text(Path(file)))
    except (DataError, OSError) as error:
        reason = getattr(error, "strerror", None) or error
        raise AxisError(f"limits file {file}: {reason}; give the path of a TOML file") from error
    except (ValueError, RecursionError) as error:
        raise AxisError(f"limits file {file} is not TOML: {error}") from error
