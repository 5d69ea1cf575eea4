"""Pages of results: one estimate, several compared, one simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ivtools import plots
from ivtools.comparison import Comparison
from ivtools.plots.chart import Chart
from ivtools.report import Card, Page, Picture
from ivtools.tables import Text

if TYPE_CHECKING:
    from ivtools.estimators.drive_gain_results import DriveGain
    from ivtools.loop import Simulation
    from ivtools.problem import Problem
    from ivtools.record import Record
    from ivtools.results import FitResults
    from ivtools.transfer_table import TransferTable

FORCE_CAPTION = "Force measured and reconstructed; below, their difference."


def fit_page(fit: FitResults, gain: DriveGain | None = None) -> Page:
    """Return the page of one result: estimates, tests, force; the drive gain if it was sought."""
    problem = fit.problem
    assert problem is not None  # every estimator keeps its problem
    out = Page(
        f"{problem.record.name}: {fit.method.upper()}",
        f"Parameters of {problem.loop.name} identified from {problem.record!r}.",
    )
    out.add("Estimates", tables=[fit.summary()], figures=[force_chart(fit)])
    if gain is not None:
        caption = "The drive gain, with its 95 % interval."
        picture = Picture("drive-gain", plots.drive_gain(gain), caption)
        out.add("Drive gain", tables=[gain.summary()], figures=[picture])
    tests = "\n".join(str(test) for test in fit.tests().values())
    out.add("Tests", *problem.record.notes, tables=[Text(tests)])
    return out


def comparison_page(comparison: Comparison, holdout: Record | None = None) -> Page:
    """Return the page of a comparison: table, intervals, force and simulation."""
    functions = comparison.functions
    any_fit: Any = (*comparison.results, *(functions.results if functions else ()))[0]
    first = any_fit.problem
    out = Page(f"{first.record.name}: methods compared", f"{first.loop.name}, {first.record!r}.")
    if comparison.results:
        _add_estimates(out, comparison, first, holdout)
    if functions is not None:
        _add_functions(out, functions)
    return out


def _add_functions(out: Page, functions: TransferTable) -> None:
    """Add the transfer functions to a page, the best of each case drawn."""
    pictures = [
        Picture(
            f"transfer-function-{k}",
            plots.transfer_function(fit),
            f"{fit.method.upper()} from {fit.estimator.input} to {fit.estimator.output}: measured "
            "and free-running output; below, their difference.",
        )
        for k, fit in enumerate(functions.best(), 1)
    ]
    out.add("Transfer functions", tables=[functions.summary()], figures=pictures)


def _add_estimates(
    out: Page, comparison: Comparison, first: Problem, holdout: Record | None
) -> None:
    """Add table, intervals, force and simulation of the physical parameters to a page."""
    pictures = [
        Picture(
            f"parameters-{k}",
            plots.parameters(fits, truth=first.record.theta_true),
            "Estimates with 95 % intervals.",
        )
        for k, fits in enumerate(_by_model(comparison.results), 1)
    ]
    estimates = replace(comparison, functions=None)
    out.add("Comparison", tables=[estimates.summary()], figures=pictures)
    test = "cross-test" if holdout is not None else "direct"
    row = comparison.frame.index.get_loc(("relative_error", test))
    errors = comparison.frame.to_numpy()[row]
    if test == "direct":  # an error of the position is no error of the force
        elsewhere = np.array([fit.signal != "force" for fit in comparison.results])
        errors = np.where(elsewhere & ~elsewhere.all(), np.nan, errors)
    best = comparison.results[int(np.nanargmin(errors))]
    forces = [force_chart(best)]
    if holdout is not None:
        assert best.problem is not None
        other = replace(best.problem, record=holdout)
        forces.append(force_chart(best, "cross-test", f"Hold-out. {FORCE_CAPTION}", problem=other))
    out.add("Force", f"The result with the smallest {test} error.", figures=forces)
    add_simulation(out, best)


def _by_model(results: Sequence[FitResults]) -> list[list[FitResults]]:
    """Return the results in groups of the same parameters."""
    groups: dict[tuple[str, ...], list[FitResults]] = {}
    for fit in results:
        groups.setdefault(fit.names, []).append(fit)
    return list(groups.values())


def add_simulation(out: Page, fit: FitResults) -> None:
    """Add the closed loop simulated with a result to a page."""
    problem = fit.problem
    assert problem is not None  # every estimator keeps its problem
    simulated = problem.simulate(fit.params.to_numpy())
    caption = "Simulated and measured signals, and the error of the force."
    chart = plots.simulation_chart(simulated, problem.record, problem.pipeline, caption=caption)
    out.add(
        "The closed loop simulated",
        f"Driven by the record's reference alone, with the parameters of {fit.method.upper()}.",
        figures=[chart],
    )


def force_chart(
    fit: FitResults, name: str = "force", caption: str = FORCE_CAPTION, **options: Any
) -> Chart:
    """Return the force chart of a result; its picture is titled by method, model and error."""
    models = {"viscous_pos": ", asymmetric friction", "viscous": ", symmetric friction"}
    model = next((text for key, text in models.items() if key in fit.names), "")
    title = f"{fit.method.upper()}{model}: {fit.relative_error:.2f} %"
    if options.get("problem") is None:
        options["title"] = title
    return plots.force_chart(fit, name=name, caption=caption, **options)


def simulation_page(record: Record, simulation: Simulation, table: Text) -> Page:
    """Return the page of one simulation."""
    lead = f"{simulation.loop.name} simulated in closed loop on the reference of {record!r}."
    out = Page(f"{record.name}: simulation", lead)
    caption = "Simulated and measured signals, and the error of the force."
    chart = plots.simulation_chart(simulation, record, caption=caption)
    out.add("Relative errors", tables=[table], figures=[chart])
    return out
