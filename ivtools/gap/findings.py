"""Findings: what is wrong with a record or an axis file, before any effect is looked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import RecordError
from ..loop import ClosedLoop
from ..record import Record
from .fold import usable
from .parity import Parity

Array = NDArray[np.float64]

_LEAST_TIME = 3.0  # s of usable motion
_GROSS = 0.15  # a larger error of a gain is a wrong axis file, not an effect
_BEYOND = 2.0  # command over its declared limit from which a unit must be wrong
SATURATED = 0.2  # share of samples at the limit beyond which nothing can be said


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

    Raises
    ------
    RecordError
        If the record has no reference, or more than one joint.
    """
    return [*_motion(record, loop), *_controller(record, loop, parity), *_mechanics(record, loop)]


def require(record: Record) -> None:
    """Refuse a record that the closed loop cannot be compared with."""
    if record.n_joints != 1:
        raise RecordError(
            f"{record.name} has {record.n_joints} joints; a diagnosis takes one at a time"
        )
    if record.q_ref is None:
        raise RecordError(f"{record.name} has no q_ref; the simulated loop is driven by it")


def _motion(record: Record, loop: ClosedLoop) -> list[Finding]:
    assert record.q_ref is not None
    kept = float(usable(record, loop).sum()) * record.dt
    moving = float(np.ptp(record.q_ref)) > 1e-9 * max(float(np.max(np.abs(record.q))), 1e-12)
    if not moving or kept < 0.2:
        return [
            Finding(
                "the reference does not move: a record at standstill says nothing about "
                "the model; record a motion over the stroke, in both directions"
            )
        ]
    if kept < _LEAST_TIME:
        return [
            Finding(
                f"only {kept:.1f} s of the record show motion that can be compared; give "
                f"at least {_LEAST_TIME:g} s, better 20 s, with several reversals"
            )
        ]
    dq = np.gradient(record.q_ref[:, 0])
    if min(np.mean(dq > 0), np.mean(dq < 0)) < 0.02:
        return [
            Finding(
                "the reference moves in one direction only: friction and offset cannot be "
                "told apart; add the way back",
                fatal=False,
            )
        ]
    return []


def _controller(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    return _at_limit(record, loop, parity) or _law(record, loop, parity)


def _at_limit(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    own = loop.command(record) - (record.added if record.added is not None else 0.0)
    top, limit = float(np.max(np.abs(own))), loop.controller.limit
    if top > _BEYOND * limit:
        return [
            Finding(
                f"the recorded command reaches {top:.4g} and the axis file says that it is limited "
                f"to {limit:g}; check the unit of nu, and [controller] limit"
            )
        ]
    if parity.clipped <= SATURATED:
        return []
    share = f"in {100 * parity.clipped:.0f} % of the samples"
    if parity.limit is not None:
        text = f"the command is cut at {parity.limit:.4g} {share}, which the axis file does not say"
        return [Finding(f"{text}; put it in [controller] limit, use gentler references", False)]
    text = f"the command sits at its limit {share}; the loop is open there"
    return [Finding(f"{text}: use gentler references")]


def _law(record: Record, loop: ClosedLoop, parity: Parity) -> list[Finding]:
    gross = {n: v for n, v in parity.mismatch.items() if abs(v) > _GROSS}
    if parity.trustworthy and not gross:
        return []
    if gross and parity.trustworthy:
        text = ", ".join(f"{n} {100 * v:+.0f} %" for n, v in gross.items())
        return [
            Finding(
                f"the record shows other controller settings than the axis file ({text}); "
                "correct [controller] and diagnose again"
            )
        ]
    factor = _factor(record, loop, parity)
    if factor < 0.0:
        text = "the recorded command has the opposite sign of what the controller gives"
        return [Finding(f"{text}; check the sign of nu, or of q and q_ref")]
    if not 0.2 < factor < 5.0:
        return [
            Finding(
                f"the recorded command is {factor:.3g} times what the controller gives for the "
                "recorded position; check the units of q, q_ref and nu, and the gains in "
                "[controller]"
            )
        ]
    return [
        Finding(
            f"the control law reproduces the recorded command only to {100 * parity.after:.0f} %; "
            "check kind, gains and velocity_filter in [controller], and that q, q_ref and nu "
            "belong together"
        )
    ]


def _factor(record: Record, loop: ClosedLoop, parity: Parity) -> float:
    """Return the recorded command per command of the declared law."""
    assert record.q_ref is not None
    dq_ref = (
        record.dq_ref if record.dq_ref is not None else np.gradient(record.q_ref, record.dt, axis=0)
    )
    law = loop.controller.law(record.dt)(record.q_ref[:, 0], dq_ref[:, 0], record.q[:, 0])
    nu = loop.command(record)[:, 0]
    nu = nu - record.added[:, 0] if record.added is not None else nu
    delay = parity.delay
    law, nu = law[: len(law) - delay], nu[delay:]
    return float(nu @ law / max(float(law @ law), 1e-300))


def _mechanics(record: Record, loop: ClosedLoop) -> list[Finding]:
    """Look at the sign and size of the inertia that the record itself suggests."""
    inertia = rough_inertia(record, loop)
    if inertia <= 0.0:
        return [
            Finding(
                f"the record suggests an inertia of {inertia:.3g}: the force does not "
                "accelerate the axis; check the sign of the command and of [drive] gain"
            )
        ]
    start = loop.start.get("inertia")
    if start and not 0.05 < inertia / start < 20.0:
        return [
            Finding(
                f"the record suggests an inertia of {inertia:.3g}, the axis file starts "
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
