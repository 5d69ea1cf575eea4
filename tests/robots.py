"""Robots and loops that several tests share."""

import numpy as np

import ivtools as iv
from ivtools.loop import Controller
from ivtools.robot.robot import Joint, Place, Robot


def one_joint(inertia, kind="prismatic"):
    """A robot with one joint that gravity does not move."""
    phi = np.zeros((1, 10))
    phi[0, 0 if kind == "prismatic" else 9] = inertia
    joint = Joint("joint", "link", kind, -1, np.eye(3), np.zeros(3))
    gravity = (-9.81, 0.0, 0.0) if kind == "prismatic" else (0.0, 0.0, -9.81)
    places = {"link": Place(0, np.eye(3), np.zeros(3))}
    return Robot("one", (joint,), phi, gravity, places)


def two_joints(gravity=(0.0, -9.81, 0.0)):
    """An arm of two links in the plane that gravity acts in."""
    first = Joint("shoulder", "upper", "revolute", -1, np.eye(3), np.zeros(3))
    second = Joint("elbow", "lower", "revolute", 0, np.eye(3), np.array([0.3, 0.0, 0.0]))
    phi = np.zeros((2, 10))
    phi[0, [0, 1, 4, 7, 9]] = 0.6, 0.15, 0.001, 0.05, 0.05
    phi[1, [0, 1, 4, 7, 9]] = 0.5, 0.09, 0.001, 0.02, 0.02
    places = {"upper": Place(0, np.eye(3), np.zeros(3)), "lower": Place(1, np.eye(3), np.zeros(3))}
    return Robot("two", (first, second), phi, gravity, places)


def axis(kp, kd, terms=("viscous", "coulomb", "offset"), **start):
    controller = Controller("none", {}) if kp is None else Controller("pd", {"kp": kp, "kd": kd})
    return iv.ClosedLoop(controller, 1.0, terms, joint="revolute", start=start)


def two_axes(kp=(40.0, 20.0), kd=(4.0, 1.5), friction=True):
    terms = ("viscous", "coulomb", "offset")
    values = [
        {"viscous": 0.05, "coulomb": 0.1, "offset": 0.01},
        {"viscous": 0.03, "coulomb": 0.15, "offset": -0.02},
    ]
    start = values if friction else [dict.fromkeys(v, 0.0) for v in values]
    return [axis(p, d, terms, **s) for p, d, s in zip(kp, kd, start, strict=True)]


SIX_GAINS = ((3000.0, 3000.0, 2000.0, 800.0, 600.0, 300.0), (200.0, 220.0, 120.0, 25.0, 18.0, 6.0))
SIX_TERMS = ("inertia", "viscous", "coulomb", "offset")


def six_loop(terms=SIX_TERMS):
    """The generic arm with drives, frictions and a controller per joint."""
    values = zip(
        (1.0, 1.0, 0.6, 0.2, 0.2, 0.1),
        (8.0, 8.0, 6.0, 2.0, 2.0, 1.0),
        (6.0, 6.0, 5.0, 2.0, 1.5, 1.0),
        strict=True,
    )
    axes = []
    for kp, kd, (inertia, viscous, coulomb) in zip(*SIX_GAINS, values, strict=True):
        start = {"inertia": inertia, "viscous": viscous, "coulomb": coulomb, "offset": 0.3}
        axes.append(axis(kp, kd, terms, **start))
    return iv.RobotLoop(iv.Robot.six_axis(), axes)


def reference(seconds, dt=1e-3, n=6, seed=0, size=0.25):
    """Sums of sines, at 0.1 to 0.8 Hz, that begin at 0."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds / dt)) * dt
    q = np.zeros((len(t), n))
    for h in range(1, 9):
        w = 2.0 * np.pi * 0.1 * h
        a, b = rng.standard_normal((2, n)) * size / np.sqrt(h)
        q += np.sin(w * t)[:, None] * a + (np.cos(w * t) - 1.0)[:, None] * b
    return t, q


def plan(t, q_ref):
    """A record that holds a reference and nothing else of use."""
    rng = np.random.default_rng(0)
    return iv.Record(t, q=q_ref, q_ref=q_ref, nu=rng.standard_normal(q_ref.shape))
