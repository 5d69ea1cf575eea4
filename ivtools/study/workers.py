"""Blocks of a study on joblib's workers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from time import perf_counter
from typing import TYPE_CHECKING

from ivtools import workers
from ivtools.study.plan import Task
from ivtools.study.table import Block
from ivtools.study.work import Bench, work

if TYPE_CHECKING:
    import pyarrow as pa


def _timed(block: Block, sent: bytes | Bench) -> tuple[Block, pa.Table, float]:
    start = perf_counter()
    table = work(sent, block.first, block.last)
    return block, table, perf_counter() - start


def outcomes(
    tasks: Iterable[Task], n_jobs: int, backend: workers.Backend, scheduler: str | None
) -> Iterator[tuple[Block, pa.Table, float]]:
    """Yield the finished blocks as they come, each with the seconds that a worker was on it."""
    yield from workers.outcomes(_timed, tasks, n_jobs, backend, scheduler)
