"""``ivtools identify``: one method on one record."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from ivtools.cli import options
from ivtools.cli.output import progress, show, write_json, write_page

if TYPE_CHECKING:
    pass


def identify(
    record: options.Record,
    axis: options.Axis = None,
    method: Annotated[
        str, typer.Option("--method", metavar="METHOD", help="Method; an unknown one lists all.")
    ] = "idim-ls",
    cov: options.Cov = options.Covariance.HAC,
    friction: options.FrictionModel = None,
    tests: Annotated[bool, typer.Option("--tests", help="Print the statistical tests.")] = False,
    data: options.Data = None,
    json: options.Json = None,
    out: options.Out = None,
) -> None:
    """Identify the parameters of an axis from a record."""
    from ivtools.cli.case import load
    from ivtools.estimators.base import estimator_class

    estimator = estimator_class(method)(cov_type=cov.value)
    measured, loop = load(record, axis, data, friction)
    from ivtools.problem import Problem

    with progress(method):
        fit = estimator.fit(Problem(measured, loop))
    texts: list[object] = [fit.summary()]
    if tests:
        texts.append("\n".join(str(test) for test in fit.tests().values()))
    if out is not None:
        from ivtools.pages import fit_page

        texts.append(f"report: {write_page(fit_page(fit), out)}")
    if json is not None:
        write_json(fit.to_dict(), json)
    show(*texts, json_file=json)
