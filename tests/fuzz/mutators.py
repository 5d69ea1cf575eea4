"""Seeded damage: to bytes, to the tables of a file, to the signals of a record."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

Generator = np.random.Generator
STRANGE: tuple[Any, ...] = (
    0, -1, 1, 2.5, -1e-300, 1e300, 10**400, 10**12, float("nan"), float("inf"), True, False,
    "", "a", "none", "0", "nan", "=1+1", "ä" * 300, "\x00", "../../etc/passwd", [], [[]], {},
    [1, "a"], [0.0] * 2000, {"a": {"b": 1}}, [float("nan")], ["inertia", "inertia"], "~nouser/x",
)  # fmt: skip


def strange(rng: Generator) -> Any:
    """Return a value that few places expect."""
    return copy.deepcopy(STRANGE[rng.integers(len(STRANGE))])


def places(tables: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the way to every value in nested tables and lists."""
    inner = tables.items() if isinstance(tables, dict) else enumerate(tables)
    found = []
    for key, value in inner:
        found.append((*path, key))
        if isinstance(value, dict | list):
            found += places(value, (*path, key))
    return found


def damaged_tables(tables: dict[str, Any], rng: Generator) -> dict[str, Any]:
    """Change, remove, add or move one to three values."""
    tables = copy.deepcopy(tables)
    for _ in range(rng.integers(1, 4)):
        ways = places(tables)
        if not ways:
            break
        *path, last = ways[rng.integers(len(ways))]
        at: Any = tables
        for key in path:
            at = at[key]
        choice = rng.integers(5)
        if choice == 0:
            del at[last]
        elif choice == 1 and isinstance(at, dict):
            at[str(rng.choice(["extra", "", "kind", "q ü", last]))] = strange(rng)
        elif choice == 2 and type(at[last]) in (int, float) and abs(at[last]) < 1e300:
            at[last] = at[last] * float(rng.choice([0.0, -1.0, 1e-12, 1e12, 1e150, 1e308]))
        else:
            at[last] = strange(rng)
    return tables


def toml(tables: dict[str, Any]) -> str:
    """Return tables as TOML, inline below the first level."""
    return "\n".join(f"{_key(key)} = {_value(value)}" for key, value in tables.items()) + "\n"


def _key(key: str) -> str:
    return '"' + str(key).replace("\\", "\\\\").replace('"', '\\"').replace("\x00", "\\u0000") + '"'


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, int | float) else _key(value)


def damaged_bytes(data: bytes, rng: Generator) -> bytes:
    """Flip, cut, repeat, overwrite or insert somewhere, one to four times."""
    out = bytearray(data)
    for _ in range(rng.integers(1, 5)):
        at, choice = int(rng.integers(len(out) + 1)), rng.integers(7)
        length = int(rng.integers(1, 400))
        if choice == 0 and out:
            out[min(at, len(out) - 1)] ^= 1 << int(rng.integers(8))
        elif choice == 1:
            del out[at:]
        elif choice == 2:
            del out[at : at + length]
        elif choice == 3:
            out[at:at] = out[at : at + length] * int(rng.integers(1, 50))
        elif choice == 4:
            out[at : at + length] = rng.bytes(length)
        elif choice == 5:
            out[at:at] = _SCRAPS[rng.integers(len(_SCRAPS))] * int(rng.integers(1, 1000))
        else:
            out[at : at + length] = _SCRAPS[rng.integers(len(_SCRAPS))]
    return bytes(out)


_SCRAPS = (
    b" ", b",", b";", b"\n", b"\r", b"\t", b'"', b"0", b"9", b"-", b"e", b"nan", b"inf", b"1e308",
    b"\x00", b"\xff", b"\xef\xbb\xbf", "°".encode(), b"[", b"{", b".", b"=", b"#", b"1,5", b"q_ref",
)  # fmt: skip


def damaged_signals(columns: dict[str, Any], rng: Generator) -> dict[str, Any]:
    """Make a record pathological but readable: absurd cells, dead or huge or copied signals."""
    columns = {name: np.array(x, dtype=float) for name, x in columns.items()}
    for _ in range(rng.integers(1, 3)):
        name = str(rng.choice([c for c in columns if c != "t"]))
        x = columns[name]
        n, at = len(x), int(rng.integers(len(x)))
        choice = rng.integers(12)
        if choice == 0:
            x[at] = float(rng.choice([1e30, 1e100, 1e154, -1e200, 1e308, 1e-308]))
        elif choice == 1:
            x *= float(rng.choice([0.0, 1e-12, 1e-300, 1e6, 1e12, 1e100, 1e150, -1.0]))
        elif choice == 2:
            x += float(rng.choice([1e3, 1e9, 1e15, -1e100]))
        elif choice == 3:
            x[:] = x[0]
        elif choice == 4:
            x[at:] = x[at]
        elif choice == 5:
            x[:] = rng.normal(size=n)
        elif choice == 6:
            x[:] = columns[str(rng.choice(list(columns)))]
        elif choice == 7:
            x[:] = np.round(x / np.ptp(x) * 3) if np.ptp(x) else x
        elif choice == 8:
            x[:] = np.linspace(0.0, 1.0, n)
        elif choice == 9:
            x[:] = np.sign(x - np.mean(x))
        elif choice == 10:
            columns["t"] = columns["t"] * float(rng.choice([1e-9, 1e-3, 1e3, 1e9]))
        else:
            length = int(rng.integers(200, n + 1)) if n > 200 else n
            columns = {c: v[:length] for c, v in columns.items()}
    return columns
