"""Every Python block of the documentation runs, block after block of one page."""

import re
from pathlib import Path

import pandas as pd
import pytest

import ivtools as iv

DOCS = sorted((Path(__file__).parents[1] / "docs").glob("*.md"))
BLOCK = re.compile(r"^```python\n(.*?)^```", flags=re.M | re.S)
PAGES = [page for page in DOCS if BLOCK.search(page.read_text(encoding="utf-8"))]


@pytest.fixture(scope="module")
def folder(twin, tmp_path_factory) -> Path:
    """What a reader has: an axis file and logs of the axis."""
    folder = tmp_path_factory.mktemp("reader")
    (folder / "axis.toml").write_text(iv.axes.emps().to_toml())
    (folder / "logs").mkdir()
    one, two = twin.slice(0, 12_000).to_frame(), twin.slice(12_000).to_frame()
    for name, frame in (("log", one), ("other", two), ("logs/log_17", one)):
        frame.to_csv(folder / f"{name}.csv", index=False)
    return folder


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_blocks_of_a_page_run(page, folder, monkeypatch):
    monkeypatch.chdir(folder)
    loop = iv.axes.emps()
    record, other = iv.Record.read("log.csv"), iv.Record.read("other.csv")
    problem = iv.Problem(record, loop)
    fit = iv.SRIVC(poles=2, input="q_ref").fit(problem)
    names = {"iv": iv, "pd": pd, "loop": loop, "record": record, "other": other}
    names |= {"problem": problem, "fit": fit}
    for block in BLOCK.findall(page.read_text(encoding="utf-8")):
        quick = re.sub(r"seeds=\d+", "seeds=2", block).replace("n_jobs=-1", "n_jobs=1")
        exec(compile(quick, page.name, "exec"), names)
