"""``ivtools benchmark``: a Monte-Carlo study, named or described in a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from ivtools.cli import options
from ivtools.cli.output import follow, show, write_json


def benchmark(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME|FILE",
            callback=options.known_study,
            help="A named study, or a study file (TOML, Python).",
        ),
    ],
    jobs: Annotated[int, typer.Option("--jobs", help="Workers; -1 is one per core.")] = 1,
    seeds: Annotated[
        int | None, typer.Option("--seeds", help="Repetitions; default: the study's own.")
    ] = None,
    backend: Annotated[
        options.Backend, typer.Option("--backend", help="Where they run.")
    ] = options.Backend.LOKY,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="ADDRESS", help="Of a Dask cluster.")
    ] = None,
    json: options.Json = None,
    out: options.Out = None,
) -> None:
    """Run a Monte-Carlo study; with --out it goes on where it was interrupted."""
    if name == "leaderboard":
        return _leaderboard(json, out)
    from ivtools.study import load

    study = load(name, seeds)
    rows = None if out is None else out / "rows"
    study.run(jobs, backend.value, rows, scheduler, progress=follow())
    score = study.score()
    texts: list[object] = [score]
    if out is not None:
        texts.append(f"report: {score.save(out)}")
    if json is not None:
        write_json(score.to_dict(), json)
    show(*texts, json_file=json)


def _leaderboard(json: Path | None, out: Path | None) -> None:
    """Run the EMPS protocol and print the board."""
    from ivtools import axes, datasets
    from ivtools.files import write
    from ivtools.gap import diagnose
    from ivtools.leaderboard import leaderboard
    from ivtools.tables import csv

    train, axis = datasets.emps(), axes.emps()
    gap = diagnose(train, axis)
    named = replace(gap.loop, start={**gap.loop.start, **gap.theta})
    board = leaderboard(train, datasets.emps_pulses(), axis, diagnosed=named)
    if out is not None:
        write(out / "leaderboard.md", board.to_markdown())
        write(out / "leaderboard.csv", csv(board.frame()))
    if json is not None:
        write_json(board.to_dict(), json)
    show(board.summary(), json_file=json)
