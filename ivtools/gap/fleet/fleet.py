"""Fleet: the diagnoses of many records, side by side."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from statistics import median
from textwrap import wrap
from typing import TYPE_CHECKING, Any, ClassVar

from ...display import Displayed
from ...files import write
from ...physics import EFFECTS, PHASES
from ...tables import Text, csv, table
from ...units import plural, prefixed
from ..verdict import tally
from .entry import FAILED, Entry
from .shelf import PAGES

if TYPE_CHECKING:
    import pandas as pd

    from ...report import Card, Page

TABLE, OVERVIEW = "fleet.csv", "index.html"
_HEADER = ("record", "verdict", "effects", "before", "after", "closed")
_EFFECTS, _REMARKS = 21, 12  # columns of the effects; remarks shown
_ROOM = 80 - _EFFECTS - 3 * 6 - 5 * 2  # columns that name and verdict share


@dataclass(frozen=True, eq=False)
class Fleet(Displayed):
    """The diagnoses of many records.

    Parameters
    ----------
    entries : tuple of Entry
        One per record, in the order that they were given; ``fleet["name"]`` is one of them.
    axis : str
        Name of the model.
    folder : Path or None
        Where the pages are.
    """

    figure: ClassVar[str] = "fleet.fleet"

    entries: tuple[Entry, ...]
    axis: str
    folder: Path | None = None

    def __len__(self) -> int:
        return len(self.entries)

    def __iter__(self) -> Iterator[Entry]:
        return iter(self.entries)

    def __getitem__(self, name: str) -> Entry:
        return next(e for e in self.entries if e.name == name)

    @property
    def done(self) -> tuple[Entry, ...]:
        """The entries that have a diagnosis."""
        return tuple(e for e in self.entries if e.content is not None)

    @property
    def failed(self) -> tuple[Entry, ...]:
        """The entries that have none."""
        return tuple(e for e in self.entries if e.content is None)

    @property
    def unit(self) -> str:
        """Unit of the force error."""
        return next((e.shrink["unit"] for e in self.entries if e.shrink), "N")

    def _unit_of(self, effect: str, parameter: str) -> str:
        """Return the unit of a parameter of a known effect; a number has none."""
        joint = "revolute" if self.unit == "N m" else "prismatic"
        known = EFFECTS[effect].parameters if effect in EFFECTS else ()
        units = {p.name: p.unit_for(joint) for p in known if p.unit != "1"}
        return units.get(parameter, "")

    def frame(self) -> pd.DataFrame:
        """Return one row per record: verdict, effects, force errors, and each parameter named.

        The columns of parameters are called ``effect.parameter``; force errors are rms.
        """
        import pandas as pd

        return pd.DataFrame([e.row() for e in self.entries])

    def to_dict(self) -> list[dict[str, Any]]:
        """Return one object per record: the JSON of ``ivtools diagnose``, with name and file."""
        return [e.to_dict() for e in self.entries]

    def summary(self) -> Text:
        """Return the fleet as a table."""
        room = _ROOM - max((len(e.verdict) for e in self.entries), default=0)
        rows = [row for e in self.entries for row in _rows(e, room)]
        head = [*self._lines(), f"before and after: force error on held-out data, {self.unit} rms"]
        made = table(self._title, head, _HEADER, rows, self._notes(), left=3)
        return Text(made, self._html(f"{self.folder or '.'}/{PAGES}"))

    @property
    def _title(self) -> str:
        return f"Fleet of {self.axis}: {plural(len(self), 'record')}"

    def _lines(self) -> list[str]:
        """Return how many records have which verdict, and show which effect."""
        verdicts = Counter(e.verdict for e in self.entries)
        lines = ["verdicts: " + ", ".join(f"{v} {n}" for v, n in verdicts.most_common())]
        for effect, parameters in self.effects().items():
            count = sum(effect in e.effects for e in self.entries)
            ranges = "; ".join(
                f"{name} {_range(values, self._unit_of(effect, name))}"
                for name, values in parameters.items()
                if values
            )
            text = f"{effect}: named in {count} of {len(self)}{'; ' * bool(ranges)}{ranges}"
            lines += wrap(text, 78, subsequent_indent="  ", break_on_hyphens=False)
        return lines

    def effects(self) -> dict[str, dict[str, list[float]]]:
        """Return the values of every parameter of the effects that are named, most frequent first.

        Left out: the phase of a periodic effect, which differs from record to record, and 0.
        """
        counts = Counter(name for e in self.entries for name in e.effects)
        found: dict[str, dict[str, list[float]]] = {name: {} for name, _ in counts.most_common()}
        for entry in self.done:
            assert entry.content is not None
            for effect, values in entry.content["parameters"].items():
                for parameter, value in values.items():
                    if parameter not in PHASES and value != 0.0:
                        found.setdefault(effect, {}).setdefault(parameter, []).append(value)
        return found

    def _notes(self) -> list[str]:
        remarks = [f"{e.name}: {e.remark}" for e in self.entries if e.remark]
        notes = remarks[:_REMARKS]
        if len(remarks) > _REMARKS:
            notes.append(f"... and {len(remarks) - _REMARKS} more records with remarks")
        reused = sum(e.reused for e in self.entries)
        if reused:
            notes.append(f"{reused} of {len(self)} were diagnosed before: not computed again")
        if self.done and not any(e.judged_by for e in self.entries):
            notes.append("no hold-out: the stretches of each record judged each other")
        return notes

    def stopped(self, asked: int) -> str:
        """Return what to say when a run ends early."""
        text = f"interrupted with {len(self.done)} of {asked} records diagnosed"
        if self.folder is None:
            return f"{text}; with a folder (--out) the next run would go on from there"
        return f"{text}; they are in {self.folder}, and the same command goes on from there"

    # --- pages -----------------------------------------------------------------------------------

    def page(self, links: str = PAGES) -> Page:
        """Return the overview; `links` is the folder of the pages, seen from it."""
        from ...report import Page, Picture

        out = Page(self._title, "Each record against the same model.", self._card())
        caption = (
            "Effects by record, and the force error on held-out data before and after "
            "they are in the model, with its 95 % interval and the floor."
        )
        pictures = [Picture("fleet", self.plot(), caption)] if self.done else []
        text = Text(str(self.summary()), self._html(links))
        out.add("The fleet at a glance", figures=pictures)
        out.add("Records", tables=[text])
        return out

    def _card(self) -> Card:
        """Return the fleet in short."""
        from ...report import Card

        judged = [e.shrink for e in self.entries if e.shrink]
        lines = (line.partition(": ") for line in _joined(self._lines())[1:6])
        facts = [(name, text) for name, _, text in lines]
        if not self.effects():
            facts.append(("Effects", "none is named in any record"))
        if judged:
            before, after = (median(s[key] for s in judged) for key in ("before", "after"))
            change = f"{before:.3g} {self.unit} → {after:.3g} {self.unit}"
            facts.append(("Force error, rms, median", change))
        idle = [e for e in self.entries if e.content is None or not e.shrink]  # nothing was judged
        remarks = [f"{e.name}: {e.remark}" for e in idle[:4]]
        if len(idle) > 4:
            remarks.append(f"and {len(idle) - 4} more that were not judged: see the table")
        verdict = tally("record", (e.verdict for e in self.entries))
        return Card(verdict, tuple(facts), tuple(remarks), "doubt" if self.failed else "good")

    def save(self, folder: str | Path) -> Path:
        """Write the table and the overview into a folder, and return the overview."""
        folder = Path(folder)
        write(folder / TABLE, csv(self.frame()))
        return self.to_html(folder / OVERVIEW)

    def _html(self, links: str) -> str:
        """Return the table as HTML, with links to the pages."""
        names = (*_HEADER[:3], f"before, {self.unit}", f"after, {self.unit}", "closed", "remark")
        header = "".join(f'<th scope="col">{escape(n)}</th>' for n in names)
        body = "".join(f"<tr>{_cells(e, links)}</tr>" for e in self.entries)
        return (
            f'<div class="ivtools"><table class="sortable"><thead><tr>{header}</tr></thead>'
            f"<tbody>{body}</tbody></table></div>"
        )

    def __repr__(self) -> str:
        return f"{self._title}, {len(self.failed)} failed"


def _joined(lines: Sequence[str]) -> list[str]:
    """Return wrapped lines as whole ones."""
    whole: list[str] = []
    for line in lines:
        if line.startswith("  ") and whole:
            whole[-1] += " " + line.strip()
        else:
            whole.append(line)
    return whole


def _rows(entry: Entry, room: int) -> list[tuple[str, ...]]:
    """Return the rows of an entry: effects that do not fit go on below."""
    name, half = entry.name, (room - 1) // 2
    if len(name) > room:  # the end tells records apart as often as the beginning
        name = f"{name[:half]}~{name[-half:]}"
    effects = wrap(", ".join(entry.effects), _EFFECTS, break_on_hyphens=False) or [""]
    first = (name, entry.verdict, effects[0], *_figures(entry))
    return [first, *(("", "", more, "", "", "") for more in effects[1:])]


def _figures(entry: Entry) -> tuple[str, str, str]:
    s = entry.shrink
    if not s:
        return "", "", ""
    closed = f"{100 * s['closed']:.0f} %" if entry.effects else ""  # nothing closes nothing
    return f"{s['before']:.3g}", f"{s['after']:.3g}", closed


def _cells(entry: Entry, links: str) -> str:
    name = escape(entry.name)
    if entry.page is not None:
        name = f'<a href="{escape(links, quote=True)}/{escape(entry.page.name)}">{name}</a>'
    before, after, closed = _figures(entry)
    colour = ' class="failed"' if entry.verdict == FAILED else ""
    effects = ", ".join(f'<span class="whole">{escape(e)}</span>' for e in entry.effects) or (
        "none named" if entry.shrink else ""
    )
    cells = "".join(f"<td>{escape(cell)}</td>" for cell in (before, after, closed, entry.remark))
    return f"<td>{name}</td><td{colour}>{escape(entry.verdict)}</td><td>{effects}</td>{cells}"


def _range(values: Sequence[float], unit: str) -> str:
    """Write the median with its unit; of several, the least and the largest too.

    Examples
    --------
    >>> _range([0.0021, 0.002, 0.0022], "m")
    '2.1 mm (2 to 2.2)'
    """
    ordered = sorted(values)
    middle = ordered[len(ordered) // 2]
    factor, unit = prefixed(middle, unit)
    shown = f"{factor * middle:.3g} {unit}".rstrip()
    if len(ordered) == 1:
        return shown
    return f"{shown} ({factor * ordered[0]:.3g} to {factor * ordered[-1]:.3g})"
