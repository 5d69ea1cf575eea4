"""One self-contained HTML page from results: text, tables and figures, and nothing to load."""

from __future__ import annotations

from base64 import b64encode
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from ivtools.tables import Text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TEMPLATES = Path(__file__).parent / "templates"


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

    @property
    def alt(self) -> str:
        """The text in place of the picture."""
        return self.caption

    @property
    def wide(self) -> bool:
        """Whether the figure takes the whole width of the page."""
        return bool(self.figure.get_figwidth() > 5.0)  # inches

    @cached_property
    def svg(self) -> bytes:
        """The figure as an SVG file."""
        from ivtools.plots import style

        return style.encode(self.figure, "svg")

    @property
    def uri(self) -> str:
        """The figure as an address that holds it whole."""
        return "data:image/svg+xml;base64," + b64encode(self.svg).decode("ascii")


@dataclass(frozen=True)
class Section:
    """A part of a page: paragraphs, then tables, then figures."""

    title: str
    text: tuple[str, ...] = ()
    tables: tuple[Text, ...] = ()
    figures: tuple[Picture, ...] = ()


@dataclass
class Page:
    """A page that grows section by section.

    Parameters
    ----------
    title, lead : str
        Heading, and what the page says in one sentence.

    Examples
    --------
    >>> page = Page("An axis", "What was identified.")
    >>> page.add("Nothing yet", "There is no result.")
    >>> "<h2>Nothing yet</h2>" in page.html()
    True
    """

    title: str
    lead: str
    sections: list[Section] = field(default_factory=list)

    def add(
        self,
        title: str,
        *text: str,
        tables: tuple[Text, ...] | list[Text] = (),
        figures: tuple[Picture, ...] | list[Picture] = (),
    ) -> None:
        """Append a section; its text is plain, markup in it is shown as it is."""
        self.sections.append(Section(title, text, tuple(map(_with_html, tables)), tuple(figures)))

    def html(self) -> str:
        """Return the page; it refers to no other file."""
        from jinja2 import Environment, FileSystemLoader, StrictUndefined

        from ivtools import __version__

        environment = Environment(
            loader=FileSystemLoader(TEMPLATES), autoescape=True, undefined=StrictUndefined
        )
        return environment.get_template("page.html").render(page=self, version=__version__)

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
        file = Path(file)
        file.parent.mkdir(parents=True, exist_ok=True)
        for picture in (p for s in self.sections for p in s.figures) if figures else ():
            (file.parent / f"{picture.name}.svg").write_bytes(picture.svg)
        part = file.with_name(f".{file.name}.part")
        part.write_text(self.html(), encoding="utf-8")
        return part.replace(file)


def _with_html(text: str) -> Text:
    """Return a table with an HTML form; plain text is set as it is."""
    return text if isinstance(text, Text) else Text(text, f"<pre>{escape(text)}</pre>")
