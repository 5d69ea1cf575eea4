"""What a verb leaves behind: text, JSON, pages, and a progress bar while it works."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ivtools.display import plain
from ivtools.files import write

if TYPE_CHECKING:
    from ivtools.report import Page
    from ivtools.workers import Progress

STDOUT = Path("-")
INTERRUPTED = 130  # exit status, as shells have it


def show(*texts: object, json_file: Path | None = None) -> None:
    """Print tables, an empty line between them; nothing if the JSON goes to stdout."""
    if json_file == STDOUT:
        return
    text = "\n\n".join(str(text) for text in texts)
    try:
        typer.echo(text)
    except UnicodeEncodeError:  # a terminal that knows no Greek
        encoding = sys.stdout.encoding or "ascii"
        typer.echo(text.encode(encoding, "replace").decode(encoding))


def write_json(content: Mapping[str, Any] | Sequence[Any], file: Path | None) -> None:
    """Write a result for programs; what is not finite becomes null.

    Raises
    ------
    DataError
        The file cannot be written.
    """
    if file is None:
        return
    text = json.dumps(plain(content), indent=2, allow_nan=False) + "\n"
    if file == STDOUT:
        typer.echo(text, nl=False)
        return
    write(file, text)


def write_page(page: Page, folder: Path, name: str = "report.html") -> Path:
    """Write a page and its figures into a folder, and say where.

    Raises
    ------
    DataError
        The folder cannot be written.
    """
    return page.write(folder / name, figures=True)


@contextmanager
def progress(what: str, total: int | None = None) -> Iterator[Any]:
    """Show a bar on a terminal, nothing in a pipe; yields a function that advances it."""
    if not sys.stderr.isatty():
        yield lambda *_: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)

        def advance(label: str | None = None) -> None:
            bar.update(task, advance=1, description=label or what)

        yield advance


@contextmanager
def stoppable() -> Iterator[None]:
    """Say in its own words what an interrupted run leaves behind, and end the command."""
    try:
        yield
    except KeyboardInterrupt as stop:
        if not stop.args:
            raise
        typer.echo(f"ivtools: {stop}", err=True)
        raise SystemExit(INTERRUPTED) from None


def follow() -> Any:
    """Return a function that shows the progress of many records; None in a pipe."""
    if not sys.stderr.isatty():
        return None

    def tell(progress: Progress) -> None:
        share = progress.done / max(progress.total, 1)
        bar = "#" * round(30 * share)
        left = timedelta(seconds=round(progress.left))
        text = f"\r[{bar:30}] {progress.done}/{progress.total} records, {left} left \033[K"
        sys.stderr.write(text if progress.done < progress.total else "\r\033[K")
        sys.stderr.flush()

    return tell
