"""Quantify: how far the gap shrinks once the named effects are in the model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import signal, stats

from ..loop import ClosedLoop
from ..record import Record
from .attribute import Attribution
from .fit import Fit, gauss_newton, steps
from .floor import Floor, Measured
from .fold import Fold
from .rules import ADEQUATE_NAMED, LEAST_BLOCKS

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Shrink:
    """The gap before and after, on data that the effects were not fitted to.

    Parameters
    ----------
    unit : str
        N or N m.
    before, after : float
        Force error of the simulation, rms.
    corrected : float
        As `before`, with what controller parity found put right and no effect in the model.
    interval : tuple of float
        95 % interval of `after`, by blocks.
    floor : float
        What no model could close, rms.
    held_out : bool
        Whether another record judged; else blocks of the same one.
    frozen : float
        As `after`, with the base parameters frozen as well.
    signals : mapping
        (before, after) rms of position, velocity and acceleration.
    """

    unit: str
    before: float
    after: float
    corrected: float
    interval: tuple[float, float]
    floor: float
    held_out: bool
    frozen: float
    signals: dict[str, tuple[float, float]]

    @property
    def closed(self) -> float:
        """Fraction of the reducible gap that is closed."""
        reducible = self.before - self.floor
        return (
            float(np.clip((self.before - self.after) / reducible, -1.0, 1.0))
            if reducible > 0
            else 0.0
        )

    def to_dict(self) -> dict[str, object]:
        """Return the JSON of the shrink."""
        return {
            "signal": "force",
            "unit": self.unit,
            "before": self.before,
            "after": self.after,
            "corrected": self.corrected,
            "interval": list(self.interval),
            "floor": self.floor,
            "closed": self.closed,
            "held_out": self.held_out,
            "frozen": self.frozen,
            "signals": {n: {"before": b, "after": a} for n, (b, a) in self.signals.items()},
        }


@dataclass(frozen=True, eq=False)
class Traces:
    """Signals for the figures, on the record that judged."""

    record: Record
    keep: NDArray[np.bool_]
    measured: Array
    before: Array
    after: Array
    spectra: tuple[Array, Array, Array, Array]


def declared(loop: ClosedLoop, measured: tuple[Measured, ...]) -> Fit:
    """Fit the loop as it was given, on the record that judges."""
    last = measured[-1]
    record = last.base.fold.record
    if last.parity.mismatch.get("added"):
        added = np.asarray(record.added) / (1.0 + last.parity.mismatch["added"])
        record = replace(record, added=added)
    fold = replace(last.side.fold, record=record)
    step = steps(fold, loop, last.side.scales)
    return gauss_newton(fold, loop, last.base.values, last.base.free, step, 5)


def how_far(
    declared: Fit,
    measured: tuple[Measured, ...],
    result: Attribution,
    judge: Fold,
    held_out: bool,
) -> tuple[Shrink, Traces]:
    """Return how far the gap closes, and the signals that show it."""
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
    return limit + (left - limit) * float(np.clip((ADEQUATE_NAMED - after.cost) / 0.1, 0.0, 1.0))


def _spectra(dt: float, e0: Array, e1: Array, level: Floor) -> tuple[Array, Array, Array, Array]:
    """Return frequency, and amplitude densities of the errors and of the noise model."""
    hz, before = signal.welch(e0, 1.0 / dt, nperseg=min(2048, len(e0)))
    after = signal.welch(e1, 1.0 / dt, nperseg=min(2048, len(e1)))[1]
    _, gain = signal.freqz([1.0], level.whitener, worN=2 * np.pi * hz * dt)
    return hz, np.sqrt(before), np.sqrt(after), np.sqrt(2.0 * dt) * np.abs(gain)


def quantify(
    before: Fit, corrected: Fit, after: Fit, frozen: Fit, floor: float, held_out: bool
) -> Shrink:
    """Measure the gap on the held-out fold, without and with the named effects."""
    fold = after.fold
    e0, e1, e2, e3 = (
        f.fold.force_error(f.loop, f.values)[f.fold.keep]
        for f in (before, after, frozen, corrected)
    )
    return Shrink(
        unit="N" if after.loop.joint == "prismatic" else "N m",
        before=_rms(e0),
        after=_rms(e1),
        corrected=_rms(e3),
        interval=_interval(e1, fold),
        floor=min(floor, _rms(e1), _rms(e0)),
        held_out=held_out,
        frozen=_rms(e2),
        signals=_signals(before, after),
    )


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _interval(e: Array, fold: Fold) -> tuple[float, float]:
    """Return the 95 % interval of the rms, from how the energy varies between blocks.

    A t interval of its logarithm: the resampled quantiles of some tens of blocks are too narrow,
    and energy is skewed.
    """
    sums, sizes = fold.block_sums(e**2), fold.block_sums(np.ones(len(e)))
    if len(sums) < LEAST_BLOCKS:
        parts = np.array_split(e**2, LEAST_BLOCKS)
        sums, sizes = (np.array([f(p) for p in parts]) for f in (np.sum, np.size))
    count, mean = len(sums), float(np.sum(sums) / np.sum(sizes))
    if not mean > 0.0:
        return 0.0, 0.0
    spread = np.linalg.norm(sums - mean * sizes) * np.sqrt(count / (count - 1.0))
    reach = float(stats.t.ppf(0.975, count - 1) * spread / np.sum(sums)) / 2.0
    return _rms(e) * float(np.exp(-reach)), _rms(e) * float(np.exp(reach))


def _signals(before: Fit, after: Fit) -> dict[str, tuple[float, float]]:
    record, keep = after.fold.record, after.fold.keep
    measured = _motion(record, after.loop)
    runs = [f.fold.simulate(f.loop, f.values).motion for f in (before, after)]
    return {
        name: (_rms((m - runs[0][i])[keep]), _rms((m - runs[1][i])[keep]))
        for i, (name, m) in enumerate(
            zip(("position", "velocity", "acceleration"), measured, strict=True)
        )
    }


def _motion(record: Record, loop: ClosedLoop) -> tuple[Array, ...]:
    return tuple(loop.pipeline(record).differentiate(record.q, record.dt))
