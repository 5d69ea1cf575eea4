"""``ivtools reproduce``: the EMPS report, number by number."""

from __future__ import annotations

import typer

from ivtools.cli import options
from ivtools.cli.output import show, write_json, write_page


def reproduce(
    data: options.Data = None,
    html: options.Html = None,
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
            texts.append(f"report: {made.write(html)}")
        if out is not None:
            texts.append(f"report: {write_page(made, out)}")
    write_json(result.to_dict(), json)
    show(*texts, json_file=json)
    if not result.ok:
        raise typer.Exit(1)
