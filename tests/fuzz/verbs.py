"""What every input must end in, whatever it holds: a status, one line, no NaN without a reason.

Run as a program it takes one task after another from stdin, in a process that a time and a memory
limit bind; `Bound` starts it, and starts it anew when it dies.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import selectors
import subprocess
import sys
import tempfile
import time
from functools import cache
from pathlib import Path
from typing import Any

LONGEST_S, LARGEST = 20.0, 2 << 30
START_S = 120.0  # imports, and the first compilation


class Bound:
    """A process that runs commands within limits; what it does not survive is a finding."""

    def __init__(self, longest: float = LONGEST_S, memory: int = LARGEST):
        self.longest, self.memory = longest, memory
        self.process: subprocess.Popen[str] | None = None
        self.folder = tempfile.TemporaryDirectory(prefix="ivtools-fuzz-")
        self.most_cpu = self.most_seconds = 0.0

    def run(self, arguments: list[str]) -> dict[str, Any]:
        """Return status, stderr, seconds, and JSON if there is any; ``died`` says of what."""
        if self.process is None or self.process.poll() is not None:
            self._start()
        process = self.process
        assert process is not None and process.stdin is not None
        start = time.monotonic()
        process.stdin.write(json.dumps(arguments) + "\n")
        process.stdin.flush()
        answer = self._answer(self.longest * 2 + 5)  # the machine may be busy: its own clock counts
        if answer is None:
            code = process.poll()
            died = f"longer than {self.longest} s" if code is None else f"exit {code}"
            self.close()
            return {"died": died, "seconds": time.monotonic() - start}
        found = dict(json.loads(answer))
        self.most_cpu = max(self.most_cpu, found["cpu"])
        self.most_seconds = max(self.most_seconds, found["seconds"])
        return found

    def _start(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__).resolve()), str(self.memory)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
            cwd=self.folder.name,  # where MuJoCo leaves its log
        )  # fmt: skip
        if self._answer(START_S) is None:
            raise RuntimeError("the process of the commands does not start")

    def _answer(self, seconds: float) -> str | None:
        assert self.process is not None and self.process.stdout is not None
        with selectors.DefaultSelector() as selector:
            selector.register(self.process.stdout, selectors.EVENT_READ)
            ready = selector.select(seconds)
        return (self.process.stdout.readline() or None) if ready else None

    def close(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self.process = None


def faults(verb: str, found: dict[str, Any]) -> list[str]:
    """Return what is wrong with the way in which a command ended."""
    if "died" in found:
        return [f"died: {found['died']}"]
    wrong = []
    lines = [line for line in found["stderr"].splitlines() if line]
    errors = [line for line in lines if not line.startswith("ivtools: warning")]
    if found["status"] not in (0, 2):
        wrong.append(f"status {found['status']}: {' | '.join(errors)[:300]}")
    if found["status"] == 2 and len(errors) != 1:
        wrong.append(f"{len(errors)} lines: {' | '.join(errors)[:300]}")
    if any(not line.startswith("ivtools: ") or not line.isprintable() for line in lines):
        wrong.append(f"strange line: {lines[0][:200]!r}")
    if found["cpu"] > LONGEST_S:
        wrong.append(f"{found['cpu']:.1f} s")
    lost = [] if verb == "benchmark" else nulls(found.get("json"))  # whose rows say why
    return wrong + ([f"null without a reason: {', '.join(lost)[:300]}"] if lost else [])


#: Where null means "not asked for" or "there is none", which is an answer.
REASONS = ("reason", "reasons", "note", "error", "why", "warnings", "findings")
MAY_BE_NULL = (
    "recommended",
    "changes",
    "discrepancy",
    "judged",
    "holdout",
    "block",
    "n_iter",
    "limit",
)


def nulls(content: Any, path: str = "") -> list[str]:
    """Return where a table of numbers holds null, and nothing in it or around it says why."""
    if isinstance(content, dict):
        if content.get("converged") is False or any(content.get(word) for word in REASONS):
            return []
        lost = [k for k, v in content.items() if v is None and k not in MAY_BE_NULL]
        found = [f"{path}.{k}" for k in lost if not content.get(f"{k}_reason")]
        return found + [p for k, v in content.items() for p in nulls(v, f"{path}.{k}")]
    if isinstance(content, list):
        return [p for k, v in enumerate(content) for p in nulls(v, f"{path}[{k}]")]
    return []


def _serve(memory: int) -> None:
    import typer

    from ivtools.cli import run

    typer.main.get_command = cache(typer.main.get_command)  # which takes longer than most inputs
    with contextlib.redirect_stdout(io.StringIO()):
        run(["simulate", "twin"])  # compiles once, which is not the input's time
    resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    answers = os.fdopen(os.dup(1), "w")
    print(json.dumps("ready"), file=answers, flush=True)
    for line in sys.stdin:
        arguments = json.loads(line)
        out, err = io.StringIO(), io.StringIO()
        start, cpu = time.monotonic(), time.process_time()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = _visited(arguments[1], err) if arguments[0] == "upload" else run(arguments)
        found = {"status": status, "stderr": err.getvalue()[:3000]}
        found |= {"seconds": time.monotonic() - start, "cpu": time.process_time() - cpu}
        with contextlib.suppress(ValueError, OSError, IndexError):
            file = Path(arguments[arguments.index("--json") + 1])
            found["json"] = json.loads(file.read_text())
            file.unlink()
        print(json.dumps(found), file=answers, flush=True)


def _visited(plan: str, err: io.StringIO) -> int:
    """Let a window of the app do what a plan says."""
    from window import visit

    try:
        status, line = visit(json.loads(Path(plan).read_text()))
    except Exception as error:
        status, line = 1, f"ivtools: {type(error).__name__}: {error}"
    err.truncate(err.seek(0))
    err.write(line)
    return status


if __name__ == "__main__":
    _serve(int(sys.argv[1]))
