"""Entry: one record of a fleet, its diagnosis or the reason why there is none."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..diagnosis import Diagnosis

FAILED = "failed"


@dataclass(frozen=True, eq=False)
class Entry:
    """One record of a fleet.

    Parameters
    ----------
    name : str
        Unlike that of any other entry.
    source : str
        The file, or the name of the data set; empty for a record that was given as it is.
    content : mapping or None
        The diagnosis as in the JSON of ``ivtools diagnose``; None if there is none.
    error : str
        Why there is none, one line.
    seconds : float
        What it took.
    judged_by : str
        The hold-out; empty if the record judged itself.
    reused : bool
        Whether an earlier run made it.
    page : Path or None
        Its page.
    diagnosis : Diagnosis or None
        The diagnosis itself, if it was made just now and not put in a folder.
    """

    name: str
    source: str = ""
    content: Mapping[str, Any] | None = None
    error: str = ""
    seconds: float = 0.0
    judged_by: str = ""
    reused: bool = False
    page: Path | None = None
    diagnosis: Diagnosis | None = None

    @property
    def verdict(self) -> str:
        """The verdict, or "failed"."""
        return FAILED if self.content is None else str(self.content["verdict"])

    @property
    def effects(self) -> tuple[str, ...]:
        """What is named."""
        return () if self.content is None else tuple(self.content["effects"])

    @property
    def remark(self) -> str:
        """The reason of a failure, what has changed, or the first finding; else nothing."""
        if self.content is None:
            return self.error
        if changed := self.content.get("changed"):
            return f"{' and '.join(changed)} changed between it and {self.judged_by}"
        return str(next(iter(self.content["findings"]), ""))

    @property
    def shrink(self) -> Mapping[str, Any]:
        """The shrink of the diagnosis; empty if there is none."""
        return (self.content or {}).get("shrink") or {}

    def to_dict(self) -> dict[str, Any]:
        """Return the diagnosis with the record's name, file and error."""
        about = {
            "name": self.name,
            "file": self.source,
            "holdout": self.judged_by or None,
            "error": self.error or None,
        }
        return {**about, "verdict": None, "effects": [], **(self.content or {})}

    def row(self) -> dict[str, Any]:
        """Return the row of the table: one column per figure, and per parameter that is named."""
        content, s = self.content or {}, self.shrink
        low, high = s.get("interval") or (None, None)
        named = content.get("parameters", {})
        twins = {e: t for e, t in content.get("ambiguous_with", {}).items() if t}
        return {
            "record": self.name,
            "file": self.source,
            "verdict": self.verdict,
            "effects": " ".join(self.effects),
            "ambiguous_with": json.dumps(twins) if twins else "",
            "probability": " ".join(f"{p:.2f}" for p in content.get("probability", {}).values()),
            "block": content.get("where", {}).get("block") or "",
            "unit": s.get("unit", ""),
            "before": s.get("before"),
            "after": s.get("after"),
            "after_low": low,
            "after_high": high,
            "floor": s.get("floor"),
            "closed": s.get("closed"),
            "holdout": self.judged_by,
            "finding": "; ".join(content.get("findings", ())),
            "error": self.error,
            "seconds": round(self.seconds, 2),
            "page": self.page.name if self.page else "",
            **{f"{e}.{p}": v for e, values in named.items() for p, v in values.items()},
        }
