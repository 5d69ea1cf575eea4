"""What is published: one version, one address, the same dependencies, a wheel that works."""

import ast
import importlib.util
import re
import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path
from types import ModuleType

import pytest

import ivtools

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
CORE = PROJECT["project"]["dependencies"]


def read(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("file, line", [
    ("CITATION.cff", f"version: {ivtools.__version__}"),
    ("CHANGELOG.md", f"## {ivtools.__version__}"),
    ("recipe/recipe.yaml", f'version: "{ivtools.__version__}"'),
])  # fmt: skip
def test_there_is_one_version(file, line):
    assert re.search(rf"^\s*{re.escape(line)}", read(file), flags=re.M), f"{file} has no {line}"


def addresses() -> ModuleType:
    """Return what fills in links and addresses when a wheel is built."""
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_there_is_one_address():
    address = PROJECT["tool"]["hatch"]["metadata"]["hooks"]["custom"]["address"]
    assert not address or re.fullmatch(r"https://[\w.-]+\.\w+/\S+[^/]", address)
    for file, key in (("CITATION.cff", "repository-code"), ("recipe/recipe.yaml", "homepage")):
        found = re.findall(rf"^\s*{key}: (\S+)", read(file), flags=re.M)
        assert found == ([address] if address else []), f"{file}: {key} is not the address"


@pytest.mark.parametrize("address", ["", "https://host.org/own/ivtools"])
def test_no_link_of_the_readme_is_dead_on_an_index(address):
    text, made = read("README.md"), addresses()
    shown = made.readme(text, address)
    links = re.findall(r"\]\(([^)]+)\)|src=\"([^\"]+)\"", shown)
    assert all("".join(link).startswith(("https://", "#")) for link in links)
    assert bool(made.urls(address)) == bool(address)
    assert bool(address) == any(address and address in "".join(x) for x in links)
    for words in ("Your own log", "how it decides", "make demo"):
        assert words in shown
    if not address:
        assert "<img" not in shown and "source archive" in shown
    else:
        assert f'src="{address}/raw/main/docs/figure.png"' in shown
        assert f"]({address}/blob/main/docs/tutorial.md)" in shown


def test_the_recipe_needs_what_the_package_needs():
    yaml = pytest.importorskip("yaml", reason="mkdocs brings it")
    asked = yaml.safe_load(read("recipe/recipe.yaml"))["requirements"]
    recipe = {re.sub(r"^matplotlib-base", "matplotlib", need) for need in asked["run"]}
    built_by = tomllib.loads(read("pyproject.toml"))["build-system"]["requires"]
    assert {re.sub(r">=", " >=", text) for text in built_by} <= set(asked["host"])
    wanted = {re.sub(r">=", " >=", text) for text in CORE}
    assert recipe == wanted | {f"python {PROJECT['project']['requires-python']}"}


def test_what_is_imported_is_asked_for():
    extras = PROJECT["project"]["optional-dependencies"]
    asked = [
        *CORE,
        *(text for name in set(extras) - {"all", "dev", "docs"} for text in extras[name]),
    ]
    names = {re.split(r"[><\[]", text)[0] for text in asked} - {
        "ivtools",
        "dask",
    }  # distributed brings it
    found = set()
    for file in (ROOT / "ivtools").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                found.add(str(node.module).split(".")[0])
            elif isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "optional":
                found |= {
                    a.value.split(".")[0] for a in node.args[:1] if isinstance(a, ast.Constant)
                }
    assert found - set(sys.stdlib_module_names) - {"ivtools"} == names | {"distributed"}


@pytest.mark.slow
def test_the_wheel_is_whole_and_its_demo_runs(tmp_path):
    """Built as for an index, installed where nothing else is, in one process after the other."""
    run = {"check": True, "capture_output": True, "text": True, "timeout": 900}
    subprocess.run([sys.executable, "-m", "build", "--outdir", tmp_path, ROOT], **run)
    wheel, sdist = next(tmp_path.glob("*.whl")), next(tmp_path.glob("*.tar.gz"))
    subprocess.run([sys.executable, "-m", "twine", "check", "--strict", wheel, sdist], **run)
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        about = archive.read(next(n for n in names if n.endswith("METADATA"))).decode()
    files = {f.relative_to(ROOT).as_posix() for f in (ROOT / "ivtools").rglob("*") if f.is_file()}
    assert {f for f in files if "__pycache__" not in f} <= names
    assert not re.search(r'\]\((?!https://|#)|src="(?!https://)', about), "a link is relative"
    venv.create(tmp_path / "empty", with_pip=True)
    bin = tmp_path / "empty" / "bin"
    subprocess.run([bin / "pip", "install", "--quiet", wheel], **run)
    home = {"HOME": str(tmp_path), "PATH": str(bin)}
    subprocess.run([bin / "ivtools", "demo"], cwd=tmp_path, env=home, **run)
    assert "Made by ivtools" in (tmp_path / "ivtools-demo/report.html").read_text(encoding="utf-8")
    told = subprocess.run([bin / "ivtools", "benchmark", "noise"], cwd=tmp_path, env=home,
                          capture_output=True, text=True)  # fmt: skip
    assert told.returncode == 2 and 'pip install "ivtools[parquet]"' in told.stderr
