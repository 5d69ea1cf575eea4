"""The plan of a run: what is left to do, in blocks as long as the pace allows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np

from ivtools.study.table import Block
from ivtools.study.work import Bench
from ivtools.workers import Clock, Progress

BLOCK_S = 2.0  # s of work in a block, once the pace is known
SHORTEST_S = 0.1  # s, so that handing out stays cheap
SHARE = 0.125  # of what is left that one block may take: workers then end together
LARGEST_BLOCK = 500


class Task(NamedTuple):
    """A block of work, and the case with its estimators: themselves, or as bytes to be sent."""

    block: Block
    sent: bytes | Bench


class Pace:
    """How long a repetition takes, and what that means for blocks and the time left."""

    def __init__(self, total: int, progress: Callable[[Progress], object] | None):
        self.clock, self.per_seed = Clock(total, progress), 0.0

    def tick(self, seeds: int, seconds: float) -> None:
        """Note that so many repetitions took a worker so long."""
        fresh = seconds / seeds
        self.per_seed = fresh if not self.per_seed else 0.5 * (self.per_seed + fresh)
        self.clock.tick(seeds)

    def blocks(self, plan: Iterable[Task]) -> Iterator[Task]:
        """Cut ranges into blocks, as long as the pace says when the next one is asked for."""
        given = 0
        for block, sent in plan:
            first = block.first
            while first < block.last:
                last = min(first + self._size(self.clock.total - given), block.last)
                yield Task(Block(block.case, block.estimators, first, last), sent)
                given, first = given + last - first, last

    def _size(self, rest: int) -> int:
        """Return the repetitions of a block: about `BLOCK_S`, less when little is left to share."""
        if not self.per_seed:
            return 1
        seconds = max(min(BLOCK_S, SHARE * rest * self.per_seed), SHORTEST_S)
        return min(max(1, int(seconds / self.per_seed)), LARGEST_BLOCK)


def gaps(wanted: Block, done: Iterable[Block]) -> Iterator[tuple[dict[str, str], int, int]]:
    """Yield runs of repetitions and, for each, the estimators that have not seen them."""
    keys = list(wanted.estimators)
    lacking = np.ones((len(keys), wanted.last), dtype=bool)
    for block in done:
        for row, key in enumerate(keys):
            if block.estimators.get(key) == wanted.estimators[key]:
                lacking[row, block.first : block.last] = False
    changes = np.flatnonzero((lacking[:, 1:] != lacking[:, :-1]).any(axis=0)) + 1
    edges = [0, *changes.tolist(), wanted.last]
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        if lacking[:, first].any():
            open_ = {k: wanted.estimators[k] for row, k in enumerate(keys) if lacking[row, first]}
            yield open_, first, last
