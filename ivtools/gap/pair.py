"""Pair: whether a record and its hold-out can judge each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..record import Record
from .findings import Finding
from .fit import Fit

Array = NDArray[np.float64]

_SAME, _OVERLAP = 0.95, 0.1  # share of stretches that both hold, sample for sample
_SAME_AXIS = 1.3  # inertias of two records of one axis differ by less
_WORSE = 3.0  # a record simulated with the inertia of another axis is that much worse


def overlap(record: Record, holdout: Record) -> list[Finding]:
    """Return what a hold-out has in common with the record that it should not."""
    share = _shared(record, holdout)
    if share > _SAME:
        text = f"the hold-out {holdout.name} holds the same samples as {record.name}"
        return [Finding(f"{text}; give another record of the axis, or none")]
    if share > _OVERLAP:
        text = f"the hold-out {holdout.name} shares {100 * share:.0f} % of its samples with "
        return [Finding(f"{text}{record.name}; give a record that was not fitted to")]
    return []


def same_axis(bases: Sequence[Fit]) -> list[Finding]:
    """Return what two records say against being of one axis.

    Their inertias differ, and neither record can be simulated with the other's.
    """
    inertias = [fit.values.get("inertia", 1.0) for fit in bases]
    if max(inertias) < _SAME_AXIS * min(inertias):
        return []
    for fit, other in zip(bases, inertias[::-1], strict=True):
        error = fit.fold.error(fit.loop, {**fit.values, "inertia": other})
        if float(np.mean(error**2)) < _WORSE * fit.cost:
            return []
    unit = "kg" if bases[0].loop.joint == "prismatic" else "kg m2"
    names = [fit.fold.record.name for fit in bases]
    shown = " and ".join(f"{n} {m:.4g} {unit}" for n, m in zip(names, inertias, strict=True))
    return [
        Finding(
            f"the records show different inertias ({shown}): another axis, payload or unit; hold "
            "out a record of the same axis and load"
        )
    ]


def _shared(record: Record, holdout: Record, windows: int = 40, width: int = 50) -> float:
    """Return the share of a record's stretches that another one holds, sample for sample."""
    one, two = (_columns(r) for r in (record, holdout))
    starts = np.linspace(0, len(two) - width, windows).astype(int)
    return float(np.mean([_holds(one, two[s : s + width]) for s in starts]))


def _columns(record: Record) -> Array:
    """Return position and command, (n_samples, 2)."""
    force = record.nu if record.nu is not None else record.tau
    assert force is not None  # a record has one of them
    return np.column_stack([record.q[:, 0], force[:, 0]])


def _holds(x: Array, part: Array) -> bool:
    width = len(part)
    at = np.flatnonzero((x[: len(x) - width + 1] == part[0]).all(axis=1))
    return any(np.array_equal(x[i : i + width], part) for i in at)
