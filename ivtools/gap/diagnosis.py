"""Diagnosis: the answer, for people and for programs."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..loop import ClosedLoop
from ..tables import Text, table
from .attribute import Evidence
from .floor import Floor
from .locate import Region
from .parity import Parity
from .preflight import Finding
from .quantify import Shrink, Traces
from .rules import CORRECTED, NOTHING_ALONE
from .verdict import VERDICTS, Ranked, Replica

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..report import Page
    from ..simulators.mjcf_export import Export
    from .against import Change

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Diagnosis:
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
    """

    verdict: str
    effects: tuple[str, ...]
    ambiguous_with: dict[str, list[str]]
    parameters: dict[str, dict[str, float]]
    block: str | None
    regions: tuple[Region, ...]
    shrink: Shrink | None
    ranking: tuple[Ranked, ...]
    advice: tuple[str, ...]
    findings: tuple[Finding, ...]
    parity: tuple[Parity, ...]
    floors: tuple[Floor, ...]
    loop: ClosedLoop
    theta: dict[str, float]
    chi: tuple[float, float]
    name: str
    replication: dict[str, tuple[float, float]] = field(default_factory=dict)
    replicas: tuple[Replica, ...] = ()
    evidence: dict[str, Evidence] = field(default_factory=dict)
    probability: dict[str, float] = field(default_factory=dict)
    traces: Traces | None = None
    changes: dict[str, Change] | None = None
    surplus: tuple[str, ...] = ()

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
            "shrink": None if self.shrink is None else self.shrink.to_dict(),
            "ranking": [r.to_dict() for r in self.ranking],
            "advice": list(self.advice),
            "findings": [f.text for f in self.findings],
            "gap": {"before": _number(self.chi[0]), "after": _number(self.chi[1])},
            "replication": {k: list(v) for k, v in self.replication.items()},
            "replicates": {r.effect: r.to_dict() for r in self.replicas},
            "probability": dict(self.probability),
            "evidence": {n: e.to_dict() for n, e in self.evidence.items()},
            "theta": dict(self.theta),
            "changes": None
            if self.changes is None
            else {name: change.to_dict() for name, change in self.changes.items()},
            "surplus": list(self.surplus),
        }

    def summary(self) -> Text:
        """Return the answer as a table."""
        header = ("effect", "closes alone", "p value", "named")
        rows = [
            (
                r.effect,
                f"{100 * r.closed:.0f} %",
                r.chance,
                "yes" if r.effect in self.effects else "replicates" if r.replicates else "",
            )
            for r in self.ranking[:8]
        ]
        name = self.name if len(self.name) <= 60 else f"{self.name[:30]}~{self.name[-29:]}"
        return table(f"Diagnosis of {name}", self._lines(), header, rows, self._notes())

    def _lines(self) -> list[str]:
        lines = [f"verdict: {self.verdict} ({VERDICTS[self.verdict]})"]
        for effect in self.effects:
            values = ", ".join(f"{k} {v:.4g}" for k, v in self.parameters.get(effect, {}).items())
            twins = self.ambiguous_with.get(effect, [])
            other = f"; not told from {', '.join(twins)}" if twins else ""
            chance = f" ({100 * self.probability[effect]:.0f} % sure)"
            lines += _wrapped(f"{effect}{chance}: {values}{other}", "  ")
            for replica in (r for r in self.replicas if r.effect == effect):
                lines += _wrapped(f"  {replica.short}", "    ")
        if self.block:
            lines.append(f"block: {self.block}")
        if self.shrink:
            s = self.shrink
            lines += _wrapped(
                f"force error: {s.before:.3g} -> {s.after:.3g} {s.unit} "
                f"[{s.interval[0]:.3g}, {s.interval[1]:.3g}], floor {s.floor:.3g}, "
                f"closed {100 * s.closed:.0f} %",
                "  ",
            )
            if s.corrected < CORRECTED * s.before:
                lines.append(f"  of which the controller, put right: {s.corrected:.3g} {s.unit}")
        return lines

    def _notes(self) -> list[str]:
        together = [f"only beside the others does {e} show" for e in self.beside]
        return [*(f.text for f in self.findings), *together, *self.advice]

    @property
    def beside(self) -> tuple[str, ...]:
        """Named effects that close next to nothing alone, and show once others are in the model."""
        alone = {r.effect: r.closed for r in self.ranking}
        return tuple(e for e in self.effects if alone.get(e, 1.0) < NOTHING_ALONE)

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
        base = {name for term in self.loop.terms if term.base for name in term.names}
        changes = {name: c.change for name, c in self.changes.items() if name in base}
        values = {name: c.real - c.simulator for name, c in self.changes.items()}
        return export(path, joint, self.loop, values, actuator=actuator, changes=changes)

    def plot(self) -> Figure:
        """Return the figure that shows the answer."""
        from ..plots.gap import gap

        return gap(self)

    def page(self) -> Page:
        """Return the answer as a page, with figures."""
        from .page import page

        return page(self)

    def to_html(self, path: str | Path) -> Path:
        """Write one self-contained page."""
        return self.page().write(path)

    def _repr_html_(self) -> str:
        return self.summary().html

    def __repr__(self) -> str:
        named = ", ".join(self.effects) or "none"
        return f"Diagnosis of {self.name}: {self.verdict}, effects: {named}"


def _number(x: float) -> float | None:
    """Return a number that JSON knows."""
    return float(x) if np.isfinite(x) else None


def _wrapped(text: str, indent: str) -> list[str]:
    """Break a line, but not the names of effects."""
    return wrap(text, 78, subsequent_indent=indent, break_on_hyphens=False)
