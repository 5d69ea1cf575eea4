"""Angles that count otherwise than the model: said of the joint, and of no other."""

import re
from dataclasses import replace

import numpy as np
import pytest
from robots import plan, reference, six_loop, two_axes, two_joints

import ivtools as iv
from ivtools.loop.encoders import doubts


def measured(loop, seed, seconds=8.0):
    t, q_ref = reference(seconds, n=loop.n_joints, seed=seed)
    rng = np.random.default_rng(seed)
    sim = loop.simulate(
        plan(t, q_ref), initial="rest", position_noise=5e-5 * rng.standard_normal(q_ref.shape)
    )
    return iv.Record(t, q=sim.q, q_ref=q_ref, nu=sim.nu)


def counted(record, j, sign=1.0, shift=0.0):
    """The record of an encoder that counts otherwise."""
    parts = {}
    for name in ("q", "q_ref"):
        x = getattr(record, name).copy()
        x[:, j] = sign * (x[:, j] - shift)
        parts[name] = x
    return record.replace(**parts)


def drawn(loop, seed):
    """A robot whose links are not those of the file."""
    rng = np.random.default_rng(seed)
    phi = loop.robot.inertias * rng.uniform(0.7, 1.3, (loop.n_joints, 1))
    return replace(loop, robot=replace(loop.robot, inertias=phi))


def two_loop():
    return iv.RobotLoop(two_joints(), two_axes())


@pytest.mark.parametrize("seed", range(6))
def test_healthy_robots_raise_no_doubt(seed):
    for loop in (two_loop(), six_loop()):
        wide = replace(loop, robot=_unlimited(loop.robot))
        assert doubts(wide, measured(drawn(loop, seed), seed)) == []


def _unlimited(robot):
    free = {"lower": -np.inf, "upper": np.inf, "speed": np.inf, "effort": np.inf}
    joints = tuple(replace(j, **free) for j in robot.joints)
    return replace(robot, joints=joints)


@pytest.mark.parametrize(
    ("joint", "change", "words"),
    [
        (1, {"sign": -1.0}, "counted the other way"),
        (2, {"shift": 0.5 * np.pi}, r"turned by \+90 degrees"),
        (1, {"shift": np.pi}, "turned by 180 degrees"),
        (2, {"sign": -1.0}, "counted the other way"),
    ],
)
def test_the_joint_is_named(joint, change, words):
    loop = six_loop()
    wide = replace(loop, robot=_unlimited(loop.robot))
    said = doubts(wide, counted(measured(drawn(loop, 1), 1), joint, **change))
    assert len(said) == 1 and said[0].startswith(f"joint_{joint + 1}:")
    assert re.search(words, said[0])


def test_positions_beyond_the_range_are_said():
    loop = six_loop()
    said = doubts(loop, counted(measured(loop, 0), 1, shift=-2.5))
    assert any("joint_2: positions" in s and "beyond its range, -2 to 2 rad" in s for s in said)


def test_speeds_and_forces_beyond_their_limits_are_said():
    loop = six_loop()
    record = measured(loop, 0)
    wide = _unlimited(loop.robot)
    slow = (wide.joints[0], replace(wide.joints[1], speed=0.1), *wide.joints[2:4])
    weak = (replace(wide.joints[4], effort=1.0), wide.joints[5])
    said = doubts(replace(loop, robot=replace(wide, joints=(*slow, *weak))), record)
    assert len(said) == 2
    assert re.match(r"joint_2: speeds up to .* rad/s are beyond its limit, 0.1 rad/s", said[0])
    assert re.match(r"joint_5: forces up to .* N m are beyond its limit, 1 N m", said[1])
