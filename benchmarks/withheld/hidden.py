"""Hidden: what a force without a name leaves of effects that were missed, the truth being known.

    python -m benchmarks.withheld.hidden build/withheld/background.jsonl

fits the true effect of every case of a run that was not answered well, and prints its share of its
own beside the force without a name, and its size there, relative to that by itself, on each fold.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

from .cases import draw
from .run import read
from .suites import SUITES, Task

_WELL = ("right", "ambiguous", "twin")


def missed(path: Path) -> Iterator[Task]:
    """Yield the cases with an effect that were not answered well."""
    keys = {r["key"] for r in read(path) if r["score"] not in (*_WELL, "undrawn")}
    seeds = sorted({int(key.split("/")[1]) for key in keys})
    tasks = SUITES[path.stem](range(seeds[0], seeds[-1] + 1)) if seeds else []
    return (t for t in tasks if t.effects and t.key in keys)


def measured(task: Task) -> dict[str, list[tuple[float, float]] | None]:
    """Return share and size of each true effect; None of what the screening does not see."""
    warnings.simplefilter("ignore")
    import ivtools as iv
    from ivtools.gap.discrepancy import Laws, beside_law
    from ivtools.gap.fit import common
    from ivtools.loop.axis_file import from_tables

    selection = sys.modules["ivtools.gap.attribute.selection"]
    forward, found = selection._Selection.forward, {}

    def noted(search: Any) -> Any:
        """Look for the true effects before any other."""
        for name in task.effects:
            trials = search.play([], [name]).trials
            both = [(common(t.before), common(t.held)) for t in trials]
            found[name] = beside_law(*both[0], Laws.of(both[0][0])) if both else None
        return forward(search)

    case = draw(task)
    records = [iv.Record.from_dict(r, name=n) for r, n in zip(case.records, "ab", strict=True)]
    with patch.object(selection._Selection, "forward", noted):
        iv.diagnose(records[0], from_tables(case.axis.tables()), holdout=records[1])
    return found


def main() -> None:
    """Read, fit, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="of a suite's results")
    for task in missed(parser.parse_args().file):
        for name, folds in measured(task).items():
            pairs = "; ".join(f"own {own:.2f}, size {size:.2f}" for own, size in folds or ())
            told = pairs or ("not seen" if folds is None else "no force without a name")
            print(f"{task.key:50} {name:22} {told}", flush=True)


if __name__ == "__main__":
    main()
