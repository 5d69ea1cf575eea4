"""A servo axis in MuJoCo: motor, load, and forces that are not in its language.

What MuJoCo has of its own is taken from it: masses, damping, dry friction, springs, a second body
on a spring or in a gap, an eccentric mass, a pendulum that hangs under a cart. The rest is a force
applied at every step of the physics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np

STEPS = 10  # of the physics per sample
Force = Callable[[float, float, float, float], float]

_XML = """<mujoco>
  <compiler inertiafromgeom="false"/>
  <option timestep="{step}" gravity="{gravity}" integrator="implicitfast" iterations="50"/>
  <worldbody><body>
    <joint name="axis" type="{kind}" axis="{axis}" damping="{viscous}" frictionloss="{coulomb}"
      stiffness="{stiffness}" solreffriction="{solref} 1" solimpfriction="{solimp}"/>
    <inertial pos="0 0 0" mass="{mass}" diaginertia="{inertia} {inertia} {inertia}"/>
    {inside}
  </body></worldbody>
</mujoco>"""
_SLIDE = """<body><joint name="rel" type="slide" axis="1 0 0" {joint}/>
  <inertial pos="0 0 0" mass="{mass}" diaginertia="1e-3 1e-3 1e-3"/></body>"""
_TURN = """<body><joint name="rel" type="hinge" axis="0 1 0" {joint}/>
  <inertial pos="0 0 0" mass="1e-6" diaginertia="{mass} {mass} {mass}"/></body>"""
_ARM = """<body><inertial pos="0 0 {down}" mass="{mass}" diaginertia="1e-9 1e-9 1e-9"/></body>"""
_PENDULUM = """<body pos="0 0 0"><joint type="hinge" axis="0 1 0" damping="{damping}"/>
  <inertial pos="0 0 {down}" mass="{mass}" diaginertia="{small} {small} {small}"/></body>"""


@dataclass(frozen=True)
class Plant:
    """One axis.

    Parameters
    ----------
    joint : str
        ``"prismatic"`` or ``"revolute"``.
    inertia, viscous, coulomb, offset : float
        SI.
    dry : bool
        Coulomb friction as stiff as MuJoCo makes it; else regularised, as it ships.
    stiffness : float
        Of a spring to the world.
    load : mapping
        ``share`` of the inertia on a second body, ``hz`` and ``damping`` of its spring or contact,
        ``gap``.
    arm, pendulum : float
        Eccentric mass times length; share of the mass that swings under the cart.
    force : callable
        Further force, ``f(q, dq, t, tau)``, that opposes the motion.
    drive : callable
        What the drive makes of a force: ``f(tau)``.
    delay, lag : float
        Of the force, s.
    """

    joint: str
    inertia: float
    viscous: float
    coulomb: float
    offset: float
    dry: bool = True
    stiffness: float = 0.0
    load: dict[str, float] = field(default_factory=dict)
    arm: float = 0.0
    pendulum: float = 0.0
    force: Force | None = None
    drive: Callable[[float], float] | None = None
    delay: float = 0.0
    lag: float = 0.0

    def xml(self, dt: float) -> str:
        """Return the model at a sampling step."""
        turn, share, inside = self.joint == "revolute", 0.0, ""
        if self.load:
            share = self.load["share"]
            inside = (_TURN if turn else _SLIDE).format(
                joint=self._second(), mass=share * self.inertia
            )
        if self.arm:
            inside += _ARM.format(down=-0.1, mass=self.arm / 0.1)
        if self.pendulum:
            m = self.pendulum * self.inertia
            inside += _PENDULUM.format(down=-0.3, mass=m, damping=0.01 * m, small=1e-3 * m)
        own = self.inertia * (1.0 - share)
        return _XML.format(
            step=dt / STEPS,
            gravity="0 0 -9.81" if self.arm or self.pendulum else "0 0 0",
            kind="hinge" if turn else "slide",
            axis="0 1 0" if turn else "1 0 0",
            viscous=self.viscous,
            coulomb=self.coulomb,
            stiffness=self.stiffness,
            solref=2.0 * dt / STEPS if self.dry else 0.02,
            solimp="0.99 0.999 1e-4" if self.dry else "0.9 0.95 0.001",
            mass=1e-6 if turn else own,
            inertia=max(own - 0.1 * self.arm, 0.1 * own) if turn else 1e-3,
            inside=inside,
        )

    def _second(self) -> str:
        """Return the attributes of the joint between the bodies."""
        r = self.load["share"]
        reduced = self.inertia * r * (1.0 - r)
        w = 2.0 * np.pi * self.load["hz"]
        k, c = reduced * w * w, 2.0 * self.load["damping"] * reduced * w
        gap = self.load.get("gap", 0.0)
        if not gap:
            return f'stiffness="{k}" damping="{c}"'
        scale = self.inertia * r  # limits of MuJoCo: stiffness and damping per mass
        return (
            f'limited="true" range="{-0.5 * gap} {0.5 * gap}" solreflimit="{-k / scale} '
            f'{-c / scale}" solimplimit="0.99 0.99 1e-6" damping="{1e-4 * c}"'
        )


def run(
    plant: Plant,
    command: Callable[[int, float, float], float],
    q0: float,
    n: int,
    dt: float,
    gain: float,
    noise: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Run an axis under a control law; return position and command, (n,) each.

    Parameters
    ----------
    plant : Plant
    command : callable
        Of the sample, the position and the velocity: the command.
    q0 : float
        Position at the start, at rest.
    n, dt, gain
        Samples, s, force per command.
    noise : ndarray, (n,)
        Force noise, held over a sample.
    """
    xml = plant.xml(dt).replace("<compiler ", '<compiler angle="radian" autolimits="true" ')
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.qpos[0] = q0
    q, nu = np.empty(n), np.empty(n)
    steps = round(plant.delay / dt * STEPS)
    line, made, last, h, t = [0.0] * steps, 0.0, 0.0, dt / STEPS, 0.0
    pull = 1.0 - np.exp(-h / plant.lag) if plant.lag else 1.0
    for k in range(n):
        q[k] = data.qpos[0]
        nu[k] = command(k, q[k], float(data.qvel[0]))
        for _ in range(STEPS):
            line.append(gain * nu[k])
            made += pull * (line.pop(0) - made)
            tau = plant.drive(made) if plant.drive else made
            x, v = float(data.qpos[0]), float(data.qvel[0])
            rest = plant.force(x, v, t, tau) if plant.force else 0.0
            # where a step ends its new velocity has moved it for all of the step: half of one early
            data.qfrc_applied[0] = 0.5 * (last + tau) - plant.offset - rest + noise[k]
            last = tau
            mujoco.mj_step(model, data)
            t += h
        if not np.isfinite(data.qpos[0]) or abs(data.qvel[0]) > 1e6:
            raise FloatingPointError("the axis ran away")
    return q, nu
