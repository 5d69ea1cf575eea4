"""Ceiling: what naming whichever effect gains most would score, however weak the evidence.

    python -m benchmarks.withheld.ceiling background FOLDER [FOLDER ...]

Where the truth does not gain most on held-out data of all that was fitted, no criterion on these
fits could tell it. Where it does, a threshold must keep silent behind most of the cases in which
nothing is hidden: the table has the best one for each share of false names.
"""

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .run import read
from .scores import GOOD

FALSE = (0.0, 0.01, 0.03, 0.1)  # shares of the cases without an effect that would have a name


class Leader(NamedTuple):
    """The effect of a case that gains most.

    Attributes
    ----------
    gain : float
        Share of the reducible gap that it closes by itself on held-out data.
    true : bool or None
        Whether it is the hidden one; None where nothing is hidden.
    good : bool
        Whether the answer of the diagnosis was.
    """

    gain: float
    true: bool | None
    good: bool


def leader(row: dict[str, Any]) -> Leader:
    """Return the effect that gains most in a case."""
    fitted = [r for r in row["found"]["ranking"] if r["held_out"]]
    best = max(fitted, key=lambda r: r["closed"], default={"effect": "", "closed": 0.0})
    hidden = row["label"]["effects"]
    true = best["effect"] in hidden if hidden else None
    return Leader(best["closed"], true, row["score"] in GOOD[row["suite"]])


def table(leaders: Sequence[Leader]) -> str:
    """Return the scores of naming it always, and from thresholds on."""
    some = [x for x in leaders if x.true is not None]
    none = np.array([x.gain for x in leaders if x.true is None])
    lines = [
        f"{len(some)} with an effect, {len(none)} without",
        f"named always: {sum(bool(x.true) for x in some)} right; the diagnosis: "
        f"{sum(x.good for x in some)} good, either: {sum(x.true or x.good for x in some)}",
    ]
    for share in FALSE if len(none) else ():
        least = float(np.quantile(none, 1.0 - share))
        named = [x for x in some if x.gain > least]
        right = sum(bool(x.true) for x in named)
        lines.append(
            f"{100 * share:.0f} % of those without one named: from {100 * least:.0f} % closed on, "
            f"{right} right, {len(named) - right} wrong"
        )
    return "\n".join(lines)


def main(arguments: Iterable[str] | None = None) -> None:
    """Print the table of a suite over some runs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("suite")
    parser.add_argument("folders", nargs="+", type=Path)
    given = parser.parse_args(arguments)
    rows = (row for folder in given.folders for row in read(folder / f"{given.suite}.jsonl"))
    print(table([leader(row) for row in rows if "found" in row]))


if __name__ == "__main__":
    main()
