"""What a worker does: simulate the records of a block and fit every estimator to each."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import cloudpickle

from ivtools.errors import IVToolsError
from ivtools.study.case import HOLDOUT, Case
from ivtools.study.outcome import Outcome, failure, fit, rows
from ivtools.study.table import Row, part
from ivtools.workers import packed
from ivtools.workers import quiet as quiet

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
    """Return a case and its estimators as bytes, the same for every block of the case."""
    what = f"case {case.name} or one of its estimators"
    return packed((case, dict(estimators)), map(type, estimators.values()), what)


def work(sent: bytes | Bench, first: int, last: int) -> pa.Table:
    """Return the rows of repetitions `first` to `last` (excluded)."""
    bench = _bench(sent) if isinstance(sent, bytes) else sent
    with quiet():
        return part([row for seed in range(first, last) for row in bench.rows(seed)])


@lru_cache(maxsize=4)
def _bench(sent: bytes) -> Bench:
    return Bench(*cloudpickle.loads(sent))
