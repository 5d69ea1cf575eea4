"""The numbers of the EMPS report, computed: by section, row and quantity."""

from __future__ import annotations

from time import perf_counter

from ivtools import axes
from ivtools.goodness import ErrorFigures
from ivtools.problem import Problem
from ivtools.record import Record
from ivtools.reproduce.rows import value
from ivtools.reproduce.toolboxes import report_cases
from ivtools.results import FitResults

Figures = dict[tuple[str, str, str], float]

NAMES = {
    "inertia": "M1",
    "viscous": "FV1",
    "coulomb": "FC1",
    "offset": "OF1",
    "viscous_pos": "FV1p",
    "coulomb_pos": "FC1p",
    "viscous_neg": "FV1m",
    "coulomb_neg": "FC1m",
}


def published_theta() -> dict[str, float]:
    """Return the parameters of the published simulation: those that the report prints."""
    names = ("inertia", "viscous", "coulomb", "offset")
    return {name: value("identification", NAMES[name], "value") for name in names}


def settings(record: Record, problem: Problem) -> Figures:
    """Return what the report says about the axis and the record."""
    gains, natural = problem.loop.controller.settings, problem.pipeline.cutoff_hz or 0.0
    return {
        ("settings", "kp", "value"): gains["kp"],
        ("settings", "kv", "value"): gains["kv"],
        ("settings", "gtau", "value"): problem.loop.gain,
        ("settings", "bandwidth", "one digit"): natural / 5.0,
        ("settings", "sampling", "value"): record.sampling_hz / 1000.0,
        ("settings", "duration", "approximately"): float(record.t[-1] - record.t[0]),
    }


def estimate(section: str, fit: FitResults) -> Figures:
    """Return the parameters with their deviations."""
    figures = {}
    for name in fit.names:
        key = (section, NAMES[name])
        figures[*key, "value"] = float(fit.params[name])
        figures[*key, "deviation"] = float(fit.std_errors[name])
        figures[*key, "relative"] = float(fit.relative_std[name])
    return figures


def quality(section: str, fit: FitResults, errors: ErrorFigures) -> Figures:
    """Return |diag R|, the condition number and the size of the error."""
    figures = {(section, NAMES[str(k)], "|diag R|"): float(v) for k, v in fit.abs_diag_r.items()}
    figures[section, "X", "condition number"] = fit.condition_number
    figures[section, "error", "norm"] = errors.norm
    figures[section, "error", "relative"] = errors.relative
    figures[section, "error", "deviation"] = errors.std
    return figures


def cross_test(fit: FitResults, holdout: Problem) -> Figures:
    """Return the figures of an estimate on another record."""
    there = FitResults.from_solution(
        fit.method, fit.params.to_numpy(), holdout.X, holdout.y, problem=holdout
    )
    return quality("cross-test", there, fit.cross_test(holdout))


def seconds(record: Record) -> float:
    """Return the duration of one simulation of the record, s; a first run loads the kernel."""
    loop = axes.emps()
    loop.simulate(record, published_theta())
    start = perf_counter()
    loop.simulate(record, published_theta())
    return perf_counter() - start


def transfer_functions(record: Record) -> Figures:
    """Return the figures of the report's comparison with transfer-function toolboxes."""
    return {("toolboxes", *key): number for key, number in report_cases(record).items()}
