"""What a controller sees of a record: references, what is known beforehand, position, velocity."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...errors import RecordError
from ...record import Record
from .law import Clipped, LinearLaw

if TYPE_CHECKING:
    from .controller import Controller

Array = NDArray[np.float64]

DERIVATIVES = ("central", "backward")
FEEDFORWARDS = ("velocity", "acceleration", "coulomb", "gravity", "gravity_cos")
_NEAR = 3.0  # times its noise at a limit, how far below it a command may have been clipped
_STEPS = 2  # in which the state that a law began in is found, where it is clipped by itself
_REST = 1e-9  # of the largest velocity: below it a reference stands


@dataclass(frozen=True, eq=False)
class Seen:
    """The inputs of a law along a record.

    Parameters
    ----------
    inputs : ndarray, (n_samples, 5)
        q_ref, dq_ref, feed, q, dq, as `LinearLaw` takes them.
    command : ndarray, (n_samples,)
        What the law itself commanded: the recorded command without added inputs.
    """

    inputs: Array
    command: Array

    @classmethod
    def of(
        cls, controller: Controller, record: Record, command: Array, joint: str = "prismatic"
    ) -> Seen:
        """Collect what a controller saw.

        Parameters
        ----------
        controller : Controller
        record : Record
            With one joint.
        command : (n_samples, 1) ndarray
            The recorded command, added inputs included.
        joint : {"prismatic", "revolute"}
            Gravity turns with a revolute axis.

        Raises
        ------
        RecordError
            If a reference, a logged velocity or a column is missing that the law needs.
        """
        own = command[:, 0] - (0.0 if record.added is None else record.added[:, 0])
        q_ref, dq_ref = references(record, controller)
        q = record.q[:, 0]
        feed = own if controller.kind == "none" else fed(controller, record, joint)
        if controller.velocity == "logged":
            if record.dq is None:
                raise RecordError(
                    'dq is missing; velocity = "logged" in [controller] needs it, else the '
                    "controller differentiates q"
                )
            dq = record.dq[:, 0]
        else:
            dq = controller.shown(record.dt).law(record.dt).velocity(q)
        return cls(np.column_stack([q_ref, dq_ref, feed, q, dq]), own)

    def expected(self, law: LinearLaw, delay: int, limit: float, least: float) -> Array:
        """Return the command of a law, late by whole samples, before its limit, (n_samples,).

        What the law's own states were when the record began, only the record can tell.

        Parameters
        ----------
        law : LinearLaw
        delay : int
            Samples from the measured position to the recorded command.
        limit, least : float
            At which the record was clipped, and from which it sits there.
        """
        n = len(self.command) - delay
        inputs, own = self.inputs[:n], self.command[delay:]
        clipped = Clipped.of(own, limit, least)
        start = law.began(inputs, own, clipped)
        nu = law.command(inputs, start, clipped)
        if law.hold.any() and clipped.side.any():
            nu = min(
                (nu, *_by_itself(law, inputs, own, clipped, least, start)),
                key=lambda one: np.linalg.norm(own - np.clip(one, -limit, limit)),
            )
        return np.concatenate([np.full(delay, nu[0]), nu])


def _by_itself(
    law: LinearLaw, inputs: Array, own: Array, clipped: Clipped, least: float, start: Array
) -> Iterator[Array]:
    """Yield commands, (n,), of a law that finds itself where, near its limit, it was clipped.

    A log with noise shows that less well than the law does, if it is right: an integrator that runs
    on for a few samples, or stands, is wrong from then on. Each begins nearer to where it began.
    """
    limit = clipped.limit
    noise = max(limit - least, float(np.max(np.abs(own))) - limit)
    near = Clipped.of(own, limit, limit - _NEAR * noise, sure=False)
    if np.array_equal(near.side, clipped.side):
        return
    for _ in range(_STEPS):
        start = law.began(inputs, own, near, start)
        yield law.command(inputs, start, near)


def references(record: Record, controller: Controller) -> tuple[Array, Array]:
    """Return q_ref and dq_ref, (n_samples,) each, 0 where the law does not need them.

    Raises
    ------
    RecordError
        If the one that the law needs is missing.
    """
    zero = np.zeros(record.n_samples)
    if controller.kind == "none":
        return zero, zero
    if record.q_ref is None:
        if controller.needs_position:
            raise RecordError(
                "q_ref is missing; the closed loop is driven by the position reference"
            )
        if record.dq_ref is None:
            raise RecordError(
                f"dq_ref is missing, and q_ref too; a controller {controller.kind} follows one"
            )
    q_ref = zero if record.q_ref is None else record.q_ref[:, 0]
    return q_ref, speed_reference(record, controller.reference_derivative)


def other_derivative(way: str) -> str:
    """Return the other one of `DERIVATIVES`."""
    return DERIVATIVES[1 - DERIVATIVES.index(way)]


def derivative(reference: Array, dt: float, way: str) -> Array:
    """Return the derivative of a reference, (n_samples,): one of `DERIVATIVES`."""
    if way == "central":
        return np.gradient(reference, dt)
    return np.diff(reference, prepend=2.0 * reference[0] - reference[1]) / dt


def speed_reference(record: Record, way: str) -> Array:
    """Return the velocity reference, (n_samples,): logged, or the derivative of the position's."""
    if record.dq_ref is not None:
        return np.ascontiguousarray(record.dq_ref[:, 0])
    assert record.q_ref is not None  # the caller has looked
    return derivative(record.q_ref[:, 0], record.dt, way)


def ahead(record: Record, controller: Controller) -> int:
    """Return how many samples a law looks ahead in its reference; as many at the end it cannot.

    Derivatives that are not logged are central differences there, and those of the last samples
    would take samples after the record.
    """
    if controller.kind == "none" or controller.reference_derivative != "central":
        return 0
    law, fed = controller.shown(record.dt).law(record.dt), controller.feedforward
    own = int(record.dq_ref is None)
    takes = law.D[1] != 0.0 or law.B[:, 1].any() or {"velocity", "coulomb"} & {*fed}
    return own + 1 if "acceleration" in fed else own * int(bool(takes))


def reference_response(
    controller: Controller, z: NDArray[np.complex128], record: Record
) -> NDArray[np.complex128]:
    """Return the transfer function from the position reference to the command, (len(z),).

    Limits aside, and feed-forwards that are not linear; a logged velocity reference is given.
    """
    law, fed = controller.law(record.dt), controller.feedforward
    direct = law.response(z, "q_ref")
    if record.dq_ref is not None:
        return direct
    backward = controller.reference_derivative == "backward"
    slope = (1.0 - 1.0 / z if backward else (z - 1.0 / z) / 2.0) / record.dt
    ahead = fed.get("velocity", 0.0) + fed.get("acceleration", 0.0) * slope
    return direct + slope * (law.response(z, "dq_ref") + ahead * law.response(z, "feed"))


def feedforward(name: str, record: Record, joint: str, way: str) -> Array:
    """Return the signal, (n_samples,), that the gain of a feed-forward multiplies.

    Parameters
    ----------
    name : str
        One of `FEEDFORWARDS`, of the reference, or a further column of the record.
    record : Record
    joint : {"prismatic", "revolute"}
        Gravity is the sine (`gravity`) and cosine (`gravity_cos`) of a revolute joint's reference,
        and constant on a prismatic one.
    way : {"central", "backward"}
        How derivatives of the reference are made that are not logged.

    Raises
    ------
    RecordError
        If there is no such column.
    """
    if name not in FEEDFORWARDS:
        return column(name, record)
    if name.startswith("gravity"):
        if joint == "prismatic":
            return np.ones(record.n_samples)
        angle = record.q if record.q_ref is None else record.q_ref
        return (np.cos if name == "gravity_cos" else np.sin)(angle[:, 0])
    if record.q_ref is None and record.dq_ref is None:
        raise RecordError(f"a feed-forward of {name} needs q_ref or dq_ref in the record")
    dq = speed_reference(record, way)
    if name == "velocity":
        return dq
    if name == "acceleration":
        return derivative(dq, record.dt, way)
    return np.where(np.abs(dq) > _REST * np.abs(dq).max(), np.sign(dq), 0.0)


def column(name: str, record: Record) -> Array:
    """Return a further measured column of a record, (n_samples,)."""
    if name in record.extra:
        return record.extra[name]
    if name in record.signals:
        return record.signals[name][:, 0]
    there = ", ".join([*record.signals, *record.extra])
    raise RecordError(f"column {name!r}, which the controller sees, is not in the record: {there}")


def fed(controller: Controller, record: Record, joint: str) -> Array:
    """Return the sum of feed-forwards and measured feedback, (n_samples,), in command units."""
    total = np.zeros(record.n_samples)
    for name, gain in controller.feedforward.items():
        total += gain * feedforward(name, record, joint, controller.reference_derivative)
    for name, gain in controller.feedback.items():
        total += gain * column(name, record)
    return total
