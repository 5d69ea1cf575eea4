"""The table of every printed number beside ours."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ivtools import axes, datasets
from ivtools.display import Displayed
from ivtools.estimators import IDIMLS
from ivtools.problem import Problem
from ivtools.reproduce import figures, toolboxes
from ivtools.reproduce.clocks import CLOCKS
from ivtools.reproduce.rows import SECTIONS, Printed, printed
from ivtools.results import FitResults
from ivtools.tables import Text, table


@dataclass(frozen=True)
class Row:
    """A printed number and ours; None if no method computes it yet."""

    printed: Printed
    ours: float | None

    @property
    def agrees(self) -> bool | None:
        """Whether the two agree; None if that is not judged."""
        return None if self.ours is None else self.printed.agrees(self.ours)

    @property
    def mark(self) -> str:
        """The verdict as it is shown."""
        if self.ours is None:
            return "not yet"
        if not self.agrees:
            return "-" if self.agrees is None else "DIFFERS"
        return "ok" if self.printed.rule == "digits" else f"ok ({self.printed.rule})"

    def cells(self) -> list[str]:
        """Return the row as text: what, unit, printed, ours, difference, mark."""
        p = self.printed
        name = f"{p.row} {p.quantity}"
        if self.ours is None:
            return [name, p.unit, p.text, "", "", self.mark]
        ours = f"{self.ours:.{p.decimals + 2}f}"
        difference = f"{p.last_digits(self.ours):+.2f}" if p.quantity != "time" else ""
        return [name, p.unit, p.text, ours, difference, self.mark]

    def to_dict(self) -> dict[str, Any]:
        """Return the content as plain objects, ready for JSON."""
        p = self.printed
        return {
            "section": p.section,
            "row": p.row,
            "quantity": p.quantity,
            "unit": p.unit,
            "printed": p.value,
            "ours": self.ours,
            "difference_last_digit": None if self.ours is None else p.last_digits(self.ours),
            "rule": p.rule,
            "agrees": self.agrees,
            "report_section": p.where,
        }


@dataclass(frozen=True, repr=False)
class Reproduction(Displayed):
    """Every number of the report beside ours.

    Attributes
    ----------
    rows : tuple of Row
        In the order of the report.
    clocks : mapping
        Relative errors of the simulated signals, in %, by section and clock.
    fits : mapping of str to FitResults
        The estimates: "identification" and "asymmetric".
    holdout : Problem
        The problem of the pulses record.
    """

    rows: tuple[Row, ...]
    clocks: Mapping[str, Mapping[str, Mapping[str, float]]]
    fits: Mapping[str, FitResults] = field(repr=False)
    holdout: Problem = field(repr=False)

    @property
    def ok(self) -> bool:
        """Whether every number that should agree does."""
        return all(row.agrees is not False for row in self.rows)

    def section(self, name: str) -> list[Row]:
        """Return the rows of a section."""
        return [row for row in self.rows if row.printed.section == name]

    def tables(self) -> Iterator[Text]:
        """Yield one table per section, and the clocks of the simulations after them."""
        for name, title in SECTIONS.items():
            header = ["", "unit", "printed", "ours", "last digits", ""]
            cells = [row.cells() for row in self.section(name)]
            yield table(title, [], header, cells, _NOTES.get(name, ()), left=2)
        yield self.clock_table()

    def clock_table(self) -> Text:
        """Return the simulated errors by clock, with the reasons of their differences."""
        header = ["relative error, %", "printed", *(clock.title for clock in CLOCKS)]
        cells = []
        for section, clocks in self.clocks.items():
            record = "pulses" if section.endswith("pulses") else "estimation"
            for signal in clocks["published"]:
                text = next(
                    row.printed.text
                    for row in self.section(section)
                    if row.printed.quantity == signal
                )
                ours = [f"{clocks[clock.name][signal]:.5g}" for clock in CLOCKS]
                cells.append([f"{record}: {signal}", text, *ours])
        return table("Why the simulations differ", [], header, cells, _CLOCK_NOTES)

    def summary(self) -> Text:
        """Return all tables and the verdict, at most 80 columns wide."""
        parts = [*self.tables(), self.verdict()]
        return Text("\n\n".join(parts), "".join(getattr(p, "html", p) for p in parts))

    def verdict(self) -> Text:
        """Return the result in one line."""
        judged = [row for row in self.rows if row.agrees is not None]
        wrong = [row for row in judged if not row.agrees]
        pending = sum(row.ours is None for row in self.rows)
        text = f"{len(judged) - len(wrong)} of {len(judged)} judged numbers agree"
        if wrong:
            names = ", ".join(" ".join(row.printed.key) for row in wrong[:3])
            text += f"; differing: {names}{' ...' if len(wrong) > 3 else ''}"
        if pending:
            text += f"; {pending} not yet"
        return Text(text, f"<p>{text}</p>")

    def to_dict(self) -> dict[str, Any]:
        """Return the content as plain objects, ready for JSON."""
        return {
            "ok": self.ok,
            "rows": [row.to_dict() for row in self.rows],
            "clocks": {k: {c: dict(e) for c, e in v.items()} for k, v in self.clocks.items()},
        }


def reproduce(data: str | Path | None = None) -> Reproduction:
    """Compute every number of the EMPS report.

    Parameters
    ----------
    data : str or Path, optional
        Folder of the two measured records.

    Returns
    -------
    Reproduction

    Raises
    ------
    DataError
        A record is not there and cannot be downloaded.

    Examples
    --------
    ::

        print(reproduce().summary())
    """
    record, pulses = datasets.emps(data), datasets.emps_pulses(data)
    loop = axes.emps()
    problem, holdout = Problem(record, loop), Problem(pulses, loop)
    asymmetric = Problem(record, loop.with_terms("inertia", "asymmetric-friction"))
    ls = IDIMLS(cov_type="classical")
    fits = {"identification": ls.fit(problem), "asymmetric": ls.fit(asymmetric)}
    found = figures.settings(record, problem)
    for section, fit in fits.items():
        found |= figures.estimate(section, fit) | figures.quality(section, fit, fit.errors)
    found |= figures.cross_test(fits["identification"], holdout)
    clocks = {}
    for section, driven in (("simulation", record), ("simulation-pulses", pulses)):
        found[section, "run", "time"] = figures.seconds(driven)
        clocks[section] = {
            c.name: c.relative_error(loop, driven, figures.published_theta()) for c in CLOCKS
        }
        for signal, error in clocks[section]["published"].items():
            found[section, "error", signal] = error
    found |= figures.transfer_functions(record)
    rows = tuple(Row(p, found.get(p.key)) for p in printed())
    return Reproduction(rows, clocks, fits, holdout)


_NOTES: Mapping[str, Sequence[str]] = {
    "simulation": [
        "Must agree: the position to its last digit, the others within 0.5 %. The published clock "
        "is explained in the last table; the time is that of this machine."
    ],
    "identification": ["Deviations are the classical ones, as the report has them."],
    "toolboxes": toolboxes.NOTES,
}
_CLOCK_NOTES = (
    "published: its sample time is t(10) - t(9), in the files 0.999984 ms and not 1 ms, so "
    "the simulated clock and the reference read at it drift by 0.4 ms over the record; pulses "
    "are interpolated and ramp up in the millisecond before each; sign(dq) has no rule of "
    "standstill and chatters.",
    "true clock: 1 kHz, pulses held over the sample; sign(dq) still chatters.",
    "standstill: as the true clock, and friction holds the axis where it can; this is what "
    "ivtools simulates by default.",
)
