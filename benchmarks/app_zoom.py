"""How long a zoom takes in the app, by length of the record.

The server's part in processor time, which other work does not change; and the whole, from the key
to the drawn samples in Chromium, which it does.
"""

import json
import statistics
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ivtools.app import charts
from ivtools.plots.chart import Chart, Panel, Series
from ivtools.report import Page

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from browser import app, at_rest, driver  # noqa: E402

RESULT = Path(__file__).parent / "results" / "app.md"
STEPS, SHARES = 24, (1.0, 0.5, 0.1, 0.01)


def log(folder: Path, n: int) -> tuple[str, str]:
    """Write a record of n samples and its axis file."""
    t, rng = np.arange(n) / 1000.0, np.random.default_rng(0)
    q = 0.1 * np.sin(2.0 * t) + 0.05 * np.sin(0.3 * t)
    frame = pd.DataFrame({"t": t, "q_ref": q, "q": q + rng.normal(0, 1e-5, n)})
    frame["nu"] = 50.0 * (frame.q_ref - frame.q) + rng.normal(0, 0.01, n)
    frame.to_parquet(folder / "log.parquet")
    axis = '[controller]\nkind = "pd"\nkp = 50.0\nkd = 0.0\n[drive]\ngain = 1.0\n'
    (folder / "axis.toml").write_text(axis)
    return str(folder / "log.parquet"), str(folder / "axis.toml")


def zooms(chrome, address: str) -> list[float]:
    """Return ms of each zoom of the first chart: in, about, and out again."""
    chrome.get(address)
    at_rest(chrome, 600)
    chrome.execute_script("document.querySelector('#look figure.chart').scrollIntoView()")
    figure = chrome.find_element("css selector", "#look figure.chart")
    keys = ["+"] * 4 + ["ArrowRight", "ArrowLeft"] * 4 + ["-"] * 3
    found = []
    for key in (keys * 3)[:STEPS]:
        chrome.execute_script("delete arguments[0].dataset.refined", figure)
        press = "document.querySelector(`#look .chart [data-key='${arguments[0]}']`).click()"
        chrome.execute_script(press, key)
        end = time.monotonic() + 10
        while time.monotonic() < end:
            if value := figure.get_attribute("data-refined"):
                found.append(float(value))
                break
            time.sleep(0.02)
    return found


def server(folder: Path, n: int, share: float) -> float:
    """Return ms of processor time for the samples of a share of a chart of eight signals."""
    t, rng = np.arange(n) / 1000.0, np.random.default_rng(0)
    if not (folder / "charts").exists():
        signals = [rng.normal(size=n) for _ in range(8)]
        series = [Series(f"{k}", x, "measured") for k, x in enumerate(signals)]
        panels = tuple(Panel("force", "N", tuple(series[k : k + 2])) for k in range(0, 8, 2))
        page = Page("", "")
        page.add("", figures=[Chart("record", t, panels, "")])
        charts.keep(page, folder)
    found = []
    for _ in range(5):
        begin = time.process_time()
        json.dumps(charts.kept(folder, "record").window(0.0, share * t[-1]).content())
        found.append(1000.0 * (time.process_time() - begin))
    return statistics.median(found)


def served(lengths: Sequence[int]) -> list[str]:
    """Return the rows of the server's part."""
    rows = []
    for n in lengths:
        with tempfile.TemporaryDirectory() as name:
            ms = [server(Path(name), n, share) for share in SHARES]
        rows.append(f"| {n} | {' | '.join(f'{x:.0f}' for x in ms)} |")
        print(rows[-1], flush=True)
    return rows


def drawn(lengths: Sequence[int]) -> list[str]:
    """Return the rows of the whole, in a browser."""
    rows = []
    for n in lengths:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            chrome = driver(folder)
            file, axis = log(folder, n)
            with app(folder, file, "--axis", axis) as made:
                ms = sorted(zooms(chrome, made.address)) or [float("nan")]
            chrome.quit()
        load = Path("/proc/loadavg").read_text().split()[0]
        middle, last = statistics.median(ms), ms[-1]
        rows.append(f"| {n} | {len(ms)} | {middle:.0f} | {last:.0f} | {load} |")
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    """Measure, and write the tables."""
    shares = " | ".join(f"{share:.0%}" for share in SHARES)
    lines = [
        "# Zooming in the app",
        "",
        "Made by app_zoom.py. The server's part: processor time, ms, to re-sample and encode eight",
        "signals in four panels, by the share of the record that is visible (median of 5).",
        "",
        f"| samples | {shares} |",
        "|---|" + "---|" * len(SHARES),
        *served((100_000, 1_000_000, 10_000_000)),
        "",
        "The whole: from the key to the drawn samples of three panels in Chromium, with 60 ms of",
        "waiting for further keys, and the load of the two cores at that time.",
        "",
        "| samples | zooms | median, ms | worst, ms | load |",
        "|---|---|---|---|---|",
        *drawn([int(float(n)) for n in sys.argv[1:]] or [100_000, 1_000_000]),
    ]
    RESULT.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
