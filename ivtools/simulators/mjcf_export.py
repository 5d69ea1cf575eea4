"""A diagnosis, written back into a MuJoCo model: what its elements can hold, the rest as comments.

MuJoCo's damping is a polynomial of the speed, its stiffness one of the position; an actuator may
have a delay, a lag and a limit. A `<dcmotor>` without a command of its own holds cogging, and so
the gravity of an eccentric mass too (one period per turn). A constant force is an actuator with
nothing but a bias.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ivtools.errors import AxisError
from ivtools.files import write
from ivtools.loop import ClosedLoop
from ivtools.physics import Term
from ivtools.robot.mjcf import engine
from ivtools.simulators.difference import CREEPS
from ivtools.simulators.mjcf import Axis, closed_loop
from ivtools.simulators.mjcf_writer import Writer, number
from ivtools.xml_file import parsed


@dataclass(frozen=True)
class Export:
    """A MuJoCo model with a diagnosis in it.

    Attributes
    ----------
    xml : str
        The model.
    native : tuple of str
        What MuJoCo now does by itself.
    beside : dict of Term to tuple of float
        Forces that it has no element for: in the model as comments with their formulas, and for
        ``MujocoSimulator(..., beside=export.beside)``.
    lost : tuple of str
        What is in the comments only.
    """

    xml: str
    native: tuple[str, ...]
    beside: dict[Term, tuple[float, ...]] = field(default_factory=dict)
    lost: tuple[str, ...] = ()

    def write(self, path: str | Path) -> Path:
        """Write the model beside the files it refers to; return its path."""
        return write(path, self.xml)


def export(
    path: str | Path,
    joint: str,
    loop: ClosedLoop,
    theta: Mapping[str, float],
    *,
    actuator: str | None = None,
    changes: Mapping[str, float] | None = None,
    surplus: Sequence[str] = (),
) -> Export:
    """Write a diagnosed loop into the model of one of its joints.

    Parameters
    ----------
    path : str or Path
        The model.
    joint : str
    loop : ClosedLoop
        The diagnosed loop, with its effects.
    theta : mapping
        Its parameters.
    actuator : str, optional
        Default: the only one that drives the joint.
    changes : mapping, optional
        Changes of base parameters against the model, by name: they are added to what the model
        states. Without them the loop's values replace the model's.
    surplus : sequence of str
        Effects that the model has and the axis lacks; what is no force of its own must be taken
        out of it by hand.

    Raises
    ------
    AxisError
        The model, joint or actuator is not found, or the joint stands in an included file.
    """
    axis = Axis.of(path, joint, actuator)
    own = closed_loop(path, joint, actuator, controller=loop.controller)
    writer = Writer(
        axis, joint, ET.ElementTree(parsed(Path(path), comments=True)), {**own.values(own.start)}
    )
    wanted = {**writer.own, **theta}
    if changes is not None:
        wanted |= {name: writer.own.get(name, 0.0) + change for name, change in changes.items()}
    native: list[str] = []
    beside: dict[Term, tuple[float, ...]] = {}
    lost: list[str] = []
    for term in sorted(loop.terms, key=lambda term: term.second_mass):  # takes its share
        values = tuple(float(wanted.get(name, 0.0)) for name in term.names)
        write = _NATIVE.get(term.name)
        if term.name in surplus and term.law is None:
            lost.append(term.name)
            writer.comment(f"to be taken out: {_formula(term, values, loop.joint)}")
            continue
        if write is not None and write(writer, *values):
            native.append(f"{term.name}: {', '.join(map(number, values))}")
            continue
        lost.append(term.name)
        if term.law is not None:
            beside[term] = values
        writer.comment(f"not held by MuJoCo: {_formula(term, values, loop.joint)}")
    if CREEPS in (
        term.name for term in loop.terms
    ):  # beside it, what is dry must not creep as well
        writer.stiff()
    writer.finish()
    return Export(_text(writer.tree), tuple(native), beside, tuple(lost))


def _formula(term: Term, values: tuple[float, ...], joint: str) -> str:
    """Return equation and values of a term."""
    numbers = [
        f"{p.name} {number(v)} {p.unit_for(joint)}"
        for p, v in zip(term.parameters, values, strict=True)
    ]
    return f"{term.name}, {term.equation}; {', '.join(numbers)}"


def _text(tree: ET.ElementTree[ET.Element]) -> str:
    """Return the edited model, which MuJoCo reads if it needs no other file."""
    ET.indent(tree)
    xml = ET.tostring(tree.getroot(), encoding="unicode") + "\n"
    if not any(e.get("file") for e in tree.iter() if isinstance(e.tag, str)):
        try:
            engine().MjModel.from_xml_string(xml)
        except ValueError as error:
            reason = " ".join(str(error).split())[:200]
            raise AxisError(f"MuJoCo does not take the diagnosed model: {reason}") from error
    return xml


_NATIVE: dict[str, Callable[..., bool]] = {
    "inertia": Writer.inertia,
    "viscous": Writer.viscous,
    "coulomb": Writer.coulomb,
    "asymmetric-friction": Writer.asymmetric,
    "offset": Writer.offset,
    "gravity": Writer.gravity,
    "spring": Writer.spring,
    "polynomial-viscous": Writer.polynomial,
    "cogging": Writer.cogging,
    "drive-timing": Writer.timing,
    "saturation": Writer.saturation,
    "flexibility": Writer.flexibility,
    "backlash": Writer.backlash,
}
