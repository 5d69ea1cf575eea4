"""Candidate: one effect in the model, fitted on one fold and judged on the other.

starts      from which values it is fitted
attempt     the fits on each fold, and on the other one with its values frozen
trial       what they tell
"""

from .attempt import attempt, deeper, frozen, gone_on, phases, retuned
from .trial import Trial

__all__ = ["Trial", "attempt", "deeper", "frozen", "gone_on", "phases", "retuned"]
