"""``ivtools compare``: several methods and friction models side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from ivtools.cli import options
from ivtools.cli.output import progress, show, stoppable, write_json, write_page
from ivtools.errors import EstimationError, IVToolsError

if TYPE_CHECKING:
    from ivtools.estimators.base import Estimator
    from ivtools.estimators.transfer_function import SRIVC
    from ivtools.estimators.transfer_results import TransferFunctionResults
    from ivtools.loop import ClosedLoop
    from ivtools.problem import Problem
    from ivtools.record import Record
    from ivtools.results import FitResults

    Method = Estimator | SRIVC

DEFAULT = ("idim-ls", "idim-iv", "idim-bciv", "didim")
DEFAULT_ROBOT = "idim-ls, idim-wls, idim-iv, didim"


@dataclass
class Fits:
    """What was finished, what failed, and whether somebody stopped it."""

    done: list[FitResults | TransferFunctionResults]
    failed: list[str]
    interrupted: bool = False


def compare(
    record: options.Record,
    axis: options.Axis = None,
    robot: options.Robot = None,
    holdout: options.Holdout = None,
    methods: Annotated[
        str | None,
        typer.Option(
            "--methods",
            metavar="LIST",
            help="Methods, separated by commas, or all; srivc, rivc, clsrivc, sriv and rivbj are "
            "transfer functions.",
        ),
    ] = None,
    friction: Annotated[
        options.Frictions | None,
        typer.Option("--friction", help="Friction models; default: that of the axis file."),
    ] = None,
    cov: options.Cov = options.Covariance.HAC,
    data: options.Data = None,
    json: options.Json = None,
    out: options.Out = None,
) -> None:
    """Compare methods on a record, and on a hold-out that none of them has seen."""
    from ivtools.cli.case import exists, load

    exists(record, axis, robot)
    names = _names(methods or (DEFAULT_ROBOT if robot else None))
    from ivtools import datasets
    from ivtools.comparison import compare as side_by_side

    estimators = _estimators(names, cov)
    measured, loop = load(record, axis, data, robot=robot)
    other = None
    if holdout is not None:
        other = datasets.load(holdout, data, loop.log)
    fits = _fit(estimators, measured, loop, friction)
    if not fits.done:
        if fits.interrupted:
            raise KeyboardInterrupt
        raise EstimationError("; ".join(fits.failed))
    comparison = side_by_side(fits.done, other)
    texts: list[object] = [comparison.summary(), *fits.failed]
    if out is not None:
        from ivtools.pages import comparison_page

        texts.append(f"report: {write_page(comparison_page(comparison, other), out)}")
    write_json(comparison.to_dict(), json)
    show(*texts, json_file=json)
    if fits.interrupted:
        with stoppable():
            raise KeyboardInterrupt("interrupted; what was finished is kept")


def _names(methods: str | None) -> list[str]:
    """Return the methods of a list by name."""
    from ivtools.methods import FUNCTIONS, METHODS, method

    names = list(DEFAULT)
    if methods is not None:
        names = methods.replace(",", " ").split()
        names = [*METHODS, *FUNCTIONS] if names == ["all"] else list(dict.fromkeys(names))
    if not names:
        known = ", ".join([*METHODS, *FUNCTIONS])
        raise EstimationError(f"--methods is empty; use some of {known}")
    for name in names:
        if name not in FUNCTIONS:
            method(name)
    return names


def _estimators(names: list[str], cov: options.Covariance) -> list[Method]:
    """Return the estimators of a list; a transfer-function method has one per structure."""
    from ivtools.estimators.base import METHODS, estimator_class
    from ivtools.estimators.functions import function_cases

    estimators: list[Method] = []
    for name in names:
        if name in METHODS:
            estimators.append(estimator_class(name)(cov_type=cov.value))
        else:
            estimators.extend(function_cases(name))
    return estimators


def _fit(
    estimators: list[Method],
    record: Record,
    loop: ClosedLoop,
    friction: options.Frictions | None,
) -> Fits:
    """Fit every method to every model; one that fails is named and the others go on."""
    fits, tasks = Fits([], []), _tasks(estimators, record, loop, friction)
    with progress("identifying", len(tasks)) as advance:
        try:
            for estimator, problem in tasks:
                try:
                    fits.done.append(estimator.fit(problem))
                except IVToolsError as error:
                    fits.failed.append(f"{estimator.key}: {error}")
                advance(estimator.key)
        except KeyboardInterrupt:
            fits.interrupted = True
    return fits


def _tasks(
    estimators: list[Method],
    record: Record,
    loop: ClosedLoop,
    friction: options.Frictions | None,
) -> list[tuple[Method, Problem]]:
    """Return what is fitted to what; transfer functions know no friction model."""
    from ivtools.cli.case import with_friction
    from ivtools.estimators.base import FUNCTIONS
    from ivtools.problem import Problem

    both = ("symmetric", "asymmetric")
    models = both if friction == options.Frictions.BOTH else (friction,)
    problems = [Problem(record, with_friction(loop, model)) for model in models]
    for problem in problems:
        problem.prepare()
    functions = [estimator for estimator in estimators if estimator.key in FUNCTIONS]
    others = [estimator for estimator in estimators if estimator.key not in FUNCTIONS]
    tasks = [(estimator, problem) for problem in problems for estimator in others]
    return tasks + [(function, problems[0]) for function in functions]
