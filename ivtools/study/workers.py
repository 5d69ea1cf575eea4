"""Where the work is done: this process, others, threads, or a Dask cluster; joblib's backends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import TYPE_CHECKING, Literal

from ivtools.errors import IVToolsError, MissingExtraError
from ivtools.study.plan import Task
from ivtools.study.table import Block
from ivtools.study.work import Bench, work

if TYPE_CHECKING:
    import pyarrow as pa

Backend = Literal["loky", "threading", "dask"]

TIMEOUT_S = 20.0  # for a Dask scheduler to answer


def _timed(block: Block, sent: bytes | Bench) -> tuple[Block, pa.Table, float]:
    start = perf_counter()
    table = work(sent, block.first, block.last)
    return block, table, perf_counter() - start


def outcomes(
    tasks: Iterable[Task], n_jobs: int, backend: Backend, scheduler: str | None
) -> Iterator[tuple[Block, pa.Table, float]]:
    """Yield the finished blocks as they come, each with the seconds that a worker was on it."""
    import joblib

    if n_jobs == 1 and backend != "dask":
        yield from (_timed(*task) for task in tasks)
    else:
        with _parallel(backend, scheduler):
            n_jobs = -1 if backend == "dask" else n_jobs
            parallel = joblib.Parallel(n_jobs, batch_size=1, return_as="generator_unordered")
            yield from parallel(joblib.delayed(_timed)(*task) for task in tasks)


@contextmanager
def _parallel(backend: Backend, scheduler: str | None) -> Iterator[None]:
    """Set joblib's backend."""
    import joblib

    if backend != "dask":
        with joblib.parallel_config(backend=backend):
            yield
        return
    try:
        from distributed import Client, get_client
    except ImportError as error:
        raise MissingExtraError("distributed", "distributed") from error
    try:
        if scheduler is None:
            client = get_client()
        else:
            client = Client(scheduler, set_as_default=False, timeout=TIMEOUT_S)
    except (OSError, ValueError) as error:
        where = "here; give the scheduler's address" if scheduler is None else f"at {scheduler}"
        raise IVToolsError(f"no Dask scheduler answers {where} ({error})") from error
    if scheduler is None:  # somebody else's client, who will close it
        with joblib.parallel_config(backend="dask", client=client):
            yield
        return
    with client, joblib.parallel_config(backend="dask", client=client):
        yield
