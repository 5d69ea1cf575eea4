"""Answer: from what was attributed to the diagnosis that people read."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..loop import ClosedLoop
from . import advice as advices
from . import findings, locate
from .attribute import Attribution
from .confidence import AT_CONTROLLER, probability
from .diagnosis import Diagnosis, Ranked, Traces
from .fit import Fit, gauss_newton, steps
from .floor import Floor
from .fold import Fold
from .parity import Parity
from .quantify import Shrink, quantify
from .replica import Replica, replicas
from .rules import ADEQUATE, Rules
from .side import Side

Array = NDArray[np.float64]

_CLOSED = 0.8  # share of the reducible energy beyond which the gap is explained
_MOVED = 1.5  # frozen over re-tuned energy that speaks of a changed setting
_STEADY = 1.3  # most that smooth laws of the state leave where a gap is repeatable
_BEYOND = 0.03  # share of a record beyond the other one's stroke that is worth a remark
_FEW, _SHORT = 5, 0.25  # stretches of a record, and its share, that an outside force may take


@dataclass(frozen=True, eq=False)
class Measured:
    """A record, ready to be judged."""

    side: Side
    base: Fit
    floor: Floor
    parity: Parity

    @property
    def fold(self) -> Fold:
        """What is compared of the record."""
        return self.side.fold


def local(level: Floor) -> bool:
    """Whether few stretches stand out: events, not a way of the model to be wrong."""
    return 0 < len(level.events) <= _FEW and float(np.mean(level.event_mask)) < _SHORT


def answer(
    name: str,
    loop: ClosedLoop,
    measured: tuple[Measured, ...],
    result: Attribution,
    judge: Fold,
    rules: Rules,
    found: list[findings.Finding],
    held_out: bool,
) -> Diagnosis:
    """Put the diagnosis together."""
    checked = tuple(m.parity for m in measured)
    declared = _declared(loop, measured)
    before = [m.cost for m in result.base]
    after = [h.cost for h in result.held]
    at_controller, values = _controller_effects(checked)
    effects = (*at_controller, *result.named)
    shrink, traces = _how_far(declared, measured, result, judge, held_out)
    energy = max(float(np.mean(before)) - 1.0, 1e-9)
    closed = (float(np.mean(before)) - float(np.mean(after))) / energy
    verdict = _verdict(effects, measured, result, closed)
    return Diagnosis(
        verdict=verdict,
        effects=effects,
        ambiguous_with={e: result.ambiguous.get(e, []) for e in effects},
        parameters={**values, **_parameters(result)},
        block=locate.block(
            effects,
            any(_delayed(loop, p) for p in checked),
            any(local(m.floor) for m in measured),
            verdict != "adequate",
        ),
        regions=locate.regions(judge.record, judge.keep, traces.before, traces.after),
        shrink=shrink,
        ranking=_ranking(result, rules, energy),
        advice=(*_advice(result), *_remarks(loop, measured, result, held_out)),
        findings=tuple(found),
        parity=checked,
        floors=tuple(m.floor for m in measured),
        loop=result.fits[0].loop,
        theta=result.fits[0].values,
        chi=(float(np.mean(before)), float(np.mean(after))),
        name=name,
        replication=_replication(result),
        replicas=_replicas(effects, result, checked, rules),
        evidence=result.evidence,
        probability=dict.fromkeys(at_controller, AT_CONTROLLER)
        | {n: probability(proof) for n, proof in result.evidence.items()},
        traces=traces,
    )


def _declared(loop: ClosedLoop, measured: tuple[Measured, ...]) -> Fit:
    """Fit the loop as it was given, on the record that judges."""
    last = measured[-1]
    record = last.base.fold.record
    if last.parity.mismatch.get("added"):
        added = np.asarray(record.added) / (1.0 + last.parity.mismatch["added"])
        record = replace(record, added=added)
    fold = replace(last.side.fold, record=record)
    step = steps(fold, loop, last.side.scales)
    return gauss_newton(fold, loop, last.base.values, last.base.free, step, 5)


def _how_far(
    declared: Fit,
    measured: tuple[Measured, ...],
    result: Attribution,
    judge: Fold,
    held_out: bool,
) -> tuple[Shrink, Traces]:
    after = replace(result.held[-1], fold=judge)
    before = replace(declared, fold=replace(declared.fold, keep=judge.keep))
    still = replace(after, values=result.fits[0].values)
    level = measured[-1].floor
    corrected = replace(result.base[-1], fold=judge)
    shrink = quantify(before, corrected, after, still, _reachable(level, after), held_out)
    record = judge.record
    e0, e1 = (
        before.fold.force_error(before.loop, before.values),
        after.fold.force_error(after.loop, after.values),
    )
    force = after.loop.force(record)[:, 0]
    return shrink, Traces(record, judge.keep, force, e0, e1, _spectra(record.dt, e0, e1, level))


def _reachable(level: Floor, after: Fit) -> float:
    """Return the force error that could be reached, N or N m rms.

    Where the whitened error is at its floor nothing is left to close, and what remains is the
    floor; the noise model alone, which knows little below some hertz, would set it too low.
    """
    e = after.fold.force_error(after.loop, after.values)[after.fold.keep]
    left = float(np.sqrt(np.mean(e**2)))
    limit = min(level.level, left)
    return limit + (left - limit) * float(np.clip((1.15 - after.cost) / 0.1, 0.0, 1.0))


def _spectra(dt: float, e0: Array, e1: Array, level: Floor) -> tuple[Array, Array, Array, Array]:
    """Return frequency, and amplitude densities of the errors and of the noise model."""
    from scipy import signal

    hz, before = signal.welch(e0, 1.0 / dt, nperseg=min(2048, len(e0)))
    after = signal.welch(e1, 1.0 / dt, nperseg=min(2048, len(e1)))[1]
    _, gain = signal.freqz([1.0], level.whitener, worN=2 * np.pi * hz * dt)
    return hz, np.sqrt(before), np.sqrt(after), np.sqrt(2.0 * dt) * np.abs(gain)


def _controller_effects(
    checked: tuple[Parity, ...],
) -> tuple[list[str], dict[str, dict[str, float]]]:
    """Return what the controller itself shows, decided at parity level."""
    effects, values = [], {}
    limits = [p.limit for p in checked if p.limit is not None]
    if limits:
        effects.append("saturation")
        values["saturation"] = {"limit": float(np.mean(limits))}
    names = {n for p in checked for n in p.mismatch}
    if names:
        effects.append("controller-mismatch")
        values["controller-mismatch"] = {
            n: float(np.mean([p.mismatch[n] for p in checked if n in p.mismatch]))
            for n in sorted(names)
        }
    return effects, values


def _parameters(result: Attribution) -> dict[str, dict[str, float]]:
    values = result.fits[0].values
    return {
        e: {n.partition(".")[2]: v for n, v in values.items() if n.startswith(f"{e}.")}
        for e in result.named
    }


def _replication(result: Attribution) -> dict[str, tuple[float, float]]:
    one, two = (f.values for f in result.fits)
    return {n: (v, two[n]) for n, v in one.items() if "." in n and n in two}


def _replicas(
    effects: tuple[str, ...], result: Attribution, checked: tuple[Parity, ...], rules: Rules
) -> tuple[Replica, ...]:
    one, two = result.fits
    sides = (one.fold.label, two.fold.label)
    return replicas(effects, sides, (one.values, two.values), one.loop, checked, rules)


def _ranking(result: Attribution, rules: Rules, energy: float) -> tuple[Ranked, ...]:
    gap = energy / (1.0 + energy)  # the reducible part of the whitened energy
    fitted = {t.name: t for t in result.trials}
    ranked = []
    for name, share in result.scores.items():
        trial = fitted.get(name)
        closed = float(np.clip((trial.share if trial else share) / gap, 0.0, 1.0))
        p = result.pvalues.get(name, 1.0) if trial else 1.0
        ranked.append(
            Ranked(name, closed, p, trial is not None, bool(trial and trial.passes(rules)))
        )
    return tuple(sorted(ranked, key=lambda r: (not r.held_out, -r.closed)))


def _verdict(
    effects: tuple[str, ...], measured: tuple[Measured, ...], result: Attribution, closed: float
) -> str:
    events = any(local(m.floor) for m in measured)
    after = float(np.mean([h.cost for h in result.held]))
    if effects:
        near = after <= ADEQUATE + 0.03 or closed >= _CLOSED
        return "explained" if near else "partial"
    if events:
        return "non-repeatable"
    if after <= ADEQUATE:
        return "adequate"
    return "non-repeatable" if _changed(result) else "unexplained"


def _changed(result: Attribution) -> bool:
    """Whether the base parameters moved between the records and that is the whole gap."""
    if result.fits[0].fold.record is result.fits[1].fold.record:
        return False
    tuned = float(np.mean([f.cost for f in result.fits]))
    one, two = result.fits
    swapped = [two.fold.error(two.loop, one.values), one.fold.error(one.loop, two.values)]
    still = float(np.mean([np.mean(e**2) for e in swapped]))
    return tuned < _STEADY and still > _MOVED * tuned


def _advice(result: Attribution) -> list[str]:
    lines = []
    fits = {t.name: t.fits[0] for t in result.trials}
    for name, others in result.ambiguous.items():
        for other in others:
            if name in fits and other in fits:
                lines.append(advices.separate(fits[name], fits[other], name, other))
    return lines


def _delayed(loop: ClosedLoop, p: Parity) -> bool:
    return p.delay != loop.controller.delay


def _remarks(
    loop: ClosedLoop, measured: tuple[Measured, ...], result: Attribution, held_out: bool
) -> list[str]:
    lines = []
    for m, compared in zip(measured, result.base, strict=False):
        p, name = m.parity, m.fold.record.name
        beyond = 1.0 - compared.fold.n_kept / m.fold.n_kept
        if held_out and not local(m.floor) and beyond > _BEYOND:
            lines.append(
                f"{name}: in {100 * beyond:.0f} % of it the axis is where the other record has not "
                "been, or later than that; effects are named from the rest"
            )
        if _delayed(loop, p):
            lines.append(
                f"{name}: the recorded command follows the measured position by {p.delay} samples, "
                f"the axis file says {loop.controller.delay}; parity error {100 * p.before:.2g} % "
                f"-> {100 * p.after:.2g} %"
            )
        if "added" in p.mismatch:
            lines.append(
                f"{name}: the added input acts {100 * p.mismatch['added']:+.2g} % larger than "
                "recorded"
            )
        if local(m.floor):
            when = ", ".join(f"{a:.2f}-{b:.2f} s" for a, b in m.floor.events[:6])
            lines.append(f"{name}: stands out and does not come again: {when}")
        if p.clipped > 0.0:
            lines.append(
                f"{name}: the command sits at its limit in {100 * p.clipped:.2g} % of the samples; "
                "records at the limit are hard to reproduce"
            )
    if not held_out:
        lines.append(
            "no hold-out: stretches of the record judged each other; a second record makes "
            "the answer stronger"
        )
    return lines
