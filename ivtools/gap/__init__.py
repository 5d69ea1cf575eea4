"""Diagnose the sim-to-real gap: where, which effect, how far it closes.

gap = iv.diagnose(record, loop, holdout=other)
print(gap.summary())
fleet = iv.diagnose_fleet(Path("logs").glob("*.csv"), loop, path="fleet")

The rooms, in the order in which a record flows through them:

preflight plausible parity pull hanging    is the input fit, what does its controller show
fold response floor measured               what counts of it, how noisy it is, the model as declared
library screen spatial_lines               effects that may be missing, all at once
fit candidate smooth                       one of them, fitted on one fold and judged on the other
rounds evidence attribute                  which get a name, and how sure that is
discrepancy                                what repeats and has none
quantify locate advice verdict             how far the gap closes, where it is, what to record next
diagnose diagnosis page                    the process, its answer, the page of that
against changes confirm                    the same for a simulator of the user's own
links joints robot_diagnosis fleet         the joints of a robot; many records
rules                                      every threshold that decides anything
"""

from .diagnose import diagnose
from .diagnosis import Diagnosis
from .fleet import Entry, Fleet, diagnose_fleet
from .joints import diagnose_robot
from .robot_diagnosis import RobotDiagnosis
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
