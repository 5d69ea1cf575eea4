"""Cases: two records of an axis with something hidden in it, and the sealed label."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from . import axes, backgrounds, disturbances, logs, motions, unknowns
from .axes import DT, Axis
from .effects import EFFECTS, SIZE, Values
from .experiments import Experiment, least, off_limit, play, record, visible
from .suites import REAL, Task

DETECTABLE = 0.3  # least whitened signature over the noise floor
_UNKNOWN = 0.5  # the same, of a background without a name
_TRIES = 200
_BURST = 1.0  # least rms of a burst's mark over the floor, while it lasts


@dataclass(frozen=True)
class Case:
    """A drawn case.

    Parameters
    ----------
    axis : Axis
    effects : dict
        Effect to the parameters of the plant.
    experiments : tuple of Experiment
        The record that is diagnosed and the one that judges, before scaling.
    steady : tuple of ndarray
        Of each experiment the force, N, that would act again: a background, no noise, no burst.
    records : tuple of dict
        What the diagnosis sees.
    label : dict
        What it must not see.
    """

    axis: Axis
    effects: dict[str, Values]
    experiments: tuple[Experiment, ...]
    steady: tuple[np.ndarray, ...]
    records: tuple[dict[str, np.ndarray], ...]
    label: dict[str, Any]


def draw(task: Task) -> Case:
    """Draw a case; draw again until its effects are detectable and its command off the limit.

    Raises
    ------
    RuntimeError
        If 200 draws give none.
    """
    for attempt in range(_TRIES):
        case = _attempt(task, np.random.default_rng([attempt, *task.key.encode()]))
        if case is not None:
            return replace(case, label={**case.label, "draws": attempt + 1})
    raise RuntimeError(f"{task.key}: no detectable case in {_TRIES} draws")


def _attempt(task: Task, rng: np.random.Generator) -> Case | None:
    axis = axes.draw(rng)
    if task.suite == "controllers":
        axis = axes.controlled(rng, axis, task.detail[0])
    motion = str(rng.choice(motions.KINDS))
    n = int(rng.uniform(16.0, 25.0) / DT)
    refs = [motions.draw(rng, motion, n) for _ in range(2)]
    steady = [np.zeros(n)] * 2
    if task.suite in REAL:
        found = backgrounds.draw(rng, *task.detail, refs)
        size = rng.uniform(0.5, 1.5) * rng.choice([-1.0, 1.0])
        refs, steady = [b.ref for b in found], [size * b.force for b in found]
        motion = motion if task.detail[0] == "moved" else "emps"
    quiet = [_noisy(rng, axis, ref, motions.pulses(rng, axis, len(ref))) for ref in refs]
    if task.suite == "unknown":
        paths = [play(axis, {}, x.silent())[2] for x in quiet]
        steady = unknowns.draw(rng, *task.detail, paths)
    values = {e: EFFECTS[e](rng) for e in task.effects}
    if axes.LAWS[axis.law] == "state-space" and "controller-mismatch" in values:
        off = rng.choice([-1.0, 1.0]) * rng.uniform(0.01, 0.05)  # its matrices as a whole
        values["controller-mismatch"] = {"kp": off, "kv": off}
    if task.suite == "small":
        values = _sized(axis, values, quiet, float(task.detail[0]))
    axis, values = _limited(rng, axis, values, quiet)
    seen = {e: least(axis, {e: v}, quiet) for e, v in values.items() if e != "saturation"}
    if task.suite != "small" and not all(s >= DETECTABLE for s in seen.values()):
        return None
    full = [replace(x, force=x.force + s) for x, s in zip(quiet, steady, strict=True)]
    label = {
        "suite": task.suite,
        "effects": list(task.effects),
        "detail": list(task.detail),
        "reference": motion,
        "signature": seen,
        "parameters": {e: {k: float(x) for k, x in v.items()} for e, v in values.items()},
        "inertia": axis.inertia * axis.mass,
    }
    if task.suite == "unknown":
        both = zip(quiet, steady, strict=True)
        label["unknown"] = min(visible(axis, x, force) for x, force in both)
        if not label["unknown"] >= _UNKNOWN:
            return None
    if task.suite in REAL:
        label["background"] = float(np.std(steady[1]) / np.std(quiet[1].force))
        over = label["over_background"] = {e: least(axis, {e: values[e]}, full) for e in seen}
        if task.suite == "clear" and not all(s >= DETECTABLE for s in over.values()):
            return None
    if task.suite == "bursts":
        full, mark = _burst(rng, task.detail[0], axis, full)
        if mark["size"] < _BURST:
            return None
        label["burst"] = mark
    case = _played(axis, values, full, steady, label)
    if case is None or task.suite != "logs":
        return case
    return replace(case, records=logs.changed(task.detail[0], case.records))


def _noisy(rng: np.random.Generator, axis: Axis, ref: np.ndarray, added: np.ndarray) -> Experiment:
    n = len(ref)
    force = disturbances.noise(rng, axis, n)
    return Experiment(ref, added, force, axis.noise.position * rng.normal(size=n))


def again(rng: np.random.Generator, case: Case, which: int = 1) -> Experiment:
    """Return an experiment of a case with fresh noise: same axis, motion, inputs, background."""
    old = case.experiments[which]
    new = _noisy(rng, case.axis, old.ref, old.added)
    return replace(new, force=new.force + case.steady[which])


def _limited(
    rng: np.random.Generator, axis: Axis, values: dict[str, Values], quiet: list[Experiment]
) -> tuple[Axis, dict[str, Values]]:
    """Give the axis a limit above what it needs, and a saturation its own below that."""
    peaks = [float(np.max(np.abs(play(axis, {}, x.silent())[1] - x.added))) for x in quiet]
    axis = replace(axis, limit=rng.uniform(1.4, 3.0) * max(peaks))
    if "saturation" in values:
        values = {**values, "saturation": {"limit": values["saturation"]["clip"] * min(peaks)}}
    return axis, values


def _sized(
    axis: Axis, values: dict[str, Values], quiet: list[Experiment], level: float
) -> dict[str, Values]:
    """Scale an effect until its signature has a level, within 5 %."""
    ((effect, start),) = values.items()
    key = SIZE[effect]
    parameters = dict(start) if key in start else {key: 1e-3}
    for _ in range(6):
        size = least(axis, {effect: parameters}, quiet)
        if not size > 0.0 or abs(size / level - 1.0) < 0.05:
            break
        parameters[key] *= level / size
    return {effect: parameters}


def _burst(
    rng: np.random.Generator, shape: str, axis: Axis, experiments: list[Experiment]
) -> tuple[list[Experiment], dict[str, Any]]:
    """Add bursts to one of the records; their mark is the whitened rms while they last."""
    at = int(rng.integers(2))
    old = experiments[at]
    force, when = disturbances.burst(rng, shape, len(old.ref))
    only = replace(old, force=old.force + force)
    change = play(axis, {}, only)[1] - play(axis, {}, old)[1]
    noise = play(axis, {}, old)[1] - play(axis, {}, old.silent())[1]
    lasts = force != 0.0
    size = float(np.sqrt(np.mean(change[lasts] ** 2)) / np.std(noise))
    marked = [only if i == at else x for i, x in enumerate(experiments)]
    return marked, {"record": at, "when": when, "size": size}


def _played(
    axis: Axis,
    values: dict[str, Values],
    experiments: list[Experiment],
    steady: list[np.ndarray],
    label: dict[str, Any],
) -> Case | None:
    runs = [play(axis, values, x) for x in experiments]
    if not all(np.isfinite(out).all() for out in runs):
        return None
    free = all(off_limit(axis, o, x.added) for o, x in zip(runs, experiments, strict=True))
    if not free and "saturation" not in values:
        return None
    records = tuple(record(axis, x, o) for x, o in zip(experiments, runs, strict=True))
    return Case(axis, values, tuple(experiments), tuple(steady), records, label)


def write(case: Case, folder: Path) -> None:
    """Write record.csv, holdout.csv and axis.toml; the label stays outside."""
    import pandas as pd

    folder.mkdir(parents=True, exist_ok=True)
    for name, table in zip(("record", "holdout"), case.records, strict=True):
        pd.DataFrame(table).to_csv(folder / f"{name}.csv", index=False)
    lines = []
    for head, content in case.axis.tables().items():
        lines += [f"[{head}]", *(f"{k} = {_toml(v)}" for k, v in content.items())]
    (folder / "axis.toml").write_text("\n".join(lines) + "\n")


def _toml(value: object) -> str:
    if isinstance(value, dict):
        return f"{{{', '.join(f'{k} = {json.dumps(v)}' for k, v in value.items())}}}"
    return json.dumps(value)
