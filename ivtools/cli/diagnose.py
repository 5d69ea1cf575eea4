"""``ivtools diagnose``: what the simulation lacks, of one record or of many."""

from __future__ import annotations

import glob
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ivtools.cli import options
from ivtools.cli.output import follow, progress, show, stoppable, write_json, write_page
from ivtools.errors import DataError

if TYPE_CHECKING:
    from ivtools.gap import Fleet
    from ivtools.loop import ClosedLoop
    from ivtools.record import Record


def diagnose(
    records: Annotated[
        list[str],
        typer.Argument(
            metavar="RECORD",
            help="A csv, parquet or mat file, or emps, emps-pulses, twin; several, a pattern such "
            "as 'logs/*.csv', or a folder, are diagnosed as a fleet.",
        ),
    ],
    axis: options.Axis = None,
    robot: options.Robot = None,
    joint: Annotated[
        list[str] | None,
        typer.Option("--joint", metavar="NAME", help="With --robot: only this joint; repeatable."),
    ] = None,
    holdout: options.Holdout = None,
    simulated: Annotated[
        str | None,
        typer.Option(
            "--simulated",
            metavar="SIM",
            help="What your own simulator did on the record's reference: what does it lack?",
        ),
    ] = None,
    simulated_holdout: Annotated[
        str | None,
        typer.Option("--simulated-holdout", metavar="SIM2", help="The same on the holdout's."),
    ] = None,
    judge: Annotated[
        str | None,
        typer.Option("--judge", metavar="RECORD", help="A third record, which chooses nothing."),
    ] = None,
    tolerance: Annotated[
        float,
        typer.Option("--tolerance", help="Per cent of the force below which a gap is negligible."),
    ] = 2.0,
    jobs: Annotated[
        int, typer.Option("--jobs", help="Workers for a fleet; -1 is one per core.")
    ] = -1,
    backend: Annotated[
        options.Backend, typer.Option("--backend", help="Where a fleet is diagnosed.")
    ] = options.Backend.LOKY,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="ADDRESS", help="Of a Dask cluster.")
    ] = None,
    data: options.Data = None,
    json: options.Json = None,
    out: options.Out = None,
) -> None:
    """Name what separates the simulation from a record, and how far it can be closed.

    Several records are a fleet: one table, and with --out a page of each.

    The same command again goes on where a fleet was stopped.

    Status of a fleet: 0 all are diagnosed, 1 some could not be, 2 none could.
    """
    names, several = _expanded(records)
    if joint and robot is None:
        raise DataError("--joint belongs to --robot FILE")
    if robot is not None:
        if several or axis or simulated or simulated_holdout or judge:
            raise DataError("--robot takes one record, and --holdout, --joint and --tolerance")
        return _robot(names[0], robot, holdout, joint, tolerance, data, json, out)
    if not several:
        return _one(
            names[0],
            axis,
            holdout,
            (simulated, simulated_holdout),
            data,
            json,
            out,
            judge,
            tolerance,
        )
    if simulated or simulated_holdout:
        raise DataError("--simulated belongs to one record; diagnose the records one at a time")
    loop = _loop(axis, names)
    from ivtools.gap import diagnose_fleet

    with stoppable():
        fleet = diagnose_fleet(
            names,
            loop,
            holdout,
            judge=judge,
            tolerance=tolerance,
            path=out,
            n_jobs=jobs,
            backend=backend.value,
            scheduler=scheduler,
            data=data,
            progress=follow(),
        )
    _tell(fleet, json, out)


def _one(
    name: str,
    axis: str | None,
    holdout: str | None,
    simulated: tuple[str | None, str | None],
    data: Path | None,
    json: Path | None,
    out: Path | None,
    judge: str | None,
    tolerance: float,
) -> None:
    """Diagnose a single record."""
    from ivtools.cli.case import exists, load, own_axis

    exists(name, axis)
    for one in (holdout, judge):
        if one is not None:
            exists(one, axis or own_axis(name))
    from ivtools.gap import diagnose as find_gap
    from ivtools.gap.simulator import changes_table

    measured, loop = load(name, axis, data, known=False)
    if simulated[0] is None and simulated[1] is not None:
        raise DataError("--simulated-holdout needs --simulated: a log of each reference")
    other, sim, sim_other = (
        None if file is None else _log(file, data, loop) for file in (holdout, *simulated)
    )
    third = None if judge is None else _log(judge, data, loop)
    with progress("diagnosing", 4) as advance:
        gap = find_gap(
            measured,
            loop,
            holdout=other,
            simulated=sim,
            simulated_holdout=sim_other,
            judge=third,
            tolerance=tolerance,
            progress=advance,
        )
    texts: list[object] = [gap.summary()]
    if gap.changes:
        texts.append(changes_table(gap.changes))
    if out is not None:
        texts.append(f"report: {write_page(gap.page(), out)}")
    if json is not None:
        write_json(gap.to_dict(), json)
    show(*texts, json_file=json)


def _robot(
    name: str,
    robot: Path,
    holdout: str | None,
    joints: list[str] | None,
    tolerance: float,
    data: Path | None,
    json: Path | None,
    out: Path | None,
) -> None:
    """Diagnose a robot, joint by joint."""
    from ivtools.cli.case import load
    from ivtools.gap import diagnose_robot

    loop: Any
    measured, loop = load(name, None, data, known=False, robot=robot)
    other = None if holdout is None else _log(holdout, data, loop)
    with progress("diagnosing", 2 + loop.n_joints) as advance:
        gap = diagnose_robot(
            measured, loop, other, joints=joints, tolerance=tolerance, progress=advance
        )
    texts: list[object] = [gap.summary()]
    if out is not None:
        texts.append(f"report: {write_page(gap.page(), out)}")
    write_json(gap.to_dict(), json)
    show(*texts, json_file=json)


def _log(name: str, data: Path | None, loop: ClosedLoop) -> Record:
    from ivtools import datasets

    return datasets.load(name, data, loop.log)


def _loop(axis: str | None, names: list[str]) -> ClosedLoop:
    """Return the axis of a fleet: that of the first record, if none is named."""
    from ivtools.cli.case import load_axis, own_axis

    return load_axis(axis or own_axis(names[0]))


def _tell(fleet: Fleet, json: Path | None, out: Path | None) -> None:
    """Print and write what was found, and end with a status that says whether it is all."""
    if not fleet.done:
        reasons = "; ".join(f"{e.name}: {e.error}" for e in fleet.failed[:3])
        more = f"; and {len(fleet) - 3} more" if len(fleet) > 3 else ""
        raise DataError(f"no record could be diagnosed: {reasons}{more}")
    texts: list[object] = [fleet.summary()]
    if out is not None:
        texts.append(f"report: {out / 'index.html'}\ntable: {out / 'fleet.csv'}")
    if json is not None:
        write_json(fleet.to_dict(), json)
    show(*texts, json_file=json)
    if fleet.failed:
        raise typer.Exit(1)


def _expanded(records: list[str]) -> tuple[list[str], bool]:
    """Return the records, patterns and folders opened, and whether they are a fleet.

    Raises
    ------
    DataError
        A pattern or a folder holds no record.
    """
    for record in records if len(records) == 1 else ():
        if not glob.has_magic(record):
            options.there(record)
    names: list[str] = []
    several = len(records) > 1
    for given in records:
        if Path(given).is_dir():
            from ivtools.readers import IN_FOLDERS

            found = sorted(str(f) for f in Path(given).iterdir() if f.name.endswith(IN_FOLDERS))
            several, rule = True, f"a folder of records holds {', '.join(IN_FOLDERS)} files"
        elif glob.has_magic(given) and not Path(given).exists():
            found, rule = sorted(glob.glob(given)), "name a file, or another pattern"
        else:
            found, rule = [given], ""
        if not found:
            raise DataError(f"{given}: no file matches; {rule}")
        names += found
    return names, several or len(names) > 1
