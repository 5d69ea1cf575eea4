"""``python tests/fuzz/fuzz.py [--minutes M] [--kind K] [--seed S]``: find what ends badly.

Every finding is printed with its kind and seed, which give the same input again.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from inputs import KINDS
from verbs import Bound, faults


def tried(
    kind: str, seed: int, bound: Bound, ends: Counter[tuple[str, str]] | None = None
) -> list[str]:
    """Return what is wrong with how the input of a seed ends, by every verb that it goes to.

    How often each verb ended how is counted in `ends`.
    """
    wrong = []
    rng = np.random.default_rng([list(KINDS).index(kind), seed])
    with tempfile.TemporaryDirectory() as folder:
        for command in KINDS[kind](rng, Path(folder)):
            found = bound.run(command)
            if ends is not None:
                ends[command[0], str(found.get("status", "died"))] += 1
            wrong += [f"{command[0]}: {fault}" for fault in faults(command[0], found)]
    return wrong


def main() -> int:
    """Try seeds until the time is over; return how many ended badly."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--kind", choices=sorted(KINDS), action="append")
    parser.add_argument("--seed", type=int, default=0, help="the first one")
    parser.add_argument("--last", type=int, help="seed to end with, before the time is over")
    given = parser.parse_args()
    until, counts, bad = time.monotonic() + 60.0 * given.minutes, Counter[str](), 0
    bound, seed, ends = Bound(), given.seed, Counter[tuple[str, str]]()
    while time.monotonic() < until and (given.last is None or seed <= given.last):
        for kind in given.kind or sorted(KINDS):
            counts[kind] += 1
            wrong = tried(kind, seed, bound, ends)
            for fault in wrong:
                print(f"{kind} {seed}: {fault}", flush=True)
            bad += bool(wrong)
        seed += 1
        if seed % 50 == 0:
            print(f"seed {seed}: {counts.total()} tried, {bad} ended badly", flush=True)
    bound.close()
    print(f"{dict(counts)} tried, {bad} ended badly")
    print({f"{verb}, status {status}": n for (verb, status), n in sorted(ends.items())})
    print(f"longest {bound.most_cpu:.1f} s of processor time, {bound.most_seconds:.1f} s by clock")
    return bad


if __name__ == "__main__":
    sys.exit(min(main(), 1))
