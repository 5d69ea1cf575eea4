"""The linear pass against a simulation per parameter."""

import numpy as np
import pytest
from robots import plan, reference, two_axes, two_joints

import ivtools as iv
from ivtools.loop import robot_sensitivity


def differences(loop, record, values, now):
    """Return the change of every command by a small step of each parameter, over the step."""
    out = []
    for name in loop.names:
        step = 1e-5 * max(abs(values[name]), 0.1)
        then = loop.simulate(record, {**values, name: values[name] + step}, initial="rest").tau
        out.append((then - now) / step)
    return np.stack(out, axis=2).transpose(1, 0, 2)


@pytest.mark.parametrize(("friction", "within"), [(False, 0.01), (True, 0.2)])
def test_one_pass_is_as_good_as_a_simulation_per_parameter(friction, within):
    loop = iv.RobotLoop(two_joints(), two_axes(friction=friction))
    record = plan(*reference(4.0, n=2, seed=3))
    values = loop.values()
    simulation = loop.simulate(record, values, initial="rest")
    found = robot_sensitivity.answers(loop, record, values, simulation)
    right = differences(loop, record, values, simulation.tau)
    error, size = (np.linalg.norm(x[:, 100:], axis=1) for x in (found - right, right))
    felt = size > 1e-2 * size.max(axis=1, keepdims=True)
    assert np.median(error[felt] / size[felt]) < within
    assert felt.sum() > len(loop.names)


def test_delays_and_lags_of_drives_are_in_it():
    loop = iv.RobotLoop(two_joints(), two_axes(friction=False))
    late = loop.with_effect("elbow", "drive-timing", delay=1.5e-3, lag=2e-3)
    record = plan(*reference(3.0, n=2, seed=5))
    values, k = late.values(), list(late.names).index("ZZ2")
    simulation = late.simulate(record, values, initial="rest")
    found = robot_sensitivity.answers(late, record, values, simulation)
    right = differences(late, record, values, simulation.tau)[1, 100:, k]
    without = robot_sensitivity.answers(loop, record, loop.values(), simulation)
    errors = [np.linalg.norm(x[1, 100:, k] - right) for x in (found, without)]
    assert errors[0] < 0.02 * np.linalg.norm(right) and errors[0] < 0.5 * errors[1]
