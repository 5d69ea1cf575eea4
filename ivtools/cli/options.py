"""Options that several verbs share."""

from __future__ import annotations

import os
import tempfile
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from ivtools.errors import AxisError, DataError


class Friction(StrEnum):
    """Friction model of the axis."""

    SYMMETRIC = "symmetric"
    ASYMMETRIC = "asymmetric"


class Frictions(StrEnum):
    """Friction models to compare."""

    SYMMETRIC = "symmetric"
    ASYMMETRIC = "asymmetric"
    BOTH = "both"


class Backend(StrEnum):
    """Where work is done."""

    LOKY = "loky"
    THREADING = "threading"
    DASK = "dask"


class Covariance(StrEnum):
    """Covariance of the estimates."""

    HAC = "hac"
    ROBUST = "robust"
    CLASSICAL = "classical"


def there(record: str | None) -> str | None:
    """Refuse a record that is neither a file nor a data set, before anything heavy is loaded."""
    from ivtools.registry import REGISTRY

    if record is None or record in REGISTRY or Path(record).suffix or _exists(record):
        return record
    known = ", ".join(REGISTRY)
    raise DataError(f"{record}: there is no such file and no such data set ({known})")


def known_axis(axis: str | None) -> str | None:
    """Refuse an axis that is neither a file nor registered, before anything heavy is loaded."""
    from ivtools.axes import FILES

    if axis is None or axis in FILES or Path(axis).suffix or _exists(axis):
        return axis
    raise AxisError(
        f"{axis!r} is neither an axis file nor a registered axis; registered: {', '.join(FILES)}"
    )


def present(path: Path) -> Path:
    """Refuse a model that is no file, before anything heavy is loaded."""
    if not _exists(str(path)):
        raise DataError(f"{path}: there is no such file; give a URDF or MJCF file")
    return path


def known_model(path: Path) -> Path:
    """Refuse what is neither a file nor a registered axis, before anything heavy is loaded."""
    from ivtools.axes import FILES

    if str(path) not in FILES and not _exists(str(path)):
        known = ", ".join(FILES)
        raise DataError(f"{path}: there is no such file and no such axis ({known})")
    return path


def known_limits(path: Path | None) -> Path | None:
    """Refuse a file of limits that is not there, before anything heavy is loaded."""
    if path is not None and not _exists(str(path)):
        raise DataError(
            f"limits file {path}: No such file or directory; give the path of a TOML file"
        )
    return path


def known_study(name: str) -> str:
    """Refuse what is neither a named study nor a file, before anything heavy is loaded."""
    folder = Path(__file__).parents[1] / "study" / "named"
    names = sorted(file.stem for file in folder.glob("*.toml"))
    if name in (*names, "leaderboard") or _exists(name):
        return name
    raise DataError(
        f"{name} is neither a named study ({', '.join(names)}) nor a study file; give a .toml or "
        ".py file"
    )


def a_folder(path: Path | None) -> Path | None:
    """Refuse a folder that is none, before anything heavy is loaded."""
    try:
        there = path is None or path.expanduser().is_dir()
    except (OSError, RuntimeError, ValueError):  # an unknown ~user, a name too long
        there = False
    if not there:
        raise DataError(f"--data names {path}, which is no folder; mend or unset it")
    return path


def is_file(name: str) -> bool:
    """Whether there is such a file, also below a home folder."""
    try:
        return Path(name).expanduser().exists()
    except (OSError, RuntimeError, ValueError):
        return False


def _exists(name: str) -> bool:
    try:
        return Path(name).exists()
    except (OSError, ValueError):
        return False


Record = Annotated[
    str,
    typer.Argument(
        callback=there,
        metavar="RECORD",
        help="A csv, parquet or mat file, or emps, emps-pulses, twin.",
    ),
]
Axis = Annotated[
    str | None,
    typer.Option(
        "--axis",
        callback=known_axis,
        metavar="AXIS",
        help="Axis file (TOML) or registered axis; default: the data set's own.",
    ),
]
Robot = Annotated[
    Path | None,
    typer.Option("--robot", metavar="FILE", help="Robot file (TOML), for a record of n joints."),
]
Holdout = Annotated[
    str | None,
    typer.Option(
        "--holdout", callback=there, metavar="RECORD", help="Another record of the same axis."
    ),
]
Data = Annotated[
    Path | None,
    typer.Option(
        "--data", metavar="DIR", callback=a_folder, help="Folder of the registered record files."
    ),
]
FrictionModel = Annotated[
    Friction | None,
    typer.Option("--friction", help="Friction model; default: that of the axis file."),
]
Cov = Annotated[Covariance, typer.Option("--cov", help="Covariance of the estimates.")]


def writable(path: Path | None) -> Path | None:
    """Refuse, before any work is done, a file or folder that could not be written.

    Raises
    ------
    DataError
        Something else is there, or it may not be written.
    """
    if path is None or str(path) == "-":
        return path
    there = path.absolute()
    while not there.exists():
        there = there.parent
    if there != path.absolute() and not there.is_dir():
        raise DataError(f"cannot write {path}: {there} is not a folder; name another place")
    if there.is_dir():
        try:
            tempfile.TemporaryFile(dir=there).close()  # which no permission alone can tell
        except OSError as error:
            reason = (error.strerror or type(error).__name__).lower()
            raise DataError(
                f"cannot write {path}: {reason} at {there}; name another place"
            ) from error
    elif not os.access(there, os.W_OK):
        raise DataError(f"cannot write {path}: permission denied at {there}; name another place")
    return path


def file(path: Path | None) -> Path | None:
    """Refuse a path that cannot become a file; see `writable`."""
    if path is not None and path.is_dir():
        raise DataError(f"cannot write {path}: it is a folder; name a file in it")
    return writable(path)


def folder(path: Path | None) -> Path | None:
    """Refuse a path that cannot become a folder; see `writable`."""
    if path is not None and path.exists() and not path.is_dir():
        raise DataError(f"cannot write {path}: it is a file; name a folder")
    return writable(path)


Json = Annotated[
    Path | None,
    typer.Option(
        "--json", metavar="FILE", callback=file, help="Write the result as JSON; - for stdout."
    ),
]
Html = Annotated[
    Path | None,
    typer.Option("--html", metavar="FILE", callback=file, help="Write the page with the figures."),
]
Out = Annotated[
    Path | None,
    typer.Option(
        "--out", metavar="DIR", callback=folder, help="Write report.html and the figures."
    ),
]
