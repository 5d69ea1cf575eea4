"""Source: where the records of a fleet come from, what they are called, and what they hold."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ... import datasets
from ...digest import digest
from ...errors import DataError
from ...record import Record
from ...record_format import RecordFormat

Given = Record | str | Path


@dataclass(frozen=True, eq=False)
class Source:
    """A record of a fleet before it is read.

    Parameters
    ----------
    name : str
        Unlike that of any other source; fit for a file name.
    given : Record, str or Path
        The record, its file, or the name of a data set.
    log : RecordFormat
        How its file is read.
    data : str or Path, optional
        Folder of the registered data sets.
    """

    name: str
    given: Given
    log: RecordFormat = RecordFormat()
    data: str | Path | None = None

    @property
    def text(self) -> str:
        """The file or data set; empty for a record."""
        return "" if isinstance(self.given, Record) else str(self.given)

    @property
    def _registered(self) -> bool:
        return self.text in datasets.REGISTRY

    def read(self) -> Record:
        """Return the record.

        Raises
        ------
        IVToolsError
            It cannot be read, or breaks a rule of records.
        """
        if isinstance(self.given, Record):
            return self.given
        return datasets.load(self.text, self.data, self.log)

    def digest(self) -> str:
        """Return a digest of the content: of the file's bytes, or of the record's arrays.

        Raises
        ------
        DataError
            The file cannot be read.
        """
        if isinstance(self.given, Record) or self._registered:
            record = self.read()
            return digest(record.t, record.signals, record.extra)
        try:
            with open(self.given, "rb") as file:
                return digest(hashlib.file_digest(file, "sha256").hexdigest(), self.log.to_dict())
        except OSError as error:
            reason = error.strerror or type(error).__name__
            raise DataError(f"{self.given}: {reason}; give a record file") from error


def sources(
    given: Iterable[Given], log: RecordFormat | None = None, data: str | Path | None = None
) -> list[Source]:
    """Return the sources of records, each named once; a file that comes twice counts once.

    Examples
    --------
    >>> [s.name for s in sources(["a/log 1.csv", "b/log 1.csv", "c.csv.gz", "c.csv.gz"])]
    ['log_1', 'b-log_1', 'c']
    """
    found: dict[str, Source] = {}
    seen: set[object] = set()
    for one in given:
        same: object = one if isinstance(one, Record) else str(one)
        if same in seen:
            continue
        seen.add(same)
        name = next(n for n in _names(one) if n.casefold() not in found)
        found[name.casefold()] = Source(name, one, log or RecordFormat(), data)
    return list(found.values())


def _names(given: Given) -> Iterable[str]:
    """Yield names for a record, from the plainest on."""
    if isinstance(given, Record):
        plain = _safe(given.name)
    else:
        plain = _safe(Path(given).name.split(".")[0])
        yield plain
        yield f"{_safe(Path(given).absolute().parent.name)}-{plain}"
    yield plain
    number = 2
    while True:
        yield f"{plain}-{number}"
        number += 1


def _safe(name: str) -> str:
    """Return a name that every file system takes."""
    return re.sub(r"[^\w.+-]+", "_", name).strip("._") or "record"
