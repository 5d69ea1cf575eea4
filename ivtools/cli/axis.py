"""``ivtools axis``: the file of a registered axis, or a first one made from a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ivtools.cli import options
from ivtools.cli.output import show, write_json
from ivtools.errors import AxisError, DataError


def axis(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME|new|from-mjcf",
            help="A registered axis, such as emps; new, for one of a log; from-mjcf, of a model.",
        ),
    ],
    log: Annotated[
        str | None,
        typer.Argument(
            metavar="LOG|MODEL", help="The log that tells the axis, or a MuJoCo model of it."
        ),
    ] = None,
    joint: Annotated[
        str | None, typer.Option("--joint", metavar="NAME", help="With from-mjcf: the joint.")
    ] = None,
    actuator: Annotated[
        str | None, typer.Option("--actuator", metavar="NAME", help="With from-mjcf: its drive.")
    ] = None,
    keyframe: Annotated[
        str | None, typer.Option("--keyframe", metavar="NAME", help="With from-mjcf: the pose.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="FILE", callback=options.file, help="The axis file to write."
        ),
    ] = None,
    json: options.Json = None,
) -> None:
    """Print a registered axis file, or make one: axis new LOG, axis from-mjcf MODEL --joint J."""
    if name == "new":
        return _new(log, out, json)
    if name == "from-mjcf":
        return _from_mjcf(log, joint, actuator, keyframe, out, json)
    if log is not None or out is not None:
        raise AxisError(f"ivtools axis {name} prints a file; ivtools axis new LOG makes one")
    import tomllib

    from ivtools import axes

    text = axes.path(name).read_text(encoding="utf-8")
    write_json(tomllib.loads(text), json)
    show(text.rstrip("\n"), json_file=json)


def _new(log: str | None, out: Path | None, json: Path | None) -> None:
    """Guess columns, units, rate and law of a log, and write a commented axis file."""
    if log is None:
        raise DataError("ivtools axis new needs a log: ivtools axis new log.csv --out axis.toml")
    if not options.is_file(log):
        raise DataError(f"{log}: there is no such file; check the name and the folder")
    from ivtools.guess import first_axis

    found = first_axis(log)
    texts: list[object] = [found.summary()]
    if out is None:
        texts.append(found.to_toml().rstrip("\n"))
    else:
        from ivtools.files import write

        write(out, found.to_toml())
        texts.append(f"axis file: {out}\nnext: ivtools check {log} --axis {out}")
    write_json(found.to_dict(), json)
    show(*texts, json_file=json)


def _from_mjcf(
    model: str | None,
    joint: str | None,
    actuator: str | None,
    keyframe: str | None,
    out: Path | None,
    json: Path | None,
) -> None:
    """Read a joint of a MuJoCo model as an axis file."""
    if model is None or joint is None:
        raise DataError(
            "ivtools axis from-mjcf needs a model and a joint: ivtools axis from-mjcf model.xml "
            "--joint NAME"
        )
    import tomllib

    from ivtools.files import write
    from ivtools.loop import ClosedLoop

    text = ClosedLoop.from_mjcf(model, joint, actuator, keyframe).to_toml()
    write_json(tomllib.loads(text), json)
    if out is not None:
        write(out, text)
    show(text.rstrip("\n") if out is None else f"axis file: {out}", json_file=json)
