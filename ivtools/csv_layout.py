"""The layout of a csv file as people have them: separators, decimals, comments, units."""

from __future__ import annotations

import codecs
import csv
import gzip
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ivtools.errors import DataError

__all__ = ["Layout", "sniff"]

SAMPLE = 1 << 18  # bytes read to find the layout
LOOK_AT = 50  # rows of data looked at
BOMS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
NOT_TEXT = re.compile(r"[\x00-\x08\x0b\x0e-\x1f\x7f-\x9f]")
NUMBER = re.compile(r"[+-]?(\d+[.,]?\d*|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.I)
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
    """

    names: tuple[str, ...]
    first_row: int
    separator: str
    decimal: str
    encoding: str
    comment: str | None
    notes: tuple[str, ...]


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
    if not lines:
        raise DataError("the file has no content; log or copy it again")
    (start, header), data = lines[0], lines[1:]
    separator = told[1] if told else _separator(header)
    names = _fields(header, separator)
    if all(NUMBER.fullmatch(name) for name in names):
        names, data = _commented_header(text, start, names, separator), lines
    notes = [] if separator == "," else [f"columns are separated by {SPOKEN[separator]}"]
    if not data:
        raise DataError("the file has a header and no rows; log or copy it again")
    rows = [_fields(line, separator) for _, line in data[:LOOK_AT]]
    if len(rows) > 1 and _is_unit_row(rows[0]) and not _is_unit_row(rows[1]):
        notes.append("the second row holds the units")
        names = [f"{name} [{unit}]" if unit else name for name, unit in _pairs(names, rows[0])]
        data, rows = data[1:], rows[1:]
    names += [""] * _surplus(names, rows)
    decimal = _decimal(rows, separator)
    if decimal == ",":
        notes.append("numbers have decimal commas")
    return Layout(tuple(names), data[0][0], separator, decimal, encoding, comment, tuple(notes))


def _sample(path: Path) -> tuple[str, str]:
    """Return the beginning of the file as text, and its encoding."""
    with gzip.open(path) if path.name.lower().endswith(".gz") else path.open("rb") as file:
        content = file.read(SAMPLE)
    encoding = next((name for bom, name in BOMS.items() if content.startswith(bom)), "utf-8")
    try:
        text = codecs.getincrementaldecoder(encoding)().decode(content)
    except UnicodeDecodeError:
        encoding, text = "latin-1", content.decode("latin-1")
    if NOT_TEXT.search(text):
        raise DataError("this is not a text file, whatever its name says; export it as csv")
    return text, encoding


def _numbered(text: str) -> Iterator[tuple[int, str]]:
    """Yield the complete lines of the sample that are not blank, with their number from 0."""
    lines = re.split(r"\r\n|\n|\r", text)
    complete = lines if len(text) < SAMPLE or len(lines) == 1 else lines[:-1]
    yield from ((i, line) for i, line in enumerate(complete) if line.strip())


def _comments(text: str) -> list[tuple[int, str]]:
    return [(i, line) for i, line in _numbered(text) if line.strip()[0] in "#%"]


def _content(text: str) -> Iterator[tuple[int, str]]:
    return ((i, line) for i, line in _numbered(text) if line.strip()[0] not in "#%")


def _separator(header: str) -> str:
    mark = max(";\t|,", key=header.count)  # the first of those that are equally frequent
    return mark if mark in header else r"\s+" if len(header.split()) > 1 else ","


def _fields(line: str, separator: str) -> list[str]:
    if separator == r"\s+":
        return line.split()
    fields = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
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
    commas = any("," in field for field in numbers) and separator != ","
    if commas and any("." in field for field in numbers):
        raise DataError("numbers have decimal commas and points; export it with one of them")
    return "," if commas else "."
