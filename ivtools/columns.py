"""Which column of a table is which signal: names, foreign names, joints and units."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ivtools.errors import IVToolsError, RecordError, ShapeError, shown
from ivtools.units import parse

__all__ = [
    "SIGNALS",
    "UNITS",
    "column_name",
    "match_columns",
    "pick_further",
    "plain_name",
    "stack",
]

#: Signals of a record and what they mean, in the order of the columns of a file.
SIGNALS = {
    "q": "measured position, m or rad",
    "q_ref": "position reference, as q",
    "nu": "command as sent to the drive, added inputs included, V (or A, N, N m)",
    "tau": "force or torque, N or N m",
    "added": "known input added to the command after the controller, as nu",
    "dq": "measured velocity as the controller saw it, m/s or rad/s",
    "dq_ref": "velocity reference, m/s or rad/s",
    "load": "known outside force that the drive has to overcome, N or N m",
}
#: SI units of a signal; a command may have any.
UNITS = {
    "t": ("s",),
    "q": ("m", "rad"),
    "q_ref": ("m", "rad"),
    "dq": ("m/s", "rad/s"),
    "dq_ref": ("m/s", "rad/s"),
    "tau": ("N", "N m"),
    "load": ("N", "N m"),
}
_OURS = re.compile(rf"(t|({'|'.join(SIGNALS)})(\d{{0,9}}))")


def column_name(signal: str, joint: int, n_joints: int) -> str:
    """Return the name of a joint's column: q for one joint, else q1, q2, ...

    Examples
    --------
    >>> column_name("q", 0, 1), column_name("q", 0, 6)
    ('q', 'q1')
    """
    return signal if n_joints == 1 else f"{signal}{joint + 1}"


def match_columns(
    names: Iterable[str],
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    timed: bool = True,
) -> dict[str, list[str]]:
    """Find the signals of a record among the names of a table.

    Parameters
    ----------
    names : iterable of str
        Column names, possibly with a unit: ``q``, ``q [m]``, ``q1 (rad)``.
    columns : mapping of str to str, optional
        Foreign names, ours = theirs.
    units : mapping of str to str, optional
        Units that were stated: of these signals the header may say what it likes.
    timed : bool
        Whether a time is needed.

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
        ours = plain_name(name)[0]
        if not _OURS.fullmatch(ours) or _signal(ours) in mapped or name in claimed:
            continue
        if ours in found:
            raise RecordError(f"column {ours} appears twice; rename one of them")
        found[ours] = name
    for needed in ("t", "q") if timed else ("q",):
        if needed not in map(_signal, found):
            without = ", or [record] rate = 1000 without it" if needed == "t" else ""
            raise RecordError(
                f"column {needed} is missing; there are {_listed(names)}; write which one it is in "
                f'the axis file: [record] columns = {{ {needed} = "name" }}{without}'
            )
    for ours, name in found.items():
        if not {ours, _signal(ours)} & set(units or ()):
            _check_unit(_signal(ours), name)
    return {signal: _by_joint(signal, found) for signal in dict.fromkeys(map(_signal, found))}


def pick_further(
    table: Mapping[str, Any], signals: Mapping[str, list[str]], n_samples: int
) -> dict[str, Any]:
    """Return the columns that are no signal of a record, by their names without the unit.

    A control law may have seen them. What is not a finite number in every row is left out.

    Examples
    --------
    >>> sorted(pick_further({"t": [0, 1], "strain [V]": [2, 3]}, {"t": ["t"]}, 2))
    ['strain']
    """
    taken = {name for names in signals.values() for name in names}
    found: dict[str, Any] = {}
    for name in table.keys() - taken:
        plain, values = plain_name(name)[0], np.asarray(table[name])
        usable = values.shape == (n_samples,) and values.dtype.kind in "biuf"
        if usable and plain and plain not in signals and np.isfinite(values).all():
            found[plain] = values.astype(float)
    return dict(sorted(found.items()))


def stack(table: Mapping[str, Any], names: list[str]) -> Any:
    """Return the columns of all joints side by side, or the only one as it is."""
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


def plain_name(name: str) -> tuple[str, str]:
    """Split ``q [m]`` or ``q (m)`` into ``q`` and ``m``; the unit may be empty."""
    plain = name.strip()
    opening = max(plain.rfind("["), plain.rfind("("))
    if opening < 0 or plain[-1] not in ")]" or plain[opening + 1 : -1].strip().isdigit():
        return plain, ""  # DV[3] is the third of several
    return plain[:opening].strip(), plain[opening + 1 : -1].strip()


def _find(ours: str, theirs: str, names: list[str]) -> str:
    for name in names:
        if theirs in (name, name.strip(), plain_name(name)[0]):
            return name
    raise RecordError(
        f"column {theirs!r}, mapped to {ours}, is missing; there are {_listed(names)}; mend "
        f'[record] columns = {{ {ours} = "name" }}'
    )


def _check_unit(signal: str, name: str) -> None:
    unit = plain_name(name)[1]
    known = UNITS.get(signal, ())
    if not unit or not known:
        return
    try:
        found = parse(unit)
        if found.factor == 1.0 and found.si in known:
            return
    except IVToolsError:
        pass
    raise RecordError(
        f"column {shown(name)!r} is in {shown(unit)}; convert {signal} to {' or '.join(known)} and "
        f'say so in the header, or write [record] units = {{ {signal} = "{shown(unit)}" }} in the '
        "axis file"
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
    some = ", ".join(shown(name.strip()) for name in names[:12])
    return f"{some}{', ...' if len(names) > 12 else ''}" if names else "none"
