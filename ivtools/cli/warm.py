"""``ivtools warm``: compile now what is else compiled when it is first used."""

from __future__ import annotations

from time import perf_counter

from ivtools.cli import options
from ivtools.cli.output import progress, show, write_json


def warm(json: options.Json = None) -> None:
    """Compile the simulations and keep them, so that nothing waits for it later."""
    from ivtools.compiled import folder
    from ivtools.tables import table

    seconds = {}
    with progress("compiling", len(STEPS)) as advance:
        for step in STEPS:
            what, start = str(step.__doc__).rstrip("."), perf_counter()
            step()
            seconds[what] = round(perf_counter() - start, 2)
            advance(f"{what}: done")
    write_json({"seconds": seconds, "folder": str(folder())}, json)
    rows = [[what, f"{value:.1f}"] for what, value in seconds.items()]
    notes = [f"kept in {folder()}", "what had been compiled before was only loaded"]
    show(table("Compiled", [], ["what", "s"], rows, notes, left=1), json_file=json)


def _axis() -> None:
    """Loop of one axis."""
    from ivtools import axes, datasets

    loop, record = axes.emps(), datasets.twin().slice(0, 400)
    loop.simulate(record, {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": 0.0})


def _law() -> None:
    """Control laws that integrate."""
    import numpy as np

    from ivtools.loop import Controller

    law, inputs = Controller("pid", {"kp": 1.0, "ki": 1.0, "kd": 0.1}).law(1e-3), np.ones((400, 5))
    law.command(inputs, law.settled(inputs[0]))


def _transfer_function() -> None:
    """Transfer functions."""
    from ivtools import axes, datasets
    from ivtools.estimators import SRIVC
    from ivtools.problem import Problem

    SRIVC(poles=2, input="q_ref").fit(Problem(datasets.twin().slice(0, 5000), axes.emps()))


def _robot() -> None:
    """Loop of a robot."""
    import numpy as np

    from ivtools.loop import ClosedLoop, Controller, RobotLoop
    from ivtools.physics import find
    from ivtools.record import Record
    from ivtools.robot import Robot

    pd = Controller("pd", {"kp": 2000.0, "kd": 100.0})
    friction = {"viscous": 5.0, "coulomb": 4.0, "offset": 0.0}
    axis = ClosedLoop(pd, 1.0, find(friction), joint="revolute", start=friction)
    t = np.linspace(0.0, 0.399, 400)
    q = 0.1 * np.repeat(np.sin(6.0 * t)[:, None], 6, axis=1)
    loop = RobotLoop(Robot.six_axis(), [axis] * 6)
    record = Record(t, q=q, q_ref=q, nu=q)
    loop.simulate(record)
    loop.robot.torques(q, q, q), loop.robot.regressor(q, q, q)


#: What there is to compile, the largest first; each says what it is.
STEPS = (_axis, _robot, _law, _transfer_function)
