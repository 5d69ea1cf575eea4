"""Sessions: what each window has been given and found, on disk and in memory."""

from __future__ import annotations

import json
import re
import secrets
import shutil
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from threading import RLock
from time import monotonic
from typing import Any

from ..errors import DataError, shown
from ..readers import SUFFIXES
from .hands import Hands, Job

STEPS = ("look", "estimate", "diagnose")
MOST = 16  # sessions; the one that rested longest gives way
_UNSAFE = re.compile(r"[^\w.-]+", re.ASCII)


@dataclass
class Step:
    """One step of a session: what it found last, and what is in hand.

    Attributes
    ----------
    status : str
        ``""``, ``"working"``, ``"done"``, ``"failed"`` or ``"cancelled"``.
    text : str
        How far the work is, or why it failed.
    version : int
        Rises with every result.
    folder : Path or None
        Of the last result.
    options : mapping
        What that result was asked for.
    warnings : list of str
    """

    status: str = ""
    text: str = ""
    version: int = 0
    folder: Path | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    since: float = 0.0
    job: Job | None = None

    def read(self, name: str) -> str:
        """Return a file of the last result; empty if there is none."""
        file = None if self.folder is None else self.folder / name
        return file.read_text(encoding="utf-8") if file is not None and file.exists() else ""


class Session:
    """What one window has been given and found.

    Parameters
    ----------
    folder : Path
        Of its own; removed with it.
    hands : Hands
        Who does the work.
    address : str
        Of the session on its server.
    """

    def __init__(self, folder: Path, hands: Hands, address: str):
        self.folder, self.address, self._hands = folder, address, hands
        self.log, self.name = "", ""
        self.holdout, self.holdout_name = "", ""
        self.axis = ""
        self.uploads = 0
        self.steps = {name: Step() for name in STEPS}
        self.lock = RLock()
        self._made = 0

    # --- what is given -----------------------------------------------------------------------

    def place(self, name: str) -> Path:
        """Return where an upload of this name goes: a safe name in a folder of its own.

        Raises
        ------
        DataError
            It is no kind of file that is read.
        """
        bare = re.split(r"[\\/]", name)[-1]
        suffix = next((s for s in SUFFIXES if bare.lower().endswith(s)), None)
        if suffix is None:
            known = ", ".join(SUFFIXES)
            raise DataError(f"{shown(bare) or 'a file'}: unknown type; known are {known}")
        stem = _UNSAFE.sub("_", bare[: -len(suffix)]).strip("._")[:60] or "log"
        self.uploads += 1
        return self.folder / f"upload-{self.uploads}" / f"{stem}{suffix}"

    def take_log(self, log: str, name: str, axis: str = "") -> None:
        """Begin with a log, and look at it."""
        with self.lock:
            self.cancel()
            self._drop(self.log)
            self._drop(self.holdout)
            self.log, self.name = log, name
            self.holdout = self.holdout_name = ""
            self.axis = axis
            for step in self.steps.values():
                self._clear(step)
            self.start("look", {"axis": axis or None})

    def take_holdout(self, file: str, name: str) -> None:
        """Take another record of the same axis; what was found without it goes."""
        with self.lock:
            self.cancel(("estimate", "diagnose"))  # a look at the log needs no hold-out
            self._drop(self.holdout)
            self.holdout, self.holdout_name = file, name
            self._clear(self.steps["estimate"])
            self._clear(self.steps["diagnose"])

    # --- work --------------------------------------------------------------------------------

    @property
    def ready(self) -> bool:
        """Whether there is a log with a usable axis file."""
        look = self.steps["look"]
        return look.folder is not None and (look.folder / "axis.toml").exists()

    def start(self, name: str, options: Mapping[str, Any]) -> None:
        """Begin a step.

        Raises
        ------
        DataError
            There is nothing to work on, or the session is at work.
        """
        with self.lock:
            if not self.log or (name != "look" and not self.ready):
                raise DataError("begin with a log that can be used")
            if any(step.status == "working" for step in self.steps.values()):
                raise DataError("a step is at work; wait, or cancel it")
            step, self._made = self.steps[name], self._made + 1
            folder = self.folder / f"{name}-{self._made}"
            folder.mkdir(parents=True)
            order = {
                "task": name,
                "folder": str(folder),
                "live": f"{self.address}chart/{name}",
                "log": self.log,
                "name": self.name,
                "holdout": self.holdout or None,
                **options,
            }
            if name != "look":
                own = self.steps["look"].folder
                assert own is not None
                order["axis"] = str(own / "axis.toml")
            step.status, step.text, step.since = "working", "waiting for a worker", monotonic()

            def tell(message: dict[str, Any]) -> None:
                self._told(step, folder, options, message)

            step.job = self._hands.do(order, tell)

    def correct(self, fields: Mapping[str, Any]) -> None:
        """Look again, with the columns and units that the user says; a stated law stays."""
        own = self.steps["look"].folder
        stated = own is not None and self.about().get("law") == "stated"
        axis = str(own / "axis.toml") if own is not None and stated else None
        self.start("look", {"fields": dict(fields), "axis": axis})

    def cancel(self, steps: Sequence[str] = STEPS) -> None:
        """Cancel what is in hand of these steps."""
        with self.lock:
            for step in (self.steps[name] for name in steps):
                if step.status == "working" and step.job is not None:
                    step.status, step.text = "cancelled", "Cancelled."
                    job, step.job = step.job, None
                    job.cancel()

    def _told(
        self, step: Step, folder: Path, options: Mapping[str, Any], message: dict[str, Any]
    ) -> None:
        """Note what a worker tells."""
        with self.lock:
            if step.status != "working" or folder.name.split("-")[-1] != str(self._made):
                shutil.rmtree(folder, ignore_errors=True)  # cancelled meanwhile
                return
            if "say" in message:
                step.text = str(message["say"])
                return
            step.job = None
            if "done" not in message:
                text = str(message.get("error", "Cancelled."))
                step.status = "failed" if "error" in message else "cancelled"
                step.text = self._bare(text)
                shutil.rmtree(folder, ignore_errors=True)
                return
            self._drop(step.folder)
            step.status, step.text, step.folder = "done", "", folder
            step.version, step.options = step.version + 1, dict(options)
            step.warnings = [self._bare(w) for w in message["done"].get("warnings", ())]
            if step is self.steps["look"]:  # what was found with another axis file goes
                self._clear(self.steps["estimate"])
                self._clear(self.steps["diagnose"])

    def _bare(self, text: str) -> str:
        """Return a message that names files as the user knows them."""
        for file, name in ((self.log, self.name), (self.holdout, self.holdout_name)):
            if file and file != name:
                text = text.replace(file, shown(name, 200))
        return re.sub(re.escape(str(self.folder)) + r"/[\w-]+/", "", text)

    # --- the end -----------------------------------------------------------------------------

    def _clear(self, step: Step) -> None:
        self._drop(step.folder)
        step.folder, step.status, step.text, step.job = None, "", "", None
        step.version, step.options, step.warnings = step.version + 1, {}, []

    def _drop(self, place: str | Path | None) -> None:
        """Remove what lies in the session's own folder; a user's file stays."""
        if place and self.folder in Path(place).parents:
            own = Path(place)
            shutil.rmtree(own if own.is_dir() else own.parent, ignore_errors=True)

    def close(self) -> None:
        """Cancel what is in hand, and remove everything."""
        self.cancel()
        shutil.rmtree(self.folder, ignore_errors=True)

    # --- what a window asks ------------------------------------------------------------------

    def about(self) -> dict[str, Any]:
        """Return what the first look told; empty if there is nothing."""
        text = self.steps["look"].read("about.json")
        return dict(json.loads(text)) if text else {}

    def state(self) -> dict[str, Any]:
        """Return what a window needs to know to be up to date."""
        with self.lock:
            versions = {name: step.version for name, step in self.steps.items()}
            whole = ".".join(map(str, versions.values()))
            shown_as = {
                "log": f"{self.uploads}.{versions['look']}.{self.holdout_name}",
                "look": f"{versions['look']}",
                "estimate": f"{versions['look']}.{versions['estimate']}",
                "diagnose": f"{versions['look']}.{versions['diagnose']}",
                "take": whole,
            }
            return {
                "sections": shown_as,
                "steps": {
                    name: {
                        "status": step.status,
                        "text": step.text,
                        "seconds": round(monotonic() - step.since, 1)
                        if step.status == "working"
                        else 0.0,
                    }
                    for name, step in self.steps.items()
                },
            }


class Sessions:
    """The sessions of a server.

    Parameters
    ----------
    folder : Path
        Where they keep their files.
    hands : Hands
    base : str
        Address that theirs begin with.
    """

    def __init__(self, folder: Path, hands: Hands, base: str):
        self._folder, self._hands, self._base = folder, hands, base
        self._all: OrderedDict[str, Session] = OrderedDict()
        self._lock = RLock()

    def new(self) -> Session:
        """Return a new session; if there are too many, the one that rested longest ends."""
        key = secrets.token_urlsafe(12)
        folder = self._folder / key
        folder.mkdir(parents=True)
        session = Session(folder, self._hands, f"{self._base}s/{key}/")
        with self._lock:
            self._all[key] = session
            ended = [self._all.popitem(last=False)[1] for _ in range(len(self._all) - MOST)]
        for one in ended:
            one.close()
        return session

    def get(self, key: str) -> Session | None:
        """Return a session by its key."""
        with self._lock:
            if key in self._all:
                self._all.move_to_end(key)
            return self._all.get(key)

    def close(self) -> None:
        """End them all."""
        with self._lock:
            ended = list(self._all.values())
            self._all.clear()
        for session in ended:
            session.close()
