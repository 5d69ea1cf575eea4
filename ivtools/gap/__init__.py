"""Diagnose the sim-to-real gap: where, which effect, how far it closes.

gap = iv.diagnose(record, loop, holdout=other)
print(gap.summary())
fleet = iv.diagnose_fleet(Path("logs").glob("*.csv"), loop, path="fleet")
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
