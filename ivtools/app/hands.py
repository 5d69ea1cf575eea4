"""Hands: the processes that do the work of all sessions, one of them warm and waiting."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from threading import BoundedSemaphore, Lock, Thread
from typing import Any

Told = Callable[[dict[str, Any]], None]

_COMMAND = (sys.executable, "-m", "ivtools.app.worker")


@dataclass(eq=False)
class Job:
    """A piece of work in hand, which can be cancelled."""

    cancelled: bool = False
    process: subprocess.Popen[str] | None = None
    lock: Lock = field(default_factory=Lock)

    def cancel(self) -> None:
        """End it, whether it has begun or not."""
        with self.lock:
            self.cancelled = True
            if self.process is not None:
                _end(self.process)


class Hands:
    """Workers, so many at a time.

    Parameters
    ----------
    most : int
        Pieces of work at a time; further ones wait.
    """

    def __init__(self, most: int = 2):
        self._room = BoundedSemaphore(most)
        self._lock = Lock()
        self._closed = False
        self._spare: subprocess.Popen[str] | None = None
        self._busy: set[Job] = set()

    def prepare(self) -> None:
        """Warm a worker up."""
        with self._lock:
            if self._spare is None and not self._closed:
                self._spare = _started()

    def do(self, order: dict[str, Any], tell: Told) -> Job:
        """Have a piece of work done; `tell` hears of it from another thread.

        Messages are ``{"say": text}`` and at last one of ``{"done": ...}``, ``{"error": text}`` and
        ``{"cancelled": True}``.
        """
        job = Job()
        Thread(target=self._do, args=(order, tell, job), daemon=True).start()
        return job

    def close(self) -> None:
        """End every worker."""
        with self._lock:
            self._closed = True
            spare, self._spare = self._spare, None
            busy = list(self._busy)
        if spare is not None:
            _end(spare)
        for job in busy:
            job.cancel()

    def _do(self, order: dict[str, Any], tell: Told, job: Job) -> None:
        with self._room:
            with self._lock:
                self._busy.add(job)
            try:
                tell(self._outcome(order, tell, job))
            finally:
                with self._lock:
                    self._busy.discard(job)

    def _outcome(self, order: dict[str, Any], tell: Told, job: Job) -> dict[str, Any]:
        """Give the order to a worker, pass on what it says, and return its last word."""
        with job.lock:
            if job.cancelled or self._closed:
                return {"cancelled": True}
            job.process = process = self._taken()
        last: dict[str, Any] = {}
        with suppress(OSError, ValueError):  # a worker that is ended ends its pipes
            assert process.stdin is not None and process.stdout is not None
            process.stdin.write(json.dumps(order) + "\n")
            process.stdin.flush()
            for line in process.stdout:
                last = json.loads(line)
                if "say" not in last:
                    break
                tell(last)
        with job.lock:  # from here on it cannot be cancelled
            job.process = None
        if job.cancelled or not last.pop("again", False) or not self._back(process):
            _end(process)
            self.prepare()
        if job.cancelled:
            return {"cancelled": True}
        if "say" in last or not last:
            return {"error": "the worker died; it may need more memory than there is"}
        return last

    def _back(self, process: subprocess.Popen[str]) -> bool:
        """Let a worker wait for the next piece of work; return whether it is needed."""
        with self._lock:
            if self._spare is not None or self._closed:
                return False
            self._spare = process
            return True

    def _taken(self) -> subprocess.Popen[str]:
        with self._lock:
            spare, self._spare = self._spare, None
        return spare if spare is not None and spare.poll() is None else _started()


def _started() -> subprocess.Popen[str]:
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONIOENCODING": "utf-8"}
    return subprocess.Popen(
        _COMMAND,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        env=environment,
        start_new_session=True,  # with what it starts, it is ended as one
    )


def _end(process: subprocess.Popen[str]) -> None:
    with suppress(OSError):
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with suppress(OSError):
                pipe.close()
    with suppress(subprocess.TimeoutExpired):
        process.wait(2.0)
