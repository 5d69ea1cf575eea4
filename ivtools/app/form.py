"""The form of the first look: what is known of a log, as fields that a user can correct."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import IVToolsError, RecordError, shown
from ..guess import FirstAxis
from ..guess.roles import Roles, assign
from ..guess.scales import Scales, measure
from ..loop import ClosedLoop
from ..readers import preamble, read_table
from ..record_format import RecordFormat
from ..registry import REGISTRY

#: Signals of the form, and what they are called.
SIGNALS = {
    "t": "time",
    "q": "position",
    "q_ref": "position reference",
    "nu": "command",
    "dq": "velocity, as the controller saw it",
    "dq_ref": "velocity reference",
    "tau": "force or torque",
    "added": "known input added to the command",
    "load": "known outside force",
}
_FIRST = 4  # values of each column that are shown
_NUMBERS = ("rate", "gain", "rated", "counts", "torque_constant")


def of_guess(found: FirstAxis) -> dict[str, Any]:
    """Return the form of a first look."""
    return _form(found.path, found.roles, found.scales, found.loop.gain, found.loop.log)


def partial(path: Path, error: str) -> dict[str, Any]:
    """Return what can be told of a log whose needed columns were not found."""
    columns, _ = read_table(path, None)  # what cannot be read at all is an error
    roles, scales = assign(columns), Scales()
    with suppress(IVToolsError, ValueError, ArithmeticError, IndexError):
        scales = measure(columns, roles, preamble(path))
    return {**_form(path, roles, scales, scales.gain or 1.0, RecordFormat()), "error": error}


def of_loop(log: str, loop: ClosedLoop) -> dict[str, Any]:
    """Return the form of a log whose axis file is given; a registered data set needs none."""
    if log in REGISTRY:
        return {"columns": []}
    own = loop.log
    roles = Roles(dict(own.columns), why=dict.fromkeys(own.columns, "axis file"))
    for signal in own.units:
        roles.take(signal, signal, "axis file")
    scales = Scales(dict(own.units), loop.joint, own.rate, own.gaps == "longest")
    scales.sure = dict.fromkeys((*own.units, "joint"), "axis file")
    return _form(Path(log), roles, scales, loop.gain, own)


def said(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the fields of the form say, as arguments of `first_axis`.

    Raises
    ------
    RecordError
        A field that is no number, or no known unit.
    """
    columns = {s: str(fields[f"column-{s}"]) for s in SIGNALS if fields.get(f"column-{s}")}
    units = {s: str(fields[f"unit-{s}"]).strip() for s in columns if fields.get(f"unit-{s}")}
    numbers = {name: _number(name, fields.get(name)) for name in _NUMBERS}
    log = RecordFormat(
        columns=columns,
        units={s: unit for s, unit in units.items() if unit},
        rated={} if numbers["rated"] is None else {"nu": numbers["rated"]},
        counts_per_unit={} if numbers["counts"] is None else {"q": numbers["counts"]},
        torque_constant=numbers["torque_constant"],
        rate=numbers["rate"],
        resample=bool(fields.get("resample")),
        gaps="longest" if fields.get("gaps") else "refuse",
    )
    joint = "revolute" if fields.get("joint") == "revolute" else "prismatic"
    return {"said": log, "joint": joint, "gain": numbers["gain"]}


def _number(name: str, text: Any) -> float | None:
    if text in (None, ""):
        return None
    try:
        return float(str(text).replace(",", "."))
    except ValueError:
        raise RecordError(f"{name}: {shown(str(text))!r} is not a number") from None


def _form(
    path: Path, roles: Roles, scales: Scales, gain: float, log: RecordFormat
) -> dict[str, Any]:
    """Return the fields, and the columns of the file to choose from."""
    columns, _ = read_table(path, None)
    plain = {name.strip(): name for name in columns}
    signals = {}
    for signal, means in SIGNALS.items():
        told = roles.columns.get(signal, "")
        column = plain.get(told.strip()) or next(
            (name for name in columns if told and name.startswith(told)), ""
        )
        signals[signal] = {
            "means": means,
            "column": column,
            "unit": scales.units.get(signal, ""),
            "why": roles.why.get(signal, ""),
            "sure": scales.sure.get(signal, ""),
        }
    rated, counts = log.rated or scales.rated, log.counts_per_unit or scales.counts
    return {
        "columns": [_column(name, values) for name, values in columns.items()],
        "signals": signals,
        "joint": scales.joint,
        "rate": scales.rate,
        "gaps": scales.gaps,
        "resample": log.resample,
        "gain": gain,
        "rated": next(iter(rated.values()), None),
        "counts": next(iter(counts.values()), None),
        "torque_constant": log.torque_constant,
        "doubts": [*roles.doubts, *scales.doubts],
    }


def _column(name: str, values: Any) -> dict[str, Any]:
    """Return the name of a column and what it holds."""
    x = np.asarray(values, dtype=float).ravel()
    x = x[np.isfinite(x)]
    ends = [f"{x.min():.5g}", f"{x.max():.5g}"] if x.size else ["", ""]
    first = ", ".join(f"{v:.5g}" for v in x[:_FIRST])
    return {"name": name, "first": first, "least": ends[0], "greatest": ends[1]}
