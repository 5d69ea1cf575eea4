"""What a user's own simulator lacks against the axis, and what of its parameters is off."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import IVToolsError
from ..estimators.input_error import CLIE
from ..loop import ClosedLoop
from ..problem import Problem
from ..record import Record
from ..simulators.difference import (
    CREEPS,
    Difference,
    as_simulated,
    brought,
    difference,
    dry,
)
from ..tables import Text, table
from .diagnosis import Diagnosis
from .rules import ALL_CLOSED, SAME_LOG, SECOND_ORDER, STICKS

Diagnose = Callable[..., Diagnosis]  # of record, holdout and loop; named=False names nothing


@dataclass(frozen=True)
class Change:
    """One parameter of the simulator, and what the axis has instead.

    Attributes
    ----------
    simulator, real, change : float
        As our model sees them, in `unit`.
    std_error : float
        Of the change; NaN where it is not known.
    unit : str
    """

    simulator: float
    real: float
    change: float
    std_error: float
    unit: str

    def to_dict(self) -> dict[str, Any]:
        """Return the content as plain objects, ready for JSON."""
        known = self.std_error if np.isfinite(self.std_error) else None
        return {
            "simulator": self.simulator,
            "real": self.real,
            "change": self.change,
            "std_error": known,
            "unit": self.unit,
        }


def against(
    record: Record,
    loop: ClosedLoop,
    holdout: Record | None,
    simulated: Record,
    simulated_holdout: Record | None,
    diagnose: Diagnose,
) -> Diagnosis:
    """Diagnose what a simulator lacks; see `ivtools.diagnose`.

    First what the axis has and the simulator has not; if that leaves something, or names a law of
    friction, of which less looks like more of another, the other way round as well: a simulator may
    have too much of an effect that cannot be negative.
    """
    pairs = [(record, simulated), (holdout, simulated_holdout)]
    logs = [brought(a, b, loop) for a, b in pairs if a is not None and b is not None]
    loop = as_simulated(loop.known(record), logs[0][1])
    lacking = [difference(real, sim, loop, notes) for real, sim, notes in logs]
    if all(_parted(pair, loop) < SAME_LOG * _rms(loop.force(pair.real)) for pair in lacking):
        same = diagnose(*_records(lacking), loop, named=False)
        return _told(replace(same, verdict="adequate", discrepancy=None), lacking, False)
    found = diagnose(*_records(lacking), loop)
    answers = [(found, lacking, False)]
    alike = any(t.everywhere for t in found.loop.terms if t.name in found.effects)
    enough = _closed(found) >= ALL_CLOSED and len(found.effects) == 1 and not alike
    if found.verdict != "adequate" and not enough:
        try:
            turned = [difference(sim, real, loop, notes) for real, sim, notes in logs]
            answers.append((diagnose(*_records(turned), loop), turned, True))
        except IVToolsError:
            pass  # the simulator's log alone carries no diagnosis
    good = [answer for answer in answers if _material(*answer, loop)]
    if len(good) == 2 and set(good[0][0].effects) == set(good[1][0].effects):
        good.pop()  # an effect of either sign: the axis has it
    if good:
        return _told(*max(good, key=lambda answer: _worth(answer[0])))
    if found.effects:
        found = replace(diagnose(*_records(lacking), loop, named=False), verdict="adequate")
    return _told(found, lacking, False)


def _worth(found: Diagnosis) -> tuple[float, int, float]:
    """Return how far an answer closes the gap, how few effects it takes, and what it leaves."""
    left = found.shrink.after if found.shrink else 0.0
    return min(_closed(found), ALL_CLOSED), -len(found.effects), -left


def _material(found: Diagnosis, pairs: list[Difference], surplus: bool, loop: ClosedLoop) -> bool:
    """Whether named effects explain more than the second order of the difference of two logs."""
    return bool(found.effects) and _explains(found) >= SECOND_ORDER * _parted(pairs[-1], loop)


def _records(pairs: list[Difference]) -> tuple[Record, Record | None]:
    """Return the record of a diagnosis, and its holdout."""
    return pairs[0].record, pairs[1].record if len(pairs) > 1 else None


def _explains(found: Diagnosis) -> float:
    """Return the rms force that the named effects explain, N or N m."""
    s = found.shrink
    return 0.0 if s is None else float(np.sqrt(max(s.before**2 - s.after**2, 0.0)))


def _parted(pair: Difference, loop: ClosedLoop) -> float:
    """Return the rms force by which simulator and axis differ, N or N m."""
    return _rms(loop.force(pair.real) - loop.force(pair.simulated))


def _rms(x: Any) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def _closed(found: Diagnosis) -> float:
    """Return how far named effects close the gap; 0 if none is named."""
    return found.shrink.closed if found.effects and found.shrink else 0.0


def _told(found: Diagnosis, pairs: list[Difference], surplus: bool) -> Diagnosis:
    """Return a diagnosis that speaks of the simulator."""
    made = changes(found, pairs[0], surplus)
    whose = "the simulator has and the axis lacks" if surplus else "your simulator lacks"
    what = ", ".join(found.effects) or "nothing but other parameters"
    notes = tuple(dict.fromkeys(note for pair in pairs for note in pair.notes))
    creeps = "at standstill your simulator's friction creeps, the axis sticks"
    told = (f"{whose}: {what}", *((creeps,) if sticks(found, pairs[0]) else ()), *notes)
    return replace(
        found,
        changes=made,
        surplus=found.effects if surplus else (),
        advice=(*told, *found.advice),
    )


def changes(found: Diagnosis, pair: Difference, surplus: bool) -> dict[str, Change]:
    """Return what must change in the simulator, parameter by parameter.

    The final loop is fitted to the difference once more, for its standard errors; an effect's
    values are zero on the side that lacks it.
    """
    if not found.theta:
        return {}
    values, errors = _final(found, pair.record)
    base = {str(n): float(v) for n, v in pair.base.params.items()}
    if f"{CREEPS}.force" in base:
        values = values if sticks(found, pair) else _whole(values)
        base = _whole(base)
    units = found.loop.units
    sign = -1.0 if surplus else 1.0
    out = {}
    for name, value in values.items():
        have = base.get(name, 0.0)
        one, two = (value, have) if surplus else (have, value)
        out[name] = Change(
            simulator=one,
            real=two,
            change=sign * (value - have),
            std_error=errors.get(name, float("nan")),
            unit=units.get(name, ""),
        )
    return out


def _final(found: Diagnosis, record: Record) -> tuple[dict[str, float], dict[str, float]]:
    """Return values and standard errors of the final loop on the difference."""
    loop = replace(found.loop, start={**found.loop.start, **found.theta})
    try:
        fit = CLIE(start="axis").fit(Problem(record, loop))
    except IVToolsError:
        return dict(found.theta), {}
    if not fit.converged:
        return dict(found.theta), {}
    values = {str(name): float(value) for name, value in fit.params.items()}
    errors = {str(name): float(value) for name, value in fit.std_errors.items()}
    parts = ["coulomb", f"{CREEPS}.force"]
    if set(parts) <= {*errors}:  # of the sum: the parts trade with each other
        errors["coulomb"] = float(np.sqrt(max(fit.cov.loc[parts, parts].to_numpy().sum(), 0.0)))
    return {**found.theta, **values}, errors


def sticks(found: Diagnosis, pair: Difference) -> bool:
    """Whether the axis sticks at standstill where its simulator creeps."""
    base = {str(n): float(v) for n, v in pair.base.params.items()}
    if f"{CREEPS}.force" not in base:
        return False
    return dry(found.theta) - max(dry(base), 0.0) > STICKS  # less than none is beside a pendulum


def _whole(values: Mapping[str, float]) -> dict[str, float]:
    """Return values with the friction that creeps in the Coulomb friction.

    That it creeps is how a simulator computes friction, no setting of the axis.
    """
    both = values["coulomb"] + values[f"{CREEPS}.force"]
    kept = {name: v for name, v in values.items() if not name.startswith(f"{CREEPS}.")}
    return {**kept, "coulomb": both}


def changes_table(made: dict[str, Change]) -> Text:
    """Return the changes as a table."""
    rows = [
        [
            name,
            c.unit,
            f"{c.simulator:.5g}",
            f"{c.real:.5g}",
            f"{c.change:+.3g}",
            f"{c.std_error:.2g}" if np.isfinite(c.std_error) else "–",
        ]
        for name, c in made.items()
    ]
    header = ["parameter", "unit", "simulator", "real", "change", "std error"]
    return table("Changes to your simulator", [], header, rows, left=2)
