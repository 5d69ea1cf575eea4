"""What a window of the app may do, done in this process: a file is uploaded, then more is asked."""

from __future__ import annotations

import io
import json
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

ANSWERS = (200, 303, 400, 404, 410)  # every other status is a fault
SECTIONS = ("log", "look", "estimate", "diagnose", "take")


class _AtOnce:
    """Hands that do the work here, before the request is answered."""

    def do(self, order: dict[str, Any], tell: Any) -> Any:
        from ivtools.app import tasks, worker
        from ivtools.app.hands import Job

        told = worker._done(tasks, json.loads(json.dumps(order)), io.StringIO())
        tell(told)
        return Job()

    def prepare(self) -> None: ...

    def close(self) -> None: ...


@cache
def _opened() -> tuple[Any, Any]:
    """Return the server and a client of it."""
    from starlette.testclient import TestClient

    from ivtools.app.server import Server

    server = Server(Path(tempfile.mkdtemp(dir=".")), largest=20.0)
    server.hands = server.sessions._hands = _AtOnce()  # type: ignore[assignment]
    headers = {"X-Ivtools": "1"}
    client = TestClient(server.app, base_url="http://127.0.0.1", headers=headers)
    return server, client.__enter__()  # one event loop for all visits


def visit(plan: dict[str, Any]) -> tuple[int, str]:
    """Do what a plan says in a session of its own; return a status and a line as a command does."""
    server, client = _opened()
    place = client.get(server.base, follow_redirects=False).headers["location"]
    content = Path(plan["file"]).read_bytes()
    answers = [client.post(f"{place}upload/log", params={"name": plan["name"]}, content=content)]
    for method, address, body in plan["then"]:
        # what JSON cannot hold, such as nan, is sent as Python writes it
        sent = None if body is None else json.dumps(body).encode()
        answers.append(client.request(method, f"{place}{address}", content=sent))
    answers += [client.get(f"{place}section/{name}") for name in SECTIONS]
    answers += [client.get(place), client.get(f"{place}state")]
    strange = [
        f"{a.request.url.path}: {a.status_code}" for a in answers if a.status_code not in ANSWERS
    ]
    strange += [
        f"{a.request.url.path}: internal error"
        for a in answers
        if "internal error" in a.text or "Traceback" in a.text
    ]
    steps = answers[-1].json()["steps"]
    told = [step["text"] for step in steps.values() if step["text"]]
    server.sessions.close()
    if strange:
        return 1, "ivtools: error: " + " ".join([*strange, *told])
    return (2, f"ivtools: error: {told[0]}") if told else (0, "")
