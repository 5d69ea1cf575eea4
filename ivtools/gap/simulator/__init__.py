"""Simulator: what a user's own simulator lacks against the axis.

against    the difference of the two, diagnosed as an axis is
changes    which of its parameters are off, how surely, and what looks the same
confirm    its own logs with the changes, if it can be run
"""

from .against import against
from .changes import Change, changes_table
from .confirm import Confirmation, confirm, run

__all__ = ["Change", "Confirmation", "against", "changes_table", "confirm", "run"]
