"""Readers of record files: text, parquet and MATLAB files become tables by column name.

Everything is read in pieces, and refused above the limits of `ivtools.limits` before there is more.
A MATLAB file that nobody vouches for is read in a process of its own (`ivtools.mat_child`).
"""

from __future__ import annotations

import io
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from ivtools import limits, mat_child
from ivtools.columns import match_columns, plain_name
from ivtools.errors import DataError, IVToolsError, RecordError, optional, shown

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

    from ivtools.record_format import RecordFormat

    Table = dict[str, NDArray[np.float64]]

__all__ = ["IN_FOLDERS", "SUFFIXES", "frame_table", "preamble", "read_table"]

#: The variables of the EMPS files, ours = theirs.
EMPS = {"q": "qm", "q_ref": "qg", "nu": "vir", "added": "pulses_N"}
_TEXT = (".csv", ".txt", ".tsv", ".dat", ".asc", ".log")
_BINARY = (".parquet", ".mat")
_PIECE = 1_000_000  # numbers read at a time
_TIMES = ("s", "ms", "us", "µs", "ns", "min", "h")
_SPARE = 1_000_000  # lines and bytes that a file may have beside its numbers
_PER_NUMBER = 100  # bytes of text, on average
_MOSTLY = 0.9  # of the cells of a column of numbers that are one
_THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:[,'\u2019\u00a0\u202f ]\d{3})+(?:\.\d*)?")
_PATIENCE = 15.0  # s that a damaged MATLAB file may take, and what its size takes beside
SUFFIXES = (*_TEXT, *(f"{suffix}.gz" for suffix in _TEXT), *_BINARY)
IN_FOLDERS = (".csv", ".csv.gz", *_BINARY)  # of the records there; other text may be more


def read_table(
    path: Path, layout: RecordFormat | None, trusted: bool = False
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Read the columns of a record file.

    Parameters
    ----------
    path : Path
        A text file such as csv, also gzipped, a parquet or a mat file.
    layout : RecordFormat or None
        Foreign names and units; None reads every column that is numbers.
    trusted : bool
        Whether the file is known to be sound, as one with a registered checksum is.

    Returns
    -------
    table : dict of str to array
        Columns by the file's own names: those that make up a record, and what else is numbers.
    notes : tuple of str
        How the file was read, where that was not plain.

    Raises
    ------
    DataError
        The file is missing, empty, damaged, too large, or of unknown type.
    RecordError
        A column is missing or holds text.
    """
    path, suffix = _checked(path)
    try:
        if path.stat().st_size == 0:
            raise DataError("the file is empty; log or copy it again")
        if suffix == ".mat":
            return _read_mat(path, layout, trusted)
        return (_read_parquet if suffix == ".parquet" else _read_csv)(path, layout)
    except IVToolsError:
        raise
    except Exception as error:  # a parser of another library met a damaged file
        reason = shown(" ".join(str(error).split()), 200) or type(error).__name__
        raise DataError(
            f"cannot be read as {suffix[1:]}: {reason}; mend it or copy it again"
        ) from error


def preamble(path: Path) -> tuple[str, ...]:
    """Return the lines above the header of a text file."""
    from ivtools.csv_layout import sniff

    path, suffix = _checked(path)
    return () if suffix in _BINARY else sniff(path).preamble


def _checked(path: Path) -> tuple[Path, str]:
    """Return the path of an existing file and its suffix."""
    try:
        path = path.expanduser()
        there, is_file = path.exists(), path.is_file()
    except (OSError, RuntimeError, ValueError) as error:  # a name too long, an unknown ~user
        reason = getattr(error, "strerror", None) or str(error)
        raise DataError(f"this is no usable path: {reason}; check the name") from error
    if not there:
        raise DataError("there is no such file; check the name and the folder")
    if not is_file:
        raise DataError("it is not a file; name the file itself")
    suffix = next((s for s in SUFFIXES if path.name.lower().endswith(s)), None)
    if suffix is None:
        kind = shown(path.suffix) or "(no suffix)"
        raise DataError(f"unknown file type {kind}; known are {', '.join(SUFFIXES)}")
    return path, suffix


def frame_table(frame: pd.DataFrame, layout: RecordFormat) -> dict[str, NDArray[np.float64]]:
    """Return a record's columns of a DataFrame, and what else it has in numbers.

    A named index is a column.
    """
    if frame.index.name is not None and frame.index.name not in frame.columns:
        frame = frame.reset_index()
    return _joined([frame], [str(name) for name in frame.columns], layout)


def _joined(
    pieces: Iterable[pd.DataFrame],
    names: list[str],
    layout: RecordFormat | None,
    decimal: str = ".",
) -> dict[str, NDArray[np.float64]]:
    """Return the columns of pieces of a table, one below the other, as numbers.

    A column that is wanted must be numbers; others are left out where they are not.
    """
    limits.check_columns(names)
    wanted: set[str] = set()
    clocks: dict[int, _Stamps] = {}
    kept: dict[int, list[NDArray[np.float64]]] = {i: [] for i in range(len(names))}
    n = 0
    for piece in pieces:
        if n == 0:
            clocks = {i: _Stamps() for i in kept if _Stamps.holds(piece.iloc[:, i])}
            names = [_in_seconds(x) if i in clocks else x for i, x in enumerate(names)]
            wanted = _wanted(names, layout)
        for i in list(kept):
            column = piece.iloc[:, i]
            spoilt = layout is None or layout.rows == "usable"
            if i in clocks:
                kept[i].append(clocks[i].seconds(names[i], column, spoilt))
            elif names[i] in wanted:
                kept[i].append(_numbers(names[i], column, n, spoilt, decimal))
            elif column.dtype.kind in "biuf":
                kept[i].append(column.to_numpy(dtype=float))
            elif (numbers := _mostly(column, decimal)) is not None:
                kept[i].append(numbers)
            elif layout is None and column.notna().sum() == 0:
                kept[i].append(np.full(len(column), np.nan))
            else:
                del kept[i]
        n += len(piece)
        limits.check_size(n * len(kept))
    table = {}
    for i in list(kept):
        parts = kept.pop(i)
        table[names[i]] = parts[0] if len(parts) == 1 else np.concatenate(parts or [np.zeros(0)])
        table[names[i]].flags.writeable = False  # a record then needs no copy of its own
    return table


def _in_seconds(name: str) -> str:
    """Return the name of a column that was read as times of the day, whatever its header says."""
    plain, unit = plain_name(name)
    return f"{plain if unit in _TIMES else name.strip()} [s]"


class _Stamps:
    """Times of the day, after a date or not, read as seconds from the first row."""

    _CLOCK = re.compile(r"(?:^|[ T])(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d{1,12})?)")
    _DAY = 86400.0  # s

    def __init__(self) -> None:
        self._first: float | None = None
        self._last = 0.0

    @classmethod
    def holds(cls, column: pd.Series) -> bool:
        """Whether a column begins with such a time."""
        first = column.iloc[0] if len(column) else None
        return isinstance(first, str) and len(first) < 60 and bool(cls._CLOCK.search(first))

    def seconds(self, name: str, column: pd.Series, spoilt: bool) -> NDArray[np.float64]:
        """Return the next rows, s; behind midnight a day more; NaN where rows may be spoilt."""
        parts = column.astype(str).str.extract(self._CLOCK)
        told = parts.notna().all(axis=1).to_numpy()
        if spoilt and told.any() and not told.all():
            t = np.full(len(told), np.nan)
            t[told] = self.seconds(name, column[told], spoilt)
            return t
        if not told.all():
            row = int(np.argmax(parts.isna().any(axis=1).to_numpy()))
            raise RecordError(
                f"{shown(name)} holds {shown(str(column.iloc[row]))!r}, which is no time as the "
                "first row's is; clean the file"
            )
        h, m, s = (parts[k].str.replace(",", ".").to_numpy(dtype=float) for k in range(3))
        t = 3600.0 * h + 60.0 * m + s
        self._first = float(t[0]) if self._first is None else self._first
        t = t - self._first
        steps = np.diff(t, prepend=self._last)
        t = t + self._DAY * np.cumsum(np.round(-steps / self._DAY))
        self._last = float(t[-1])
        return t


def _wanted(names: list[str], layout: RecordFormat | None) -> set[str]:
    if layout is None:
        return set()
    found = match_columns(names, layout.columns, layout.units, timed=layout.rate is None)
    return {name for group in found.values() for name in group}


def _plain_numbers(column: pd.Series, decimal: str) -> pd.Series:
    """Return cells as numbers, marks between thousands left out, and NaN where there is none."""
    import pandas as pd

    text = column.astype(str).str.strip()
    if decimal == ",":
        text = text.str.replace(".", "'", regex=False).str.replace(",", ".", regex=False)
    marked = text.str.fullmatch(_THOUSANDS)
    text = text.where(~marked, text.str.replace(r"[^\d.+-]", "", regex=True))
    return pd.to_numeric(text, errors="coerce")


def _mostly(column: pd.Series, decimal: str) -> NDArray[np.float64] | None:
    """Return a column whose cells are numbers but for some; None if there are too many others."""
    if column.dtype.kind not in "OTU" and str(column.dtype) not in ("str", "string"):
        return None
    numbers = _plain_numbers(column, decimal).to_numpy(dtype=float)
    return numbers if np.isfinite(numbers).mean() > _MOSTLY else None


def _numbers(
    name: str, column: pd.Series, first: int = 0, spoilt: bool = False, decimal: str = "."
) -> NDArray[np.float64]:
    """Return a column as numbers; cells that are none are NaN if it may be `spoilt`."""
    import pandas as pd

    if column.dtype.kind in "Mm":
        raise RecordError(f"{shown(name)} holds dates; give seconds from the start of the record")
    if pd.api.types.is_numeric_dtype(column) and column.dtype.kind != "c":
        return column.to_numpy(dtype=float, na_value=np.nan)
    numbers = _plain_numbers(column, decimal)
    text = (numbers.isna() & column.notna()).to_numpy()
    if text.any() and not spoilt:
        row = int(np.argmax(text))
        raise RecordError(
            f"{shown(name)} holds {shown(str(column.iloc[row]))!r} at row {first + row} (rows of "
            "data count from 0), not a number; clean the file, or leave such rows out by "
            '[record] rows = "usable" in the axis file'
        )
    return numbers.to_numpy(dtype=float, na_value=np.nan)


class _Bounded(io.RawIOBase):
    """A stream of text that ends in an error where lines or the whole are beyond what is read."""

    def __init__(self, source: IO[bytes], n_columns: int):
        self._source, self._line = source, 0
        self._lines = self._bytes = 0
        self._most = limits.most_numbers() // n_columns + _SPARE
        self._longest = n_columns * limits.LONGEST
        self._usual = n_columns * _PER_NUMBER

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        block = self._source.read(len(buffer))
        last = block.rfind(b"\n")
        self._line = self._line + len(block) if last < 0 else len(block) - last
        self._lines += block.count(b"\n")
        self._bytes += len(block)
        if self._lines > self._most:
            limits.check_size(limits.most_numbers() + 1)
        wide = self._bytes > self._usual * self._lines + _SPARE * _PER_NUMBER
        if wide or self._line > self._longest:
            raise DataError(
                f"lines are far longer than {self._usual} characters; is this a csv file?"
            )
        buffer[: len(block)] = block
        return len(block)


def _read_csv(path: Path, layout: RecordFormat | None) -> tuple[dict[str, Any], tuple[str, ...]]:
    import pandas as pd

    from ivtools.csv_layout import open_text, sniff

    found = sniff(path)
    limits.check_size(int(0.8 * found.rows * len(found.names)))  # as it looks, before reading
    with open_text(path) as source:
        stream = io.BufferedReader(_Bounded(source, len(found.names)), 1 << 18)
        pieces = pd.read_csv(  # no usecols: with it pandas drops the surplus of too long rows
            stream,
            sep=found.separator,
            decimal=found.decimal,
            comment=found.comment,
            encoding=found.encoding,
            header=None,
            names=range(len(found.names)),
            skiprows=found.first_row,
            index_col=False,
            skipinitialspace=True,
            low_memory=False,
            chunksize=max(_PIECE // len(found.names), 100),
        )
        return _joined(pieces, list(found.names), layout, found.decimal), found.notes


def _read_parquet(
    path: Path, layout: RecordFormat | None
) -> tuple[dict[str, Any], tuple[str, ...]]:
    pq, arrow = optional("pyarrow.parquet", "parquet"), optional("pyarrow", "parquet")
    types = arrow.types
    with pq.ParquetFile(path, pre_buffer=False) as file:
        schema = file.schema_arrow
        limits.check_columns(schema.names)
        wanted = _wanted(schema.names, layout)
        numeric = (types.is_integer, types.is_floating, types.is_boolean)
        names = [
            f.name for f in schema if f.name in wanted or any(test(f.type) for test in numeric)
        ]
        limits.check_size(file.metadata.num_rows * len(names))
        nested = [f for f in schema if f.name in names and types.is_nested(f.type)]
        if nested:
            raise RecordError(f"{shown(nested[0].name)} holds lists or tables; give numbers")
        told = (types.is_string, types.is_large_string, types.is_binary, types.is_large_binary)
        texts = [f.name for f in schema if f.name in names and any(t(f.type) for t in told)]
    # a text that is repeated lies once in the file, and once in a dictionary in memory
    with pq.ParquetFile(path, pre_buffer=False, read_dictionary=texts) as file:
        _check_texts(file, texts)
        batches = file.iter_batches(max(_PIECE // max(len(names), 1), 100), columns=names)
        frames = (_plain(batch.to_pandas(ignore_metadata=True)[names]) for batch in batches)
        table = _joined(frames, names, layout)
    arrow.default_memory_pool().release_unused()  # which else keeps as much as the file takes
    return table, ()


def _check_texts(file: Any, names: list[str]) -> None:
    """Refuse columns of text whose cells are far longer than numbers or times are."""
    about = file.metadata
    for group in range(about.num_row_groups):
        for i in range(about.num_columns):
            column = about.row_group(group).column(i)
            most = _PER_NUMBER * column.num_values + limits.LONGEST * _PER_NUMBER
            if column.path_in_schema in names and column.total_uncompressed_size > most:
                name = shown(column.path_in_schema)
                raise DataError(f"{name} holds long texts, not numbers; clean the file")


def _plain(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table whose texts are texts again, each there once."""
    for name in frame.columns:
        if frame[name].dtype == "category":
            if any(len(str(text)) > limits.LONGEST for text in frame[name].cat.categories):
                raise DataError(f"{shown(name)} holds long texts, not numbers; clean the file")
            frame[name] = frame[name].astype(object)
    return frame


def _read_mat(
    path: Path, layout: RecordFormat | None, trusted: bool
) -> tuple[dict[str, Any], tuple[str, ...]]:
    with tempfile.TemporaryDirectory(prefix="ivtools-") as folder:
        result = Path(folder) / "content.npz"
        _unpack(path, result, trusted)
        with np.load(result, allow_pickle=False) as content:
            table = {str(n): _vector(content[f"v{i}"]) for i, n in enumerate(content["names"])}
    limits.check_columns(list(table))
    emps = {ours: theirs for ours, theirs in EMPS.items() if theirs in table}
    if layout is None or len(emps) < 3 or "q" in table:
        return table, ()
    ours = {**emps, **layout.columns}
    named = {*layout.columns.values()}
    rest = {k: v for k, v in table.items() if k not in emps.values() or k in named}
    return {**rest, **{k: table[v] for k, v in emps.items() if ours[k] == v}}, ("EMPS file",)


def _unpack(path: Path, result: Path, trusted: bool) -> None:
    """Write the variables of a MATLAB file as npz, in a process of its own unless it is trusted."""
    arguments = [str(path), str(result), str(limits.most_numbers())]
    if trusted and mat_child.main(*arguments) == 0:
        return
    seconds = _PATIENCE + path.stat().st_size / 10e6
    command = [sys.executable, "-I", mat_child.__file__, *arguments]
    try:
        done = subprocess.run(command, capture_output=True, timeout=seconds, check=False)
    except subprocess.TimeoutExpired:
        raise DataError(f"cannot be read as mat within {seconds:.0f} s; save it again") from None
    if done.returncode == mat_child.TOO_LARGE:
        limits.check_size(limits.most_numbers() + 1)
    if done.returncode:
        reason = shown(" ".join(done.stdout.decode(errors="replace").split()), 200)
        reason = reason if done.returncode == mat_child.REFUSED and reason else "it is damaged"
        raise DataError(f"cannot be read as mat: {reason}; mend it or copy it again")


def _vector(values: NDArray[Any]) -> NDArray[Any]:
    """Return a MATLAB row or column vector as a one-dimensional array."""
    return values.ravel() if values.ndim == 2 and 1 in values.shape else values
