"""Registered data sets: where they come from, how to get them, and that they are the right ones.

A file is looked for in the folder given, in ``$IVTOOLS_DATA`` and in the user's cache, and else
downloaded into the cache. Every file is checked by its SHA-256 each time it is used. What
IVTOOLS_DATA names is a folder that holds a set's files, or one folder per set.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ivtools.download import download, unpacked
from ivtools.errors import DataError
from ivtools.record import Record
from ivtools.record_format import RecordFormat
from ivtools.registry import REGISTRY, DataSet
from ivtools.trapezoids import trapezoid

__all__ = [
    "REGISTRY",
    "DataSet",
    "emps",
    "emps_pulses",
    "fetch",
    "find",
    "load",
    "path",
    "paths",
    "twin",
]

FOLDER_VARIABLE = "IVTOOLS_DATA"
MIRROR_VARIABLE = "IVTOOLS_MIRROR"


def emps(data: str | Path | None = None) -> Record:
    """Return the estimation record of the EMPS, 24841 samples at 1 kHz; q in m, nu in V.

    Parameters
    ----------
    data : str or Path, optional
        Folder that holds the file.

    Raises
    ------
    DataError
        The file is not there and cannot be downloaded, or it is not the right one.
    """
    return load("emps", data)


def emps_pulses(data: str | Path | None = None) -> Record:
    """Return the validation record of the EMPS: as `emps`, with pulses in ``added``, V.

    The file calls them newtons; only as volts after the saturation do they reproduce the record.
    """
    return load("emps-pulses", data)


def load(
    name: str | Path,
    data: str | Path | None = None,
    columns: Mapping[str, str] | RecordFormat | None = None,
) -> Record:
    """Return the record of a registered data set, or of a file.

    Parameters
    ----------
    name : str or Path
        ``emps``, ``emps-pulses``, ``twin``, or a record file.
    data : str or Path, optional
        Folder to look in first.
    columns : mapping of str to str, or RecordFormat, optional
        How a file is read, see `Record.read`; registered data sets are known.

    Raises
    ------
    DataError
        Neither a data set nor a readable file.
    RecordError, ShapeError
        The content breaks a rule of `Record`.
    """
    if name == "twin":
        return twin()
    if name in REGISTRY:
        return _registered_record(REGISTRY[str(name)], data)
    if not Path(name).suffix and not Path(name).exists():
        raise DataError(f"{name} is neither a file nor a data set; data sets: {_known()}")
    return Record.read(name, columns)


def _registered_record(data_set: DataSet, data: str | Path | None) -> Record:
    """Return the record of a registered data set, from its owners' files."""
    main, *beside = _own(data_set.name, data)
    if not data_set.reader:
        return Record.read(main, trusted=True).replace(name=data_set.name)
    from ivtools.measured import READERS

    return READERS[data_set.reader](data_set.name, data_set.part, main, *beside)


def paths(name: str, data: str | Path | None = None) -> tuple[Path, ...]:
    """Return every verified file of a data set, the one of `path` first."""
    found = _found(name, data)
    return found if found is not None else _fetched(name)


def _own(name: str, data: str | Path | None) -> tuple[Path, ...]:
    """Return every verified file of a data set; a folder that was named must hold them."""
    found = _found(name, data)
    folder = None if data is None else Path(data).expanduser().resolve()
    if folder is None or (found and all(folder in file.resolve().parents for file in found)):
        return found or _fetched(name)
    held = ", ".join(_registered(name).files)
    raise DataError(
        f"--data names {data}, which holds no {held}; name its folder, or leave --data out to use "
        f"{found[0].parent if found else 'the cache or a download'}"
    )


def path(name: str, data: str | Path | None = None) -> Path:
    """Return the verified file of a data set, downloading it if it is nowhere.

    Raises
    ------
    DataError
        The file is not there and cannot be downloaded, it is not the right one, or ``data`` names
        a folder that does not hold it.
    """
    return _own(name, data)[0]


def find(name: str, data: str | Path | None = None) -> Path | None:
    """Return the verified file of a data set if this machine has it, else None.

    Raises
    ------
    DataError
        A folder that was named does not exist, or the file found is not the right one.
    """
    found = _found(name, data)
    return None if found is None else found[0]


def _found(name: str, data: str | Path | None) -> tuple[Path, ...] | None:
    """Return the verified files of a data set if one folder of this machine has them all."""
    data_set = _registered(name)
    for folder in _folders(data):
        for place in dict.fromkeys((folder, folder / data_set.folder)):
            files = [place / file for file in data_set.files]
            if all(file.is_file() for file in files):
                return tuple(_verified(file, data_set) for file in files)
    return None


def fetch(name: str, url: str | None = None) -> Path:
    """Return the file of a data set in the user's cache, downloading it if need be.

    Parameters
    ----------
    name : str
        Name in the registry.
    url : str, optional
        Address of a zip archive that holds the file; default ``$IVTOOLS_MIRROR``, else the
        archive of the data set's authors.

    Raises
    ------
    DataError
        The download failed or is not the right file; nothing of it stays in the cache.
    """
    return _fetched(name, url)[0]


def _fetched(name: str, url: str | None = None) -> tuple[Path, ...]:
    """Return the files of a data set in the user's cache, downloading what is not there."""
    data_set, cache = _registered(name), _cache()
    files = [cache / file for file in data_set.files]
    if all(file.is_file() for file in files):
        return tuple(_verified(file, data_set) for file in files)
    url = url or os.environ.get(MIRROR_VARIABLE) or data_set.archive
    try:
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=cache, prefix="download-") as folder:
            archive = download(url, Path(folder) / "archive.zip")
            parts = [_extract(archive, file, sha) for file, sha in data_set.files.items()]
            checked = [_verified(part, data_set, url) for part in parts]
            return tuple(part.replace(file) for part, file in zip(checked, files, strict=True))
    except (OSError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        told = ", ".join(f"{file}, SHA-256 {sha}" for file, sha in data_set.files.items())
        raise DataError(
            f"{data_set.filename} is not on this machine and cannot be downloaded from {url} "
            f"({_reason(error)}); get it from {data_set.origin} ({told}) and "
            f"put it in {cache}, or name its folder with --data or {FOLDER_VARIABLE}"
        ) from error


def twin() -> Record:
    """Return a simulated record of an EMPS-like axis; the same one every time.

    The axis of ``emps.toml`` with asymmetric friction follows trapezoidal moves of up to 0.24 m
    and 0.15 m/s for 24.84 s at 1 kHz. The encoder resolves 5e-8 m and white noise of 2 N standard
    deviation acts beside the drive force. ``theta_true`` has the true parameters in SI units.

    Examples
    --------
    >>> record = twin()
    >>> record.n_samples, record.theta_true["inertia"]
    (24841, 95.0)
    """
    from ivtools import axes

    theta = {
        "inertia": 95.0,
        "viscous_pos": 165.0,
        "coulomb_pos": 20.0,
        "viscous_neg": 240.0,
        "coulomb_neg": 21.0,
    }
    t = np.arange(24841) / 1000.0
    q_ref = _moves(t)
    noise = np.random.default_rng(np.random.SeedSequence(list(b"twin"))).normal(0.0, 2.0, t.size)
    sim = (
        axes.emps()
        .with_terms("inertia", "asymmetric-friction")
        .simulate(
            Record(t, q=q_ref, q_ref=q_ref, nu=q_ref),  # of which the simulation uses the reference
            theta,
            initial="rest",
            force_noise=noise,
            quantum=5e-8,
        )
    )
    return Record(t, sim.q, q_ref=q_ref, nu=sim.nu, name="twin", theta_true=theta)


def _moves(t: np.ndarray) -> np.ndarray:
    """Return a position reference, m: trapezoidal moves out and back, slow and fast.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Time, s.
    """
    acceleration = 1.2  # m/s2
    strokes = (0.24, 0.20, 0.16, 0.12, 0.06, 0.03, 0.01, 0.07)  # m
    speeds = (0.15, 0.12, 0.09, 0.06, 0.04, 0.02, 0.01, 0.08)  # m/s
    position, start = np.zeros_like(t), 0.0
    for stroke, speed in zip(strokes, speeds, strict=True):
        ramp, cruise = speed / acceleration, stroke / speed
        for sign in (1.0, -1.0):
            position += trapezoid(t - start, sign * speed, ramp, cruise)
            start += cruise + ramp
    return position  # which has just come to rest: a motion cut off spoils the filters


def _known() -> str:
    return ", ".join(REGISTRY)


def _registered(name: str) -> DataSet:
    if name not in REGISTRY:
        raise DataError(f"{name!r} is no registered data set; data sets: {_known()}")
    if not REGISTRY[name].filename:
        raise DataError(f"{name} is simulated and has no file; use it by its name")
    return REGISTRY[name]


def _cache() -> Path:
    import platformdirs

    return Path(platformdirs.user_cache_dir("ivtools"))


def _folders(data: str | Path | None) -> Iterator[Path]:
    """Yield the folders to look in, in order; those that were named must exist."""
    named = {"--data": data, FOLDER_VARIABLE: os.environ.get(FOLDER_VARIABLE)}
    for source, folder in named.items():
        if folder:
            try:
                place = Path(folder).expanduser()
                there = place.is_dir()
            except (OSError, RuntimeError, ValueError):  # an unknown ~user, a name too long
                there = False
            if not there:
                raise DataError(f"{source} names {folder}, which is no folder; mend or unset it")
            yield place
    yield _cache()


def _verified(file: Path, data_set: DataSet, source: str | None = None) -> Path:
    found, expected = _sha256(file), data_set.files[file.name]
    if found == expected:
        return file
    remedy = "try again or get it from" if source else "delete it and fetch it again, or see"
    raise DataError(
        f"{file.name} from {source or file.parent} is not the file that is registered: "
        f"SHA-256 {found}, expected {expected}; {remedy} {data_set.origin}"
    )


def _sha256(file: Path) -> str:
    with file.open("rb") as content:
        return hashlib.file_digest(content, "sha256").hexdigest()


def _reason(error: BaseException) -> str:
    """Return what went wrong at the bottom of a chain of errors, short: the wrappers say little."""
    while error.__cause__ or error.__context__:
        error = error.__cause__ or error.__context__ or error
    return " ".join(str(error).split())[:100] or type(error).__name__


def _extract(archive: Path, filename: str, sha256: str) -> Path:
    """Extract one file of an archive, by its name or its checksum."""
    file = archive.with_name(filename)
    if unpacked(archive, file, lambda found: _sha256(found) == sha256):
        return file
    raise OSError(f"the archive holds no {filename}")
