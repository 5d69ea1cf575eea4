"""Cells: one row of figures per case, from the JSON lines of a run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from .run import read
from .scores import score
from .suites import SUITES

_LABEL = ("reference", "inertia", "background")
_TRUE = ("before", "after", "after_frozen", "spread", "floor", "closed")
_SHRINK = ("unit", "before", "after", "floor", "closed", "after_frozen")


def load(folder: Path) -> tuple[pd.DataFrame, list[dict[str, Any]]]:
    """Return the table of a folder of results, one row per case, and the rows it came from.

    What could not be drawn is no case. The answers are scored again, so that a corrected scorer
    needs no new run.
    """
    rows = [row for suite in SUITES for row in read(folder / f"{suite}.jsonl")]
    for row in rows:
        if "found" in row:
            row["score"] = score(row["found"], row["label"])
    return pd.DataFrame([cell(row) for row in rows if row["score"] != "undrawn"]), rows


def cell(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures of one case."""
    label, found = row.get("label", {}), row.get("found", {})
    truth, gap = row.get("truth") or {}, found.get("whitened", {})
    shrink = found.get("shrink") or {}
    none = (None, None)
    (low, high), frozen = shrink.get("interval", none), shrink.get("interval_frozen", none)
    return {
        "suite": row["suite"],
        "seed": row["seed"],
        "detail": "+".join(label.get("detail", ())),
        "truth": "+".join(label.get("effects", ())),
        "named": "+".join(found.get("effects", ())),
        "not_told_from": _others(found.get("ambiguous_with", {})),
        "score": row["score"],
        "verdict": found.get("verdict"),
        "described": found.get("discrepancy") is not None,
        **{k: label.get(k) for k in _LABEL},
        "signature": _least(label.get("signature")),
        "over_background": _least(label.get("over_background")),
        "burst": label.get("burst", {}).get("size"),
        "probability": _least(found.get("probability")),
        "chi_before": gap.get("before"),
        "chi_after": gap.get("after"),
        **{k: shrink.get(k) for k in _SHRINK},
        "low": low,
        "high": high,
        "low_frozen": frozen[0],
        "high_frozen": frozen[1],
        **{f"true_{k}": truth.get(k) for k in _TRUE},
        "cpu": row.get("time", {}).get("cpu"),
        "wall": row.get("time", {}).get("wall"),
    }


def _others(ambiguous: Mapping[str, Iterable[str]]) -> str:
    return ";".join(f"{k}:{'+'.join(v)}" for k, v in ambiguous.items() if v)


def _least(values: Mapping[str, float] | None) -> float | None:
    return min(values.values()) if values else None
