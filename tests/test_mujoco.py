"""MuJoCo models: read, simulated, and what a diagnosis writes into them."""

import numpy as np
import pytest

import ivtools as iv
from ivtools.errors import AxisError
from ivtools.simulators.mjcf_export import export

mujoco = pytest.importorskip("mujoco", reason="the extra [mujoco] is not installed")

CART = """<mujoco model="cart">
<option timestep="0.001" gravity="0 0 -9.81"/>
<!-- a comment of the user's -->
<worldbody><body name="cart">
  <joint name="x" type="slide" axis="1 0 0" damping="{damping}" armature="{armature}" {more}/>
  <geom size=".1" mass="0.3" contype="0" conaffinity="0"/>
</body></worldbody>
<actuator><position name="drive" joint="x" kp="400" kv="20"/></actuator>
</mujoco>"""
HINGE = """<mujoco model="arm">
<option timestep="0.001" gravity="0 0 -9.81"/>
<worldbody><body name="arm">
  <joint name="j" type="hinge" axis="0 1 0" damping="0.05" armature="0.02"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass="0.4" contype="0" conaffinity="0"/>
</body></worldbody>
<actuator><position name="drive" joint="j" kp="60" kv="3"/></actuator>
</mujoco>"""


def cart(tmp_path, name="cart.xml", damping="1", armature="0", more=""):
    file = tmp_path / name
    file.write_text(CART.format(damping=damping, armature=armature, more=more))
    return file


def reference(seconds=6.0, size=0.05, seed=1) -> iv.Record:
    rng, t = np.random.default_rng(seed), np.arange(int(1000 * seconds)) / 1000.0
    q = sum(
        size / (1 + 2 * f) * np.sin(2 * np.pi * f * t + rng.uniform(0, 6))
        for f in (0.2, 0.7, 1.3, 2.1)
    )
    q = (q - q[0]) * (1.0 - np.exp(-((t / 0.5) ** 3)))  # from rest
    return iv.Record(t=t, q=q, q_ref=q, nu=np.cos(t), name="reference")


def rms(x) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


def test_a_position_actuator_is_its_own_controller(tmp_path):
    file = cart(tmp_path, damping="1 2 3", armature="0.1", more='stiffness="4 1" springref="0.02"')
    loop = iv.ClosedLoop.from_mjcf(file, "x")
    assert loop.controller.kind == "cascade-pd"
    assert loop.controller.settings == {"kp": 20.0, "kv": 20.0}
    assert loop.start["inertia"] == pytest.approx(0.4)
    assert loop.start["polynomial-viscous.quadratic"] == 2.0
    q = np.linspace(-0.1, 0.1, 5)
    (spring,) = (t for t in loop.terms if t.name == "spring")
    force = spring.force(q, 0 * q, 0 * q, [loop.start[n] for n in spring.names])
    x = q - 0.02
    assert np.allclose(force + loop.start["offset"], (4 + 1 * x) * x)


def test_both_engines_do_the_same_with_the_same_model(tmp_path):
    file = cart(tmp_path, damping="1 2", armature="0.1", more='stiffness="4"')
    record, loop = reference(), iv.ClosedLoop.from_mjcf(file, "x")
    theirs = iv.MujocoSimulator(file, "x").simulate(record)
    ours = loop.simulate(theirs)
    assert rms(ours.nu - theirs.nu) < 0.01 * rms(theirs.nu)


def test_a_hinge_carries_its_gravity(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(HINGE)
    loop = iv.ClosedLoop.from_mjcf(file, "j")
    assert loop.joint == "revolute" and "gravity" in [t.name for t in loop.terms]
    assert loop.start["gravity.sin"] == pytest.approx(0.4 * 9.81 * 0.15, rel=1e-6)
    record = reference(size=1.0)
    theirs = iv.MujocoSimulator(file, "j").simulate(record)
    assert rms(loop.simulate(theirs).nu - theirs.nu) < 0.01 * rms(theirs.nu)


EFFECTS = {
    "cogging": {"cosine": 0.3, "sine": -0.4, "period": 0.02},
    "spring": {"stiffness": 6.0, "curvature": 1.0},
    "polynomial-viscous": {"quadratic": 9.0, "cubic": 4.0},
}


@pytest.mark.parametrize("effect", EFFECTS)
def test_what_is_written_into_a_model_acts_there_as_it_does_here(tmp_path, effect):
    file = cart(tmp_path, armature="0.1")
    record, loop = reference(), iv.ClosedLoop.from_mjcf(file, "x")
    lacking = loop.with_effect(effect, **EFFECTS[effect])
    theta = {**lacking.values(lacking.start), "inertia": 0.45, "viscous": 1.5, "offset": 0.7}
    made = export(file, "x", lacking, theta)
    assert made.lost == () and "a comment of the user's" in made.xml
    better = made.write(tmp_path / "better.xml")
    theirs = iv.MujocoSimulator(better, "x").simulate(record)
    ours = lacking.simulate(theirs, theta)
    before = loop.simulate(theirs)
    assert rms(ours.nu - theirs.nu) < min(0.1 * rms(before.nu - theirs.nu), 0.02 * rms(theirs.nu))


@pytest.mark.parametrize("hz, friction", [(12.0, 0.0), (12.0, 1.0), (25.0, 0.5)])
def test_two_masses_are_two_joints_and_a_tendon(tmp_path, hz, friction):
    file = cart(tmp_path, armature="0.1")
    record, loop = reference(), iv.ClosedLoop.from_mjcf(file, "x")
    values = {"frequency_hz": hz, "damping": 0.05, "load_share": 0.3, "load_friction": friction}
    lacking = loop.with_effect("flexibility", **values)
    better = export(file, "x", lacking, lacking.values(lacking.start)).write(tmp_path / "b.xml")
    model = mujoco.MjModel.from_xml_path(str(better))
    assert model.njnt == 2 and model.ntendon == 1
    theirs = [iv.MujocoSimulator(f, "x").simulate(record) for f in (file, better)]
    ours = [one.simulate(theirs[0]).nu for one in (loop, lacking)]
    change = ours[1] - ours[0]
    assert rms(theirs[1].nu - theirs[0].nu - change) < 0.2 * rms(change)


def test_lighter_bodies_where_armature_cannot_be_negative(tmp_path):
    file = cart(tmp_path)
    loop = iv.ClosedLoop.from_mjcf(file, "x")
    made = export(file, "x", loop, {**loop.values(loop.start), "inertia": 0.2})
    again = iv.ClosedLoop.from_mjcf(made.write(tmp_path / "light.xml"), "x")
    assert again.start["inertia"] == pytest.approx(0.2, rel=1e-9)


def test_changes_are_added_to_what_the_model_states(tmp_path):
    file = cart(tmp_path, damping="1", armature="0.1")
    loop = iv.ClosedLoop.from_mjcf(file, "x")
    made = export(file, "x", loop, {}, changes={"inertia": 0.05, "viscous": -0.25})
    again = iv.ClosedLoop.from_mjcf(made.write(tmp_path / "other.xml"), "x")
    assert again.start["inertia"] == pytest.approx(0.45)
    assert again.start["viscous"] == pytest.approx(0.75)


def test_a_second_diagnosis_goes_on_top_of_the_first(tmp_path):
    file = cart(tmp_path, armature="0.1")
    loop = iv.ClosedLoop.from_mjcf(file, "x")
    for name in ("first.xml", "second.xml"):
        lacking = loop.with_effect("cogging", **EFFECTS["cogging"])
        made = export(file, "x", lacking, lacking.values({}), changes={"offset": 0.5})
        file = made.write(tmp_path / name)
    model = mujoco.MjModel.from_xml_path(str(file))
    assert model.nu == 5
    twice = iv.MujocoSimulator(file, "x").simulate(reference())
    once = iv.MujocoSimulator(tmp_path / "first.xml", "x").simulate(reference())
    assert rms(twice.nu - once.nu) > 0.1


def test_what_mujoco_cannot_hold_is_a_comment_and_acts_beside(tmp_path):
    file = cart(tmp_path, armature="0.1")
    record, loop = reference(), iv.ClosedLoop.from_mjcf(file, "x")
    lacking = loop.with_effect("asymmetric-viscous", delta=1.5)
    made = export(file, "x", lacking, lacking.values(lacking.start))
    assert made.lost == ("asymmetric-viscous",) and "dFv |dq|" in made.xml
    better = made.write(tmp_path / "better.xml")
    theirs = iv.MujocoSimulator(better, "x", beside=made.beside).simulate(record)
    assert rms(lacking.simulate(theirs).nu - theirs.nu) < 0.02 * rms(theirs.nu)


@pytest.mark.parametrize(
    "joint, actuator, match",
    [("y", None, "no joint 'y'; it has: x"), ("x", "motor", "no actuator 'motor'; it has: drive")],
)
def test_a_wrong_name_lists_the_right_ones(tmp_path, joint, actuator, match):
    with pytest.raises(AxisError, match=match):
        iv.ClosedLoop.from_mjcf(cart(tmp_path), joint, actuator)


@pytest.mark.parametrize("text", ["", "<mujoco>", "<mujoco/>", "no xml"])
def test_what_is_no_model_is_said_in_one_line(tmp_path, text):
    (tmp_path / "m.xml").write_text(text)
    with pytest.raises(AxisError) as error:
        iv.ClosedLoop.from_mjcf(tmp_path / "m.xml", "x")
    assert "\n" not in str(error.value)


def test_without_mujoco_one_line_says_what_to_install(tmp_path, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(iv.errors.MissingExtraError, match=r'pip install "ivtools\[mujoco\]"'):
        iv.ClosedLoop.from_mjcf(cart(tmp_path), "x")


def test_a_motor_gets_the_command_of_the_axis_controller(tmp_path):
    text = CART.format(damping="1", armature="0.1", more="")
    file = tmp_path / "motor.xml"
    file.write_text(text.replace('<position name="drive" joint="x" kp="400" kv="20"/>',
                                 '<motor name="drive" joint="x" gear="2"/>'))  # fmt: skip
    bare = iv.ClosedLoop.from_mjcf(file, "x")
    assert bare.controller.kind == "identify" and bare.gain == 2.0
    with pytest.raises(AxisError, match="has no controller"):
        iv.MujocoSimulator(file, "x").simulate(reference())
    from dataclasses import replace

    from ivtools.loop import Controller

    kinds = {
        "pd": {"kp": 200.0, "kd": 10.0},
        "p-pi": {"kp": 20.0, "kv": 10.0, "ki": 5.0},
        "pid": {"kp": 200.0, "kd": 10.0, "ki": 100.0},
    }
    record = reference()
    for kind, settings in kinds.items():
        loop = replace(bare, controller=Controller(kind, settings, delay=1))
        theirs = iv.MujocoSimulator(file, "x", loop=loop).simulate(record)
        ours = loop.simulate(record, initial="rest")
        assert rms(ours.nu - theirs.nu) < 0.01 * rms(theirs.nu), kind


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("cogging", {"cosine": 1.0, "sine": 0.6, "period": 0.01}),
        ("spring", {"stiffness": 60.0, "curvature": 0.0}),
    ],
)
def test_creeping_friction_takes_up_its_share_of_every_force(tmp_path, effect, values):
    file = cart(tmp_path, armature="0.1", more='frictionloss="1"')
    plain, record = iv.ClosedLoop.from_mjcf(file, "x"), reference()
    soft = {"force": 1.0, "speed": 1.0 / (0.4 * 0.9 * 105.0), "hold": 0.9}
    ours = plain.with_effect("regularised-coulomb", **soft).with_effect(effect, **values)
    lacking = plain.with_effect(effect, **values)
    better = export(file, "x", lacking, lacking.values(lacking.start)).write(tmp_path / "b.xml")
    theirs = iv.MujocoSimulator(better, "x").simulate(record)
    given = record.replace(dq=np.gradient(record.q[:, 0], 1e-3))
    nu = ours.simulate(given, {"coulomb": 0.0}, initial="rest").nu
    assert rms(nu - theirs.nu) < 0.03 * rms(theirs.nu)


@pytest.mark.parametrize("timing", [{"delay": 0.003}, {"lag": 0.004}])
def test_a_late_drive_is_late_in_mujoco_too(tmp_path, timing):
    from dataclasses import replace

    from ivtools.loop import Controller

    text = CART.format(damping="1", armature="0.1", more="")
    file = tmp_path / "motor.xml"
    file.write_text(text.replace('<position name="drive" joint="x" kp="400" kv="20"/>',
                                 '<motor name="drive" joint="x"/>'))  # fmt: skip
    controller = Controller("pd", {"kp": 400.0, "kd": 20.0})
    loop = replace(iv.ClosedLoop.from_mjcf(file, "x"), controller=controller)
    lacking = loop.with_effect("drive-timing", **timing)
    better = export(file, "x", lacking, lacking.values(lacking.start)).write(tmp_path / "b.xml")
    record = reference()
    theirs = [iv.MujocoSimulator(f, "x", loop=loop).simulate(record).nu for f in (file, better)]
    ours = [one.simulate(record, initial="rest").nu for one in (loop, lacking)]
    assert rms(theirs[1] - theirs[0] - (ours[1] - ours[0])) < 0.3 * rms(ours[1] - ours[0])


def test_the_command_line_makes_an_axis_file_of_a_model(tmp_path, capsys):
    from ivtools.cli import run

    file, out = cart(tmp_path, armature="0.1"), tmp_path / "axis.toml"
    assert run(["axis", "from-mjcf", str(file), "--joint", "x", "--out", str(out)]) == 0
    loop = iv.ClosedLoop.from_file(out)
    assert loop.start["inertia"] == pytest.approx(0.4) and loop.controller.kind == "cascade-pd"
    assert run(["axis", "from-mjcf", str(file)]) == 2
    assert "--joint NAME" in capsys.readouterr().err
