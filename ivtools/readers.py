"""Readers of record files: csv, csv.gz, parquet and MATLAB files become tables by column name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ivtools.columns import match_columns
from ivtools.errors import DataError, IVToolsError, RecordError

if TYPE_CHECKING:
    import pandas as pd
    from numpy.typing import NDArray

    Table = dict[str, NDArray[np.float64]]

__all__ = ["frame_table", "read_table"]

#: The variables of the EMPS files, ours = theirs.
EMPS = {"q": "qm", "q_ref": "qg", "nu": "vir", "added": "pulses_N"}
SUFFIXES = (".csv", ".csv.gz", ".parquet", ".mat")


def read_table(
    path: Path, columns: Mapping[str, str] | None = None
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Read the columns of a record file that make up a record.

    Parameters
    ----------
    path : Path
        A csv, csv.gz, parquet or mat file.
    columns : mapping of str to str, optional
        Foreign names, ours = theirs.

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
        return _READERS[suffix](path, columns)
    except IVToolsError:
        raise
    except Exception as error:  # a parser of another library met a damaged file
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise DataError(
            f"cannot be read as {suffix[1:]}: {reason}; mend it or copy it again"
        ) from error


def frame_table(
    frame: pd.DataFrame, columns: Mapping[str, str] | None = None
) -> dict[str, NDArray[np.float64]]:
    """Return a record's columns of a DataFrame, and what else it has in numbers.

    A named index is a column.
    """
    if frame.index.name is not None and frame.index.name not in frame.columns:
        frame = frame.reset_index()
    names = [str(name) for name in frame.columns]
    wanted = {name for group in match_columns(names, columns).values() for name in group}
    return {
        name: _numbers(name, frame.iloc[:, position])
        for position, name in enumerate(names)
        if name in wanted or frame.iloc[:, position].dtype.kind in "biuf"
    }


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


def _read_csv(
    path: Path, columns: Mapping[str, str] | None
) -> tuple[dict[str, Any], tuple[str, ...]]:
    import pandas as pd

    from ivtools.csv_layout import sniff

    layout = sniff(path)
    frame = pd.read_csv(  # no usecols: with it pandas drops the surplus of rows that are too long
        path,
        sep=layout.separator,
        decimal=layout.decimal,
        comment=layout.comment,
        encoding=layout.encoding,
        header=None,
        names=range(len(layout.names)),
        skiprows=layout.first_row,
        index_col=False,
        skipinitialspace=True,
        low_memory=False,
    )
    return frame_table(frame.rename(columns=dict(enumerate(layout.names))), columns), layout.notes


def _read_parquet(
    path: Path, columns: Mapping[str, str] | None
) -> tuple[dict[str, Any], tuple[str, ...]]:
    import pandas as pd

    return frame_table(pd.read_parquet(path), columns), ()


def _read_mat(
    path: Path, columns: Mapping[str, str] | None
) -> tuple[dict[str, Any], tuple[str, ...]]:
    from scipy.io import loadmat

    try:
        content = loadmat(path, appendmat=False)
    except NotImplementedError:
        raise DataError("this is a MATLAB 7.3 file; save it in MATLAB with '-v7'") from None
    table = {k: _vector(v) for k, v in content.items() if not k.startswith("__")}
    emps = {ours: theirs for ours, theirs in EMPS.items() if theirs in table}
    if len(emps) < 3 or "q" in table:
        return table, ()
    ours = {**emps, **(columns or {})}
    named = {*(columns or {}).values()}
    rest = {k: v for k, v in table.items() if k not in emps.values() or k in named}
    return {**rest, **{k: table[v] for k, v in emps.items() if ours[k] == v}}, ("EMPS file",)


def _vector(values: Any) -> Any:
    """Return a MATLAB row or column vector as a one-dimensional array."""
    is_vector = isinstance(values, np.ndarray) and values.ndim == 2 and 1 in values.shape
    return values.ravel() if is_vector else values


_READERS = {
    ".csv": _read_csv,
    ".csv.gz": _read_csv,
    ".parquet": _read_parquet,
    ".mat": _read_mat,
}
