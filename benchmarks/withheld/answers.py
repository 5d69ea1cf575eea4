"""Answers: a case drawn, diagnosed on its records alone, and scored."""

from __future__ import annotations

import time
import traceback
import warnings
from typing import Any

from .cases import Case, draw
from .recorder import attributions, names
from .scores import score
from .suites import MEASURED, Task
from .truth import measure


def answer(task: Task, truth: bool = True) -> dict[str, Any]:
    """Return one row of the results; an error is a row too."""
    row: dict[str, Any] = {"key": task.key, "suite": task.suite, "seed": task.seed}
    try:
        case = draw(task)
    except RuntimeError as error:
        return {**row, "score": "undrawn", "error": str(error)}
    row |= {"label": case.label}
    try:
        return {**row, **diagnosed(case, task, truth)}
    except Exception:  # whatever it is, it belongs into the table
        return {**row, "score": "failed", "error": traceback.format_exc(limit=-4)}


def diagnosed(case: Case, task: Task, truth: bool) -> dict[str, Any]:
    """Diagnose the records of a case, then open its label."""
    warnings.simplefilter("ignore")
    import ivtools as iv
    from ivtools.loop.axis_file import from_tables

    loop = from_tables(case.axis.tables())
    first, second = (
        iv.Record.from_dict(r, name=n)
        for r, n in zip(case.records, ("record", "holdout"), strict=True)
    )
    left_out = task.effects if task.suite == "outside" else ()
    wall, cpu = time.perf_counter(), time.process_time()
    with attributions() as seen:
        gap = iv.diagnose(first, loop, holdout=second, without=left_out)
    times = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}
    found = gap.to_dict()
    figures = measure(case, gap, loop) if truth and task.suite in MEASURED else None
    return {
        "score": score(found, case.label),
        "time": times,
        "truth": None if figures is None else figures.to_dict(),
        "floors": [{"noise": f.noise, "generic": f.generic} for f in gap.floors],
        "names": [n for a in seen[-1:] for n in names(a, case.label["effects"])],
        "found": {k: v for k, v in found.items() if k not in ("where", "advice")},
    }
