"""Pages of results: one estimate, several compared, one simulation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ivtools import plots
from ivtools.comparison import Comparison
from ivtools.comparison_table import model_of
from ivtools.loop.simulation import LOST
from ivtools.plots.chart import Chart
from ivtools.plots.parameters import shown_name
from ivtools.plots.style import readable
from ivtools.recommendation import listed
from ivtools.report import Card, Page, Picture
from ivtools.tables import Text, sentence, table
from ivtools.units import JOINTS

if TYPE_CHECKING:
    from ivtools.estimators.drive_gain_results import DriveGain
    from ivtools.loop import Simulation
    from ivtools.problem import Problem
    from ivtools.record import Record
    from ivtools.results import FitResults
    from ivtools.transfer_table import TransferTable

ILL_CONDITIONED = 200.0
CLOSE = 5.0  # % of the force; friction that is not in the model leaves more
_FEW = 10  # parameters that a card names one by one
_NEXT = ("Run ivtools diagnose: it names what this model lacks, if anything.",)
FORCE_CAPTION = "Force measured and reconstructed; below, their difference."


def fit_page(fit: FitResults, gain: DriveGain | None = None) -> Page:
    """Return the page of one result: estimates, tests, force; the drive gain if it was sought."""
    problem = fit.problem
    assert problem is not None  # every estimator keeps its problem
    out = Page(
        f"{problem.record.name}: {fit.method.upper()}",
        f"Parameters of {problem.loop.name} identified from {problem.record!r}.",
        fit_card(fit),
    )
    out.add("Estimates", *map(sentence, problem.record.notes),
            tables=[fit.summary()], figures=_forces(fit))  # fmt: skip
    if gain is not None:
        caption = "The drive gain, with its 95 % interval."
        picture = Picture("drive-gain", plots.drive_gain(gain), caption)
        out.add("Drive gain", tables=[gain.summary()], figures=[picture])
    _add_residual(out, fit)
    return out


def fit_card(fit: FitResults) -> Card:
    """Return one result in plain words: values with units, and whether to trust them."""
    facts = (*_sizes(fit), *_left(fit))
    doubts = tuple(_doubts(fit))
    if not fit.converged:
        return Card("Not converged: these are no estimates yet.", facts, doubts, "bad")
    verdict = "Identified, with reservations." if doubts else "Identified."
    return Card(verdict, facts, doubts or _NEXT, "doubt" if doubts else "good")


def _left(fit: FitResults) -> Iterator[tuple[str, str]]:
    """Yield what is left of the signal, of each joint if there are several."""
    problem, label = fit.problem, f"Left of the {fit.signal}"
    for j, name in enumerate(problem.loop.joints if problem is not None else ("",)):
        kind = problem.loop.kind_of(j) if problem is not None else "prismatic"
        several = problem is not None and len(problem.loop.joints) > 1
        mine = problem.row_joints == j if problem is not None and several else slice(None)
        rms = float(np.sqrt(np.mean(np.square(fit.resids[mine]))))
        unit = JOINTS[kind].force
        if several:
            of = float(np.sqrt(np.mean(np.square(fit.y[mine])))) or np.nan
            yield label, f"{name}: {rms:.3g} {unit} rms, {100.0 * rms / of:.3g} %"
        else:
            size = f"{rms:.3g} {unit} rms, " if fit.signal == "force" else ""
            yield label, f"{size}{fit.relative_error:.3g} %"


def _forces(fit: FitResults, name: str = "force", more: str = "", **options: Any) -> list[Chart]:
    """Return the force chart of a result, one of each joint of a robot."""
    caption = f"{more}{FORCE_CAPTION}"
    assert fit.problem is not None  # every estimator keeps its problem
    names = fit.problem.loop.joints
    if len(names) == 1:
        return [force_chart(fit, name, caption, **options)]
    return [
        plots.force_chart(fit, options.get("problem"), name=f"{name}-{j + 1}", joint=j,
                          title=joint, caption=f"{joint}. {caption}")
        for j, joint in enumerate(names)
    ]  # fmt: skip


def _sizes(fit: FitResults) -> tuple[tuple[str, str], ...]:
    """Return the parameters of a result, each with unit and 95 % interval."""
    label = "Parameters, ± 95 %"
    if len(fit.names) > _FEW:
        return (("Parameters", f"{len(fit.names)}, see the table"),)
    return tuple((label, f"{shown_name(name)} {_value(fit, name)}") for name in fit.names)


def _value(fit: FitResults, name: str) -> str:
    """Return a parameter with its unit and the half width of its 95 % interval."""
    problem = fit.problem
    unit = readable(problem.units[name]) if problem is not None else ""
    value, ends = float(fit.params[name]), fit.conf_int()
    half = 0.5 * float((ends["upper"] - ends["lower"])[name])
    if not np.isfinite(half) or half == 0.0:
        return f"{value:.4g} {unit}".rstrip()
    places = max(0, 1 - int(np.floor(np.log10(half))))
    return f"{value:.{places}f} ± {half:.{places}f} {unit}".rstrip()


def _doubts(fit: FitResults) -> Iterator[str]:
    """Yield what keeps a result from being trusted, each with its remedy."""
    if not fit.converged:
        yield "Start nearer (axis file, [model.start]), or take DIDIM or IDIM-IV instead."
    if fit.converged and (weak := fit.weak()):
        yield (
            f"{listed(weak)}: may be more than 20 % off by what the record says; leave it out "
            "of the model, or move the axis in a way that shows it."
        )
    if fit.condition_number > ILL_CONDITIONED:
        yield "The condition number is high: vary speed and acceleration more."


def _add_residual(out: Page, fit: FitResults) -> None:
    """Add what the residual still knows, and the tests; those that do not apply are folded."""
    tests = list(fit.tests().values())
    rows = [
        [t.name, t.null, f"{t.statistic:.4g}", "–" if t.pvalue is None else f"{t.pvalue:.2g}"]
        for t in tests
        if t.statistic is not None
    ]
    others = [[t.name, t.reason] for t in tests if t.statistic is None]
    header = ["test", "holds if p is not small", "statistic", "p value"]
    pictures = []
    if fit.problem is None or len(fit.problem.loop.joints) == 1:  # a series in time
        near = "The autocorrelation of what is left, with the band that white noise keeps in."
        pictures = [
            Picture("residual", plots.whiteness(fit, "autocorrelation"), near),
            Picture(
                "residual-spectrum",
                plots.whiteness(fit, "spectrum"),
                "The spectrum of what is left.",
            ),
        ]
    folded = [("Tests that do not apply", table("", [], ["test", "why"], others, left=2))]
    out.add(
        "The residual, and tests",
        tables=[table("Tests", [], header, rows, left=2)],
        figures=pictures,
        folded=folded if others else (),
    )


def comparison_page(comparison: Comparison, holdout: Record | None = None) -> Page:
    """Return the page of a comparison: table, intervals, force and simulation."""
    functions = comparison.functions
    any_fit: Any = (*comparison.results, *(functions.results if functions else ()))[0]
    first = any_fit.problem
    out = Page(
        f"{first.record.name}: methods compared",
        f"{first.loop.name}, {first.record!r}.",
        comparison_card(comparison) if comparison.results else None,
    )
    if comparison.results:
        _add_estimates(out, comparison, first, holdout)
    if functions is not None:
        _add_functions(out, functions)
    return out


def comparison_card(comparison: Comparison) -> Card:
    """Return which result to take, and why."""
    chosen, best = comparison.recommendation, comparison.best
    if chosen is None or best is None:
        why = () if chosen is None else (("Why", chosen.reason),)
        return Card("None of these results can be recommended.", why, (), "bad")
    doubts = tuple(_doubts(best))
    facts = (*_sizes(best), ("Why", f"{chosen.reason}."))
    model = f", {model_of(best)}" if len(_by_model(comparison.results)) > 1 else ""
    verdict = f"Take {best.method.upper()}{model}."
    return Card(verdict, facts, doubts or _NEXT, "doubt" if doubts else "good")


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
            f"Estimates with 95 % intervals, {model_of(fits[0])}.",
        )
        for k, fits in enumerate(_by_model(comparison.results), 1)
        if len(fits[0].names) <= _FEW
    ]
    estimates = replace(comparison, functions=None)
    out.add("Comparison", tables=[estimates.summary()], figures=pictures)
    best = comparison.best or comparison.results[0]
    forces = _forces(best)
    if holdout is not None:
        assert best.problem is not None
        other = replace(best.problem, record=holdout)
        forces += _forces(best, "cross-test", "Hold-out. ", problem=other)
    model = f", {model_of(best)}" if len(_by_model(comparison.results)) > 1 else ""
    out.add("Force", f"Of {best.method.upper()}{model}.", figures=forces)
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
    out.add(
        "The closed loop simulated",
        f"Driven by the record's reference alone, with the parameters of {fit.method.upper()}.",
        figures=_simulated(simulated, problem.record, problem.pipeline),
    )


def _simulated(simulated: Simulation, record: Record, pipeline: Any = None) -> list[Chart]:
    """Return the chart of a simulation, one of each joint of a robot."""
    caption = "Simulated and measured signals, and the error of the force."
    names = simulated.loop.joints
    if len(names) == 1:
        return [plots.simulation_chart(simulated, record, pipeline, caption=caption)]
    charts = [
        plots.simulation_chart(
            simulated.joint(j, record), record.joint(j), caption=f"{name}. {caption}"
        )
        for j, name in enumerate(names)
    ]
    return [replace(chart, name=f"simulation-{j}") for j, chart in enumerate(charts, 1)]


def force_chart(
    fit: FitResults, name: str = "force", caption: str = FORCE_CAPTION, **options: Any
) -> Chart:
    """Return the force chart of a result; its picture is titled by method, model and error."""
    known = {"viscous_pos", "viscous"} & {*fit.names}
    model = f", {model_of(fit)}" if known else ""
    title = f"{fit.method.upper()}{model}: {fit.relative_error:.2f} %"
    if options.get("problem") is None:
        options["title"], caption = title, f"{title}. {caption}"
    return plots.force_chart(fit, name=name, caption=caption, **options)


def simulation_page(record: Record, simulation: Simulation, table: Text) -> Page:
    """Return the page of one simulation."""
    lead = f"{simulation.loop.name} simulated in closed loop on the reference of {record!r}."
    out = Page(f"{record.name}: simulation", lead, simulation_card(record, simulation))
    out.add("Relative errors", tables=[table], figures=_simulated(simulation, record))
    return out


def simulation_card(record: Record, simulation: Simulation) -> Card:
    """Return how far a simulation is off, in a sentence."""
    errors = simulation.relative_error(record)
    told = {name: f"{error:.2g} %" for name, error in errors.items() if np.isfinite(error)}
    facts = tuple((f"Error of the {name}", share) for name, share in told.items())
    if not errors["position"] <= LOST:
        advice = ("Check the parameters, the gains and the units.",)
        return Card("The simulated axis does not follow.", facts, advice, "bad")
    close = errors["force"] <= CLOSE
    verdict = f"The simulated axis follows; its force is {told.get('force', 'not')} off."
    if close:
        return Card(verdict, facts, _NEXT)
    return Card(verdict, facts, _NEXT, "doubt")
