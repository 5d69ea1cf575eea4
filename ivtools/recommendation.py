"""Recommendation: which of several results to take, and why."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ivtools.results import FitResults

Figures = Mapping[tuple[str, str], float]

ALIKE = 1.01  # errors within this factor of the least one say nothing about which is better
SIGNIFICANT = 0.01  # p value from which a test counts against a result
CRITERIA = {
    ("simulated-holdout", "force"): "hold-out force error",
    ("relative_error", "cross-test"): "cross-test error",
    ("simulated", "force"): "simulated force error",
    ("relative_error", "direct"): "relative error",
}
"""What results are ranked by: the first that any of them has."""


@dataclass(frozen=True)
class Recommendation:
    """The result to take.

    Attributes
    ----------
    label : str
        Of the result in the comparison; empty if none can be recommended.
    reason : str
        In one line.
    """

    label: str
    reason: str

    def __str__(self) -> str:
        return f"Recommended: {self.label or 'none'}: {self.reason}"


@dataclass(frozen=True)
class _Candidate:
    label: str
    fit: FitResults
    error: float
    doubts: tuple[str, ...]

    @property
    def rank(self) -> tuple[int, int, float]:
        """Among those alike: the fewest doubts, then the simplest model, then the least error."""
        return len(self.doubts), len(self.fit.names), self.error


def recommend(
    labels: Sequence[str], fits: Sequence[FitResults], figures: Sequence[Figures]
) -> Recommendation | None:
    """Recommend one result: converged, of least error, and with no test against it.

    Those within 1 % of the least error count as alike; among them decide the doubts that tests
    raise, then the number of parameters.

    Parameters
    ----------
    labels, fits, figures : sequences
        Of the same length; the figures of a result by (group, quantity), in %.

    Returns
    -------
    Recommendation or None
        None if there is nothing to choose from.
    """
    if not fits:
        return None
    lost = [label for label, fit in zip(labels, fits, strict=True) if not fit.converged]
    key = _criterion(fits, figures)
    if key is None:
        return Recommendation("", "nothing has converged" if lost else "no error is known")
    rejected = _rejected(fits)
    found = [
        _Candidate(label, fit, _error(key, fit, values), _doubts(fit, rejected))
        for label, fit, values in zip(labels, fits, figures, strict=True)
        if math.isfinite(_error(key, fit, values))
    ]
    least = min(candidate.error for candidate in found)
    best = min((c for c in found if c.error <= ALIKE * least), key=lambda c: c.rank)
    return Recommendation(best.label, _reason(best, found, CRITERIA[key], lost))


def _criterion(fits: Sequence[FitResults], figures: Sequence[Figures]) -> tuple[str, str] | None:
    """Return the first criterion that a converged result has a figure for."""
    pairs = list(zip(fits, figures, strict=True))
    known = (key for key in CRITERIA if any(math.isfinite(_error(key, *pair)) for pair in pairs))
    return next(known, None)


def _error(key: tuple[str, str], fit: FitResults, figures: Figures) -> float:
    """Return a result's figure; NaN if it has not converged, or if that is of another signal."""
    other = key == ("relative_error", "direct") and fit.signal != "force"
    return math.nan if other or not fit.converged else figures.get(key, math.nan)


def _rejected(fits: Sequence[FitResults]) -> dict[tuple[str, ...], float]:
    """Return, per model, the p value by which instruments find least squares biased."""
    found: dict[tuple[str, ...], float] = {}
    for fit in fits:
        test = fit.wu_hausman() if fit.converged else None
        if test is not None and test.pvalue is not None and test.pvalue < SIGNIFICANT:
            found[fit.names] = min(test.pvalue, found.get(fit.names, 1.0))
    return found


def _doubts(fit: FitResults, rejected: Mapping[tuple[str, ...], float]) -> tuple[str, ...]:
    """Return what tests have against a result."""
    doubts = []
    measured = fit.Z is None and fit.n_simulations == 0  # least squares on the measured motion
    if measured and fit.names in rejected:
        doubts.append(f"least squares is biased (Wu-Hausman, p = {rejected[fit.names]:.1g})")
    strength = fit.weak_instruments()
    if strength.applies and "not weak" not in strength.reason:
        doubts.append("its instruments are weak")
    if vague := fit.not_identifiable():
        doubts.append(f"{listed(vague)} known to 10 % at best")
    return tuple(doubts)


def listed(names: Sequence[str], most: int = 6) -> str:
    """Write names, of many the first and how many more.

    Examples
    --------
    >>> listed(["a", "b"]), listed("abcdefgh", 3)
    ('a, b', 'a, b, c and 5 more')
    """
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _reason(
    best: _Candidate, found: Sequence[_Candidate], criterion: str, lost: Sequence[str]
) -> str:
    """Write why, in one line."""
    others = sorted((c for c in found if c is not best), key=lambda c: c.error)
    passed = [c for c in others if c.error <= best.error and c.doubts]
    size = "least" if not others or best.error <= others[0].error else "within 1 % of the least"
    next_best = f"; {others[0].label} {others[0].error:.4g} %" if others else ""
    parts = [f"converged, {size} {criterion} ({best.error:.4g} %{next_best})"]
    parts += [f"but {doubt}" for doubt in best.doubts] or ["no test against it"]
    parts += [f"{c.label} is passed over, as {' and '.join(c.doubts)}" for c in passed[:1]]
    parts += [f"not converged: {', '.join(lost)}"] * bool(lost)
    return "; ".join(parts)
