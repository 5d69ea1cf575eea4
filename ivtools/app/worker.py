"""A process that does the work: it reads an order, tells how far it is, and waits for the next.

``python -m ivtools.app.worker`` imports what work needs and waits for lines of JSON on stdin; what
it tells are lines of JSON on stdout. So a worker is warm before there is work, and can be ended at
any time. One that has needed much memory ends by itself, and so gives it back.
"""

from __future__ import annotations

import json
import os
import sys
import traceback
import warnings
from pathlib import Path
from types import ModuleType
from typing import IO, Any

from ..errors import IVToolsError, IVToolsWarning

MEMORY = 700.0  # MB; a worker that has had more ends after its work


def main() -> None:
    """Do what the orders on stdin say."""
    voice = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what a library prints is for the log
    import ivtools.gap  # noqa: F401  (what most work needs, while nobody waits)
    import ivtools.guess  # noqa: F401
    import ivtools.suitability  # noqa: F401

    from . import tasks

    for line in sys.stdin:  # which ends with the server
        last = _done(tasks, json.loads(line), voice)
        again = _peak() < MEMORY
        _tell(voice, {**last, "again": again})
        if not again:
            return


def _done(tasks: ModuleType, order: dict[str, Any], voice: IO[str]) -> dict[str, Any]:
    """Do what an order says, and return the last word on it."""
    folder = Path(order.pop("folder"))

    def say(text: str) -> None:
        _tell(voice, {"say": text})

    try:
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("ignore")
            warnings.simplefilter("always", IVToolsWarning)
            told = tasks.TASKS[order.pop("task")](tasks.Order(folder=folder, **order), say)
        return {"done": {**told, "warnings": list(dict.fromkeys(str(w.message) for w in heard))}}
    except IVToolsError as error:
        return {"error": str(error)}
    except MemoryError:
        return {"error": "the memory does not suffice; take a shorter part of the log"}
    except Exception as error:
        traceback.print_exc()
        return {"error": f"internal error: {type(error).__name__}: {error}"}


def _peak() -> float:
    """Return the most memory that this process has had, MB; 0 where nobody tells."""
    try:
        import resource
    except ImportError:  # Windows
        return 0.0
    size = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return size / (1e6 if sys.platform == "darwin" else 1e3)


def _tell(voice: IO[str], message: dict[str, Any]) -> None:
    voice.write(json.dumps(message) + "\n")
    voice.flush()


if __name__ == "__main__":
    main()
