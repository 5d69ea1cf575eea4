"""The tidy table of a study: its columns, its order, and the files that it streams to."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ivtools.digest import digest
from ivtools.errors import DataError

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

KEYS = ("case", "estimator", "seed", "parameter")
COLUMNS = {
    "case": "string",
    "estimator": "string",
    "seed": "int32",
    "parameter": "string",
    "theta": "float64",
    "theta_true": "float64",
    "std_error": "float64",
    "relative_error": "float64",
    "holdout_error": "float64",
    "converged": "bool",
    "n_iter": "int32",
    "n_simulations": "int32",
    "runtime": "float64",
    "error": "string",
}
"""Columns and types, one row per case, estimator, seed and parameter."""

MEASURED = ("runtime",)
"""Columns that a clock decides; all others are the same for any number of workers, bit for bit."""

Row = tuple[Any, ...]
_ABOUT = b"ivtools"
LEFT_S = 600.0  # no part takes so long to be written


def part(rows: Sequence[Row]) -> pa.Table:
    """Return rows, in the order of `COLUMNS`, as an Arrow table."""
    import pyarrow as pa

    values = list(zip(*rows, strict=True)) if rows else [()] * len(COLUMNS)
    arrays = [pa.array(v, kind) for v, kind in zip(values, COLUMNS.values(), strict=True)]
    return pa.table(arrays, schema=pa.schema(list(COLUMNS.items())))


def frame(parts: Iterable[pa.Table], orders: Mapping[str, Sequence[str]]) -> pd.DataFrame:
    """Return the parts as one DataFrame in the order of the study; no row appears twice.

    Parameters
    ----------
    parts : iterable of Table
    orders : mapping
        Order of the cases, estimators and parameters; others follow by name. These columns become
        categories.
    """
    import pandas as pd
    import pyarrow as pa

    whole = pa.concat_tables([part([]), *parts])
    table = whole.to_pandas(strings_to_categorical=True)
    del whole
    for name, kind in COLUMNS.items():
        if kind == "string":
            order = list(orders.get(name, []))
            rest = sorted(set(table[name].cat.categories) - set(order))
            table[name] = table[name].cat.set_categories(order + rest)
    table = table.sort_values(list(KEYS), kind="stable").drop_duplicates(list(KEYS))
    return pd.DataFrame(table.reset_index(drop=True))


@dataclass(frozen=True)
class Block:
    """Repetitions ``first`` to ``last`` (excluded) of a case, with some of the estimators.

    Parameters
    ----------
    case : str
        Identity of the case.
    estimators : mapping of str to str
        Identity of each estimator by its label.
    first, last : int
        Repetitions.
    """

    case: str
    estimators: Mapping[str, str]
    first: int
    last: int

    @property
    def filename(self) -> str:
        """Name of the part file: two runs that compute the same give the same name."""
        who = digest(self.case, self.estimators)[:24]
        return f"part-{who}-{self.first:07d}-{self.last:07d}.parquet"


@dataclass(frozen=True)
class Store:
    """A folder of part files, each written at once and never changed.

    A part is written beside its place, flushed to the disk and moved there, which the file system
    does whole or not at all; so a part that can be seen is complete, and what is finished is read
    off the parts themselves. There is no list of them that could disagree.

    Parameters
    ----------
    folder : Path
        Made if it does not exist.
    """

    folder: Path

    def write(self, block: Block, table: pa.Table) -> None:
        """Add the rows of a finished block."""
        import pyarrow.parquet as pq

        about = {
            "case": block.case,
            "estimators": dict(block.estimators),
            "seeds": [block.first, block.last],
        }
        table = table.replace_schema_metadata({_ABOUT: json.dumps(about).encode()})
        place = self.folder / block.filename
        beside = place.with_name(f"{place.name}.{os.getpid()}.tmp")
        with open(beside, "wb") as file:
            pq.write_table(table, file, compression="zstd")
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, place)

    def blocks(self) -> Iterator[tuple[Path, Block]]:
        """Yield the finished blocks and their files, in the order of the names."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        for path in sorted(self.folder.glob("part-*.parquet")):
            try:
                about = json.loads(pq.read_schema(path).metadata[_ABOUT])
                block = Block(about["case"], about["estimators"], *about["seeds"])
            except (pa.ArrowInvalid, OSError, KeyError, TypeError, ValueError) as error:
                raise DataError(
                    f"{path} is not a part of a study ({error}); delete it and run again"
                ) from error
            yield path, block

    def read(self, wanted: Iterable[Block]) -> Iterator[pa.Table]:
        """Yield the rows of the wanted repetitions, each once, file by file."""
        import pyarrow.compute as pc
        import pyarrow.parquet as pq

        cases = {block.case: block for block in wanted}
        for path, block in self.blocks():
            mine = cases.get(block.case)
            if mine is None:
                continue
            labels = [k for k, v in block.estimators.items() if mine.estimators.get(k) == v]
            if labels and block.first < mine.last:
                rows = pq.read_table(path)
                keep = pc.and_(
                    pc.is_in(rows["estimator"], pc.cast(labels, "string")),
                    pc.less(rows["seed"], mine.last),
                )
                yield rows.filter(keep).replace_schema_metadata(None)

    def sweep(self) -> None:
        """Remove what killed runs have left half-written; what is being written is younger."""
        for path in self.folder.glob("part-*.tmp"):
            with suppress(FileNotFoundError):  # another run was quicker
                if time.time() - path.stat().st_mtime > LEFT_S:
                    path.unlink()
