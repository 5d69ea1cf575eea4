"""Structure search: which orders of a transfer function a record supports."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any, ClassVar

import pandas as pd

from ivtools.display import Displayed
from ivtools.errors import ConvergenceWarning, EstimationError
from ivtools.estimators.transfer_function import SRIVC
from ivtools.estimators.transfer_results import TransferFunctionResults
from ivtools.tables import Text, dashed, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ivtools.problem import Problem

CRITERIA = ("yic", "aic", "bic", "relative_error")


@dataclass(frozen=True, eq=False, repr=False)
class StructureSearch(Displayed):
    """Transfer functions of several structures, the best first.

    Attributes
    ----------
    results : tuple of TransferFunctionResults
        In the order of the criterion; those that have not converged come last.
    criterion : str
    notes : tuple of str
        Structures that could not be estimated.
    """

    content: ClassVar[tuple[str, ...]] = ("criterion", "results", "notes")

    results: tuple[TransferFunctionResults, ...]
    criterion: str
    notes: tuple[str, ...] = ()

    @property
    def best(self) -> TransferFunctionResults:
        """The first one."""
        return self.results[0]

    def frame(self) -> pd.DataFrame:
        """Return one row per structure."""
        return pd.DataFrame(
            [
                {
                    "poles": fit.estimator.poles,
                    "zeros": fit.estimator.zeros,
                    "integrators": fit.estimator.integrators,
                    "relative_error": fit.relative_error,
                    "r2": fit.r2,
                    "yic": fit.yic,
                    "aic": fit.aic,
                    "bic": fit.bic,
                    "converged": fit.converged,
                }
                for fit in self.results
            ]
        )

    def summary(self) -> Text:
        """Return a table of at most 80 columns."""
        header = ["poles zeros integrators", "rel. error, %", "R_T^2", "YIC", "AIC", "BIC", "conv."]
        rows = [
            [
                f"{fit.estimator.poles} {fit.estimator.zeros} {fit.estimator.integrators}",
                f"{fit.relative_error:.4g}",
                f"{fit.r2:.4f}",
                f"{fit.yic:.2f}",
                dashed(fit.aic, ".0f"),
                dashed(fit.bic, ".0f"),
                "yes" if fit.converged else "NO",
            ]
            for fit in self.results
        ]
        e = self.best.estimator
        title = f"{self.best.method.upper()} structures, {e.input} to {e.output}"
        notes = [f"sorted by {self.criterion}; small is good, but R_T^2 near 1", *self.notes]
        return table(title, [], header, rows, notes)

    def plot(self, **options: Any) -> Figure:
        """Draw the measured output and that of the best model."""
        return self.best.plot(**options)


def search_structures(
    problem: Problem,
    estimator: SRIVC | None = None,
    *,
    poles: Iterable[int] = (1, 2, 3),
    zeros: Iterable[int] = (0, 1, 2),
    integrators: Iterable[int] = (0, 1),
    criterion: str = "yic",
) -> StructureSearch:
    """Fit every structure and sort them.

    Parameters
    ----------
    problem : Problem
    estimator : SRIVC, optional
        Method and signals; default: `SRIVC` from command to position.
    poles, zeros, integrators : iterable of int
        Numbers to combine; improper combinations are left out.
    criterion : {"yic", "aic", "bic", "relative_error"}

    Returns
    -------
    StructureSearch

    Raises
    ------
    EstimationError
        If the criterion is unknown or no structure can be estimated.

    References
    ----------
    P. C. Young, *Recursive Estimation and Time-Series Analysis*, Springer, 2011, section 6.6.

    Examples
    --------
    >>> import ivtools as iv
    >>> problem = iv.Problem(iv.datasets.twin(), iv.axes.emps())
    >>> found = search_structures(problem, SRIVC(input="q_ref"), poles=[1, 2], zeros=[0],
    ...                           integrators=[0])
    >>> found.best.estimator.poles
    2
    """
    if criterion not in CRITERIA:
        raise EstimationError(f"criterion {criterion!r} is unknown; use {', '.join(CRITERIA)}")
    estimator = estimator or SRIVC()
    fits, notes = [], []
    for n, m, k in product(poles, zeros, integrators):
        if m < n and k < n:
            try:
                candidate = replace(estimator, poles=n, zeros=m, integrators=k)
                fits.append(_quiet_fit(candidate, problem))
            except EstimationError as error:
                notes.append(f"{n} {m} {k}: {error}")
    if not fits:
        reason = "; ".join(notes) or "none given"
        raise EstimationError(f"no structure could be estimated: {reason}")
    fits.sort(key=lambda fit: (not fit.converged, getattr(fit, criterion)))
    return StructureSearch(tuple(fits), criterion, tuple(notes))


def _quiet_fit(estimator: SRIVC, problem: Problem) -> TransferFunctionResults:
    """Fit; the table says what has not converged."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return estimator.fit(problem)
