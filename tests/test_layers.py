"""Imports point to the left only: the rooms of the package in the order of its layers."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

import ivtools

ROOT = Path(ivtools.__file__).parent
#: Rooms from left to right. A room imports rooms to its left, and nothing beside it.
ORDER = [
    ("errors",),
    (
        "download",
        "files",
        "limits",
        "methods",
        "settings",
        "mat_child",
        "registry",
        "tables",
        "trapezoids",
        "units",
    ),
    ("csv_layout", "resume", "workers"),
    ("columns", "clock", "compiled", "untidy", "xml_file"),
    ("record_format",),
    ("checks", "display", "readers"),
    ("record", "linalg", "pipeline"),
    ("pipelines",),
    ("measured",),
    ("datasets", "physics"),
    ("robot",),
    ("loop",),
    ("axes", "digest", "excitation"),
    ("problem",),
    ("estimates", "goodness", "hypothesis", "joint_figures"),
    ("results", "transfer_table"),
    ("comparison_table", "recommendation"),
    ("comparison",),
    ("inference", "estimators"),
    ("simulators",),
    ("gap", "guess", "study", "leaderboard"),
    ("suitability",),
    ("plots",),
    ("report",),
    ("pages", "log_page"),
    ("reproduce", "demo"),
    ("app",),
    ("cli",),
    ("__main__",),
]
RANK = {room: rank for rank, rooms in enumerate(ORDER) for room in rooms}
#: Methods that open a room to the right when they are called; nothing else may.
LATE = {
    ("datasets", "axes"): "twin() is simulated by the loop of a registered axis",
    ("hypothesis", "inference"): "results offer their own tests",
    ("loop", "simulators"): "ClosedLoop.from_mjcf()",
    ("record", "plots"): "record.plot()",
    ("display", "plots"): "plot() of every result",
    ("display", "report"): "to_html() of every result",
    ("comparison", "plots"): "a comparison draws whichever results it has",
    ("study", "plots"): "the figures of score.page()",
    ("study", "report"): "score.page()",
    ("gap", "plots"): "diagnosis.plot()",
    ("gap", "report"): "diagnosis.to_html()",
}


class Import(NamedTuple):
    file: Path
    line: int
    room: str
    target: str
    late: bool


def imports(file: Path) -> Iterator[Import]:
    """Yield the imports of other rooms, with those that only type checkers follow left out."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    parts = file.relative_to(ROOT).with_suffix("").parts
    package = ["ivtools", *parts[:-1]]
    late = {
        id(node)
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        for node in ast.walk(function)
    }
    unseen = {
        id(node)
        for block in ast.walk(tree)
        if isinstance(block, ast.If) and "TYPE_CHECKING" in ast.unparse(block.test)
        for statement in block.body
        for node in ast.walk(statement)
    }
    for node in ast.walk(tree):
        if id(node) in unseen:
            continue
        for name in imported(node, package):
            target = name.split(".")[1] if "." in name else "__init__"
            if target != parts[0]:
                yield Import(file, node.lineno, parts[0], target, id(node) in late)


def imported(node: ast.AST, package: list[str]) -> list[str]:
    """Return the modules of this package that a statement imports, as absolute names."""
    if isinstance(node, ast.Import):
        names = [alias.name for alias in node.names]
    elif isinstance(node, ast.ImportFrom):
        base = package[: len(package) - node.level + 1] if node.level else []
        module = ".".join([*base, *([node.module] if node.module else [])])
        names = [f"{module}.{alias.name}" for alias in node.names]
    else:
        names = []
    return [name for name in names if name.split(".")[0] == "ivtools"]


FILES = sorted(file for file in ROOT.rglob("*.py") if file != ROOT / "__init__.py")


def allowed(found: Import) -> bool:
    if found.target == "__version__" or (found.late and (found.room, found.target) in LATE):
        return True
    return RANK.get(found.target, len(ORDER)) < RANK[found.room]


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(ROOT)))
def test_imports_point_to_the_left(file):
    room = file.relative_to(ROOT).with_suffix("").parts[0]
    assert room in RANK, f"{room} has no place in the order of the layers"
    wrong = [
        f"{found.file.relative_to(ROOT)}:{found.line} imports {found.target}"
        for found in imports(file)
        if not allowed(found)
    ]
    assert not wrong


def test_every_kind_of_import_is_seen(tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    file = tmp_path / "loop" / "kernel.py"
    file.parent.mkdir()
    file.write_text(
        "import ivtools.cli\nfrom ivtools import plots\nfrom ..gap import screen\n"
        "from . import controllers\nfrom .. import study\nimport numpy\n"
        "def f():\n    from ivtools.report import page\n    from ..simulators import mjcf\n"
        "if TYPE_CHECKING:\n    from ivtools.problem import Problem\n"
    )
    found = {(i.target, i.late, allowed(i)) for i in imports(file)}
    assert found == {
        ("cli", False, False),
        ("plots", False, False),
        ("gap", False, False),
        ("study", False, False),
        ("report", True, False),
        ("simulators", True, True),
    }


def test_the_public_face_imports_nothing_until_it_is_asked():
    code = (
        "import sys, ivtools; ivtools.Record; "
        "print(*{name.split('.')[0] for name in sys.modules} & {'pandas', 'scipy', 'numba', "
        "'control', 'statsmodels', 'matplotlib', 'joblib', 'cvxpy', 'pymoo', 'dask'})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


@pytest.mark.parametrize("name", [n for n in ivtools.__all__ if (ROOT / f"{n}.py").exists()])
def test_public_modules_are_attributes(name):
    assert getattr(ivtools, name).__name__ == f"ivtools.{name}"


def test_an_unknown_public_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'Rekord'"):
        ivtools.Rekord  # noqa: B018


def _inside(room: str) -> dict[str, set[str]]:
    """Return which modules of a room import which others at their top level."""
    folder, found = ROOT / room, {}
    for file in folder.rglob("*.py"):
        parts = file.relative_to(folder).with_suffix("").parts
        if parts == ("__init__",):
            continue
        package = ["ivtools", room, *parts[:-1]]
        names = {
            name
            for node in ast.parse(file.read_text(encoding="utf-8")).body
            for name in imported(node, package)
            if name.startswith(f"ivtools.{room}.")
        }
        found.setdefault(parts[0], set()).update(n.split(".")[2] for n in names)
    return {name: targets & found.keys() - {name} for name, targets in found.items()}


def test_no_circles_in_the_diagnosis():
    inside = _inside("gap")
    assert "fold" in inside["fit"]  # that imports are seen at all,
    assert "preflight" in inside["floor"]  # and those of whole rooms
    while free := {name for name, targets in inside.items() if not targets & inside.keys()}:
        inside = {name: targets for name, targets in inside.items() if name not in free}
    assert not inside
