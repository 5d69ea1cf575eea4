"""Replica: whether a named effect does the same on either side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...loop import ClosedLoop
from ...units import setting
from ..attribute import Attribution
from ..candidate import phases
from ..fit import Fit, of_effect
from ..parity import Parity, unit
from ..rules import AGREES, GOES_ON
from ..screen import unit_force

Array = NDArray[np.float64]
Pair = tuple[float | None, float | None]


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
    resized : bool
        Whether they agree but for the size of a drift, which has less left to go in one of them.
    """

    effect: str
    sides: tuple[str, str]
    values: dict[str, Pair]
    units: dict[str, str]
    replicates: bool | None
    resized: bool = False

    @property
    def text(self) -> str:
        """The answer as a sentence."""
        return f"{self.effect} {self.short}"

    @property
    def short(self) -> str:
        """The sentence without its subject."""
        said = {
            True: "replicates in both directions",
            False: "its values differ between the sides",
            None: "cannot be compared",
        }
        but = ", but for its size, which is a matter of when a record begins" * self.resized
        one, two = self.sides
        shown = (
            f"{n} {self.value(n, 0)} on {one}, {self.value(n, 1)} on {two}" for n in self.values
        )
        return f"{said[self.replicates]}{but}: {'; '.join(shown)}"

    def value(self, name: str, side: int) -> str:
        """Return the value of a parameter on one side, with its unit."""
        value = self.values[name][side]
        if value is None:
            return "not seen"
        return setting(value, self.units[name].removeprefix("1"))

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
    made: Mapping[str, Array] | None = None,
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
    made : mapping of str to ndarray, (n_samples,), optional
        What one unit of a parameter does along a record: sizes of several are compared by what they
        do together, for of two that trade with each other either may have more.
    """
    found = []
    for effect in effects:
        own = [n for n in loop.parameters if n.startswith(f"{effect}.")]
        if own:
            found.append(_fitted(effect, sides, values, loop, own, made or {}))
        elif len(checked) == 2:
            found.append(_controller(effect, sides, checked))
    return tuple(found)


def _fitted(
    effect: str,
    sides: tuple[str, str],
    values: tuple[Mapping[str, float], Mapping[str, float]],
    loop: ClosedLoop,
    names: list[str],
    made: Mapping[str, Array],
) -> Replica:
    pairs = {n: (values[0][n], values[1][n]) for n in names if not loop.parameters[n].nuisance}
    units = {n: loop.parameters[n].unit_for(loop.joint) for n in pairs}
    turned = sorted(phases(loop) & {*names})
    if turned:  # its phase is a matter of where the record began
        size = f"{effect}.amplitude"
        pairs, units = _without_phase(pairs, turned, size), {**units, size: units[turned[0]]}
    pairs = {n: p for n, p in pairs.items() if p != (0.0, 0.0)}
    term = next(t for t in loop.terms if t.name == effect)
    if term.search == "either" and len(pairs) > 1:  # each side may have taken another one
        pairs, units = _summed(pairs), {" + ".join(pairs): units[min(pairs)]}
    linear = {n for n, p in loop.parameters.items() if p.linear}
    sizes = [n for n in pairs if n.endswith(".amplitude") or n in linear] or list(pairs)
    x = np.array([pairs[n] for n in sizes]).reshape(-1, 2)
    known = bool(sizes) and made.keys() >= {*sizes}
    does = np.column_stack([made[n] for n in sizes]) @ x if known else _relative(x)
    agree, resized = _agree(does) if sizes else None, False
    if term.of_time and agree is False:  # of the same form, it is as large as is left to go
        large = np.maximum(np.linalg.norm(does, axis=0), 1e-300)
        agree = resized = _agree(does / large) and bool(large.max() <= GOES_ON * large.min())
    short = {n: n.replace(f"{effect}.", "") for n in pairs}
    return Replica(
        effect,
        sides,
        {short[n]: p for n, p in pairs.items()},
        {short[n]: units[n] for n in pairs},
        agree,
        resized,
    )


def _summed(pairs: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
    """Return the sum, on both sides, of what does nearly the same, as a delay and a lag."""
    one, two = (sum(p[i] for p in pairs.values()) for i in (0, 1))
    return {" + ".join(pairs): (one, two)}


def _without_phase(
    pairs: Mapping[str, tuple[float, float]], turned: Sequence[str], size: str
) -> dict[str, tuple[float, float]]:
    """Return values on both sides with the size of a wave, so named, instead of what turns."""
    one, two = (float(np.linalg.norm([pairs[n][i] for n in turned])) for i in (0, 1))
    return {size: (one, two), **{n: p for n, p in pairs.items() if n not in turned}}


def _relative(x: Array) -> Array:
    """Return values on two sides, (n, 2), relative to the larger one."""
    return np.asarray(x / np.maximum(np.max(np.abs(x), axis=-1, keepdims=True), 1e-300))


def _agree(x: Array) -> bool:
    """Whether two sides (n, 2) point the same way and are of similar size."""
    dot = float(x[:, 0] @ x[:, 1])
    ratios = [dot / max(float(x[:, i] @ x[:, i]), 1e-300) for i in (0, 1)]
    return bool(min(ratios) >= 1.0 / AGREES and max(ratios) <= AGREES)


def _controller(effect: str, sides: tuple[str, str], checked: Sequence[Parity]) -> Replica:
    """Compare what the controllers of two records show."""
    if effect == "saturation":
        values: dict[str, Pair] = {"limit": (checked[0].limit, checked[1].limit)}
    else:
        one, two = (p.found for p in checked)
        values = {n: (one.get(n), two.get(n)) for n in sorted({*one, *two})}
    both = np.array(
        [[float(v) for v in p if v is not None] for p in values.values() if None not in p]
    )
    agree = _agree(_relative(both)) if len(both) else None
    units = {n: unit(checked, n) for n in values}
    return Replica(effect, sides, values, units, agree)


def replicate(
    effects: tuple[str, ...], result: Attribution, checked: tuple[Parity, ...]
) -> tuple[Replica, ...]:
    """Return, per named effect, whether the sides agree."""
    one, two = result.fits
    sides = (one.fold.label, two.fold.label)
    values = (one.values, two.values)
    return replicas(effects, sides, values, one.loop, checked, _made(one, result.base[0]))


def _made(fit: Fit, base: Fit) -> dict[str, Array]:
    """Return what one unit of each size of a law does to the error, beside the base model."""
    laws = [t for t in fit.loop.terms if not t.base and t.law is not None and not t.net]
    run = fit.simulation
    if not laws or not run.finite:
        return {}
    names, forces = [], []
    for term in laws:
        shape = of_effect(fit.values, term.name)
        for i, (name, p) in enumerate(term.by_name.items()):
            if p.linear:
                names.append(name)
                forces.append(unit_force(term, i, shape, run))
    if not forces:
        return {}
    answers = base.beyond_base(base.fold.answers(np.column_stack(forces)))
    return dict(zip(names, answers.T, strict=True))
