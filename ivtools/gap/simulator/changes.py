"""What of a simulator's parameters is off against the axis, how surely, and what looks the same."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import stats

from ...physics import EFFECTS, Term
from ...simulators.difference import CREEPS, Difference, dry
from ...tables import Text, table
from ..diagnosis import Diagnosis
from ..fit import Fit, gauss_newton
from ..fold import better_t
from ..library import library
from ..rules import ADEQUATE, CONFIDENCE, DISCREPANCY_T, HARDLY_ANY, STICKS, SURE_T, TRADING, Rules


@dataclass(frozen=True)
class Change:
    """One parameter of the simulator, and what the axis has instead.

    Attributes
    ----------
    simulator, real, change : float
        As our model sees them, in `unit`.
    std_error : float
        Of the change; NaN where it is not known. It holds what noise does, block by block, how
        far an effect that helps but has no name would move the parameter, and what of the force
        does not cancel in the difference of the logs.
    interval : tuple of float
        95 % interval of the change: Student's, for the blocks of the record.
    unit : str
    """

    simulator: float
    real: float
    change: float
    std_error: float
    interval: tuple[float, float]
    unit: str

    def to_dict(self) -> dict[str, Any]:
        """Return the content as plain objects, ready for JSON."""
        known = bool(np.isfinite(self.std_error))
        unknown = {} if known else {"std_error": None, "interval": None}
        return {**asdict(self), "interval": list(self.interval), **unknown}


def settled(found: Diagnosis, pair: Difference, rules: Rules) -> tuple[Fit | None, bool]:
    """Return the final fit, and whether the axis sticks where its simulator creeps.

    Where the record does not show that more of the friction is dry than the simulator's, as much
    is: both parts together would trade with each other.
    """
    fit, base = found.whole, _named(pair)
    fit = None if fit is None else _kept(fit, base, rules)
    if fit is None or f"{CREEPS}.force" not in base or "coulomb" not in fit.free:
        return fit, False
    both = fit.values["coulomb"] + fit.values[f"{CREEPS}.force"]
    start = {"coulomb": base["coulomb"], f"{CREEPS}.force": max(both - base["coulomb"], 0.0)}
    soft = _tuned(fit, start, without=("coulomb",))
    if _as_good(soft, fit, rules):
        return soft, False
    return fit, dry(fit.values) - max(dry(base), 0.0) > STICKS  # less than none is by a pendulum


def changes(
    found: Diagnosis, pair: Difference, fit: Fit | None, stuck: bool, surplus: bool
) -> dict[str, Change]:
    """Return what must change in the simulator, parameter by parameter.

    An effect's values are zero on the side that lacks it.

    Parameters
    ----------
    found : Diagnosis
    pair : Difference
    fit, stuck
        As `settled` returns them.
    surplus : bool
        Whether what is named is what the simulator has and the axis has not.
    """
    base, values, errors, reach = _named(pair), dict(found.theta), dict[str, float](), np.nan
    if fit is not None:
        values, errors = {**values, **fit.values}, _errors(fit, found.alternatives)
        reach = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, max(len(fit.fold.blocks) - 1, 1)))
    if f"{CREEPS}.force" in base:
        values, base = values if stuck else _whole(values), _whole(base)
    sign, out = -1.0 if surplus else 1.0, {}
    for name, value in values.items():
        have = base.get(name, 0.0)
        one, two = (value, have) if surplus else (have, value)
        change = sign * (value - have)
        error = float(np.hypot(errors.get(name, np.nan), pair.second_order * value))
        interval = (change - reach * error, change + reach * error)
        out[name] = Change(one, two, change, error, interval, found.loop.units.get(name, ""))
    return out


def _named(pair: Difference) -> dict[str, float]:
    """Return the simulator's parameters, as our model sees them."""
    return {str(n): float(v) for n, v in pair.base.params.items()}


def _kept(fit: Fit, base: Mapping[str, float], rules: Rules) -> Fit:
    """Return a fit that differs from the simulator only where the record shows it.

    Columns that are all but one, as an offset and the cosine of a pendulum over a short arc, leave
    a direction in which parameters may move far and change nothing.
    """
    free = [n for n in fit.free if n in base and not n.startswith(CREEPS)]
    J = fit.J[:, [fit.free.index(n) for n in free]]
    scale = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    size, turn = np.linalg.eigh((J / scale).T @ (J / scale))
    moved = turn.T @ (scale * np.array([fit.values[n] - base[n] for n in free]))
    still = moved**2 * np.maximum(size, 0.0) < SURE_T**2 * fit.cost
    trades = size < size[-1] * np.where(still, *TRADING)
    if not trades.any():
        return fit
    change = (turn @ np.where(trades, 0.0, moved) / scale).tolist()
    held = {free[k] for k in np.argmax(np.abs(turn[:, trades]), axis=0)}  # one of each direction
    back = _tuned(fit, {n: base[n] + x for n, x in zip(free, change, strict=True)}, held)
    return back if _as_good(back, fit, rules) else fit


def _as_good(one: Fit, other: Fit, rules: Rules) -> bool:
    """Whether a fit leaves as much as another one, as far as their record tells."""
    return better_t([other.fold], [one.e], [other.e]) < DISCREPANCY_T


def _tuned(fit: Fit, values: Mapping[str, float], without: Collection[str] = ()) -> Fit:
    """Return a fit that goes on from given values, some of them no longer free."""
    return fit.refit(values=values, free=[name for name in fit.free if name not in without])


def _errors(fit: Fit, alternatives: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the standard error of every parameter of a fit.

    What an effect does that helps and yet has no name is in the base parameters: by how much it
    would move them counts as a deviation of theirs.

    J. A. Hoeting, D. Madigan, A. E. Raftery, C. T. Volinsky, "Bayesian model averaging: a
    tutorial", Statistical Science 14(4), 1999: the variance of an estimate is that within a model
    and that between the models.
    """
    sums = {name: [name] for name in fit.free}
    if f"{CREEPS}.force" in fit.values:  # of the sum: the parts trade with each other
        sums["coulomb"] = ["coulomb", f"{CREEPS}.force"]
    out = {}
    for name, parts in sums.items():
        moved = [
            sum(other[n] - fit.values[n] for n in parts)
            for other in alternatives
            if {*parts} <= {*other}
        ]
        out[name] = float(np.hypot(fit.deviation(parts), max(map(abs, moved), default=0.0)))
    return out


def _whole(values: Mapping[str, float]) -> dict[str, float]:
    """Return values with the friction that creeps in the Coulomb friction.

    That it creeps is how a simulator computes friction, no setting of the axis.
    """
    both = values["coulomb"] + values[f"{CREEPS}.force"]
    kept = {name: v for name, v in values.items() if not name.startswith(f"{CREEPS}.")}
    return {**kept, "coulomb": both}


# --- changes that look like an effect ------------------------------------------------------------


def twins(fit: Fit, pair: Difference, rules: Rules) -> dict[str, dict[str, dict[str, float]]]:
    """Return the effects that a change of one that the simulator has cannot be told from.

    A pendulum over a short arc is a spring: whether its weight has changed, or a spring is there
    that the simulator lacks, no such record says.

    Parameters
    ----------
    fit : Fit
        The final model on the record.
    pair : Difference
    rules : Rules

    Returns
    -------
    dict
        By effect that the simulator has and that changes: by name of an effect that would do as
        well with it as it is, the values of that effect.
    """
    base, found = _named(pair), {}
    for term in (t for t in fit.loop.terms if t.name in EFFECTS and {*t.names} <= {*base}):
        if term.name == CREEPS or not all(p.linear for p in term.parameters):
            continue
        begin = {n: v for n, v in base.items() if n in fit.values}  # offset and cosine are one
        frozen = _tuned(fit, begin, without=term.names)
        if (frozen.cost - fit.cost) * len(fit.e) < SURE_T**2:
            continue  # it does not change
        found[term.name] = {
            other.name: values
            for other in library(fit.loop)
            if other.law is not None and all(p.linear for p in other.parameters)
            if (values := _as_well(fit, frozen, other, rules)) is not None
        }
    return {name: others for name, others in found.items() if others}


def _as_well(fit: Fit, frozen: Fit, term: Term, rules: Rules) -> dict[str, float] | None:
    """Return the values of an effect that does as well as a change; None if it does not."""
    loop = frozen.loop.with_effect(term)
    values, free = loop.values(frozen.values), (*frozen.free, *term.names)
    other = gauss_newton(frozen.fold, loop, values, free)
    gain = (frozen.cost - other.cost) / (frozen.cost - fit.cost)
    near = gain > 1.0 - rules.equivalence and _as_good(other, fit, rules)
    same = gain > 1.0 - HARDLY_ANY and other.cost < ADEQUATE * fit.cost
    return {n: other.values[n] for n in term.names} if near or same else None


def changes_table(made: Mapping[str, Change]) -> Text:
    """Return the changes as a table."""
    rows = [
        [
            name,
            c.unit,
            f"{c.simulator:.5g}",
            f"{c.real:.5g}",
            f"{c.change:+.3g}",
            f"{c.interval[0]:+.3g} to {c.interval[1]:+.3g}" if np.isfinite(c.std_error) else "–",
        ]
        for name, c in made.items()
    ]
    header = ["parameter", "unit", "simulator", "real", "change", "95 % interval"]
    return table("Changes to your simulator", [], header, rows, left=2)
