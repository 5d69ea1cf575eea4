"""Scores: an answer against the sealed label.

==========  =====================================================================================
right       exactly the truth, each effect with at most one that it is not told from; or, with
            nothing hidden, nothing named and the right verdict
ambiguous   the truth, once every name is exchanged for one that it is said to be not told from,
            in sets of at most two
vague       the same in larger sets
twin        the truth, once names are exchanged for their documented twins
subset      some of several effects, nothing else
extra       all of them, and more
abstained   nothing named though something was hidden; or the wrong verdict though nothing was
flagged     the truth is not in the library, something was named, and the verdict says that a
            significant part of the gap remains
wrong       anything else: a name for what is not there
failed      the diagnosis raised an error
==========  =====================================================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import Any

from .effects import twins

#: What counts as a good answer, per suite; `extra` and `wrong` hold a spurious name in any.
GOOD = {
    "single": ("right", "ambiguous"),
    "none": ("right",),
    "two": ("right", "ambiguous", "twin"),
    "outside": ("right", "twin", "flagged"),
    "background": ("right", "ambiguous"),
    "clear": ("right", "ambiguous"),
    "unknown": ("right", "ambiguous"),
    "bursts": ("right",),
    "small": ("right", "ambiguous"),
    "controllers": ("right", "ambiguous"),
    "logs": ("right", "ambiguous"),
}
SPURIOUS = ("extra", "wrong")
_CALM = {"none": ("adequate",), "logs": ("adequate",), "bursts": ("non-repeatable",)}


def score(found: Mapping[str, Any], label: Mapping[str, Any]) -> str:
    """Return the score of an answer, the JSON of a diagnosis.

    >>> score({"effects": ["spring"], "ambiguous_with": {"spring": ["cogging"]}},
    ...       {"suite": "single", "effects": ["cogging"]})
    'ambiguous'
    """
    truth, named = list(label["effects"]), list(found["effects"])
    if label["suite"] == "outside":
        return _outside(truth[0], named, found["verdict"])
    if not truth:
        if named:
            return "wrong"
        calm = _CALM.get(label["suite"])
        return "right" if calm is None or found["verdict"] in calm else "abstained"
    if not named:
        return "abstained"
    return _named(truth, named, found["ambiguous_with"])


def _named(truth: list[str], named: list[str], others: Mapping[str, Sequence[str]]) -> str:
    sets = {e: {e, *others.get(e, [])} for e in named}
    if set(named) == set(truth):
        return "right" if all(len(s) <= 2 for s in sets.values()) else "vague"
    if _matches(truth, named, sets):
        return "ambiguous" if all(len(s) <= 2 for s in sets.values()) else "vague"
    wide = {e: s.union(*(twins(x) for x in s)) for e, s in sets.items()}
    if len(truth) > 1 and _matches(truth, named, wide):
        return "twin"
    if set(truth) < set(named):
        return "extra"
    if len(named) < len(truth) and any(
        _matches(list(part), named, sets) for part in permutations(truth, len(named))
    ):
        return "subset"
    return "wrong"


def _matches(truth: list[str], named: list[str], sets: Mapping[str, set[str]]) -> bool:
    """Whether every name stands for another one of the truth."""
    return len(truth) == len(named) and any(
        all(t in sets[n] for t, n in zip(order, named, strict=True))
        for order in permutations(truth)
    )


def _outside(truth: str, named: list[str], verdict: str) -> str:
    if not named:
        return "right"
    if set(named) <= twins(truth):
        return "twin"
    return "wrong" if verdict == "explained" else "flagged"
