"""Diagnose: the process.

process     what a user calls; one BLAS thread for as long as it runs
begun       the base model and the floor of each record, nothing named yet
finished    what is named, where the gap is, and how far it closes
refused     what is said where no diagnosis can begin
"""

from .begun import Begun, Task, begin
from .finished import finish
from .process import diagnose

__all__ = ["Begun", "Task", "begin", "diagnose", "finish"]
