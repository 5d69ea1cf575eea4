"""Weights: what turns the evidence for a name into a probability.

    python -m benchmarks.withheld.weights --first 300 --count 2 --folder build/withheld

draws training cases of every suite, notes the evidence for the best candidate of every round of
the selection, named or not, and whether it is in the truth, and fits a logistic regression.
`ivtools.gap.rules.WEIGHTS` holds what it prints.
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported, here and in the workers

import argparse  # noqa: E402
import json  # noqa: E402
import warnings  # noqa: E402
from collections.abc import Iterator  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

import numpy as np  # noqa: E402

from .cases import draw  # noqa: E402
from .recorder import attributions  # noqa: E402
from .run import read  # noqa: E402
from .suites import SUITES, Task  # noqa: E402

TRAINING = ("single", "two", "background", "small", "none", "unknown")
_RIDGE = 1.0  # of the standardised weights, against the count of candidates


def candidates(task: Task) -> list[dict[str, Any]]:
    """Return a row of evidence for the best candidate of every round, and whether it is true."""
    warnings.simplefilter("ignore")

    import ivtools as iv
    from ivtools.loop.axis_file import from_tables

    case = draw(task)
    records = [iv.Record.from_dict(r, name=n) for r, n in zip(case.records, "ab", strict=True)]
    with attributions() as seen:
        iv.diagnose(records[0], from_tables(case.axis.tables()), holdout=records[1])
    return [row for found in seen[-1:] for row in _rows(task, found)]


def _rows(task: Task, found: Any) -> Iterator[dict[str, Any]]:
    from ivtools.gap.attribute import cost

    for r in found.rounds:
        if not r.trials:
            continue
        best = r.best or max(r.trials, key=lambda t: t.gain)
        names = {best.name, *(t.name for t in r.rivals(found.rules, cost(found.held)))}
        right = bool(names & {*task.effects})
        proof = found.proof(r, best).to_dict()
        yield {"key": task.key, "named": r.best is not None, "right": right, **proof}


def fit(rows: list[dict[str, Any]]) -> dict[str, float]:
    """Return the weights of a logistic regression with a small ridge."""
    from scipy.optimize import minimize

    from ivtools.gap.attribute import Evidence, features

    names = list(features(Evidence(0.1, 10.0, 1.0, 0.0, 0.1, 1.0)))
    X = np.array([[features(_evidence(r))[n] for n in names] for r in rows])
    y = np.array([r["right"] for r in rows], dtype=float)
    mean, scale = X.mean(axis=0), X.std(axis=0)
    Z = (X - mean) / scale

    def loss(w: np.ndarray) -> float:
        z = Z @ w[1:] + w[0]
        return float(np.sum(np.logaddexp(0.0, z) - y * z) + 0.5 * _RIDGE * w[1:] @ w[1:])

    w = minimize(loss, np.zeros(len(names) + 1)).x
    slopes = w[1:] / scale
    constant = float(w[0] - slopes @ mean)
    return {"constant": constant, **dict(zip(names, slopes.tolist(), strict=True))}


def _evidence(row: dict[str, Any]) -> Any:
    from ivtools.gap.attribute import Evidence

    return Evidence(**{n: row[n] for n in Evidence.__dataclass_fields__})


def main() -> None:
    """Draw, diagnose, fit, print."""
    from joblib import Parallel, delayed

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=300)
    parser.add_argument("--count", type=int, default=2)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=Path("build/withheld"))
    args = parser.parse_args()
    path = args.folder / "evidence.jsonl"
    path.parent.mkdir(parents=True, exist_ok=True)
    there = {r["key"] for r in read(path)}
    seeds = range(args.first, args.first + args.count)
    tasks = [t for suite in TRAINING for t in SUITES[suite](seeds) if t.key not in there]
    work = Parallel(n_jobs=args.jobs, return_as="generator_unordered")(
        delayed(candidates)(t) for t in tasks
    )
    with path.open("a") as file:
        for rows in work:
            file.writelines(json.dumps(r) + "\n" for r in rows)
            file.flush()
    rows = list(read(path))
    print(len(rows), "candidates,", sum(r["right"] for r in rows), "true")
    print({n: round(w, 3) for n, w in fit(rows).items()})


if __name__ == "__main__":
    main()
