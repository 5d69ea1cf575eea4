"""Guard: who may ask a server that listens on this machine alone, and what its answers may do.

A page of the open web can send requests to 127.0.0.1, by name resolution that changes meanwhile
(DNS rebinding) even read the answers. So a request must name this machine as its host, and what
changes anything must come from the app's own pages.
"""

from __future__ import annotations

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

HOSTS = ("127.0.0.1", "localhost")
_SAFE = ("GET", "HEAD")
_ANSWERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
        "img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Guard:
    """Refuses requests from elsewhere, and says in each answer what a browser may do with it.

    Parameters
    ----------
    app : ASGI application
    """

    def __init__(self, app: ASGIApp):
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":  # no websockets; start and end pass
            if scope["type"] == "lifespan":
                await self._app(scope, receive, send)
            return

        async def answer(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _ANSWERS.items():
                    headers.setdefault(name, value)
            await send(message)

        reason = refused(scope["method"], Headers(scope=scope))
        if reason:
            await PlainTextResponse(f"{reason}\n", 403)(scope, receive, answer)
            return
        await self._app(scope, receive, answer)


def refused(method: str, headers: Headers) -> str:
    """Return why a request is refused; empty if it is not.

    Examples
    --------
    >>> refused("GET", Headers({"host": "evil.example:8000"}))
    'this server answers to 127.0.0.1 only'
    >>> refused("GET", Headers({"host": "127.0.0.1:8000"}))
    ''
    """
    host = headers.get("host", "")
    if host.rpartition(":")[0] not in HOSTS and host not in HOSTS:
        return f"this server answers to {HOSTS[0]} only"
    origin, site = headers.get("origin"), headers.get("sec-fetch-site", "same-origin")
    if origin is not None and origin != f"http://{host}":
        return "requests of other pages are refused"
    if site not in ("same-origin", "none"):
        return "requests of other pages are refused"
    if method not in _SAFE and headers.get("x-ivtools") != "1":
        return "only the app's own pages may change anything"
    return ""
