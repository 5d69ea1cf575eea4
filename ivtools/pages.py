"""Pages of results: one estimate, several compared, one simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ivtools import plots
from ivtools.comparison import Comparison
from ivtools.report import Page, Picture
from ivtools.tables import Text

if TYPE_CHECKING:
    from ivtools.loop import Simulation
    from ivtools.record import Record
    from ivtools.results import FitResults

FORCE_CAPTION = "Force measured and reconstructed; below, their difference."


def fit_page(fit: FitResults) -> Page:
    """Return the page of one result: estimates, tests, force."""
    problem = fit.problem
    assert problem is not None  # every estimator keeps its problem
    out = Page(
        f"{problem.record.name}: {fit.method.upper()}",
        f"Parameters of {problem.loop.name} identified from {problem.record!r}.",
    )
    out.add("Estimates", tables=[fit.summary()], figures=[force_picture(fit)])
    tests = "\n".join(str(test) for test in fit.tests().values())
    out.add("Tests", *problem.record.notes, tables=[Text(tests)])
    return out


def comparison_page(comparison: Comparison, holdout: Record | None = None) -> Page:
    """Return the page of a comparison: table, intervals, force and simulation."""
    first = comparison.results[0].problem
    assert first is not None  # every estimator keeps its problem
    out = Page(f"{first.record.name}: methods compared", f"{first.loop.name}, {first.record!r}.")
    pictures = [
        Picture(
            f"parameters-{k}",
            plots.parameters(fits, truth=first.record.theta_true),
            "Estimates with 95 % intervals.",
        )
        for k, fits in enumerate(_by_model(comparison.results), 1)
    ]
    out.add("Comparison", tables=[comparison.summary()], figures=pictures)
    test = "cross-test" if holdout is not None else "direct"
    row = comparison.frame.index.get_loc(("relative_error", test))
    best = comparison.results[int(np.nanargmin(comparison.frame.to_numpy()[row]))]
    forces = [force_picture(best)]
    if holdout is not None:
        assert best.problem is not None
        other = replace(best.problem, record=holdout)
        forces.append(Picture("cross-test", plots.force(best, other), f"Hold-out. {FORCE_CAPTION}"))
    out.add("Force", f"The result with the smallest {test} error.", figures=forces)
    add_simulation(out, best)
    return out


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
    figure = plots.simulation(simulated, problem.record, problem.pipeline, width_mm=160.0)
    caption = "Simulated and measured signals with their relative errors."
    out.add(
        "The closed loop simulated",
        f"Driven by the record's reference alone, with the parameters of {fit.method.upper()}.",
        figures=[Picture("simulation", figure, caption)],
    )


def force_picture(fit: FitResults, name: str = "force") -> Picture:
    """Return the force figure of a result, titled by method, model and error."""
    models = {"viscous_pos": ", asymmetric friction", "viscous": ", symmetric friction"}
    model = next((text for key, text in models.items() if key in fit.names), "")
    title = f"{fit.method.upper()}{model}: {fit.relative_error:.2f} %"
    return Picture(name, plots.force(fit, title=title), FORCE_CAPTION)


def simulation_page(record: Record, simulation: Simulation, table: Text) -> Page:
    """Return the page of one simulation."""
    lead = f"{simulation.loop.name} simulated in closed loop on the reference of {record!r}."
    out = Page(f"{record.name}: simulation", lead)
    figure = plots.simulation(simulation, record, width_mm=160.0)
    caption = "Simulated and measured signals, the errors below."
    out.add("Relative errors", tables=[table], figures=[Picture("simulation", figure, caption)])
    return out
