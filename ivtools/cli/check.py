"""``ivtools check``: what will be used of a log, and whether it suffices."""

from __future__ import annotations

from ivtools.cli import options
from ivtools.cli.output import show, write_json, write_page


def check(
    record: options.Record,
    axis: options.Axis = None,
    data: options.Data = None,
    json: options.Json = None,
    out: options.Out = None,
) -> None:
    """Say what will be used of a log, in which units, and whether it suffices."""
    from ivtools.cli.case import load

    measured, loop = load(record, axis, data)
    from ivtools.suitability import suitability

    found = suitability(measured, loop)
    texts: list[object] = [found.summary()]
    if out is not None:
        from ivtools.files import write
        from ivtools.log_page import log_page
        from ivtools.plots.style import encode

        write(out / "record.svg", encode(found.plot()))

        texts.append(f"report: {write_page(log_page(found), out)}")
    write_json(found.to_dict(), json)
    show(*texts, json_file=json)
