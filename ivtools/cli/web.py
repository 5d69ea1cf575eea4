"""``ivtools app``: the local web app for one's own log."""

from __future__ import annotations

from typing import Annotated

import typer

from ivtools.cli import options
from ivtools.errors import MissingExtraError


def web(
    log: Annotated[
        str | None,
        typer.Argument(callback=options.there, metavar="[LOG]", help="A log to begin with."),
    ] = None,
    axis: options.Axis = None,
    port: Annotated[int, typer.Option("--port", help="Port; 0 takes a free one.")] = 0,
    largest: Annotated[
        float, typer.Option("--largest", metavar="MB", help="Largest file that is taken.")
    ] = 1000.0,
    window: Annotated[
        bool, typer.Option("--window/--no-window", help="Open it in the browser.")
    ] = True,
) -> None:
    """Open a web app on this machine: drop a log, look, estimate, diagnose, take it away.

    It listens on 127.0.0.1 only, and ends with Ctrl-C.
    """
    try:
        from ivtools.app.server import serve
    except ImportError as error:
        raise MissingExtraError(str(error.name).split(".")[0], "app") from error
    from ivtools import axes
    from ivtools.cli.case import exists

    if log is not None:
        exists(log, axis or "emps")  # the app guesses, where no axis is given

    def began(address: str) -> None:
        typer.echo(f"ivtools app: {address} (Ctrl-C ends it)")
        if window:
            typer.launch(address)

    own = str(axes.FILES[axis]) if axis in axes.FILES else axis or ""
    serve(log or "", own, port, largest, began)
