"""Downloads that end: in time, below a size, and unpacked in pieces."""

from __future__ import annotations

import threading
import time
import urllib.request
import zipfile
from collections.abc import Callable
from http.client import HTTPException
from pathlib import Path
from typing import Any

__all__ = ["download", "unpacked"]

LARGEST = 200_000_000  # bytes of an archive, and of a file in it
SILENCE = 8.0  # s without a byte
PATIENCE = 15.0  # s for what does not say how large it is, and before the speed counts
SLOWEST = 20_000  # bytes/s of what does
_PIECE = 1 << 16


class _Transfer(threading.Thread):
    """One download in a thread of its own, as a server may keep a reader waiting at any point."""

    def __init__(self, url: str, file: Path):
        super().__init__(daemon=True)
        self.url, self.file = url, file
        self.received, self.size = 0, 0
        self.stopped = False
        self.error: Exception | None = None

    def run(self) -> None:
        try:
            with (
                urllib.request.urlopen(self.url, timeout=SILENCE) as answer,
                self.file.open("wb") as out,
            ):
                self.size = int(answer.headers.get("Content-Length") or 0)
                while not self.stopped and (piece := answer.read1(_PIECE)):
                    out.write(piece)
                    self.received += len(piece)
        except (OSError, HTTPException, ValueError) as error:
            self.error = error


def download(url: str, file: Path) -> Path:
    """Download a file.

    Parameters
    ----------
    url : str
    file : Path
        Where it goes.

    Raises
    ------
    OSError
        It cannot be had, is too large, or comes too slowly.
    """
    transfer = _Transfer(url, file)
    start = time.monotonic()
    transfer.start()
    while transfer.is_alive():
        transfer.join(0.05)
        wrong = _wrong(transfer, time.monotonic() - start)
        if wrong and transfer.is_alive():
            transfer.stopped = True
            raise OSError(wrong)
    if transfer.error is not None:
        raise OSError(str(transfer.error)) from transfer.error
    if transfer.size and transfer.received < transfer.size:
        raise OSError(f"it ended after {transfer.received} of {transfer.size} bytes")
    if transfer.received > LARGEST:
        raise OSError(f"it is larger than {LARGEST // 1_000_000} MB")
    return file


def _wrong(transfer: _Transfer, seconds: float) -> str:
    """Say what is wrong with a download that is under way."""
    if max(transfer.received, transfer.size) > LARGEST:
        return f"it is larger than {LARGEST // 1_000_000} MB"
    if seconds > PATIENCE and not transfer.size:
        return f"it took longer than {PATIENCE:g} s and does not say how large it is"
    if seconds > PATIENCE and transfer.received < SLOWEST * seconds:
        return f"{transfer.received} bytes in {seconds:.0f} s are too slow"
    return ""


def unpacked(archive: Path, file: Path, wanted: Callable[[Path], bool]) -> bool:
    """Unpack one member of a zip archive, in whatever folder of it that lies.

    Owners rename their files: one of another name but the same type that is wanted will do.

    Parameters
    ----------
    archive : Path
    file : Path
        Where it goes; its name is that of the member.
    wanted : callable
        Whether an unpacked file of another name is the right one.

    Returns
    -------
    bool
        Whether it was found.

    Raises
    ------
    OSError
        A member unpacks to too much.
    """
    with zipfile.ZipFile(archive) as content:
        akin = [m for m in content.infolist() if Path(m.filename).suffix == file.suffix]
        named = [m for m in akin if Path(m.filename).name == file.name]
        for member in named or akin[:100]:
            with content.open(member) as source, file.open("wb") as out:
                _copy(source, out)
            if named or wanted(file):
                return True
            file.unlink()
    return False


def _copy(source: Any, out: Any) -> None:
    """Copy a member in pieces, and no more than is allowed."""
    written = 0
    while piece := source.read(1 << 20):
        written += out.write(piece)
        if written > LARGEST:
            raise OSError(f"it unpacks to more than {LARGEST // 1_000_000} MB")
