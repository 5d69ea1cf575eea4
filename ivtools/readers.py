"""Readers of record files: csv, csv.gz, parquet and MATLAB files become tables by column name."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ivtools.columns import match_columns
from ivtools.errors import DataError, IVToolsError, RecordError

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

    from ivtools.record_format import RecordFormat

    Table = dict[str, NDArray[np.float64]]

__all__ = ["SUFFIXES", "frame_table", "read_table"]

#: The variables of the EMPS files, ours = theirs.
EMPS = {"q": "qm", "q_ref": "qg", "nu": "vir", "added": "pulses_N"}
_TEXT = (".csv", ".txt", ".tsv", ".dat", ".asc", ".log")
SUFFIXES = (*_TEXT, *(f"{suffix}.gz" for suffix in _TEXT), ".parquet", ".mat")


def read_table(path: Path, layout: RecordFormat) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Read the columns of a record file that make up a record.

    Parameters
    ----------
    path : Path
        A csv, csv.gz, parquet or mat file.
    layout : RecordFormat
        Foreign names and units.

    Returns
    -------
    table : dict of str to array
        Columns by the file's own names.
    notes : tuple of str
        How the file was read, where that was not plain.

    Raises
    ------
    DataError
        The file is missing, empty, damaged or of unknown type.
    RecordError
        A column is missing or holds text.
    """
    path = path.expanduser()
    if not path.exists():
        raise DataError("there is no such file; check the name and the folder")
    if not path.is_file():
        raise DataError("it is not a file; name the file itself")
    suffix = next((s for s in SUFFIXES if path.name.lower().endswith(s)), None)
    if suffix is None:
        raise DataError(
            f"unknown file type {path.suffix or '(no suffix)'}; known are {', '.join(SUFFIXES)}"
        )
    try:
        if path.stat().st_size == 0:
            raise DataError("the file is empty; log or copy it again")
        return _READERS.get(suffix, _read_csv)(path, layout)
    except IVToolsError:
        raise
    except Exception as error:  # a parser of another library met a damaged file
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise DataError(
            f"cannot be read as {suffix[1:]}: {reason}; mend it or copy it again"
        ) from error


def frame_table(frame: pd.DataFrame, layout: RecordFormat) -> dict[str, NDArray[np.float64]]:
    """Return a record's columns of a DataFrame, and what else it has in numbers.

    A named index is a column.
    """
    if frame.index.name is not None and frame.index.name not in frame.columns:
        frame = frame.reset_index()
    names = [str(name) for name in frame.columns]
    wanted = {name for group in _matched(names, layout).values() for name in group}
    return {
        name: _numbers(name, frame.iloc[:, position])
        for position, name in enumerate(names)
        if name in wanted or frame.iloc[:, position].dtype.kind in "biuf"
    }


def _matched(names: list[str], layout: RecordFormat) -> dict[str, list[str]]:
    return match_columns(names, layout.columns, layout.units, timed=layout.rate is None)


def _numbers(name: str, column: pd.Series) -> NDArray[np.float64]:
    import pandas as pd

    if column.dtype.kind in "Mm":
        raise RecordError(f"{name} holds dates; give seconds from the start of the record")
    if pd.api.types.is_numeric_dtype(column) and column.dtype.kind != "c":
        return column.to_numpy(dtype=float, na_value=np.nan)
    numbers = pd.to_numeric(column, errors="coerce")
    text = (numbers.isna() & column.notna()).to_numpy()
    if text.any():
        row = int(np.argmax(text))
        raise RecordError(
            f"{name} holds {str(column.iloc[row])[:40]!r} at row {row} (rows of data count from 0)"
            ", not a number; clean the file"
        )
    return numbers.to_numpy(dtype=float, na_value=np.nan)


def _read_csv(path: Path, layout: RecordFormat) -> tuple[dict[str, Any], tuple[str, ...]]:
    import pandas as pd

    from ivtools.csv_layout import sniff

    found = sniff(path)
    frame = pd.read_csv(  # no usecols: with it pandas drops the surplus of rows that are too long
        path,
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
    )
    return frame_table(frame.rename(columns=dict(enumerate(found.names))), layout), found.notes


def _read_parquet(path: Path, layout: RecordFormat) -> tuple[dict[str, Any], tuple[str, ...]]:
    import pandas as pd

    return frame_table(pd.read_parquet(path), layout), ()


def _read_mat(path: Path, layout: RecordFormat) -> tuple[dict[str, Any], tuple[str, ...]]:
    from scipy.io import loadmat

    try:
        content = loadmat(path, appendmat=False)
    except NotImplementedError:
        raise DataError("this is a MATLAB 7.3 file; save it in MATLAB with '-v7'") from None
    table = {k: _vector(v) for k, v in content.items() if not k.startswith("__")}
    emps = {ours: theirs for ours, theirs in EMPS.items() if theirs in table}
    if len(emps) < 3 or "q" in table:
        return table, ()
    ours = {**emps, **layout.columns}
    named = {*layout.columns.values()}
    rest = {k: v for k, v in table.items() if k not in emps.values() or k in named}
    return {**rest, **{k: table[v] for k, v in emps.items() if ours[k] == v}}, ("EMPS file",)


def _vector(values: Any) -> Any:
    """Return a MATLAB row or column vector as a one-dimensional array."""
    is_vector = isinstance(values, np.ndarray) and values.ndim == 2 and 1 in values.shape
    return values.ravel() if is_vector else values


_READERS = {".parquet": _read_parquet, ".mat": _read_mat}  # and the rest is text
