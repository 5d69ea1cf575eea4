"""The documentation holds: Python runs, commands exist, messages are those of the source."""

import ast
import re
import shlex
from pathlib import Path

import pandas as pd
import pytest

import ivtools as iv
from ivtools.cli import app, run

ROOT = Path(__file__).parents[1]
DOCS = sorted((ROOT / "docs").glob("*.md"))
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", flags=re.M | re.S)


def blocks(page: Path, language: str) -> list[str]:
    return [
        text for name, text in BLOCK.findall(page.read_text(encoding="utf-8")) if name == language
    ]


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


PAGES = [p for p in DOCS if blocks(p, "python") and p.stem != "tutorial"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_blocks_of_a_page_run(page, folder, monkeypatch):
    monkeypatch.chdir(folder)
    loop = iv.axes.emps()
    record, other = iv.Record.read("log.csv"), iv.Record.read("other.csv")
    problem = iv.Problem(record, loop)
    fit = iv.SRIVC(poles=2, input="q_ref").fit(problem)
    names = {"iv": iv, "pd": pd, "loop": loop, "record": record, "other": other}
    names |= {"problem": problem, "fit": fit}
    for block in blocks(page, "python"):
        quick = re.sub(r"seeds=\d+", "seeds=2", block).replace("n_jobs=-1", "n_jobs=1")
        exec(compile(quick, page.name, "exec"), names)


def test_the_tutorial_works_as_written(tmp_path, monkeypatch, capsys):
    """Every line of it, in its order; and what it promises is what comes."""
    monkeypatch.chdir(tmp_path)
    page = ROOT / "docs" / "tutorial.md"
    for language, block in BLOCK.findall(page.read_text(encoding="utf-8")):
        if language == "python":
            exec(compile(block, page.name, "exec"), {})
        for line in block.splitlines() if language == "sh" else ():
            if line.startswith("sed"):
                file = Path("axis.toml")
                file.write_text(
                    re.sub(r"^gain = 1.0", "gain = 35.15", file.read_text(), flags=re.M)
                )
            elif line.startswith("ivtools"):
                assert run(shlex.split(line)[1:]) == 0, line
    text = capsys.readouterr().out
    for promised in ("kp 160.2, kv 243.4 (R2 1.0000)", "it suffices", "verdict: explained",
                     "asymmetric-viscous (99 % likely)"):  # fmt: skip
        assert promised in text
    assert float(re.search(r"^inertia  kg +(\S+)", text, flags=re.M)[1]) == pytest.approx(
        94.9, abs=0.05
    )
    errors = [float(e) for e in re.findall(r"^hold-out force, % +(\S+)", text, flags=re.M)]
    assert errors == [pytest.approx(7.25, abs=0.05), pytest.approx(2.4, abs=0.05)]
    assert Path("report/report.html").exists() and Path("gap/report.html").exists()


COMMANDS = {
    line
    for page in DOCS
    for block in blocks(page, "sh")
    for line in block.replace("\\\n", " ").splitlines()
    if line.startswith("ivtools ")
}


@pytest.mark.parametrize("line", sorted(COMMANDS))
def test_the_commands_exist(line):
    verbs = [verb.name for verb in (*app.registered_commands, *app.registered_groups)]
    assert shlex.split(line, comments=True)[1] in verbs


def messages() -> set[str]:
    """Return the texts of the source's errors, with … for what is filled in."""
    found = set()
    for file in (ROOT / "ivtools").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.JoinedStr):
                parts = (v.value if isinstance(v, ast.Constant) else "…" for v in node.values)
                found.add("".join(map(str, parts)))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.add(node.value)
    return found


def test_the_questions_are_messages_of_the_source():
    asked = re.findall(
        r"^### `(.+)`$", (ROOT / "docs/faq.md").read_text(encoding="utf-8"), flags=re.M
    )
    known = messages()
    strange = [text for text in asked if not any(m.startswith(text) for m in known)]
    assert len(asked) > 25 and not strange


def test_every_link_leads_somewhere():
    generated = {"index.md", "changelog.md", "contributing.md"}
    for page in DOCS:
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
        for link in re.findall(r"\]\(([^)#\s]+)", text):
            if not link.startswith("http") and link not in generated:
                assert (page.parent / link).exists(), f"{page.name}: {link}"


def test_the_reference_names_the_public_face():
    text = (ROOT / "docs/reference.md").read_text(encoding="utf-8")
    named = {path.split(".")[-1] for path in re.findall(r"^::: (\S+)", text, flags=re.M)}
    modules = {"axes", "datasets", "estimators", "plots"}
    assert set(iv.__all__) - modules - named == set()
