"""``ivtools diagnose``: what the simulation lacks."""

from __future__ import annotations

from ivtools.cli import options
from ivtools.cli.output import progress, show, write_json, writing


def diagnose(
    record: options.Record,
    axis: options.Axis = None,
    holdout: options.Holdout = None,
    data: options.Data = None,
    json: options.Json = None,
    out: options.Out = None,
) -> None:
    """Name what separates the simulation from the record, and how far it can be closed."""
    from ivtools import datasets
    from ivtools.cli.case import load
    from ivtools.gap import diagnose as find_gap

    measured, loop = load(record, axis, data)
    other = None
    if holdout is not None:
        columns = None if holdout in datasets.REGISTRY else loop.columns
        other = datasets.load(holdout, data, columns)
    with progress("diagnosing"):
        gap = find_gap(measured, loop, holdout=other)
    texts: list[object] = [gap.summary()]
    if out is not None:
        with writing(out):
            out.mkdir(parents=True, exist_ok=True)
            gap.to_html(out / "report.html")
        texts.append(f"report: {out / 'report.html'}")
    if json is not None:
        write_json(gap.to_dict(), json)
    show(*texts, json_file=json)
