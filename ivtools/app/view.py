"""View: the window of a session as HTML."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from .. import __version__
from ..errors import DataError
from ..report import TEMPLATES
from .session import Session

SECTIONS = {
    "log": "The log",
    "look": "Signals and controller",
    "estimate": "Estimates",
    "diagnose": "Diagnosis",
    "take": "Take away",
}
USUAL = ("idim-ls", "idim-iv", "idim-bciv", "didim")  # as `ivtools compare` does
UNITS = (
    *("s", "ms", "us", "m", "mm", "um", "rad", "deg", "rev", "counts", "m/s", "mm/s", "rad/s"),
    *("deg/s", "rpm", "V", "mV", "A", "mA", "%", "N", "kN", "N m", "mN m"),
)


class View:
    """Fills in the templates.

    Parameters
    ----------
    base : str
        Address of the app.
    methods : iterable of str
        Those to choose from.
    """

    def __init__(self, base: str, methods: Iterable[str]):
        environment = Environment(
            loader=FileSystemLoader(TEMPLATES), autoescape=True, undefined=StrictUndefined
        )
        self._page = environment.get_template("app.html")
        self._sections = environment.get_template("app_sections.html")
        self._base = base
        self._methods = (*USUAL, *(m for m in methods if m not in USUAL))

    def page(self, session: Session) -> str:
        """Return the whole window."""
        state = session.state()  # first, so that what changes meanwhile is asked for again
        sections = [(n, title, Markup(self.section(session, n))) for n, title in SECTIONS.items()]
        return self._page.render(
            sections=sections,
            name=session.name,
            base=self._base,
            state=state,
            version=__version__,
        )

    def section(self, session: Session, name: str) -> str:
        """Return the inside of a step's section.

        Raises
        ------
        DataError
            There is no such step.
        """
        if name not in SECTIONS:
            raise DataError("there is no such step")
        step = session.steps.get(name)
        chosen = session.steps["estimate"].options.get("methods", USUAL)
        content: dict[str, Any] = {
            "session": session,
            "step": step,
            "about": session.about(),
            "fragment": Markup(step.read("fragment.html")) if step else "",
            "axis": session.steps["look"].read("axis.toml"),
            "methods": [(m, m in chosen, _about(m)) for m in self._methods],
            "usual": len(USUAL),
            "more": bool({*chosen} - {*USUAL}),
            "units": UNITS,
        }
        return self._sections.render(name=name, **content)


@cache
def _about(method: str) -> str:
    """Return the first line that a method says of itself."""
    from importlib import import_module

    from ..estimators.base import METHODS

    module, name = METHODS[method].split(":")
    found = getattr(import_module(f"ivtools.estimators.{module}"), name)
    return str(found.__doc__ or "").strip().split("\n")[0].rstrip(".")
