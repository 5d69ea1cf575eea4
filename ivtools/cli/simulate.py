"""``ivtools simulate``: the closed loop on a record's reference, against what was measured."""

from __future__ import annotations

import warnings
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ivtools.cli import options
from ivtools.cli.output import show, write_json, write_page
from ivtools.errors import AxisError, EstimationError, IVToolsError, IVToolsWarning

if TYPE_CHECKING:
    from ivtools.loop import ClosedLoop
    from ivtools.loop.simulation import Simulation
    from ivtools.record import Record
    from ivtools.tables import Text


def simulate(
    record: options.Record,
    axis: options.Axis = None,
    robot: options.Robot = None,
    theta: Annotated[
        Path | None,
        typer.Option(
            "--theta",
            metavar="FILE",
            help="Parameters: the JSON of identify, or names and numbers; default: the true ones "
            "of a simulated record, the axis file's, else IDIM-LS estimates.",
        ),
    ] = None,
    friction: options.FrictionModel = None,
    data: options.Data = None,
    json: options.Json = None,
    out: options.Out = None,
) -> None:
    """Simulate the closed loop and compare it with the record."""
    from ivtools.cli.case import load, load_theta, with_friction
    from ivtools.loop.simulation import LOST

    given = load_theta(theta) if theta is not None else None
    measured, loop = load(record, axis, data, friction, robot=robot)
    if given is None and friction is None and measured.theta_true is not None:
        given, source = dict(measured.theta_true), "true parameters of the record"
    else:
        source = str(theta)
    if given is not None and friction is None and set(given) - set(loop.parameters):
        loop = with_friction(loop, "asymmetric" if "viscous_pos" in given else "symmetric")
    if given is None:
        given, source = _default(measured, loop)
    simulation = loop.simulate(measured, given)
    if not simulation.finite:
        raise EstimationError(
            "the simulated loop is unstable; check the parameters and the controller's gains"
        )
    errors = simulation.relative_error(measured)
    if not errors["position"] <= LOST:
        warnings.warn(
            f"the simulated axis does not follow: its position is {errors['position']:.3g} % off; "
            "check the parameters, the gains and the units",
            IVToolsWarning,
            stacklevel=2,
        )
    joints = _joint_errors(simulation, measured)
    found = _table(joints or {"": errors}, source)
    texts: list[object] = [found]
    if out is not None:
        from ivtools.pages import simulation_page

        texts.append(f"report: {write_page(simulation_page(measured, simulation, found), out)}")
    lost = {s: "the measured one is 0 throughout" for s, e in errors.items() if not isfinite(e)}
    more = ({"reasons": lost} if lost else {}) | ({"joints": joints} if joints else {})
    write_json({"relative_error": errors} | more, json)
    show(*texts, json_file=json)


def _default(record: Record, loop: ClosedLoop) -> tuple[dict[str, float], str]:
    """Return the axis file's parameters, else those that least squares finds in the record."""
    if len(loop.joints) > 1:
        from ivtools.problem import Problem

        return Problem(record, loop).start, "least squares in the band of the references"
    try:
        return loop.values(), "starting values of the axis file"
    except AxisError:
        from ivtools.estimators.least_squares import IDIMLS
        from ivtools.problem import Problem

        try:
            fit = IDIMLS().fit(Problem(record, loop))
        except IVToolsError as error:
            raise type(error)(f"{error} (no --theta was given)") from error
        return {str(k): float(v) for k, v in fit.params.items()}, "IDIM-LS on this record"


def _joint_errors(simulation: Simulation, record: Record) -> dict[str, dict[str, float]]:
    """Return the relative errors per joint of a robot; none for one axis."""
    names = simulation.loop.joints
    if len(names) == 1:
        return {}
    return {
        name: simulation.joint(j, record).relative_error(record.joint(j))
        for j, name in enumerate(names)
    }


def _table(errors: dict[str, dict[str, float]], source: str) -> Text:
    """Return the relative errors as a table: a column per joint, or one alone."""
    from ivtools.tables import table

    signals = list(next(iter(errors.values())))
    rows = [[signal, *(f"{e[signal]:.5g}" for e in errors.values())] for signal in signals]
    header = ["signal", *(name or "relative error, %" for name in errors)]
    notes = [f"parameters: {source}", *["relative errors in %"][: len(errors) - 1]]
    return table("Simulated against measured", [], header, rows, notes)
