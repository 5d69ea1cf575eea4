"""XML files, read within bounds: of size, depth and number, and without entities of their own."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

from ivtools.errors import AxisError

LARGEST = 32 << 20  # bytes
DEEPEST = 64
MOST = 200_000  # elements


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
