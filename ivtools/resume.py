"""Resumable runs: what is finished lies in a folder, which one run has at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ivtools.errors import WorkersLostError
from ivtools.files import claimed, refused, sweep


@contextmanager
def resumable(folder: Path | None, inner: str = ".") -> Iterator[None]:
    """Make the folder of a run, sweep out what killed runs left half-written, and claim it.

    Parameters
    ----------
    folder : Path or None
        None for a run that keeps its results in memory.
    inner : str
        The folder in it that the results go to.

    Raises
    ------
    DataError
        The folder cannot be made, or another run has it.
    WorkersLostError
        As raised inside, with what is kept.
    """
    if folder is None:
        yield
        return
    try:
        (folder / inner).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise refused(folder, error) from error
    with claimed(folder):
        for place in {folder, folder / inner}:
            sweep(place)
        try:
            yield
        except WorkersLostError as error:
            raise WorkersLostError(f"{error}; {kept(folder)}") from error


def kept(folder: Path) -> str:
    """Return what to say of a run that ended early."""
    return f"what is finished is kept in {folder}, and the same run goes on from there"
