"""Verdict: what was attributed, in one word, and whether either side says the same.

Nothing is decided here that a person could not look up in `rules`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..loop import ClosedLoop
from ..units import quantity
from .attribute import Attribution, cost
from .candidate import phases
from .fit import Fit, common, gauss_newton, steps
from .floor import Measured
from .library import Scales
from .parity import Parity
from .preflight import Finding
from .quantify import Shrink
from .rules import (
    ADEQUATE,
    CHANGED,
    CHANGED_BY,
    CHANGED_T,
    DRAWS,
    EXPLAINED,
    FAINT,
    HEARD,
    MOST,
    OVER_FLOOR,
    REPEATS,
    SHORT,
    STEADY,
    Rules,
)

Pair = tuple[float | None, float | None]


VERDICTS = {
    "adequate": "the model is as good as the measurement is repeatable",
    "explained": "the named effects close the gap",
    "partial": "the named effects close part of the gap; a significant part remains",
    "unexplained": "there is a gap that no known effect explains",
    "non-repeatable": "the gap comes and goes: something from outside, or a changed setting",
}

#: Of a gap that no law of the axis's own motion describes.
OUTSIDE = Finding(
    "what is left follows neither position nor speed nor load of this axis: it looks like a force "
    "from outside that the model does not know, as another joint's motion or a hand makes; log it "
    "as load, or take the whole robot (--robot)",
    fatal=False,
)
#: Of a gap that the other record cannot judge.
ELSEWHERE = Finding(
    "most of what is left lies where only one of the records has been, or later than the other one "
    "ends: no effect can be proved there; record both along the same stroke, and as long",
    fatal=False,
)


@dataclass(frozen=True)
class Setting:
    """A base parameter that differs between two records.

    Parameters
    ----------
    record, holdout : float
        Its values.
    t : float
        Difference over its block-robust standard error.
    unit : str
    """

    record: float
    holdout: float
    t: float
    unit: str

    @property
    def text(self) -> str:
        """The values, with units."""
        one, two = (quantity(x, self.unit, 3) for x in (self.record, self.holdout))
        return f"{one} -> {two}"

    def said(self, name: str) -> str:
        """Return what to say of it, as a sentence."""
        return f"{name} {self.text} between the records: a changed setting, not an effect"

    def to_dict(self) -> dict[str, float]:
        """Return the JSON of the change."""
        return {"record": self.record, "holdout": self.holdout, "t": self.t}


def changes(result: Attribution, tolerance: float) -> dict[str, Setting]:
    """Return the base parameters that differ between two records, whatever is named.

    Only where the model reproduces both: a force that it lacks bends the parameters along other
    motions otherwise.
    """
    if result.fits[0].fold.record is result.fits[1].fold.record:
        return {}
    one, two = (_own_parameters(fit) for fit in common(result.fits))
    if max(one.cost, two.cost) > STEADY:
        return {}
    found = {}
    force = float(np.sqrt(np.mean(one.loop.force(one.fold.record)[one.fold.keep] ** 2)))
    for name in (n for n in one.free if "." not in n and n in two.free):
        a, b = one.values[name], two.values[name]
        t = abs(a - b) / max(np.hypot(one.deviation([name]), two.deviation([name])), 1e-300)
        p = one.loop.parameters[name]
        size = 0.5 * abs(a + b) if p.lower >= 0.0 else tolerance / 100.0 * force / CHANGED_BY
        large = t > CHANGED_T and abs(a - b) > CHANGED_BY * size
        if large and _needed(one, name, b) and _needed(two, name, a):
            found[name] = Setting(a, b, t, p.unit_for(one.loop.joint))
    return found


def _own_parameters(fit: Fit) -> Fit:
    """Return a fit whose base parameters are the axis's own, whatever is not known of its load.

    What an axis cannot tell from a change of its own parameters counts as one while it is
    diagnosed; along another motion it is another one.
    """
    link = fit.fold.link
    if link is None or link.doubt is None:
        return fit
    fold = replace(fit.fold, link=replace(link, doubt=link.doubt.whole))
    step = steps(fold, fit.loop, Scales(fold.record, fit.loop))
    return gauss_newton(fold, fit.loop, fit.values, fit.free, step)


def _needed(fit: Fit, name: str, value: float) -> bool:
    """Whether no other base parameter makes up for the other record's value of this one."""
    step = steps(fit.fold, fit.loop, Scales(fit.fold.record, fit.loop))
    others = [n for n in fit.free if n != name]
    moved = gauss_newton(fit.fold, fit.loop, {**fit.values, name: value}, others, step)
    return (moved.cost - fit.cost) * len(fit.e) > CHANGED_T**2


def decide(
    effects: Sequence[str],
    measured: Sequence[Measured],
    result: Attribution,
    shrink: Shrink,
    changed: Mapping[str, Setting],
    repeats: float,
    tolerance: float,
) -> str:
    """Return the verdict, a key of `VERDICTS`.

    Parameters
    ----------
    effects : sequence of str
        What is named.
    measured : sequence of Measured
    result : Attribution
    shrink : Shrink
    changed : mapping
        Base parameters that differ between the records.
    repeats : float
        Share of what is left above the floor that comes again without having a name.
    tolerance : float
        Per cent of the force below which a gap is negligible.
    """
    small = shrink.remainder < 0.01 * tolerance * shrink.force
    if effects:
        return "explained" if small or shrink.closed >= EXPLAINED else "partial"
    few = min(m.fold.n_kept for m in measured)
    allowed = ADEQUATE + (SHORT / few) ** 2
    each = [h.cost for h in result.held]
    left = float(np.mean(each))
    if changed or (repeats < REPEATS and any(_comes_and_goes(m, each, allowed) for m in measured)):
        return "non-repeatable"
    between = measured[-1].floor.between
    above = between is not None and shrink.after > OVER_FLOOR * between and not small
    above = above or repeats >= REPEATS
    if left <= allowed and not above:
        return "adequate"
    return "non-repeatable" if _moved(result) else "unexplained"


def _comes_and_goes(m: Measured, left: Sequence[float], allowed: float) -> bool:
    """Whether stretches of a record stand out, and come and go.

    If they do, one record at least shows nothing else that the model lacks. Where both do, a law of
    the state may be behind all of it: friction over position stands out where the other record has
    not been. The load of a robot's joint is wrong now and then, where its links are hardly known or
    another joint's link swings: there the stretches must be the gap, and all of it.

    Parameters
    ----------
    m : Measured
    left : sequence of float
        Whitened energy of each record without those stretches.
    allowed : float
        Energy of a model that is adequate.
    """
    if m.fold.link is None:
        return m.floor.isolated and min(left) <= allowed
    return m.floor.isolated and float(np.mean(left)) <= allowed < m.base.cost


def lowers(shrink: Shrink, simulated: bool, removed: float) -> bool:
    """Whether effects lower the held-out force error, by enough to be worth a name.

    Parameters
    ----------
    shrink : Shrink
    simulated : bool
        Whether all were named by simulation, and not at the controller, which a wrong setting of
        may change the force little.
    removed : float
        Whitened energy that they remove; 1 is the floor. Where fast noise is most of the force
        error, no effect lowers it by much, and an energy that stands out of the noise is enough.
    """
    least = FAINT if simulated and removed <= HEARD else 0.0
    return shrink.after < (1.0 - least) * shrink.before


def no_better(effects: Sequence[str], shrink: Shrink) -> Finding:
    """Return what to say of effects that do not lower the force error."""
    values = f"{shrink.before:.4g} to {shrink.after:.4g} {shrink.unit}"
    text = f"{', '.join(effects)} in the model takes the held-out force error from {values}"
    return Finding(f"{text}: nothing is named", fatal=False)


def may_swing(effects: Sequence[str]) -> Finding:
    """Return what to say of effects that remove less than other joints' links may have left."""
    text = f"{', '.join(effects)} would remove less than the swing of other joints' links may leave"
    return Finding(f"{text}: nothing is named", fatal=False)


def remainder(held: Sequence[Fit], shrink: Shrink) -> Finding | None:
    """Return what to say of a gap that no law describes; None if it is hardly above the floor.

    Parameters
    ----------
    held : sequence of Fit
        The model with all that is named, on each fold.
    shrink : Shrink
    """
    if cost(common(held)) - 1.0 < MOST * (cost(held) - 1.0):
        return ELSEWHERE
    return OUTSIDE if shrink.after > OVER_FLOOR * shrink.floor else None


def _moved(result: Attribution) -> bool:
    """Whether the base parameters moved between the records and that is the whole gap."""
    if result.fits[0].fold.record is result.fits[1].fold.record:
        return False
    one, two = (_own_parameters(fit) for fit in result.fits)
    tuned = float(np.mean([one.cost, two.cost]))
    swapped = [two.fold.error(two.loop, one.values), one.fold.error(one.loop, two.values)]
    still = float(np.mean([np.mean(e**2) for e in swapped]))
    return tuned < STEADY and still > CHANGED * tuned


@dataclass(frozen=True)
class Ranked:
    """One effect in the ranking.

    Parameters
    ----------
    effect : str
    closed : float
        Fraction of the reducible energy of the gap that it closes alone.
    p_value : float
        Of no gain on held-out data, corrected for all effects tried; 1 if it was not fitted.
    held_out : bool
        Whether `closed` was judged on held-out data; else it is the screening's estimate.
    replicates : bool
        Whether it passes the rules for a name.
    """

    effect: str
    closed: float
    p_value: float
    held_out: bool
    replicates: bool

    @property
    def chance(self) -> str:
        """The p value as it is printed."""
        if not self.held_out:
            return "screened"
        return f"{self.p_value:.3f}" if self.p_value > 0.0 else f"< {1.0 / DRAWS:g}"

    def to_dict(self) -> dict[str, object]:
        """Return the JSON of the entry."""
        return {
            "effect": self.effect,
            "closed": self.closed,
            "p_value": self.p_value,
            "held_out": self.held_out,
            "replicates": self.replicates,
        }


def ranking(result: Attribution, rules: Rules, energy: float) -> tuple[Ranked, ...]:
    """Return every effect that was tried, those that were fitted first."""
    gap = energy / (1.0 + energy)  # the reducible part of the whitened energy
    fitted = {t.name: t for t in result.trials}
    ranked = []
    for name, gain in result.screened.items():
        trial = fitted.get(name)
        closed = float(np.clip((trial.gain if trial else gain) / gap, 0.0, 1.0))
        p = result.pvalues.get(name, 1.0) if trial else 1.0
        ranked.append(
            Ranked(name, closed, p, trial is not None, bool(trial and trial.passes(rules)))
        )
    return tuple(sorted(ranked, key=lambda r: (not r.held_out, -r.closed)))


@dataclass(frozen=True)
class Replica:
    """The values of a named effect on either side.

    Parameters
    ----------
    effect : str
    sides : tuple of str
        The two records, or the two parts of one.
    values : mapping
        Per parameter, its value on either side; None where the side does not show it.
    units : mapping
        Unit of each parameter.
    replicates : bool or None
        Whether the sides agree; None if only one of them can show the effect.
    """

    effect: str
    sides: tuple[str, str]
    values: dict[str, Pair]
    units: dict[str, str]
    replicates: bool | None

    @property
    def text(self) -> str:
        """The answer as a sentence."""
        return f"{self.effect} {self.short}"

    @property
    def short(self) -> str:
        """The sentence without its subject."""
        said = {
            True: "replicates in both directions",
            False: "does not replicate, its values differ",
            None: "shows on one side only",
        }
        one, two = self.sides
        shown = (
            f"{n} {self.value(n, 0)} on {one}, {self.value(n, 1)} on {two}" for n in self.values
        )
        return f"{said[self.replicates]}: {'; '.join(shown)}"

    def value(self, name: str, side: int) -> str:
        """Return the value of a parameter on one side, with its unit."""
        value = self.values[name][side]
        if value is None:
            return "not seen"
        if self.units[name] == "%":
            return f"{100 * value:+.2g} %"
        return quantity(value, self.units[name].removeprefix("1"))

    def to_dict(self) -> dict[str, object]:
        """Return the JSON of the replica."""
        sides = [{"side": s, **{n: v[i] for n, v in self.values.items()}}
                 for i, s in enumerate(self.sides)]  # fmt: skip
        return {"replicates": self.replicates, "sides": sides, "text": self.text}


def replicas(
    effects: Sequence[str],
    sides: tuple[str, str],
    values: tuple[Mapping[str, float], Mapping[str, float]],
    loop: ClosedLoop,
    checked: Sequence[Parity],
    rules: Rules,
) -> tuple[Replica, ...]:
    """Compare the named effects between the sides.

    Parameters
    ----------
    effects : sequence of str
    sides : tuple of str
        Names of the two sides.
    values : tuple of mapping
        Fitted parameters on either side.
    loop : ClosedLoop
        With the effects that were fitted.
    checked : sequence of Parity
        Of each record.
    rules : Rules
    """
    found = []
    for effect in effects:
        own = [n for n in loop.parameters if n.startswith(f"{effect}.")]
        if own:
            found.append(_fitted(effect, sides, values, loop, own, rules))
        elif len(checked) == 2:
            found.append(_controller(effect, sides, checked, rules))
    return tuple(found)


def _fitted(
    effect: str,
    sides: tuple[str, str],
    values: tuple[Mapping[str, float], Mapping[str, float]],
    loop: ClosedLoop,
    names: list[str],
    rules: Rules,
) -> Replica:
    pairs = {n: (values[0][n], values[1][n]) for n in names if not loop.parameters[n].nuisance}
    units = {n: loop.parameters[n].unit_for(loop.joint) for n in pairs}
    turned = sorted(phases(loop) & {*names})
    if turned:  # its phase is a matter of where the record began
        size = f"{effect}.amplitude"
        pairs, units = _without_phase(pairs, turned, size), {**units, size: units[turned[0]]}
    pairs = {n: p for n, p in pairs.items() if p != (0.0, 0.0)}
    sizes = [n for n in pairs if n.endswith(".amplitude") or _linear(loop, n)] or list(pairs)
    agree = _agree(np.array([pairs[n] for n in sizes]), rules) if sizes else None
    short = {n: n.partition(".")[2] for n in pairs}
    return Replica(
        effect,
        sides,
        {short[n]: p for n, p in pairs.items()},
        {short[n]: units[n] for n in pairs},
        agree,
    )


def _linear(loop: ClosedLoop, name: str) -> bool:
    return name in loop.parameters and bool(loop.parameters[name].linear)


def _without_phase(
    pairs: Mapping[str, tuple[float, float]], turned: Sequence[str], size: str
) -> dict[str, tuple[float, float]]:
    """Return values on both sides with the size of a wave, so named, instead of what turns."""
    one, two = (float(np.linalg.norm([pairs[n][i] for n in turned])) for i in (0, 1))
    return {size: (one, two), **{n: p for n, p in pairs.items() if n not in turned}}


def _agree(x: np.ndarray, rules: Rules) -> bool:
    """Whether two sets of values (n, 2) point the same way and are of similar size."""
    x = x / np.maximum(np.max(np.abs(x), axis=1, keepdims=True), 1e-300)
    dot = float(x[:, 0] @ x[:, 1])
    ratios = [dot / max(float(x[:, i] @ x[:, i]), 1e-300) for i in (0, 1)]
    return bool(1.0 / rules.other.agreement <= min(ratios) and max(ratios) <= rules.other.agreement)


def _controller(
    effect: str, sides: tuple[str, str], checked: Sequence[Parity], rules: Rules
) -> Replica:
    """Compare what the controllers of two records show."""
    if effect == "saturation":
        values: dict[str, Pair] = {"limit": (checked[0].limit, checked[1].limit)}
    else:
        one, two = (p.found for p in checked)
        values = {n: (one.get(n), two.get(n)) for n in sorted({*one, *two})}
    both = np.array(
        [[float(v) for v in p if v is not None] for p in values.values() if None not in p]
    )
    agree = _agree(both, rules) if len(both) else None
    absolute = ("limit", "law.", "feed")  # what is no relative error
    units = {n: "" if n.startswith(absolute) else "%" for n in values}
    return Replica(effect, sides, values, units, agree)


def replicate(
    effects: tuple[str, ...], result: Attribution, checked: tuple[Parity, ...], rules: Rules
) -> tuple[Replica, ...]:
    """Return, per named effect, whether the sides agree."""
    one, two = result.fits
    sides = (one.fold.label, two.fold.label)
    return replicas(effects, sides, (one.values, two.values), one.loop, checked, rules)
