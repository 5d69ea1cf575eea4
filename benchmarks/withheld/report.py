"""Turn the JSON lines of a run into a table, a summary and figures.

python -m benchmarks.withheld.report build/withheld --out benchmarks/results/withheld
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt  # noqa: E402
import pandas as pd  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from . import calibration, figures, sections  # noqa: E402
from .cells import load  # noqa: E402

_DPI = 110


def summary(
    table: pd.DataFrame, found: calibration.Reliability | None, command: str, undrawn: int = 0
) -> str:
    """Return the summary in Markdown."""
    seeds = f"{table['seed'].min()} to {table['seed'].max()}"
    parts = [
        (
            "Withheld effects: results",
            f"{len(table)} cases, seeds {seeds}, made by\n\n    {command}"
            + f"\n\n{undrawn} more had no detectable case in 200 draws." * bool(undrawn),
        ),
        ("Suites", sections.suites(table) + "\n\n![](scores.png)"),
        ("Single effects", sections.effects(table) + "\n\n![](confusion.png)"),
        ("Real backgrounds", sections.backgrounds(table) + "\n\n![](backgrounds.png)"),
        ("Forces without a name", sections.nameless(table)),
        ("Small effects", sections.levels(table) + "\n\n![](power.png)"),
        ("How far the gap closes", sections.closing(table) + "\n\n![](intervals.png)"),
        ("Stated probabilities", sections.probabilities(found) + "\n\n![](reliability.png)"),
        ("Time", sections.times(table)),
        ("Every case that was not answered well", sections.failures(table)),
    ]
    text = [f"{'#' if i == 0 else '##'} {head}\n\n{body}\n" for i, (head, body) in enumerate(parts)]
    return "\n".join(text)


def drawings(
    table: pd.DataFrame, found: calibration.Reliability | None
) -> Iterator[tuple[str, Figure]]:
    """Yield the figures of what is there, with their names."""
    yield "scores", figures.scores(table)
    for name, suite, draw in (
        ("confusion", "single", figures.confusion),
        ("power", "small", figures.power),
    ):
        if (table["suite"] == suite).any():
            yield name, draw(table[table["suite"] == suite])
    if table["over_background"].notna().any():
        yield "backgrounds", figures.visible(table[table["over_background"].notna()])
    if table["true_after"].notna().any():
        yield "intervals", figures.intervals(table)
    if found is not None:
        yield "reliability", figures.reliability(found)


def main() -> None:
    """Read a folder of results and write the report."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/withheld"))
    parser.add_argument(
        "--command", default="python -m benchmarks.withheld.run all --first 1000 --jobs 2"
    )
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    table, rows = load(args.folder)
    names = calibration.stated(rows)
    found = calibration.reliability(names[names["suite"].isin(calibration.JUDGED)])
    table.to_csv(args.out / "cases.csv", index=False, float_format="%.4g")
    there = set()
    for name, figure in drawings(table, found):
        figure.savefig(args.out / f"{name}.png", dpi=_DPI)
        plt.close(figure)
        there.add(name)
    undrawn = sum(row["score"] == "undrawn" for row in rows)
    text = summary(table, found, args.command, undrawn)
    for name in ("confusion", "power", "backgrounds", "intervals", "reliability"):
        if name not in there:
            text = text.replace(f"\n\n![]({name}.png)", "")
    (args.out / "summary.md").write_text(text)


if __name__ == "__main__":
    main()
