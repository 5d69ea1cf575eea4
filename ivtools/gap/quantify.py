"""Quantify: how far the gap shrinks once the named effects are in the model."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import signal, stats

from ..linalg import rms
from ..loop import ClosedLoop
from ..record import Record
from ..units import JOINTS, plain_number, prefixed
from .attribute import Attribution
from .candidate import gone_on, phases
from .fit import Fit, gauss_newton
from .floor import Floor, Measured
from .fold import Fold
from .rules import ADEQUATE, CLEAN, CONFIDENCE, HARDLY_ANY, LEAST_BLOCKS, RETUNED

Array = NDArray[np.float64]


def shown(
    error: float, unit: str, interval: tuple[float, float] | None = None, like: float = np.nan
) -> str:
    """Return an error for people, perhaps with its interval, in the prefix of another one.

    Examples
    --------
    >>> shown(1.234, "N", (1.1, 1.4)), shown(0.109, "N m", like=0.055)
    ('1.23 N [1.1, 1.4]', '109 mN m')
    """
    if not np.isfinite(error):
        return "no figure, for the simulation diverges"
    factor, unit = prefixed(like if np.isfinite(like) else error, unit)
    text = f"{plain_number(factor * error)} {unit}"
    low, high = (plain_number(factor * x) for x in interval or (0.0, 0.0))
    return text if interval is None else f"{text} [{low}, {high}]"


@dataclass(frozen=True)
class Judged:
    """Force errors, N or N m rms, on a record that took part in nothing.

    Parameters
    ----------
    record : str
    before, after, after_frozen : float
        As in `Shrink`.
    interval, interval_frozen : tuple of float
        95 % intervals of `after` and `after_frozen`, by blocks.
    """

    record: str
    before: float
    after: float
    after_frozen: float
    interval: tuple[float, float]
    interval_frozen: tuple[float, float]

    def said(self, unit: str) -> str:
        """Return the errors, N or N m, as a sentence."""
        like = _largest(self.before, self.after)
        before, after, frozen = (
            shown(x, unit, interval, like)
            for x, interval in (
                (self.before, None),
                (self.after, self.interval),
                (self.after_frozen, self.interval_frozen),
            )
        )
        return (
            f"on {self.record}, which only judges: {before} -> {after}; with the first record's "
            f"base parameters: {frozen}"
        )


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
    after_frozen : float
        As `after`, but the base parameters are those of the first record: the model as it would
        be handed over. `after` tunes them again, which judges the structure alone.
    interval_frozen : tuple of float
        95 % interval of `after_frozen`, by blocks.
    force : float
        Measured force, rms.
    signals : mapping
        (before, after) rms of position, velocity and acceleration.
    judged : Judged or None
        The same figures on a third record that took part in nothing.
    """

    unit: str
    before: float
    after: float
    corrected: float
    interval: tuple[float, float]
    floor: float
    held_out: bool
    after_frozen: float
    interval_frozen: tuple[float, float]
    force: float
    signals: dict[str, tuple[float, float]]
    judged: Judged | None = None

    @property
    def closed(self) -> float:
        """Fraction of the reducible gap that is closed; all of one in which the loop diverges."""
        if not np.isfinite(self.before):
            return float(np.isfinite(self.after))
        reducible = self.before - self.floor
        closed = (self.before - self.after) / reducible if reducible > 0 else 0.0
        return float(np.clip(closed, -1.0, 1.0))

    @property
    def remainder(self) -> float:
        """What `after` leaves beyond the floor, in energy, N or N m rms."""
        return float(np.sqrt(max(self.after**2 - self.floor**2, 0.0)))

    @property
    def put_right(self) -> bool:
        """Whether what was put right of the controller is worth a word."""
        return self.corrected < (1.0 - HARDLY_ANY) * self.before

    @property
    def diverges(self) -> bool:
        """Whether the loop diverges as it was declared."""
        return not np.isfinite(self.before)

    @property
    def gap(self) -> float:
        """What `before` has beyond the floor, in energy, N or N m rms."""
        return float(np.sqrt(max(self.before**2 - self.floor**2, 0.0)))

    def reaching(self, share: float) -> Shrink:
        """Return it where a law without a name leaves this share of `after`: no floor is above."""
        return replace(self, floor=min(self.floor, share * self.after))

    def slight(self, tolerance: float) -> bool:
        """Whether `after` leaves less beyond the floor than so many per cent of the force."""
        return 100.0 * self.remainder < tolerance * self.force

    def of_force(self, error: float) -> float:
        """Return an error in per cent of the measured force."""
        return 100.0 * error / max(self.force, 1e-300)

    def shown(self, error: float, interval: tuple[float, float] | None = None) -> str:
        """Return one of the errors for people, all of them with one prefix."""
        return shown(error, self.unit, interval, _largest(self.before, self.after))

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
            "after_frozen": self.after_frozen,
            "interval_frozen": list(self.interval_frozen),
            "signals": {n: {"before": b, "after": a} for n, (b, a) in self.signals.items()},
            "judged": None if self.judged is None else asdict(self.judged),
        }


@dataclass(frozen=True, eq=False)
class Traces:
    """Signals for the figures, on the record that judged.

    Where the loop diverges as it was declared, there is no `before`: it is as `after`.
    """

    record: Record
    keep: NDArray[np.bool_]
    measured: Array
    before: Array
    after: Array
    spectra: tuple[Array, Array, Array, Array]


def declared(loop: ClosedLoop, m: Measured, fold: Fold) -> Fit:
    """Fit a loop that the record did not put right, to samples of it."""
    fold = replace(fold, record=m.logged)
    return gauss_newton(fold, loop, m.base.values, m.base.free)


def how_far(
    plain: Fit,
    measured: tuple[Measured, ...],
    result: Attribution,
    fold: Fold,
    held_out: bool,
    named: bool,
) -> tuple[Shrink, Traces]:
    """Return how far the gap closes, and the signals that show it.

    If nothing is named it does not, but for what was put right of the controller, if that helps.
    """
    fold = fold.at_limit_too
    after = _judged(_tuned(measured, result), fold)
    before = replace(plain, fold=replace(plain.fold, keep=fold.keep))
    parity = measured[-1].parity
    right = not (parity.mismatch or parity.taken)
    same = right and parity.delay == parity.declared.delay
    if not named and (same or after.force_rms > before.force_rms):
        after = before
    still = replace(after, values=_handed_over(result.fits[0], after))
    level = measured[-1].floor
    plain_base = result.base[-1] if len(measured) == 1 else measured[-1].base
    corrected = replace(plain_base, fold=fold)
    e0, e1, e2, e3 = (f.force_error for f in (before, after, still, corrected))
    shrink = Shrink(
        unit=JOINTS[after.loop.joint].force,
        before=rms(e0),
        after=rms(e1),
        corrected=rms(e3),
        interval=_interval(e1, fold),
        floor=min([_reachable(level, after), *map(rms, (e0, e1, e2))]),
        held_out=held_out,
        after_frozen=rms(e2),
        interval_frozen=_interval(e2, fold),
        force=fold.force_rms(after.loop),
        signals=_signals(before, after),
    )
    record, e1 = fold.record, after.whole_error
    e0 = e1 if shrink.diverges else before.whole_error
    force = after.loop.force(record)[:, 0]
    return shrink, Traces(record, fold.keep, force, e0, e1, _spectra(record.dt, e0, e1, level))


def beside(
    measured: tuple[Measured, ...],
    result: Attribution,
    fold: Fold,
    force: Array,
    both: NDArray[np.bool_] | None = None,
) -> tuple[float, float]:
    """Return the force error without and with a further force in the model, N or N m rms.

    As `Shrink.after`: the loop is simulated with it, the base parameters are tuned beside it.

    Parameters
    ----------
    measured, result, fold
        As for `how_far`.
    force : ndarray, (n_samples,)
        Along the record that judges, against the motion, N or N m.
    both : ndarray of bool, (n_samples,), optional
        Where it is known, if not everywhere: nothing else is judged then.
    """
    tuned = _tuned(measured, result)
    if both is not None:
        fold = fold.only(both)
        tuned = tuned.refit(tuned.fold.only(both), iterations=RETUNED)
    more = tuned.refit(replace(tuned.fold, against=force), iterations=RETUNED)
    without, after = (
        _judged(fit, replace(fold, against=fit.fold.against)).force_rms for fit in (tuned, more)
    )
    return without, after if np.isfinite(after) else without  # a loop that diverges closes nothing


def _tuned(measured: tuple[Measured, ...], result: Attribution) -> Fit:
    """Return the model with what is named, its base parameters tuned on the record that judges."""
    return result.held[-1] if result.named or len(measured) == 1 else measured[-1].base


def _judged(tuned: Fit, fold: Fold) -> Fit:
    """Return a model on all that is judged."""
    if fold.doubt is None or tuned.fold.n_kept >= fold.n_kept:
        return replace(tuned, fold=fold)
    # what is likeliest of the load hangs together with the base parameters, on all of that
    return tuned.refit(fold, iterations=RETUNED)


def _handed_over(fit: Fit, own: Fit) -> dict[str, float]:
    """Return the values of a fit, with the phases that a record has of its own."""
    return {**fit.values, **{n: own.values[n] for n in phases(fit.loop)}}


def judge(loop: ClosedLoop, third: Measured, result: Attribution) -> Judged:
    """Return the figures of a record that took part in nothing."""
    fold = third.fold.at_limit_too
    plain = declared(loop, third, fold)
    fit = result.fits[0]
    free = [n for n in fit.free if n in loop.parameters or n in phases(fit.loop)]
    model = replace(fit.loop, controller=third.base.loop.controller)
    start = {**fit.values, **{n: third.base.values[n] for n in third.base.free}}
    after = replace(gone_on(gauss_newton(third.fold, model, start, free)), fold=fold)
    still = replace(after, values=_handed_over(fit, after))
    e, kept = after.force_error, still.force_error
    return Judged(
        third.fold.record.name,
        plain.force_rms,
        rms(e),
        rms(kept),
        _interval(e, fold),
        _interval(kept, fold),
    )


def _reachable(level: Floor, after: Fit) -> float:
    """Return the force error that could be reached, N or N m rms.

    The difference of two records of one motion is the floor, whatever the model leaves. Else, where
    the whitened error is at its floor, nothing is left to close and what remains is the floor: the
    noise model alone, which knows little below some hertz, would set it too low.
    """
    if level.between is not None:
        return level.between
    left = after.force_rms
    limit = min(level.level, left)
    return limit + (left - limit) * float(
        np.clip((ADEQUATE - after.cost) / (ADEQUATE - CLEAN), 0.0, 1.0)
    )


def _spectra(dt: float, e0: Array, e1: Array, level: Floor) -> tuple[Array, Array, Array, Array]:
    """Return frequency, and amplitude densities of the errors and of the noise model."""
    hz, before = signal.welch(e0, 1.0 / dt, nperseg=min(2048, len(e0)))
    after = signal.welch(e1, 1.0 / dt, nperseg=min(2048, len(e1)))[1]
    _, gain = signal.freqz([1.0], level.whitener, worN=2 * np.pi * hz * dt)
    return hz, np.sqrt(before), np.sqrt(after), np.sqrt(2.0 * dt) * np.abs(gain)


def _largest(*errors: float) -> float:
    """Return the largest of some errors that is finite, else NaN."""
    return max((x for x in errors if np.isfinite(x)), default=float("nan"))


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
    reach = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, count - 1) * spread / np.sum(sums)) / 2.0
    return rms(e) * float(np.exp(-reach)), rms(e) * float(np.exp(reach))


def _signals(before: Fit, after: Fit) -> dict[str, tuple[float, float]]:
    record, keep = after.fold.record, after.fold.keep
    measured = _motion(record, after.loop)
    runs = [f.simulation.motion for f in (before, after)]
    return {
        name: (rms((m - runs[0][i])[keep]), rms((m - runs[1][i])[keep]))
        for i, (name, m) in enumerate(
            zip(("position", "velocity", "acceleration"), measured, strict=True)
        )
    }


def _motion(record: Record, loop: ClosedLoop) -> tuple[Array, ...]:
    return tuple(loop.pipeline(record).differentiate(record.q, record.dt))
