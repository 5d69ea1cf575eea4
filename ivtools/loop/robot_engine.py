"""From a robot's loop and a record to the arguments of the arm's kernel, and back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import AxisError, ShapeError
from ..physics import TERMS
from ..record import Record
from . import mechanics
from .arm import Arm, room, state
from .arm_kernel import Laws, Outside, Work, run
from .controllers import Controller
from .engine import driven, plant
from .robot_masses import SINGULAR
from .simulation import Simulation

if TYPE_CHECKING:
    from .robot_loop import RobotLoop

Array = NDArray[np.float64]

_STEP = 1e-3  # s: the mass matrix is taken as constant over so long


def simulate(
    loop: RobotLoop,
    record: Record,
    values: Mapping[str, float],
    *,
    initial: Any,
    substeps: int | None,
    position_noise: ArrayLike | None,
    force_noise: ArrayLike | None,
    quantum: ArrayLike,
) -> Simulation:
    """Run the kernel; see `RobotLoop.simulate`."""
    n, dt = loop.n_joints, record.dt
    own = [loop.joint_values(j, values) for j in range(n)]
    law = laws(loop, record, own, initial)
    arm, user = _arm(loop, values, own, law.q)
    steps = _steps(loop, dt) if substeps is None else substeps
    if steps < 1:
        raise AxisError(f"substeps is {steps}; it counts the integration steps per sample")
    force = _noise("force_noise", force_noise, record)
    if record.load is not None:
        force = (force if force.size else 0.0) - np.ascontiguousarray(record.load.T)
    outside = Outside(_added(record, own), force, _noise("position_noise", position_noise, record))
    resolution = np.broadcast_to(np.asarray(quantum, dtype=float), n).copy()
    out = np.empty((4, n, record.n_samples))
    work = _work(n, record.n_samples, law, longest_delay(arm, dt))
    if not run(dt, steps, law, outside, resolution, arm, user, work, out):
        raise AxisError(SINGULAR)
    q, dq, ddq, nu = (np.ascontiguousarray(signal.T) for signal in out)
    with np.errstate(over="ignore", invalid="ignore"):  # Simulation.finite tells
        tau = nu * [axis.gain for axis in loop.axes]
    return Simulation(record.t, q, dq, ddq, nu, tau, loop)


def _work(n: int, samples: int, laws: Laws, delay: int) -> Work:
    """Return room for a simulation."""
    return Work(
        room(n),
        room(n),
        state(n),
        state(n),
        np.zeros((8, n)),
        np.empty((n, laws.taps.shape[1] - 1 + samples)),
        np.empty((n, laws.first.shape[1] - 1 + samples)),
        np.empty((n, delay + 1 + samples)),
        np.empty(laws.C.shape[1]),
    )


def longest_delay(arm: Arm, dt: float) -> int:
    """Return the longest delay of a drive, in samples, rounded up."""
    return int(np.ceil((arm.p["delay"] + arm.p["drive-timing.delay"]).max() / dt)) + 1


def _steps(loop: RobotLoop, dt: float) -> int:
    """Return the steps per sample; one joint has what its terms need, as one axis has."""
    needed = max((axis.substeps for axis in loop.axes if axis.terms), default=1)
    return needed if loop.n_joints == 1 else max(needed, int(np.ceil(dt / _STEP - 1e-6)))


def laws(loop: RobotLoop, record: Record, own: list[dict[str, float]], initial: Any) -> Laws:
    """Collect the laws of all joints, padded to the longest.

    Without a reference the loop is open: the recorded commands drive it.
    """
    opened = record.q_ref is None and record.dq_ref is None
    parts = []
    for j, axis in enumerate(loop.axes):
        if opened:
            axis = replace(axis, controller=Controller("none", {}))
        parts.append(driven(axis, _joints(record)[j], own[j], _initial(initial, j)))
    return Laws(*(_stacked([np.asarray(p[i]) for p in parts]) for i in range(len(Laws._fields))))


def _joints(record: Record) -> tuple[Record, ...]:
    """Return the records of the joints: the same ones each time, so that their laws are kept."""
    if record not in _JOINTS:
        _JOINTS[record] = tuple(record.joint(j) for j in range(record.n_joints))
    return _JOINTS[record]


_JOINTS: WeakKeyDictionary[Record, tuple[Record, ...]] = WeakKeyDictionary()


def _initial(initial: Any, j: int) -> Any:
    """Return how joint j starts."""
    if isinstance(initial, str):
        return initial
    try:
        q, v = initial
        return float(np.ravel(q)[j]), float(np.ravel(v)[j])
    except (TypeError, ValueError, IndexError):
        raise AxisError(f"initial is {initial!r}; it is 'record', 'rest' or (q, dq)") from None


def _stacked(arrays: list[NDArray[Any]]) -> NDArray[Any]:
    """Stack arrays as rows, each padded with zeros to the largest."""
    shape = [max(sizes) for sizes in zip(*(a.shape for a in arrays), strict=True)]
    out = np.zeros((len(arrays), *shape), dtype=arrays[0].dtype)
    for j, array in enumerate(arrays):
        corner = [slice(j, j + 1), *(slice(0, k) for k in array.shape)]
        out[tuple(corner)] = array
    return out


def _arm(
    loop: RobotLoop, values: Mapping[str, float], own: list[dict[str, float]], q0: Array
) -> tuple[Arm, Callable[..., float]]:
    """Collect mechanics and drives; also return the slot of own laws."""
    M = loop.mass_matrix(q0, values)[0]
    try:
        np.linalg.cholesky(M)
        felt = 1.0 / np.diag(np.linalg.inv(M))
    except np.linalg.LinAlgError:
        raise AxisError(SINGULAR) from None
    n, users = loop.n_joints, []
    p, on = np.zeros(n, mechanics.PARAMETERS), np.zeros(n, mechanics.FLAGS)
    for j, axis in enumerate(loop.axes):
        if not axis.terms:
            p[j]["gain"], p[j]["delay"], p[j]["inertia"] = axis.gain, axis.delay, felt[j]
            on[j]["effects"] = axis.delay > 0.0
            continue
        part = plant(axis, {**own[j], "inertia": float(felt[j])})
        p[j], on[j] = part.p, part.on
        if any(TERMS.get(term.name) is not term for term in axis.terms):
            users.append(part.user)
        p[j]["inertia"] = felt[j]
    if len(set(users)) > 1:
        raise AxisError("joints have different terms of your own; give all of them the same")
    armature = np.array([v.get("inertia", 0.0) for v in own])
    coupled = loop.transmission is not None
    matrix = np.ascontiguousarray(loop._T)
    phi = loop.inertias(values)
    arm = Arm(loop.robot.tree, phi, armature, matrix, coupled, p, on)
    return arm, users[0] if users else mechanics.no_law


def _added(record: Record, own: list[dict[str, float]]) -> Array:
    if record.added is None:
        return np.zeros((0, 0))
    more = np.array([v.get("controller-mismatch.added", 0.0) for v in own])
    return np.ascontiguousarray((record.added * (1.0 + more)).T)


def _noise(name: str, noise: ArrayLike | None, record: Record) -> Array:
    if noise is None:
        return np.zeros((0, 0))
    array = np.asarray(noise, dtype=float).reshape(len(np.atleast_1d(noise)), -1)
    if array.shape != record.q.shape:
        raise ShapeError(f"{name} is {array.shape} and q {record.q.shape}; both must match")
    return np.ascontiguousarray(array.T)
