"""Findings: what is wrong with a record or an axis file, before any effect is looked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .. import checks
from ..errors import RecordError
from ..loop import ClosedLoop
from ..record import Record
from . import hints
from .fold import usable
from .parity import Parity

Array = NDArray[np.float64]

_LEAST_TIME = 3.0  # s of usable motion
_FOLLOWS = (0.2, 5.0)  # travel of the position per travel of its reference
_ALONG = 0.9  # correlation of a position with its reference if it follows it
_ONE_WAY = 0.02  # share of the time that a direction takes at least
_GROSS = 0.15  # a larger error of a gain is a wrong axis file, not an effect
_OVER, _FEW = 1.05, 8  # command over its declared limit, in so many samples: it is not the limit
_BEYOND = 2.0  # command over its declared limit from which a unit must be wrong
_INERTIA = (0.05, 20.0)  # of the record per that of the axis file
SATURATED = 0.2  # share of samples at the limit beyond which nothing else can be said
_OPEN = 0.9  # and beyond which the limit is no effect any more: nothing controls the axis


@dataclass(frozen=True)
class Finding:
    """Something that a person must look at.

    Parameters
    ----------
    text : str
        What is wrong, and what to do.
    fatal : bool
        Whether it keeps effects from being named.
    """

    text: str
    fatal: bool = True


def inspect(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    """Return what is wrong with a record, or with the axis file that goes with it.

    The first cause that spoils everything behind it ends the search: a position in millimetres
    makes the inertia wrong too, and saying so would only mislead.
    """
    found: list[Finding] = []
    for look in (_reference, _at_limit, _law, _length, _direction, _mechanics):
        found += look(record, loop, parity)
        if any(f.fatal for f in found):
            break
    return found


def require(record: Record) -> None:
    """Refuse a record that the closed loop cannot be compared with.

    Raises
    ------
    RecordError
        If the record has no reference, or more than one joint.
    """
    if record.n_joints != 1:
        raise RecordError(
            f"{record.name} has {record.n_joints} joints; a diagnosis takes one at a time"
        )
    if record.q_ref is None:
        raise RecordError(f"{record.name} has no q_ref; the simulated loop is driven by it")


def identified(record: Record, loop: ClosedLoop) -> list[Finding]:
    """Say which control law is taken, if the axis file leaves it to the record.

    Raises
    ------
    RecordError
        If no law can be fitted to the record.
    """
    if loop.controller.kind != "identify":
        return []
    law = loop.known(record).notes[-1]
    text = f"{law}; the record that a law was fitted to cannot say whether it is the right one"
    return [Finding(text, fatal=False)]


def named(found: Sequence[Finding], record: Record) -> list[Finding]:
    """Return findings that say of which record they speak."""
    return [replace(f, text=f"{record.name}: {f.text}") for f in found]


def _reference(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    assert record.q_ref is not None
    asked, done = (float(np.ptp(x)) for x in (record.q_ref, record.q))
    if asked <= 1e-9 * max(float(np.max(np.abs(record.q))), 1e-12):
        return [
            Finding(
                "the reference does not move: a record at standstill says nothing about "
                "the model; record a motion over the stroke, in both directions"
            )
        ]
    along = float(np.corrcoef(record.q[:, 0], record.q_ref[:, 0])[0, 1])
    if along < -_ALONG:
        return [Finding("q moves against its reference; check the signs of q and q_ref")]
    unit = "m" if loop.joint == "prismatic" else "rad"
    if _FOLLOWS[0] < done / asked < _FOLLOWS[1]:
        return []
    factor, signal = (asked / done, "q") if done > asked else (done / asked, "q_ref")
    remedy = hints.scale(factor, loop.joint, signal) if along > _ALONG else ""
    remedy = remedy or "was the axis blocked or not enabled?"
    return [
        Finding(f"q moves {done:.3g} {unit} where its reference moves {asked:.3g} {unit}; {remedy}")
    ]


def _length(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    kept = float(usable(record, loop).sum()) * record.dt
    if kept >= _LEAST_TIME:
        return []
    whole = record.n_samples * record.dt
    return [
        Finding(
            f"only {kept:.1f} s of the record's {whole:.1f} s show motion that can be compared; "
            f"give at least {_LEAST_TIME:g} s, better 20 s, with several reversals"
        )
    ]


def _direction(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    assert record.q_ref is not None
    dq = np.gradient(record.q_ref[:, 0])
    if min(np.mean(dq > 0), np.mean(dq < 0)) >= _ONE_WAY:
        return []
    both = "offset" in loop.names or "viscous_pos" in loop.names
    return [
        Finding(
            "the reference moves in one direction only: Coulomb friction and offset cannot be "
            "told apart; add the way back",
            fatal=both,
        )
    ]


def _at_limit(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    whole, limit = np.abs(loop.command(record)), loop.controller.limit
    own = np.abs(loop.command(record) - (record.added if record.added is not None else 0.0))
    size = np.minimum(whole, own)  # whether the added input is in the command or not
    top = float(np.max(size))
    if np.sum(size > _OVER * limit) >= _FEW:
        text = f"the recorded command reaches {top:.4g}, the axis file says that it is limited to "
        remedy = "check the unit of nu, and [controller] limit"
        if top <= _BEYOND * limit:
            remedy = "correct [controller] limit"
        return [Finding(f"{text}{limit:g}; {remedy}")]
    if parity.clipped <= SATURATED:
        return []
    share = f"in {100 * parity.clipped:.0f} % of the samples"
    if parity.limit is not None:
        text = f"the command is cut at {parity.limit:.4g} {share}, which the axis file does not say"
        remedy = "put it in [controller] limit, use gentler references"
        return [Finding(f"{text}; {remedy}", parity.clipped > _OPEN)]
    text = f"the command sits at its limit {share}; the loop is open there"
    return [Finding(f"{text}: use gentler references")]


def _law(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    gross = {n: v for n, v in parity.mismatch.items() if abs(v) > _GROSS}
    if parity.trustworthy and not gross:
        return []
    other = hints.shown(record, loop) if gross else None
    if other is not None and other.kind != loop.controller.kind:
        text = f"the record shows {hints.described(other)}; the axis file says kind "
        return [Finding(f"{text}{loop.controller.kind}: correct [controller]")]
    if gross and parity.trustworthy:
        settings = loop.controller.settings
        text = ", ".join(
            f"{n} {100 * v:+.0f} %"
            + (f": {(1 + v) * settings[n]:.4g}, not {settings[n]:.4g}" if n in settings else "")
            for n, v in gross.items()
        )
        return [
            Finding(
                f"the record shows other controller settings than the axis file ({text}); "
                f"correct [controller] and diagnose again{hints.law(other)}"
            )
        ]
    doubts = checks.doubts(record)
    if doubts:
        return [Finding("; ".join(doubts))]
    return [Finding(hints.command(record, loop, parity.delay, parity.after))]


def _mechanics(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    """Look at the sign and size of the inertia that the record itself suggests."""
    inertia = rough_inertia(record, loop)
    unit = "kg" if loop.joint == "prismatic" else "kg m2"
    if inertia <= 0.0:
        return [
            Finding(
                f"the record suggests an inertia of {inertia:.3g} {unit}: the force does not "
                "accelerate the axis; check the sign of the command and of [drive] gain"
            )
        ]
    start = loop.start.get("inertia")
    if start and not _INERTIA[0] < inertia / start < _INERTIA[1]:
        return [
            Finding(
                f"the record suggests an inertia of {inertia:.3g} {unit}, the axis file starts "
                f"from {start:g}; check units and [drive] gain"
            )
        ]
    return []


def rough_inertia(record: Record, loop: ClosedLoop) -> float:
    """Return the inertia of a plain least-squares fit along the smoothed measured motion."""
    width = max(round(0.01 / record.dt), 3)
    kernel = np.hanning(2 * width + 3)
    kernel /= kernel.sum()
    q = np.convolve(record.q[:, 0], kernel, mode="same")
    dq = np.gradient(q, record.dt)
    ddq = np.gradient(dq, record.dt)
    tau = np.convolve(loop.force(record)[:, 0], kernel, mode="same")
    inner = slice(4 * width, -4 * width)
    X = np.column_stack([ddq, dq, np.sign(dq), np.ones(len(q))])[inner]
    scale = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
    return float((np.linalg.lstsq(X / scale, tau[inner], rcond=None)[0] / scale)[0])
