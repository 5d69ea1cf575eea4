"""What the site adds to the pages of docs/: other files of the project, formulae, generated lists.

A hook of mkdocs. README, changelog, benchmarks and notebooks become pages where they are linked
to; formulae become MathML, so no script is needed and none is fetched; the glossary's words are
those of the reports.
"""

from __future__ import annotations

import html
import json
import re
import tomllib
from functools import cache
from pathlib import Path, PurePosixPath
from posixpath import normpath, relpath
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, InclusionLevel

ROOT = Path(__file__).parents[1]
#: Files of the project that are pages of the site, by where they are.
PAGES = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
}
SHOWN = (
    *(f"benchmarks/results/**/*.{kind}" for kind in ("html", "svg", "png", "csv")),
    "benchmarks/**/*.md",
    "notebooks/*.ipynb",
    "data/*.md",
)
CODE = r"(?P<code>^```(?!math).*?^```|^(?: {4}|\t).*?$|(?<!\$)`[^`\n]+`)"
FORMULA = r"^ *```math\n(?P<fence>.*?)^ *```|\$`(?P<tick>[^`$]+)`\$|\$\$(?P<block>.+?)\$\$|(?<![\w$])\$(?P<line>[^$\n`]+)\$(?!\w)"  # noqa: E501
TEXT = re.compile(f"{FORMULA}|{CODE}", re.M | re.S)
LINK = re.compile(r"(\]\(|(?:src|href)=\")([^)\"\s]+)")
SEARCH = 'data-md-component="search" aria-label="Search"'
OUTPUT = 'class="output" tabindex="0" role="group" aria-label="Output"'  # it scrolls: keys reach it
_kept: dict[str, str] = {}


@cache
def places() -> dict[str, str]:
    """Return where each file of the project is in the site's sources."""
    found = dict(PAGES)
    for pattern in SHOWN:
        for path in ROOT.glob(pattern):
            name = path.relative_to(ROOT).as_posix()
            if "/rows/" not in name:
                found[name] = name.replace(".ipynb", ".md")
    return found


def on_files(files: Any, config: Any) -> Any:
    """Add the project's files to those of docs/."""
    for name, place in places().items():
        if name.endswith(".ipynb"):
            files.append(File.generated(config, place, content=notebook(ROOT / name)))
        else:
            files.append(File.generated(config, place, abs_src_path=str(ROOT / name)))
    for file in files:
        if file.src_uri in places().values() and file.is_documentation_page():
            file.inclusion = InclusionLevel.NOT_IN_NAV
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Fill in what is generated, mend links that leave docs/, and keep formulae as MathML."""
    markdown = markdown.replace("<!-- words -->", words()).replace("<!-- cards -->", cards())
    source = next(
        (n for n, p in places().items() if p == page.file.src_uri), f"docs/{page.file.src_uri}"
    )
    markdown = TEXT.sub(_formula, markdown)
    pieces = re.split(CODE.replace("?P<code>", ""), markdown, flags=re.M | re.S)
    for i in range(0, len(pieces), 2):
        pieces[i] = LINK.sub(lambda m: m[1] + target(m[2], source, page.file.src_uri), pieces[i])
    return "".join(pieces)


def on_page_content(content: str, **_: Any) -> str:
    """Put back what Markdown must not touch."""
    return re.sub(r"(?:<p>)?KEPT(\d+)KEPT(?:</p>)?", lambda m: _kept[m[1]], content)


def on_post_page(output: str, page: Any, **_: Any) -> str:
    """Take the search's helper from the site itself; nothing is loaded from anywhere else."""
    here = relpath("theme/iframe-worker.js", str(PurePosixPath(page.file.dest_uri).parent))
    output = output.replace("https://unpkg.com/iframe-worker/shim", here)
    output = output.replace('data-md-component="search" role="dialog"', f'{SEARCH} role="dialog"')
    loads = r'<(?:script|img|iframe)[^>]*src="(https?:[^"]+)|<link[^>]*href="(https?:[^"]+)'
    if found := [a or b for a, b in re.findall(loads, output)]:
        raise PluginError(f"{page.file.src_uri} loads {found[0]} from elsewhere")
    return output


def target(link: str, source: str, here: str) -> str:
    """Return a link of a source file as it is in the site; to what is not there: nowhere."""
    path, _, anchor = link.partition("#")
    if not path or re.match(r"[a-z]+:", path):
        return link
    name = normpath(str(PurePosixPath(source).parent / path))
    place = places().get(name) or (name[5:] if name.startswith("docs/") else None)
    if place is None or not (ROOT / name).exists():
        generated = name.startswith("docs/") and name[5:] in PAGES.values()
        if not generated:
            return "#" if (ROOT / name).exists() else link  # mkdocs complains of what is nowhere
        place = name[5:]
    return relpath(place, str(PurePosixPath(here).parent)) + (f"#{anchor}" if anchor else "")


def notebook(path: Path) -> str:
    """Return a notebook as Markdown, with the outputs that it was committed with."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    parts = []
    for cell in cells:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
        else:
            parts.append(f"```python\n{source}\n```")
            parts += [_keep(f"<div {OUTPUT}>{_shown(output)}</div>") for output in cell["outputs"]]
    return "\n\n".join(parts)


def cards() -> str:
    """Return the notebooks as cards: figure, title, first sentence."""
    out = []
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        title, _, text = "".join(cells[0]["source"]).partition("\n")
        first = re.split(r"(?<=[.?])\s", re.sub(r"[*`$]", "", " ".join(text.split())))[0]
        images = [
            o["data"]["image/png"]
            for c in cells
            for o in c.get("outputs", [])
            if "image/png" in o.get("data", {})
        ]
        image = f'<img alt="" src="data:image/png;base64,{"".join(images[0])}">' if images else ""
        link = f"notebooks/{path.stem}.html"
        name = html.escape(title.lstrip("# "))
        out.append(
            f'<div class="card">{image}<p><a href="{link}"><strong>{name}</strong></a></p>'
            f"<p>{html.escape(first)}</p></div>"
        )
    return _keep(f'<div class="cards">{"".join(out)}</div>')


def words() -> str:
    """Return the words that the reports explain."""
    terms = tomllib.loads((ROOT / "ivtools/templates/terms.toml").read_text(encoding="utf-8"))
    return "\n".join(
        f"**{name}**\n: {meaning}\n"
        for name, meaning in sorted(terms.items(), key=lambda t: t[0].lower())
    )


def _shown(output: Any) -> str:
    data = output.get("data", {})
    if "text/html" in data:
        return "".join(data["text/html"])
    if "image/png" in data:
        return f'<img alt="figure" src="data:image/png;base64,{"".join(data["image/png"])}">'
    text = output.get("text") or data.get("text/plain") or ""
    return f"<pre>{html.escape(''.join(text))}</pre>"


def _formula(match: re.Match[str]) -> str:
    """Return a formula as MathML, kept for later; code as it is."""
    if match["code"] is not None:
        return match[0]
    inline, block = match["tick"] or match["line"], match["fence"] or match["block"]
    indent = match[0][: len(match[0]) - len(match[0].lstrip())]
    return indent + _keep(convert(inline or block, display="inline" if inline else "block"))


def _keep(text: str) -> str:
    key = str(len(_kept))
    _kept[key] = text
    return f"KEPT{key}KEPT"
