"""Diagnose the sim-to-real gap: where, which effect, how far it closes.

gap = iv.diagnose(record, loop, holdout=other)
print(gap.summary())
"""

from .diagnosis import VERDICTS, Diagnosis, Ranked
from .process import diagnose
from .trial import Rules

__all__ = ["VERDICTS", "Diagnosis", "Ranked", "Rules", "diagnose"]
