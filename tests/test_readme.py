"""The README keeps its promises."""

import re
import shlex
from pathlib import Path

import pytest

from ivtools.cli import app

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", README, flags=re.M | re.S)


def test_the_python_runs(capsys):
    (code,) = (text for language, text in BLOCKS if language == "python")
    assert len([line for line in code.splitlines() if line.strip()]) <= 10
    exec(compile(code, "README.md", "exec"), {})
    out = capsys.readouterr().out
    assert "idim-iv" in out and "'force'" in out


def test_the_two_commands_are_targets():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    first = next(text for language, text in BLOCKS if language == "sh")
    targets = re.findall(r"^make (\w+)", first, flags=re.M)
    assert targets == ["demo", "test"]
    assert all(re.search(rf"^{target}:", makefile, flags=re.M) for target in targets)


@pytest.mark.parametrize("line", re.findall(r"^ivtools .*|`(ivtools [^`]+)`", README, flags=re.M))
def test_the_verbs_exist(line):
    if line:
        verbs = [verb.name for verb in (*app.registered_commands, *app.registered_groups)]
        assert shlex.split(line)[1] in verbs


@pytest.mark.parametrize("target", re.findall(r"\]\(([^)#]+)\)|src=\"([^\"]+)\"", README))
def test_the_links_lead_somewhere(target):
    address = "".join(target)
    assert address.startswith("https://") or (ROOT / address).exists()


def test_the_readme_tells_the_number_of_results():
    from ivtools.reproduce import printed

    judged = sum(number.rule != "none" for number in printed())
    assert f"{judged} results that can be checked" in README
