"""The natural frequency that the filters come from, against python-control."""

from dataclasses import replace

import control
import numpy as np
import pytest

from ivtools import axes
from ivtools.loop.mode import dominant_mode_hz, transition

DT = 1e-3


@pytest.mark.parametrize("delay", [0, 1, 3])
@pytest.mark.parametrize("viscous", [0.0, 200.0])
def test_the_poles_are_those_of_the_linear_loop(delay, viscous):
    emps = axes.emps()
    loop = replace(emps, controller=replace(emps.controller, delay=delay))
    kp, kv = (loop.controller.settings[key] for key in ("kp", "kv"))
    plant = control.ss([[0, 1], [0, -viscous / 95]], [[0], [loop.gain / 95]], [[1, 0]], 0)
    z = control.tf([1, 0], [1], DT)
    velocity = 0.5 * (1 - z**-2) / DT  # the two-tap filter, then the backward difference
    law = (kp * kv + kv * velocity) * z**-delay
    closed = control.feedback(control.ss2tf(control.c2d(plant, DT)), law)
    expected = np.sort(np.abs(closed.poles()))
    ours = np.sort(np.abs(np.linalg.eigvals(transition(loop, 95.0, viscous, DT))))
    assert ours[-3:] == pytest.approx(expected[-3:], rel=1e-6)


def test_a_whole_sample_of_delay_is_the_same_in_the_drive_and_in_the_controller():
    emps = axes.emps()
    drive = replace(emps, delay=DT)
    law = replace(emps, controller=replace(emps.controller, delay=emps.controller.delay + 1))
    assert dominant_mode_hz(drive, 95.0, 200.0, DT) == pytest.approx(
        dominant_mode_hz(law, 95.0, 200.0, DT), rel=1e-9
    )


def test_a_fraction_of_a_sample_lies_between_whole_ones():
    emps = axes.emps()
    hz = [dominant_mode_hz(replace(emps, delay=d * DT), 95.0, 200.0, DT) for d in (0.0, 0.5, 1.0)]
    assert hz == sorted(hz)
    assert dominant_mode_hz(emps, 100.0, 0.0, DT) == pytest.approx(21.0386, abs=1e-3)
