"""What a user's own simulator lacks against the axis, and what of its parameters is off."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import replace

import numpy as np

from ...errors import IVToolsError
from ...linalg import rms
from ...loop import ClosedLoop
from ...record import Record
from ...simulators.difference import SWINGS, Difference, as_simulated, brought, difference
from ...units import quantity
from ..diagnosis import Diagnosis
from ..rules import ADEQUATE, LITTLE, SAME_LOG, Rules
from .changes import changes, settled, twins

Diagnose = Callable[..., Diagnosis]
"""Of record, holdout and loop; named=False names nothing, described=False describes nothing."""


def against(
    record: Record,
    loop: ClosedLoop,
    holdout: Record | None,
    simulated: Record,
    simulated_holdout: Record | None,
    diagnose: Diagnose,
    rules: Rules,
) -> Diagnosis:
    """Diagnose what a simulator lacks; see `ivtools.diagnose`.

    First what the axis has and the simulator has not; if that leaves more than is negligible, or
    names a law of friction, of which less looks like more of another, the other way round as well:
    a simulator may have too much of an effect that cannot be negative.
    """
    pairs = [(record, simulated), (holdout, simulated_holdout)]
    logs = [brought(a, b, loop) for a, b in pairs if a is not None and b is not None]
    own = {t.name for t in loop.terms}
    loop, base = as_simulated(loop.known(record), logs[0][1])
    lacking = [
        difference(real, sim, loop, notes, base if k == 0 else None)
        for k, (real, sim, notes) in enumerate(logs)
    ]
    if all(_parted(pair, loop) < SAME_LOG * rms(loop.force(pair.real)) for pair in lacking):
        found = diagnose(*_records(lacking), loop, named=False)
        found = replace(found, verdict="adequate", discrepancy=None)
        return _of_simulator(found, lacking, False, own, rules)
    found = diagnose(*_records(lacking), loop)
    answers = [(found, lacking, False)]
    everywhere = any(t.everywhere for t in found.loop.terms if t.name in found.effects)
    whole = _closed(found) >= 1.0 - LITTLE or found.chi[1] < ADEQUATE
    enough = whole and len(found.effects) == 1 and not everywhere
    nothing = found.verdict == "adequate" or (found.negligible and not found.effects)
    if not nothing and not enough:
        try:
            turned = [difference(sim, real, loop, notes) for real, sim, notes in logs]
            answers.append((diagnose(*_records(turned), loop, described=False), turned, True))
        except IVToolsError:
            pass  # the simulator's log alone carries no diagnosis
    good = [answer for answer in answers if _material(*answer, loop)]
    same = len(good) == 2 and set(good[0][0].effects) == set(good[1][0].effects)
    if same or (good and good[-1][2] and _of_either_sign(good[-1][0])):
        good.pop()  # the axis has it, with the other sign, or does not show it
    if good:
        best, shown, surplus = max(good, key=lambda answer: _worth(answer[0]))
        best = diagnose(*_records(shown), loop) if surplus else best
        return _of_simulator(best, shown, surplus, own, rules)
    if found.effects:
        plain = diagnose(*_records(lacking), loop, named=False)
        slight = plain.shrink and plain.shrink.gap < LITTLE * _parted(lacking[-1], loop)
        found = replace(plain, verdict="adequate") if slight else plain
    return _of_simulator(found, lacking, False, own, rules)


def _of_either_sign(found: Diagnosis) -> bool:
    """Whether all that is named is a force whose amplitude may be negative."""
    terms = [t for t in found.loop.terms if t.name in found.effects]
    lowest = [[p.lower for p in t.parameters if p.linear] for t in terms if t.law is not None]
    return len(lowest) == len(found.effects) and all(
        bounds and np.isneginf(bounds).all() for bounds in lowest
    )


def _worth(found: Diagnosis) -> tuple[float, int, float]:
    """Return how far an answer closes the gap, how few effects it takes, and what it leaves."""
    left = found.shrink.after if found.shrink else 0.0
    return min(_closed(found), 1.0 - LITTLE), -len(found.effects), -left


def _material(found: Diagnosis, pairs: list[Difference], surplus: bool, loop: ClosedLoop) -> bool:
    """Whether named effects explain more than the second order of the difference of two logs."""
    return bool(found.effects) and _explains(found) >= LITTLE * _parted(pairs[-1], loop)


def _records(pairs: list[Difference]) -> tuple[Record, Record | None]:
    """Return the record of a diagnosis, and its holdout."""
    return pairs[0].record, pairs[1].record if len(pairs) > 1 else None


def _explains(found: Diagnosis) -> float:
    """Return the rms force that the named effects explain, N or N m."""
    s = found.shrink
    return 0.0 if s is None else float(np.sqrt(max(s.before**2 - s.after**2, 0.0)))


def _parted(pair: Difference, loop: ClosedLoop) -> float:
    """Return the rms force by which simulator and axis differ, N or N m."""
    return rms(loop.force(pair.real) - loop.force(pair.simulated))


def _closed(found: Diagnosis) -> float:
    """Return how far named effects close the gap; 0 if none is named."""
    return found.shrink.closed if found.effects and found.shrink else 0.0


def _of_simulator(
    found: Diagnosis, pairs: list[Difference], surplus: bool, own: Collection[str], rules: Rules
) -> Diagnosis:
    """Return a diagnosis that speaks of the simulator; `own` are the terms of the user's axis."""
    fit, stuck = settled(found, pairs[0], rules)
    made = changes(found, pairs[0], fit, stuck, surplus)
    swings = SWINGS not in {*own, *found.effects}
    if swings:  # what hangs from both is no setting of the simulator's
        made = {name: c for name, c in made.items() if not name.startswith(f"{SWINGS}.")}
    others = {} if fit is None or surplus else twins(fit, pairs[0], rules)
    whose = "the simulator has and the axis lacks" if surplus else "your simulator lacks"
    none = "no effect; parameters differ" if found.verdict == "adequate" else "nothing with a name"
    what = ", ".join(found.effects) or none
    said = [f"{whose}: {what}", *(_either(name, found, others[name]) for name in others)]
    if swings and f"{SWINGS}.frequency_hz" in pairs[0].base.params:
        hz = quantity(float(pairs[0].base.params[f"{SWINGS}.frequency_hz"]), "Hz")
        said.append(f"a load swings at {hz} in your simulator; the axis is taken to have it too")
    if stuck:
        said.append("at standstill your simulator's friction creeps, the axis sticks")
    notes = dict.fromkeys(note for pair in pairs for note in pair.notes)
    either = {name: list(effects) for name, effects in others.items()}
    return replace(
        found,
        changes=made,
        surplus=found.effects if surplus else (),
        ambiguous_with={**found.ambiguous_with, **either},
        advice=(*said, *notes, *found.advice),
        whole=None,
        alternatives=(),
    )


def _either(name: str, found: Diagnosis, others: Mapping[str, Mapping[str, float]]) -> str:
    """Return the sentence about a change that an effect would do as well."""
    said = []
    for effect, values in others.items():
        units = found.loop.with_effect(effect).units
        shown = (f"{n.partition('.')[2]} {quantity(v, units[n], 3)}" for n, v in values.items())
        said.append(f"{effect} ({', '.join(shown)})")
    return (
        f"{name} changes, or your simulator lacks {' or '.join(said)}: the records cannot tell "
        "which, and either closes the gap"
    )
