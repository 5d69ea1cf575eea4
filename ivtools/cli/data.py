"""``ivtools data``: the registered data sets."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ivtools.cli import options
from ivtools.cli.output import show, write_json
from ivtools.errors import DataError

app = typer.Typer(help="List, fetch and locate the registered data sets.", no_args_is_help=False)
Name = Annotated[str, typer.Argument(metavar="NAME", help="A registered data set.")]


@app.command("list")
def listing(data: options.Data = None, json: options.Json = None) -> None:
    """List the registered data sets and where their files are."""
    from ivtools.registry import REGISTRY

    entries = {name: _entry(name, data) for name in REGISTRY}
    texts = [
        f"{name}\n    {entry['title']}\n    file: {entry['file']}\n    licence: {entry['licence']}"
        for name, entry in entries.items()
    ]
    write_json(entries, json)
    show(*texts, json_file=json)


def _entry(name: str, data: Path | None) -> dict[str, Any]:
    """Return what is known about a data set."""
    from ivtools import datasets

    data_set = datasets.REGISTRY[name]
    place = "none, it is simulated"
    if data_set.filename:
        try:
            found = datasets.find(name, data)
            place = str(found or f"not here; ivtools data fetch {name} downloads it")
        except DataError as error:
            place = str(error)
    return {
        "title": data_set.title,
        "file": place,
        "sha256": data_set.sha256 or None,
        "files": data_set.files,
        "origin": data_set.origin,
        "licence": data_set.licence,
        "citation": data_set.citation,
        "axis": data_set.axis,
    }


@app.command("fetch")
def fetch(
    name: Name,
    url: Annotated[
        str | None,
        typer.Option("--url", help="Address of a zip archive that holds the file."),
    ] = None,
    json: options.Json = None,
) -> None:
    """Download a data set into the cache, unless it is there, and check it."""
    from ivtools import datasets

    _print(name, datasets.fetch(name, url), json)


@app.command("path")
def path(name: Name, data: options.Data = None, json: options.Json = None) -> None:
    """Print the verified file of a data set, downloading it if it is nowhere."""
    from ivtools import datasets

    _print(name, datasets.path(name, data), json)


def _print(name: str, file: Path, json: Path | None) -> None:
    write_json({"name": name, "path": str(file)}, json)
    show(file, json_file=json)
