"""Controller parity: whether the recorded command follows from the measured position.

The control law is fed with the measured position and compared with the recorded command. That
needs no model of the plant, and separates a wrong controller, a log that is shifted in time, a
limit that nobody declared, and an added input that was not applied as recorded, from everything
behind the command.

signals      what a law sees of a record, what was recorded, and the error between them
limit        where the command sits at a limit, which nobody may have declared
gains        what settings, other than the declared ones, explain it, and how late
compared     the comparison, and the law that the record shows
rate         at which rate the controller acted, where its logs have several
"""

from .compared import (
    SUMMED,
    Parity,
    another,
    as_read,
    at_limit,
    at_motion,
    check,
    doubted,
    effects,
    otherwise_derived,
    unit,
)
from .limit import beyond
from .rate import by_another, known_oversampling, multiple, rates
from .signals import Signals, grid

__all__ = [
    "SUMMED",
    "Parity",
    "Signals",
    "another",
    "as_read",
    "at_limit",
    "at_motion",
    "by_another",
    "beyond",
    "check",
    "doubted",
    "effects",
    "known_oversampling",
    "multiple",
    "grid",
    "otherwise_derived",
    "rates",
    "unit",
    "relative",
]
