"""Behind: how the link of a robot's joint moves that has a mass of its own behind the drive."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...compiled import cached
from ...loop import ClosedLoop
from ...loop.mechanics import LIGHTEST
from ...physics import EFFECTS
from ...record import Record
from ..diagnosis import Diagnosis
from ..fit import of_effect
from ..rules import CRAWLING, LINKED_TRANSIENT, STEP

Array = NDArray[np.float64]

#: Which a RobotLoop cannot have.
TWO_MASSES = tuple(name for name, term in EFFECTS.items() if term.second_mass)


class Alone(NamedTuple):
    """One joint of a robot as an axis.

    Attributes
    ----------
    record : Record
        With the load of the others.
    loop : ClosedLoop
    link : ndarray, (n_samples, 2)
        That load without what the inertia of its link has beyond the mean, and that inertia.
    unknown : ndarray, (n_samples, k)
        Loads of unknown size: blows at the start, where the motion's derivatives are those of the
        filter, and the free swing of other joints' links.
    """

    record: Record
    loop: ClosedLoop
    link: Array
    unknown: Array


class Behind(NamedTuple):
    """Motion of a link behind its drive, m or rad.

    Attributes
    ----------
    q, ddq : ndarray, (n_samples,)
        Position, and acceleration.
    unknown : ndarray, (k, 2, n_samples)
        What both have more with another start, or with other values of the second mass: the joint
        alone does not tell them well enough for others. None behind a gap, where a link rattles.
    """

    q: Array
    ddq: Array
    unknown: Array


def follow(diagnosis: Diagnosis, part: Alone, dq: Array, ddq: Array) -> Behind:
    """Return how the link of a joint with two masses moves.

    Under its load it swings behind the drive, from a start that its force on the drive tells; a gap
    lies on the side to which it is pulled, and the link behind it is jerked when a simulation of
    that joint says. One that strays from its drive farther than that moves does no such thing: a
    link that is too light for its poses swings up without end. It is then taken for rigid.

    Parameters
    ----------
    diagnosis : Diagnosis
        Has the values of its flexibility or backlash.
    part : Alone
        That joint.
    dq, ddq : ndarray, (n_samples,)
        Velocity and acceleration of the drive.
    """
    effect = next(e for e in TWO_MASSES if e in diagnosis.effects)
    theta, own = diagnosis.theta, of_effect(diagnosis.theta, effect)
    hz = next(own[p.name] for p in EFFECTS[effect].parameters if p.unit == "Hz")
    mass = np.array([hz, own["damping"], own["load_share"]])
    q = part.record.q[:, 0]

    def swings(mass: Array, x: float = 0.0, v: float = 0.0) -> Array:
        """Return position, acceleration and force, (3, n_samples), begun so far from hanging."""
        return _swings(part, theta["inertia"], (q, dq), mass, x, v)

    link = swings(mass)
    if own.get("gap", 0.0) > 0.0:
        ddx, none = _jerked(effect, diagnosis, part), np.zeros((0, 2, len(q)))
        x = link[0] - 0.5 * own["gap"] * np.sign(q - link[0])
        return Behind(x, ddx if np.isfinite(ddx).all() else link[1], none)
    others = (
        swings(mass, 1.0),
        swings(mass, 0.0, 1.0),
        *(swings(m) for m in mass + STEP * np.diag(mass)),
    )
    unknown = np.array(others) - link
    delivered = _driven(part, theta, mass[2], (q, dq, ddq), part.loop.force(part.record)[:, 0])
    settled = slice(round(LINKED_TRANSIENT / part.record.dt), None)
    moves = np.zeros(len(q), dtype=bool)
    moves[settled] = np.abs(dq[settled]) > CRAWLING * np.max(np.abs(dq))  # else stiction tells
    begun = np.linalg.lstsq(unknown[:2, 2, moves].T, (delivered - link[2])[moves])[0]
    link = link + np.tensordot(begun, unknown[:2], 1)
    if not np.max(np.abs(link[0] - q)[settled]) < np.ptp(q):
        return Behind(q, ddq, np.zeros((0, 2, len(q))))
    return Behind(link[0], link[1], unknown[:, :2])


def _swings(
    part: Alone, inertia: float, drive: tuple[Array, Array], mass: Array, x: float, v: float
) -> Array:
    """Return position and acceleration of a link behind a spring, and the net force on it.

    Parameters
    ----------
    part : Alone
    inertia : float
        Of the joint, kg or kg m2.
    drive : tuple of ndarray, (n_samples,)
        Its position and velocity.
    mass : ndarray, (3,)
        Frequency, Hz, damping and share of the inertia of the second mass.
    x, v : float
        Position and velocity at the start, beside those where it hangs still.
    """
    hz, damping, share = (float(m) for m in mass)
    (load, more), heavy, w = part.link.T, share * inertia, 2.0 * np.pi * hz
    heavier = np.maximum(1.0 + more / heavy, LIGHTEST)
    pull, drag = w * w * (1.0 - share), 2.0 * damping * w * (1.0 - share)
    x, v = x + drive[0][0] - load[0] / heavy / pull, v + drive[1][0]
    found = _swung(*drive, load / heavy, heavier, pull, drag, part.record.dt, x, v)
    return np.array(found) * [[1.0], [1.0], [heavy]]


@cached()
def _swung(
    q: Array,
    dq: Array,
    pulled: Array,
    heavier: Array,
    pull: float,
    drag: float,
    dt: float,
    x: float,
    v: float,
) -> tuple[Array, Array, Array]:
    """Return position, acceleration and net force over the mean inertia of a mass behind a spring.

    By the implicit midpoint rule. What its velocity asks where the inertia changes is in the load
    as if it had that of what it hangs from.

    Parameters
    ----------
    q, dq : ndarray, (n_samples,)
        Position and velocity of what it hangs from.
    pulled : ndarray, (n_samples,)
        Load that pulls it, over its mean inertia.
    heavier : ndarray, (n_samples,)
        Its inertia, over the mean.
    pull, drag : float
        Spring and damper, over the mean inertia.
    dt : float
    x, v : float
        Its position and velocity at the start.
    """
    places, ddx, net = np.empty(len(q)), np.empty(len(q)), np.empty(len(q))
    grows = np.zeros(len(q))
    grows[1:-1] = (heavier[2:] - heavier[:-2]) / (2.0 * dt)
    for k in range(len(q)):
        places[k] = x
        net[k] = pull * (q[k] - x) + drag * (dq[k] - v) - pulled[k]
        ddx[k] = (net[k] + grows[k] * (dq[k] - v)) / heavier[k]
        if k + 1 == len(q):
            break
        step = 2.0 * dt / (heavier[k] + heavier[k + 1])
        ahead = 0.5 * (q[k] + q[k + 1]) - x - 0.5 * dt * v
        faster = 0.5 * (dq[k] + dq[k + 1]) - v
        wider = drag + (heavier[k + 1] - heavier[k]) / dt
        force = pull * ahead + wider * faster - 0.5 * (pulled[k] + pulled[k + 1])
        change = step * force / (1.0 + 0.5 * step * (0.5 * dt * pull + wider))
        x += dt * (v + 0.5 * change)
        v += change
    return places, ddx, net


def _jerked(effect: str, diagnosis: Diagnosis, part: Alone) -> Array:
    """Return the acceleration of a link behind a gap, (n_samples,), in a simulation of the joint.

    Its velocity is hardly another than the drive's.
    """
    theta = diagnosis.theta
    loop = part.loop.with_effect(effect, **of_effect(theta, effect))
    values = loop.values({n: v for n, v in theta.items() if n in loop.names})
    sim = loop.simulate(part.record, values, link=part.link)
    share, motion = theta[f"{effect}.load_share"], (sim.q[:, 0], sim.dq[:, 0], sim.ddq[:, 0])
    heavy = share * theta["inertia"]
    own = np.maximum(heavy + part.link[:, 1], LIGHTEST * heavy)
    return _driven(part, theta, share, motion, sim.tau[:, 0]) / own


def _driven(
    part: Alone,
    theta: Mapping[str, float],
    share: float,
    motion: tuple[Array, Array, Array],
    tau: Array,
) -> Array:
    """Return the force that accelerates a link, N or N m, (n_samples,).

    Of those on the joint what accelerates neither drive nor load.
    """
    t = part.record.t - part.record.t[0]
    left = tau - (1.0 - share) * theta["inertia"] * motion[2] - part.link[:, 0]
    for term in part.loop.terms:
        if term.law is not None and term.name != "inertia":
            left = left - term.force(*motion, [theta[n] for n in term.names], tau, t)
    return left
