"""Displayed: what every result offers a terminal, a notebook, a program and a page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from ivtools.tables import Text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ivtools.report import Page


class Displayed:
    """A result that shows itself as a table, as plain objects, as a figure and as a page.

    A class states its `summary`; what follows from it is here.

    Attributes
    ----------
    content : tuple of str
        Attributes that make its JSON.
    figure : str
        Function of `ivtools.plots` that draws it, with its module if that is not imported there:
        ``"force"``, ``"study.bias"``. Empty if there is nothing to draw.

    Examples
    --------
    >>> class Count(Displayed):
    ...     content = ("rows",)
    ...     rows = 3
    ...     def summary(self):
    ...         return Text(f"{self.rows} rows")
    >>> Count(), Count().to_dict()
    (3 rows, {'rows': 3})
    >>> Count()._repr_html_()
    '<pre>3 rows</pre>'
    """

    content: ClassVar[tuple[str, ...]] = ()
    figure: ClassVar[str] = ""

    def summary(self) -> Text:
        """Return a table of at most 80 columns, which shows itself in a notebook as well."""
        raise NotImplementedError(f"{type(self).__name__} states no summary")

    def to_dict(self) -> Any:
        """Return the content as plain objects, ready for JSON."""
        return {name: plain(getattr(self, name)) for name in self.content}

    def plot(self, **options: Any) -> Figure:
        """Return the figure that shows it; options go to the function of `ivtools.plots`."""
        from ivtools import plots

        module, _, name = self.figure.rpartition(".")
        home = import_module(f"{plots.__name__}.{module}") if module else plots
        figure: Figure = getattr(home, name)(self, **options)
        return figure

    @property
    def drawn(self) -> bool:
        """Whether it has a figure."""
        return bool(self.figure)

    def page(self) -> Page:
        """Return the table and the figure as a page."""
        from ivtools.report import Page, Picture

        text = self.summary()
        page = Page(str(text).splitlines()[0].strip(), "")
        pictures = [Picture("figure", self.plot(), "")] if self.drawn else []
        page.add("Result", tables=[text], figures=pictures)
        return page

    def to_html(self, path: str | Path) -> Path:
        """Write one self-contained page, and return where it is."""
        return self.page().write(path)

    def __repr__(self) -> str:
        return str(self.summary())

    def _repr_html_(self) -> str:
        return self.summary()._repr_html_()


def plain(content: Any) -> Any:
    """Return a value as JSON has it: numbers that are not finite are None.

    Series and mappings become objects, arrays and sequences lists, complex numbers pairs, and a
    result that is `Displayed` what its `to_dict` says.

    Examples
    --------
    >>> plain({"a": (1.0, float("nan"))})
    {'a': [1.0, None]}
    """
    if content is None or isinstance(content, str | bool | int):
        return content
    if isinstance(content, float):
        return content if math.isfinite(content) else None
    if isinstance(content, complex):
        return [plain(content.real), plain(content.imag)]
    if isinstance(content, Displayed):
        return content.to_dict()
    if isinstance(content, Mapping):
        return {str(key): plain(value) for key, value in content.items()}
    if hasattr(content, "to_dict"):  # a Series
        return plain(content.to_dict())
    if hasattr(content, "tolist"):  # an array, or a number of numpy
        return plain(content.tolist())
    if isinstance(content, Sequence):
        return [plain(value) for value in content]
    return plain(float(content))
