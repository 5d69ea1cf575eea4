"""Logs as they lie about: what loggers, spreadsheets and people do to a sound file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import vendor_logs

Table = list[list[str]]
Habit = Callable[[np.random.Generator, Table, int, str], Table]


def _comments(rng, rows: Table, head: int, decimal: str) -> Table:
    return [["# exported by hand"], ["# operator: N. N."], *rows]


def _footer(rng, rows: Table, head: int, decimal: str) -> Table:
    return [*rows, [""], ["End of trace"]]


def _holes(rng, rows: Table, head: int, decimal: str) -> Table:
    """A few cells are no numbers."""
    for k in rng.integers(head + 300, len(rows), 3):
        j = rng.integers(1, len(rows[k]))
        rows[k] = [*rows[k][:j], str(rng.choice(["", "NaN", "#N/A", "-"])), *rows[k][j + 1 :]]
    return rows


def _twice(rng, rows: Table, head: int, decimal: str) -> Table:
    """The logger writes some rows again."""
    again = set((head + rng.integers(0, len(rows) - head, len(rows) // 100)).tolist())
    return [row for k, one in enumerate(rows) for row in [one] * (1 + (k in again))]


def _dropped(rng, rows: Table, head: int, decimal: str) -> Table:
    """A buffer is lost, once or twice."""
    n = len(rows) - head
    for at in sorted(rng.integers(n // 8, n // 3, rng.integers(1, 3)).tolist(), reverse=True):
        del rows[head + at : head + at + int(rng.integers(2, 30))]
    return rows


def _head_again(rng, rows: Table, head: int, decimal: str) -> Table:
    at = len(rows) // 2
    return [*rows[:at], rows[head - 1], *rows[at:]]


def _trailing(rng, rows: Table, head: int, decimal: str) -> Table:
    return [*rows[: head - 1], *([*row, ""] for row in rows[head - 1 :])]


def _quoted(rng, rows: Table, head: int, decimal: str) -> Table:
    return [*([f'"{c}"' for c in row] for row in rows[:head]), *rows[head:]]


def _spaced(rng, rows: Table, head: int, decimal: str) -> Table:
    return [*rows[:head], *([f" {c} " for c in row] for row in rows[head:])]


def _beside(rows: Table, head: int, name: str, cell: str) -> Table:
    """Add a column; of a header of two rows the second has the units."""
    names = [name, ""][:head]
    tops = [[*row, more] for row, more in zip(rows[:head], names, strict=True)]
    return [*tops, *([*row, cell] for row in rows[head:])]


def _words(rng, rows: Table, head: int, decimal: str) -> Table:
    """A column of words."""
    return _beside(rows, head, "Mode", "AUTO")


def _empty(rng, rows: Table, head: int, decimal: str) -> Table:
    """A channel that was not recorded."""
    return _beside(rows, head, "Analog 2", "")


def _waiting(rng, rows: Table, head: int, decimal: str) -> Table:
    """The first rows have a stamp and nothing else."""
    first = [[row[0], *[""] * (len(row) - 1)] for row in rows[head : head + 12]]
    return [*rows[:head], *first, *rows[head + 12 :]]


def _coarse(rng, rows: Table, head: int, decimal: str) -> Table:
    """Six digits, as %g writes them; stamps are left alone."""

    def cell(text: str) -> str:
        try:
            return f"{float(text.replace(',', '.')):.6g}".replace(".", decimal)
        except ValueError:
            return text

    return [*rows[:head], *([row[0], *map(cell, row[1:])] for row in rows[head:])]


HABITS: dict[str, Habit] = {
    "coarse": _coarse,
    "dropped": _dropped,
    "holes": _holes,
    "twice": _twice,
    "waiting": _waiting,
    "words": _words,
    "empty": _empty,
    "head again": _head_again,
    "spaced": _spaced,
    "quoted": _quoted,
    "trailing": _trailing,
    "comments": _comments,
    "footer": _footer,
}  # in the order in which they happen
CODES = ("utf-8", "utf-8-sig", "utf-16", "cp1252")


def draw(rng: np.random.Generator, folder: Path, style: str) -> vendor_logs.Written:
    """Write a make's log, and do to it what some of these habits do; its name says which."""
    log = vendor_logs.draw(rng, folder, style)
    make = vendor_logs.MAKES[style]
    lines = log.path.read_text(encoding="utf-8").splitlines()
    numbers = len(make.head(["a"], [""]))
    above = next(k for k, line in enumerate(lines) if line.count(make.separator) >= 2)
    rows = [line.split(make.separator) for line in lines[above:]]
    chosen = set(rng.choice(list(HABITS), rng.integers(1, 5), replace=False).tolist())
    for name, habit in HABITS.items():
        if name in chosen:
            rows = habit(rng, rows, numbers, make.decimal)
    told = ", ".join(name for name in HABITS if name in chosen)
    path = folder / f"{log.path.stem}, {told}.csv"
    end = str(rng.choice(["\n", "\r\n"]))
    text = end.join([*lines[:above], *map(make.separator.join, rows)]) + end
    try:
        path.write_bytes(text.encode(str(rng.choice(CODES))))
    except UnicodeEncodeError:  # that code does not have its letters
        path.write_text(text, encoding="utf-8", newline="")
    return replace(log, path=path)
