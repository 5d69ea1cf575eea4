"""Healthy records of every kind: nothing must be refused, or told of a wrong sign or unit.

    python -m benchmarks.healthy build/healthy.csv --count 200

A row per record: the verdict, what was refused and by which step, and every finding that speaks of
a sign or a unit. Records whose row is there are not drawn again.
"""

from __future__ import annotations

import argparse
import re
import time
import traceback
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ivtools import IDIMIV, IDIMLS, Problem, diagnose
from ivtools.errors import IVToolsError
from ivtools.loop import ClosedLoop, Controller
from ivtools.record import Record
from ivtools.suitability import suitability

from . import populations

RATES = (100, 125, 200, 250, 500, 1000, 2000, 4000, 8000)  # Hz
FORCES = ("none", "spring", "gravity")
LONGEST = 40_000  # samples
ACCUSES = re.compile(r"\b(sign of|opposite sign|wrong unit|in mm|degrees|unit of|units)\b")


@dataclass(frozen=True)
class Case:
    """A healthy record, its loop as the owner knows it, and what it was drawn from."""

    record: Record
    loop: ClosedLoop
    labels: dict[str, object]


def draw(seed: int, rates: tuple[int, ...] = RATES, seconds: float | None = None) -> Case:
    """Draw a record whose axis follows its reference."""
    rng = np.random.default_rng([seed, 12])
    kind = populations.KINDS[seed % len(populations.KINDS)]
    hz = float(rates[(seed // len(populations.KINDS)) % len(rates)])
    while True:
        case = _drawn(rng, kind, hz, seconds or rng.uniform(12.0, 20.0))
        if case is not None:
            return case


def _drawn(rng: np.random.Generator, kind: str, hz: float, seconds: float) -> Case | None:
    """Return a case, or None if the axis does not follow."""
    joint = str(rng.choice(["prismatic", "revolute"]))
    loop, theta, stroke = populations.axis(rng, joint)
    fast = rng.uniform(1.0, 4.0) if hz < 500.0 else 1.0  # slow clocks are used to the full
    law = populations.controller(rng, kind, theta["inertia"], hz, fast)
    if rng.random() < 0.3:
        law = populations.surrounded(rng, law, hz)
    loop = replace(loop, controller=populations.scaled(law, loop.gain), name=kind)
    force = str(rng.choice(FORCES if joint == "revolute" else FORCES[:2]))
    held = theta["inertia"] * (2.0 * np.pi * rng.uniform(0.3, 2.0)) ** 2  # N/m, or N m
    true = loop
    if force == "spring":
        true = loop.with_effect("spring", stiffness=held, curvature=0.0)
    elif force == "gravity":
        angle = rng.uniform(0.0, 2.0 * np.pi)
        true = loop.with_effect("gravity", sin=held * np.cos(angle), cos=held * np.sin(angle))
    known = force == "none" or bool(rng.random() < 0.5)  # whether its owner knows that force
    n = min(int(seconds * hz), LONGEST) + int(hz)  # the log begins a second later, in motion
    asked = populations.reference(rng, n, hz, stroke, most=rng.uniform(2.5, 7.0))
    made = true.simulate(
        asked,
        {**true.start, **theta},
        initial="rest",
        position_noise=stroke * 10 ** rng.uniform(-7, -4.5) * rng.normal(size=asked.n_samples),
        force_noise=rng.uniform(0.01, 0.1) * theta["coulomb"] * rng.normal(size=asked.n_samples),
    )
    if not (made.finite and follows(made.q, asked.q_ref, loop.controller.needs_position)):
        return None
    labels = {"kind": kind, "hz": hz, "joint": joint, "force": force, "known": known,
              "seconds": round(n / hz - 1.0, 1)}  # fmt: skip
    model = replace(true if known else loop, start={})
    record = asked.replace(q=made.q, nu=made.nu, name=f"{kind} {hz:g} Hz")
    return Case(record.slice(int(hz)), model, labels)


def follows(q: np.ndarray, q_ref: np.ndarray, position: bool) -> bool:
    """Whether an axis does what it is told, a velocity loop without regard to where."""
    q, q_ref = q[:, 0], q_ref[:, 0]
    if not position:
        width = max(len(q) // 200, 1)
        q, q_ref = (x[width:] - x[:-width] for x in (q, q_ref))
    return bool(np.std(q - q_ref) < 0.4 * np.std(q_ref))


def answer(case: Case) -> dict[str, object]:
    """Return what every step makes of a case: the first refusal of each, and accusations."""
    record, loop = case.record, case.loop
    unknown = replace(loop, controller=Controller("identify", {}))
    told: list[str] = []

    def checked() -> str:
        told.extend(suitability(record, loop).advice)
        return ""

    def diagnosed() -> str:
        found = diagnose(record, loop)
        told.extend(f.text for f in found.findings)
        fatal = [f.text for f in found.findings if f.fatal]
        return f"{found.verdict}: {'+'.join(found.effects) or '-'}" + "".join(
            f"; FATAL {text}" for text in fatal
        )

    steps = {
        "check": checked,
        "ls": lambda: str(IDIMLS().fit(Problem(record, loop)).converged),
        "iv": lambda: str(IDIMIV().fit(Problem(record, loop)).converged),
        "law": lambda: unknown.identify_controller(record)[1].controller.kind,
        "diagnose": diagnosed,
    }
    row: dict[str, object] = {}
    start = time.process_time()
    for name, step in steps.items():
        try:
            row[name] = step()
        except IVToolsError as error:
            row[name] = f"REFUSED {error}"
        except Exception:
            row[name] = f"FAILED {traceback.format_exc(limit=-3)}"
    accusing = [text for text in told if ACCUSES.search(text)]
    return {**row, "advice": " | ".join(told), "accused": " | ".join(accusing),
            "cpu": round(time.process_time() - start, 1)}  # fmt: skip


def main() -> None:
    """Run what is missing of a population, a row at a time."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--rates", type=int, nargs="*", default=RATES, help="Hz")
    parser.add_argument("--seconds", type=float, help="length; default 12 to 20 s")
    args = parser.parse_args()
    warnings.simplefilter("ignore")
    there = {int(row["seed"]) for row in populations.rows(args.file)}
    args.file.parent.mkdir(parents=True, exist_ok=True)
    for seed in sorted(set(range(args.first, args.first + args.count)) - there):
        case = draw(seed, tuple(args.rates), args.seconds)
        row = {"seed": seed, **case.labels, **answer(case)}
        populations.append(args.file, row)
        shown = {k: v for k, v in row.items() if k != "advice"}
        print("; ".join(f"{k} {v}" for k, v in shown.items() if v != ""), flush=True)


if __name__ == "__main__":
    main()
