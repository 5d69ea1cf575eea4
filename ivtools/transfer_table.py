"""TransferTable: transfer functions of one record side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from ivtools.display import Displayed
from ivtools.errors import IVToolsError
from ivtools.tables import Text, table

if TYPE_CHECKING:
    from ivtools.estimators.transfer_results import TransferFunctionResults
    from ivtools.record import Record

NOTE = (
    "free run from the input, without a controller; R_T^2 near 1 and a small YIC are good; "
    "poles in rad/s; a transfer function has no dry friction, and that from the reference is one "
    "of the whole loop"
)


@dataclass(frozen=True, eq=False, repr=False)
class TransferTable(Displayed):
    """Transfer functions side by side.

    Attributes
    ----------
    results : tuple of TransferFunctionResults
    holdout : tuple of float
        Relative error of each on the hold-out, in %; NaN without one.
    notes : tuple of str
        Hold-outs that failed.
    """

    results: tuple[TransferFunctionResults, ...]
    holdout: tuple[float, ...]
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, results: Sequence[TransferFunctionResults], holdout: Record | None = None
    ) -> TransferTable:
        """Measure every transfer function on the hold-out."""
        errors, notes = [], []
        for fit in results:
            try:
                errors.append(math.nan if holdout is None else fit.cross_test(holdout))
            except IVToolsError as error:
                errors.append(math.nan)
                notes.append(f"{fit.method} {case_of(fit)}, hold-out: {error}")
        return cls(tuple(results), tuple(errors), tuple(notes))

    def frame(self) -> pd.DataFrame:
        """Return one row per transfer function."""
        rows = [
            {
                "method": fit.method,
                "case": case_of(fit),
                "poles": fit.estimator.poles,
                "zeros": fit.estimator.zeros,
                "integrators": fit.estimator.integrators,
                "relative_error": fit.relative_error,
                "holdout_error": error,
                "r2": fit.r2,
                "yic": fit.yic,
                "pole_values": shown_poles(fit.poles),
                "converged": fit.converged,
                "runtime": fit.runtime,
            }
            for fit, error in zip(self.results, self.holdout, strict=True)
        ]
        return pd.DataFrame(rows)

    def summary(self) -> Text:
        """Return a table of at most 80 columns."""
        tested = any(map(math.isfinite, self.holdout))
        header = ["method", "from, to", "orders", "error, %", "R_T^2", "YIC", "poles"]
        rows = [
            [
                fit.method + "*" * (not fit.converged),
                case_of(fit),
                "/".join(map(str, orders(fit))),
                f"{fit.relative_error:.4g}",
                f"{fit.r2:.4f}",
                f"{fit.yic:.2f}",
                _cut(shown_poles(fit.poles)),
            ]
            for fit in self.results
        ]
        if tested:
            header.insert(4, "hold-out")
            for row, error in zip(rows, self.holdout, strict=True):
                row.insert(4, f"{error:.4g}" if math.isfinite(error) else "-")
        notes = ["orders: poles/zeros/integrators", NOTE, *self.notes]
        if not all(fit.converged for fit in self.results):
            notes.insert(0, "* has not converged")
        return table("Transfer functions", [], header, rows, notes, left=3)

    def to_dict(self) -> list[dict[str, Any]]:
        """Return the content as plain objects, ready for JSON."""
        return [
            {**fit.to_dict(), "holdout_error": error if math.isfinite(error) else None}
            for fit, error in zip(self.results, self.holdout, strict=True)
        ]

    def best(self) -> tuple[TransferFunctionResults, ...]:
        """Return the one with the least error of each case."""
        found: dict[str, TransferFunctionResults] = {}
        for fit in self.results:
            case = case_of(fit)
            if case not in found or fit.relative_error < found[case].relative_error:
                found[case] = fit
        return tuple(found.values())


def case_of(fit: TransferFunctionResults) -> str:
    """Return input and output, such as ``nu, q``."""
    return f"{fit.estimator.input}, {fit.estimator.output}"


def orders(fit: TransferFunctionResults) -> tuple[int, int, int]:
    """Return the numbers of poles, zeros and integrators."""
    return fit.estimator.poles, fit.estimator.zeros, fit.estimator.integrators


def shown_poles(poles: Sequence[complex] | np.ndarray) -> str:
    """Write poles, a pair only once.

    Examples
    --------
    >>> shown_poles([-51.0 + 114.0j, -51.0 - 114.0j, 0.0])
    '-51+-114j 0'
    """
    cells = []
    for pole in np.asarray(poles, dtype=complex):
        if abs(pole.imag) <= 1e-9 * abs(pole):
            cells.append(f"{pole.real + 0.0:.3g}")
        elif pole.imag > 0.0:
            cells.append(f"{pole.real:.3g}+-{pole.imag:.3g}j")
    return " ".join(cells)


def _cut(text: str, width: int = 18) -> str:
    """Shorten what no table holds."""
    return text if len(text) <= width else text[: width - 1] + "~"
