"""The layout of a csv file as people have them: separators, decimals, comments, units."""

from __future__ import annotations

import codecs
import csv
import gzip
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import IO

from ivtools import limits
from ivtools.errors import DataError, IVToolsError
from ivtools.units import parse

__all__ = ["Layout", "sniff"]

SAMPLE = 1 << 18  # bytes read to find the layout
LARGEST = 1 << 25  # bytes read if there is no row in that
LOOK_AT = 50  # rows of data looked at
BOMS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
NOT_TEXT = re.compile(r"[\x00-\x08\x0b\x0e-\x1f\x7f-\x9f]")
NUMBER = re.compile(r"[+-]?(\d++[.,]?\d*+|[.,]\d++)([eE][+-]?\d++)?|[+-]?(nan|inf|infinity)", re.I)
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
SPOKEN = {";": "semicolons", "\t": "tabs", "|": "bars", r"\s+": "spaces"}
SEP_LINE = re.compile(r'"?sep=([,;|\t])"?', re.I)  # spreadsheets write it above the header
EMPTY = ("", "na", "n/a", "null", "none", "nan")


@dataclass(frozen=True)
class Layout:
    """How to read a csv file.

    Attributes
    ----------
    names : tuple of str
        Column names as in the header, a unit row added in brackets.
    first_row : int
        Lines of the file before the first row of data.
    separator, decimal, encoding : str
        As pandas takes them.
    comment : str or None
        Character that starts a comment.
    notes : tuple of str
        What was not plain.
    rows : int
        How many rows the file seems to have, at least.
    preamble : tuple of str
        What is above the header, comments included.
    """

    names: tuple[str, ...]
    first_row: int
    separator: str
    decimal: str
    encoding: str
    comment: str | None
    notes: tuple[str, ...]
    rows: int
    preamble: tuple[str, ...]


def sniff(path: Path) -> Layout:
    """Find the layout of a csv file from its first lines.

    Raises
    ------
    DataError
        It is no text, has no header row, or can be read in more than one way.
    """
    text, encoding = _sample(path)
    lines = list(_content(text))
    told = SEP_LINE.fullmatch(lines[0][1].strip(" ")) if lines else None
    lines = lines[1:] if told else lines
    comment = next((line.strip()[0] for _, line in _comments(text)), None)
    more = f" in its first {LARGEST >> 20} MB" if _size(path) > LARGEST else ""
    if not lines:
        raise DataError(f"the file has no content{more}; log or copy it again")
    lines, skipped = _without_preamble(lines)
    (start, header), data = lines[0], lines[1:]
    separator = told[1] if told else _separator(header)
    names = _fields(header, separator)
    if all(NUMBER.fullmatch(name) for name in names):
        names, data = _commented_header(text, start, names, separator), lines
    limits.check_columns(names)
    notes = [] if separator == "," else [f"columns are separated by {SPOKEN[separator]}"]
    if skipped:
        notes.append(f"{skipped} lines above the header were skipped")
    if not data:
        raise DataError(f"the file has a header and no rows{more}; log or copy it again")
    rows = [_fields(line, separator) for _, line in data[:LOOK_AT]]
    if len(rows) > 1 and _is_unit_row(rows[0]) and not _is_unit_row(rows[1]):
        notes.append("the second row holds the units")
        names = [f"{name} [{unit}]" if unit else name for name, unit in _pairs(names, rows[0])]
        data, rows = data[1:], rows[1:]
    names += [""] * _surplus(names, rows)
    decimal = _decimal(rows, separator)
    if decimal == ",":
        notes.append("numbers have decimal commas")
    rate = len(text) / (1 + lines[-1][0])  # characters per line
    size = _size(path) // (2 if encoding == "utf-16" else 1)
    return Layout(
        names=tuple(names),
        first_row=data[0][0],
        separator=separator,
        decimal=decimal,
        encoding=encoding,
        comment=comment,
        notes=tuple(notes),
        rows=int(size / rate) - data[0][0],
        preamble=tuple(line for i, line in _numbered(text) if i < start),
    )


def _size(path: Path) -> int:
    """Return the size of a text, bytes; of a gzipped one what its last four bytes say."""
    if not path.name.lower().endswith(".gz"):
        return path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - 4, 0))
        return int.from_bytes(file.read(4), "little")


def open_text(path: Path) -> IO[bytes]:
    """Open a text file, unpacked if it is gzipped."""
    return gzip.open(path) if path.name.lower().endswith(".gz") else path.open("rb")  # type: ignore[return-value]


def _sample(path: Path) -> tuple[str, str]:
    """Return the beginning of the file as text, and its encoding."""
    with open_text(path) as file:
        content = file.read(SAMPLE)
        whole = len(content) < SAMPLE
        while not whole and _rows(content) < LOOK_AT and len(content) < LARGEST:
            more = file.read(len(content))
            content, whole = content + more, len(more) < len(content)
    encoding = next((name for bom, name in BOMS.items() if content.startswith(bom)), "utf-8")
    try:
        text = codecs.getincrementaldecoder(encoding)().decode(content)
    except UnicodeDecodeError:
        encoding, text = "latin-1", content.decode("latin-1")
    if not whole:
        end = max(text.rfind("\n"), text.rfind("\r"))
        text = text[: end + 1]
        if end < 0:
            raise DataError(f"the first line is longer than {LARGEST >> 20} MB; is it a csv file?")
    if NOT_TEXT.search(text):
        raise DataError("this is not a text file, whatever its name says; export it as csv")
    return text, encoding


def _rows(content: bytes) -> int:
    """Return how many lines there are that are no comment."""
    return content.count(b"\n") - content.count(b"\n#") - content.count(b"\n%")


def _numbered(text: str) -> Iterator[tuple[int, str]]:
    """Yield the lines that are not blank, with their number from 0."""
    lines = re.split(r"\r\n|\n|\r", text)
    yield from ((i, line) for i, line in enumerate(lines) if line.strip())


def _without_preamble(lines: list[tuple[int, str]]) -> tuple[list[tuple[int, str]], int]:
    """Leave out what a vendor's logger writes above the header: lines of another shape.

    The last lines of the sample show the shape of the data. The header is the line right above
    the data, or the one above it if that holds the units.
    """
    last = [line for _, line in lines[: 20 * LOOK_AT]][-LOOK_AT // 2 :]
    separator = next((mark for mark in ";\t|" if mark in last[-1]), None) or _separator(last[-1])
    width = max(len(_fields(line, separator)) for line in last)
    shapes = [_fields(line, separator) for _, line in lines[: 4 * LOOK_AT]]
    words = [bool(f) and not NUMBER.fullmatch(f) for f in _fields(last[-1], separator)]
    rows = [_is_row(fields, width, words) for fields in shapes]
    first = next((k for k in range(len(rows) - 2) if all(rows[k : k + 3])), 0)
    if width < 2 or first < 2 or len(shapes[0]) in (width, width - 1):
        return lines, 0
    has_units = len(shapes[first - 2]) in (width, width - 1) and _are_units(shapes[first - 1])
    header = first - 2 if has_units else first - 1
    return lines[header:], header


def _is_row(fields: list[str], width: int, words: list[bool]) -> bool:
    """Whether fields are a row of data: as wide, and mostly numbers, or nothing beside a stamp.

    `words` says in which columns the data have words, as days and hours are.
    """
    if len(fields) not in (width, width - 1):
        return False
    numbers = [NUMBER.fullmatch(field) is not None for field in fields]
    bare = all(
        number or word or field.lower() in EMPTY
        for number, word, field in zip_longest(numbers, words[: len(fields)], fields)
    )
    return 2 * sum(numbers) > len(fields) or (bare and (any(numbers) or fields[0][:1].isdigit()))


def _are_units(fields: list[str]) -> bool:
    """Whether a row above the data holds units: short, and no two of them a name."""
    stated = [field.strip("[]() ") for field in fields if field.lower() not in EMPTY]
    return bool(stated) and sum(_is_unit(text) for text in stated) * 2 >= len(stated)


def _is_unit(text: str) -> bool:
    try:
        parse(text)
    except IVToolsError:
        return text in ("-", "1")
    return True


def _comments(text: str) -> list[tuple[int, str]]:
    return [(i, line) for i, line in _numbered(text) if line.strip()[0] in "#%"]


def _content(text: str) -> Iterator[tuple[int, str]]:
    return ((i, line) for i, line in _numbered(text) if line.strip()[0] not in "#%")


def _separator(header: str) -> str:
    mark = max(";\t|,", key=header.count)  # the first of those that are equally frequent
    return mark if mark in header else r"\s+" if len(header.split()) > 1 else ","


def _fields(line: str, separator: str) -> list[str]:
    if separator == r"\s+":
        return [field.strip('"') for field in line.split()]
    try:
        fields = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    except csv.Error:
        raise DataError(f"a cell is longer than {limits.LONGEST} characters; mend it") from None
    return [field.strip() for field in fields]


def _commented_header(text: str, start: int, row: list[str], separator: str) -> list[str]:
    """Return the names in the comment right above the first row, as numpy.savetxt writes them."""
    above = [line for i, line in _comments(text) if i < start]
    names = _fields(above[-1].lstrip("#% "), separator) if above else []
    if len(names) != len(row) or any(NUMBER.fullmatch(name) for name in names):
        raise DataError("the file has no header row; name the columns in its first line: t, q, ...")
    return names


def _is_unit_row(row: list[str]) -> bool:
    stated = [field for field in row if field.lower() not in EMPTY]
    return bool(stated) and not any(NUMBER.fullmatch(field) for field in row)


def _pairs(names: list[str], row: list[str]) -> list[tuple[str, str]]:
    units = [field.strip("[]() ") for field in row]
    return list(zip(names, units + [""] * len(names), strict=False))


def _surplus(names: list[str], rows: list[list[str]]) -> int:
    """Return 1 if rows end with a separator that the header has not, else 0."""
    for number, row in enumerate(rows):
        extra = row[len(names) :]
        if any(extra) or len(extra) > 1:
            raise DataError(
                f"row {number} of the data has {len(row)} fields and the header {len(names)}; "
                "put semicolons between columns if commas are decimals"
            )
    return max(max(map(len, rows)) - len(names), 0)


def _decimal(rows: list[list[str]], separator: str) -> str:
    numbers = [field for row in rows for field in row if NUMBER.fullmatch(field)]
    marked = [field for field in numbers if "," in field]
    commas = bool(marked) and separator != ","
    if commas and all(THOUSANDS.fullmatch(field) for field in marked):
        commas = not any("." in field for field in numbers)  # 12,345 beside 0.5 is no decimal
    if commas and any("." in field for field in numbers):
        raise DataError("numbers have decimal commas and points; export it with one of them")
    return "," if commas else "."
