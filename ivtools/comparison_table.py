"""ComparisonTable: results side by side as text of at most 80 columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from ivtools.tables import WIDTH, Text, rounded, table

if TYPE_CHECKING:
    from ivtools.recommendation import Recommendation
    from ivtools.results import FitResults

SIGNALS = ("position", "velocity", "acceleration", "force")
LABELS = {
    ("relative_error", "direct"): "relative error, %",
    ("relative_error", "cross-test"): "cross-test error, %",
    ("cost", "iterations"): "iterations",
    ("cost", "simulations"): "simulations",
    ("cost", "time_ms"): "time, ms",
    **{("simulated", s): f"simulated {s}, %" for s in SIGNALS},
    **{("simulated-holdout", s): f"hold-out {s}, %" for s in SIGNALS},
}


@dataclass(frozen=True)
class ComparisonTable:
    """The tables of a comparison.

    Attributes
    ----------
    columns : mapping
        Figures of each result by its label, each by (group, quantity).
    results : tuple of FitResults
        In the same order.
    remarks : tuple of str
        Simulations that failed.
    recommendation : Recommendation or None
        What the last table ends with.
    """

    columns: Mapping[str, Mapping[tuple[str, str], float]]
    results: tuple[FitResults, ...]
    remarks: tuple[str, ...]
    recommendation: Recommendation | None

    def blocks(self, wide: bool = False) -> Iterator[Text]:
        """Yield the tables of the parameters: one if all fit beside each other, or one per model.

        A model with many results has several, unless there is room for `wide` ones.
        """
        labels = list(self._headers)
        whole = self._packed(labels)
        models = [labels] if len(whole) == 1 else [list(g) for _, g in groupby(labels, self._model)]
        packed = [(group, [group] if wide else self._packed(group)) for group in models]
        for group, blocks in packed:
            for k, block in enumerate(blocks):
                title = _title(self._model(group[0]), len(models) > 1, k, len(blocks))
                notes = self._notes() if block[-1] == labels[-1] else []
                header = ["", *(self._headers[label] for label in block)]
                yield table(title, [], header, self._rows(block), notes)

    def _packed(self, labels: Sequence[str]) -> list[list[str]]:
        """Return as many of the results per table as 80 columns hold."""
        rows = [["", *(self._headers[label] for label in labels)], *self._rows(labels)]
        first, *widths = (max(map(len, column)) for column in zip(*rows, strict=True))
        blocks: list[list[str]] = []
        used = WIDTH
        for label, width in zip(labels, widths, strict=True):
            if not blocks or used + 2 + width > WIDTH:
                blocks.append([])
                used = first
            blocks[-1].append(label)
            used += 2 + width
        return blocks

    def _model(self, label: str) -> str:
        """Return the friction model of a result in words."""
        return model_of(dict(zip(self.columns, self.results, strict=True))[label])

    @property
    def _headers(self) -> dict[str, str]:
        """Return the label of each result as the table shows it: marked if it is no estimate."""
        return {
            label: label + " !" * (not fit.converged)
            for label, fit in zip(self.columns, self.results, strict=True)
        }

    def _notes(self) -> list[str]:
        """Return what stands under the last table; the recommendation ends it."""
        lost = not all(fit.converged for fit in self.results)
        return [
            "standard errors in parentheses",
            *["! has not converged: no estimates, and without standard errors"][: int(lost)],
            *self._other_signals(),
            *self.remarks,
            *([str(self.recommendation)] if self.recommendation else []),
        ]

    def _marks(self) -> dict[str, str]:
        """Return the mark of each result whose relative error is not that of the force."""
        signals = dict(zip(self.columns, (fit.signal for fit in self.results), strict=True))
        others = list(dict.fromkeys(s for s in signals.values() if s != "force"))
        return {k: "*" * (others.index(s) + 1) for k, s in signals.items() if s in others}

    def _other_signals(self) -> list[str]:
        """Say what the marks mean, one line for each signal."""
        signals = dict(zip(self.columns, (fit.signal for fit in self.results), strict=True))
        meanings = {mark: signals[label] for label, mark in self._marks().items()}
        return [
            f"{mark} of the simulated {signal}: not to be compared with errors of the force"
            for mark, signal in meanings.items()
        ]

    def _rows(self, labels: Sequence[str]) -> list[list[str]]:
        """Write the rows of some of the results."""
        columns, marks = [self.columns[label] for label in labels], self._marks()
        shown = [
            key
            for key in next(iter(self.columns.values()))
            if key[0] != "std_errors" and any(np.isfinite(column[key]) for column in columns)
        ]
        direct = ("relative_error", "direct")
        return [
            [
                LABELS.get(key) or self._with_unit(key[1]),
                *(
                    _cell(column, key) + (marks.get(label, "") if key == direct else "")
                    for label, column in zip(labels, columns, strict=True)
                ),
            ]
            for key in shown
        ]

    def _with_unit(self, name: str) -> str:
        """Write a parameter with its unit, such as ``inertia, kg``."""
        known = (dict(zip(fit.names, fit.units, strict=False)) for fit in self.results)
        unit = next((units[name] for units in known if units.get(name)), "")
        return f"{name}, {unit}" if unit else name


def labels_of(results: Sequence[FitResults]) -> list[str]:
    """Return one label per result: the method, with its friction model where models differ."""
    mixed = len({fit.names for fit in results}) > 1
    seen: dict[str, int] = {}
    labels = []
    for fit in results:
        label = f"{fit.method} {_short(fit) if mixed else ''}".rstrip()
        seen[label] = count = seen.get(label, 0) + 1
        labels.append(label if count == 1 else f"{label} #{count}")
    return labels


def model_of(fit: FitResults) -> str:
    """Return the friction model of a result in words, such as ``asymmetric friction, stribeck``."""
    kind = "asymmetric" if "viscous_pos" in fit.names else "symmetric"
    return ", ".join([f"{kind} friction", *_more(fit)])


def _short(fit: FitResults) -> str:
    """Return the model for a label: nothing for the plain symmetric one."""
    return " ".join([*["asym."] * ("viscous_pos" in fit.names), *(f"+{m}" for m in _more(fit))])


def _more(fit: FitResults) -> list[str]:
    """Return the terms beside inertia, friction by direction and offset."""
    plain_terms = ("inertia", "offset", "viscous", "coulomb")
    terms = (name.split(".")[0] for name in fit.names if not name.startswith(plain_terms))
    return list(dict.fromkeys(terms))


def _title(model: str, mixed: bool, block: int, blocks: int) -> str:
    """Return the title of a table; no two tables of a comparison have the same."""
    name = f"Comparison, {model}" if mixed else "Comparison"
    return f"{name} ({block + 1} of {blocks})" if blocks > 1 else name


def _cell(column: Mapping[tuple[str, str], float], key: tuple[str, str]) -> str:
    """Write one figure, a parameter with its standard error and to the digits of that."""
    value, (group, quantity) = column[key], key
    if not np.isfinite(value):
        return "-"
    if group == "params":
        shown, error = rounded(value, column["std_errors", quantity], digits=2)
        return f"{shown} ({error})"
    return f"{value:.0f}" if quantity in ("iterations", "simulations") else f"{value:.4g}"
