"""Files that are whole or not there: written beside their place, flushed, and moved to it.

A reader never sees half a file, two writers never mix theirs, and what a killed one has left goes
away when the next file of that name is written. Locks end with their process, however it ends.
"""

from __future__ import annotations

import errno
import os
import platform
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from ivtools.errors import DataError

try:
    import fcntl
except ImportError:  # Windows, which deletes no file that somebody has open
    fcntl = None  # type: ignore[assignment]


LOCK = ".in-use"  # name of the file by which a folder is claimed
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def write(path: str | Path, content: str | bytes) -> Path:
    """Write a file whole, in place of what is there, and return its path; its folder is made.

    Raises
    ------
    DataError
        It cannot be written; what was there before is kept.
    """
    path = Path(path)
    data = content.encode() if isinstance(content, str) else content
    try:
        if path.exists() and not path.is_file():
            path.write_bytes(data)  # a device, or an error
            return path
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as file:
            file.write(data)
    except BrokenPipeError:  # the reader of a pipe has seen enough
        raise
    except OSError as error:
        raise refused(path, error) from error
    return path


def refused(path: Path, error: OSError) -> DataError:
    """Return the error of a place that cannot be written: why, and what to do."""
    reason = error.strerror or type(error).__name__
    if error.errno in _FULL:
        return DataError(
            f"cannot write {path}: {reason}; what is finished is kept: free some space, run again"
        )
    return DataError(f"cannot write {path}: {reason}; name another place")


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Open a file of a name of its own beside a path; it takes that path when it is complete.

    Raises
    ------
    OSError
        It cannot be written; nothing is left of it.
    """
    sweep(path.parent, path.name)
    file = _beside(path)
    beside = Path(file.name)
    try:
        with file:
            yield file
            file.flush()
            os.fsync(file.fileno())
            os.replace(beside, path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise


def sweep(folder: Path, name: str = "") -> None:
    """Remove what killed writers left of a file, or of any; what is being written stays."""
    with suppress(OSError):  # a folder that cannot be listed keeps its files
        for left in folder.iterdir():
            if left.name.startswith(f".{name}") and left.name.endswith(_SUFFIX):
                with suppress(OSError), open(left, "rb") as file:
                    if _locked(file, wait=False):
                        left.unlink(missing_ok=True)


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Have a folder to oneself, among all who claim it.

    Raises
    ------
    DataError
        Another process has it; the message says which.
    """
    place = folder / LOCK
    with _lock(place) as file:
        file.write(f"process {os.getpid()} on {platform.node()}".encode())
        file.flush()
        try:
            yield
        finally:
            place.unlink(missing_ok=True)


def _lock(place: Path) -> BinaryIO:
    """Open the lock file of a folder, locked."""
    while True:
        file = open(place, "a+b")  # noqa: SIM115  (closed by the caller)
        if not _locked(file, wait=False):
            file.seek(0)
            who = file.read(200).decode(errors="replace") or "another process"
            file.close()
            raise DataError(
                f"{place.parent} is in use by {who}; wait until it ends, or name another folder"
            )
        if place.exists() and place.stat().st_ino == os.fstat(file.fileno()).st_ino:
            file.truncate(0)
            return file
        file.close()  # the one who had it has just removed it


_SUFFIX = ".part~"


def _beside(path: Path) -> BinaryIO:
    """Open a new file, locked as long as this process lives."""
    while True:
        beside = path.with_name(f".{path.name}.{uuid.uuid4().hex[:12]}{_SUFFIX}")
        file = open(beside, "xb")  # noqa: SIM115  (closed by the caller)
        _locked(file)
        if beside.exists():
            return file
        file.close()  # it was swept before it was locked


def _locked(file: BinaryIO, wait: bool = True) -> bool:
    """Lock a file against others for as long as it is open; return whether that worked."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        return False
    return True
