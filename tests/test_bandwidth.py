"""The bandwidth that the filters come from, against python-control on drawn axes."""

import sys
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest

from ivtools import axes
from ivtools.loop.bandwidth import axis_response, bandwidth_hz

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.axes.population import population  # noqa: E402

DT = 1e-3
DRAWN = population(16, seed=11)


def crossed(case):
    """Return the crossover of a case's loop, Hz, and its sampling step."""
    dt, theta = 1.0 / case.sampling_hz, case.theta
    return bandwidth_hz(case.loop, theta["inertia"], theta["viscous"], dt), dt


def closed(case, dt):
    """Return the python-control system of a case without dry friction, linear at standstill."""
    rigid = {name: case.theta[name] for name in ("inertia", "viscous")}
    system = case.loop.with_terms(*rigid).system(rigid, dt=dt)
    return control.linearize(system, np.zeros(system.nstates), np.zeros(3))


@pytest.mark.parametrize("case", DRAWN[:8], ids=lambda case: case.name)
def test_the_responses_are_those_of_python_control(case):
    """From the added command, q = P / (1 - P C z^-delay), with the law C on the position."""
    dt, theta = 1.0 / case.sampling_hz, case.theta
    z = np.exp(2j * np.pi * np.geomspace(1e-4, 0.45, 30))
    P = case.loop.gain * axis_response(theta["inertia"], theta["viscous"], case.loop.delay, dt, z)
    C = case.loop.controller.law(dt).response(z) * z**-case.loop.controller.delay
    expected = np.array([closed(case, dt)[0, 2](point) for point in z])
    np.testing.assert_allclose(P / (1.0 - P * C), expected, rtol=1e-5)


@pytest.mark.parametrize("case", DRAWN, ids=lambda case: case.name)
def test_it_lies_by_the_bandwidth_from_reference_to_position(case):
    """Within a factor of 2, more where a delay eats the phase; integral action or not."""
    hz, dt = crossed(case)
    grid = np.geomspace(0.01, 10.0, 400) * hz
    inputs = closed(case, dt)
    z = np.exp(2j * np.pi * grid[grid < 0.5 / dt] * dt)
    from_speed = (z - 1.0 / z) / (2.0 * dt)  # the velocity reference is that of the position's
    answer = np.abs(
        [inputs[0, 0](p) + s * inputs[0, 1](p) for p, s in zip(z, from_speed, strict=True)]
    )
    found = grid[int(np.argmax(answer < np.sqrt(0.5) * answer[0]))]
    assert 0.5 < found / hz < 2.5


def test_the_axis_of_the_report_keeps_its_20_hz():
    emps = axes.emps()
    for inertia in (92.0, 95.0, 100.0, 110.0):
        assert f"{bandwidth_hz(emps, inertia, 200.0, DT):.0e}" == "2e+01"


def test_delays_do_not_move_the_crossover():
    emps = axes.emps()
    loops = [replace(emps, delay=d * DT) for d in (0.0, 0.5, 1.0)]
    loops.append(replace(emps, controller=replace(emps.controller, delay=2)))
    found = [bandwidth_hz(loop, 95.0, 200.0, DT) for loop in loops]
    assert found == pytest.approx([found[0]] * 4, rel=0.01)


def test_a_loop_that_does_nothing_has_none():
    emps = axes.emps()
    weak = replace(emps, gain=1e-12)
    assert np.isnan(bandwidth_hz(weak, 95.0, 200.0, DT))
