"""Discrepancy: a force that repeats and is no known effect, described instead of named."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...linalg import rms
from ...loop import Simulation
from ...units import JOINTS, plain_number, prefixed, quantity
from ..fit import Fit, normal
from ..rules import POSITION_KNOTS, SOME
from .laws import Laws, Spline
from .smooth import Basis, signals

Array = NDArray[np.float64]
_Curve = tuple[tuple[float, float, float], ...]

_NAMES = {
    "q": "position",
    "dq": "speed",
    "load": "load",
    "drive": "the force of the drive",
    "state": "position and speed together",
    "gain": "load times position or speed",
    "past": "the motion before",
    "heat": "how much moved before",
    "warm": "how much moved before",
    "wave": "position (periodic)",
    "swing": "the swing of a load",
}
#: What is asked of the axis for each of them; "past" is the motion before.
_SIGNALS = {
    "state": ("q", "dq"),
    "gain": ("load", "q", "dq"),
    "heat": ("dq", "past"),
    "warm": ("dq", "past"),
    "wave": ("q", "dq"),
    "swing": ("ddq", "past"),
}
#: Over what the curve of each is drawn, if not over speed.
_ALONG = {"load": "load", "drive": "drive", **dict.fromkeys(("q", "state", "gain", "wave"), "q")}
_DIRECTED = {"q", "dq", "load", "state"}  # differ forwards and backwards
_MOST_SAID = 3  # in a sentence


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """A force that the model lacks, comes again, and is not among the known effects.

    Parameters
    ----------
    rms : float
        Of the force beyond what the base parameters make, N or N m, on the last fold.
    unit : str
    over : tuple of str
        What it depends on, of `smooth.OVER`; where one of `_DIRECTED` is among it, on the direction
        of motion as well.
    gain : float
        Share of the whitened energy left that it removes on held-out data.
    before, after : float
        The force error without and with it in the model, beside all that is named and what was put
        right of the controller, N or N m rms, where both records have been. The loop is simulated
        with the force that the other fold alone gives along this motion; what is finer than its
        knots is left, so another law may leave less.
    curve : tuple of (float, float, float)
        Over the signal `along`: its value (SI), and the mean force forwards and backwards.
    period : float
        One that is periodic over position has its curve within a period, m or rad; 0 is none.
    """

    rms: float
    unit: str
    over: tuple[str, ...]
    gain: float
    before: float
    after: float
    curve: _Curve
    period: float = 0.0

    @property
    def text(self) -> str:
        """What is there, and what such a law would leave, as a sentence."""
        return (
            f"a force of {quantity(self.rms, self.unit, 2)} rms repeats over {self.said} and is "
            f"not among the known effects; a {self.law} would leave {self.leaves}"
        )

    @property
    def law(self) -> str:
        """What kind of law it is."""
        return "smooth law with a memory" if "past" in self.signals else "smooth static law"

    @property
    def leaves(self) -> str:
        """What of the force error it leaves, in words."""
        factor, unit = prefixed(self.before, self.unit)
        after, before = (plain_number(factor * x, 2) for x in (self.after, self.before))
        share = "nearly all" if after == before else f"about {after}"
        if self.after > self.before:  # along another motion
            share = "all"
        return f"{share} of {before} {unit} rms"

    @property
    def along(self) -> str:
        """The signal of its curve: q, dq, load or drive."""
        return _ALONG.get(self.over[0], "dq")

    @property
    def said(self) -> str:
        """What it depends on, in words, the most telling first."""
        apart = [n for n in self.over if n not in _SIGNALS["state"] or "state" not in self.over]
        names = [*dict.fromkeys(_NAMES[n] for n in apart)]
        some = names[:_MOST_SAID]
        if len(names) > _MOST_SAID:
            last = "others"
        else:
            last = "direction" if _DIRECTED & {*self.over} else some.pop()
        first = ", ".join(some)
        if " and " in first:  # position and speed together
            first += ","
        return " and ".join(filter(None, (first, last)))

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals that it depends on: q, dq, ddq, load, drive, past."""
        return tuple(dict.fromkeys(s for n in self.over for s in _SIGNALS.get(n, (n,))))

    def to_dict(self) -> dict[str, object]:
        """Return the JSON of the discrepancy."""
        return {
            "rms": self.rms,
            "unit": self.unit,
            "over": list(self.signals),
            "repeats": True,
            "gain": self.gain,
            "before": self.before,
            "after": self.after,
            "curve": [list(point) for point in self.curve],
            "period": self.period,
        }


def describe(
    fits: Sequence[Fit], judged: Callable[[Array], tuple[float, float]], laws: Laws | None = None
) -> Discrepancy | None:
    """Return the force that repeats in what two fits leave; None if there is none.

    Parameters
    ----------
    fits : sequence of Fit
        The model with all that is named, on each fold.
    judged : callable
        Returns the force error of that model, N or N m rms, without and with a force along the
        record of the last fold.
    laws : Laws, optional
        Made along the motion of a model much like it; without them, along its own.
    """
    laws = laws or Laws.of(fits)
    found = laws.fitted(fits) if laws is not None else None
    if laws is None or found is None or not found.over:
        return None
    forces = found.force()
    beyond = [_beyond(x, f, r) for x, f, r in zip(forces, fits, laws.runs, strict=True)]
    counts = [x[f.fold.keep] for x, f in zip(beyond, fits, strict=True)]
    whole, there = map(rms, (np.concatenate(counts), counts[-1]))
    if whole < SOME * min(f.force_rms for f in fits):
        return None
    unit = JOINTS[fits[0].loop.joint].force
    period, curve = _curve(laws.basis, found, laws.runs, beyond)
    before, after = judged(_beyond(found.from_other()[-1], fits[-1], laws.runs[-1]))
    return Discrepancy(there, unit, found.over, found.gain, before, after, curve, period)


def _beyond(force: Array, fit: Fit, run: Simulation) -> Array:
    """Return what the base parameters cannot make of a force, N or N m, (n_samples,).

    A law has some of them as well, of any size: a fit tells only what they do together.
    """
    dq, keep = run.dq[:, 0], fit.fold.keep
    ddq = np.gradient(dq, fit.fold.record.dt)
    B = np.column_stack([ddq, dq, np.sign(dq), np.ones(len(dq))])
    B = B / np.maximum(np.linalg.norm(B[keep], axis=0), 1e-300)
    return np.asarray(force - B @ normal(B[keep], force[keep]))


def _curve(
    basis: Basis, found: Spline, runs: Sequence[Simulation], forces: Sequence[Array]
) -> tuple[float, _Curve]:
    """Return the mean force at the knots of one signal, forwards and backwards, and a period.

    Of the periods of one that is periodic over position, the one that shows most of it.
    """
    name = _ALONG.get(found.over[0], "dq")
    kinds = dict(zip(("q", "dq", "load"), signals(runs), strict=True))
    kinds["drive"] = kinds["load"]
    x = np.concatenate(kinds[name])
    x = x if name == "q" else np.abs(x)
    speed = np.concatenate(kinds["dq"])
    force = np.concatenate(forces)
    if found.over[0] != "wave":
        return 0.0, _means(basis.knots[name], x, speed, force)
    grids = [np.linspace(0.0, p, POSITION_KNOTS) for p in found.periods]
    curves = [_means(grid, x % grid[-1], speed, force) for grid in grids]
    sizes = [float(np.mean(np.square(c)[:, 1:])) if c else 0.0 for c in curves]
    best = int(np.argmax(sizes))
    return float(found.periods[best]), curves[best]


def _means(knots: Array, x: Array, speed: Array, force: Array) -> _Curve:
    """Return the mean force near each knot that is passed both ways, forwards and backwards."""
    hats, ways = Basis({"x": knots}).hats("x", x), (speed > 0.0, speed < 0.0)
    weight = [hats[rows].sum(axis=0) for rows in ways]
    mean = [hats[rows].T @ force[rows] / np.maximum(w, 1e-300)
            for rows, w in zip(ways, weight, strict=True)]  # fmt: skip
    seen = (weight[0] > 0.0) & (weight[1] > 0.0)
    points = np.column_stack([knots, *mean])[seen]
    return tuple((float(k), float(a), float(b)) for k, a, b in points)
