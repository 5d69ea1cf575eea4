"""Edits one joint of a MuJoCo model and its actuator, term by term."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from copy import copy
from math import atan2, ceil, hypot, log, pi
from typing import Any

from ivtools.errors import AxisError
from ivtools.robot.mjcf import engine
from ivtools.simulators.mjcf import Axis

_FRAME = ("pos", "quat", "euler", "axisangle", "xyaxes", "zaxis", "childclass")
_PLACE = ("joint", "dof", "position", "actuator", "pose")
_CLOSED = 1e-12  # m or rad: MuJoCo wants a gap that is not 0
_SILENT = {"motorconst": "1e-6", "resistance": "1e6"}  # a motor that does nothing by itself
#: Friction that holds at standstill instead of creeping, as far as MuJoCo's solver goes.
_DRY = {"solreffriction": "0.0001 1", "solimpfriction": "0.999 0.9999 0.0001"}


class Writer:
    """Edits one joint and its actuator, term by term."""

    def __init__(
        self, axis: Axis, joint: str, tree: ET.ElementTree[ET.Element], own: dict[str, float]
    ) -> None:
        self.axis, self.name, self.tree, self.own = axis, joint, tree, own
        root = tree.getroot()
        self.joint = _one(root.iter("joint"), "name", joint)
        drives = [e for block in root.iter("actuator") for e in block if e.get("joint") == joint]
        self.actuator = drives[0] if drives else None
        if len(drives) > 1 and axis.actuator >= 0:
            self.actuator = _one(drives, "name", axis.model.actuator(axis.actuator).name)
        self.moved = own["inertia"]
        self.constant = 0.0  # force that is added to what the model has

    def finish(self) -> None:
        """Write what several terms add up to."""
        if self.constant:
            bias = {
                "biastype": "affine",
                "biasprm": f"{number(-self.constant)} 0 0",
                "gainprm": "0",
            }
            self._add("general", name=f"{self.name}-offset", **bias)

    def comment(self, text: str) -> None:
        """Add a comment at the model's end."""
        self.tree.getroot().append(ET.Comment(f" {text.replace('--', '- -')} "))

    def _add(self, tag: str, **attributes: Any) -> bool:
        """Add an actuator on the joint behind the others, whose commands keep their places."""
        block = self.tree.getroot().find("actuator")
        if block is None:
            block = ET.SubElement(self.tree.getroot(), "actuator")
        taken = {e.get("name") for e in block}
        while attributes["name"] in taken:  # of an earlier diagnosis
            attributes["name"] += "-more"
        ET.SubElement(block, tag, joint=self.name, **attributes)
        return True

    # --- one term each; each returns whether MuJoCo holds it ------------------------------------

    def inertia(self, value: float) -> bool:
        """Write what the joint moves: armature, or lighter bodies."""
        self.moved = value
        armature = float(self.axis.model.dof_armature[self.axis.dof])
        bodies = self.own["inertia"] - armature
        self.joint.set("armature", number(max(value - bodies, 0.0)))
        if value < bodies:
            self._shrink(bodies - value)
        return True

    def _shrink(self, less: float) -> None:
        """Make the bodies that are fixed to the joint lighter: no armature is negative."""
        model, bodies = self.axis.model, self._fixed()
        lighter = Axis(copy(model), *(getattr(self.axis, k) for k in _PLACE))
        for k in bodies:
            lighter.model.body_mass[k] *= 0.5
            lighter.model.body_inertia[k] *= 0.5
        engine().mj_setConst(lighter.model, lighter.data())
        own = 2.0 * (self.axis.inertia() - lighter.inertia())
        factor = 1.0 - less / own if own > 0.0 else 0.0
        if factor <= 0.0:
            self.comment(f"{self.name} should move {number(less)} less than its bodies weigh")
            return
        for k, body in bodies.items():
            for old in body.findall("inertial"):
                body.remove(old)
            numbers = {
                "pos": model.body_ipos[k],
                "quat": model.body_iquat[k],
                "mass": [factor * model.body_mass[k]],
                "diaginertia": factor * model.body_inertia[k],
            }
            text = {key: " ".join(map(number, x)) for key, x in numbers.items()}
            body.insert(0, ET.Element("inertial", text))

    def _fixed(self) -> dict[int, ET.Element]:
        """Return the bodies that move with the joint and have no joint of their own, by number.

        MuJoCo numbers bodies in the order of the file.
        """
        bodies = list(self.tree.getroot().find("worldbody").iter("body"))  # type: ignore[union-attr]
        if len(bodies) != self.axis.model.nbody - 1:
            raise AxisError(
                "the model's bodies are not all in this file, so they cannot be made lighter; give "
                "the joint an armature from which the change can be taken"
            )
        numbers = {id(body): k for k, body in enumerate(bodies, 1)}
        found, open_ = {}, [self._body()]
        while open_:
            body = open_.pop()
            found[numbers[id(body)]] = body
            open_ += [b for b in body.findall("body") if b.find("joint") is None]
        return found

    def _body(self) -> ET.Element:
        """Return the body that the joint moves."""
        return next(b for b in self.tree.iter("body") if self.joint in list(b))

    # --- a second mass: motor and load share the joint's inertia, the encoder is on the motor ----

    def flexibility(self, hz: float, damping: float, share: float, friction: float) -> bool:
        """Write a load behind a spring and damper."""
        reduced = self.moved * share * (1.0 - share)
        stiffness = (2.0 * pi * hz) ** 2 * reduced
        damper = 2.0 * damping * (stiffness * reduced) ** 0.5
        spring = {"stiffness": number(stiffness), "damping": number(damper)}
        return self._second_mass(share, friction, spring)

    def backlash(
        self, gap: float, share: float, friction: float, offset: float, hz: float, damping: float
    ) -> bool:
        """Write a load behind a gap with hard ends."""
        rate, gap = 2.0 * pi * hz, max(gap, _CLOSED)
        stop = {
            "limited": "true",
            "range": f"{number(-0.5 * gap)} {number(0.5 * gap)}",
            "solreflimit": f"{number(-(rate**2))} {number(-2.0 * damping * rate)}",
            "solimplimit": "0.9999 0.9999 1e-6",
        }
        return offset == 0.0 and self._second_mass(share, friction, stop)

    def _second_mass(self, share: float, friction: float, tie: dict[str, Any]) -> bool:
        whole, load = self.moved, f"{self.name}-load"
        self.inertia(whole * (1.0 - share))
        carrier = self._body()
        parent = next(b for b in self.tree.iter() if carrier in list(b))
        frame: dict[str, Any] = {k: v for k in _FRAME if (v := carrier.get(k))}
        body = ET.SubElement(parent, "body", name=load, gravcomp="1", **frame)
        size = number(whole * share)  # a mass on a slide, an inertia on a hinge; not an armature,
        round_ = f"{size} {size} {size}"  # on which MuJoCo's friction finds no hold
        ET.SubElement(body, "inertial", pos="0 0 0", mass=size, diaginertia=round_)
        same: dict[str, Any] = {k: v for k in ("type", "axis", "pos") if (v := self.joint.get(k))}
        same.pop("pos", None) if self.axis.revolute else None
        second = ET.SubElement(body, "joint", name=load, **same)
        for key in ("damping", "frictionloss"):
            numbers = [float(x) for x in (self.joint.get(key) or "0").split()]
            for element, part in ((self.joint, 1.0 - friction), (second, friction)):
                element.set(key, " ".join(number(part * x) for x in numbers))
        for key in _DRY:
            if (text := self.joint.get(key)) is not None:
                second.set(key, text)
        block = self.tree.getroot().find("tendon")
        block = ET.SubElement(self.tree.getroot(), "tendon") if block is None else block
        tendon = ET.SubElement(block, "fixed", name=f"{self.name}-transmission", **tie)
        for joint, coef in ((self.name, "1"), (load, "-1")):
            ET.SubElement(tendon, "joint", joint=joint, coef=coef)
        return True

    def viscous(self, value: float) -> bool:
        """Write the first coefficient of the damping."""
        return self._damping(0, max(value, 0.0))

    def polynomial(self, quadratic: float, cubic: float) -> bool:
        """Write the other two coefficients of the damping."""
        return self._damping(1, quadratic) and self._damping(2, cubic)

    def _damping(self, place: int, value: float) -> bool:
        model, dof = self.axis.model, self.axis.dof
        stated = [model.dof_damping[dof], *model.dof_dampingpoly[dof][:2]]
        now = [float(x) for x in (self.joint.get("damping") or "").split()]
        numbers = (now + [float(x) for x in stated[len(now) :]])[:3]
        numbers[place] = value
        self.joint.set("damping", " ".join(map(number, numbers)))
        return True

    def coulomb(self, value: float) -> bool:
        """Write dry friction, stiff where the model had none of its own."""
        self.joint.set("frictionloss", number(max(value, 0.0)))
        if (
            value > 0.0 == self.axis.model.dof_frictionloss[self.axis.dof]
        ):  # else it creeps as it did
            self.stiff()
        return True

    def stiff(self) -> None:
        """Let dry friction hold at standstill."""
        for key, text in _DRY.items():
            self.joint.set(key, text)

    def asymmetric(self, vpos: float, cpos: float, vneg: float, cneg: float) -> bool:
        """Write the part of a friction that is the same in both directions."""
        same = self.viscous(0.5 * (vpos + vneg)) and self.coulomb(0.5 * (cpos + cneg))
        if vpos != vneg or cpos != cneg:
            self.comment(
                f"friction differs by direction: {number(0.5 * (vpos - vneg))} |dq| + "
                f"{number(0.5 * (cpos - cneg))} against the motion are not in the model"
            )
        return same

    def offset(self, value: float) -> bool:
        """Write a constant force; it is written when all of it is known."""
        self.constant += value - self.own.get("offset", 0.0)
        return True

    def spring(self, stiffness: float, curvature: float) -> bool:
        """Write a stiffness that is a polynomial of the position."""
        at = float(self.axis.model.qpos_spring[self.axis.position])
        first = stiffness + 2.0 * curvature * at  # about the model's own resting place
        self.joint.set("stiffness", f"{number(first)} {number(curvature)}")
        before = self.own.get("spring.stiffness", 0.0) + (
            self.own.get("spring.curvature", 0.0) * at
        )
        self.constant += (first - curvature * at - before) * at  # the spring's own part of it
        return True

    def gravity(self, sine: float, cosine: float) -> bool:
        """Write an eccentric mass beside those that the model has."""
        change = (
            sine - self.own.get("gravity.sin", 0.0),
            cosine - self.own.get("gravity.cos", 0.0),
        )
        return not any(change) or self._wave("gravity", *change[::-1], 1.0)

    def cogging(self, cosine: float, sine: float, period: float) -> bool:
        """Write a force that is periodic in the position."""
        return self._wave("cogging", cosine, sine, 2.0 * pi / period)

    def _wave(self, what: str, cosine: float, sine: float, per_length: float) -> bool:
        """Hold a cos(n q) + b sin(n q) against the motion."""
        size, phase = hypot(cosine, sine), atan2(-cosine, -sine)
        text = f"{number(size)} {number(per_length)} {number(phase)}"
        return self._add("dcmotor", name=f"{self.name}-{what}", cogging=text, **_SILENT)

    def timing(self, delay: float, lag: float) -> bool:
        """Write delay and lag of an actuator that only passes a command on."""
        element = self.actuator
        if (
            element is None
            or element.tag not in ("motor", "general")
            or self.axis.kp
            or self.axis.kv
        ):
            return False  # what its own controller gets would be late, not what it gives
        step = float(self.axis.model.opt.timestep)
        delay += float(element.get("delay") or 0.0)
        if delay > 0.5 * step:  # MuJoCo has none below a step
            element.set("delay", number(max(delay, step)))
            element.set("nsample", str(ceil(delay / step) + 2))
            element.set("interp", "linear")
        if lag > 0.0:
            element.tag = "general"
            element.set("dyntype", "filterexact")
            element.set("actearly", "true")
            element.set("dynprm", number(step / log((lag + step) / lag)))  # late by `lag` in all
        return True

    def saturation(self, limit: float) -> bool:
        """Write a limit of the actuator's force."""
        if self.actuator is None or limit == float("inf"):
            return self.actuator is not None
        self.actuator.set("forcerange", f"{number(-limit)} {number(limit)}")
        return True


def _one(elements: Iterable[ET.Element], key: str, value: str) -> ET.Element:
    found = [e for e in elements if e.get(key) == value]
    if len(found) != 1:
        raise AxisError(
            f"{key} {value!r} stands {len(found)} times in the file, not once (name "
            "the included file that holds it, if it is in one)"
        )
    return found[0]


def number(value: Any) -> str:
    """Write a number as models have it."""
    return f"{float(value):.10g}"
