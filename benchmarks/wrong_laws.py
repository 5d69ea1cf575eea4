"""Laws stated wrongly, an effect behind each: is the law put right, and the effect still named?

    python -m benchmarks.wrong_laws build/wrong_laws.csv --first 5000 --count 60

A row per case: the kind of controller and the effect, what was stated wrongly (gains of half to
twice their size, or another kind), what was named.
Cases whose row is there are not drawn again. At the end of a run stands what the file holds.
"""

from __future__ import annotations

import argparse
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

import ivtools as iv
from ivtools.loop import Controller
from ivtools.loop.axis_file import from_tables

from .populations import filled
from .withheld.cases import draw
from .withheld.effects import AT_CONTROLLER, EFFECTS, twins
from .withheld.suites import Task

OTHER = {
    "cascade-pd": "pid",
    "pd": "p-pi",
    "pid": "cascade-pd",
    "p-pi": "pd",
    "pi-velocity": "p-velocity",
    "p-velocity": "pi-velocity",
}
GAINS = ("kp", "kv", "ki", "kd")
SAID = "the record shows"  # how a finding says the law that it read, and what it thinks of the file


def misstated(rng: np.random.Generator, law: Controller) -> tuple[str, Controller]:
    """Return what is wrong about a stated law, and the law."""
    gains = {k: v for k, v in law.settings.items() if k in GAINS}
    way = rng.choice(["gains", "gains", "kind"])
    if way == "gains":
        wrong = {k: v * float(rng.uniform(0.5, 2.0)) for k, v in gains.items()}
        return "gains", replace(law, settings={**law.settings, **wrong})
    other = OTHER[law.kind]
    names = {"pid": "kp ki kd", "p-pi": "kp kv ki", "cascade-pd": "kp kv", "pd": "kp kd",
             "p-velocity": "kv", "pi-velocity": "kv ki"}[other].split()  # fmt: skip
    given = {k: gains.get(k, 10.0 ** rng.uniform(-1.0, 1.0)) for k in names}
    return other, replace(law, kind=other, settings=given)


def answer(seed: int) -> dict[str, object] | None:
    """Return the row of a seed, or None if no such case can be drawn."""
    rng = np.random.default_rng([seed, 12])
    kind = list(OTHER)[seed % len(OTHER)]
    behind = [e for e in EFFECTS if e not in AT_CONTROLLER]
    effect = str(rng.choice(behind))
    try:
        case = draw(Task("controllers", seed, (effect,), (kind,)))
    except RuntimeError:
        return None
    loop = from_tables(case.axis.tables())
    what, law = misstated(rng, loop.controller)
    first, second = (iv.Record.from_dict(r) for r in case.records)
    gap = iv.diagnose(first, replace(loop, controller=law), holdout=second)
    text = " ".join(f.text for f in gap.findings)
    named = [e for e in gap.effects if e != "controller-mismatch"]
    hers = {effect, *twins(effect)}
    for name in named:  # one that cannot be told from hers stands for it
        hers |= {name} if effect in gap.ambiguous_with.get(name, ()) else set()
    return {
        "seed": seed,
        "kind": kind,
        "effect": effect,
        "stated": what,
        "law": "controller-mismatch" in gap.effects or SAID in text,
        "named": bool(hers & set(named)),
        "others": " ".join(sorted(set(named) - hers)),
        "verdict": gap.verdict,
        "findings": text[:300],
    }


def main() -> None:
    """Run what is missing, a row at a time, and count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--first", type=int, default=5000)
    parser.add_argument("--count", type=int, default=60)
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    seeds = range(args.first, args.first + args.count)
    found = filled(args.file, ((seed,) for seed in seeds), answer)
    count = {key: sum(row[key] == "True" for row in found) for key in ("law", "named")}
    false = sum(bool(row["others"]) for row in found)
    print(f"{len(found)} cases: law {count['law']}, effect {count['named']}, other names {false}")


if __name__ == "__main__":
    main()
