"""Verdict: what the diagnosis says of what was attributed.

answer     one word, and what is to be said beside it
ranking    every effect that was tried, and how much each closes by itself
replica    whether a named effect does the same on either side

The thresholds are in `rules`. If all names together do not lower the force error (`lowers`), all of
them fall before there is an answer.
"""

from .answer import (
    OUTSIDE,
    VERDICTS,
    Setting,
    changes,
    decide,
    lowers,
    may_swing,
    no_better,
    remainder,
    tally,
)
from .ranking import SCREENED, Ranked, ranking
from .replica import Replica, replicas, replicate

__all__ = [
    "OUTSIDE",
    "SCREENED",
    "VERDICTS",
    "Ranked",
    "Replica",
    "Setting",
    "changes",
    "decide",
    "lowers",
    "may_swing",
    "no_better",
    "ranking",
    "remainder",
    "replicas",
    "replicate",
    "tally",
]
