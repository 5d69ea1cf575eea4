"""Shelf: the folder in which the finished diagnoses of a fleet lie."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...files import write
from .entry import Entry

PAGES, SCRIPT = "records", "charts.js"
SHARED = f"../{SCRIPT}"  # the one script, as the pages see it


@dataclass(frozen=True)
class Shelf:
    """A folder of diagnoses: per record a page, and beside it what it was made of.

    The page is written first, the JSON file after it; so a record whose JSON file is there is
    finished. The JSON file holds the key of what the diagnosis rests on, and the checksum of
    itself and the page: with another key or content the record is not finished.

    Parameters
    ----------
    folder : Path
        Of the whole fleet.
    """

    folder: Path

    def find(self, entry: Entry, key: str) -> Entry | None:
        """Return the finished entry of that name and key, if there is one."""
        page = self.page(entry)
        try:
            written = page.with_suffix(".json").read_bytes()
            found = json.loads(written)
            if written != _text(found).encode():  # one number can be written in several ways
                return None
            check = found.pop("checksum")
            if found["key"] != key or check != _checksum(found, page.read_bytes()):
                return None
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return None
        return replace(
            entry,
            content=found["diagnosis"],
            seconds=float(found["seconds"]),
            reused=True,
            page=page,
        )

    def prepare(self) -> None:
        """Write the script that all pages draw their charts with."""
        from ...report import chart_script

        write(self.folder / SCRIPT, chart_script())

    def keep(self, entry: Entry, key: str, html: str) -> Entry:
        """Write a finished entry, and return it with its page."""
        page = self.page(entry)
        about: dict[str, Any] = {
            "key": key,
            "file": entry.source,
            "seconds": entry.seconds,
            "diagnosis": entry.content,
        }
        about["checksum"] = _checksum(json.loads(json.dumps(about)), html.encode())
        write(page, html)
        write(page.with_suffix(".json"), _text(about))
        return replace(entry, page=page)

    def page(self, entry: Entry) -> Path:
        """Return the place of a record's page."""
        return self.folder / PAGES / f"{entry.name}.html"


def _text(about: dict[str, Any]) -> str:
    return json.dumps(about, indent=1) + "\n"


def _checksum(about: dict[str, Any], page: bytes) -> str:
    text = json.dumps(about, sort_keys=True).encode()
    return hashlib.sha256(text + hashlib.sha256(page).digest()).hexdigest()
