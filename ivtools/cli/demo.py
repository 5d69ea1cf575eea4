"""``ivtools demo``: the main job on the embedded record, without a network."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ivtools.cli import options
from ivtools.cli.output import progress, show, write_json, write_page


def demo(
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="DIR", callback=options.folder, help="Where the report goes."
        ),
    ] = Path("ivtools-demo"),
    json: options.Json = None,
) -> None:
    """Identify a simulated axis, judge the result against the truth, write a report."""
    from ivtools.demo import STEPS, page
    from ivtools.demo import demo as perform

    with progress("demo", len(STEPS) + 2) as advance:
        result = perform(advance)
        made = page(result)
        advance("figures")
        file = write_page(made, out)
    write_json(result.to_dict(), json)
    show(*result.tables(), f"report: {file}", json_file=json)
