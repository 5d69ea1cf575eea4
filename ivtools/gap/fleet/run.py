"""Run: the diagnosis of many records of one kind of axis, in parallel and resumable."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

from ... import __version__
from ...digest import digest, loop_text
from ...errors import IVToolsError
from ...loop import ClosedLoop
from ...physics import Term
from ...record import Record
from ...record_format import RecordFormat
from ...resume import resumable
from ...workers import Backend, Clock, Progress, known, outcomes, packed, quiet
from ..diagnose import diagnose
from ..diagnosis import Diagnosis
from ..rules import TOLERANCE, Rules
from .entry import Entry
from .fleet import Fleet
from .shelf import PAGES, SHARED, Shelf
from .source import Given, Source, sources


class _Job(NamedTuple):
    """A record that is to be diagnosed: its entry so far, and the key of its result."""

    source: Source
    entry: Entry
    key: str
    holdout: Record | None
    judge: Record | None


def diagnose_fleet(
    records: Iterable[Given],
    loop: ClosedLoop,
    holdout: Given | None = None,
    *,
    judge: Given | None = None,
    tolerance: float = TOLERANCE,
    path: str | Path | None = None,
    n_jobs: int = -1,
    backend: Backend = "loky",
    scheduler: str | None = None,
    rules: Rules | None = None,
    extra: Sequence[Term] = (),
    without: Sequence[str] = (),
    data: str | Path | None = None,
    progress: Callable[[Progress], object] | None = None,
) -> Fleet:
    """Diagnose many records with one model: of a fleet of axes, or of one axis over the years.

    Parameters
    ----------
    records : iterable of Record, path or name of a data set
        A file that cannot be used becomes a row with the reason; the others go on.
    loop : ClosedLoop
        The model that is meant to be the twin of each.
    holdout : Record, path or name of a data set, optional
        Judges every record. Without it each record judges itself, stretch against stretch; so
        does the hold-out where it is among the records.
    judge : Record, path or name of a data set, optional
        A third record, which chooses nothing: clean figures for every record but itself.
    tolerance : float
        Per cent of the force below which a gap is negligible.
    path : str or Path, optional
        Folder that finished diagnoses go to, a page and a JSON file each, with an overview. A
        later run with the same folder does not repeat what has the same content of the record,
        the hold-out and the judge, loop, rules, tolerance and version of ivtools.
    n_jobs : int
        Workers; 1 works in this process, -1 uses every core. Dask uses the whole cluster.
    backend : {"loky", "threading", "dask"}
        Processes, threads, or a Dask cluster.
    scheduler : str, optional
        Address of the Dask scheduler; default the current client's.
    rules, extra, without
        As for `diagnose`.
    data : str or Path, optional
        Folder of the registered data sets.
    progress : callable, optional
        Called with a `Progress` after each record.

    Returns
    -------
    Fleet

    Raises
    ------
    IVToolsError
        If there is no record, the hold-out or the judge cannot be read or are one record, or the
        folder cannot be written.

    Examples
    --------
    >>> import ivtools as iv
    >>> twin = iv.datasets.twin()
    >>> fleet = diagnose_fleet([twin.slice(0, 12000)], iv.axes.emps(), n_jobs=1)
    >>> fleet.frame()["verdict"].tolist()
    ['explained']
    """
    backend = known(backend)
    shelf = None if path is None else Shelf(Path(path))
    settings: dict[str, Any] = {"rules": rules, "extra": tuple(extra), "without": tuple(without)}
    settings["tolerance"] = tolerance
    given = sources(records, loop.log, data)
    if not given:
        raise IVToolsError("there is no record to diagnose; give files, data sets or records")
    others = [None if x is None else _Other.of(x, loop.log, data) for x in (holdout, judge)]
    if others[0] is not None and others[1] is not None and others[0].digest == others[1].digest:
        raise IVToolsError(
            f"{others[1].name} is hold-out and judge: a judge takes part in nothing; give a third "
            "record"
        )
    with resumable(None if shelf is None else shelf.folder, PAGES):
        if shelf is not None:
            shelf.prepare()
        entries, jobs = _planned(given, others, shelf, loop, settings)
        clock = Clock(len(jobs), progress)
        tasks = _tasks(jobs, loop, settings, shelf is not None, entries, clock)
        work = outcomes(_work, tasks, _fewer(n_jobs, jobs), backend, scheduler, _lost)
        try:
            for key, done, html in work:
                kept = done if shelf is None or done.error else shelf.keep(done, key, html)
                entries[done.name] = kept
                clock.tick()
        except KeyboardInterrupt:
            fleet = _gathered(given, entries, loop, shelf)
            raise KeyboardInterrupt(fleet.stopped(len(given))) from None
        return _gathered(given, entries, loop, shelf)


def _gathered(
    given: list[Source], entries: dict[str, Entry], loop: ClosedLoop, shelf: Shelf | None
) -> Fleet:
    """Return what there is, in the order that it was asked for, and write the overview."""
    finished = tuple(entries[s.name] for s in given if s.name in entries)
    fleet = Fleet(finished, loop.name, None if shelf is None else shelf.folder)
    if shelf is not None:
        fleet.save(shelf.folder)
    return fleet


class _Other(NamedTuple):
    """A hold-out or a judge of a fleet."""

    name: str
    record: Record
    digest: str

    @classmethod
    def of(cls, given: Given, log: RecordFormat | None, data: str | Path | None) -> _Other:
        """Return it as it was given: read, and with the digest of its content."""
        source = sources([given], log, data)[0]
        return cls(source.name, source.read(), source.digest())


def _planned(
    given: list[Source],
    others: Sequence[_Other | None],
    shelf: Shelf | None,
    loop: ClosedLoop,
    settings: dict[str, Any],
) -> tuple[dict[str, Entry], list[_Job]]:
    """Return the entries that are finished, and the jobs that are not."""
    entries, jobs = {}, []
    for source in given:
        entry = Entry(source.name, source.text)
        try:
            own = source.digest()
        except IVToolsError as error:
            entries[source.name] = replace(entry, error=_line(error))
            continue
        holdout, judge = (x if x is None or x.digest != own else None for x in others)
        if holdout is not None:
            entry = replace(entry, judged_by=holdout.name)
        model = [loop_text(loop), loop.start, loop.name]
        beside = ["" if x is None else x.digest for x in (holdout, judge)]
        key = digest(__version__, own, beside, model, settings)
        found = None if shelf is None else shelf.find(entry, key)
        if found is not None:
            entries[source.name] = found
        else:
            records = (None if x is None else x.record for x in (holdout, judge))
            jobs.append(_Job(source, entry, key, *records))
    return entries, jobs


def _tasks(
    jobs: list[_Job],
    loop: ClosedLoop,
    settings: dict[str, Any],
    paged: bool,
    entries: dict[str, Entry],
    clock: Clock,
) -> Iterator[tuple[str, Entry, bytes, bool]]:
    """Yield the work, reading each record when its turn comes; what cannot be read is an entry."""
    makers = [term.law for term in (*loop.terms, *settings["extra"]) if term.law is not None]
    for source, entry, key, holdout, judge in jobs:
        try:
            with quiet():
                record = source.read().replace(name=source.name)
            judged = {**settings, "judge": judge}
            sent = packed((record, loop, holdout, judged), makers, source.name)
        except IVToolsError as error:
            entries[source.name] = replace(entry, error=_line(error))
            clock.tick()
            continue
        yield key, entry, sent, paged


def _work(key: str, entry: Entry, sent: bytes, paged: bool) -> tuple[str, Entry, str]:
    """Diagnose one record; return its key, its entry and its page."""
    import cloudpickle

    record, loop, held, settings = cloudpickle.loads(sent)
    start = perf_counter()
    try:
        with quiet():
            found: Diagnosis = diagnose(record, loop, held, **settings)
            html = found.page().html(script=SHARED) if paged else ""
    except Exception as error:  # one record must not end the others
        return key, replace(entry, error=_line(error), seconds=perf_counter() - start), ""
    done = replace(
        entry,
        content=found.to_dict(),
        seconds=perf_counter() - start,
        diagnosis=None if paged else found,
    )
    return key, done, html


def _lost(key: str, entry: Entry, sent: bytes, paged: bool, reason: str) -> tuple[str, Entry, str]:
    """Return the entry of a record that no worker survives."""
    return key, replace(entry, error=f"it cannot be diagnosed: {reason}"), ""


def _line(error: Exception) -> str:
    """Return an error in one line; one that is not the input's fault says its kind."""
    text = " ".join(str(error).split())
    ours = isinstance(error, IVToolsError)
    return text if ours else f"internal error: {type(error).__name__}: {text}"


def _fewer(n_jobs: int, jobs: list[_Job]) -> int:
    """Return no more workers than there is work for."""
    return min(os.cpu_count() or 1, len(jobs)) or 1 if n_jobs == -1 else n_jobs
