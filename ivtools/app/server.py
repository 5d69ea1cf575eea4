"""The server: addresses, what they answer, and how it begins and ends."""

from __future__ import annotations

import math
import os
import secrets
import shutil
import socket
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import (
    HTMLResponse,
    JSONResponse,
    PlainTextResponse,
    RedirectResponse,
    Response,
)
from starlette.routing import Mount, Route

from ..errors import DataError, IVToolsError
from ..estimators.base import METHODS
from ..files import LOCK, claimed
from ..report import TEMPLATES, chart_script, style
from . import charts
from .guard import HOSTS, Guard
from .hands import Hands
from .script import script
from .session import Session, Sessions
from .view import View

LARGEST = 1000  # MB of an upload
_PREFIX = "ivtools-app-"  # of folders in the system's for temporary files
_FILES = {
    "axis.toml": ("look", "axis.toml", "text/plain"),
    "log.html": ("look", "page.html", "text/html"),
    "estimates.html": ("estimate", "page.html", "text/html"),
    "estimates.json": ("estimate", "result.json", "application/json"),
    "diagnosis.html": ("diagnose", "page.html", "text/html"),
    "diagnosis.json": ("diagnose", "result.json", "application/json"),
}


class Server:
    """The app: its sessions, and an answer for each address.

    Parameters
    ----------
    folder : Path
        Where sessions keep their files.
    largest : float
        Of an upload, MB.
    """

    def __init__(self, folder: Path, largest: float = LARGEST):
        self.base = f"/{secrets.token_urlsafe(12)}/"  # other users of the machine do not know it
        self.largest = int(largest * 1e6)
        self.hands = Hands()
        self.sessions = Sessions(folder, self.hands, self.base)
        self._view = View(self.base, METHODS)
        own = [
            Route("/", self.begin),
            Route("/app.css", self.asset),
            Route("/app.js", self.asset),
            Route("/charts.js", self.asset),
            Route("/s/{key}/", self.page),
            Route("/s/{key}/state", self.state),
            Route("/s/{key}/section/{name}", self.section),
            Route("/s/{key}/chart/{step}/{name}", self.chart),
            Route("/s/{key}/get/{name}", self.get),
            Route("/s/{key}/upload/{what}", self.upload, methods=["POST"]),
            Route("/s/{key}/do/{what}", self.do, methods=["POST"]),
        ]
        self.app = Starlette(
            routes=[Mount(self.base.rstrip("/"), routes=own)],
            middleware=[Middleware(Guard)],
            exception_handlers={IVToolsError: _at_fault, 404: _unknown},
        )

    # --- pages -------------------------------------------------------------------------------

    def begin(self, request: Request) -> Response:
        """Open a session of its own."""
        return RedirectResponse(self.sessions.new().address, 303)

    def asset(self, request: Request) -> Response:
        """Return a style or a script."""
        name = request.url.path.rsplit("/", 1)[-1]
        own = "" if name == "charts.js" else (TEMPLATES / name).read_text(encoding="utf-8")
        content = {"app.css": style() + own, "app.js": own, "charts.js": chart_script()}[name]
        kind = "text/css" if name.endswith("css") else "text/javascript"
        return Response(content, media_type=kind)

    def page(self, request: Request) -> Response:
        """Return the whole window."""
        return HTMLResponse(self._view.page(self._session(request)))

    def section(self, request: Request) -> Response:
        """Return a step's part of the window."""
        return HTMLResponse(self._view.section(self._session(request), _path(request, "name")))

    def state(self, request: Request) -> Response:
        """Return how far everything is."""
        return JSONResponse(self._session(request).state())

    def chart(self, request: Request) -> Response:
        """Return the samples of a chart between two times."""
        step = self._session(request).steps.get(_path(request, "step"))
        if step is None or step.folder is None:
            raise DataError("there is no such chart")
        whole = charts.kept(step.folder, _path(request, "name"))
        start, stop = (_seconds(request.query_params.get(name)) for name in ("from", "to"))
        return JSONResponse(whole.window(start, stop).content())

    def get(self, request: Request) -> Response:
        """Return a file to keep."""
        session, name = self._session(request), _path(request, "name")
        if name == "repeat.py":
            made, found = session.steps["estimate"], session.steps["diagnose"]
            text = script(
                session.name if session.log != session.name else session.log,
                session.holdout_name,
                made.options.get("methods", ()),
                found.options.get("tolerance"),
            )
            return _attached(text, name, "text/x-python")
        step, file, kind = _FILES.get(name, ("look", "", ""))
        text = session.steps[step].read(file) if file else ""
        if not text:
            raise DataError(f"there is no {name} yet")
        return _attached(text, name, kind)

    # --- what changes something --------------------------------------------------------------

    async def upload(self, request: Request) -> Response:
        """Take a file, not larger than the limit."""
        session, what = self._session(request), _path(request, "what")
        name = request.query_params.get("name", "")[:200]
        if what not in ("log", "holdout") or (what == "holdout" and not session.ready):
            raise DataError("begin with a log that can be used")
        told = request.headers.get("content-length", "")
        if told.isdigit() and int(told) > self.largest:
            raise self._too_large(name)
        place = session.place(name)
        place.parent.mkdir(parents=True)
        try:
            await self._received(request, place, name)
        except (IVToolsError, ClientDisconnect, OSError) as error:
            place.unlink(missing_ok=True)
            place.parent.rmdir()
            if isinstance(error, OSError):
                raise DataError(f"the file cannot be kept: {error.strerror}") from error
            raise
        take = session.take_log if what == "log" else session.take_holdout
        await run_in_threadpool(take, str(place), name)
        return JSONResponse(session.state())

    async def _received(self, request: Request, place: Path, name: str) -> None:
        size = 0
        with place.open("wb") as file:
            async for block in request.stream():
                size += len(block)
                if size > self.largest:
                    raise self._too_large(name)
                await run_in_threadpool(file.write, block)

    def _too_large(self, name: str) -> DataError:
        return DataError(
            f"{name} is larger than {self.largest / 1e6:g} MB; take a part of it, or start the app "
            "with --largest MB"
        )

    async def do(self, request: Request) -> Response:
        """Begin or cancel a step."""
        session, what = self._session(request), _path(request, "what")
        fields = await _fields(request)
        actions: dict[str, Callable[[], None]] = {
            "cancel": session.cancel,
            "twin": lambda: session.take_log("twin", "twin"),
            "correct": lambda: session.correct(fields),
            "axis": lambda: session.start("look", {"text": str(fields.get("text", ""))}),
            "estimate": lambda: session.start("estimate", {"methods": _methods(fields)}),
            "diagnose": lambda: session.start("diagnose", {"tolerance": _tolerance(fields)}),
        }
        if what not in actions:
            raise DataError("there is no such step")
        await run_in_threadpool(actions[what])
        return JSONResponse(session.state())

    # --- begin and end -----------------------------------------------------------------------

    def _session(self, request: Request) -> Session:
        session = self.sessions.get(_path(request, "key"))
        if session is None:
            raise DataError("this session has ended")
        return session

    def close(self) -> None:
        """End all work, and remove all files."""
        self.hands.close()
        self.sessions.close()


def serve(
    log: str = "",
    axis: str = "",
    port: int = 0,
    largest: float = LARGEST,
    began: Callable[[str], object] = print,
) -> None:
    """Run the app on 127.0.0.1 until it is interrupted.

    Parameters
    ----------
    log, axis : str
        A log, or a registered data set, to begin with, and its axis file.
    port : int
        0 takes a free one.
    largest : float
        Of an upload, MB.
    began : callable
        Called with the address.

    Raises
    ------
    DataError
        The port is taken.
    """
    import uvicorn

    sweep()
    with (
        tempfile.TemporaryDirectory(prefix=_PREFIX) as folder,
        claimed(Path(folder)),
        socket.socket() as place,
    ):
        place.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            place.bind((HOSTS[0], port))
        except (OSError, OverflowError) as error:
            raise DataError(f"port {port} cannot be used ({error}); name another one") from error
        server = Server(Path(folder), largest)
        server.hands.prepare()
        address = server.base
        if log:
            session = server.sessions.new()
            session.take_log(log, Path(log).name, axis)
            address = session.address
        config = uvicorn.Config(
            server.app, log_level="warning", access_log=False, lifespan="off", ws="none",
            timeout_graceful_shutdown=2,
        )  # fmt: skip
        place.listen()  # who comes before uvicorn is ready waits, and is not refused
        try:
            began(f"http://{HOSTS[0]}:{place.getsockname()[1]}{address}")
            with suppress(KeyboardInterrupt):
                uvicorn.Server(config).run(sockets=[place])
        finally:
            server.close()


def sweep() -> None:
    """Remove the folders of servers that were killed; those of others and of live ones stay."""
    us = getattr(os, "getuid", lambda: 0)()
    for left in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        with suppress(DataError, OSError):
            own = left.lstat().st_uid == us and not left.is_symlink()
            if own and (left / LOCK).is_file():
                with claimed(left):
                    shutil.rmtree(left, ignore_errors=True)


def _path(request: Request, name: str) -> str:
    return str(request.path_params[name])


def _seconds(text: str | None) -> float:
    with suppress(TypeError, ValueError):
        if math.isfinite(value := float(text or "")):
            return value
    raise DataError("from and to are times, s")


async def _fields(request: Request) -> dict[str, Any]:
    """Return the fields of a form, sent as JSON of at most 1 MB."""
    body = b""
    async for block in request.stream():
        body += block
        if len(body) > 1_000_000:
            raise DataError("the form is too large")
    if not body:
        return {}
    with suppress(ValueError, RecursionError):
        import json

        found = json.loads(body)
        if isinstance(found, dict):
            return found
    raise DataError("the form cannot be read")


def _methods(fields: dict[str, Any]) -> list[str]:
    chosen = fields.get("methods", [])
    chosen = [chosen] if isinstance(chosen, str) else chosen
    methods = [m for m in METHODS if isinstance(chosen, list) and m in chosen]
    if not methods:
        raise DataError("choose a method")
    return methods


def _tolerance(fields: dict[str, Any]) -> float:
    with suppress(TypeError, ValueError):
        value = float(str(fields.get("tolerance", "2")).replace(",", "."))
        if 0.0 <= value <= 100.0:
            return value
    raise DataError("the tolerance is a number from 0 to 100, per cent of the force")


def _attached(text: str, name: str, kind: str) -> Response:
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return Response(text, media_type=kind, headers=headers)


def _at_fault(request: Request, error: Exception) -> Response:
    ended = "has ended" in str(error)
    return JSONResponse({"error": str(error)}, 410 if ended else 400)


def _unknown(request: Request, error: Exception) -> Response:
    return PlainTextResponse("There is nothing here.\n", 404)
