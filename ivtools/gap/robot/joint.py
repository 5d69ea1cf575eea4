"""Joint: one joint from round to round, beside what swings in the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...linalg.columns import fir, projection
from ...record import Record
from ...results import FitResults
from ...workers import threaded
from .. import response
from ..diagnose import Begun, Task, begin, finish, refused
from ..diagnosis import Diagnosis
from ..fit import of_effect
from ..floor import autoregression
from ..fold import Doubt, Link
from ..preflight import Finding
from ..rules import ADEQUATE, SWUNG
from .alone import alone
from .behind import TWO_MASSES, Alone
from .links import Links, measure

Array = NDArray[np.float64]

#: Verdicts that leave nothing to explain.
SETTLED = ("adequate", "explained")

#: Of a joint that cannot be simulated with what the robot was identified to be.
NO_INERTIA = Finding(
    "with the parameters that were identified this joint has no inertia: the record does not tell "
    "the robot's links apart; record a motion that does (`ivtools excite`)"
)


class Loads(NamedTuple):
    """What the links put on the joints by a fit, and what each record shows of them."""

    fit: FitResults
    links: Mapping[Record, Links | None]

    @classmethod
    def of(
        cls, fit: FitResults, records: Sequence[Record], before: Sequence[Links | None]
    ) -> Loads:
        """Return those of a fit; what another fit found of each record spares some of the work."""
        links = threaded(lambda one, known: measure(fit, one, known), records, before)
        return cls(fit, dict(zip(records, links, strict=True)))


class Joint:
    """One joint, from round to round.

    Parameters
    ----------
    j : int
        Counted from 0.
    name : str
    rigid : Loads
        By the fit without any effect.
    settings : mapping
        As for `diagnose`.
    """

    def __init__(self, j: int, name: str, rigid: Loads, settings: Mapping[str, Any]):
        self.j, self.name, self.rigid, self.settings = j, name, rigid, settings
        self.stiff = _begun(j, rigid, settings)
        self.found: Diagnosis | None = None
        self._begun_under: Any = None  # which loads: these very objects
        self._found_under: Any = None
        self._leads = False
        self._places: Mapping[str, Any] = {}  # where its second mass was found

    @property
    def turn(self) -> float:
        """What the joints are diagnosed in the order of, the largest first.

        That is the energy that the rigid joint leaves, and later the gain of its two masses.
        """
        if self.found is not None:
            return np.inf if self._leads else _swing(self.found)
        return self.stiff.left if isinstance(self.stiff, Begun) else 0.0

    @property
    def open(self) -> bool:
        """Whether links that are estimated with what is named may change what is said of it."""
        return self.found is not None and self.found.verdict != "adequate"

    @property
    def unsettled(self) -> bool:
        """Whether what is said of it may be the swing of another joint's link, or lack it."""
        assert self.found is not None
        if isinstance(self.stiff, Diagnosis) or self.stiff.left < ADEQUATE:
            return False
        soft = any(e in TWO_MASSES for e in self.found.effects)
        return soft or self.found.verdict not in SETTLED

    @property
    def beside(self) -> Mapping[str, Diagnosis]:
        """The joints beside whose swinging links it was diagnosed, and perhaps itself."""
        return self._found_under[2] if self._found_under else {}

    def anew(self, leads: bool = False) -> Joint:
        """Return the same joint, of which nothing is said yet.

        One that `leads` comes before those that leave more.
        """
        one = copy(self)
        one.found = one._begun_under = one._found_under = None
        one._leads, one._places = leads, {}
        return one

    def diagnosed(
        self, loads: Loads, own: tuple[str, ...], soft: Mapping[str, Diagnosis]
    ) -> Diagnosis:
        """Return what is found under these loads, which is not looked for again under the same.

        Parameters
        ----------
        loads : Loads
        own : tuple of str
            Effects of this joint that the links were estimated with.
        soft : mapping of str to Diagnosis
            Joints that have two masses.
        """
        known = self.found
        itself = known is not None and not known.effects and _swing(known) > 0.0
        link = {self.name: known} if known is not None and itself else {}
        under = loads.fit, own, {**soft, **link}
        if known is not None and under == self._begun_under:
            return known
        self._begun_under, begun = under, self._begin(loads, own, soft)
        swung = _swung(self.stiff, begun) if soft else 0.0
        beside = {**(soft if swung > 0.0 else {}), **link}
        under = loads.fit, own, beside
        if known is not None and under == self._found_under:
            return known
        self._found_under = under
        if beside.keys() != soft.keys():
            begun = self._begin(loads, own, beside)
        self.found = finish(begun, swung=SWUNG * max(swung, 0.0))
        self._places = self.found.places
        return self.found

    def _begin(
        self, loads: Loads, own: tuple[str, ...], beside: Mapping[str, Diagnosis]
    ) -> Begun | Diagnosis:
        if loads is self.rigid and not beside:
            return self.stiff
        settings = {**self.settings, "places": self._places}
        if isinstance(self.stiff, Begun):
            settings["inspected"] = self.stiff.inspected
        return _begun(self.j, loads, settings, own, beside)


def other_way_round(one: Joint, others: Sequence[Joint]) -> dict[str, Joint]:
    """Return two joints as they are diagnosed the other way round, if that explains more.

    The link of either swings along with that of the other, and the one that leaves more by itself
    need not be the one that is soft. Fewer names that leave fewer joints unexplained are the
    better explanation, then the smaller force error of both.

    Parameters
    ----------
    one : Joint
        Diagnosed beside the others.
    others : sequence of Joint
        They have two masses; the first of them leaves most.
    """
    last = next((other for other in others if other.name in one.beside), None)
    if last is None or not one.unsettled:
        return {}
    rest = (o for o in others if o is not last)
    beside = {o.name: o.found for o in rest if o.found is not None}
    first, second = one.anew(leads=True), last.anew()
    found = first.diagnosed(one.rigid, (), beside)
    if not swings(found):
        return {}
    second.diagnosed(one.rigid, (), {**beside, one.name: found})
    return {j.name: j for j in (first, second)} if _better((first, second), (last, one)) else {}


def _better(these: Sequence[Joint], those: Sequence[Joint]) -> bool:
    """Whether joints as they are diagnosed explain more than the same joints in another order."""

    def rank(joints: Sequence[Joint]) -> tuple[int, float]:
        """Return how much it takes to explain what they do, and what is left."""
        found = [j.found for j in joints if j.found is not None]
        taken = sum(len(d.effects) + (d.verdict not in SETTLED) for d in found)
        return taken, float(np.prod([d.shrink.after if d.shrink else np.inf for d in found]))

    return rank(these) < rank(those)


def swings(diagnosis: Diagnosis, again: int = 0) -> bool:
    """Whether a joint's link swings, as far as others are to know.

    What is supposed, or named after another effect, may be the swing of another joint's link: that
    waits for the second round.
    """
    first = any(e in TWO_MASSES for e in diagnosis.effects[:1])
    return _swing(diagnosis) > 0.0 and (first or again > 0)


def _swing(diagnosis: Diagnosis | None) -> float:
    """Return the gain of a joint's two masses, on data that they were not fitted to; else 0."""
    if diagnosis is None:
        return 0.0
    if not diagnosis.effects and diagnosis.supposed is not None:
        one = diagnosis.supposed
        return one.gain if one.effect in TWO_MASSES else 0.0
    both = (e for e in diagnosis.effects if e in TWO_MASSES and e in diagnosis.evidence)
    return max((diagnosis.evidence[e].gain for e in both), default=0.0)


def assumed(diagnosis: Diagnosis) -> Diagnosis:
    """Return a diagnosis that has what it supposes for an effect, where it names nothing."""
    one = diagnosis.supposed
    if diagnosis.effects or one is None:
        return diagnosis
    parameters = {one.effect: of_effect(one.values, one.effect)}
    return replace(diagnosis, effects=(one.effect,), parameters=parameters, theta=one.values)


def _begun(
    j: int,
    loads: Loads,
    settings: Mapping[str, Any],
    without: Sequence[str] = (),
    soft: Mapping[str, Diagnosis] | None = None,
) -> Begun | Diagnosis:
    """Begin to diagnose one joint under the loads that the links of a fit put on it."""
    fit, links = loads
    name = fit.problem.loop.joints[j]  # type: ignore[union-attr]
    soft = {n: assumed(d) for n, d in soft.items()} if soft else None
    parts = [alone(j, one, fit, without, soft) for one in links]
    if not parts[0].loop.start["inertia"] > 0.0:
        return refused(parts[0].record, parts[0].loop, (), [NO_INERTIA])
    other = parts[1].record if len(parts) > 1 else None
    behind = [
        Link(part.record.t, part.link, _doubt(name, known, part))
        for known, part in zip(links.values(), parts, strict=True)
    ]
    settings = {**settings, "links": behind}
    return begin(Task(parts[0].record, parts[0].loop, other, **settings))


def _doubt(joint: str, links: Links | None, part: Alone) -> Doubt:
    """Return what is not known of a joint's load: of the links, and of how the record began."""
    record = part.record
    answers = response.measure(part.loop, record, part.loop.start)(part.unknown)
    none = np.zeros((record.n_samples, 0))
    nothing = Doubt(record.t, none, np.zeros(0), np.zeros((0, 0)))
    return (nothing if links is None else links.doubt(joint)).beside(record, answers)


def _swung(stiff: Begun | Diagnosis, begun: Begun | Diagnosis) -> float:
    """Return how much energy a rigid joint leaves beyond the same one beside swinging links.

    In N2 or (N m)2; NaN where one of them is refused, and nothing where its error is the likelier
    one. Each has a noise of its own, for that of the rigid one is learnt where links swing: what is
    new in an error from sample to sample says which is likelier. How much more is left is judged by
    the noise of the second, but for what its parameters may stand for.
    """
    if isinstance(stiff, Diagnosis) or isinstance(begun, Diagnosis):
        return float("nan")
    likelier, more = 0.0, 0.0
    for rigid, beside in zip(stiff.measured, begun.measured, strict=True):
        errors = [m.base.whole_error for m in (rigid, beside)]
        new = [_new(e, beside.fold.keep) for e in errors]
        likelier += float(np.log(new[0] / new[1]))
        e = beside.fold.white(errors[0])
        e -= projection(beside.base.J, e)
        more += float(e @ e) / len(e) - beside.base.cost
    surprise = sum(m.floor.surprise for m in begun.measured)
    return more / len(begun.measured) * surprise if likelier > 0.0 else 0.0


def _new(e: Array, keep: NDArray[np.bool_]) -> float:
    """Return the energy of what is new in an error from sample to sample."""
    return float(np.mean(fir(autoregression(e, keep), e)[keep] ** 2))
