"""Task: what a diagnosis is asked, what is known beforehand, and whom it tells how far it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from ...loop import ClosedLoop
from ...physics import Term
from ...record import Record
from ..fold import Link
from ..parity import Parity
from ..preflight import Finding
from ..rules import TOLERANCE, Rules


class Inspected(NamedTuple):
    """What records and their control law show, whatever loads the axis.

    Attributes
    ----------
    checked : tuple of Parity
        Of each record that is given.
    found : tuple of Finding
    """

    checked: tuple[Parity, ...]
    found: tuple[Finding, ...]

    def under(self, loop: ClosedLoop) -> Inspected:
        """Return the same of another model of the axis, with that law."""
        laws = (replace(loop, controller=p.loop.controller) for p in self.checked)
        pairs = zip(self.checked, laws, strict=True)
        return self._replace(checked=tuple(replace(p, loop=law) for p, law in pairs))


Say = Callable[[str], None]


def mute(text: str) -> None:
    """Show no progress."""


@dataclass(frozen=True, eq=False)
class Task:
    """What a diagnosis is asked: as for `diagnose`, and what its callers inside the toolkit add.

    Parameters
    ----------
    whole : bool, optional
        Whether the final model is fitted to all of the record.
    described : bool, optional
        Whether a force without a name is described.
    links : sequence of Link or None, optional
        What the links of a robot leave unknown of the load, of each record that is given.
    places : mapping of str to mapping, optional
        Where valleys of an effect are known to be: a search that begins in one ends there.
    inspected : Inspected, optional
        What another diagnosis of the same records found, under other loads.
    """

    record: Record
    loop: ClosedLoop
    holdout: Record | None = None
    judge: Record | None = None
    tolerance: float = TOLERANCE
    rules: Rules = field(default_factory=Rules)
    extra: Sequence[Term] = ()
    without: Sequence[str] = ()
    links: Sequence[Link | None] = ()
    whole: bool = False
    described: bool = True
    places: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    inspected: Inspected | None = None

    @property
    def records(self) -> tuple[Record, ...]:
        """The record, and the holdout if there is one."""
        return (self.record,) if self.holdout is None else (self.record, self.holdout)

    @property
    def given(self) -> dict[str, Record]:
        """Every record that there is, by the name of its attribute."""
        named = {"record": self.record, "holdout": self.holdout, "judge": self.judge}
        return {role: one for role, one in named.items() if one is not None}
