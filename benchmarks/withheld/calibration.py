"""Calibration: do the stated intervals and probabilities mean what they say?"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

#: Suites whose stated probabilities are judged; with the truth outside the library none is right.
JUDGED = ("single", "none", "two", "background", "clear", "bursts", "small", "unknown")


def wilson(good: int, n: int) -> tuple[float, float]:
    """Return the 95 % interval of a rate.

    >>> [round(x, 3) for x in wilson(19, 20)]
    [0.764, 0.991]
    """
    if n == 0:
        return float("nan"), float("nan")
    found = stats.binomtest(good, n).proportion_ci(method="wilson")
    return float(found.low), float(found.high)


def coverage(table: pd.DataFrame, which: str = "") -> pd.Series:
    """Return, per case with a true figure, whether the stated interval holds it.

    Parameters
    ----------
    table : DataFrame
    which : {"", "_frozen"}
        The interval of `after`, or of `after_frozen`.
    """
    names = [f"true_after{which}", f"low{which}", f"high{which}"]
    true, low, high = (table.dropna(subset=names)[n] for n in names)
    return (low <= true) & (true <= high)


def stated(rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Return one row per name that came with a probability: suite, effect, p, right.

    A name is right if it, or what it is said to be not told from, is in the truth.
    """
    found = []
    for row in rows:
        if "found" not in row:
            continue
        truth, answer = set(row["label"]["effects"]), row["found"]
        for effect, p in (answer.get("probability") or {}).items():
            names = {effect, *answer["ambiguous_with"].get(effect, ())}
            found.append((row["suite"], effect, float(p), bool(names & truth)))
    return pd.DataFrame(found, columns=["suite", "effect", "p", "right"])


@dataclass(frozen=True)
class Reliability:
    """Stated against observed probability.

    Parameters
    ----------
    p, rate, low, high, count : ndarray, (n_bins,)
        Mean stated probability, share that was right with its 95 % interval, and cases per bin.
    brier : float
        Mean square of probability less outcome; 0.25 says nothing.
    error : float
        Mean distance of the bins from the diagonal, weighted by their cases.
    """

    p: np.ndarray
    rate: np.ndarray
    low: np.ndarray
    high: np.ndarray
    count: np.ndarray
    brier: float
    error: float


def reliability(names: pd.DataFrame, bins: int = 6) -> Reliability | None:
    """Return the reliability of stated probabilities, in bins of about equal counts."""
    if len(names) < 2 * bins:
        return None
    p, right = names["p"].to_numpy(), names["right"].to_numpy(dtype=float)
    edges = np.unique(np.quantile(p, np.linspace(0.0, 1.0, bins + 1)))
    at = np.clip(np.searchsorted(edges, p, side="right") - 1, 0, max(len(edges) - 2, 0))
    groups = [at == k for k in np.unique(at)]
    count = np.array([g.sum() for g in groups])
    mean = np.array([p[g].mean() for g in groups])
    rate = np.array([right[g].mean() for g in groups])
    low, high = np.array([wilson(int(right[g].sum()), int(g.sum())) for g in groups]).T
    error = float(np.sum(count * np.abs(mean - rate)) / len(p))
    return Reliability(mean, rate, low, high, count, float(np.mean((p - right) ** 2)), error)
