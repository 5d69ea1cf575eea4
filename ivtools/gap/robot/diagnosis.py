"""RobotDiagnosis: the answers of a robot's joints, and what they do to the whole."""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import wrap
from typing import TYPE_CHECKING, Any, NamedTuple

from ...display import Displayed
from ...results import FitResults
from ...tables import Text, table
from ...units import quantity
from ..diagnosis import Diagnosis
from ..fleet.entry import Entry
from ..fleet.fleet import Fleet
from ..verdict import tally

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ...report import Card, Page


class Coupled(NamedTuple):
    """Force errors of the whole robot simulated, rms per joint, N or N m.

    Attributes
    ----------
    before, after : mapping of str to float
        Without and with what was named, both fitted to the record; NaN where it diverges.
    """

    before: dict[str, float]
    after: dict[str, float]


@dataclass(frozen=True, eq=False)
class RobotDiagnosis(Displayed):
    """What a robot's model lacks, joint by joint.

    Parameters
    ----------
    name, robot : str
        Of the record and of the robot.
    joints : mapping of str to Diagnosis
    plain, fit : FitResults
        Of the robot without and with what was named.
    coupled : Coupled
        Errors of one simulation of all joints, on the hold-out if there is one.
    notes : tuple of str
    """

    name: str
    robot: str
    joints: dict[str, Diagnosis]
    plain: FitResults
    fit: FitResults
    coupled: Coupled
    notes: tuple[str, ...] = ()

    def __getitem__(self, joint: str) -> Diagnosis:
        return self.joints[joint]

    @property
    def effects(self) -> dict[str, tuple[str, ...]]:
        """What is named, by joint; joints without are left out."""
        return {name: d.effects for name, d in self.joints.items() if d.effects}

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON of ``ivtools diagnose --robot``."""
        return {
            "joints": {name: d.to_dict() for name, d in self.joints.items()},
            "coupled": {
                name: {"before": self.coupled.before[name], "after": self.coupled.after[name]}
                for name in self.coupled.before
            },
            "params": {str(k): float(v) for k, v in self.fit.params.items()},
            "notes": list(self.notes),
        }

    def summary(self) -> Text:
        """Return joints, verdicts, effects and errors as a table."""
        header = ("joint", "verdict", "effects", "unit", "by itself", "coupled")
        rows = []
        for name, d in self.joints.items():
            s = d.shrink
            own = "" if s is None else f"{s.before:.3g} -> {s.after:.3g}"
            whole = " -> ".join(f"{x[name]:.3g}" for x in self.coupled)
            unit = "" if s is None else s.unit
            rows.append((name, d.verdict, ", ".join(d.effects), unit, own, whole))
        lines = [
            "force error, rms, before -> after: of each joint by itself, and coupled, of one",
            "simulation of all",
            *wrap(
                f"before, by itself, of the force, floor included: {', '.join(self._shares())}", 78
            ),
        ]
        said = [f"{name}: {text}" for name, d in self.joints.items() for text in _said(d)]
        title = f"Diagnosis of {self.robot} on {self.name}"
        return table(title, lines, header, rows, [*self.notes, *said], left=4)

    def _shares(self) -> list[str]:
        """Return how much of its force each joint's error is, and whether that is negligible."""
        judged = [(name, d, d.shrink) for name, d in self.joints.items() if d.shrink is not None]
        return [
            f"{name} {s.of_force(s.before):.2g} %" + (f" ({d.small})" if d.small else "")
            for name, d, s in judged
        ]

    def fleet(self) -> Fleet:
        """Return the joints as the entries of a fleet."""
        entries = [Entry(n, content=d.to_dict(), diagnosis=d) for n, d in self.joints.items()]
        return Fleet(tuple(entries), self.robot)

    def plot(self, **options: Any) -> Figure:
        """Return effects by joint, and the force error of each before and after."""
        return self.fleet().plot(**options)

    def page(self) -> Page:
        """Return the overview: joints by effects."""
        from ...report import Page, Picture
        from ..page import add_joint

        out = Page(f"Diagnosis of {self.robot}", f"Joint by joint, on {self.name}.", self._card())
        caption = (
            "Effects by joint, and the force error of each joint by itself, before and "
            "after they are in the model, with its 95 % interval and the floor."
        )
        out.add("The joints at a glance", figures=[Picture("joints", self.plot(), caption)])
        out.add("Joints", tables=[self.summary()])
        for k, (name, diagnosis) in enumerate(self.joints.items(), 1):
            add_joint(out, name, diagnosis, f"joint-{k}")
        return out

    def _card(self) -> Card:
        """Return the robot in short: what is named in which joint, and what it is worth."""
        from ...report import Card
        from ..page import effects_text

        facts = [(name, text) for name, d in self.joints.items() for text in effects_text(d)]
        if not facts:
            facts = [("Effects", "none is named in any joint")]
        for name in self.effects:
            before, after = self.coupled.before[name], self.coupled.after[name]
            shrink = self.joints[name].shrink
            unit = shrink.unit if shrink is not None else ""
            facts.append(
                ("Force error, rms",
                 f"{name}, in one simulation of all: {quantity(before, unit, 3)} → "
                 f"{quantity(after, unit, 3)}")
            )  # fmt: skip
        verdicts = [d.verdict for d in self.joints.values()]
        good = {"adequate", "explained"} >= {*verdicts}
        verdict = tally("joint", verdicts)
        asked = ("Put what is named into the model of its joint.",) if self.effects else ()
        steps = (*asked, *self.notes[:4])
        return Card(verdict, tuple(facts), steps, "good" if good else "doubt")

    def __repr__(self) -> str:
        named = "; ".join(f"{n}: {', '.join(e)}" for n, e in self.effects.items()) or "none"
        return f"Diagnosis of robot {self.robot} on {self.name}: {named}"


def _said(diagnosis: Diagnosis) -> list[str]:
    """Return what is named, what has changed or is left, and the first finding."""
    named = [diagnosis.described(e) for e in diagnosis.effects]
    return [*named, *diagnosis.otherwise, *(f.text for f in diagnosis.findings[:1])]
