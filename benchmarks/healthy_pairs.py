"""Healthy pairs: two motions of an axis whose file is right; nothing may be named, or refused.

    python -m benchmarks.healthy_pairs build/healthy_pairs.csv --count 120

Laws of every kind with feed-forwards, filters and delays, controllers up to four times as fast as
their log, noise of the encoder and of the force, records that begin and end anywhere in a motion.
A row per pair: the verdict, what was named and said. Pairs whose row is there are not drawn again.
"""

from __future__ import annotations

import argparse
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

import ivtools as iv
from ivtools.loop import ClosedLoop
from ivtools.record import Record

from . import populations
from .healthy import follows

ROW = "kind", "hz", "faster", "joint", "fed", "verdict", "named", "gap", "said", "cpu"
TRIES = 6  # motions that are drawn until an axis follows one


def draw(seed: int) -> tuple[list[Record], ClosedLoop, dict[str, object]] | None:
    """Return two records, the loop as its owner knows it, and labels; None if nothing follows."""
    rng = np.random.default_rng([seed, 91])
    kind = populations.KINDS[seed % len(populations.KINDS)]
    hz = float(rng.choice([250, 500, 1000, 2000]))
    joint = str(rng.choice(["prismatic", "revolute"]))
    faster = int(rng.choice([1, 1, 2, 4]))
    rate = hz * faster
    loop, theta, stroke = populations.axis(rng, joint)
    law = populations.controller(rng, kind, theta["inertia"], rate)
    if rng.random() < 0.4:
        law = populations.surrounded(rng, law, rate)
    fed = {}
    if rng.random() < 0.7:
        fed["acceleration"] = theta["inertia"] * rng.uniform(0.5, 1.1)
        if rng.random() < 0.6:
            fed["velocity"] = theta["viscous"] * rng.uniform(0.5, 1.2)
        if rng.random() < 0.3:
            fed["coulomb"] = theta["coulomb"] * rng.uniform(0.5, 1.0)
    law = replace(law, feedforward={**law.feedforward, **fed})
    loop = replace(loop, controller=populations.scaled(law, loop.gain), name=kind)
    noise = stroke * 10 ** rng.uniform(-7, -4.7)
    force = rng.uniform(0.01, 0.08) * theta["coulomb"]
    labels = {"kind": kind, "hz": hz, "faster": faster, "joint": joint, "fed": "+".join(fed)}
    records = []
    for name in ("one", "two"):
        whole = _played(rng, loop, theta, stroke, rate, noise, force)
        if whole is None:
            return None
        part = whole.slice(int(rate), whole.n_samples - int(rng.integers(1, rate)))
        logged = {k: x[::faster] for k, x in part.signals.items()}
        records.append(Record(part.t[::faster], name=name, **logged))
    return records, replace(loop, start={}), labels


def _played(
    rng: np.random.Generator,
    loop: ClosedLoop,
    theta: dict[str, float],
    stroke: float,
    rate: float,
    noise: float,
    force: float,
) -> Record | None:
    """Return a motion that the axis follows, at the rate of its controller."""
    n = int(rng.uniform(9, 14) * rate)
    for _ in range(TRIES):
        asked = populations.reference(rng, n, rate, stroke, most=rng.uniform(2.5, 7.0))
        made = loop.simulate(
            asked,
            {**loop.start, **theta},
            initial="rest",
            position_noise=noise * rng.normal(size=n),
            force_noise=force * rng.normal(size=n),
        )
        if made.finite and follows(made.q, asked.q_ref, loop.controller.needs_position):
            return asked.replace(q=made.q, nu=made.nu)
    return None


def main() -> None:
    """Run what is missing of a population, a row at a time."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, default=120)
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    there = {int(row["seed"]) for row in populations.rows(args.file)}
    args.file.parent.mkdir(parents=True, exist_ok=True)
    for seed in sorted(set(range(args.first, args.first + args.count)) - there):
        drawn = draw(seed)
        if drawn is None:
            none = {**dict.fromkeys(ROW, ""), "verdict": "not drawn"}
            populations.append(args.file, {"seed": seed, **none})
            continue
        (one, two), loop, labels = drawn
        start = time.process_time()
        found = iv.diagnose(one, loop, holdout=two)
        answer = {"verdict": found.verdict, "named": "+".join(found.effects), "gap": found.size,
                  "said": " | ".join(f.text for f in found.findings),
                  "cpu": round(time.process_time() - start, 1)}  # fmt: skip
        populations.append(args.file, {"seed": seed, **labels, **answer})
        print(seed, *labels.values(), found.verdict, *found.effects, found.size, flush=True)


if __name__ == "__main__":
    main()
