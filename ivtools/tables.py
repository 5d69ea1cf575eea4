"""Text tables of at most 80 columns that show themselves in a terminal and in a notebook."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pandas as pd

WIDTH = 80


class Text(str):
    """A string whose representation is itself, with an HTML form for notebooks.

    Examples
    --------
    >>> Text("a table", html="<table></table>")
    a table
    """

    html: str

    def __new__(cls, text: str, html: str = "") -> Text:
        """Join the two forms."""
        self = super().__new__(cls, text)
        self.html = html or f"<pre>{escape(text)}</pre>"
        return self

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        return self.html


def table(
    title: str,
    head: Sequence[str],
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    notes: Sequence[str] = (),
    left: int = 1,
) -> Text:
    """Lay out a table: title, free lines, a header with rows, and notes below.

    Parameters
    ----------
    title : str
        Centred above.
    head : sequence of str
        Lines between the title and the table.
    header, rows : sequences of str
        Cells; without rows no header is shown.
    notes : sequence of str
        Lines under the table, wrapped.
    left : int
        Number of leading columns aligned to the left; the others are aligned to the right.

    Returns
    -------
    Text
        At most 80 columns wide; the first column is shortened if need be.

    Examples
    --------
    >>> print(table("T", [], ["", "value"], [["inertia", "95.1"]]))
          T
    ==============
             value
    --------------
    inertia   95.1
    ==============
    """
    cells = [list(header), *[list(row) for row in rows]]
    widths = [max(len(row[j]) for row in cells) for j in range(len(header))]
    others = sum(widths[1:]) + 2 * (len(widths) - 1)
    widths[0] = min(widths[0], max(WIDTH - others, 8))
    lines = [_line(row, widths, left) for row in cells]
    width = min(WIDTH, max(map(len, [*lines, *head, title])))
    body = [lines[0], "-" * width, *lines[1:]] if rows else []
    top = [title.center(width).rstrip(), "=" * width]
    if head:
        top += [*head, *(["-" * width] if rows else [])]
    text = "\n".join([*top, *body, "=" * width, *_wrapped(notes)])
    return Text(text, _html(title, head, cells, notes, left))


class Labelled(str):
    """A line of labelled values, which HTML shows one below the other."""

    pairs: tuple[tuple[str, str], ...]


def two_columns(pairs: Sequence[tuple[str, str]]) -> list[str]:
    """Write labelled values in two columns of 38 characters.

    Examples
    --------
    >>> two_columns([("Rows", "2480"), ("Error", "4.08 %")])
    ['Rows:                            2480    Error:                         4.08 %']
    """
    cells = [f"{label}:{value:>{37 - len(label)}}" for label, value in pairs]
    cells += [""] * (len(cells) % 2)
    lines = [Labelled(f"{a}    {b}".rstrip()) for a, b in zip(cells[::2], cells[1::2], strict=True)]
    for k, line in enumerate(lines):
        line.pairs = tuple(pairs[2 * k : 2 * k + 2])
    return list(lines)


def rounded(value: float, std: float, digits: int = 4) -> tuple[str, str]:
    """Write a value and its standard error, both to the last digit that the error leaves sense.

    Parameters
    ----------
    value, std : float
    digits : int
        Significant digits of the error.

    Examples
    --------
    >>> rounded(95.18342, 0.12345, 2), rounded(95.18342, math.nan), rounded(math.nan, math.nan)
    (('95.18', '0.12'), ('95.1834', '-'), ('-', '-'))
    """
    if not (math.isfinite(value) and math.isfinite(std)) or std == 0.0:
        return dashed(value, ".6g"), dashed(std, ".4g")
    decimals = digits - 1 - math.floor(math.log10(std))
    if 0 <= decimals <= 7 and abs(value) < 1e6:
        return f"{value:.{decimals}f}", f"{std:.{decimals}f}"
    more = max(math.floor(math.log10(abs(value) / std)), 0) if value else 0
    return f"{value:.{more + digits - 1}e}", f"{std:.{digits - 1}e}"


def sentence(text: str) -> str:
    """Return a line as a sentence; a signal's or a record's name keeps its case.

    Examples
    --------
    >>> sentence("rows are few"), sentence("t jitters"), sentence("axis-1: the command clips.")
    ('Rows are few.', 't jitters.', 'axis-1: the command clips.')
    """
    first = text.split(" ")[0]
    name = first.endswith(":") or (len(first) == 1 and first != "a")
    return f"{text[:1] if name else text[:1].upper()}{text[1:].rstrip('.')}."


def dashed(value: float, form: str) -> str:
    """Write a number, or a dash in the place of one that is not known.

    Examples
    --------
    >>> dashed(1.0, ".2f"), dashed(math.nan, ".2f"), dashed(math.inf, ".2f")
    ('1.00', '-', 'inf')
    """
    return "-" if math.isnan(value) else f"{value:{form}}"


def _line(row: Sequence[str], widths: Sequence[int], left: int) -> str:
    """Write one row, two spaces between the columns."""
    cells = [_shortened(row[0], widths[0]), *row[1:]]
    padded = [
        cell.ljust(width) if j < left else cell.rjust(width)
        for j, (cell, width) in enumerate(zip(cells, widths, strict=True))
    ]
    return "  ".join(padded).rstrip()


def _shortened(text: str, width: int) -> str:
    """Cut a text that is too long."""
    return text if len(text) <= width else text[: width - 1] + "~"


def _wrapped(notes: Sequence[str]) -> list[str]:
    """Break notes into lines."""
    from textwrap import wrap

    return [line for note in notes for line in wrap(note, WIDTH, subsequent_indent="  ")]


def _html(
    title: str,
    head: Sequence[str],
    cells: Sequence[Sequence[str]],
    notes: Sequence[str],
    left: int,
) -> str:
    """Write the same table as HTML."""

    def row(content: Sequence[str], tag: str) -> str:
        aligned = [
            f'<{tag} style="text-align:{"left" if j < left else "right"}">{escape(cell)}</{tag}>'
            for j, cell in enumerate(content)
        ]
        return f"<tr>{''.join(aligned)}</tr>"

    lines = _head(head)
    body = "".join(row(content, "td") for content in cells[1:])
    grid = f"<table><thead>{row(cells[0], 'th')}</thead><tbody>{body}</tbody></table>"
    below = "".join(f"<p>{escape(note)}</p>" for note in notes)
    return (
        f'<div class="ivtools"><strong>{escape(title)}</strong>{lines}'
        f"{grid if body else ''}{below}</div>"
    )


def _head(lines: Sequence[str]) -> str:
    """Write the lines above a table as HTML; labelled values fit a narrow screen."""
    if not lines or not all(isinstance(line, Labelled) for line in lines):
        return f"<pre>{escape(chr(10).join(lines))}</pre>" if lines else ""
    pairs = [pair for line in lines if isinstance(line, Labelled) for pair in line.pairs]
    rows = (
        f'<tr><td style="text-align:left">{escape(a)}</td>'
        f'<td style="text-align:left">{escape(b)}</td></tr>'
        for a, b in pairs
    )
    return f'<table class="pairs"><tbody>{"".join(rows)}</tbody></table>'


def csv(frame: pd.DataFrame) -> str:
    """Return a DataFrame as a csv file whose text no spreadsheet takes for a formula.

    A text that begins with ``=``, ``+``, ``-``, ``@``, a tab or a line break gets an apostrophe in
    front, as the OWASP's advice against CSV injection has it; numbers stay as they are.

    Examples
    --------
    >>> import pandas as pd
    >>> print(csv(pd.DataFrame({"name": ["=1+1", "a"], "value": [-1.0, 2.5]})), end="")
    name,value
    '=1+1,-1
    a,2.5
    """
    safe = frame.rename(columns=_inert)
    for position, kind in enumerate(frame.dtypes):
        if kind.kind not in "biuf":
            safe.isetitem(position, [_inert(value) for value in frame.iloc[:, position]])
    return str(safe.to_csv(index=False, float_format="%.6g"))


def _inert(value: object) -> object:
    return f"'{value}" if isinstance(value, str) and value[:1] in tuple("=+-@\t\r\n") else value
