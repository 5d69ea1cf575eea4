"""Leaderboard: the public protocol of the EMPS benchmark, beside what it cannot see.

Train on the estimation record, test on the pulses: the model runs free from the recorded command
to the position, and the root mean square error after the first 20 samples counts, in mm.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pandas as pd

from ivtools.display import Displayed
from ivtools.errors import ConvergenceWarning, IVToolsError
from ivtools.estimators.base import Estimator, estimator_class
from ivtools.estimators.closed_loop_srivc import CLSRIVC
from ivtools.estimators.output_error import open_loop
from ivtools.estimators.transfer_function import SRIVC
from ivtools.problem import Problem
from ivtools.tables import Text, table

if TYPE_CHECKING:
    from ivtools.estimators.transfer_results import TransferFunctionResults
    from ivtools.loop import ClosedLoop
    from ivtools.record import Record
    from ivtools.results import FitResults

WINDOW = 20  # samples at the start that do not count
ASYMMETRIC = ("inertia", "asymmetric-friction")
NOTES = (
    "The axis is a pure integrator: in free run every error of the force is integrated twice, a "
    "newton too much of Coulomb friction becomes millimetres, and whether the axis sticks at a "
    "reversal decides the rest. An honest model of the forces is punished for what a controller "
    "would remove, and a model trained on this very error may pay for it with wrong forces. The "
    "last two columns say how each model does under the controller that the axis really has.",
    "mm: free run from the recorded command to the position, after 20 samples; %: closed loop from "
    "the reference, relative errors of position and force on the test record. OLOE is trained on "
    "the free run itself, and a fit that has not converged says so; n/m/k are poles, zeros, "
    "integrators; * decimated by 10.",
    "measured: figures of other programs run side by side on the same records; read: figures that "
    "their authors state.",
)


@dataclass(frozen=True)
class Entry:
    """One row of the board.

    Attributes
    ----------
    model : str
    source : str
        "ours", "measured" (another program, run by us) or "read" (a figure somebody states).
    rmse_mm : float
        Free run on the test record.
    train_mm : float
        The same on the training record.
    position, force : float
        Relative errors in closed loop on the test record, in %; NaN if the model has no loop.
    seconds : float
        Duration of the fit.
    converged : bool
        Whether the fit met its tolerance; a row that did not is marked.
    """

    model: str
    source: str
    rmse_mm: float
    train_mm: float = math.nan
    position: float = math.nan
    force: float = math.nan
    seconds: float = math.nan
    converged: bool = True

    @property
    def label(self) -> str:
        """The model, marked if its fit has not converged."""
        return self.model if self.converged else f"{self.model} (not converged)"


OTHERS = (
    Entry("jax-sysid, linear, 4 states*", "measured", 2.57),
    Entry("MuJoCo system identification", "measured", 5.48),
    Entry("SIPPY PARSIM-K", "measured", 5.98),
    Entry("IDIM-LS symmetric, elsewhere", "measured", 9.23),
    Entry("LTC network", "read", 4.10),
    Entry("CT-SUBNET", "read", 4.61),
)
"""Published or measured figures of other models on the same protocol."""

OURS: Mapping[str, tuple[str | SRIVC, tuple[str, ...]]] = {
    "IDIM-LS symmetric": ("idim-ls", ()),
    "IDIM-IV symmetric": ("idim-iv", ()),
    "IDIM-LS asymmetric": ("idim-ls", ASYMMETRIC),
    "IDIM-IV asymmetric": ("idim-iv", ASYMMETRIC),
    "DIDIM asymmetric": ("didim", ASYMMETRIC),
    "OLOE symmetric": ("oloe", ()),
    "OLOE asymmetric": ("oloe", ASYMMETRIC),
    "DIDIM asymmetric, polynomial": ("didim", (*ASYMMETRIC, "polynomial-viscous")),
    "SRIVC 2/0/1": (SRIVC(poles=2, integrators=1), ()),
    "CLSRIVC 2/0/1": (CLSRIVC(poles=2, integrators=1), ()),
    "SRIVC 2/1/0": (SRIVC(poles=2, zeros=1), ()),
    "SRIVC 4/2/0": (SRIVC(poles=4, zeros=2), ()),
}
"""Our models: method and terms (none: those of the axis)."""
DIAGNOSED: Mapping[str, str] = {"diagnosed effects": "clie", "diagnosed effects, OLOE": "oloe"}
"""Methods for the axis with the effects that a diagnosis of the training record names."""


@dataclass(frozen=True, eq=False, repr=False)
class Leaderboard(Displayed):
    """Free-run errors of all models, the smallest first.

    Attributes
    ----------
    entries : tuple of Entry
    notes : tuple of str
    """

    figure: ClassVar[str] = "leaderboard"

    entries: tuple[Entry, ...]
    notes: tuple[str, ...] = NOTES

    def frame(self) -> pd.DataFrame:
        """Return one row per model."""
        return pd.DataFrame([vars(entry) for entry in self.entries])

    def summary(self) -> Text:
        """Return a table of at most 80 columns."""
        header = ["model", "source", "test, mm", "train, mm", "pos., %", "force, %"]
        rows = [
            [e.label, e.source, *(_cell(v) for v in (e.rmse_mm, e.train_mm, e.position, e.force))]
            for e in self.entries
        ]
        return table("EMPS leaderboard", [], header, rows, self.notes)

    score = summary

    def to_dict(self) -> dict[str, Any]:
        """Return the content as plain objects, ready for JSON; a missing figure is None."""
        rows = [
            {k: None if isinstance(v, float) and not math.isfinite(v) else v
             for k, v in vars(entry).items()}
            for entry in self.entries
        ]  # fmt: skip
        return {"benchmark": "emps", "unit": "mm", "models": rows, "notes": list(self.notes)}

    def to_markdown(self) -> str:
        """Return the table and its notes for a README or a results folder."""
        lines = ["| model | source | free run, mm | training, mm | closed-loop position, % | "
                 "closed-loop force, % |", "|---|---|---|---|---|---|"]  # fmt: skip
        for e in self.entries:
            cells = [_cell(v) for v in (e.rmse_mm, e.train_mm, e.position, e.force)]
            lines.append(f"| {' | '.join([e.label, e.source, *cells])} |")
        command = "Made by `ivtools benchmark leaderboard --out benchmarks/results`."
        return "\n".join([command, "", *lines, "", *(f"- {note}" for note in self.notes), ""])


def leaderboard(
    train: Record,
    test: Record,
    loop: ClosedLoop,
    models: Mapping[str, tuple[str | Estimator | SRIVC, Sequence[str]]] | None = None,
    others: Sequence[Entry] = OTHERS,
    diagnosed: ClosedLoop | None = None,
) -> Leaderboard:
    """Fit every model on one record and let it run free on the other.

    Parameters
    ----------
    train, test : Record
        Estimation and test record.
    loop : ClosedLoop
        The axis.
    models : mapping, optional
        Label to (method, terms); a method is a key, an estimator or a transfer function, and no
        terms are those of the axis. Default: `OURS`.
    others : sequence of Entry
        Rows that are not computed here.
    diagnosed : ClosedLoop, optional
        The axis with the effects that a diagnosis of the training record alone names, which start
        at its values; for the methods of `DIAGNOSED`.

    Returns
    -------
    Leaderboard

    Examples
    --------
    >>> import ivtools as iv
    >>> record = iv.datasets.twin()
    >>> models = {"LS": ("idim-ls", ()), "LS asymmetric": ("idim-ls", ASYMMETRIC)}
    >>> board = leaderboard(record, record, iv.axes.emps(), models, others=())
    >>> [entry.model for entry in board.entries]
    ['LS asymmetric', 'LS']
    """
    entries, notes = list(others), list(NOTES)
    tried = [
        (label, method, loop.with_terms(*terms) if terms else loop)
        for label, (method, terms) in (OURS if models is None else models).items()
    ]
    if diagnosed is not None:
        tried += [(label, method, diagnosed) for label, method in DIAGNOSED.items()]
        effects = [t.name for t in diagnosed.terms if t.name not in {x.name for x in loop.terms}]
        notes.append(f"diagnosed effects: {', '.join(effects) or 'none'}")
    for label, method, axis in tried:
        try:
            entries.append(_entry(label, method, Problem(train, axis), test))
        except IVToolsError as error:
            notes.append(f"{label}: {error}")
    entries.sort(key=lambda entry: entry.rmse_mm)
    return Leaderboard(tuple(entries), tuple(notes))


def _entry(label: str, method: str | Estimator | SRIVC, problem: Problem, test: Record) -> Entry:
    """Fit one model and measure it."""
    estimator = estimator_class(method)() if isinstance(method, str) else method
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        if isinstance(estimator, SRIVC):
            return _black_box(label, estimator.fit(problem), problem, test)
        fit = estimator.fit(problem)
    simulation = problem.loop.simulate(test, _parameters(fit))
    errors = simulation.relative_error(test) if simulation.finite else {}
    return Entry(
        label,
        "ours",
        free_run(fit, test),
        free_run(fit, problem.record),
        errors.get("position", math.nan),
        errors.get("force", math.nan),
        fit.runtime,
        bool(fit.converged),
    )


def _black_box(label: str, fit: TransferFunctionResults, problem: Problem, test: Record) -> Entry:
    """Measure a transfer function; it has no closed loop of its own."""
    free = {}
    for name, record in (("test", test), ("train", problem.record)):
        nu, q = problem.loop.command(record)[:, 0], record.q[:, 0]
        free[name] = rms_mm(q, fit.simulate(nu, record.dt, float(q[0])))
    return Entry(
        label,
        "ours",
        free["test"],
        free["train"],
        seconds=fit.runtime,
        converged=bool(fit.converged),
    )


def _parameters(fit: FitResults) -> dict[str, float]:
    return {str(name): float(value) for name, value in fit.params.items()}


def free_run(fit: FitResults, record: Record) -> float:
    """Return the root mean square error, mm (or mrad), of a fit's axis driven by the command.

    The axis starts at the first measured position, at rest; the first 20 samples do not count.

    Examples
    --------
    >>> import ivtools as iv
    >>> record = iv.datasets.twin()
    >>> loop = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    >>> free_run(iv.IDIMLS().fit(iv.Problem(record, loop)), record) < 60.0
    True
    """
    if fit.problem is None:
        raise IVToolsError("the fit has no problem: there is no axis to run free")
    axis = open_loop(replace(fit.problem, record=record))
    return rms_mm(record.q[:, 0], axis.simulate(_parameters(fit)).q[:, 0])


def rms_mm(measured: np.ndarray, simulated: np.ndarray) -> float:
    """Return the root mean square error after the first 20 samples, in thousandths.

    Examples
    --------
    >>> rms_mm(np.zeros(100), np.full(100, 1e-3))
    1.0
    """
    error = np.asarray(measured)[WINDOW:] - np.asarray(simulated)[WINDOW:]
    return 1e3 * float(np.sqrt(np.mean(error**2)))


def _cell(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "-"
