"""Diagnose the sim-to-real gap: where, which effect, how far it closes.

gap = iv.diagnose(record, loop, holdout=other)
print(gap.summary())
fleet = iv.diagnose_fleet(Path("logs").glob("*.csv"), loop, path="fleet")
"""

from .diagnosis import VERDICTS, Diagnosis, Ranked
from .entry import Entry
from .fleet import Fleet
from .patrol import diagnose_fleet
from .process import diagnose
from .rules import Rules

__all__ = [
    "VERDICTS",
    "Diagnosis",
    "Entry",
    "Fleet",
    "Ranked",
    "Rules",
    "diagnose",
    "diagnose_fleet",
]
