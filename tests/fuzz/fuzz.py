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


def tried(kind: str, seed: int, bound: Bound) -> list[str]:
    """Return what is wrong with how the input of a seed ends, by every verb that it goes to."""
    wrong = []
    rng = np.random.default_rng([sorted(KINDS).index(kind), seed])
    with tempfile.TemporaryDirectory() as folder:
        for command in KINDS[kind](rng, Path(folder)):
            wrong += [f"{command[0]}: {fault}" for fault in faults(command[0], bound.run(command))]
    return wrong


def main() -> int:
    """Try seeds until the time is over; return how many ended badly."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--kind", choices=sorted(KINDS), action="append")
    parser.add_argument("--seed", type=int, default=0, help="the first one")
    given = parser.parse_args()
    until, counts, bad = time.monotonic() + 60.0 * given.minutes, Counter[str](), 0
    bound, seed = Bound(), given.seed
    while time.monotonic() < until:
        for kind in given.kind or sorted(KINDS):
            counts[kind] += 1
            wrong = tried(kind, seed, bound)
            for fault in wrong:
                print(f"{kind} {seed}: {fault}", flush=True)
            bad += bool(wrong)
        seed += 1
    bound.close()
    print(f"{dict(counts)} tried, {bad} ended badly")
    return bad


if __name__ == "__main__":
    sys.exit(min(main(), 1))
