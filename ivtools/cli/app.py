"""The application: its verbs, and how it ends."""

from __future__ import annotations

import logging
import os
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Annotated, Any

import typer

from ivtools import __version__
from ivtools.cli import (
    axis,
    benchmark,
    catalogue,
    check,
    compare,
    data,
    demo,
    diagnose,
    excite,
    export,
    identify,
    reproduce,
    robot,
    simulate,
    warm,
    web,
)
from ivtools.cli.output import INTERRUPTED
from ivtools.errors import IVToolsError, IVToolsWarning, WorkersLostError, shown

LONGEST = 2000  # characters of a line on stderr
DONE, FAILED, AT_FAULT = 0, 1, 2

app = typer.Typer(
    name="ivtools",
    add_completion=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
_VERBS: Sequence[tuple[str, Callable[..., None]]] = (
    ("demo", demo.demo),
    ("reproduce", reproduce.reproduce),
    ("identify", identify.identify),
    ("compare", compare.compare),
    ("simulate", simulate.simulate),
    ("diagnose", diagnose.diagnose),
    ("excite", excite.excite),
    ("benchmark", benchmark.benchmark),
    ("effects", catalogue.effects),
    ("methods", catalogue.methods),
    ("axis", axis.axis),
    ("check", check.check),
    ("warm", warm.warm),
    ("app", web.web),
)
for _name, _verb in _VERBS:
    app.command(_name)(_verb)
app.add_typer(data.app, name="data")
app.add_typer(export.app, name="export")
app.add_typer(robot.app, name="robot")


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"ivtools {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option("--version", "-V", callback=_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Identify a controlled axis from closed-loop records, simulate it, compare.

    RECORD is a csv, parquet or mat file, or a registered data set: emps, emps-pulses, twin.
    """


def run(arguments: Sequence[str]) -> int:
    """Run one command and return its exit status.

    Parameters
    ----------
    arguments : sequence of str
        As on the command line, without the program.

    Returns
    -------
    int
        0 done, 2 the input is at fault, 130 interrupted, 1 anything else.

    Examples
    --------
    >>> run(["identify", "nowhere.csv"])
    2
    """
    with warnings.catch_warnings():
        _hear_warnings()
        try:
            status = typer.main.get_command(app).main(
                list(arguments) or ["--help"], prog_name="ivtools", standalone_mode=False
            )
            sys.stdout.flush()
        except BaseException as error:
            return _ended_by(error)
    return _ended_by(KeyboardInterrupt()) if status == INTERRUPTED else int(status or DONE)


def main() -> None:
    """Run the command of this process and exit; a wish to end it is like Ctrl-C."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if sys.stdout is None:
        _say("error: stdout is closed, so the result would be lost; open it, or use > /dev/null")
        sys.exit(AT_FAULT)
    status = run(sys.argv[1:])
    with suppress(OSError):
        sys.stdout.flush()
    sys.exit(status)


def _ended_by(error: BaseException) -> int:
    """Say in one line why the command ended, and return its exit status."""
    if isinstance(error, SystemExit):
        return int(error.code) if isinstance(error.code, int) else FAILED
    if isinstance(error, BrokenPipeError):  # the reader has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    if isinstance(error, KeyboardInterrupt) or type(error).__name__ == "Abort":
        _say("interrupted")
        return INTERRUPTED
    if isinstance(error, IVToolsError | WorkersLostError):
        _say(f"error: {error}")
        return AT_FAULT if isinstance(error, IVToolsError) else FAILED
    if isinstance(error, MemoryError):
        _say("error: the memory does not suffice; take a shorter part of the record")
        return FAILED
    usage = getattr(error, "format_message", None)
    if usage is not None:  # a usage error of typer, whichever click it brings
        _say(f"error: {usage()} ivtools --help shows what there is.")
        return AT_FAULT
    _say(f"internal error: {type(error).__name__}: {error}; IVTOOLS_TRACEBACK=1 shows where")
    if os.environ.get("IVTOOLS_TRACEBACK"):
        raise error
    return FAILED


def _hear_warnings() -> None:
    """Show our own warnings as one line each, once, and nobody else's."""
    seen: set[str] = set()

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        if str(message) not in seen:
            seen.add(str(message))
            _say(f"warning: {message}")

    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # our own line names the folder
    warnings.simplefilter("ignore")
    warnings.simplefilter("always", IVToolsWarning)
    warnings.showwarning = show


def _say(text: str) -> None:
    """Write one line to stderr."""
    line = f"ivtools: {shown(' '.join(text.split()), LONGEST)}"
    with suppress(OSError, ValueError, AttributeError):  # nobody listens
        encoding = sys.stderr.encoding or "ascii"
        typer.echo(line.encode(encoding, "replace").decode(encoding), err=True)
