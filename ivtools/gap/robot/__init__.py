"""Robot: n joints, diagnosed one by one.

links        what the other joints say of the load that the links put on one of them
joints       each joint in turn, and what was named in one in the load of the others
diagnosis    the answers of all joints, and what they do to the whole
"""

from .diagnosis import RobotDiagnosis
from .joints import alone, assumed, diagnose_robot, heard, identified

__all__ = [
    "RobotDiagnosis",
    "alone",
    "assumed",
    "diagnose_robot",
    "heard",
    "identified",
]
