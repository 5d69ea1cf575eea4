"""Suites: which cases are drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from . import backgrounds, logs, unknowns
from .axes import LAWS
from .disturbances import BURSTS
from .effects import AT_CONTROLLER, EFFECTS, SIZE, twins

#: Signatures, over the noise floor, of the power curve.
LEVELS = (0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0, 2.0)
#: Pairs that every run has.
PAIRS = (
    ("asymmetric-viscous", "cogging"),
    ("stribeck", "spring"),
    ("drive-timing", "asymmetric-viscous"),
    ("position-friction", "flexibility"),
    ("load-friction", "offset-drift"),
    ("presliding", "spring"),
    ("controller-mismatch", "asymmetric-viscous"),
    ("friction-drift", "cogging"),
    ("polynomial-viscous", "spring"),
    ("drive-timing", "position-friction"),
)


@dataclass(frozen=True)
class Task:
    """One case to draw.

    Parameters
    ----------
    suite : str
    seed : int
    effects : tuple of str
    detail : tuple of str
        Of a background: its kind and model, or its kind if it has no name; of a burst: its shape;
        of a small effect: its level; of a controller: its kind; of a log: what became of it.
    """

    suite: str
    seed: int
    effects: tuple[str, ...] = ()
    detail: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """What tells it from every other task, and seeds its random numbers."""
        return "/".join(
            (self.suite, str(self.seed), "+".join(self.effects) or "-", "+".join(self.detail))
        )


def _single(seeds: range) -> Iterator[Task]:
    return (Task("single", s, (e,)) for s in seeds for e in EFFECTS)


def _none(seeds: range) -> Iterator[Task]:
    return (Task("none", s) for s in seeds)


def _two(seeds: range) -> Iterator[Task]:
    """Ten listed pairs per five seeds, and two random ones per seed."""
    for s in seeds:
        for pair in PAIRS[2 * (s % 5) : 2 * (s % 5) + 2]:
            yield Task("two", s, pair)
        yield from (Task("two", s, p) for p in _random_pairs(np.random.default_rng([s, 2]), 2))


def _random_pairs(rng: np.random.Generator, count: int) -> list[tuple[str, str]]:
    """Draw pairs that are no documented twins, without those decided by a clipped command."""
    pairs: list[tuple[str, str]] = []
    names = [e for e in EFFECTS if e != "saturation"]
    while len(pairs) < count:
        a, b = (str(x) for x in rng.choice(names, 2, replace=False))
        if b not in twins(a) and (a, b) not in PAIRS and (b, a) not in PAIRS:
            pairs.append((a, b))
    return pairs


def _outside(seeds: range) -> Iterator[Task]:
    return (Task("outside", s, (e,)) for s in seeds for e in EFFECTS if e not in AT_CONTROLLER)


def _background(seeds: range) -> Iterator[Task]:
    """Every kind and model in turn, one without an effect for two with one."""
    names = [e for e in EFFECTS if e != "saturation"]
    ways = [(k, m) for m in backgrounds.MODELS for k in backgrounds.KINDS]
    for s in seeds:
        order = np.random.default_rng([s, 3]).permutation(len(names))
        for i in range(6):
            way = ways[(6 * s + i) % len(ways)]
            yield Task("background", s, (), way)
            for j in (2 * i, 2 * i + 1):
                yield Task("background", s, (names[order[j]],), way)


def _clear(seeds: range) -> Iterator[Task]:
    """The backgrounds with an effect once more, to be drawn until it stands out from them."""
    for task in _background(seeds):
        if task.effects:
            yield replace(task, suite="clear")


def _unknown(seeds: range) -> Iterator[Task]:
    """Every background without a name, with nothing else and, in every third, with an effect."""
    names = [e for e in EFFECTS if e not in AT_CONTROLLER]
    for s in seeds:
        picked = np.random.default_rng([s, 4]).permutation(names)
        for i, kind in enumerate(unknowns.KINDS):
            yield Task("unknown", s, (), (kind,))
            if (i + s) % 3 == 0:
                yield Task("unknown", s, (str(picked[i]),), (kind,))


def _bursts(seeds: range) -> Iterator[Task]:
    return (Task("bursts", s, (), (shape,)) for s in seeds for shape in BURSTS)


def _small(seeds: range) -> Iterator[Task]:
    for s in seeds:
        for e in SIZE:
            yield from (Task("small", s, (e,), (f"{level:g}",)) for level in LEVELS)


def _controllers(seeds: range) -> Iterator[Task]:
    """Every kind of controller with every effect, and without."""
    for s in seeds:
        for kind in LAWS:
            yield Task("controllers", s, (), (kind,))
            behind = [e for e in EFFECTS if kind != "none" or e not in AT_CONTROLLER]
            yield from (Task("controllers", s, (e,), (kind,)) for e in behind)


def _logs(seeds: range) -> Iterator[Task]:
    """Everything that a log may have made of its signals, with an effect in turn, and without."""
    kinds = list(logs.KINDS)
    for s in seeds:
        yield from (Task("logs", s, (), (kind,)) for kind in kinds)
        for i, e in enumerate(EFFECTS):
            yield Task("logs", s, (e,), (kinds[(i + s) % len(kinds)],))


#: Suite to its tasks for a range of seeds.
SUITES: dict[str, Callable[[range], Iterator[Task]]] = {
    "single": _single,
    "none": _none,
    "two": _two,
    "outside": _outside,
    "background": _background,
    "clear": _clear,
    "unknown": _unknown,
    "bursts": _bursts,
    "small": _small,
    "controllers": _controllers,
    "logs": _logs,
}
#: Suites whose true held-out figures are measured.
MEASURED = ("single", "none", "two", "background", "clear")
#: Suites whose records have the residual of a real axis in them.
REAL = ("background", "clear")
#: Seeds of a full run: at least 20 cases per effect, 100 without, 60 pairs, 108 backgrounds.
FULL = {
    "single": 20,
    "none": 100,
    "two": 15,
    "outside": 3,
    "background": 6,
    "clear": 6,
    "unknown": 12,
    "bursts": 6,
    "small": 3,
    "controllers": 2,
    "logs": 3,
}
