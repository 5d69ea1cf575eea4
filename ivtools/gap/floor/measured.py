"""Measured: a record with its base model and floor, as it is judged, whole or in folds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...errors import EstimationError
from ...loop import ClosedLoop
from ...loop.rough_inertia import rough_inertia
from ...record import Record
from .. import preflight, response
from ..fit import Fit, Inverse, gauss_newton
from ..fold import Fold, Link, stepped, usable
from ..library import Scales
from ..parity import Parity
from ..rules import ADEQUATE, AGAIN, LITTLE, MOST, PARITY_POOR, SOME, STRETCHES
from . import floor
from .floor import Floor

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Measured:
    """A record with its base model and floor, ready to be judged.

    Parameters
    ----------
    base : Fit
        The model without effects.
    floor : Floor
    parity : Parity
    logged : Record
        With its added input as it was logged, not as parity found it to act.
    """

    base: Fit
    floor: Floor
    parity: Parity
    logged: Record

    @property
    def fold(self) -> Fold:
        """What is compared of the record."""
        return self.base.fold

    @property
    def driven(self) -> bool:
        """Whether the recorded command drives the model, and no controller of it counts."""
        return self.fold.driven

    @property
    def force(self) -> float:
        """Force of the drive, N or N m rms."""
        return self.base.fold.force_rms(self.base.loop)

    def beyond(self, fit: Fit) -> float:
        """Return the force error of a fit beyond the noise, in energy, N or N m rms."""
        return float(np.sqrt(max(fit.force_rms**2 - self.floor.noise**2, 0.0)))


class Ready(NamedTuple):
    """A record and the loop that its reference drives, what its controller shows, and its place."""

    record: Record
    loop: ClosedLoop
    parity: Parity
    place: Array | None = None
    driven: bool = False  # by the recorded command
    ramp: bool = False
    link: Link | None = None


def prepared(record: Record, checked: Parity, records: Sequence[Record]) -> Ready:
    """Return a record with a model that the records can tell apart, in a loop that stays there.

    A command that the law gives exactly is held between the samples; one that follows it by some
    per cent was measured, as a current is, and goes straight from one to the next.
    """
    loop = preflight.identifiable(records, checked.loop)
    place = record.q[:, 0] if preflight.adrift(loop) else None
    if not preflight.rings(record, loop, checked.oversampling):
        return Ready(record, loop, checked, place)
    ramp = checked.after > PARITY_POOR
    return Ready(*preflight.pulled(record, loop), checked, place, True, ramp)


class Fitted(NamedTuple):
    """The base model on a record whose noise is not known yet, and what it leaves, (n_samples,)."""

    fit: Fit
    left: Array


def fitted(ready: Ready) -> Fitted:
    """Fit the base model.

    Raises
    ------
    EstimationError
        If the loop is unstable when simulated with what the record shows.
    """
    record, loop, checked, place, driven, ramp, _ = ready
    if not driven and record.added is not None and "added" in checked.mismatch:
        record = replace(record, added=record.added * (1.0 + checked.mismatch["added"]))
    keep = usable(record, loop)
    values = Inverse.of(record, loop).values()
    if not values.get("inertia", 1.0) > 0.0:  # a pendulum or a spring that the model lacks
        values = {**values, "inertia": rough_inertia(loop, record)}
    oversampling = 1 if driven else checked.oversampling
    limited = None
    if checked.limit is not None:
        given = replace(loop.controller, limit=checked.declared.limit)
        limited = usable(record, replace(loop, controller=given)) & ~keep
    fold = Fold(
        record,
        keep,
        Scales(record, loop),
        response.measure(loop, record, values, oversampling),
        label=record.name,
        place=place,
        driven=driven,
        ramp=ramp,
        limited=limited,
        oversampling=oversampling,
    )
    if oversampling > 1:  # of when it stepped the log has nothing nearer than its samples
        fold = fold.only(~stepped(record))
    free = [n for n, p in loop.parameters.items() if p.linear or "." in n]
    fit = gauss_newton(fold, loop, values, free)
    left = fit.whole_error
    if not np.isfinite(left).all():  # what the model lacks has bent the start
        values = {**values, "inertia": rough_inertia(loop, record)}
        fit = gauss_newton(fold, loop, values, free)
        left = fit.whole_error
    if not np.isfinite(left).all():
        raise EstimationError(
            f"the loop is unstable when simulated with what {record.name} shows (inertia "
            f"{values['inertia']:.3g}): check the gains, units and delay of the controller, and "
            "[drive] gain; a force of the position that the model lacks (spring, gravity) may be "
            "added to [model] terms"
        )
    return Fitted(fit, left)


def measure(ready: Ready) -> Measured:
    """Fit the base model, and learn the floor."""
    fit, left = fitted(ready)
    fold, link = fit.fold, ready.link
    unknown = None if link is None or link.doubt is None else link.doubt.on(fold.record)
    level = floor.measure(fit, left, unknown)
    rough = float(np.mean(level.event_mask))
    fold = replace(fold, whitener=level.whitener, link=link, rough=rough)
    if fold.doubt is None:  # else what is not known counts as noise
        fold = replace(fold, smooth=level.generic)
    return Measured(fit.refit(fold), level, ready.parity, ready.record)


def audible(m: Measured, least: float) -> Measured:
    """Return a record in which nothing stands out by less than a share of the force.

    Where the noise is a thousandth of it, as in a simulator, the friction at a reversal stands out.
    """
    if m.floor.excess >= least * m.force:
        return m
    nothing = np.zeros_like(m.floor.event_mask)
    return replace(m, floor=replace(m.floor, events=(), event_mask=nothing))


def beside_silent(m: Measured, other: Measured, least: float) -> Measured:
    """Return a record whose events happened once, if the other one was there and shows no gap.

    Nothing but noise, or less than a share of the force.
    """
    silent = other.base.cost < ADEQUATE or other.beyond(other.base) < least * other.force
    if not silent or other.floor.events or not m.floor.event_mask.any():
        return m
    return replace(m, floor=replace(m.floor, once=_most(_seen(m, other)[m.floor.event_mask])))


def come_again(measured: Sequence[Measured]) -> bool:
    """Whether most of what stands out of a record does at the same times of another one.

    Of the same motion: then it comes from the axis, not from outside.
    """
    masks = [m.floor.event_mask for m in measured]
    same = len(masks) == 2 and measured[0].floor.between is not None
    return same and all(mask.any() for mask in masks) and _most(masks[1][masks[0]])


def _most(mask: NDArray[np.bool_]) -> bool:
    return float(np.mean(mask)) > MOST


def masked(m: Measured) -> Measured:
    """Return a record without the stretches that stand out: of what is left, none does."""
    if not m.floor.isolated:
        return m
    fold = replace(m.fold.only(~m.floor.event_mask), rough=0.0)
    return replace(m, base=m.base.refit(fold, iterations=AGAIN))


def beside(m: Measured, other: Measured) -> Measured:
    """Return a record that knows where the other one has been, and which times it has seen."""
    inside = _seen(m, other)
    if not SOME < float(np.mean(inside[m.fold.keep])) < 1.0:
        return m
    return replace(m, base=replace(m.base, fold=replace(m.fold, both=inside)))


def _seen(m: Measured, other: Measured) -> NDArray[np.bool_]:
    """Return the samples of a record at positions and times of the other one, (n_samples,)."""
    inside = np.ones(m.fold.record.n_samples, dtype=bool)
    for signal in (lambda r: r.q[:, 0], lambda r: r.t - r.t[0]):
        here, seen = (signal(x.fold.record) for x in (m, other))
        margin = LITTLE * float(np.ptp(seen))
        inside &= (here >= np.min(seen) - margin) & (here <= np.max(seen) + margin)
    return inside


def folds(measured: tuple[Measured, ...]) -> tuple[Fit, ...]:
    """Return the base model on two folds: two records, or alternating stretches of one."""
    if len(measured) == 2:
        one, two = measured
        return beside(one, two).base, beside(two, one).base
    (only,) = measured
    first = _first_half(only.fold.record)
    halves = (
        only.fold.only(first, "its odd stretches"),
        only.fold.only(~first, "its even stretches"),
    )
    return tuple(only.base.refit(half, iterations=AGAIN) for half in halves)


def _first_half(record: Record) -> NDArray[np.bool_]:
    """Return alternating stretches that move as the others do: speed, direction, acceleration."""
    assert record.q_ref is not None
    n = record.n_samples
    q = record.q_ref[:, 0] - record.q_ref.mean()
    dq = np.gradient(q)
    ddq = np.gradient(dq)
    looks = np.column_stack([np.sign(dq), dq, np.abs(dq), np.abs(ddq), q, q * np.sign(dq)])
    spread = np.std(looks, axis=0)
    looks = looks[:, spread > 0.0] / spread[spread > 0.0]
    halves = [np.arange(n) * k // n % 2 == 0 for k in STRETCHES]
    return min(
        halves, key=lambda h: float(np.sum((looks[h].mean(axis=0) - looks[~h].mean(axis=0)) ** 2))
    )
