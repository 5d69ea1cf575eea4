"""Diagnose withheld cases and score the answers against the sealed labels.

python -m benchmarks.withheld.run --suite single --count 2 --jobs 2 --out results.jsonl
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from pathlib import Path

from .generate import SUITES, axis_file, draw, plan

#: The least separable from each effect, as documented beside the list of effects.
DOCUMENTED = {
    "asymmetric-viscous": {"spring"},
    "stribeck": {"sqrt-viscous", "polynomial-viscous"},
    "presliding": {"position-friction"},
    "polynomial-viscous": {"sqrt-viscous", "stribeck"},
    "sqrt-viscous": {"stribeck", "polynomial-viscous"},
    "position-friction": set(),
    "load-friction": {"dead-zone"},
    "friction-drift": set(),
    "offset-drift": set(),
    "spring": {"asymmetric-viscous"},
    "cogging": {"encoder-eccentricity", "torque-ripple"},
    "torque-ripple": {"cogging", "encoder-eccentricity"},
    "flexibility": {"backlash"},
    "backlash": {"flexibility"},
    "drive-timing": set(),
    "drive-asymmetry": set(),
    "dead-zone": {"load-friction"},
    "encoder-eccentricity": {"cogging", "torque-ripple"},
}


def answer(seed: int, suite: str, effects: list[str]) -> dict:
    """Draw a case, diagnose its records alone, and put the label beside the answer."""
    import warnings

    warnings.simplefilter("ignore")
    import ivtools as iv
    from ivtools.loop.axis_file import from_tables

    case = draw(seed, suite, effects)
    records = [
        iv.Record.from_dict(r, name=n) for r, n in zip(case.records, ("a", "b"), strict=True)
    ]
    start = time.perf_counter()
    gap = iv.diagnose(
        records[0],
        from_tables(axis_file(case.axis)),
        holdout=records[1],
        without=effects if suite == "outside" else (),
    )
    found = gap.to_dict()
    return {
        "seed": seed,
        "label": case.label,
        "time": time.perf_counter() - start,
        **{
            k: found[k]
            for k in ("verdict", "effects", "ambiguous_with", "findings", "gap", "shrink")
        },
        "parameters": found["parameters"],
        "ranking": found["ranking"][:5],
        "score": score(found, case.label),
    }


def score(found: dict, label: dict) -> str:
    """Return right, ambiguous, extra, abstained or wrong."""
    truth, named = set(label["effects"]), set(found["effects"])
    if (
        label["suite"] == "outside"
    ):  # the truth is not in the library: a name is wrong, if it explains all
        return (
            "right"
            if not named or named <= DOCUMENTED[label["effects"][0]]
            else ("flagged" if found["verdict"] in ("partial", "non-repeatable") else "wrong")
        )
    if label["suite"] == "background" and not truth:
        return "wrong" if named else "right"
    if not truth:
        if named:
            return "wrong"
        if label["suite"] == "bursts":
            return "right" if found["verdict"] == "non-repeatable" else "abstained"
        return "right" if found["verdict"] == "adequate" else "abstained"
    if not named:
        return "abstained"
    if named == truth:
        return "right" if all(len(v) <= 1 for v in found["ambiguous_with"].values()) else "vague"
    sets = [{e, *found["ambiguous_with"].get(e, [])} for e in named]
    covered = all(any(t in s for s in sets) for t in truth)
    if covered and len(named) == len(truth):
        return "ambiguous" if all(len(s) <= 2 for s in sets) else "vague"
    if truth < named:
        return "extra"
    if named < truth:
        return "subset"
    return "wrong"


def main() -> None:
    from joblib import Parallel, delayed

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--suite", choices=SUITES, default="single")
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    tasks = [
        (s + args.first, e)
        for s, e in plan(args.suite, args.count)
        if not args.only or set(e) & set(args.only)
    ]
    work = Parallel(n_jobs=args.jobs, return_as="generator")(
        delayed(answer)(s, args.suite, e) for s, e in tasks
    )
    rows = []
    for row in work:
        rows.append(row)
        print(
            f"{row['score']:10s} {'+'.join(row['label']['effects']) or '-':28s} -> "
            f"{'+'.join(row['effects']) or '-':28s} {row['ambiguous_with']} {row['verdict']} "
            f"{row['gap']['before'] or 0:.2f}->{row['gap']['after'] or 0:.2f} "
            f"{row['label']['reference']} "
            f"{row['time']:.1f} s {'; '.join(row['findings'])[:90]}",
            flush=True,
        )
        if args.out:
            with args.out.open("a") as file:
                file.write(json.dumps(row) + "\n")
    print(Counter(r["score"] for r in rows))


if __name__ == "__main__":
    main()
