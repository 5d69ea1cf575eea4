"""The closed loop of a robot: what it shares with one axis, and what joints do to each other."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from robots import axis, one_joint, plan, reference, six_loop, two_axes, two_joints
from scipy.integrate import solve_ivp
from scipy.stats import special_ortho_group

import ivtools as iv
from ivtools.errors import AxisError, ShapeError
from ivtools.pipeline import Motion
from ivtools.robot.robot import Joint, Place, Robot

PLAIN = {"viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
EFFECTS = {
    "none": {},
    "stribeck": {"force": 10.0, "speed": 0.01, "exponent": 2.0},
    "cogging": {"cosine": 3.0, "sine": 1.0, "period": 0.01},
    "presliding": {"stiffness": 1e6, "damping": 100.0},
    "drive-timing": {"delay": 0.0004, "lag": 0.0006},
    "load-friction": {"ratio": 0.05},
    "position-friction": {"slope": 10.0, "curvature": 1.0},
    "torque-ripple": {"cosine": 0.05, "sine": 0.02, "period": 0.02},
    "drive-asymmetry": {"gain": 0.02},
    "dead-zone": {"force": 3.0},
    "encoder-eccentricity": {"cosine": 1e-4, "sine": 1e-4, "period": 0.01},
    "saturation": {"limit": 1.0},
    "controller-mismatch": {"kp": 0.1, "kv": -0.1, "velocity_filter": 0.1, "added": 0.1},
    "spring": {"stiffness": 100.0},
    "friction-drift": {"coulomb_rate": 0.3, "viscous_rate": 2.0},
    "polynomial-viscous": {"quadratic": 30.0, "cubic": 10.0},
    "sqrt-viscous": {"force": 5.0},
    "asymmetric-viscous": {"delta": -30.0},
    "offset-drift": {},
}


@pytest.fixture(scope="module")
def twin():
    return iv.datasets.twin()


def alone(loop):
    """The loop without its inertia, which is the robot's."""
    start = {k: v for k, v in loop.start.items() if k != "inertia"}
    return replace(loop, terms=loop.terms[1:], start=start)


@pytest.mark.parametrize("effect", EFFECTS)
def test_one_joint_is_one_axis(twin, effect):
    loop, theta = iv.axes.emps().with_terms("inertia", *PLAIN), {"inertia": 95.0, **PLAIN}
    if effect != "none":
        loop = loop.with_effect(effect, **EFFECTS[effect])
    own = alone(loop)
    robot = iv.RobotLoop(one_joint(95.0), [own])
    values = {"M1": 95.0, **{f"joint.{name}": value for name, value in PLAIN.items()}}
    one, many = loop.simulate(twin, theta), robot.simulate(twin, values)
    for signal, share in (("q", 1e-9), ("dq", 1e-9), ("ddq", 1e-8), ("nu", 1e-8)):
        a, b = getattr(one, signal), getattr(many, signal)
        np.testing.assert_allclose(b, a, atol=share * np.abs(a).max(), err_msg=signal)


def test_a_load_opposes_the_drive_on_one_axis_and_on_a_robot(twin):
    loop, theta = iv.axes.emps().with_terms("inertia", *PLAIN), {"inertia": 95.0, **PLAIN}
    t = twin.t[:, None]
    loaded = twin.replace(load=5.0 * np.sin(3.0 * t))
    pushed = loop.simulate(twin, theta, force_noise=-5.0 * np.sin(3.0 * t))
    np.testing.assert_array_equal(loop.simulate(loaded, theta).q, pushed.q)
    robot = iv.RobotLoop(one_joint(95.0), [alone(loop)])
    values = {"M1": 95.0, **{f"joint.{name}": value for name, value in PLAIN.items()}}
    np.testing.assert_allclose(robot.simulate(loaded, values).q, pushed.q, atol=1e-9)


def test_friction_that_grows_with_the_load_is_of_what_the_drive_transmits(twin):
    """A force from outside does not pass the gear."""
    t, mu = twin.t[:, None], 0.05
    loop = iv.axes.emps().with_terms("inertia", *PLAIN, "load-friction")
    loaded = twin.replace(load=20.0 * np.sin(3.0 * t))
    values = {"inertia": 95.0, **PLAIN, "load-friction.ratio": mu}
    sim = loop.simulate(loaded, values)
    q, dq, ddq, tau = (x[:, 0] for x in (sim.q, sim.dq, sim.ddq, sim.tau))
    sign = np.sign(dq)
    asked = 95.0 * ddq + PLAIN["viscous"] * dq + PLAIN["coulomb"] * sign + PLAIN["offset"]
    left = tau - loaded.load[:, 0] - mu * np.abs(tau) * sign - asked
    moving = (np.abs(dq) > 1e-3) & (np.arange(len(q)) > 10)
    assert np.abs(left[moving]).max() < 1e-6 * np.abs(tau).max()


# --- mechanics ---


def free(n, seconds=3.0, dt=1e-3):
    """An open-loop record without torques worth the name."""
    t = np.arange(round(seconds / dt)) * dt
    q = np.zeros((len(t), n)) + 0.1 * np.sin(t)[:, None]
    return iv.Record(t, q=q, nu=1e-15 * np.sin(np.outer(t, np.ones(n))))


def heights(robot, q):
    """Return the heights of the links' centres of mass times their masses, summed."""
    up, total = -np.asarray(robot.gravity), np.zeros(len(q))
    for k, angles in enumerate(q):
        frames = []
        for joint, angle, phi in zip(robot.joints, angles, robot.inertias, strict=True):
            T = np.eye(4)
            c, s = np.cos(angle), np.sin(angle)
            T[:3, :3] = joint.rotation @ [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
            T[:3, 3] = joint.position
            frames.append((frames[joint.parent] if joint.parent >= 0 else np.eye(4)) @ T)
            total[k] += up @ (frames[-1] @ [*phi[1:4], phi[0]])[:3]
    return total


def test_energy_stays_without_friction():
    robot = two_joints()
    loop = iv.RobotLoop(robot, [axis(None, None, ("viscous",), viscous=0.0)] * 2)
    sim = loop.simulate(free(2), initial=((0.3, -0.5), (1.0, 2.0)), substeps=4)
    M = robot.mass_matrix(sim.q)
    energy = 0.5 * np.einsum("ki,kij,kj->k", sim.dq, M, sim.dq) + heights(robot, sim.q)
    assert np.ptp(energy) < 1e-5 * np.ptp(heights(robot, sim.q))


def test_angular_momentum_stays_without_gravity():
    arm = iv.Robot.six_axis()
    loop = iv.RobotLoop(
        replace(arm, gravity=(0.0, 0.0, 0.0)), [axis(None, None, ("viscous",), viscous=0.0)] * 6
    )
    start = ((0.1, 0.5, -0.4, 0.2, 0.6, 0.0), (0.5, -0.3, 0.8, 1.0, -0.7, 2.0))
    sim = loop.simulate(free(6), initial=start, substeps=4)
    momentum = np.einsum("kj,kj->k", arm.mass_matrix(sim.q)[:, 0], sim.dq)
    assert np.ptp(momentum) < 1e-6 * abs(momentum[0])


def exact(loop, record, q0):
    """Integrate two joints with dry friction by solve_ivp, events and all modes tried."""
    values, n = loop.values(), 2
    fv, fc, off = (
        np.array([values[f"{j}.{k}"] for j in loop.joints])
        for k in ("viscous", "coulomb", "offset")
    )
    robot, phi = loop.robot, loop.inertias()

    def dynamics(q, v, tau, s):
        zero = np.zeros(n)
        bias = robot.torques(q, v, zero, phi)[0]
        M = robot.mass_matrix(q, phi)[0]
        moving = s != 0
        a = np.zeros(n)
        force = tau - bias - fc * s - fv * v - off
        if moving.any():
            a[moving] = np.linalg.solve(M[np.ix_(moving, moving)], force[moving])
        return a, force - M @ a

    def mode(q, v, tau):
        resting = np.flatnonzero(v == 0.0)
        for choice in product((0.0, 1.0, -1.0), repeat=len(resting)):
            s = np.sign(v)
            s[resting] = choice
            a, left = dynamics(q, v, tau, s)
            fits = [
                abs(left[j]) <= fc[j] * (1 + 1e-12) if s[j] == 0 else s[j] * a[j] > 0
                for j in resting
            ]
            if all(fits):
                return s
        raise AssertionError("no mode fits")

    def reversal(j, s, v):
        def event(_, x):
            return s[j] * x[n + j] + (1e-13 if v[j] == 0.0 else 0.0)

        event.terminal, event.direction = True, -1
        return event

    def breakaway(j, s, tau):
        def event(_, x):
            return fc[j] - abs(dynamics(x[:n], x[n:], tau, s)[1][j])

        event.terminal, event.direction = True, -1
        return event

    q, v, out = np.array(q0, dtype=float), np.zeros(n), []
    for k in range(record.n_samples):
        out.append(q.copy())
        t, tau = 0.0, record.nu[k]
        while t < record.dt - 1e-15:
            s = mode(q, v, tau)
            events = [reversal(j, s, v) if s[j] else breakaway(j, s, tau) for j in range(n)]
            done = solve_ivp(
                lambda _, x, s=s, tau=tau: np.append(x[n:], dynamics(x[:n], x[n:], tau, s)[0]),
                (t, record.dt),
                np.append(q, v),
                events=events,
                rtol=1e-11,
                atol=1e-13,
            )
            t, x = done.t[-1], done.y[:, -1]
            q, v = x[:n], x[n:]
            for j in range(n):
                if s[j] == 0 or len(done.t_events[j]):
                    v[j] = 0.0
    return np.array(out)


def test_stiction_of_two_joints_is_that_of_an_integrator_with_events():
    t = np.arange(400) * 2e-3
    nu = np.column_stack([1.4 * np.sin(9.0 * t), 0.8 * np.sin(14.0 * t + 1.0)])
    record = iv.Record(t, q=np.column_stack([0.1 * np.sin(t), 0.1 * np.cos(t)]), nu=nu)
    axes = [axis(None, None, viscous=0.05, coulomb=c, offset=0.01) for c in (0.9, 0.5)]
    loop, start = iv.RobotLoop(two_joints(), axes), (-1.5, 0.1)
    truth = exact(loop, record, start)
    sim = loop.simulate(record, initial=(start, (0.0, 0.0)), substeps=8)
    assert (sim.dq[:, 0] == 0.0).sum() > 5 and (sim.dq[:, 1] == 0.0).sum() > 5  # both have held
    np.testing.assert_allclose(sim.q, truth, atol=2e-6)
    plain = loop.simulate(record, initial=(start, (0.0, 0.0)))
    assert np.abs(plain.q - truth).max() < 1e-4


def test_a_finer_step_changes_next_to_nothing():
    loop, record = six_loop(), plan(*reference(3.0))
    coarse, fine = (loop.simulate(record, initial="rest", substeps=n) for n in (1, 8))
    np.testing.assert_allclose(coarse.q, fine.q, atol=1e-7)


def test_six_joints_follow():
    loop, record = six_loop(), plan(*reference(10.0))
    sim = loop.simulate(record, initial="rest")
    assert np.abs(sim.q - record.q_ref).max() < 0.1


def test_a_transmission_moves_torques_and_positions():
    """A coupled wrist: what the drives do is what the joints do, through the matrix."""
    T = np.array([[1.0, 0.0], [-0.5, 1.0]])
    robot = two_joints()
    loop = iv.RobotLoop(robot, [axis(None, None, ("viscous",), viscous=0.0)] * 2, transmission=T)
    plain = iv.RobotLoop(robot, [axis(None, None, ("viscous",), viscous=0.0)] * 2)
    record = free(2, 1.0)
    nu = np.column_stack([np.sin(5.0 * record.t), 0.3 * np.cos(3.0 * record.t)])
    q0, v0 = np.array([0.2, 0.4]), np.array([0.5, -0.3])
    drives = loop.simulate(record.replace(nu=nu), initial=(q0, v0))
    joints = plain.simulate(record.replace(nu=nu @ np.linalg.inv(T)), initial=(T @ q0, T @ v0))
    np.testing.assert_allclose(drives.q @ T.T, joints.q, atol=1e-6)
    names = loop.names
    theta = np.array([loop.values()[name] for name in names])
    X = loop.regressor(drives.motion)
    np.testing.assert_allclose((X @ theta)[0], nu[:, 0], atol=1e-6)


def test_the_regressor_gives_the_force():
    loop, record = six_loop(), plan(*reference(2.0))
    sim = loop.simulate(record, initial="rest")
    theta = np.array([loop.values()[name] for name in loop.names])
    X = loop.regressor(sim.motion)
    moving = np.abs(sim.dq) > 1e-3
    for j in range(6):
        error = (X[j] @ theta - sim.tau[:, j])[moving[:, j]]
        assert np.abs(error).max() < 1e-6 * np.abs(sim.tau[:, j]).max()


# --- what is at fault ---


@pytest.mark.parametrize("seed", range(12))
def test_the_mass_matrix_is_that_of_the_parameters(seed):
    """Whatever is regrouped: of a slide along gravity the drive's inertia is, with its offset."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 5))
    kinds = rng.choice(["revolute", "prismatic"], n)
    turns = [np.eye(3) if rng.uniform() < 0.5 else special_ortho_group.rvs(3, random_state=rng)
             for _ in range(n)]  # fmt: skip
    joints = tuple(
        Joint(f"j{k}", f"l{k}", str(kinds[k]), k - 1, turns[k], rng.normal(0.0, 0.2, 3))
        for k in range(n)
    )
    places = {f"l{k}": Place(k, np.eye(3), np.zeros(3)) for k in range(n)}
    phi = np.abs(rng.normal(size=(n, 10))) * [1.0, *[0.1] * 3, *[0.05] * 6]
    robot = Robot("some", joints, phi, (0.0, 0.0, -9.81), places)
    terms = ("inertia", "viscous", "coulomb", "offset")
    drives = [axis(1.0, 0.1, terms, inertia=rng.uniform(1, 9)) for _ in kinds]
    axes = [replace(a, joint=str(kind)) for a, kind in zip(drives, kinds, strict=True)]
    loop = iv.RobotLoop(robot, axes)
    q, ddq = rng.normal(size=(2, 50, n))
    theta = list(loop.values().values())
    moved, still = (loop.regressor(Motion(q, 0.0 * q, a)) @ theta for a in (ddq, 0.0 * ddq))
    M = loop.mass_matrix(q, loop.values())
    np.testing.assert_allclose(np.einsum("kij,kj->ki", M, ddq), (moved - still).T, atol=1e-9)


def test_an_indefinite_mass_matrix_is_refused():
    loop = six_loop()
    theta = loop.values() | {"ZZ6": -10.0, "joint_6.inertia": 0.0}
    with pytest.raises(AxisError, match="not positive definite"):
        loop.simulate(plan(*reference(1.0)), theta)


def test_axes_and_records_must_fit_the_joints(twin):
    with pytest.raises(AxisError, match="1 axes for 2 joints \\(shoulder, elbow\\)"):
        iv.RobotLoop(two_joints(), [axis(1.0, 1.0)])
    with pytest.raises(ShapeError, match="the record has 1 joints and robot"):
        six_loop().force(twin)
    with pytest.raises(AxisError, match="joint shoulder: backlash makes two masses"):
        iv.RobotLoop(two_joints(), [axis(1.0, 1.0, ("viscous", "backlash"))] * 2)
    with pytest.raises(AxisError, match="invertible"):
        iv.RobotLoop(two_joints(), two_axes(), transmission=np.ones((2, 2)))
    with pytest.raises(AxisError, match="no joint 'wrist'; its joints: shoulder, elbow"):
        iv.RobotLoop(two_joints(), two_axes()).with_effect("wrist", "stribeck")
