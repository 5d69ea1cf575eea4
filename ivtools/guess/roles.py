"""Which column is which signal: by what the names say, and where they are silent by the shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from .words import Said, read

Array = NDArray[np.float64]

_LOOK_AT = 100_000  # samples
_ALIKE = 0.95  # correlation of a position with its reference
_ROUGHER = 1.3  # ratio of the second differences of a measured position to those of its reference
_MOVED = 0.05  # of a command's power that the motion explains, at least
_DERIVED = 0.7  # correlation of a velocity with the differences of a position


@dataclass
class Roles:
    """The columns of the signals.

    Attributes
    ----------
    columns : dict of str to str
        Ours = theirs.
    said : dict of str to Said
        What each column's name says.
    why : dict of str to str
        How each was found: ``"name"``, ``"name and shape"``, ``"shape"``.
    doubts : list of str
    led : list of (str, str)
        Signals of which only the shape says which is the reference: that, and the other.
    """

    columns: dict[str, str] = field(default_factory=dict)
    said: dict[str, Said] = field(default_factory=dict)
    why: dict[str, str] = field(default_factory=dict)
    doubts: list[str] = field(default_factory=list)
    led: list[tuple[str, str]] = field(default_factory=list)

    def swapped(self, pairs: Sequence[tuple[str, str]]) -> Roles:
        """Return the roles with reference and measured signal exchanged in some pairs."""
        columns, doubts = dict(self.columns), list(self.doubts)
        for reference, own in pairs:
            one, two = columns[own], columns[reference]
            columns[reference], columns[own] = one, two
            doubts = [d for d in doubts if d != _leads(two, one)]
            doubts.append(f"{one!r} is taken for the reference of {two!r}: a law fits them so")
        return replace(self, columns=columns, doubts=doubts)

    def take(self, signal: str, column: str | None, why: str) -> None:
        """Give a column to a signal that has none."""
        if column is not None and signal not in self.columns:
            self.columns[signal], self.why[signal] = column, why

    def free(self, names: Sequence[str]) -> list[str]:
        """Return the columns that may still be a signal."""
        taken = set(self.columns.values())
        return [n for n in names if n not in taken and self.said[n].quantity != "other"]


def assign(table: Mapping[str, Array]) -> Roles:
    """Find the signals among the columns of a log, (n,) each."""
    varying = {n: x[:_LOOK_AT] for n, x in table.items() if x.ndim == 1 and _varies(x)}
    roles = Roles(said={name: read(name) for name in varying})
    roles.take("t", _time(varying, roles.said), "name and shape")
    _by_name(roles, varying)
    _by_shape(roles, varying)
    _command(roles, varying)
    return roles


def _varies(x: Array) -> bool:
    return bool(np.isfinite(x).all()) and len(x) > 20 and bool(np.ptp(x) > 0)


def _time(table: Mapping[str, Array], said: Mapping[str, Said]) -> str | None:
    """Return the column of the time: named so, else one that rises evenly."""
    rising = [n for n, x in table.items() if np.diff(x).min() >= 0 and _even(x)]
    named = [n for n in rising if said[n].quantity == "time"]
    plain = [n for n in rising if said[n].quantity in ("", "time")]
    stated = [n for n in named if said[n].unit]  # rather than a counter beside it
    finer = sorted(named, key=lambda n: -len(np.unique(np.diff(table[n]))))
    return next(iter([*stated, *finer, *plain]), None)


def _even(x: Array) -> bool:
    """Whether a column rises like a clock: on average, not at every step."""
    line = np.linspace(x[0], x[-1], len(x))
    return float(np.abs(x - line).max()) < 0.05 * float(np.ptp(x))


def _by_name(roles: Roles, table: Mapping[str, Array]) -> None:
    """Take the positions and velocities that the names tell."""
    for quantity, own, reference in (("position", "q", "q_ref"), ("velocity", "dq", "dq_ref")):
        named = [n for n in roles.free(list(table)) if roles.said[n].quantity == quantity]
        wanted = [n for n in named if roles.said[n].side == "reference"]
        actual = [n for n in named if roles.said[n].side == "actual"]
        open_ = [n for n in named if not roles.said[n].side]
        if not actual and not wanted and len(open_) == 2 and _alike(table, *open_):
            first, second = _leader(table, *open_)
            _led(roles, (reference, own), (first, second), "name and shape")
            continue
        roles.take(own, next(iter([*actual, *open_]), None), "name")
        roles.take(reference, next(iter(wanted), None), "name")
        spare = [n for n in (*actual, *open_) if n != roles.columns.get(own)]
        if spare:
            roles.doubts.append(
                f"{own} could also be {', '.join(map(repr, spare[:3]))}; the first is taken"
            )


def _led(roles: Roles, signals: tuple[str, str], columns: tuple[str, str], why: str) -> None:
    """Take a reference and what follows it."""
    for signal, column in zip(signals, columns, strict=True):
        roles.take(signal, column, why)
    roles.led.append(signals)
    roles.doubts.append(_leads(*columns))


def _leads(first: str, second: str) -> str:
    return f"{first!r} leads {second!r}, so it is taken for the reference"


def _by_shape(roles: Roles, table: Mapping[str, Array]) -> None:
    """Take position, reference and velocity by how they move, where no name has told."""
    silent = [n for n in roles.free(list(table)) if not roles.said[n].quantity]
    if "q" not in roles.columns:
        pairs = [(a, b) for a in silent for b in silent if a < b and _alike(table, a, b)]
        if "q_ref" in roles.columns:
            reference = roles.columns["q_ref"]
            roles.take("q", next((n for n in silent if _alike(table, n, reference)), None), "shape")
        elif pairs:
            first, second = _leader(table, *max(pairs, key=lambda p: _smooth(table, p)))
            _led(roles, ("q_ref", "q"), (first, second), "shape")
    if "q" not in roles.columns:
        return
    q = table[roles.columns["q"]]
    silent = [n for n in roles.free(list(table)) if not roles.said[n].quantity]
    if "q_ref" not in roles.columns:
        akin = [n for n in silent if _alike(table, n, roles.columns["q"])]
        roles.take("q_ref", next(iter(akin), None), "shape")
    for signal, of in (("dq", q), ("dq_ref", table.get(roles.columns.get("q_ref", ""), q))):
        silent = [n for n in roles.free(list(table)) if not roles.said[n].quantity]
        scores = {n: abs(_correlation(_slope(of), table[n])) for n in silent}
        best = max(scores, key=lambda n: scores[n], default=None)
        if best is not None and scores[best] > _DERIVED:
            roles.take(signal, best, "shape")


def _command(roles: Roles, table: Mapping[str, Array]) -> None:
    """Take the command: what is called so, a wanted force or current, else the current or force."""
    free = roles.free(list(table))

    def of(quantity: str, side: str | None = None) -> list[str]:
        found = [n for n in free if roles.said[n].quantity == quantity]
        return found if side is None else [n for n in found if roles.said[n].side == side]

    force, current, voltage = (of(q) for q in ("force", "current", "voltage"))
    wanted = [*of("force", "reference"), *of("current", "reference"), *of("voltage", "reference")]
    candidates = [*of("command"), *wanted, *voltage, *current, *force]
    if not candidates:
        silent = [n for n in free if not roles.said[n].quantity]
        if "q_ref" in roles.columns and "q" in roles.columns:
            error = table[roles.columns["q_ref"]] - table[roles.columns["q"]]
            silent.sort(key=lambda n: -abs(_correlation(error, table[n])))
        candidates = silent[:1]
        roles.take("nu", next(iter(candidates), None), "shape")
        return
    candidates.sort(key=lambda n: not _moves(roles, table, n))  # a supply is no command
    roles.take("nu", candidates[0], "name")
    others = [n for n in dict.fromkeys(candidates[1:]) if n != candidates[0]]
    if others:
        roles.doubts.append(
            f"nu could also be {', '.join(map(repr, others[:3]))}; {candidates[0]!r} is taken"
        )


def _moves(roles: Roles, table: Mapping[str, Array], name: str) -> bool:
    """Whether a column has to do with the motion: with position, velocity or acceleration."""
    if "q" not in roles.columns:
        return True
    q = table[roles.columns["q"]]
    dq = _slope(q)
    columns = [q, dq, np.sign(dq), _slope(dq)]
    columns += [table[roles.columns[s]] for s in ("q_ref", "dq", "dq_ref") if s in roles.columns]
    X = np.column_stack([(c - c.mean()) / (np.std(c) or 1.0) for c in columns])
    y = table[name] - table[name].mean()
    left = y - X @ np.linalg.lstsq(X, y, rcond=None)[0]
    return float(left @ left) < (1.0 - _MOVED) * float(y @ y)


def _alike(table: Mapping[str, Array], one: str, two: str) -> bool:
    a, b = table[one], table[two]
    ratio = float(np.std(a)) / max(float(np.std(b)), 1e-300)
    return 0.5 < ratio < 2.0 and _correlation(a, b) > _ALIKE


def _leader(table: Mapping[str, Array], one: str, two: str) -> tuple[str, str]:
    """Return the column that leads, then the one that follows."""
    a, b = (table[n] - table[n].mean() for n in (one, two))
    rougher = _roughness(a) / max(_roughness(b), 1e-300)
    if not 1.0 / _ROUGHER < rougher < _ROUGHER:  # a reference has no noise
        return (one, two) if rougher < 1.0 else (two, one)
    ahead = float(np.gradient(a) @ (a - b))
    return (one, two) if ahead > 0 else (two, one)


def _smooth(table: Mapping[str, Array], pair: tuple[str, str]) -> float:
    return -min(_roughness(table[n]) for n in pair)


def _roughness(x: Array) -> float:
    """Return the share of the second differences in a signal."""
    return float(np.std(np.diff(x, 2)) / np.std(x))


def _slope(x: Array) -> Array:
    """Return the smoothed differences of a position, as a velocity goes."""
    width = max(len(x) // 2000, 1)
    smooth = np.convolve(x, np.ones(width) / width, "same")
    return np.gradient(smooth)


def _correlation(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    scale = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / scale if scale > 0 else 0.0
