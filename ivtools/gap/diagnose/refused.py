"""Refused: what is said where no diagnosis can begin."""

from __future__ import annotations

import numpy as np

from ...loop import ClosedLoop
from ...record import Record
from ..diagnosis import Diagnosis
from ..parity import Parity
from ..preflight import Finding, hanging
from ..rules import AT_CONTROLLER


def refused(
    record: Record, loop: ClosedLoop, checked: tuple[Parity, ...], found: list[Finding]
) -> Diagnosis:
    """Report what is wrong with the input instead of naming an effect simulated.

    Without a control law gravity shows all the same, and with one a limit that nobody declared.
    """
    controller = any(not p.trustworthy for p in checked)
    limits = [] if controller else [p.limit for p in checked if p.limit is not None]
    lawless = controller or not checked
    own = hanging(record, loop) if lawless and record.load is None else None  # else links hang
    named: dict[str, dict[str, float]] = {}
    if own is not None:
        found = [*found, Finding(own.text, fatal=False)]
        loop = loop.with_terms(*(t.name for t in loop.terms), "gravity")
        named = {"gravity": {"sin": own.sin, "cos": own.cos}}
    elif limits:
        named = {"saturation": {"limit": float(np.mean(limits))}}
    block = "controller" if controller or limits else "mechanics" if named else None
    return Diagnosis(
        verdict="partial" if named else "unexplained",
        effects=tuple(named),
        ambiguous_with={name: [] for name in named},
        parameters=named,
        block=block,
        findings=tuple(found),
        parity=checked,
        loop=loop,
        name=record.name,
        probability={"saturation": AT_CONTROLLER} if limits else {},
    )
