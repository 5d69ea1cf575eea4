"""Which column of a table is which signal: names, foreign names, joints and units."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ivtools.errors import RecordError, ShapeError

__all__ = ["SIGNALS", "column_name", "match_columns", "pick_further", "pick_signals"]

#: Signals of a record and what they mean, in the order of the columns of a file.
SIGNALS = {
    "q": "measured position, m or rad",
    "q_ref": "position reference, as q",
    "nu": "command as sent to the drive, added inputs included, V (or A, N, N m)",
    "tau": "force or torque, N or N m",
    "added": "known input added to the command after the controller, as nu",
    "dq": "measured velocity as the controller saw it, m/s or rad/s",
    "dq_ref": "velocity reference, m/s or rad/s",
}
#: Units that a header may state; a command may have any.
UNITS = {
    "t": ("s",),
    "q": ("m", "rad"),
    "q_ref": ("m", "rad"),
    "tau": ("N", "Nm", "N m", "N*m", "N.m"),
    "dq": ("m/s", "rad/s"),
    "dq_ref": ("m/s", "rad/s"),
}
_OURS = re.compile(rf"(t|({'|'.join(SIGNALS)})(\d*))")
_HEADER = re.compile(r"(.*?)\s*[\[(]([^\[\]()]*)[\])]")


def column_name(signal: str, joint: int, n_joints: int) -> str:
    """Return the name of a joint's column: q for one joint, else q1, q2, ...

    Examples
    --------
    >>> column_name("q", 0, 1), column_name("q", 0, 6)
    ('q', 'q1')
    """
    return signal if n_joints == 1 else f"{signal}{joint + 1}"


def match_columns(
    names: Iterable[str], columns: Mapping[str, str] | None = None
) -> dict[str, list[str]]:
    """Find the signals of a record among the names of a table.

    Parameters
    ----------
    names : iterable of str
        Column names, possibly with a unit: ``q``, ``q [m]``, ``q1 (rad)``.
    columns : mapping of str to str, optional
        Foreign names, ours = theirs.

    Returns
    -------
    dict of str to list of str
        Per signal the names of its columns, joint by joint. Other columns are left out.

    Raises
    ------
    RecordError
        A column is missing, appears twice or states another unit than ours.

    Examples
    --------
    >>> match_columns(["t [s]", "pos", "nu", "room temperature"], {"q": "pos"})
    {'q': ['pos'], 't': ['t [s]'], 'nu': ['nu']}
    """
    names = [str(name) for name in names]
    mapping = dict(columns or {})
    for ours in mapping:
        if not _OURS.fullmatch(ours):
            raise RecordError(f"columns maps {ours!r}; known are t, {', '.join(SIGNALS)}")
    found = {ours: _find(ours, str(theirs), names) for ours, theirs in mapping.items()}
    mapped, claimed = {_signal(ours) for ours in mapping}, set(found.values())
    for name in names:
        ours = _plain(name)[0]
        if not _OURS.fullmatch(ours) or _signal(ours) in mapped or name in claimed:
            continue
        if ours in found:
            raise RecordError(f"column {ours} appears twice; rename one of them")
        found[ours] = name
    for needed in ("t", "q"):
        if needed not in map(_signal, found):
            raise RecordError(
                f"column {needed} is missing; there are {_listed(names)}; "
                f"say which one it is: columns {needed} = 'name'"
            )
    for ours, name in found.items():
        _check_unit(_signal(ours), name)
    return {signal: _by_joint(signal, found) for signal in dict.fromkeys(map(_signal, found))}


def pick_signals(
    table: Mapping[str, Any], columns: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Return the signals of a table, several joints side by side, by our names."""
    table = {str(name): values for name, values in table.items()}
    return {signal: _stack(table, names) for signal, names in match_columns(table, columns).items()}


def pick_further(
    table: Mapping[str, Any], columns: Mapping[str, str] | None, n_samples: int
) -> dict[str, Any]:
    """Return the columns that are no signal of a record, by their names without the unit.

    A control law may have seen them. What is not a finite number in every row is left out.

    Examples
    --------
    >>> sorted(pick_further({"t": [0, 1], "q": [0, 1], "strain [V]": [2, 3]}, None, 2))
    ['strain']
    """
    table = {str(name): values for name, values in table.items()}
    signals = match_columns(table, columns)
    taken = {name for names in signals.values() for name in names}
    found: dict[str, Any] = {}
    for name in table.keys() - taken:
        plain, values = _plain(name)[0], np.asarray(table[name])
        usable = values.shape == (n_samples,) and values.dtype.kind in "biuf"
        if usable and plain and plain not in signals and np.isfinite(values).all():
            found[plain] = values.astype(float)
    return dict(sorted(found.items()))


def _stack(table: Mapping[str, Any], names: list[str]) -> Any:
    if len(names) == 1:
        return table[names[0]]
    sizes = {name: np.shape(table[name]) for name in names}
    for name, size in sizes.items():
        if len(size) != 1 or size != sizes[names[0]]:
            raise ShapeError(
                f"{name} has shape {size} and {names[0]} {sizes[names[0]]}; "
                "the columns of all joints must be one-dimensional and of one length"
            )
    return np.column_stack([table[name] for name in names])


def _signal(ours: str) -> str:
    return ours.rstrip("0123456789")


def _plain(name: str) -> tuple[str, str]:
    """Split ``q [m]`` into ``q`` and ``m``; the unit may be empty."""
    header = _HEADER.fullmatch(name.strip())
    return (header[1], header[2].strip()) if header else (name.strip(), "")


def _find(ours: str, theirs: str, names: list[str]) -> str:
    for name in names:
        if theirs in (name, name.strip(), _plain(name)[0]):
            return name
    raise RecordError(
        f"column {theirs!r}, mapped to {ours}, is missing; there are {_listed(names)}"
    )


def _check_unit(signal: str, name: str) -> None:
    unit = _plain(name)[1]
    known = UNITS.get(signal, ())
    if unit and known and unit.lower() not in map(str.lower, known):
        raise RecordError(
            f"column {name!r} is in {unit}; convert {signal} to {' or '.join(known[:2])} "
            "and say so in the header"
        )


def _by_joint(signal: str, found: Mapping[str, str]) -> list[str]:
    ours = {name: theirs for name, theirs in found.items() if _signal(name) == signal}
    if set(ours) == {signal}:
        return [ours[signal]]
    wanted = [f"{signal}{joint}" for joint in range(1, len(ours) + 1)]
    if set(wanted) != set(ours):
        raise RecordError(
            f"columns {', '.join(ours)} do not number the joints; use {signal} for one joint or "
            f"{', '.join(wanted)}"
        )
    return [ours[name] for name in wanted]


def _listed(names: list[str]) -> str:
    shown = ", ".join(name.strip() for name in names[:12])
    return f"{shown}{', ...' if len(names) > 12 else ''}" if names else "none"
