"""Charts that a worker leaves for the server: arrays on disk, of which it reads what is visible."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np

from ..errors import DataError
from ..files import write
from ..plots.chart import Chart, Panel, Region, Series
from ..report import Page

FOLDER = "charts"


def keep(page: Page, folder: Path) -> None:
    """Write the charts of a page, whole: times as they are, signals in single precision."""
    for chart in (f for s in page.sections for f in s.figures if isinstance(f, Chart)):
        place = folder / FOLDER / chart.name
        place.mkdir(parents=True, exist_ok=True)
        np.save(place / "t.npy", np.asarray(chart.t, dtype=float))
        signals = [np.ravel(s.values) for p in chart.panels for s in p.series]
        np.save(place / "signals.npy", np.array(signals, dtype=np.float32))
        panels = [
            {
                "quantity": p.quantity,
                "unit": p.unit,
                "limits": p.limits,
                "series": [[s.label, s.role] for s in p.series],
            }
            for p in chart.panels
        ]
        regions = [[r.start, r.stop, r.label, r.shaded] for r in chart.regions]
        about = {"panels": panels, "regions": regions, "across": chart.across}
        write(place / "about.json", json.dumps(about))


def kept(folder: Path, name: str) -> Chart:
    """Return a chart that was kept; its arrays stay on disk until they are looked at.

    Raises
    ------
    DataError
        There is none of that name.
    """
    place = folder / FOLDER / name
    if not re.fullmatch(r"[a-z0-9-]{1,60}", name) or not (place / "about.json").exists():
        raise DataError("there is no such chart")
    about = json.loads((place / "about.json").read_text(encoding="utf-8"))
    t = np.load(place / "t.npy", mmap_mode="r", allow_pickle=False)
    signals = iter(np.load(place / "signals.npy", mmap_mode="r", allow_pickle=False))
    panels = tuple(
        Panel(
            p["quantity"],
            p["unit"],
            tuple(Series(label, next(signals), role) for label, role in p["series"]),
            tuple(p["limits"]) if p["limits"] else None,
        )
        for p in about["panels"]
    )
    regions = tuple(Region(*r) for r in about["regions"])
    return Chart(name, t, panels, "", regions, across=about["across"])
