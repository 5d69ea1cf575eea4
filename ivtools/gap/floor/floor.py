"""Floor: what no model of the axis could close.

The noise of the command is modelled after every smooth law of the state has been taken out, on
windows that are quiet both at high and at low frequency. The laws are fitted on all samples first,
then on the windows that no event stands out of.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal, stats

from ...errors import EstimationError
from ...limits import LARGEST
from ...linalg import NoiseModel, fir, independent, rms, swing
from ...loop import Simulation
from ...physics import EFFECTS
from .. import spatial_lines
from ..band import below
from ..fit import Fit
from ..fold import Fold
from ..response import features, memories, mixed, waves
from ..rules import (
    ASTRAY,
    EVENT_TIME,
    FEW_EVENTS,
    FREQUENCIES,
    FULL,
    LAG_WINDOW,
    LARGEST_ROOT,
    LEARNT,
    LEAST_LEFT,
    LINE_PERIODS,
    MOST,
    NOISE_ORDER,
    PER_COEFFICIENT,
    QUIET,
    RELATED_PERIODS,
    SAME_LAW,
    SHOWN,
    SLOW_FORCE,
    SLOW_HZ,
    SPLIT_HZ,
    SWINGING,
    WINDOW,
)
from .events import events, lasting, stretches, unchanged, windows
from .repeats import passes, reference_period

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Floor:
    """Noise of a record, and what is not repeatable in it.

    Parameters
    ----------
    whitener : ndarray, (order + 1,)
        Polynomial that turns the noise, N or N m, into white noise of variance 1.
    noise : float
        Noise of the force, N or N m rms.
    generic : float
        Mean square of the whitened error that smooth laws of the state leave; 1 is the floor.
    passes : float or None
        Rms of the pass-to-pass difference over sqrt(2), N or N m.
    between : float or None
        The same between two records of one reference and the same known inputs.
    events : tuple of (float, float)
        Start and end, s, of stretches that no law of the state explains.
    event_mask : ndarray of bool, (n_samples,)
    excess : float
        By how much these stretches stand out in the force, in energy, N or N m rms.
    once : bool
        Whether another record shows nothing of what makes them: many are events then, too.
    """

    whitener: Array
    noise: float
    generic: float
    passes: float | None
    events: tuple[tuple[float, float], ...]
    event_mask: Mask
    between: float | None = None
    excess: float = 0.0
    once: bool = False

    @property
    def level(self) -> float:
        """The floor, N or N m: between records where there are such, else the lowest within."""
        if self.between is not None:
            return self.between
        return self.noise if self.passes is None else min(self.noise, self.passes)

    @property
    def surprise(self) -> float:
        """Energy of what is new in the noise from sample to sample, N2 or (N m)2."""
        return float(self.whitener[0]) ** -2

    @property
    def isolated(self) -> bool:
        """Whether few stretches stand out: events, not a way of the model to be wrong."""
        few = self.once or len(self.events) <= FEW_EVENTS
        most = MOST if self.once else EVENT_TIME
        return bool(self.events) and few and float(np.mean(self.event_mask)) < most


def measure(fit: Fit, raw: Array, unknown: Array | None = None) -> Floor:
    """Measure the floor of a fold.

    Parameters
    ----------
    fit : Fit
        A fit of the base model on unwhitened error.
    raw : ndarray, (n_samples,)
        Force error of that fit, N or N m.
    unknown : ndarray, (n_samples, m), optional
        What the command answers to what is not known of the load: neither noise nor an event.
    """
    fold, keep, response = fit.fold, fit.fold.keep, fit.fold.response
    dt = fold.record.dt
    _require(raw)
    simulation = fit.denoised
    columns = response(features(simulation))
    if unknown is not None:
        columns = np.hstack([columns, unknown])
    rest = _project(columns, fit, raw, keep)
    rounded = unchanged(fold.record.q[:, 0])
    found = swing.Swings(response(simulation.ddq[:, 0]), keep, dt).strongest(rest)
    if found.share > SWINGING:  # a load that hangs from the axis would pass for slow noise
        ringing = found.swing.of(simulation.ddq[:, 0], dt)
        ringing = np.hstack([ringing, found.swing.begun(len(raw), dt)])
        columns = np.hstack([columns, response(ringing)])
        rest = _project(columns, fit, raw, keep)
    most = SLOW_FORCE * fold.force_rms(fit.loop)
    for k in range(LEARNT):
        noise = _without_slow_forces(rest, keep, dt, most)
        whitener = autoregression(noise, _quiet(noise, keep, dt))
        white = fir(whitener, noise)
        taken = (columns.shape[1] + fit.J.shape[1] + NOISE_ORDER) / max(int(keep.sum()), 1)
        scale = _level(white, keep, dt) / np.sqrt(max(1.0 - taken, MOST))  # degrees of freedom
        whitener = whitener / scale
        if k == 0:  # these would pass for coloured noise, and what remembers may pass for an event
            lines = _lines(fold, rest, whitener, simulation)
            more = np.hstack([lines, memories(simulation), mixed(simulation)])
            columns = np.hstack([columns, response(more)])
        rest = _refit(columns, fit, raw, whitener, keep & ~events(white / scale, keep, dt, rounded))
    white = fir(whitener, rest)
    mask = events(white, keep, dt, rounded)
    if not mask.any():  # what short windows show has sharper ends there
        mask = lasting(white, keep, dt, rounded)
    return Floor(
        whitener=whitener,
        noise=_size(whitener, _taken(columns, fit, whitener), dt),
        generic=float(np.mean(white[keep & ~mask] ** 2)),
        passes=passes(raw, keep & ~mask, reference_period(fold.record), dt),
        events=stretches(mask, fold.record.t),
        event_mask=mask,
        excess=_excess(rest, keep, mask),
    )


def _excess(e: Array, keep: Mask, mask: Mask) -> float:
    """Return how much larger an error is where a mask is, in energy, N or N m rms."""
    if not (keep & mask).any() or not (keep & ~mask).any():
        return 0.0
    there, elsewhere = (float(np.mean(e[part] ** 2)) for part in (keep & mask, keep & ~mask))
    return float(np.sqrt(max(there - elsewhere, 0.0)))


def _require(x: Array) -> None:
    """Refuse an error that a simulation makes that has diverged."""
    if not (np.abs(x) < LARGEST).all():
        raise EstimationError(
            "the simulated loop diverges: check the controller, its delay and the inertia"
        )


def _lines(fold: Fold, rest: Array, whitener: Array, simulation: Simulation) -> Array:
    """Return waves over position at the strongest periods, plain, by load and by speed.

    With those that are related to them, if all together are most of the rest: the harmonic of a
    large line would be learnt as noise.
    """
    fold = replace(fold, whitener=whitener)
    white, terms = fold.white(rest), tuple(EFFECTS.values())
    found = spatial_lines.search(fold, white, simulation, terms, count=1)
    longest = float(np.ptp(simulation.where)) / LINE_PERIODS
    ways = {
        name: [k * p for p in periods for k in RELATED_PERIODS if k * p <= longest]
        for name, periods in found.items()
    }
    wide, e = waves(simulation, terms, ways), rest[fold.keep]
    heard = fold.response(wide)[fold.keep]
    _require(heard)
    own = heard @ independent(heard, SAME_LAW)
    left = e - own @ (own.T @ e)
    return wide if left @ left < (1.0 - MOST) * float(e @ e) else waves(simulation, terms, found)


def _project(columns: Array, fit: Fit, raw: Array, keep: Mask) -> Array:
    """Return the raw error without what features and base model explain, (n_samples,)."""
    basis = np.column_stack([columns[keep], fit.J])
    alone = independent(basis, SAME_LAW)
    rest = np.zeros(len(raw))
    rest[keep] = raw[keep] - basis @ (alone @ (alone.T @ (basis.T @ raw[keep])))
    return rest


def _refit(columns: Array, fit: Fit, raw: Array, whitener: Array, typical: Mask) -> Array:
    """Do as `_project` by generalised least squares, on the typical samples only.

    What hardly acts there, as a friction at reversals where each of them is an event, stays: fitted
    to the little that shows of it, it would be anything where it acts. How little is too little
    shows elsewhere, where a law that goes astray leaves far more than there was.
    """
    full = np.zeros((len(raw), fit.J.shape[1]))
    full[fit.fold.keep] = fit.J
    basis = np.column_stack([columns, full])
    white = fir(whitener, np.column_stack([basis, raw]))
    _require(white)
    A, b = white[:, :-1], white[typical, -1]
    alone = independent(A[fit.fold.keep], SAME_LAW)
    B = A[typical] @ alone
    share, within = np.linalg.eigh(B.T @ B)  # of their energy
    sizes = within.T @ (B.T @ b)
    elsewhere, rest = fit.fold.keep & ~typical, raw
    most = ASTRAY * np.linalg.norm(raw[elsewhere])
    for least in SHOWN:
        shown = share > least
        rest = raw - basis @ (alone @ (within[:, shown] @ (sizes[shown] / share[shown])))
        if np.linalg.norm(rest[elsewhere]) <= most:
            break
    return np.asarray(rest)


def _without_slow_forces(x: Array, keep: Mask, dt: float, most: float) -> Array:
    """Return an error with as much that is slow as noise has, if it is too much to be noise.

    No sensor makes much of it; a force does, which a noise model of a few milliseconds would learn.
    As much as noise has is what the next octave has.
    """
    for hz in SLOW_HZ:
        slow, both = (below(x * keep, top, dt) for top in (hz, 2.0 * hz))
        parts = (slow[keep], (both - slow)[keep])
        size, next_octave = map(rms, parts)
        if size > max(most, next_octave):
            x = x - (1.0 - next_octave / size) * slow
    return x


def _quiet(x: Array, keep: Mask, dt: float) -> Mask:
    """Return the samples of windows that are quiet above and below 12 Hz."""
    low = below(x, SPLIT_HZ, dt)
    good = np.ones(0, dtype=bool)
    for part in (low, x - low):
        energy, counts, width = windows(part**2, keep, dt)
        full = counts >= FULL * width
        level = np.quantile(energy[full], QUIET) if full.any() else np.inf
        ok = full & (energy <= level)
        good = ok if not len(good) else good & ok
    mask = np.zeros(len(x), dtype=bool)
    mask[: len(good) * width] = np.repeat(good, width)
    return mask if mask.sum() > PER_COEFFICIENT * NOISE_ORDER else keep


def autoregression(x: Array, mask: Mask) -> Array:
    """Return the whitening polynomial of the masked samples by the Yule-Walker equations."""
    x = np.where(mask, x, 0.0)
    pairs = [float(mask[k:].astype(float) @ mask[: len(x) - k]) for k in range(NOISE_ORDER + 1)]
    r = np.array([x[k:] @ x[: len(x) - k] / max(n, 1.0) for k, n in enumerate(pairs)])
    r *= np.exp(-0.5 * (LAG_WINDOW * np.arange(len(r))) ** 2)  # keeps the polynomial stable
    r[0] *= 1.0 + 1e-6
    if not r[0] > 0.0:
        return np.ones(1)
    return _stable(NoiseModel.from_autocovariance(r).inverse)


def _stable(whitener: Array) -> Array:
    """Return the polynomial with its roots inside the unit circle: gaps may have moved them out."""
    roots = np.roots(whitener)
    size = np.abs(roots)
    if not np.any(size >= 1.0):
        return whitener
    inside = np.minimum(np.where(size >= 1.0, 1.0 / size, size), LARGEST_ROOT)
    return np.asarray(np.real(np.poly(inside * np.exp(1j * np.angle(roots)))))


def _level(white: Array, keep: Mask, dt: float) -> float:
    """Return the robust noise level: the median over windows, corrected to a mean."""
    energy, counts, width = windows(white**2, keep, dt)
    full = counts >= FULL * width
    if not full.any():
        return rms(white[keep])
    correction = (1.0 - 2.0 / (9.0 * width)) ** 3
    return float(np.sqrt(np.median(energy[full]) / correction))


def _taken(columns: Array, fit: Fit, whitener: Array) -> Array:
    """Return the share of noise that fitted columns take out, by frequency, (n_frequencies,).

    The leverage of the whitened columns, which are smooth: they take much of slow noise and
    nothing of fast one.
    """
    full = np.zeros((len(columns), fit.J.shape[1]))
    full[fit.fold.keep] = fit.J
    white = fir(whitener, np.column_stack([columns, full]))
    white[~fit.fold.keep] = 0.0
    basis = white @ independent(white, SAME_LAW)
    length = fft.next_fast_len(len(basis), real=True)
    edges = np.linspace(0, length // 2 + 1, FREQUENCIES + 1).astype(int)[:-1]
    spectra = fft.rfft(np.ascontiguousarray(basis.T), length)  # strided: three times as long
    power = np.sum(spectra.real**2 + spectra.imag**2, axis=0) / int(fit.fold.keep.sum())
    return np.add.reduceat(power, edges) / np.diff(np.r_[edges, len(power)])


def _size(whitener: Array, taken: Array, dt: float) -> float:
    """Return the rms of the noise that this polynomial whitens.

    The polynomial comes from what fitted columns left, in the quieter windows: what both took is
    given back. Fast noise is whitened to its own level and needs nothing.

    Parameters
    ----------
    whitener : ndarray, (order + 1,)
    taken : ndarray, (n_frequencies,)
        Share of the noise that was fitted away, from 0 to half the rate.
    dt : float
    """
    width = 0.5 / dt / len(taken)  # Hz
    hz = width * (np.arange(len(taken)) + 0.5)
    power = 1.0 / np.abs(signal.freqz(whitener, worN=hz, fs=1.0 / dt)[1]) ** 2
    freedom = 2.0 * SPLIT_HZ * WINDOW  # of the slow part of a window
    quiet = stats.chi2.cdf(stats.chi2.ppf(QUIET, freedom), freedom + 2.0) / QUIET
    left = np.where(hz < SPLIT_HZ, quiet, 1.0) * np.maximum(1.0 - taken, LEAST_LEFT)
    return float(np.sqrt(np.sum(power / left) * width * 2.0 * dt))
