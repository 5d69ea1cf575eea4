"""Preflight: are records and axis file fit to be judged, and what drives the simulated loop.

findings     faults of the input; after a fatal one no later check is made
plausible    units and signs that give themselves away
pull         what the loop follows, and what holds it where nothing else does
logged       what the log has made of signals: too few digits, a command that is late
hanging      gravity where no control law is known
"""

from .findings import (
    Finding,
    by_record,
    identifiable,
    identified,
    inspect,
    limited,
    named,
    one_way,
    only_one_way,
    other_law,
    overlap,
    require,
    same_axis,
    too_short,
)
from .hanging import Hanging, hanging
from .logged import (
    beyond_the_log,
    counted,
    derived,
    elsewhere,
    faster,
    finer,
    late,
    lateness,
    misplaced,
    near,
    noisy,
    origin,
)
from .plausible import doubts
from .pull import HELD, adrift, followed, lawless, pulled, rings

__all__ = [
    "Finding",
    "HELD",
    "Hanging",
    "adrift",
    "beyond_the_log",
    "by_record",
    "counted",
    "derived",
    "doubts",
    "elsewhere",
    "faster",
    "finer",
    "followed",
    "hanging",
    "identifiable",
    "identified",
    "inspect",
    "late",
    "lateness",
    "lawless",
    "limited",
    "misplaced",
    "named",
    "near",
    "noisy",
    "one_way",
    "only_one_way",
    "origin",
    "other_law",
    "overlap",
    "pulled",
    "require",
    "rings",
    "same_axis",
    "too_short",
]
