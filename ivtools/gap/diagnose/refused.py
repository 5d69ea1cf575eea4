"""Refused: what is said where no diagnosis can begin."""

from __future__ import annotations

from ...loop import ClosedLoop
from ...record import Record
from ..diagnosis import Diagnosis
from ..parity import Parity
from ..preflight import Finding, hanging


def refused(
    record: Record, loop: ClosedLoop, checked: tuple[Parity, ...], found: list[Finding]
) -> Diagnosis:
    """Report what is wrong with the input instead of naming an effect simulated.

    Without a control law gravity shows all the same.
    """
    controller = any(not p.trustworthy for p in checked)
    own = hanging(record, loop) if controller or not checked else None
    if own is not None:
        found = [*found, Finding(own.text, fatal=False)]
        loop = loop.with_terms(*(t.name for t in loop.terms), "gravity")
    return Diagnosis(
        verdict="unexplained" if own is None else "partial",
        effects=() if own is None else ("gravity",),
        ambiguous_with={} if own is None else {"gravity": []},
        parameters={} if own is None else {"gravity": {"sin": own.sin, "cos": own.cos}},
        block="controller" if controller else None if own is None else "mechanics",
        regions=(),
        shrink=None,
        ranking=(),
        advice=(),
        findings=tuple(found),
        parity=checked,
        floors=(),
        loop=loop,
        theta={},
        chi=(float("nan"), float("nan")),
        name=record.name,
    )
