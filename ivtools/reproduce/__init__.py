"""The EMPS report, reproduced: every number that it prints beside the one computed here."""

from __future__ import annotations

from ivtools.reproduce.clocks import CLOCKS, Clock
from ivtools.reproduce.reproduction import Reproduction, Row, reproduce
from ivtools.reproduce.rows import Printed, printed

__all__ = ["CLOCKS", "Clock", "Printed", "Reproduction", "Row", "printed", "reproduce"]
