"""Diagnosis: the answer, for people and for programs."""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..display import Displayed, plain
from ..loop import ClosedLoop
from ..tables import Text, table
from ..units import percent, quantity, setting
from .attribute import Evidence, Supposed
from .discrepancy import Discrepancy
from .fit import Fit
from .floor import Floor
from .locate import Region
from .parity import Parity, unit
from .preflight import Finding
from .quantify import Shrink, Traces
from .rules import LITTLE, NEARLY_ALL, TOLERANCE
from .verdict import SCREENED, VERDICTS, Ranked, Replica, Setting

if TYPE_CHECKING:
    from ..report import Page
    from ..simulators.mjcf_export import Export
    from .simulator import Change, Confirmation

Array = NDArray[np.float64]

_LISTED = 8  # effects of the ranking, in a table


@dataclass(frozen=True, eq=False, kw_only=True)
class Diagnosis(Displayed):
    """What a model lacks to be the twin of a measured axis.

    Parameters
    ----------
    verdict : str
        A key of `VERDICTS`.
    effects : tuple of str
        What is named.
    ambiguous_with : mapping
        Per named effect, those that the data cannot tell from it.
    parameters : mapping
        Per named effect, its parameters.
    block : str or None
        Block of the loop that it points to.
    regions : tuple of Region
        Where the gap sits.
    shrink : Shrink or None
        How far it closes; None if the record does not allow a comparison.
    ranking : tuple of Ranked
    advice : tuple of str
    findings : tuple of Finding
        What a person must look at in the record or the axis file.
    parity, floors
        Of each record.
    loop : ClosedLoop
        The loop with the named effects.
    theta : mapping
        Its parameters.
    chi : tuple of float
        Mean square of the whitened error before and after; 1 is the floor.
    replication : mapping
        Per parameter of a named effect, its value on either side.
    replicas : tuple of Replica
        Per named effect, whether the sides agree.
    evidence : mapping
        Per named effect behind the controller, what speaks for it.
    probability : mapping
        Per named effect, how likely it, or one that it is not told from, is right, as far as the
        cause is one of the known effects.
    changes : mapping of str to Change, or None
        With a simulator's log: each parameter there, on the axis, and the change to make.
    surplus : tuple of str
        Named effects that the simulator has and the axis has not.
    confirmed : Confirmation or None
        With a simulator that can be run: its errors as it is, and with the changes.
    changed : mapping
        Base parameters that differ between the records, by name.
    discrepancy : Discrepancy or None
        A force that is left, comes again, and is not among the known effects.
    tolerance : float
        Per cent of the force below which a gap is negligible.
    whole : Fit or None
        The final model on all of the record, where that was asked for.
    alternatives : tuple of mapping
        Its parameters as each effect would have them that helps and has no name.
    supposed : Supposed or None
        An effect that removes most of the gap and yet has no name, where nothing has one.
    places : mapping
        Where the valleys of effects were found, if one of them got a name: their parameters.
    """

    figure: ClassVar[str] = "gap.gap"

    verdict: str
    effects: tuple[str, ...]
    ambiguous_with: dict[str, list[str]]
    parameters: dict[str, dict[str, float]]
    block: str | None
    regions: tuple[Region, ...] = ()
    shrink: Shrink | None = None
    ranking: tuple[Ranked, ...] = ()
    advice: tuple[str, ...] = ()
    findings: tuple[Finding, ...]
    parity: tuple[Parity, ...]
    floors: tuple[Floor, ...] = ()
    loop: ClosedLoop
    theta: dict[str, float] = field(default_factory=dict)
    chi: tuple[float, float] = (float("nan"), float("nan"))
    name: str
    replication: dict[str, tuple[float, float]] = field(default_factory=dict)
    replicas: tuple[Replica, ...] = ()
    evidence: dict[str, Evidence] = field(default_factory=dict)
    probability: dict[str, float] = field(default_factory=dict)
    traces: Traces | None = None
    changes: dict[str, Change] | None = None
    surplus: tuple[str, ...] = ()
    changed: dict[str, Setting] = field(default_factory=dict)
    discrepancy: Discrepancy | None = None
    tolerance: float = TOLERANCE
    confirmed: Confirmation | None = None
    whole: Fit | None = None
    alternatives: tuple[dict[str, float], ...] = ()
    supposed: Supposed | None = None
    places: dict[str, dict[str, float]] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON of ``ivtools diagnose``."""
        return {
            "verdict": self.verdict,
            "effects": list(self.effects),
            "ambiguous_with": {k: list(v) for k, v in self.ambiguous_with.items()},
            "parameters": self.parameters,
            "where": {
                "block": self.block,
                "regions": [r.to_dict() for r in self.regions],
                "events": [list(e) for f in self.floors for e in f.events],
            },
            "shrink": None if self.shrink is None else plain(self.shrink.to_dict()),
            "ranking": [r.to_dict() for r in self.ranking],
            "advice": list(self.advice),
            "findings": [f.text for f in self.findings],
            "gap": plain(self._gap()),
            "whitened": {"before": plain(self.chi[0]), "after": plain(self.chi[1])},
            "changed": {n: c.to_dict() for n, c in self.changed.items()},
            "discrepancy": None if self.discrepancy is None else self.discrepancy.to_dict(),
            "replication": {k: list(v) for k, v in self.replication.items()},
            "replicates": {r.effect: r.to_dict() for r in self.replicas},
            "probability": dict(self.probability),
            "evidence": {n: e.to_dict() for n, e in self.evidence.items()},
            "theta": dict(self.theta),
            "changes": None
            if self.changes is None
            else {name: change.to_dict() for name, change in self.changes.items()},
            "surplus": list(self.surplus),
            "confirmed": None if self.confirmed is None else self.confirmed.to_dict(),
        }

    def summary(self) -> Text:
        """Return the answer as a table."""
        header = ("effect", "closes by itself", "p value", "named")
        rows = [
            (
                r.effect,
                f"{100 * r.closed:.0f} %",
                self.p_value(r),
                "yes" if r.effect in self.effects else "replicates" if r.replicates else "",
            )
            for r in self.first
        ]
        notes = [SCREENED] if any(not r.held_out for r in self.first) else []
        name = self.name if len(self.name) <= 60 else f"{self.name[:30]}~{self.name[-29:]}"
        return table(f"Diagnosis of {name}", self._lines(), header, rows, [*notes, *self._notes()])

    def _gap(self) -> dict[str, float | str] | None:
        """Return the gap in units of force and in per cent of it."""
        s = self.shrink
        if s is None:
            return None
        return {
            "before": s.before,
            "after": s.after,
            "unit": s.unit,
            "percent_of_force": s.of_force(s.before),
            "percent_after": s.of_force(s.after),
        }

    def value(self, effect: str, parameter: str) -> str:
        """Return a parameter of a named effect with its unit."""
        value, known = self.parameters[effect][parameter], self.loop.parameters
        if effect == "controller-mismatch":
            return setting(value, unit(self.parity, parameter))
        name = f"{effect}.{parameter}"
        si = known[name].unit_for(self.loop.joint) if name in known else ""
        return quantity(value, si.removeprefix("1"))

    @property
    def size(self) -> str:
        """How large the gap is, in words."""
        s = self.shrink
        if s is None:
            return ""
        if s.diverges:
            return "the simulation diverges"
        text = f"{s.shown(s.before)} rms, {percent(s.before / s.force)} of the force"
        if not (small := self.small):
            return text
        above = "" if s.before < 0.01 * self.tolerance * s.force else " above the floor"
        return f"{small}{above}: {text}, floor included"

    @property
    def negligible(self) -> bool:
        """Whether the gap is below the tolerance, and no setting has changed."""
        s = self.shrink
        return s is not None and not self.changed and s.gap < 0.01 * self.tolerance * s.force

    @property
    def small(self) -> str:
        """That the gap is negligible, in words; an empty text if it is not.

        Of one that no effect explains, where it is that: the other record has it, or stretches that
        are left out of its figures.
        """
        if self.shrink is None or not self.negligible:
            return ""
        if self.verdict == "non-repeatable":
            return "but for stretches that stand out, negligible"
        elsewhere = self.verdict == "unexplained" and self.shrink.held_out
        return "on the hold-out negligible" if elsewhere else "negligible"

    @property
    def why(self) -> str:
        """The verdict in words, with what speaks against it."""
        s = self.shrink
        if s is None:
            return "nothing was simulated"
        said = VERDICTS[self.verdict]
        if self.verdict == "non-repeatable" and self.changed:
            said = f"between the records, {' and '.join(self.changed)} changed"
        if self.verdict == "explained" and s.closed < NEARLY_ALL:
            left = f"{percent(s.remainder / s.force)} of the force"
            said = f"the named effects close the gap to {left} above the floor, which is negligible"
        if self.effects and not s.interval_frozen[0] <= s.before:
            said += "; with the first record's base parameters the error is larger than before"
        if s.judged is not None and not s.judged.interval[0] <= s.judged.before:
            said += f"; on {s.judged.record}, which only judges, the error is larger than before"
        return said

    def _lines(self) -> list[str]:
        lines = _wrapped(f"verdict: {self.verdict} ({self.why})", "  ")
        if self.size:
            lines += _wrapped(f"gap: {self.size}", "  ")
        for effect in self.effects:
            lines += _wrapped(self.described(effect), "  ")
            for replica in (r for r in self.replicas if r.effect == effect):
                lines += _wrapped(f"  {replica.short}", "    ")
        for text in self.otherwise:
            lines += _wrapped(text, "  ")
        if self.block:
            lines.append(f"block of the loop: {self.block}")
        return [*lines, *self._figures()]

    def chance(self, effect: str) -> str:
        """Return how likely a name is, in brackets; nothing where no simulation tells."""
        likely = self.probability.get(effect)
        return "" if likely is None else f" ({100 * likely:.0f} % likely)"

    def described(self, effect: str) -> str:
        """Return a named effect with its values, how likely it is, and what it may be as well."""
        own = self.parameters.get(effect, {})  # without a spring or a delay that is none
        shown = {k: v for k, v in own.items() if v != 0.0} or own
        values = ", ".join(f"{k} {self.value(effect, k)}" for k in shown)
        twins = self.ambiguous_with.get(effect, [])
        other = f"; the records cannot tell it from {' or '.join(twins)}" if twins else ""
        return f"{effect}{self.chance(effect)}: {values}{other}"

    @property
    def otherwise(self) -> list[str]:
        """What has changed between the records, and what is left without a name, in sentences."""
        said = [change.said(name) for name, change in self.changed.items()]
        if (left := self.nameless) is None:
            return said
        s = self.shrink
        parts = s is not None and s.held_out and s.shown(left.before) != s.shown(s.after)
        where = ", where both records have been" * parts
        return [*said, f"left: {left.text}{where}"]

    @property
    def nameless(self) -> Discrepancy | None:
        """The force without a name; None of an adequate model, which lacks too little."""
        return None if self.verdict == "adequate" else self.discrepancy

    def _figures(self) -> list[str]:
        """Return the force errors before and after."""
        s = self.shrink
        if s is None:
            return []
        text = s.shown(s.after, s.interval)
        if self.effects or s.shown(s.before) != s.shown(s.after):
            text = f"{s.shown(s.before)} -> {text}"
        text = f"force error: {text}; floor, which no model could go below: {s.shown(s.floor)}"
        if self.effects and s.shown(s.before) != s.shown(s.after):
            text += f"; closed {round(100 * s.closed)} % of what is above it"
        lines = _wrapped(text, "  ")
        if s.put_right:
            lines.append(f"  of which the controller, put right: {s.shown(s.corrected)}")
        if s.held_out:
            frozen = s.shown(s.after_frozen, s.interval_frozen)
            lines.append(f"  with the first record's base parameters: {frozen}")
        if s.judged is not None:
            lines += _wrapped(s.judged.said(s.unit), "  ")
        return lines

    def _notes(self) -> list[str]:
        shown = [] if self.confirmed is None else [self.confirmed.text]
        return [*(f.text for f in self.findings), *shown, *self.said_of_beside, *self.advice]

    @property
    def beside(self) -> tuple[str, ...]:
        """Named effects that close next to nothing by themselves."""
        alone = {r.effect: r.closed for r in self.ranking}
        return tuple(e for e in self.effects if alone.get(e, 1.0) < LITTLE)

    @property
    def later(self) -> tuple[str, ...]:
        """Named effects whose p value, of each by itself, tells nothing: they show later."""
        fitted = {r.effect for r in self.ranking if r.held_out}
        return tuple(e for e in self.effects if e in self.beside or e not in fitted)

    @property
    def first(self) -> tuple[Ranked, ...]:
        """The first of the ranking: what tables show."""
        return self.ranking[:_LISTED]

    def p_value(self, ranked: Ranked) -> str:
        """Return a p value of the ranking as it is printed."""
        return "-" if ranked.effect in self.later else ranked.chance

    @property
    def said_of_beside(self) -> list[str]:
        """What to say of these."""
        return [f"{e} shows only once the other effects are in the model" for e in self.beside]

    @property
    def edits(self) -> dict[str, float]:
        """What to add to each parameter of the simulator.

        Too much of an effect is taken away: what it is linear in turns its sign, its shape stays.
        """
        linear = {name for term in self.loop.terms for name in term.linear}
        return {
            name: c.change if name in linear or not self.surplus else c.simulator
            for name, c in (self.changes or {}).items()
        }

    def to_mjcf(self, path: str | Path, joint: str, actuator: str | None = None) -> Export:
        """Write what was found into a MuJoCo model.

        Parameters
        ----------
        path : str or Path
            The model; it is read, not changed.
        joint : str
        actuator : str, optional
            Default: the only one that drives the joint.

        Returns
        -------
        Export
            The new model, and what it cannot hold.

        Raises
        ------
        AxisError
            The model lacks the joint or actuator.
        MissingExtraError
            MuJoCo is not installed.
        """
        from ..simulators.mjcf_export import export

        if self.changes is None:
            return export(path, joint, self.loop, self.theta, actuator=actuator)
        terms = tuple(t for t in self.loop.terms if {*t.names} & {*self.changes})
        base = {name for t in terms if t.name not in self.effects for name in t.names}
        changes = {name: c.change for name, c in self.changes.items() if name in base}
        start = {n: v for n, v in self.loop.start.items() if n in self.changes}
        return export(
            path,
            joint,
            replace(self.loop, terms=terms, start=start),
            self.edits,
            actuator=actuator,
            changes=changes,
            surplus=self.surplus,
        )

    def page(self) -> Page:
        """Return the answer as a page, with figures."""
        from .page import page

        return page(self)

    def __repr__(self) -> str:
        named = ", ".join(self.effects) or "none"
        return f"Diagnosis of {self.name}: {self.verdict}, effects: {named}"


def _wrapped(text: str, indent: str) -> list[str]:
    """Break a line, but not the names of effects, nor between a number and its unit."""
    text = re.sub(r"(?<=[0-9]) (?=[a-zA-Zµ%])", "\N{NO-BREAK SPACE}", text)
    lines = wrap(text, 78, subsequent_indent=indent, break_on_hyphens=False)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]
