"""Robots: what is read of a file, and their dynamics beside Pinocchio's."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

import ivtools as iv
from ivtools.robot.base import base_parameters, random_motion
from ivtools.robot.consistent import nearest, possible
from ivtools.robot.inertia import standard

pin = pytest.importorskip("pinocchio")

DATA = Path(pin.__file__).parents[4] / "share" / "example-robot-data" / "robots"
URDFS = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", None),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", None),
    "z1": ("z1_description/urdf/z1.urdf", None),
    "panda": ("panda_description/urdf/panda.urdf", [f"panda_joint{i}" for i in range(1, 8)]),
    "two": ("double_pendulum_description/urdf/double_pendulum.urdf", None),
    "lift": ("tiago_description/robots/tiago_no_hand.urdf", None),
    "finger": ("finger_edu_description/robots/finger_edu.urdf", None),
    "tree": ("allegro_hand_description/urdf/allegro_right_hand.urdf", None),
}


def files():
    for name, (path, joints) in URDFS.items():
        if (DATA / path).exists():
            yield pytest.param(DATA / path, joints, id=name)


def oracle(path, robot):
    """Pinocchio's model with the same joints, gravity, and order."""
    model = pin.buildModelFromUrdf(str(path))
    locked = [i for i in range(1, model.njoints) if model.names[i] not in robot.names]
    if locked:
        model = pin.buildReducedModel(model, locked, pin.neutral(model))
    order = [model.getJointId(name) for name in robot.names]
    return model, model.createData(), order


def configuration(model, order, q):
    """Pinocchio's q, in which an unlimited joint is a cosine and a sine."""
    out = pin.neutral(model)
    for joint, angle in zip(order, q, strict=True):
        i = model.joints[joint].idx_q
        if model.joints[joint].nq == 2:
            out[i : i + 2] = np.cos(angle), np.sin(angle)
        else:
            out[i] = angle
    return out


@pytest.mark.parametrize(("path", "joints"), list(files()))
def test_dynamics_are_pinocchios(path, joints):
    robot = iv.Robot.from_urdf(path, joints)
    model, data, order = oracle(path, robot)
    rows = [model.joints[j].idx_v for j in order]
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-3, 3, (3, 1000, robot.n_joints))
    ours = robot.torques(q, dq, ddq)
    masses = robot.mass_matrix(q)
    weights = robot.gravity_torques(q)
    X = robot.regressor(q, dq, ddq)
    assert robot.n_joints == model.nv
    for k in range(len(q)):
        at = configuration(model, order, q[k])
        v, a = np.zeros((2, model.nv))
        v[rows], a[rows] = dq[k], ddq[k]
        tau = pin.rnea(model, data, at, v, a)[rows]
        np.testing.assert_allclose(ours[k], tau, rtol=1e-12, atol=1e-12 * np.abs(tau).max())
        np.testing.assert_allclose(
            weights[k],
            pin.computeGeneralizedGravity(model, data, at)[rows],
            atol=1e-12 * max(np.abs(tau).max(), 1e-3),
        )
        M = pin.crba(model, data, at)
        M = np.triu(M) + np.triu(M, 1).T
        np.testing.assert_allclose(
            masses[k], M[np.ix_(rows, rows)], atol=1e-12 * np.abs(M).max(), rtol=1e-12
        )
    np.testing.assert_allclose(
        X @ robot.inertias.ravel(), ours, rtol=1e-11, atol=1e-12 * np.abs(ours).max()
    )


@pytest.mark.parametrize(("path", "joints"), list(files()))
def test_regressor_is_pinocchios(path, joints):
    """Column by column: both are linear in the parameters, so random ones must agree."""
    robot = iv.Robot.from_urdf(path, joints)
    model, data, order = oracle(path, robot)
    rows = [model.joints[j].idx_v for j in order]
    rng = np.random.default_rng(1)
    q, dq, ddq = rng.uniform(-3, 3, (3, 20, robot.n_joints))
    X = robot.regressor(q, dq, ddq)
    for _ in range(10):
        phi = np.zeros((robot.n_joints, 10))
        for i, joint in enumerate(order):
            A = rng.standard_normal((4, 4))
            P = A @ A.T
            phi[i] = standard(P)
            m, h = P[3, 3], P[:3, 3]
            central = standard(P - np.outer(P[:, 3], P[:, 3]) / m)
            xx, xy, xz, yy, yz, zz = central[4:]
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            # Pinocchio's joint frame differs from ours by the turn that makes z the axis
            turn = alignment(robot, model, order, i)
            model.inertias[joint] = pin.Inertia(m, turn @ (h / m), turn @ tensor @ turn.T)
        data = model.createData()
        for k in range(len(q)):
            v, a = np.zeros((2, model.nv))
            v[rows], a[rows] = dq[k], ddq[k]
            tau = pin.rnea(model, data, configuration(model, order, q[k]), v, a)[rows]
            np.testing.assert_allclose(X[k] @ phi.ravel(), tau, atol=1e-12 * np.abs(tau).max())


def alignment(robot, model, order, i):
    """Return the turn from our frame of joint i to Pinocchio's, at joint positions 0."""
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    ours, j = np.eye(3), i
    while j >= 0:
        ours, j = robot.joints[j].rotation @ ours, robot.joints[j].parent
    return data.oMi[order[i]].rotation.T @ ours


def test_base_parameters_span_the_same_torques():
    robot = iv.Robot.six_axis()
    base = base_parameters(robot)
    q, dq, ddq = random_motion(robot, seed=5)
    X = robot.regressor(q, dq, ddq)
    theta = base.matrix @ robot.inertias.ravel()
    np.testing.assert_allclose(
        X[:, :, base.columns] @ theta, robot.torques(q, dq, ddq), rtol=1e-9, atol=1e-9
    )
    assert len(base.names) == 36
    assert base.formulas["ZZ1R"].startswith("ZZ1 + ")


def test_base_parameters_of_a_planar_arm_are_those_of_the_books():
    two = DATA / "double_pendulum_description/urdf/double_pendulum.urdf"
    base = base_parameters(iv.Robot.from_urdf(two))
    assert [name.rstrip("R") for name in base.names] == ["ZZ1", "MX1", "MY1", "ZZ2", "MX2", "MY2"]
    assert "M2" in base.formulas["ZZ1R"]


def test_the_nearest_consistent_robot_of_a_consistent_one_is_itself():
    robot = iv.Robot.six_axis()
    base = base_parameters(robot)
    theta = base.matrix @ robot.inertias.ravel()
    phi = nearest(base.matrix, theta, prior=robot.inertias.ravel())
    assert possible(phi.reshape(-1, 10))
    np.testing.assert_allclose(base.matrix @ phi, theta, atol=1e-5 * np.abs(theta).max())


def test_an_indefinite_estimate_is_made_consistent():
    robot = iv.Robot.six_axis()
    base = base_parameters(robot)
    theta = base.matrix @ robot.inertias.ravel()
    theta[base.names.index("ZZ6")] = -0.01
    phi = nearest(base.matrix, theta, prior=robot.inertias.ravel())
    assert possible(phi.reshape(-1, 10), 1e-7)
    M = robot.mass_matrix(random_motion(robot)[0][:50], phi)
    assert np.linalg.eigvalsh(M).min() > 0.0


def test_a_tool_is_felt_where_it_hangs():
    robot = iv.Robot.six_axis()
    tool = robot.with_tool("tool", 2.0, (0.0, 0.0, 0.1))
    q = np.zeros((1, 6))
    q[0, 1] = np.pi / 2
    more = tool.gravity_torques(q) - robot.gravity_torques(q)
    reach = 0.42 + 0.3 + 0.1 + 0.09 + 0.08 + 0.1
    assert more[0, 1] == pytest.approx(-2.0 * 9.81 * reach)
    links = tool.links()["flange"]
    assert links["mass"] == pytest.approx(3.0)


# --- files that are at fault ---

BODY = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1"/></inertial>'
LINK = '<link name="{}">' + BODY + "</link>"
JOINT = '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/>{}</joint>'


def urdf(tmp_path, *parts):
    file = tmp_path / "robot.urdf"
    file.write_text(f'<robot name="r">{"".join(parts)}</robot>')
    return file


def links(*names):
    return "".join(LINK.format(name) for name in names)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((links("a", "b"), JOINT.format("j", "floating", "a", "b", "")), "'j' is floating"),
        ((links("a", "b"), JOINT.format("j", "planar", "a", "b", "")), "'j' is planar"),
        (
            (links("a", "b", "c"), JOINT.format("j", "revolute", "a", "b", ""),
             JOINT.format("k", "revolute", "b", "c", '<mimic joint="j"/>')),
            "'k' mimics 'j'",
        ),
        (
            (links("a", "b", "c"), JOINT.format("j", "revolute", "a", "b", ""),
             JOINT.format("k", "revolute", "a", "c", ""),
             JOINT.format("m", "revolute", "b", "c", "")),
            "closed chains",
        ),
        ((links("a"), '<link name="b"/>', JOINT.format("j", "revolute", "a", "b", "")),
         "without inertia"),
        ((links("a", "b"),), "both|all bases"),
        ((links("a", "b"), JOINT.format("j", "fixed", "a", "b", "")), "no joint moves"),
        ((links("a"), JOINT.format("j", "revolute", "a", "b", "")), "'b', which does not exist"),
        ((links("a", "b"), JOINT.format("j", "revolute", "a", "b", '<axis xyz="0 0 nan"/>')),
         "3 finite numbers"),
        ((links("a", "b"), JOINT.format("j", "revolute", "a", "b", '<axis xyz="0 0 0"/>')),
         "give a direction"),
        ((links("a", "a"),), "'a' is there twice"),
        (("<x>" * 100 + "</x>" * 100,), "deeper than"),
        (("<unclosed>",), "not XML"),
    ],
)  # fmt: skip
def test_a_file_at_fault_is_refused_in_one_line(tmp_path, parts, message):
    with pytest.raises(iv.errors.AxisError, match=message) as caught:
        iv.Robot.from_urdf(urdf(tmp_path, *parts))
    assert "\n" not in str(caught.value)


def test_entities_are_refused_before_they_multiply(tmp_path):
    file = tmp_path / "bomb.urdf"
    file.write_text(
        '<!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;">]><robot name="&b;"/>'
    )
    with pytest.raises(iv.errors.AxisError, match="document type"):
        iv.Robot.from_urdf(file)


def test_a_missing_file_and_a_wrong_joint_are_named(tmp_path):
    with pytest.raises(iv.errors.AxisError, match="No such file"):
        iv.Robot.from_urdf(tmp_path / "none.urdf")
    file = urdf(tmp_path, links("a", "b"), JOINT.format("j", "revolute", "a", "b", ""))
    with pytest.raises(iv.errors.AxisError, match="no joint 'k' moves; those that do: j"):
        iv.Robot.from_urdf(file, ["k"])


# --- MuJoCo ---

MJCF = """
<mujoco><compiler angle="radian"/><worldbody><body name="a" pos="0 0 1" euler="0.3 0.2 0.1">
 <joint name="turn" axis="0 1 1" pos="0.1 0 0.2" armature="0.2" damping="0.5"/>
 <joint name="slide" type="slide" axis="1 0 0" pos="0 0.3 0" ref="0.4"/>
 <geom type="capsule" size="0.05" fromto="0 0 0 0.3 0.1 0"/>
 <body name="b" pos="0.3 0 0"><joint name="twist" axis="1 0.5 0" ref="-0.7"/>
 <geom type="box" size="0.1 0.05 0.02" pos="0.1 0.02 0.03"/></body>
</body></worldbody>{}</mujoco>
"""


def test_a_mujoco_model_moves_as_in_mujoco(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    file = tmp_path / "model.xml"
    file.write_text(MJCF.format(""))
    robot = iv.Robot.from_mjcf(file)
    model = mujoco.MjModel.from_xml_path(str(file))
    model.dof_damping[:] = 0.0
    data = mujoco.MjData(model)
    assert robot.names == ("turn", "slide", "twist")
    assert (robot.joints[0].armature, robot.joints[0].damping) == (0.2, 0.5)
    rng = np.random.default_rng(0)
    armature = np.array([joint.armature for joint in robot.joints])
    for q, dq, ddq in rng.uniform(-1, 1, (50, 3, 3)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        ours = robot.torques(q, dq, ddq)[0] + armature * ddq
        np.testing.assert_allclose(ours, data.qfrc_inverse, atol=1e-9)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ('<replicate count="300000"><geom size="0.1"/></replicate>', "more than 20000 elements"),
        ('<include file="more.xml"/>', "more than 20000 elements"),
        ('<replicate count="3000"><body><joint/><geom size="0.1"/></body></replicate>', "joints"),
    ],
)
def test_counts_of_a_mujoco_model_are_bounded(tmp_path, more, message):
    pytest.importorskip("mujoco")
    many = '<replicate count="200"><replicate count="200"><geom size="1"/></replicate></replicate>'
    (tmp_path / "more.xml").write_text(f"<mujocoinclude>{many}</mujocoinclude>")
    text = MJCF.format("").replace("</worldbody>", f"{more}</worldbody>")
    (tmp_path / "model.xml").write_text(text)
    with pytest.raises(iv.errors.AxisError, match=message):
        iv.Robot.from_mjcf(tmp_path / "model.xml")


def test_cells_of_a_mujoco_model_are_bounded(tmp_path):
    pytest.importorskip("mujoco")
    asset = '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>'
    (tmp_path / "model.xml").write_text(MJCF.format(asset))
    with pytest.raises(iv.errors.AxisError, match="1e.10 cells; at most"):
        iv.Robot.from_mjcf(tmp_path / "model.xml")


def test_what_mujoco_warns_of_is_said_and_no_file_is_left(tmp_path, monkeypatch):
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.xml").write_text(MJCF.format("").replace('damping="0.5"', 'damping="NaN"'))
    told = pytest.warns(iv.errors.IVToolsWarning, match="MuJoCo: XML contains a 'NaN'")
    with told, suppress(iv.errors.AxisError):
        iv.Robot.from_mjcf(tmp_path / "model.xml")
    assert [f.name for f in tmp_path.iterdir()] == ["model.xml"]


def test_constraints_of_a_mujoco_model_are_refused(tmp_path):
    pytest.importorskip("mujoco")
    file = tmp_path / "model.xml"
    file.write_text(MJCF.format('<equality><joint joint1="turn" joint2="twist"/></equality>'))
    with pytest.raises(iv.errors.AxisError, match="equality"):
        iv.Robot.from_mjcf(file)
