"""Write drawn cases as files: records and axis files to diagnose, labels to open afterwards.

    python -m benchmarks.withheld.seal single --first 0 --count 1 --out FOLDER

Each case is a folder with record.csv, holdout.csv and axis.toml; labels.json lies beside them.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from .cases import draw, write
from .suites import SUITES


def main() -> None:
    """Draw the cases of a suite and write them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("suite", choices=SUITES)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, default=1, help="number of seeds")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    labels = {}
    for task in SUITES[args.suite](range(args.first, args.first + args.count)):
        name, case = f"{args.suite}-{len(labels):03d}", draw(task)
        write(case, args.out / name)
        labels[name] = case.label
    (args.out / "labels.json").write_text(json.dumps(labels, indent=1) + "\n")


if __name__ == "__main__":
    main()
