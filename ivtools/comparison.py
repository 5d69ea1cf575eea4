"""Comparison: several results side by side, on their record and on a hold-out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from ivtools.comparison_table import LABELS, SIGNALS, ComparisonTable, labels_of
from ivtools.display import Displayed, plain
from ivtools.errors import IVToolsError
from ivtools.recommendation import Recommendation, recommend
from ivtools.tables import Text
from ivtools.transfer_table import TransferTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ivtools.estimators.transfer_results import TransferFunctionResults
    from ivtools.problem import Problem
    from ivtools.record import Record
    from ivtools.results import FitResults


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
        columns = {label: self._column(label) for label in self.frame.columns}
        tables = ComparisonTable(columns, self.results, self.notes, self.recommendation)
        wide = [*parts, *(tables.blocks(wide=True) if self.results else ())]
        parts += tables.blocks() if self.results else []
        return Text("\n\n".join(parts), "".join(part.html for part in wide))

    def _column(self, label: str) -> dict[tuple[str, str], float]:
        """Return the figures of one result by (group, quantity)."""
        keys = self.frame.index.to_list()
        return dict(zip(keys, self.frame[label].to_numpy(dtype=float).tolist(), strict=True))

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
            for group in ("simulated", "simulated-holdout"):
                if reasons := self._reasons(label, group):
                    groups[group] = {**groups.get(group, {}), "reason": reasons}
            out[label] = groups
        if self.functions is not None:
            out["transfer_functions"] = self.functions.to_dict()
        return out

    def _reasons(self, label: str, group: str) -> str:
        """Return why a simulation has no figures; empty if it has."""
        head = f"{label}, {group}: "
        failed = [note.removeprefix(head) for note in self.notes if note.startswith(head)]
        lost = [s for s in SIGNALS if not np.isfinite(self._column(label).get((group, s), 0.0))]
        if failed or not lost:
            return "; ".join(failed)
        return f"the {', '.join(lost)} cannot be compared: what was measured is 0 throughout"


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
