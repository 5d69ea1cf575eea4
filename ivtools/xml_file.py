"""XML files, read within bounds: of size, depth and number, and without entities of their own."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from contextlib import suppress
from pathlib import Path

from ivtools.errors import AxisError

LARGEST = 32 << 20  # bytes
DEEPEST = 64
MOST = 200_000  # elements
MOST_MADE = 20_000  # elements of a MuJoCo model, with those that counts make
MOST_CELLS = 20_000_000  # of a height field or a texture
_COUNTING = ("replicate", "composite", "flexcomp")


class _Bounded(ET.TreeBuilder):
    """A tree of bounded depth and size, without a document type: entities may not multiply."""

    depth = count = 0

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise AxisError("it has a document type, which models do not need; remove <!DOCTYPE ...>")

    def start(self, tag: str, attrs: dict[str, str]) -> ET.Element:
        self.depth, self.count = self.depth + 1, self.count + 1
        if self.depth > DEEPEST or self.count > MOST:
            raise AxisError(
                f"XML is deeper than {DEEPEST} or larger than {MOST} elements; that is no model"
            )
        return super().start(tag, attrs)

    def end(self, tag: str) -> ET.Element:
        self.depth -= 1
        return super().end(tag)


def parsed(path: Path, comments: bool = False) -> ET.Element:
    """Return the root of an XML file.

    Parameters
    ----------
    path : Path
    comments : bool
        Keep comments, for a file that is edited and written again.

    Raises
    ------
    AxisError
        The file cannot be read, is no XML, or is beyond the bounds.
    """
    try:
        with path.open("rb") as file:
            text = file.read(LARGEST + 1)
    except (OSError, ValueError) as error:
        raise AxisError(
            f"{getattr(error, 'strerror', None) or error}; give the path of a file"
        ) from error
    if len(text) > LARGEST:
        raise AxisError(f"larger than {LARGEST >> 20} MB; that is no model")
    parser = ET.XMLParser(target=_Bounded(insert_comments=comments))
    try:
        parser.feed(text)
        return parser.close()
    except (ET.ParseError, ValueError, LookupError) as error:
        if isinstance(error, AxisError):
            raise
        raise AxisError(f"not XML: {error}") from error


def check_counts(path: Path) -> None:
    """Refuse a MuJoCo model, and what it includes, that a few counts make larger than a model is.

    Raises
    ------
    AxisError
        As `parsed`, and for counts beyond the bounds.
    """
    if _made(parsed(path), path.parent, {path.resolve()}) > MOST_MADE:
        raise AxisError(f"its counts make more than {MOST_MADE} elements; take a smaller model")


def _made(element: ET.Element, folder: Path, seen: set[Path]) -> float:
    """Return how many elements an element becomes, those of included files among them."""
    cells = max(_product(element, "nrow", "ncol"), _product(element, "width", "height"))
    if cells > MOST_CELLS:
        raise AxisError(f"<{element.tag}> has {cells:.3g} cells; at most {MOST_CELLS} are taken")
    inner = sum(_made(child, folder, seen) for child in element)
    file = folder / element.get("file", "") if element.tag == "include" else folder
    if file.is_file() and file.resolve() not in seen:
        seen.add(file.resolve())
        inner += _made(parsed(file), folder, seen)
    return (1.0 + inner) * (_product(element, "count") if element.tag in _COUNTING else 1.0)


def _product(element: ET.Element, *names: str) -> float:
    """Return the product of an element's numbers; MuJoCo says what is wrong with those that are."""
    found = 1.0
    for word in " ".join(element.get(name, "1") for name in names).split():
        with suppress(ValueError):
            found *= max(float(word), 1.0)
    return found
