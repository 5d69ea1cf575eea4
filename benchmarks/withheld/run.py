"""Run suites in parallel, and resume them.

    python -m benchmarks.withheld.run single none --first 1000 --jobs 2 --folder build/withheld

Each suite has one file of JSON lines in the folder, one line per case; a case whose line is there
is not run again. A case runs in one process, on one BLAS thread.
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported, here and in the workers

import argparse  # noqa: E402
import json  # noqa: E402
import time  # noqa: E402
from collections import Counter  # noqa: E402
from collections.abc import Iterator  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

from .answers import answer  # noqa: E402
from .suites import FULL, SUITES, Task  # noqa: E402


def done(path: Path) -> set[str]:
    """Return the keys of the cases in a file; a line cut off by an interruption does not count."""
    return {row["key"] for row in read(path)}


def read(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the rows of a file of results."""
    if not path.exists():
        return
    for line in path.read_text().splitlines():
        try:
            yield json.loads(line)
        except json.JSONDecodeError:
            continue


def run(tasks: list[Task], path: Path, jobs: int, truth: bool = True) -> Iterator[dict[str, Any]]:
    """Run what is missing, append each row as it comes, and yield it."""
    from joblib import Parallel, delayed

    there = done(path)
    missing = [t for t in tasks if t.key not in there]
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists() and not path.read_bytes().endswith(b"\n"):
        path.write_bytes(path.read_bytes() + b"\n")
    work = Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)(
        delayed(answer)(t, truth) for t in missing
    )
    with path.open("a") as file:
        for row in work:
            file.write(json.dumps(row) + "\n")
            file.flush()
            yield row


def line(row: dict[str, Any]) -> str:
    """Return a row as one line for people."""
    if "found" not in row:
        return f"{row['score']:10s} {row['key']}: {row['error'].strip().splitlines()[-1]}"
    found, gap = row["found"], row["found"]["whitened"]
    others = {k: v for k, v in found["ambiguous_with"].items() if v} or ""
    return (
        f"{row['score']:10s} {row['key']:52s} -> {'+'.join(found['effects']) or '-'} {others} "
        f"{found['verdict']} {gap['before'] or 0:.2f} -> {gap['after'] or 0:.2f}, "
        f"{row['time']['cpu']:.1f} s"
    )


def main() -> None:
    """Run the suites that the command line names."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("suites", nargs="+", choices=[*SUITES, "all"])
    parser.add_argument("--first", type=int, default=1000, help="first seed")
    parser.add_argument("--count", type=int, help="number of seeds; default as in a full run")
    parser.add_argument("--only", nargs="*", default=(), help="effects")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=Path("build/withheld"))
    parser.add_argument("--no-truth", action="store_true", help="skip the true held-out figures")
    args = parser.parse_args()
    for suite in SUITES if "all" in args.suites else args.suites:
        seeds = range(args.first, args.first + (args.count or FULL[suite]))
        tasks = [
            t for t in SUITES[suite](seeds) if not args.only or set(t.effects) & set(args.only)
        ]
        start, scores = time.perf_counter(), Counter()
        for row in run(tasks, args.folder / f"{suite}.jsonl", args.jobs, not args.no_truth):
            scores[row["score"]] += 1
            print(line(row), flush=True)
        print(f"{suite}: {dict(scores)} in {time.perf_counter() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main()
