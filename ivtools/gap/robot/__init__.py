"""Robot: n joints, diagnosed one by one.

links        what errors of the other joints say of the load that the links put on this one
alone        a joint as an axis, what its links ask of it as a known load
behind       how a link moves that is a second mass, behind a spring or a backlash of its drive
joint        one joint from round to round, beside what swings in the others
joints       all joints in turn, the robot identified again with what was named
diagnosis    the answers of all joints, and what they do to the whole
"""

from .alone import alone
from .diagnosis import RobotDiagnosis
from .joint import assumed
from .joints import diagnose_robot, identified

__all__ = ["RobotDiagnosis", "alone", "assumed", "diagnose_robot", "identified"]
