"""The tidy table of a study: its columns, its order, and the files that it streams to."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ivtools.digest import digest
from ivtools.errors import DataError
from ivtools.files import write

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
    "half_width": "float64",
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
    def stem(self) -> str:
        """How the name of its part file begins."""
        who = digest(self.case, self.estimators)[:24]
        return f"part-{who}-{self.first:07d}-{self.last:07d}"


@dataclass(frozen=True)
class Store:
    """A folder of part files, each written at once and never changed.

    A part is written whole or not at all, and what is finished is read off the parts themselves:
    there is no list of them that could disagree. The name of a part ends with the checksum of its
    content.

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
        content, file = table.replace_schema_metadata({_ABOUT: json.dumps(about)}), BytesIO()
        pq.write_table(content, file, compression="zstd")
        data = file.getvalue()
        write(self.folder / f"{block.stem}-{checksum(data)}.parquet", data)

    def blocks(self) -> Iterator[tuple[Block, pa.Table]]:
        """Yield the finished blocks and their rows, in the order of the names.

        Raises
        ------
        DataError
            A file is not as it was written.
        """
        for path in sorted(self.folder.glob("part-*.parquet")):
            try:
                yield _block(path)
            except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
                reason = " ".join(str(error).split())[:200]
                raise DataError(
                    f"{path} is not a part of a study ({reason}); delete it and run again"
                ) from error

    def read(self, wanted: Iterable[Block]) -> Iterator[pa.Table]:
        """Yield the rows of the wanted repetitions, each once, file by file."""
        import pyarrow.compute as pc

        cases = {block.case: block for block in wanted}
        for block, rows in self.blocks():
            mine = cases.get(block.case)
            if mine is None:
                continue
            labels = [k for k, v in block.estimators.items() if mine.estimators.get(k) == v]
            if labels and block.first < mine.last:
                keep = pc.and_(
                    pc.is_in(rows["estimator"], pc.cast(labels, "string")),
                    pc.less(rows["seed"], mine.last),
                )
                yield rows.filter(keep).replace_schema_metadata(None)


def _block(path: Path) -> tuple[Block, pa.Table]:
    """Return what a part says that it is, and its rows."""
    import pyarrow.parquet as pq

    data = path.read_bytes()
    if not path.stem.endswith(f"-{checksum(data)}"):
        raise ValueError("its content does not have the checksum of its name")
    rows = pq.read_table(BytesIO(data))
    about = json.loads(rows.schema.metadata[_ABOUT])
    block = Block(str(about["case"]), dict(about["estimators"]), *map(int, about["seeds"]))
    if not rows.schema.equals(part([]).schema) or path.stem != f"{block.stem}-{checksum(data)}":
        raise ValueError("its name or its columns are not those of its rows")
    return block, rows


def checksum(data: bytes) -> str:
    """Return the checksum of a part, as its name ends."""
    return hashlib.sha256(data).hexdigest()[:16]
