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
            metavar="NAME|new", help="A registered axis, such as emps; or new, for one of a log."
        ),
    ],
    log: Annotated[
        str | None, typer.Argument(metavar="LOG", help="With new: the log that tells the axis.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="FILE", callback=options.file, help="With new: the axis file to write."
        ),
    ] = None,
    json: options.Json = None,
) -> None:
    """Print a registered axis file, or make a first one of a log: ivtools axis new LOG."""
    if name == "new":
        return _new(log, out, json)
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
