"""What each library costs: size on the disk, what comes with it alone, and the import.

Run where ivtools and its extras are installed; writes benchmarks/results/weights.md.
"""

from __future__ import annotations

import re
import resource
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

ROOT = Path(__file__).parents[1]
IMPORTS = {
    "dask": "distributed",
    "matplotlib": "matplotlib.pyplot",
    "pymoo": "pymoo.core.algorithm",
    "scipy": "scipy.signal",
    "starlette": "starlette.applications",
    "statsmodels": "statsmodels.api",
}
REPEATS = 3
EXTRAS = ("parquet", "methods", "mujoco", "distributed", "app")
ABOUT = (
    "Processor time of the import, other work beside it: read it as an order. No longer in the "
    "core: pyarrow (extra `parquet`), and pooch with requests and all that it needs."
)


def needs(name: str, extra: str = "") -> set[str]:
    """Return what a library asks for directly, here and now."""
    from packaging.requirements import Requirement

    try:
        wanted = [Requirement(text) for text in distribution(name).requires or ()]
    except PackageNotFoundError:
        return set()
    here = {"extra": extra}
    return {r.name.lower() for r in wanted if r.marker is None or r.marker.evaluate(here)}


def closure(names: set[str]) -> set[str]:
    """Return the libraries and all that they need."""
    found: set[str] = set()
    while names:
        found |= names
        names = set().union(*(needs(name) for name in names)) - found
    return found


def megabytes(name: str) -> float:
    """Return the size of a library's files, MB, compiled Python left out."""
    try:
        files = distribution(name).files or ()
    except PackageNotFoundError:
        return 0.0
    paths = {Path(str(file.locate())) for file in files if file.suffix != ".pyc"}
    return sum(path.stat().st_size for path in paths if path.exists()) / 1e6


def import_ms(module: str) -> float:
    """Return the processor time of an import, the least of some, less that of no import, ms."""

    def seconds(code: str) -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, "-c", code], check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    return 1e3 * (
        min(seconds(f"import {module}") for _ in range(REPEATS))
        - min(seconds("") for _ in range(REPEATS))
    )


def rows(names: list[str], others: set[str]) -> list[str]:
    """Return a row per library: size, with what only it brings, import."""
    out = []
    for name in names:
        alone = closure({name}) - closure((set(names) | others) - {name}) | {name}
        module = IMPORTS.get(name, name)
        own, whole = megabytes(name), sum(megabytes(n) for n in alone)
        out.append(f"| {name} | {own:.1f} | {whole:.1f} | {import_ms(module):.0f} |")
    return out


def whole(extra: str, names: list[str], core: set[str]) -> str:
    """Return the row of an extra: what it adds to the core, and its imports together."""
    more = closure(set(names)) - closure(core)
    imports = ", ".join(IMPORTS.get(name, name) for name in names)
    return f"| `{extra}` | +{sum(map(megabytes, more)):.0f} | {import_ms(imports):.0f} |"


def main() -> None:
    """Measure and write the table."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]

    def split(texts: list[str]) -> list[str]:
        return [re.split(r"[><\[]", text)[0].lower() for text in texts if "ivtools" not in text]

    core, head = (
        split(project["dependencies"]),
        "| library | MB | with what only it brings, MB | import, ms |",
    )
    lines = ["# What the libraries cost", "", __doc__.split("\n")[0], "", ABOUT, ""]
    total = sum(megabytes(name) for name in closure(set(core)))
    extras = {e: split(project["optional-dependencies"][e]) for e in EXTRAS}
    lines += [
        "| | MB, with all that it needs | import, ms |",
        "|---|---|---|",
        f"| core | {total:.0f} | {import_ms('ivtools'):.0f} (`import ivtools`) |",
        *(whole(extra, names, set(core)) for extra, names in extras.items()),
        "",
        f"Core, {total:.0f} MB in all (Python {sys.version.split()[0]}, {sys.platform}):",
        "",
        head,
        "|---|---|---|---|",
    ]
    lines += rows(core, set())
    for extra, names in extras.items():
        lines += ["", f"Extra `{extra}`:", "", head, "|---|---|---|---|", *rows(names, set(core))]
    out = ROOT / "benchmarks" / "results" / "weights.md"
    out.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(out.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
