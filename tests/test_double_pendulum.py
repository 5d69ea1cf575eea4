"""A measured robot: the double pendulum, where its records are."""

import os
from pathlib import Path

import numpy as np
import pytest

import ivtools as iv
from benchmarks.double_pendulum import OWNERS, errors, loop, owners
from ivtools.robot.consistent import possible

FOLDER = Path(os.environ.get("IVTOOLS_DATA", "nowhere")) / "dfki-double-pendulum"
URDF = FOLDER / "pendubot.urdf"
pytestmark = pytest.mark.skipif(not URDF.exists(), reason="the record is not on this machine")


@pytest.fixture(scope="module")
def problem():
    record, robot = iv.datasets.load("dfki-double-pendulum"), loop(str(URDF))
    return iv.Problem(record, robot, robot.pipeline(record, cutoff_hz=10.0))


def test_instruments_converge_to_a_robot_nearer_to_the_record_than_its_owners(problem):
    fit = iv.IDIMIV().fit(problem)
    assert fit.converged
    ours = errors(problem, dict(fit.params))
    for stated in OWNERS.values():
        theirs = errors(problem, owners(*stated, problem.names))
        assert all(a < 0.6 * b for a, b in zip(ours, theirs, strict=True))
    assert fit.params["MX2"] == pytest.approx(-0.111, abs=0.012)  # between the owners' two
    phi = problem.loop.consistent(dict(fit.params), problem.X)
    assert possible(phi[:20].reshape(-1, 10), 1e-6)
    left = np.array(
        errors(problem, dict(zip(problem.names, problem.loop.base.matrix @ phi, strict=True)))
    )
    assert (left < 1.3 * np.array(ours)).all()
