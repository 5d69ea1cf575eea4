"""Shelf: the folder in which the finished diagnoses of a fleet lie."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ...errors import DataError
from .entry import Entry

PAGES = "records"


@dataclass(frozen=True)
class Shelf:
    """A folder of diagnoses: per record a page, and beside it what it was made of.

    The page is written first and moved to its name whole, the JSON file after it; so a record
    whose JSON file is there is finished. The JSON file holds the key of what the diagnosis rests
    on: with another key the record is not finished.

    Parameters
    ----------
    folder : Path
        Of the whole fleet.
    """

    folder: Path

    def open(self) -> None:
        """Make the folder.

        Raises
        ------
        DataError
            It cannot be made.
        """
        try:
            (self.folder / PAGES).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DataError(
                f"{self.folder} cannot be a folder for diagnoses ({error.strerror}); name another"
            ) from error

    def find(self, entry: Entry, key: str) -> Entry | None:
        """Return the finished entry of that name and key, if there is one."""
        page = self.page(entry)
        try:
            found = json.loads(page.with_suffix(".json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        if not isinstance(found, dict) or found.get("key") != key or not page.is_file():
            return None
        return replace(
            entry,
            content=found["diagnosis"],
            seconds=float(found["seconds"]),
            reused=True,
            page=page,
        )

    def keep(self, entry: Entry, key: str, html: str) -> Entry:
        """Write a finished entry, and return it with its page."""
        page = self.page(entry)
        about: dict[str, Any] = {
            "key": key,
            "file": entry.source,
            "seconds": entry.seconds,
            "diagnosis": entry.content,
        }
        write(page, html)
        write(page.with_suffix(".json"), json.dumps(about, indent=1) + "\n")
        return replace(entry, page=page)

    def page(self, entry: Entry) -> Path:
        """Return the place of a record's page."""
        return self.folder / PAGES / f"{entry.name}.html"


def write(file: Path, text: str) -> None:
    """Write a file whole or not at all."""
    part = file.with_name(f".{file.name}.part")
    part.write_text(text, encoding="utf-8")
    part.replace(file)
