"""Verdict: what was attributed, in one word, and whether either side says the same.

Nothing is decided here that a person could not look up in `rules`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..loop import ClosedLoop
from .attribute import Attribution
from .candidate import phases
from .floor import Measured
from .parity import Parity
from .rules import ADEQUATE, ADEQUATE_NAMED, CHANGED, EXPLAINED, STEADY, Rules

Pair = tuple[float | None, float | None]

_PREFIXED = ("m", "rad", "s")
_PERCENT = {"kp", "kv", "velocity_filter", "added"}  # of a controller: relative errors

VERDICTS = {
    "adequate": "the model is as good as the measurement is repeatable",
    "explained": "the named effects close the gap",
    "partial": "the named effects close part of the gap; a significant part remains",
    "unexplained": "there is a gap that no known effect explains",
    "non-repeatable": "the gap comes and goes: something from outside, or a changed setting",
}


def decide(
    effects: tuple[str, ...], measured: tuple[Measured, ...], result: Attribution, closed: float
) -> str:
    """Return the verdict, a key of `VERDICTS`."""
    events = any(m.floor.isolated for m in measured)
    after = float(np.mean([h.cost for h in result.held]))
    if effects:
        near = after <= ADEQUATE_NAMED or closed >= EXPLAINED
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
        return f"{self.p_value:.3f}" if self.p_value > 0.0 else "< 0.002"  # of 500 draws

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


def quantity(value: float, unit: str, digits: int = 4) -> str:
    """Return a value with its unit, small lengths, times and speeds with a prefix.

    Examples
    --------
    >>> quantity(0.0131512, "m/s"), quantity(-37.18, "N s/m"), quantity(3e-6, "m")
    ('13.15 mm/s', '-37.18 N s/m', '3 µm')
    """
    factor, prefix = 1.0, ""
    if unit.split("/")[0] in _PREFIXED and value:
        steps = ((1.0, ""), (1e3, "m"), (1e6, "µ"))
        factor, prefix = next((s for s in steps if abs(value) * s[0] >= 0.1), steps[-1])
    return f"{value * factor:.{digits}g} {prefix}{unit}".rstrip()


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
    if phases(loop) & {*names}:  # its phase is a matter of where the record began
        unit = units.get(f"{effect}.cosine", "")
        pairs, units = _without_phase(effect, pairs), {**units, f"{effect}.amplitude": unit}
    pairs = {n: p for n, p in pairs.items() if p != (0.0, 0.0)}
    sizes = [n for n in pairs if n.endswith(".amplitude") or _linear(loop, n)] or list(pairs)
    agree = _agree(np.array([pairs[n] for n in sizes]), rules)
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
    effect: str, pairs: Mapping[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    """Return amplitude and period instead of cosine and sine."""
    waves = [pairs[f"{effect}.{n}"] for n in ("cosine", "sine")]
    one, two = (float(np.hypot(waves[0][i], waves[1][i])) for i in (0, 1))
    rest = {n: p for n, p in pairs.items() if n.partition(".")[2] not in ("cosine", "sine")}
    return {f"{effect}.amplitude": (one, two), **rest}


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
        names = sorted({n for p in checked for n in p.mismatch})
        values = {n: (checked[0].mismatch.get(n), checked[1].mismatch.get(n)) for n in names}
    both = np.array(
        [[float(v) for v in p if v is not None] for p in values.values() if None not in p]
    )
    agree = _agree(both, rules) if len(both) else None
    return Replica(effect, sides, values, {n: "%" if n in _PERCENT else "" for n in values}, agree)


def replicate(
    effects: tuple[str, ...], result: Attribution, checked: tuple[Parity, ...], rules: Rules
) -> tuple[Replica, ...]:
    """Return, per named effect, whether the sides agree."""
    one, two = result.fits
    sides = (one.fold.label, two.fold.label)
    return replicas(effects, sides, (one.values, two.values), one.loop, checked, rules)
