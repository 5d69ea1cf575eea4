"""Draw cases on MuJoCo's physics, diagnose them on their records alone, and score.

python -m benchmarks.withheld.mujoco.run --first 100 --count 1 --folder build/mujoco
"""

from __future__ import annotations

import argparse
import json
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

from ..scores import score
from .cases import CHANGED, EFFECTS, KINDS_OF_AXES, UNKNOWN, draw

SUITES = {
    "effects": EFFECTS,
    "none": ("-",),
    "unknown": UNKNOWN,
    "changed": CHANGED,
    **dict.fromkeys(KINDS_OF_AXES, (*EFFECTS, "-", *CHANGED, *UNKNOWN)),
}


def answer(suite: str, name: str, seed: int) -> dict[str, Any]:
    """Return one row of the results."""
    import ivtools as iv
    from ivtools.loop.axis_file import from_tables

    warnings.simplefilter("ignore")
    row: dict[str, Any] = {"key": f"{suite}/{name}/{seed}", "suite": suite, "name": name}
    try:
        case = draw(suite, name, seed)
    except FloatingPointError as error:
        return {**row, "score": "undrawn", "error": str(error)}
    one, two = (iv.Record.from_dict(r, name=n) for r, n in zip(case.records, "ab", strict=True))
    loop, start = from_tables(case.tables), time.process_time()
    try:
        found = iv.diagnose(one, loop, holdout=two).to_dict()
    except Exception:  # whatever it is, it belongs into the table
        return {**row, "score": "failed", "error": traceback.format_exc(limit=-3)}
    kept = ("verdict", "effects", "ambiguous_with", "shrink", "whitened", "changed",
            "discrepancy", "probability", "evidence", "findings")  # fmt: skip
    row |= {"seconds": time.process_time() - start, "found": {k: found[k] for k in kept}}
    return {**row, "score": scored(case.label["suite"], found, case.label)}


def scored(suite: str, found: dict[str, Any], label: dict[str, Any]) -> str:
    """Return the score: that of the other suites, and for changed settings whether it is said."""
    if found["shrink"] is None:
        return "refused"
    if suite == "changed":
        said = bool(found["changed"]) or found["verdict"] == "non-repeatable"
        return "wrong" if found["effects"] else "right" if said else "silent"
    if suite == "unknown":
        if found["effects"]:
            return "wrong"
        return "described" if found["discrepancy"] else f"unnamed, {found['verdict']}"
    return score(found, {**label, "suite": "none" if suite == "none" else "single"})


def main() -> None:
    """Run the suites."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("suites", nargs="*", default=list(SUITES))
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--only", nargs="*", default=())
    parser.add_argument("--folder", type=Path, default=Path("build/mujoco"))
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    with (args.folder / "mujoco.jsonl").open("a") as file:
        for suite in args.suites:
            counts: Counter[str] = Counter()
            for seed in range(args.first, args.first + args.count):
                for name in SUITES[suite]:
                    if args.only and name not in args.only:
                        continue
                    row = answer(suite, name, seed)
                    counts[row["score"]] += 1
                    file.write(json.dumps(row) + "\n")
                    file.flush()
                    print(_line(row), flush=True)
            print(f"{suite}: {dict(counts)}", flush=True)


def _line(row: dict[str, Any]) -> str:
    if "found" not in row:
        return f"{row['score']:10s} {row['key']}: {row['error'].strip().splitlines()[-1]}"
    f, s = row["found"], row["found"]["shrink"] or {}
    sizes = " ".join(f"{k} {s[k]:.3g}" for k in ("before", "after", "floor") if s)
    said = "; ".join(f["findings"][:1])[:90] if not s else ""
    return (
        f"{row['score']:10s} {row['key']:34s} -> {'+'.join(f['effects']) or '-'} {f['verdict']} "
        f"{sizes} {list(f['changed'])} {(f['discrepancy'] or {}).get('over', '')} "
        f"{row['seconds']:.1f} s {said}"
    )


if __name__ == "__main__":
    main()
