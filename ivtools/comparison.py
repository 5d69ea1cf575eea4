"""Comparison: several results side by side, on their record and on a hold-out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from ivtools.display import Displayed, plain
from ivtools.errors import IVToolsError
from ivtools.recommendation import Recommendation, recommend
from ivtools.tables import WIDTH, Text, rounded, table
from ivtools.transfer_table import TransferTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ivtools.estimators.transfer_results import TransferFunctionResults
    from ivtools.problem import Problem
    from ivtools.record import Record
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


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Displayed):
    """Results side by side.

    Attributes
    ----------
    frame : DataFrame
        One column per result; rows by (group, quantity): params, std_errors, relative_error,
        simulated, simulated-holdout (both in %), cost.
    results : tuple of FitResults
        What was compared.
    functions : TransferTable or None
        The transfer functions among the results: they have a table of their own.
    notes : tuple of str
        Simulations that failed.
    """

    frame: pd.DataFrame
    results: tuple[FitResults, ...]
    notes: tuple[str, ...] = ()
    functions: TransferTable | None = None

    @cached_property
    def recommendation(self) -> Recommendation | None:
        """Which result to take, and why; None if there are only transfer functions."""
        labels = list(self.frame.columns)
        return recommend(labels, self.results, [self._column(label) for label in labels])

    @property
    def best(self) -> FitResults | None:
        """The result that is recommended."""
        chosen = self.recommendation
        pairs = zip(self.frame.columns, self.results, strict=True)
        return next((fit for label, fit in pairs if chosen and label == chosen.label), None)

    def summary(self) -> Text:
        """Return tables of at most 80 columns, in blocks if there are many results.

        The recommendation is the last line.
        """
        parts = [self.functions.summary()] if self.functions is not None else []
        parts += self._blocks() if self.results else []
        return Text("\n\n".join(parts), "".join(part.html for part in parts))

    def _blocks(self) -> Iterator[Text]:
        """Yield the tables of the parameters: one if all fit beside each other, or one per model.

        A model with many results has several.
        """
        labels = list(self._headers)
        whole = self._packed(labels)
        models = [labels] if len(whole) == 1 else [list(g) for _, g in groupby(labels, self._model)]
        packed = [(group, self._packed(group)) for group in models]
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
        return model_of(dict(zip(self.frame.columns, self.results, strict=True))[label])

    @property
    def _headers(self) -> dict[str, str]:
        """Return the label of each result as the table shows it: marked if it is no estimate."""
        return {
            label: label + " !" * (not fit.converged)
            for label, fit in zip(self.frame.columns, self.results, strict=True)
        }

    def _notes(self) -> list[str]:
        """Return what stands under the last table; the recommendation ends it."""
        lost = not all(fit.converged for fit in self.results)
        return [
            "standard errors in parentheses",
            *["! has not converged: no estimates, and without standard errors"][: int(lost)],
            *self._other_signals(),
            *self.notes,
            *([str(self.recommendation)] if self.recommendation else []),
        ]

    def _marks(self) -> dict[str, str]:
        """Return the mark of each result whose relative error is not that of the force."""
        signals = dict(zip(self.frame.columns, (fit.signal for fit in self.results), strict=True))
        others = list(dict.fromkeys(s for s in signals.values() if s != "force"))
        return {k: "*" * (others.index(s) + 1) for k, s in signals.items() if s in others}

    def _other_signals(self) -> list[str]:
        """Say what the marks mean, one line for each signal."""
        signals = dict(zip(self.frame.columns, (fit.signal for fit in self.results), strict=True))
        meanings = {mark: signals[label] for label, mark in self._marks().items()}
        return [
            f"{mark} of the simulated {signal}: not to be compared with errors of the force"
            for mark, signal in meanings.items()
        ]

    def _column(self, label: str) -> dict[tuple[str, str], float]:
        """Return the figures of one result by (group, quantity)."""
        keys = self.frame.index.to_list()
        return dict(zip(keys, self.frame[label].to_numpy(dtype=float).tolist(), strict=True))

    def _rows(self, labels: Sequence[str]) -> list[list[str]]:
        """Write the rows of some of the results."""
        columns, marks = [self._column(label) for label in labels], self._marks()
        shown = [
            key
            for key in self.frame.index.to_list()
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

    def plot(self, **options: Any) -> Figure:
        """Draw the parameters with their intervals side by side, or else a transfer function."""
        from ivtools import plots

        if not self.results and self.functions is not None:
            return plots.transfer_function(self.functions.results[0], **options)
        return plots.parameters(self.results, **options)

    def to_dict(self) -> dict[str, Any]:
        """Return the content as plain objects, ready for JSON; a missing figure is None.

        What is recommended says why in ``recommended``; the others have None there.
        """
        out: dict[str, Any] = {}
        chosen = self.recommendation
        for label, fit in zip(self.frame.columns, self.results, strict=True):
            why = chosen.reason if chosen and chosen.label == label else None
            groups: dict[str, Any] = {"converged": bool(fit.converged), "recommended": why}
            for (group, quantity), value in self._column(label).items():
                groups.setdefault(group, {})[quantity] = plain(value)
            out[label] = groups
        if self.functions is not None:
            out["transfer_functions"] = self.functions.to_dict()
        return out


def compare(
    results: Sequence[FitResults | TransferFunctionResults],
    holdout: Record | Problem | None = None,
    simulate: bool = True,
) -> Comparison:
    """Set results side by side.

    Parameters
    ----------
    results : sequence of FitResults or TransferFunctionResults
        Of one record, by different methods or models; transfer functions have no physical
        parameters and make a second table.
    holdout : Record or Problem, optional
        Another record of the same axis: the parameters are tested on it, unchanged.
    simulate : bool
        Whether to simulate the closed loop with each result.

    Returns
    -------
    Comparison
        Parameters with deviations; direct, cross-test and simulated relative errors, in %;
        iterations, simulations and time.

    Raises
    ------
    IVToolsError
        If there is nothing to compare.

    Examples
    --------
    >>> import numpy as np
    >>> from ivtools.results import FitResults
    >>> X, y = np.ones((9, 1)), np.arange(9.0)
    >>> fit = FitResults.from_solution("idim-ls", [4.0], X, y, names=["offset"])
    >>> float(compare([fit]).frame.loc[("params", "offset"), "idim-ls"])
    4.0
    """
    if not results:
        raise IVToolsError("compare was given no result; give at least one FitResults")
    other: Any = holdout
    record: Record | None = getattr(other, "record", other)
    functions: list[Any] = [fit for fit in results if hasattr(fit, "poles")]
    fits: list[Any] = [fit for fit in results if not hasattr(fit, "poles")]
    notes: list[str] = []
    columns = {}
    for label, fit in zip(labels_of(fits), fits, strict=True):
        columns[label] = _figures(label, fit, record, simulate, notes)
    names = list(dict.fromkeys(name for fit in fits for name in fit.names))
    order = [(group, name) for name in names for group in ("params", "std_errors")]
    order += [key for key in LABELS if any(key in column for column in columns.values())]
    index = pd.MultiIndex.from_tuples(order or [("", "")], names=["group", "quantity"])[
        : len(order)
    ]
    data = {label: [column.get(key, np.nan) for key in order] for label, column in columns.items()}
    frame = pd.DataFrame(data, index=index, dtype=float)
    transfer = TransferTable.of(functions, record) if functions else None
    return Comparison(frame, tuple(fits), tuple(notes), transfer)


def _figures(
    label: str, fit: FitResults, holdout: Record | None, simulate: bool, notes: list[str]
) -> dict[tuple[str, str], float]:
    """Return every figure of one result by (group, quantity)."""
    figures = {("params", str(k)): float(v) for k, v in fit.params.items()}
    figures |= {("std_errors", str(k)): float(v) for k, v in fit.std_errors.items()}
    figures["relative_error", "direct"] = fit.relative_error
    if fit.problem is not None:
        cases = {"simulated": fit.problem}
        if holdout is not None:
            cases["simulated-holdout"] = fit.problem_of(holdout)
            test = fit.cross_test(cases["simulated-holdout"])
            figures["relative_error", "cross-test"] = test.relative
        for group, problem in cases.items() if simulate else ():
            errors = _simulated_errors(f"{label}, {group}", fit, problem, notes)
            figures |= {(group, signal): errors[signal] for signal in SIGNALS if signal in errors}
    figures["cost", "iterations"] = fit.n_iter
    figures["cost", "simulations"] = fit.n_simulations
    figures["cost", "time_ms"] = 1e3 * fit.runtime
    return figures


def _simulated_errors(
    what: str, fit: FitResults, problem: Problem, notes: list[str]
) -> dict[str, float]:
    """Simulate the closed loop; a simulation that fails is a note, not an end."""
    try:
        simulation = problem.simulate(fit.params)
        return simulation.relative_error(problem.record, problem.pipeline)
    except IVToolsError as error:
        notes.append(f"{what}: {error}")
        return {}


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


def _cell(column: dict[tuple[str, str], float], key: tuple[str, str]) -> str:
    """Write one figure, a parameter with its standard error and to the digits of that."""
    value, (group, quantity) = column[key], key
    if not np.isfinite(value):
        return "-"
    if group == "params":
        shown, error = rounded(value, column["std_errors", quantity], digits=2)
        return f"{shown} ({error})"
    return f"{value:.0f}" if quantity in ("iterations", "simulations") else f"{value:.4g}"
