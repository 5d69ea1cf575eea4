"""Diagnose the sim-to-real gap: where, which effect, how far it closes.

gap = iv.diagnose(record, loop, holdout=other)
print(gap.summary())
fleet = iv.diagnose_fleet(Path("logs").glob("*.csv"), loop, path="fleet")

The rooms, roughly in the order in which a record flows through them:

preflight parity                     is the input fit, and put right; what does its controller show
between band                         the same, if the log has only some of its samples, or its noise
fold response floor                  what counts of it, how it answers, its base model and its noise
library screen spatial_lines         effects that may be missing, each by itself, to first order
fit candidate                        any model on one fold; one effect more, judged on the other one
discrepancy                          smooth laws, which may explain what names do; one is described
attribute                            which effects are named, and how sure that is
quantify locate advice verdict       how far the gap closes, where it is, what to record, the answer
diagnose diagnosis page              what calls all of these, its answer, the page of that
simulator robot fleet                a simulator of one's own; n joints; many records
rules                                every threshold that decides anything
"""

from .diagnose import diagnose
from .diagnosis import Diagnosis
from .fleet import Entry, Fleet, diagnose_fleet
from .robot import RobotDiagnosis, diagnose_robot
from .rules import Rules
from .verdict import VERDICTS, Ranked

__all__ = [
    "VERDICTS",
    "Diagnosis",
    "Entry",
    "Fleet",
    "Ranked",
    "RobotDiagnosis",
    "Rules",
    "diagnose",
    "diagnose_fleet",
    "diagnose_robot",
]
