"""The closed loop as a python-control system.

Two blocks with named signals: the controller (its states are the past positions, its own states
and the commands on their way) and the axis (drive, mechanics, sensor; its update is the compiled
`plant_step`). python-control interpolates inputs linearly between samples where it integrates in
continuous time; this system is discrete, so inputs are held, as a digital controller holds them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .engine import effective_controller, plant
from .integrator import drive_delay
from .kernel import axis_step, measure

if TYPE_CHECKING:
    from .closed_loop import ClosedLoop
    from .controllers import Controller

Array = NDArray[np.float64]

AXIS_STATES = ("q", "dq", "q_load", "dq_load", "bristle", "force", "time")


def system(
    loop: ClosedLoop, values: Mapping[str, float], dt: float, substeps: int
) -> control.InterconnectedSystem:
    """Return the interconnected closed loop; see `ClosedLoop.system`."""
    controller = _controller_block(loop, values, dt)
    axis = _axis_block(loop, values, dt, substeps)
    feed = ["feed"] if fed(loop.controller) else []
    return control.interconnect(
        [controller, axis],
        connections=[
            ["controller.q", "axis.q"],
            *([["controller.dq", "axis.dq"]] if "dq" in controller.input_labels else []),
            ["axis.command", "controller.command"],
        ],
        inplist=["controller.q_ref", "controller.dq_ref", "axis.added"]
        + [f"controller.{name}" for name in feed],
        inputs=["q_ref", "dq_ref", "added", *feed],
        outlist=["axis.q", "axis.dq", "axis.nu", "axis.tau"],
        outputs=["q", "dq", "nu", "tau"],
        name=loop.name,
        dt=dt,
    )


def linearised(
    loop: ClosedLoop, values: Mapping[str, float], dt: float, substeps: int
) -> control.StateSpace:
    """Return the rigid loop without dry friction, from q_ref to q; see `ClosedLoop.system`."""
    rigid = loop.with_terms("inertia", "viscous")
    viscous = values.get("viscous", values.get("viscous_pos", 0.0))
    full = system(rigid, {"inertia": values["inertia"], "viscous": viscous}, dt, substeps)
    near = control.linearize(full, np.zeros(full.nstates), np.zeros(full.ninputs))
    seen = np.abs(near.C[0]) > 0.0
    for _ in range(full.nstates):  # what the position feels, directly or through other states
        seen = seen | (np.abs(near.A[seen]) > 0.0).any(axis=0)
    keep = np.flatnonzero(seen)
    A, B = near.A[np.ix_(keep, keep)], near.B[keep, :1]
    return control.ss(
        A, B, near.C[:1, keep], near.D[:1, :1], dt, inputs="q_ref", outputs="q", name=loop.name
    )


def fed(controller: Controller) -> bool:
    """Whether a controller has one more input: feed-forwards and further measured columns."""
    return bool(controller.feedforward or controller.feedback or controller.kind == "none")


def _controller_block(
    loop: ClosedLoop, values: Mapping[str, float], dt: float
) -> control.NonlinearIOSystem:
    controller = effective_controller(loop, values)
    law, delay = controller.law(dt), controller.delay
    past, inner = len(law.taps) - 1, len(law.C)
    limit = _limit(loop, values)

    known = 3 if fed(controller) else 2

    def seen(x: Array, u: Array) -> Array:
        positions = np.append(u[known], x[:past])
        feed = u[2] if known == 3 else 0.0
        speed = u[known + 1] if law.sensed else law.taps @ positions
        return np.array([u[0], u[1], feed, u[known], speed])

    def value(x: Array, u: Array) -> float:
        return float(law.D @ seen(x, u) + law.C @ x[past : past + inner])

    def state(x: Array, u: Array) -> Array:
        own, wanted = x[past : past + inner], value(x, u)
        excess = wanted - np.clip(wanted, -limit, limit)
        new = law.A @ own + law.B @ seen(x, u) - law.back * excess
        return np.where(law.hold & (excess * law.C * (new - own) > 0.0), own, new)

    def update(t: float, x: Array, u: Array, params: Any) -> Array:
        line: ArrayLike = np.append(x[past + inner :], value(x, u))[-delay:] if delay else []
        new = np.concatenate([[u[known]], x[:past], state(x, u), line])
        return new[_drop(past, inner, delay)]

    def output(t: float, x: Array, u: Array, params: Any) -> Array:
        return np.array([x[past + inner] if delay else value(x, u)])

    return control.nlsys(
        update,
        output,
        inputs=["q_ref", "dq_ref", *["feed"][: known - 2], "q", *(["dq"] if law.sensed else [])],
        outputs=["command"],
        states=past + inner + delay,
        name="controller",
        dt=dt,
    )


def _drop(past: int, inner: int, delay: int) -> Array:
    """Return the indices that keep the newest `past` positions and everything behind them."""
    return np.r_[0:past, past + 1 : past + 1 + inner + delay].astype(int)


def _axis_block(
    loop: ClosedLoop, values: Mapping[str, float], dt: float, substeps: int
) -> control.NonlinearIOSystem:
    p, on, user = plant(loop, values)
    whole, _ = drive_delay(dt, p, on)
    limit = _limit(loop, values)
    added_gain = 1.0 + values.get("controller-mismatch.added", 0.0)

    def nu(u: Array) -> float:
        return float(np.clip(u[0], -limit, limit) + added_gain * u[1])

    def update(t: float, x: Array, u: Array, params: Any) -> Array:
        line: list[float] = [
            nu(u),
            *x[7:],
        ]  # newest first; the plant is driven by what was sent `whole` ago
        state, force, _ = axis_step(
            tuple(x[:5]),
            x[5],
            line[-1],
            line[whole],
            x[6],
            dt,
            substeps,
            p,
            on,
            user,
        )
        return np.array([*state, force, x[6] + dt, *line[: whole + 1]])

    def output(t: float, x: Array, u: Array, params: Any) -> Array:
        return np.array([measure(x[0], 0.0, 0.0, p, on), x[1], nu(u), loop.gain * nu(u)])

    return control.nlsys(
        update,
        output,
        inputs=["command", "added"],
        outputs=["q", "dq", "nu", "tau"],
        states=[*AXIS_STATES, *(f"sent{i}" for i in range(whole + 1))],
        name="axis",
        dt=dt,
    )


def _limit(loop: ClosedLoop, values: Mapping[str, float]) -> float:
    return min(loop.controller.limit, values.get("saturation.limit", np.inf))


def initial_state(
    loop: ClosedLoop, values: Mapping[str, float], dt: float, q: float, dq: float
) -> Array:
    """Return the state of `system` in steady motion at q, dq, with no command sent before.

    Parameters
    ----------
    loop, values, dt
        As for `system`.
    q, dq : float
        Position (m or rad) and velocity.
    """
    controller, (p, on, _) = effective_controller(loop, values), plant(loop, values)
    law = controller.law(dt)
    past = [measure(q - i * dt * dq, 0.0, 0.0, p, on) for i in range(1, len(law.taps))]
    sent = np.zeros(drive_delay(dt, p, on)[0] + 1)
    lines = np.zeros(len(law.C) + controller.delay)
    return np.concatenate([past, lines, [q, dq, q, dq, 0.0, 0.0, 0.0], sent])
