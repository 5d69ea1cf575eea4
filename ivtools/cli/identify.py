"""``ivtools identify``: one method on one record."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ivtools.cli import options
from ivtools.cli.output import progress, show, write_json, write_page
from ivtools.errors import EstimationError

if TYPE_CHECKING:
    from ivtools.estimators.base import Estimator
    from ivtools.estimators.drive_gain_results import DriveGain
    from ivtools.problem import Problem


def identify(
    record: options.Record,
    axis: options.Axis = None,
    robot: options.Robot = None,
    method: Annotated[
        str, typer.Option("--method", metavar="METHOD", help="Method; an unknown one lists all.")
    ] = "idim-ls",
    cov: options.Cov = options.Covariance.HAC,
    friction: options.FrictionModel = None,
    tests: Annotated[bool, typer.Option("--tests", help="Print the statistical tests.")] = False,
    payload: Annotated[
        str | None,
        typer.Option(
            "--payload",
            metavar="RECORD",
            help="A record with a known payload: gives the drive gain; by total least squares if "
            "the method is idim-ls, else by the two inertias.",
        ),
    ] = None,
    mass: Annotated[
        float | None, typer.Option("--mass", metavar="KG", help="Of the payload, kg or kg m2.")
    ] = None,
    data: options.Data = None,
    json: options.Json = None,
    out: options.Out = None,
) -> None:
    """Identify the parameters of an axis from a record."""
    from ivtools.cli.case import exists, load
    from ivtools.methods import method as known

    known(method)  # which is soon told, as are names of nothing
    exists(record, axis, robot)
    from ivtools.estimators.base import estimator_class

    estimator = estimator_class(method)(cov_type=cov.value)
    if (payload is None) != (mass is None):
        raise EstimationError("--payload and --mass belong together: a record, and its weight")
    measured, loop = load(record, axis, data, friction, robot=robot)
    from ivtools.problem import Problem

    problem = Problem(measured, loop)
    with progress(method):
        fit = estimator.fit(problem)
        gain = None if mass is None else _drive_gain(problem, payload, mass, estimator, data)
    texts: list[object] = [fit.summary()]
    if gain is not None:
        texts.append(gain.summary())
    if tests:
        texts.append("\n".join(str(test) for test in fit.tests().values()))
    if out is not None:
        from ivtools.pages import fit_page

        texts.append(f"report: {write_page(fit_page(fit, gain), out)}")
    if json is not None:
        more = {} if gain is None else {"drive_gain": gain.to_dict()}
        write_json({**fit.to_dict(), **more}, json)
    show(*texts, json_file=json)


def _drive_gain(
    unloaded: Problem, payload: str | None, mass: float, estimator: Estimator, data: Path | None
) -> DriveGain:
    """Estimate the drive gain with a second record of the same axis."""
    from ivtools import datasets
    from ivtools.estimators.drive_gain import drive_gain

    loaded = replace(unloaded, record=datasets.load(str(payload), data, unloaded.loop.log))
    own = None if estimator.key == "idim-ls" else estimator
    return drive_gain(unloaded, loaded, mass, estimator=own)
