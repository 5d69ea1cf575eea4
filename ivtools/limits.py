"""Limits on what comes from a file, so that a damaged or hostile one ends in a line, and soon."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from ivtools.errors import DataError

__all__ = [
    "LONGEST",
    "MOST_COLUMNS",
    "check_content",
    "check_nesting",
    "check_size",
    "most_numbers",
]

LONGEST = 10_000  # characters of a name or cell
MOST_COLUMNS = 10_000
DEEPEST = 50  # tables in tables, lists in lists
MOST_VALUES = 1000  # of a list in an axis file, such as the taps of a filter
LARGEST_MATRIX = 50  # rows and columns
LARGEST_TEXT = 4_000_000  # bytes of a TOML or JSON file
MOST_NUMBERS = 100_000_000
LARGEST = 1e30  # of a signal or parameter, in SI; the square of what is larger is no number
VARIABLE = "IVTOOLS_MAX_SAMPLES"


def most_numbers() -> int:
    """Return how many numbers a record may hold: 10^8, or what fits a quarter of the memory.

    ``IVTOOLS_MAX_SAMPLES`` sets another number.
    """
    told = os.environ.get(VARIABLE, "")
    with suppress(ValueError, OverflowError):
        return max(int(float(told)), 1)
    return min(MOST_NUMBERS, _memory() // 4 // 8)


def _memory() -> int:
    """Return the memory of this machine, or of the container around this process, bytes."""
    sizes = [1 << 34]
    with suppress(ValueError, OSError, AttributeError):
        sizes = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    for file in ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"):
        with suppress(ValueError, OSError):
            sizes.append(int(Path(file).read_text()))
    return min(sizes)


def check_size(numbers: int) -> None:
    """Refuse a file with more numbers than a record may hold.

    Raises
    ------
    DataError
    """
    if numbers > most_numbers():
        raise DataError(
            f"the file unpacks to more than {most_numbers():.3g} numbers; keep a part of it, or "
            f"set {VARIABLE} to a larger number"
        )


def check_columns(names: Sequence[str]) -> None:
    """Refuse too many columns, and names that are too long.

    Raises
    ------
    DataError
    """
    if len(names) > MOST_COLUMNS:
        raise DataError(
            f"the file has {len(names)} columns, more than {MOST_COLUMNS}; export those that matter"
        )
    if any(len(name) > LONGEST for name in names):
        raise DataError(
            f"a column name is longer than {LONGEST} characters; is the first line the header?"
        )


def check_nesting(text: str) -> None:
    """Refuse a TOML or JSON text whose brackets or dotted keys nest too deep for its parser.

    Raises
    ------
    DataError

    Examples
    --------
    >>> check_nesting("a" + ".a" * 100 + " = 1")
    Traceback (most recent call last):
    ivtools.errors.DataError: the text nests deeper than 50 levels; write it flatter
    """
    depth = dots = 0
    quote = ""
    for character in text:
        if quote:
            quote = "" if character in (quote, "\n") else quote
            continue
        if character in "\"'":
            quote = character
        elif character in "[{":
            depth += 1
        elif character in "]}":
            depth = max(depth - 1, 0)
        dots = 0 if character in "\n=,:" else dots + (character == ".")
        if max(depth, dots) > DEEPEST:
            raise DataError(f"the text nests deeper than {DEEPEST} levels; write it flatter")


def read_text(path: Path) -> str:
    """Return the text of a TOML or JSON file that its parser can take.

    Raises
    ------
    OSError, UnicodeDecodeError
        It cannot be read, or is no UTF-8.
    DataError
        It is too large, or nests too deep.
    """
    with path.open("rb") as file:
        content = file.read(LARGEST_TEXT + 1)
    if len(content) > LARGEST_TEXT:
        raise DataError(f"the file is larger than {LARGEST_TEXT // 1_000_000} MB; name another one")
    text = content.decode("utf-8")
    check_nesting(text)
    return text


def check_content(name: str, value: Any) -> None:
    """Refuse lists, matrices and texts in an axis file that are too large.

    Raises
    ------
    DataError

    Examples
    --------
    >>> check_content("velocity_filter", [0.0] * 2000)
    Traceback (most recent call last):
    ivtools.errors.DataError: velocity_filter has 2000 values; at most 1000 are taken
    """
    if isinstance(value, str) and len(value) > LONGEST:
        raise DataError(f"{name} is longer than {LONGEST} characters")
    if isinstance(value, Mapping):
        for key, inner in value.items():
            check_content(str(key)[:40], inner)
    elif isinstance(value, list):
        matrix = any(isinstance(row, list) for row in value)
        most = LARGEST_MATRIX if matrix else MOST_VALUES
        longest = max([len(value), *(len(row) for row in value if isinstance(row, list))])
        if longest > most:
            what = f"rows or columns; at most {most}" if matrix else f"values; at most {most}"
            raise DataError(f"{name} has {longest} {what} are taken")
        for inner in value:
            check_content(name, inner)
