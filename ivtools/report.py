"""One self-contained HTML page from results: a card, text, tables and figures.

Nothing on a page is fetched from anywhere: its style, its script and its data stand in it. Pages
that are made by the hundred share one script file in their folder instead.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache, cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from markupsafe import Markup

from ivtools.files import write
from ivtools.plots.chart import Chart, stills
from ivtools.tables import Text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TEMPLATES = Path(__file__).parent / "templates"
_PARTS = {
    "style": ("page.css",),
    "chart_style": ("uplot/uPlot.min.css",),
    "script": ("uplot/uPlot.iife.min.js", "chart.js"),
    "sorting": ("table.js",),
}


@dataclass(frozen=True)
class Picture:
    """A figure on a page.

    Attributes
    ----------
    name : str
        Of the file when the figure is saved beside the page.
    figure : Figure
        As `ivtools.plots` makes it.
    caption : str
        What it shows; also its text for those who cannot see it.
    """

    name: str
    figure: Figure
    caption: str
    content = None  # a still picture has no data to draw

    @property
    def alt(self) -> str:
        """The text in place of the picture."""
        return self.caption

    @property
    def wide(self) -> bool:
        """Whether the figure takes the whole width of the page."""
        return bool(self.figure.get_figwidth() > 5.0)  # inches

    @cached_property
    def inline(self) -> str:
        """The figure as a part of a page, in the page's colours."""
        from ivtools.plots import style

        return style.inline(self.figure, self.name, self.alt)


@dataclass(frozen=True)
class Section:
    """A part of a page: paragraphs, tables, figures, then tables that are folded away."""

    title: str
    text: tuple[str, ...] = ()
    tables: tuple[Text, ...] = ()
    figures: tuple[Picture | Chart, ...] = ()
    folded: tuple[tuple[str, Text], ...] = ()


@dataclass(frozen=True)
class Card:
    """The answer in plain words, first on its page.

    Parameters
    ----------
    verdict : str
        One sentence.
    facts : sequence of (str, str)
        What a reader wants to know next: label and value with its unit.
    next : sequence of str
        What to do next.
    tone : {"good", "doubt", "bad"}
        Colour of its edge; the words say the same.
    label : str
        What it is, for those who cannot see it.
    """

    verdict: str
    facts: tuple[tuple[str, str], ...] = ()
    next: tuple[str, ...] = ()
    tone: Literal["good", "doubt", "bad"] = "good"
    label: str = "The answer in short"


@dataclass
class Page:
    """A page that grows section by section.

    Parameters
    ----------
    title, lead : str
        Heading, and what the page says in one sentence.
    card : Card, optional

    Examples
    --------
    >>> page = Page("An axis", "What was identified.")
    >>> page.add("Nothing yet", "There is no result.")
    >>> "<h2>Nothing yet</h2>" in page.html()
    True
    """

    title: str
    lead: str
    card: Card | None = None
    sections: list[Section] = field(default_factory=list)

    def add(
        self,
        title: str,
        *text: str,
        tables: Iterable[Text] = (),
        figures: Iterable[Picture | Chart] = (),
        folded: Iterable[tuple[str, Text]] = (),
    ) -> None:
        """Append a section; its text is plain, markup in it is shown as it is."""
        less = tuple((name, _with_html(table)) for name, table in folded)
        self.sections.append(
            Section(title, text, tuple(map(_with_html, tables)), tuple(figures), less)
        )

    @property
    def charts(self) -> bool:
        """Whether the page has something to draw."""
        return any(isinstance(f, Chart) for s in self.sections for f in s.figures)

    @property
    def sortable(self) -> bool:
        """Whether the page has a table that its reader can sort."""
        return any('class="sortable"' in t.html for s in self.sections for t in s.tables)

    def html(self, script: str = "") -> str:
        """Return the page; it refers to no other file but the script, if one is named."""
        from ivtools import __version__

        return _rendered(
            "page.html", Glossary(), page=self, version=__version__, parts=_parts(), script=script
        )

    def __repr__(self) -> str:
        return f"Page: {self.title}"

    def _repr_html_(self) -> str:
        """Return the page in a frame, as a notebook shows it."""
        style = "width: 100%; height: 45rem; border: 1px solid #c8c8c8"
        title, content = escape(self.title), escape(self.html())
        return f'<iframe title="{title}" style="{style}" srcdoc="{content}"></iframe>'

    def fragment(self, prefix: str, live: str) -> str:
        """Return card and sections alone, as a part of a larger page.

        Parameters
        ----------
        prefix : str
            Makes its identifiers unlike those of the page's other parts.
        live : str
            Address under which the page's server re-samples the charts.
        """
        glossary = Glossary(prefix)
        return _rendered("sections.html", glossary, page=self, prefix=prefix, live=live, level="h3")

    def write(self, file: str | Path, figures: bool = False) -> Path:
        """Write the page.

        Parameters
        ----------
        file : str or Path
            Its folder is made.
        figures : bool
            Write each figure beside it as well, as an SVG file.

        Returns
        -------
        Path
        """
        from ivtools.plots import style

        file = Path(file)
        for name, figure in stills(f for s in self.sections for f in s.figures) if figures else ():
            style.save(figure, file.parent / f"{name}.svg")
        return write(file, self.html())


def _rendered(template: str, glossary: Glossary, **content: Any) -> str:
    """Return a template filled in; the glossary explains its words."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=True, undefined=StrictUndefined
    )
    environment.filters["explained"] = glossary.explained
    return environment.get_template(template).render(glossary=glossary, **content)


@cache
def _parts() -> dict[str, str]:
    """Return what every page holds: its styles, and the script of its charts."""
    return {
        name: "\n".join((TEMPLATES / file).read_text(encoding="utf-8").strip() for file in files)
        for name, files in _PARTS.items()
    }


def style() -> str:
    """Return the style of pages with charts."""
    return "\n".join((_parts()["chart_style"], _parts()["style"]))


def chart_script() -> str:
    """Return the script that draws charts, for a folder of pages that share it."""
    return _parts()["script"]


@cache
def terms() -> dict[str, str]:
    """Return the words that pages explain, with their meaning."""
    return tomllib.loads((TEMPLATES / "terms.toml").read_text(encoding="utf-8"))


class Glossary:
    """Explains each word of `terms` where a page first uses it, and lists those that it used.

    Its identifiers begin with the prefix.
    """

    def __init__(self, prefix: str = "") -> None:
        self.prefix = prefix
        self.used: dict[str, str] = {}
        self._left = dict(terms())

    def explained(self, text: Any) -> Markup:
        """Return a text, or markup, with its new words marked."""
        markup = str(text) if isinstance(text, Markup) else escape(str(text))
        pieces = re.split(r"(<[^>]*>)", markup)  # markup at odd places stays as it is
        pieces[::2] = [self._pattern.sub(self._explain, piece) for piece in pieces[::2]]
        return Markup("".join(pieces))

    @property
    def _pattern(self) -> re.Pattern[str]:
        words = "|".join(re.escape(word) for word in sorted(self._left, key=len, reverse=True))
        return re.compile(rf"(?<![\w-])(?:{words or '(?!)'})(?![\w-])", re.IGNORECASE)

    def _explain(self, match: re.Match[str]) -> str:
        word = next((w for w in self._left if w.lower() == match[0].lower()), None)
        if word is None:
            return match[0]
        self.used[word] = means = self._left.pop(word)
        return (
            f'<dfn tabindex="0" aria-describedby="{self.prefix}term-{len(self.used)}" '
            f'data-means="{escape(means, quote=True)}">{match[0]}</dfn>'
        )


def _with_html(text: str) -> Text:
    """Return a table with an HTML form that a keyboard can scroll; plain text is set as it is."""
    made = text if isinstance(text, Text) else Text(text, f"<pre>{escape(text)}</pre>")
    reachable = '<div class="ivtools" tabindex="0" role="group" aria-label="Table">'
    return Text(made, made.html.replace('<div class="ivtools">', reachable))
