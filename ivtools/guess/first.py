"""The first axis file of a log: what was found, how sure it is, and what the user has to add."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..columns import UNITS, plain_name
from ..display import Displayed
from ..errors import DataError, IVToolsError, IVToolsWarning, RecordError
from ..loop import ClosedLoop
from ..loop.controllers import Controller
from ..loop.identification import ControllerFit
from ..loop.rough_inertia import shown_inertia
from ..physics import find
from ..readers import preamble, read_table
from ..record import Record
from ..record_format import RecordFormat
from ..tables import Text, table
from ..units import JOINTS, parse, quantity
from .roles import Roles, assign
from .scales import Scales, measure, tidied

Array = NDArray[np.float64]

_TERMS = ("inertia", "viscous", "coulomb", "offset")
_SURE = 0.9999  # R2 of a law that leaves no doubt which column is the reference
_GRAVITY = ("gravity",)
_HANGS = 0.7  # of the force's error, that gravity leaves at most where it is taken for a term
_AGAINST = "the inertia comes out negative: has the command the sign of the motion?"
_NOTHING = (
    "the inertia comes out negative: the motion tells too little of it, or the force is another"
)
_OPPOSITE = "the command has the opposite sign of the motion: [drive] gain is negative"
_GOOD = 0.98  # R2 of a law that is taken for the controller's
_MEANS = {
    "t": "time", "q": "position", "q_ref": "position reference", "dq": "velocity",
    "dq_ref": "velocity reference", "nu": "command", "tau": "force", "added": "added input",
    "load": "outside force",
}  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class FirstAxis(Displayed):
    """What a log says about its axis.

    Attributes
    ----------
    path : Path
    record : Record
    loop : ClosedLoop
        With the law that was fitted, if one was.
    roles : Roles
    scales : Scales
    fit : ControllerFit or None
    params : dict of str to float
        Rough estimates; empty if there are none.
    doubts : tuple of str
        What to check or to add.
    """

    figure: ClassVar[str] = "record.in_units"

    path: Path
    record: Record
    loop: ClosedLoop
    roles: Roles
    scales: Scales
    fit: ControllerFit | None
    params: Mapping[str, float]
    doubts: tuple[str, ...]

    @property
    def r2(self) -> float:
        """Share of the command's power that the law explains; 0 without a law."""
        return 0.0 if self.fit is None else self.fit.r2

    @property
    def pushes(self) -> bool:
        """Whether a law and an inertia were found that are of the sign of the command."""
        return self.fit is not None and self.params.get("inertia", -1.0) > 0.0

    def summary(self) -> Text:
        """Return what was found and how sure it is."""
        rows = []
        for signal, column in self.roles.columns.items():
            unit = self.scales.units.get(signal, "")
            sure = f"{self.roles.why[signal]}; unit {self.scales.sure.get(signal, 'none')}"
            rows.append([_MEANS[signal], repr(column), unit, sure])
        record = self.record
        head = [
            f"{record.n_samples} samples at {record.sampling_hz:g} Hz, "
            f"{quantity(record.n_samples * record.dt, 's', 3)}; {self.loop.joint} joint "
            f"({self.scales.sure['joint']})",
            self._law(),
        ]
        if self.params:
            units = self.loop.units
            told = ", ".join(f"{k} {v:.3g} {units[k]}" for k, v in self.params.items())
            head.append(f"roughly: {told}")
        head = [line for text in head for line in _wrapped(text)]
        notes = [*record.notes, *(f"CHECK: {doubt}" for doubt in self.doubts)]
        header = ["signal", "column", "unit", "how it was found"]
        return table(f"First look at {self.path.name}", head, header, rows, notes, left=4)

    def _law(self) -> str:
        if self.fit is None:
            return "law: none was found"
        law = self.fit.controller
        velocity = ["velocity as logged"] if law.velocity == "logged" else []
        return f"law: {', '.join([law.kind, *law.words, *velocity])} (R2 {self.fit.r2:.4f})"

    def to_toml(self) -> str:
        """Return the axis file, with comments."""
        head = [
            f"# First axis file of {self.path.name}, guessed by `ivtools axis new`.",
            "# Every table and key: docs/axis-file.md. Check the lines marked CHECK.",
            *(f"# CHECK: {doubt}" for doubt in self.doubts),
        ]
        loop = replace(self.loop, notes=())
        lines = [_commented(line, loop) for line in loop.to_toml().splitlines()]
        return "\n".join([*head, "", *lines]) + "\n"

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON of `ivtools axis new`."""
        return {
            "columns": dict(self.roles.columns),
            "units": dict(self.scales.units),
            "joint": self.loop.joint,
            "rate": self.record.sampling_hz,
            "controller": None if self.fit is None else self.fit.controller.kind,
            "r2": None if self.fit is None else self.fit.r2,
            "params": dict(self.params),
            "sure": dict(self.scales.sure),
            "check": list(self.doubts),
        }


def first_axis(
    path: str | Path,
    said: RecordFormat | None = None,
    joint: str = "prismatic",
    gain: float | None = None,
) -> FirstAxis:
    """Look at a log for the first time.

    Parameters
    ----------
    path : str or Path
        A file as `Record.read` takes it, of any column names and units.
    said : RecordFormat, optional
        What somebody who knows the log says about it; then nothing of that is guessed.
    joint, gain
        With `said`: the kind of joint, and N or N m per unit of the command, if that is known.

    Raises
    ------
    DataError
        The file cannot be read.
    RecordError
        It has no position or no command that could be found.
    """
    path = Path(path)
    try:
        columns, _ = read_table(path, None)
        columns, turns, broken = tidied(columns)
        roles = assign(columns)
        if said is None:
            scales = measure(columns, roles, preamble(path), turns)
            scales.rows = "usable" if broken or _repeats(columns, roles) else "refuse"
        else:
            roles, scales = _stated(said, roles, joint, gain)
        _needed(roles, list(columns))
        del columns  # of a long log as large as the record
    except IVToolsError as error:
        raise type(error)(f"{path}: {error}") from error
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IVToolsWarning)
        found = _looked(path, said or _format(roles, scales), roles, scales)
        if not found.pushes:  # the command may count the other way
            other = replace(scales, gain=-(scales.gain or 1.0), doubts=[*scales.doubts, _OPPOSITE])
            turned = _looked(path, _format(roles, scales), roles, other) if said is None else found
            scales = other if turned.pushes and turned.r2 >= found.r2 else scales
            found = turned if scales is other else found
        if found.r2 < _SURE:  # what leads by its shape alone may be what is led
            pairs = [p for k in range(len(roles.led)) for p in combinations(roles.led, k + 1)]
            swapped = [roles.swapped(p) for p in pairs]
            others = [_looked(path, _format(other, scales), other, scales) for other in swapped]
            found = max([found, *others], key=lambda f: f.r2)
        return found


def _stated(
    said: RecordFormat, guessed: Roles, joint: str, gain: float | None
) -> tuple[Roles, Scales]:
    """Return columns and units as they were told."""
    columns = dict(said.columns)
    for name in guessed.said:  # those that bear our names need no telling
        plain = plain_name(name)[0]
        if plain in _MEANS and name not in columns.values():
            columns.setdefault(plain, name)
    sure = dict.fromkeys((*columns, "joint"), "stated")
    roles = Roles(columns, guessed.said, dict.fromkeys(columns, "stated"))
    return roles, Scales(dict(said.units), joint, said.rate, gain=gain, sure=sure)


def _looked(path: Path, log: RecordFormat, roles: Roles, scales: Scales) -> FirstAxis:
    """Fit the law and the rough parameters, as far as the record allows."""
    record = Record.read(path, log)
    loop = ClosedLoop(
        Controller("identify", {}),
        scales.gain or 1.0,
        find(_TERMS),
        name=record.name,
        joint=scales.joint,
        log=log,
    )
    doubts = [*roles.doubts, *scales.doubts]
    fit = None
    try:
        if record.q_ref is None and record.dq_ref is None:
            raise RecordError("no reference was found, so the controller is unknown")
        known, fit = loop.identify_controller(record)
        loop = replace(known, notes=())
        if fit.r2 < _GOOD:
            doubts.append(f"the law leaves {fit.residual:.2g} % of the command; " + _tried(fit))
        doubts += fit.remains
    except IVToolsError as error:
        loop = replace(loop, controller=Controller("none", {}))
        doubts.append(f"no law was fitted: {error}")
    loop, params = _rough(record, loop, doubts)
    if scales.gain and params.get("inertia", 0.0) > 0.0:  # else it changes with the gain
        loop = replace(loop, start={"inertia": float(f"{params['inertia']:.3g}")})
    return FirstAxis(path, record, loop, roles, scales, fit, params, tuple(dict.fromkeys(doubts)))


def _tried(fit: ControllerFit) -> str:
    kinds = ", ".join(f"{kind} {r2:.3f}" for kind, r2 in fit.kinds.items())
    return f"R2 of the kinds that were tried: {kinds}"


def _rough(
    record: Record, loop: ClosedLoop, doubts: list[str]
) -> tuple[ClosedLoop, dict[str, float]]:
    """Return the loop and least-squares estimates, or say why there are none.

    With gravity among the terms of an axis that turns, if that is a good part of the force.
    """
    from ..estimators.least_squares import IDIMLS
    from ..problem import Problem

    record = record.liveliest()
    try:
        fit = IDIMLS().fit(Problem(record, loop))
        if loop.joint == "revolute":
            hanging = replace(loop, terms=find((*_TERMS, *_GRAVITY)))
            beside = IDIMLS().fit(Problem(record, hanging))
            if beside.relative_error < _HANGS * fit.relative_error:
                loop, fit = hanging, beside
    except IVToolsError as error:
        doubts.append(f"no parameters were estimated: {error}")
        return loop, {}
    params = {str(k): float(v) for k, v in fit.params.items()}
    if params.get("inertia", 1.0) <= 0.0:
        against = shown_inertia(loop, record)[1].negative
        doubts.append(_AGAINST if against else _NOTHING)
    return loop, params


def _needed(roles: Roles, names: list[str]) -> None:
    for signal in ("q", "nu"):
        if signal not in roles.columns:
            listed = ", ".join(repr(plain_name(n)[0][:30]) for n in names[:12])
            raise RecordError(
                f"no column could be found that is the {_MEANS[signal]}; there are {listed}; write "
                f'the axis file yourself, with [record] columns = {{ {signal} = "name" }} '
                "(docs/axis-file.md)"
            )
    if len(roles.columns) < 2:
        raise DataError("the file holds no log of an axis")


def _repeats(table: Mapping[str, Array], roles: Roles) -> bool:
    """Whether rows are said twice, with the stamp of the row before."""
    if "t" not in roles.columns:
        return False
    same = [np.diff(table[column]) == 0.0 for column in roles.columns.values()]
    return bool(np.logical_and.reduce(same).any())


def _format(roles: Roles, scales: Scales) -> RecordFormat:
    """Return the [record] table."""
    columns = {}
    for signal, column in roles.columns.items():
        plain = plain_name(column)[0]
        alone = sum(plain_name(name)[0] == plain for name in roles.said) == 1
        columns[signal] = plain if alone and plain else column.strip()
    columns = {s: c for s, c in columns.items() if s != c}
    units = {
        signal: unit
        for signal, unit in scales.units.items()
        if signal in roles.columns and not _plain(signal, unit)
    }
    return RecordFormat(
        columns=columns,
        units=units,
        rated=scales.rated,
        counts_per_unit=scales.counts,
        rate=scales.rate,
        gaps="longest" if scales.gaps else "refuse",
        rows=scales.rows,
        unwrap=scales.unwrap,
    )


def _plain(signal: str, unit: str) -> bool:
    """Whether a unit is what a record has anyway."""
    found = parse(unit)
    return found.factor == 1.0 and found.si in UNITS.get(signal, ("V", "A", "N", "N m"))


def _commented(line: str, loop: ClosedLoop) -> str:
    """Return a line of the axis file with what it means."""
    length, force, inertia = JOINTS[loop.joint]
    key = re.match(r"[\w.]+(?= =)", line)
    told = {
        "columns": "ours = theirs",
        "units": "of the file; what is not here is in SI",
        "rated": "what 100 % is",
        "counts_per_unit": "t: per s" if "t =" in line else f"per {length}",
        "rate": "Hz; stamps that jitter around it are replaced",
        "gaps": "samples are missing: the longest stretch without a gap is used",
        "rows": "without rows said twice, spoilt, or of zeros at the end",
        "unwrap": "the angle jumps by a turn: made continuous",
        "joint": '"prismatic" (m, N) or "revolute" (rad, N m)',
        "kind": "of controller; fitted from the log",
        "delay": "samples from the measured position to the command" if "." not in line else "s",
        "gain": f"{force} per unit of the command",
        "terms": "of the model; `ivtools effects` lists more",
        "inertia": f"{inertia}, a rough estimate to start from",
        "limit": "of the command",
    }
    comment = told.get(key[0]) if key else None
    return f"{line}  # {comment}" if comment else line


def _wrapped(text: str) -> list[str]:
    from textwrap import wrap

    return wrap(text, 78, subsequent_indent="  ")
