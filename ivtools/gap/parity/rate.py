"""Rate: at which rate a controller acted, and under which law, as one of its logs shows it best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ...loop import ClosedLoop
from ...record import Record
from ..rules import FASTER, LAW_ERROR, LITTLE
from .compared import Parity


def known_oversampling(loop: ClosedLoop) -> int:
    """Return the oversampling that is known of a declared loop; 0: its records show it.

    A law that is identified has the rate of the log that it was identified from.
    """
    return int(loop.controller.kind == "identify")


def rates(compared: Sequence[tuple[Record, Parity]]) -> list[tuple[float, Parity]]:
    """Return the rates of a controller that its logs show, Hz, and what of them does, surest first.

    A log with all of its samples, where the law gives the command, shows it; one with some of them
    as far as noise lets it; one of which neither is known does not. First are the rates of which
    every log has a whole multiple.
    """

    def order(one: tuple[float, Parity]) -> tuple[bool, bool, bool, float]:
        """Return what they are sorted by."""
        hz, p = one
        fits = all(multiple(hz, r) for r, _ in compared)
        return not fits, p.oversampling > 1, p.below is not None, p.after

    shown = ((p.oversampling / r.dt, p) for r, p in compared if p.oversampling > 1 or p.whole)
    return sorted(shown, key=order)


def multiple(hz: float, record: Record) -> int:
    """Return how many samples a controller takes for each of a log; 0 if it is no whole number."""
    count = hz * record.dt
    whole = round(count)
    return whole if 1 <= whole <= FASTER[-1] and abs(count - whole) < LITTLE else 0


def by_another(own: Parity, right: Parity, surest: Parity) -> Parity:
    """Return the parity of a record under the law that another one shows to the last digit.

    Other settings that noise between the samples of a log may suggest are none of it.

    Parameters
    ----------
    own, right : Parity
        With the declared law, and with the one that the other record shows.
    surest : Parity
        Of that record.
    """
    if right.before >= LAW_ERROR:
        return own
    law = replace(right.declared, limit=right.loop.controller.limit)
    return replace(
        right,
        loop=replace(right.loop, controller=law),
        declared=surest.declared,
        before=own.before,
        after=right.before,
        mismatch=surest.mismatch,
    )
