"""Where work is done: this process, others, threads, or a Dask cluster; joblib's backends."""

from __future__ import annotations

import ctypes
import logging
import os
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from functools import cache
from threading import Event, Lock, Thread, local
from time import perf_counter, sleep
from types import ModuleType
from typing import Any, Literal, NamedTuple, TypeVar

from ivtools.errors import (
    EstimationError,
    IVToolsError,
    IVToolsWarning,
    MissingExtraError,
    WorkersLostError,
)

Backend = Literal["loky", "threading", "dask"]
BACKENDS: tuple[Backend, ...] = ("loky", "threading", "dask")
Result = TypeVar("Result")
Lost = Callable[..., Any]

_MOST = 1000  # workers
_M_ARENA_MAX = -8  # glibc's malloc.h
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
    lost: Lost | None = None,
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
    lost : callable, optional
        Makes the result, of ``(*task, reason)``, where workers die of a task.

    Raises
    ------
    IVToolsError
        There can be no such number of workers, or no scheduler answers.
    WorkersLostError
        The workers or the scheduler died.

    Examples
    --------
    >>> list(outcomes(pow, [(2, 3), (3, 2)]))
    [8, 9]
    """
    if (
        isinstance(n_jobs, bool)
        or not isinstance(n_jobs, int)
        or not -1 <= n_jobs <= _MOST
        or not n_jobs
    ):
        raise IVToolsError(
            f"{n_jobs} workers; give a whole number from 1 to {_MOST}, or -1 for one per core"
        )
    if n_jobs == 1 and backend != "dask":
        yield from (work(*task) for task in tasks)
        return
    with _parallel(backend, scheduler):
        hands = _Hands(work, tasks, lost)
        yield from hands.outcomes(-1 if backend == "dask" else n_jobs)


class _Hands:
    """Tasks in the hands of workers: those of a worker that dies are given to others.

    A task whose worker has died twice is given to one that does nothing else, so that the one which
    kills its worker, whatever else was in hand, is known.
    """

    def __init__(self, work: Callable[..., Any], tasks: Iterable[Any], lost: Lost | None):
        self.work, self.lost = work, lost
        self.rest = enumerate(tasks)
        self.again: list[tuple[int, Any]] = []
        self.held: dict[int, Any] = {}
        self.deaths: Counter[int] = Counter()

    def outcomes(self, n_jobs: int) -> Iterator[Any]:
        """Yield the result of every task."""
        while True:
            try:
                yield from self._run(self._handed_out(), n_jobs)
                return
            except BrokenProcessPool:
                self.deaths.update(self.held.keys())
            suspects = [number for number in self.held if self.deaths[number] >= 2]
            alone = [(number, self.held.pop(number)) for number in suspects]
            self.again += self.held.items()
            self.held.clear()
            for number, task in alone:
                yield self._alone(number, task)

    def _handed_out(self) -> Iterator[tuple[int, Any]]:
        while self.again:
            yield self.again.pop()
        yield from self.rest

    def _run(self, numbered: Iterable[tuple[int, Any]], n_jobs: int) -> Iterator[Any]:
        import joblib

        def calls() -> Iterator[Any]:
            for number, task in numbered:
                self.held[number] = task
                yield joblib.delayed(_numbered)(number, self.work, task, os.getpid())

        parallel = joblib.Parallel(n_jobs, batch_size=1, return_as="generator_unordered")
        for number, result in parallel(calls()):
            del self.held[number]
            yield result

    def _alone(self, number: int, task: Any) -> Any:
        for _ in range(2):  # somebody else may have ended it
            try:
                (result,) = self._run([(number, task)], 2)  # one would be this process
                return result
            except BrokenProcessPool:
                self.held.clear()
        reason = "its worker died each time; it may need more memory than there is"
        if self.lost is None:
            raise WorkersLostError(f"a piece of work cannot be done: {reason}")
        return self.lost(*task, reason)


def _numbered(
    number: int, work: Callable[..., Any], task: tuple[Any, ...], leader: int
) -> tuple[int, Any]:
    if os.getppid() == leader:
        _follow(leader)
    return number, work(*task)


@cache
def _share_heap() -> None:
    """Let the threads of this process share one heap.

    glibc gives each thread heaps of its own and keeps what was freed there: where diagnoses follow
    each other, a process grew from 280 to 580 MB in ten of them, of which it held 75. Elsewhere
    nothing is done.
    """
    with suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").mallopt(_M_ARENA_MAX, 1)


@cache
def _follow(leader: int) -> None:
    """End this worker with the process that leads it, however that ends."""

    def watch() -> None:
        while os.getppid() == leader:
            sleep(1.0)
        os._exit(1)

    Thread(target=watch, daemon=True).start()


@contextmanager
def _parallel(backend: Backend, scheduler: str | None) -> Iterator[None]:
    """Set joblib's backend."""
    import joblib

    if backend != "dask":
        with joblib.parallel_config(backend=backend):
            yield
        return
    try:
        from distributed import Client, KilledWorker, get_client
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
    mine = nullcontext() if scheduler is None else client  # a current one has somebody to close it
    try:
        with _hushed("distributed"), mine, joblib.parallel_config(backend="dask", client=client):
            yield
    except (CancelledError, KilledWorker, OSError) as error:
        raise WorkersLostError(
            f"the Dask scheduler or its workers have died ({type(error).__name__})"
        ) from error


@contextmanager
def _hushed(name: str) -> Iterator[None]:
    """Keep back what a library logs about an error that it also raises."""
    loggers = [logging.getLogger(n) for n in logging.root.manager.loggerDict if n.startswith(name)]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


_CALM, _RUNNING = Lock(), ExitStack()
_DEPTH = [0]


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Give BLAS one thread for as long as any diagnosis of this process runs.

    For many small products, threads of its own only wait, and sums in another order round
    otherwise. The limit is the process's: the first diagnosis sets it, and the last one lifts it.
    """
    from threadpoolctl import threadpool_limits

    _share_heap()
    with _CALM:
        if _DEPTH[0] == 0:
            _RUNNING.enter_context(threadpool_limits(1, "blas"))
        _DEPTH[0] += 1
    try:
        yield
    finally:
        with _CALM:
            _DEPTH[0] -= 1
            if _DEPTH[0] == 0:
                _RUNNING.close()


_SECOND = Lock()  # held while the second thread works
_HELPING = local()  # in that thread: whether the first one has given up


def still_wanted() -> None:
    """Raise CancelledError in a thread that helps another one which has given up, else nothing.

    Whoever is interrupted waits for the thread that helps: long work asks now and then.
    """
    given_up = getattr(_HELPING, "given_up", None)
    if given_up is not None and given_up.is_set():
        raise CancelledError


def threaded(f: Callable[..., Result], *items: Iterable[Any]) -> list[Result]:
    """Return what a function gives for each of some items, as `map` does, on two threads.

    The second one helps whoever has something left to do when it has not: of parts that are made
    of parts, the small ones are shared as well. Two are all there are in a process.

    Parameters
    ----------
    f : callable
    items : iterables
        Its arguments.

    Examples
    --------
    >>> threaded(pow, [2, 3], [5, 2])
    [32, 9]
    """
    tasks = list(zip(*items, strict=False))
    done: dict[int, Result] = {}
    waiting, given_up = iter(range(len(tasks))), Event()

    def help_out() -> None:
        """Do what is waiting, and be free again."""
        _HELPING.given_up = given_up
        try:
            for k in waiting:
                done[k] = f(*tasks[k])
        finally:
            _SECOND.release()

    with ThreadPoolExecutor(1) as pool:
        helped = []
        try:
            for k in waiting:
                still_wanted()
                if k + 1 < len(tasks) and _SECOND.acquire(blocking=False):
                    helped.append(pool.submit(help_out))
                done[k] = f(*tasks[k])
            for one in helped:  # what failed there fails here
                one.result()
        except BaseException:
            given_up.set()
            raise
        finally:
            for _ in waiting:  # what fails here ends there too
                pass
    return [done[k] for k in range(len(tasks))]


@contextmanager
def quiet() -> Iterator[None]:
    """Use one thread for linear algebra, whose sums then have one order; keep warnings back.

    What the warnings say is in the results.
    """
    from threadpoolctl import threadpool_limits

    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # where it cannot keep its fonts
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
