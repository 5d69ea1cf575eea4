"""Quantify: how far the gap shrinks once the named effects are in the model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ..loop import ClosedLoop
from ..record import Record
from .fit import Fit
from .fold import Fold

Array = NDArray[np.float64]

_BLOCKS = 10  # at least, also of a short stretch


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
    if len(sums) < _BLOCKS:
        parts = np.array_split(e**2, _BLOCKS)
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
