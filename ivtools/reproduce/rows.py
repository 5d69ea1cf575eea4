"""Printed numbers, and when a computed one agrees with them."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from pathlib import Path

FILE = Path(__file__).parents[1] / "published" / "emps_report.csv"

SECTIONS = {
    "settings": "Settings",
    "identification": "IDIM-LS on the estimation record",
    "cross-test": "Cross-test on the pulses record",
    "simulation": "Simulation of the estimation record, published clock",
    "simulation-pulses": "Simulation of the pulses record, published clock",
    "asymmetric": "Asymmetric friction (equation 12)",
    "toolboxes": "Transfer functions (CAPTAIN, CONTSID)",
}


@dataclass(frozen=True)
class Printed:
    """A number as a report prints it.

    Attributes
    ----------
    section, row, quantity, unit : str
        What it is.
    text : str
        The number with its printed digits.
    rule : str
        "digits", "x %" or "none": how closely a computed number must agree.
    where : str
        Section of the report.

    Examples
    --------
    >>> row = Printed("identification", "M1", "value", "kg", "95.1089", "digits", "3.4")
    >>> row.value, row.decimals, row.agrees(95.10894), row.agrees(95.1088)
    (95.1089, 4, True, False)
    >>> round(row.last_digits(95.1091), 3)
    2.0
    """

    section: str
    row: str
    quantity: str
    unit: str
    text: str
    rule: str
    where: str

    @property
    def key(self) -> tuple[str, str, str]:
        """What identifies the number."""
        return self.section, self.row, self.quantity

    @property
    def value(self) -> float:
        """The printed number."""
        return float(self.text)

    @property
    def decimals(self) -> int:
        """Number of printed decimals."""
        return len(self.text.partition(".")[2])

    def last_digits(self, ours: float) -> float:
        """Return the difference to a number in units of the last printed digit."""
        return (ours - self.value) * 10.0**self.decimals

    def agrees(self, ours: float) -> bool | None:
        """Return whether a number agrees by the rule; None if it is not judged."""
        if self.rule == "none":
            return None
        if self.rule == "digits":
            return bool(abs(self.last_digits(ours)) <= 0.5 + 1e-6)
        share = float(self.rule.removesuffix("%"))
        return bool(abs(ours - self.value) <= share / 100.0 * abs(self.value))


@cache
def printed() -> tuple[Printed, ...]:
    """Return every number that the EMPS report prints, in the order of the table.

    Examples
    --------
    >>> len(printed()), printed()[6].text
    (74, '95.1089')
    """
    lines = FILE.read_text(encoding="utf-8").splitlines()
    rows = csv.DictReader(line for line in lines if not line.startswith("#"))
    return tuple(
        Printed(
            r["section"], r["row"], r["quantity"], r["unit"], r["printed"], r["rule"], r["where"]
        )
        for r in rows
    )


def value(section: str, row: str, quantity: str) -> float:
    """Return one printed number.

    Examples
    --------
    >>> value("identification", "M1", "value")
    95.1089
    """
    (found,) = (p.value for p in printed() if p.key == (section, row, quantity))
    return found
