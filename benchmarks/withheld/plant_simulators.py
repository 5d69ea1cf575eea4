"""A user's own simulator on the plant of this suite: another generator than MuJoCo's.

    python -m benchmarks.withheld.plant_simulators --first 700 --out build/plant-simulators

The axis is a case of `single`, `none`, or of `clear` and `background` (the residual of a real axis
acts in it). Its simulator is the same plant without the effect and without noise, with other mass
and frictions; where a residual acts, it acts in both, and the library does not know it.
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported

import argparse  # noqa: E402
import time  # noqa: E402
import warnings  # noqa: E402
from collections.abc import Iterator  # noqa: E402
from dataclasses import replace  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

import numpy as np  # noqa: E402

from .cases import Case, draw  # noqa: E402
from .effects import AT_CONTROLLER  # noqa: E402
from .experiments import play, record  # noqa: E402
from .scores import score  # noqa: E402
from .suites import SUITES, Task  # noqa: E402

OFF = (0.85, 1.2)  # of the simulator's mass and frictions, relative to the axis'


def tasks(seeds: range) -> Iterator[Task]:
    """Yield the cases: every effect alone, two without one, and six behind a shared residual."""
    for s in seeds:
        some = range(s, s + 1)
        yield from (t for t in SUITES["single"](some) if t.effects[0] not in AT_CONTROLLER)
        yield Task("none", s)
        yield Task("none", s + 10_000)
        both = [*SUITES["clear"](some), *SUITES["background"](some)]
        behind = [t for t in both if not {*t.effects} & {*AT_CONTROLLER}]
        yield from [t for t in behind if t.suite == "clear"][:4]
        yield from [t for t in behind if not t.effects][:2]


def simulated(case: Case, rng: np.random.Generator) -> tuple[dict[str, float], list[dict]]:
    """Return what the simulator's parameters are off by, and its logs."""
    axis = case.axis
    base = {"m": axis.inertia, "fv": axis.viscous, "fc": axis.coulomb}
    off = {name: (rng.uniform(*OFF) - 1.0) * value for name, value in base.items()}
    logs = []
    for x, steady in zip(case.experiments, case.steady, strict=True):
        quiet = replace(x.silent(), force=steady)
        logs.append(record(axis, quiet, play(axis, {}, quiet, change=off)))
    return off, logs


def answer(task: Task) -> dict[str, Any]:
    """Return one row of the results."""
    import ivtools as iv
    from ivtools.loop.axis_file import from_tables

    warnings.simplefilter("ignore")
    try:
        case = draw(task)
    except RuntimeError:
        return {"key": task.key, "score": "undrawn"}
    off, logs = simulated(case, np.random.default_rng([*task.key.encode()]))
    real, sim = (
        [iv.Record.from_dict(r, name=n) for r, n in zip(both, ("record", "holdout"), strict=True)]
        for both in (case.records, logs)
    )
    begin = time.process_time()
    loop = from_tables(case.axis.tables())
    gap = iv.diagnose(real[0], loop, real[1], simulated=sim[0], simulated_holdout=sim[1])
    found = gap.to_dict()
    row = {
        "key": task.key,
        "score": "wrong" if gap.surplus else score(found, {**case.label, "suite": _kind(task)}),
        "verdict": gap.verdict,
        "named": "+".join(gap.effects),
        "surplus": "+".join(gap.surplus),
        "seconds": time.process_time() - begin,
    }
    return row | (_held(gap.changes, off, case) if gap.changes and not task.effects else {})


def _kind(task: Task) -> str:
    """Return the suite by which a case is scored: without an effect any verdict will do."""
    return "single" if task.effects else "background"


def _held(changes: Any, off: dict[str, float], case: Case) -> dict[str, Any]:
    """Return how far the change of each base parameter is off, and whether its interval holds it.

    Without an effect only: the library's effects share out friction in other ways. The drive gain
    of the axis file carries the scale of mass and length.
    """
    axis, row = case.axis, {}
    scale = {"inertia": axis.mass, "viscous": axis.mass, "coulomb": axis.mass * axis.length}
    base = {"inertia": axis.inertia, "viscous": axis.viscous, "coulomb": axis.coulomb}
    for (name, value), key in zip(base.items(), ("m", "fv", "fc"), strict=True):
        if name in changes:
            true = -off[key] * scale[name]
            got = changes[name]
            row[f"{name}_off"] = (got.change - true) / (value * scale[name])
            row[f"{name}_held"] = got.interval[0] <= true <= got.interval[1]
    return row


def main() -> None:
    """Run what is missing, and print the scores."""
    import pandas as pd

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--first", type=int, default=700)
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("build/plant-simulators"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / "plant.csv"
    rows = pd.read_csv(path).to_dict("records") if path.exists() else []
    for task in tasks(range(args.first, args.first + args.count)):
        if task.key in {row["key"] for row in rows}:
            continue
        rows.append(answer(task))
        print({k: v for k, v in rows[-1].items() if k[-4:] != "_off"}, flush=True)
        pd.DataFrame(rows).to_csv(path, index=False)
    table = pd.DataFrame(rows)
    suite = table.key.str.split("/").str[0]
    print(table.groupby([suite, "score"]).size().to_string())
    for name in ("inertia", "viscous", "coulomb"):
        off, held = table[f"{name}_off"].abs().median(), table[f"{name}_held"].dropna().mean()
        print(f"{name}: off by {100 * off:.2g} % in median, intervals hold {100 * held:.0f} %")


if __name__ == "__main__":
    main()
