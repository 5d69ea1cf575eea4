"""Spatial lines: what is periodic over position in the gap, found for all periods at once.

Correlating the gap with the answer to cos(2 pi q/p) equals correlating the gap, filtered backwards
through that answer, with the cosine itself. Summed over position first, one FFT then gives every
period.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..linalg import fir
from ..loop import Simulation
from ..physics import Term
from .fold import Fold
from .response import weight
from .rules import (
    FAINT_LINE,
    LINE_BINS,
    LINE_PERIODS,
    LINE_SPEEDS,
    LINE_TOP,
    LINES,
    LINES_APART,
    NEARLY_ALL,
    PADDING,
    POSITION_BINS,
)

Array = NDArray[np.float64]


def search(
    fold: Fold, e: Array, simulation: Simulation, terms: Sequence[Term], count: int = LINES
) -> dict[str, list[float]]:
    """Return the most likely spatial periods for each effect that has one, m or rad.

    Parameters
    ----------
    fold : Fold
        With its whitener.
    e : ndarray, (n_kept,)
        Whitened error, free of what the base model explains.
    simulation : Simulation
        Of the base model.
    terms : sequence of Term
        Effects; those that are not periodic over position are passed over.
    count : int
        Periods per effect.
    """
    v, tau = simulation.dq[:, 0], simulation.tau[:, 0]
    names = [t.name for t in terms if t.search == "lines"]
    weights = [weight(t, v, tau) for t in terms if t.search == "lines"]
    found = strongest(fold, e, simulation, weights, count)
    return dict(zip(names, found, strict=True))


def strongest(
    fold: Fold, e: Array, simulation: Simulation, weights: Iterable[Array], count: int
) -> list[list[float]]:
    """Return the most likely periods of waves with each of some weights, (n_samples,)."""
    q, v = simulation.where, simulation.dq[:, 0]
    full = np.zeros(len(q))
    full[fold.keep] = e
    back = fold.response.adjoint(fir(fold.whitener, full[::-1])[::-1])
    return [_peaks(q, v, back, w, fold, count) for w in weights]


def _peaks(q: Array, v: Array, back: Array, weight: Array, fold: Fold, count: int) -> list[float]:
    """Return the periods with the largest explained energy."""
    stroke = float(np.ptp(q))
    density, _ = np.histogram(
        q, bins=POSITION_BINS, range=(q.min(), q.max()), weights=back * weight
    )
    lines = np.abs(np.fft.rfft(density, PADDING * POSITION_BINS)) ** 2
    k = np.arange(len(lines)) / (PADDING * stroke)  # 1/m
    top = LINE_TOP / fold.record.dt / max(np.quantile(np.abs(v), NEARLY_ALL), 1e-300)
    use = (k > LINE_PERIODS / stroke) & (k < min(top, POSITION_BINS / (LINE_BINS * stroke)))
    if not use.any():
        return []
    k, lines = k[use], lines[use]
    explained = lines / _energy(k, v, weight, fold)
    return [1.0 / k[i] for i in _maxima(explained, count, LINES_APART * PADDING)]


def _energy(k: Array, v: Array, weight: Array, fold: Fold) -> Array:
    """Return the whitened energy of the answer to a unit line at each wave number."""
    impulse, whitener = fold.response.impulse, fold.whitener
    heard, white = (np.fft.rfft(x, POSITION_BINS) for x in (impulse, whitener))
    gain = np.abs(heard * white) ** 2
    energy, edges = np.histogram(np.abs(v), bins=LINE_SPEEDS, weights=weight**2 * fold.keep)
    speeds = 0.5 * (edges[1:] + edges[:-1])
    hz = np.fft.rfftfreq(POSITION_BINS, fold.record.dt)
    total = np.zeros(len(k))
    for speed, share in zip(speeds, energy, strict=True):
        total += 0.5 * share * np.interp(speed * k, hz, gain, right=gain[-1])
    return total + FAINT_LINE * np.max(total)


def _maxima(x: Array, count: int, apart: int) -> list[int]:
    """Return where the largest values are, each more than so many places from the others."""
    found: list[int] = []
    for i in np.argsort(-x):
        if all(abs(int(i) - j) > apart for j in found):
            found.append(int(i))
        if len(found) == count:
            break
    return found
