"""What a worker does: simulate the records of a block and fit every estimator to each."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property, lru_cache
from types import ModuleType
from typing import TYPE_CHECKING, Any

import cloudpickle

from ivtools.errors import EstimationError, IVToolsError, IVToolsWarning
from ivtools.study.case import HOLDOUT, Case
from ivtools.study.outcome import Outcome, failure, fit, rows
from ivtools.study.table import Row, part

if TYPE_CHECKING:
    import pyarrow as pa

    from ivtools.problem import Problem


class Bench:
    """A case and its estimators, prepared once per process.

    Parameters
    ----------
    case : Case
    estimators : mapping of str to estimator
    """

    def __init__(self, case: Case, estimators: Mapping[str, Any]):
        self.case, self.estimators = case, estimators

    @cached_property
    def holdout(self) -> Problem | None:
        """The hold-out record's problem; None if it cannot be made."""
        try:
            problem = self.case.problem(self.case.record(HOLDOUT))
            return problem if problem.X.size else None
        except IVToolsError:
            return None

    def rows(self, seed: int) -> list[Row]:
        """Return the rows of one repetition."""
        try:
            problem = self.case.problem(self.case.record(seed))
            _ = problem.X  # what all estimators share is not part of any one's time
        except IVToolsError as error:
            return [r for k in self.estimators for r in self._rows(k, seed, failure(error), None)]
        return [
            row
            for key, estimator in self.estimators.items()
            for row in self._rows(key, seed, fit(estimator, problem), problem)
        ]

    def _rows(self, key: str, seed: int, outcome: Outcome, problem: Problem | None) -> list[Row]:
        case = self.case
        return rows(outcome, (case.name, key, seed), case.theta_true, problem, self.holdout)


def payload(case: Case, estimators: Mapping[str, Any]) -> bytes:
    """Return a case and its estimators as bytes, the same for every block of the case.

    Classes from a script or a module of the user's own travel as their code, so that a worker on
    another machine needs no copy of the file.
    """
    own = {m for e in estimators.values() if (m := sys.modules.get(type(e).__module__))}
    own = {m for m in own if not _installed(m)}
    try:
        for module in own:
            cloudpickle.register_pickle_by_value(module)
        return bytes(cloudpickle.dumps((case, dict(estimators))))
    except Exception as error:
        raise EstimationError(
            f"case {case.name} or one of its estimators cannot be sent to a worker ({error}); "
            "keep open files and locks out of them"
        ) from error
    finally:
        for module in own:
            cloudpickle.unregister_pickle_by_value(module)


def _installed(module: ModuleType) -> bool:
    """Whether every worker has this module: it belongs to an installed package, or to us."""
    file = getattr(module, "__file__", None) or ""
    own = module.__name__.split(".")[0] == "ivtools"
    return own or module.__name__ == "__main__" or "-packages" in file or not file


def work(sent: bytes | Bench, first: int, last: int) -> pa.Table:
    """Return the rows of repetitions `first` to `last` (excluded)."""
    bench = _bench(sent) if isinstance(sent, bytes) else sent
    with quiet():
        return part([row for seed in range(first, last) for row in bench.rows(seed)])


@contextmanager
def quiet() -> Iterator[None]:
    """Use one thread for linear algebra, whose sums then have one order; keep warnings back.

    What the warnings say is in the table (`converged`, `error`).
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore", IVToolsWarning)
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


@lru_cache(maxsize=4)
def _bench(sent: bytes) -> Bench:
    return Bench(*cloudpickle.loads(sent))
