"""Criteria: what names an effect, today's rules or tests of the literature, on the same cases.

    python -m benchmarks.withheld.criteria single:550:2 none:550:2 mujoco-unknown:960:2 \
        --folder build/criteria
    python -m benchmarks.withheld.criteria --folder build/criteria     # the tables alone

Every case is drawn and diagnosed as in `run`; of the first round of the selection the losses of
all that was tried are kept, so that other criteria can be judged afterwards on the same fits.

`tests` names the effect with the largest gain on held-out data if

- a step-down reality check over everything that was screened speaks for it (J. P. Romano, M. Wolf,
  Econometrica 73(4), 2005; signs of blocks are drawn, so blocks may be of any size),
- its amplitude is the same on both folds (Wald test with an equivalence margin),
- it removes a material share of the energy;

what a model confidence set of it and another one holds, within the margin, is not told from it
(P. R. Hansen, A. Lunde, J. M. Nason, Econometrica 79(2), 2011; pair by pair). What is decided at
the controller, without fits, is as the rules have it. `tests, against forces without a name` names
it only if it also predicts held-out data as well as a smooth force without a name does, as
today's rules ask.
"""

from __future__ import annotations

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is imported

import argparse  # noqa: E402
import json  # noqa: E402
from collections import Counter, defaultdict  # noqa: E402
from collections.abc import Callable, Mapping  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402
from unittest.mock import patch  # noqa: E402

import numpy as np  # noqa: E402
from scipy import stats  # noqa: E402

from .answers import answer  # noqa: E402
from .effects import AT_CONTROLLER  # noqa: E402
from .mujoco import run as mujoco  # noqa: E402
from .recorder import attributions  # noqa: E402
from .run import done, read  # noqa: E402
from .scores import score  # noqa: E402
from .suites import SUITES  # noqa: E402

SIZE = 0.05  # of the tests
MARGIN = 0.12  # equivalence margin of the confidence set: of the best gain, as in the rules
AMPLITUDE = 0.2  # equivalence margin of the amplitude on the other fold
MATERIAL = 0.02  # least share of the energy
DRAWS = 999


def collect(specs: list[str], folder: Path) -> None:
    """Diagnose cases that are not in the folder yet, and append what decides."""
    path = folder / "criteria.jsonl"
    folder.mkdir(parents=True, exist_ok=True)
    there = done(path)
    with path.open("a") as file:
        for key, work in _tasks(specs):
            if key in there:
                continue
            row = observed(work)
            file.write(json.dumps(row) + "\n")
            file.flush()
            named = "+".join(row.get("found", {}).get("effects", ()))
            print(f"{row['score']:12s} {key:55s} {named or '-'}", flush=True)


def _tasks(specs: list[str]) -> list[tuple[str, Callable[[], dict[str, Any]]]]:
    """Return keys and cases of specs such as ``single:550:2``: suite, first seed, count."""
    tasks: list[tuple[str, Callable[[], dict[str, Any]]]] = []
    for spec in specs:
        suite, first, count = spec.split(":")
        seeds = range(int(first), int(first) + int(count))
        if suite.startswith("mujoco-"):
            suite = suite.removeprefix("mujoco-")
            pairs = [(n, s) for s in seeds for n in mujoco.SUITES[suite]]
            tasks += [
                (f"{suite}/{n}/{s}", lambda n=n, s=s, suite=suite: mujoco.answer(suite, n, s))
                for n, s in pairs
            ]
        else:
            tasks += [(t.key, lambda t=t: answer(t, False)) for t in SUITES[suite](seeds)]
    return tasks


def observed(work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Return the row of a case, with what the first round of its selection showed."""
    from importlib import import_module

    kept = import_module("ivtools.gap.attribute.kept")
    nameless: defaultdict[int, list[float]] = defaultdict(list)
    advantage = kept.advantage
    with attributions() as found:

        def compared(*args: Any) -> float:
            """Keep what names are worth against a force without one, by attempt."""
            nameless[len(found)].append(advantage(*args))
            return nameless[len(found)][-1]

        with patch.object(kept, "advantage", compared):
            row = work()
    return row | {"attempts": [_attempt(f, nameless[k]) for k, f in enumerate(found)]}


def _attempt(found: Any, nameless: list[float]) -> dict[str, Any]:
    """Return what a selection showed: its rounds, and names against a force without one."""
    from ivtools.gap.fit import cost

    winners = [(r, r.best) for r in found.rounds if r.best is not None]
    return {
        "rounds": [_round(found, r) for r in found.rounds],
        "named": list(found.named),
        "evidence": {best.name: found.proof(r, best).to_dict() for r, best in winners},
        "nameless": nameless,
        "cost": [cost(found.base), cost(found.held), cost(found.full or found.held)],
    }


def _round(found: Any, one: Any) -> dict[str, Any]:
    """Return trials of a round: losses by block before and with each, and its amplitudes."""

    def losses(fits: Any) -> list[list[float]]:
        return [np.round(f.fold.block_sums(f.e**2), 4).tolist() for f in fits]

    trials = [
        {
            "name": t.name,
            "before": losses(t.before),
            "held": losses(t.held),
            "amplitudes": t.amplitudes.tolist(),
            "gains": t.gains.tolist(),
            "inside": t.inside,
            "passes": bool(t.passes(found.rules)),
        }
        for t in one.trials
    ]
    best = one.best.name if one.best else None
    return {
        "best": best,
        "trials": trials,
        "scores": [np.round(s, 4).tolist() for s in one.scores],
        "pvalues": _pvalues(one),
    }


def _pvalues(one: Any) -> dict[str, float]:
    """Return the p value of each trial by the step-down reality check, both folds.

    The largest of several draws of signs against all that was screened is what chance could do;
    an effect that has passed no longer counts for those behind it.
    """
    if not one.trials:
        return {}
    rng = np.random.default_rng(0)
    p = np.zeros(len(one.trials))
    for side, screened in enumerate(one.scores):
        change = [(t.before[side].e, t.held[side]) for t in one.trials]
        own = np.array([h.fold.block_sums(e**2 - h.e**2) for e, h in change])
        t = own.sum(axis=1) / np.maximum(np.linalg.norm(own, axis=1), 1e-300)
        signs = rng.choice([-1.0, 1.0], size=(DRAWS, own.shape[1]))
        rest = _studentised(signs, np.asarray(screened)).max(axis=1)
        chance = _studentised(signs, own)
        order, last = np.argsort(-t), 0.0
        for k, i in enumerate(order):
            top = np.maximum(rest, chance[:, order[k:]].max(axis=1))
            last = max(last, float((1 + np.sum(top >= t[i])) / (1 + DRAWS)))
            p[i] = max(p[i], last)
    return {t.name: float(x) for t, x in zip(one.trials, p, strict=True)}


def _studentised(signs: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Return the sums of signed blocks over their size, (n_draws, n)."""
    return signs @ scores.T / np.maximum(np.linalg.norm(scores, axis=1), 1e-300)


# --- criteria -----------------------------------------------------------------------------------


def today(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the diagnosis says."""
    return {k: row["found"][k] for k in ("effects", "ambiguous_with", "verdict")}


def tests(row: Mapping[str, Any], nameless: bool = False) -> dict[str, Any]:
    """Return the name that the tests give, and what is not told from it."""
    mute = {"effects": [], "ambiguous_with": {}, "verdict": row["found"]["verdict"]}
    if {*row["found"]["effects"]} & {*AT_CONTROLLER} or not row["attempts"]:
        return today(row)
    attempt = row["attempts"][-1]
    trials = attempt["rounds"][0]["trials"] if attempt["rounds"] else []
    if not trials:
        return mute
    best = max(trials, key=lambda t: np.mean(t["gains"]))
    p = attempt["rounds"][0]["pvalues"][best["name"]]
    if p > SIZE or min(best["gains"]) < MATERIAL or not best["inside"] or not _replicates(best):
        return mute
    if nameless and attempt["nameless"] and attempt["nameless"][0] < -1.0:
        return mute
    others = [t for t in trials if t is not best and _not_told(best, t)]
    names = [t["name"] for t in others]
    return {"effects": [best["name"]], "ambiguous_with": {best["name"]: names}, "verdict": ""}


def _replicates(trial: Mapping[str, Any]) -> bool:
    """Whether the amplitude on the other fold is not significantly outside of its margin."""
    a, t = np.transpose(trial["amplitudes"])
    beyond = np.maximum(np.abs(a - 1.0) - AMPLITUDE, 0.0) / np.maximum(np.abs(a / t), 1e-300)
    return bool(stats.chi2.sf(float(beyond @ beyond), 2) > SIZE)


def _not_told(best: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether a model confidence set of the two, with the margin, holds the other one."""
    gain = sum(np.sum(b) - np.sum(h) for b, h in zip(best["before"], best["held"], strict=True))
    worse = np.concatenate([
        np.asarray(o) - np.asarray(b) for o, b in zip(other["held"], best["held"], strict=True)
    ])  # fmt: skip
    excess = worse - MARGIN * gain / len(worse)
    t = excess.sum() / max(float(np.linalg.norm(excess - excess.mean())), 1e-300)
    return bool(stats.norm.sf(t) > SIZE)


CRITERIA: dict[str, Callable[[Mapping[str, Any]], dict[str, Any]]] = {
    "today's rules": today,
    "tests": tests,
    "tests, against forces without a name": lambda row: tests(row, nameless=True),
}


def tables(folder: Path) -> str:
    """Return the tables: per suite and criterion, how often each score was given."""
    rows = [r for r in read(folder / "criteria.jsonl") if r.get("found", {}).get("shrink")]
    lines = [
        "| suite | cases | criterion | good | wrong or extra | scores |",
        "|---|---|---|---|---|---|",
    ]
    for suite in dict.fromkeys(_suite(r) for r in rows):
        some = [r for r in rows if _suite(r) == suite]
        for name, rule in CRITERIA.items():
            counts = Counter(_scored(r, rule(r)) for r in some)
            good = sum(counts[s] for s in ("right", "ambiguous"))
            bad = sum(counts[s] for s in ("wrong", "extra"))
            said = ", ".join(f"{n} {s}" for s, n in counts.most_common())
            lines.append(f"| {suite} | {len(some)} | {name} | {good} | {bad} | {said} |")
    return "\n".join(lines)


def _suite(row: Mapping[str, Any]) -> str:
    on = "MuJoCo, " if "label" not in row else ""
    hidden = (
        "label" in row and row["suite"] in ("background", "unknown") and row["label"]["effects"]
    )
    return on + row["suite"] + (", an effect behind it" if hidden else "")


def _scored(row: Mapping[str, Any], found: Mapping[str, Any]) -> str:
    if "label" in row:
        return score(found, row["label"])
    nothing = row["suite"] != "effects"
    label = {
        "suite": "unknown" if nothing else "single",
        "effects": [] if nothing else [row["name"]],
    }
    return score(found, label)


def main() -> None:
    """Collect, and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("specs", nargs="*")
    parser.add_argument("--folder", type=Path, default=Path("build/criteria"))
    args = parser.parse_args()
    collect(args.specs, args.folder)
    print(tables(args.folder))


if __name__ == "__main__":
    main()
