"""Where work is done: this process, others, threads, or a Dask cluster; joblib's backends."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from time import perf_counter
from types import ModuleType
from typing import Any, Literal, NamedTuple, TypeVar

from ivtools.errors import EstimationError, IVToolsError, IVToolsWarning, MissingExtraError

Backend = Literal["loky", "threading", "dask"]
BACKENDS: tuple[Backend, ...] = ("loky", "threading", "dask")
Result = TypeVar("Result")

TIMEOUT_S = 20.0  # for a Dask scheduler to answer


class Progress(NamedTuple):
    """How far a run is.

    Attributes
    ----------
    done, total : int
        Pieces of work, of this run.
    elapsed, left : float
        s.
    """

    done: int
    total: int
    elapsed: float
    left: float


class Clock:
    """Counts finished pieces of work and estimates the time left."""

    def __init__(self, total: int, progress: Callable[[Progress], object] | None):
        self.total, self.progress, self.done = total, progress, 0
        self.start = perf_counter()

    def tick(self, pieces: int = 1) -> None:
        """Note that so many pieces are done, and tell."""
        self.done += pieces
        if self.progress is not None:
            elapsed = perf_counter() - self.start
            left = elapsed / self.done * (self.total - self.done)
            self.progress(Progress(self.done, self.total, elapsed, left))


def known(backend: str) -> Backend:
    """Return a backend that is known.

    Raises
    ------
    IVToolsError
        It is not.
    """
    for name in BACKENDS:
        if backend == name:
            return name
    raise IVToolsError(f"backend {backend!r} is unknown; use loky, threading or dask")


def outcomes(
    work: Callable[..., Result],
    tasks: Iterable[tuple[Any, ...]],
    n_jobs: int = 1,
    backend: Backend = "loky",
    scheduler: str | None = None,
) -> Iterator[Result]:
    """Yield ``work(*task)`` of every task, as they end.

    Parameters
    ----------
    work : callable
    tasks : iterable of tuple
        Asked for a few at a time, while others are worked on.
    n_jobs : int
        Workers; 1 works in this process, -1 uses every core. Dask uses the whole cluster.
    backend : {"loky", "threading", "dask"}
    scheduler : str, optional
        Address of the Dask scheduler; default the current client's.

    Examples
    --------
    >>> list(outcomes(pow, [(2, 3), (3, 2)]))
    [8, 9]
    """
    import joblib

    if n_jobs == 1 and backend != "dask":
        yield from (work(*task) for task in tasks)
    else:
        with _parallel(backend, scheduler):
            n_jobs = -1 if backend == "dask" else n_jobs
            parallel = joblib.Parallel(n_jobs, batch_size=1, return_as="generator_unordered")
            yield from parallel(joblib.delayed(work)(*task) for task in tasks)


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


@contextmanager
def quiet() -> Iterator[None]:
    """Use one thread for linear algebra, whose sums then have one order; keep warnings back.

    What the warnings say is in the results.
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore", IVToolsWarning)
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def packed(content: Any, makers: Iterable[Any], what: str) -> bytes:
    """Return content as bytes that a worker on another machine can open.

    Classes and functions from a script or a module of the user's own travel as their code, so
    that a worker needs no copy of the file.

    Parameters
    ----------
    content : object
    makers : iterable
        Classes and functions in it that may be the user's own.
    what : str
        Its name, for the error.

    Raises
    ------
    EstimationError
        It cannot be sent.
    """
    import cloudpickle

    own = {m for maker in makers if (m := sys.modules.get(getattr(maker, "__module__", "")))}
    own = {m for m in own if not _installed(m)}
    try:
        for module in own:
            cloudpickle.register_pickle_by_value(module)
        return bytes(cloudpickle.dumps(content))
    except Exception as error:
        raise EstimationError(
            f"{what} cannot be sent to a worker ({error}); keep open files and locks out of it"
        ) from error
    finally:
        for module in own:
            cloudpickle.unregister_pickle_by_value(module)


def _installed(module: ModuleType) -> bool:
    """Whether every worker has this module: it belongs to an installed package, or to us."""
    file = getattr(module, "__file__", None) or ""
    own = module.__name__.split(".")[0] == "ivtools"
    return own or module.__name__ == "__main__" or "-packages" in file or not file
