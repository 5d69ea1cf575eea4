"""The control law, read from a record: which kind, which gains, and what no law explains."""

from .report import ControllerFit
from .search import identify, least

__all__ = ["ControllerFit", "identify", "least"]
