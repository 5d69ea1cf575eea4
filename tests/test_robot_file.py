"""Robot files, and the verbs that take them."""

import json
from pathlib import Path

import numpy as np
import pytest
from robots import plan, reference, six_loop

import ivtools as iv
from ivtools import robot as robots_of_ivtools
from ivtools.cli.app import run
from ivtools.errors import AxisError

MODEL = Path(robots_of_ivtools.__file__).parent / "six_axis.urdf"
FILE = """
[robot]
urdf = "arm.urdf"
[record]
rate = 1000.0
[controller]
kind = "pd"
kp = 900.0
kd = 60.0
[model]
terms = ["inertia", "viscous", "coulomb", "offset"]
[model.start]
viscous = 2.0
[joint.joint_2.controller]
kp = 3000.0
[joint.joint_3.controller]
kind = "p-velocity"
kv = 80.0
[joint.joint_6.model.start]
coulomb = 1.5
[tool]
link = "tool"
mass = 1.5
com = [0.0, 0.0, 0.05]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("robot")
    (place / "arm.urdf").write_text(MODEL.read_text())
    (place / "robot.toml").write_text(FILE)
    loop = six_loop()
    t, q_ref = reference(8.0)
    rng = np.random.default_rng(0)
    noise = 2e-5 * rng.standard_normal(q_ref.shape)
    sim = loop.simulate(plan(t, q_ref), initial="rest", position_noise=noise)
    record = iv.Record(t, q=sim.q, q_ref=q_ref, nu=sim.nu)
    record.to_frame().to_csv(place / "log.csv", index=False)
    return place


def test_defaults_hold_where_a_joint_says_nothing(folder):
    loop = iv.RobotLoop.from_file(folder / "robot.toml")
    kinds = [axis.controller.kind for axis in loop.axes]
    assert kinds == ["pd", "pd", "p-velocity", "pd", "pd", "pd"]
    assert loop.axes[1].controller.settings == {"kp": 3000.0, "kd": 60.0}
    assert loop.values()["joint_6.coulomb"] == 1.5
    assert loop.values()["joint_6.viscous"] == loop.values()["joint_1.viscous"] == 2.0
    assert loop.robot.links()["flange"]["mass"] == pytest.approx(2.5)
    assert loop.log.rate == 1000.0


def test_what_is_written_is_what_is_read(folder):
    loop = iv.RobotLoop.from_file(folder / "robot.toml")
    (folder / "again.toml").write_text(loop.to_toml("arm.urdf"))
    again = iv.RobotLoop.from_file(folder / "again.toml")
    assert again.names == loop.names
    assert [a.controller for a in again.axes] == [a.controller for a in loop.axes]
    assert again.to_toml("arm.urdf") == loop.to_toml("arm.urdf")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[robot]", "[robt]"), r"\[robt\] is not known; known tables: robot"),
        (('urdf = "arm.urdf"', ""), "needs one of urdf"),
        (('urdf = "arm.urdf"', 'urdf = "leg.urdf"'), "leg.urdf: No such file"),
        (("joint_2", "joint_9"), "no joint 'joint_9'; its joints: joint_1"),
        (("joint_2.controller", "joint_2.kontroller"), r"\[joint.joint_2\] does not know"),
        (("kp = 3000.0", "kq = 3000.0"), "joint joint_2: .*does not know 'kq'"),
        (("coulomb = 1.5", 'coulomb = "much"'), "joint joint_6: .*not a number"),
        (('link = "tool"', 'link = "hand"'), "no link 'hand'"),
        (("com = [0.0, 0.0, 0.05]", "com = [0.0]"), "give 3 numbers"),
        (("mass = 1.5", ""), "mass is missing"),
        (("mass = 1.5", f"mass = 1{'0' * 400}"), "mass is too large for a number"),
        (("com = [0.0, 0.0, 0.05]", "inertia = [[0.0, 0.0, 0.0]]"), "give 3 rows of 3 numbers"),
        (("[robot]", "[robot]\ntransmission = [[1.0]]"), "give 6 rows of 6 numbers"),
        (
            ("[joint.joint_6.model.start]\ncoulomb = 1.5", "[joint.joint_6.model]\nstart = 1"),
            "model.start = 1 is not a table",
        ),
        (("rate = 1000.0", 'rate = 1000.0\nunits = { q2 = "mm" }'), "revolute joint do not fit"),
        (("rate = 1000.0", "rate = 1000.0\nunit = 1"), r"\[record\] does not know 'unit'"),
    ],
)
def test_a_file_at_fault_says_where(folder, change, message):
    file = folder / "wrong.toml"
    file.write_text(FILE.replace(*change))
    with pytest.raises(AxisError, match=message) as caught:
        iv.RobotLoop.from_file(file)
    assert "\n" not in str(caught.value)


def test_a_log_in_degrees_is_read(folder):
    frame = iv.datasets.load(str(folder / "log.csv")).to_frame()
    frame["q1"] = np.rad2deg(frame["q1"])
    frame.to_csv(folder / "degrees.csv", index=False)
    units = 'rate = 1000.0\nunits = { q1 = "deg", q2 = "rad" }'
    (folder / "degrees.toml").write_text(FILE.replace("rate = 1000.0", units))
    log = iv.RobotLoop.from_file(folder / "degrees.toml").log
    read = iv.datasets.load(str(folder / "degrees.csv"), None, log)
    assert read.q == pytest.approx(iv.datasets.load(str(folder / "log.csv")).q)


def test_the_verbs_of_a_robot(folder, capsys):
    log, robot, fit = (str(folder / name) for name in ("log.csv", "drafted.toml", "fit.json"))
    assert run(["robot", "info", str(MODEL), "--json", str(folder / "info.json")]) == 0
    info = json.loads((folder / "info.json").read_text())
    assert len(info["base"]) == 36 and len(info["joints"]) == 6
    assert run(["robot", "new", log, "--urdf", str(folder / "arm.urdf"), "--out", robot]) == 0
    assert iv.RobotLoop.from_file(robot).axes[0].controller.settings["kp"] == pytest.approx(3000.0)
    pages = str(folder / "pages")
    identify = ["identify", log, "--robot", robot, "--method", "idim-iv", "--json", fit]
    assert run([*identify, "--out", pages]) == 0
    assert "joint_6" in (folder / "pages" / "report.html").read_text(encoding="utf-8")
    found = json.loads(Path(fit).read_text())
    assert found["converged"] and set(found["joints"]) == set(iv.Robot.six_axis().names)
    assert len(found["base"]) == 36 and found["standard"]["flange"]["mass"] > 0.0
    simulate = ["simulate", log, "--robot", robot, "--theta", fit, "--out", pages]
    assert run([*simulate, "--json", "-"]) == 0
    text = capsys.readouterr().out
    errors = json.loads(text[text.rindex('{\n  "relative_error"') :])
    assert max(joint["position"] for joint in errors["joints"].values()) < 0.5


def test_faults_end_with_status_two_and_one_line(folder, capsys):
    log = str(folder / "log.csv")
    assert run(["identify", log, "--robot", str(folder / "none.toml")]) == 2
    assert run(["robot", "info", str(folder / "none.urdf")]) == 2
    assert run(["identify", log, "--robot", str(folder / "robot.toml"), "--axis", "emps"]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 3 and all(line.startswith("ivtools: error: ") for line in said)


def test_a_drafted_file_finds_its_model_from_its_own_folder(folder, monkeypatch):
    monkeypatch.chdir(folder.parent)
    name = folder.name
    draft = ["robot", "new", f"{name}/log.csv", "--urdf", f"{name}/arm.urdf"]
    assert run([*draft, "--out", f"{name}/near.toml"]) == 0
    assert iv.RobotLoop.from_file(folder / "near.toml").n_joints == 6
