"""Diagnose: the process.

process     what a user calls; one BLAS thread for as long as it runs
task        what is asked
input       records and control law, as they can be compared
begun       the base model and the floor of each record, nothing named yet
named       effects: on both records, on one alone, or without the stretches that stand out
finished    where the gap is, how far it closes; all names fall if together they lower no error
refused     what is said where no diagnosis can begin
"""

from .begun import Begun, begin
from .finished import finish
from .process import diagnose
from .refused import refused
from .task import Task

__all__ = ["Begun", "Task", "begin", "diagnose", "finish", "refused"]
