"""``ivtools reproduce``: the EMPS report, number by number."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ivtools.cli import options
from ivtools.cli.output import show, write_json, write_page, writing


def reproduce(
    data: options.Data = None,
    html: Annotated[
        Path | None,
        typer.Option("--html", metavar="FILE", help="Write the page with the figures."),
    ] = None,
    json: options.Json = None,
    out: options.Out = None,
) -> None:
    """Print every number of the EMPS report beside ours; status 1 if one differs."""
    from ivtools.reproduce import reproduce as compute

    result = compute(data)
    texts: list[object] = [*result.tables(), result.verdict()]
    if html is not None or out is not None:
        from ivtools.reproduce.page import page

        made = page(result)
        if html is not None:
            with writing(html):
                texts.append(f"report: {made.write(html)}")
        if out is not None:
            texts.append(f"report: {write_page(made, out)}")
    show(*texts, json_file=json)
    write_json(result.to_dict(), json)
    if not result.ok:
        raise typer.Exit(1)
