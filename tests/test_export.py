"""A diagnosis for other tools: what is written does what it says."""

import json
from dataclasses import replace

import numpy as np
import pytest

import ivtools as iv
from ivtools.cli import run
from ivtools.errors import AxisError
from ivtools.loop import Controller
from ivtools.physics import Parameter, Term
from ivtools.simulators.plain import described, program
from ivtools.simulators.urdf_export import export

THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
EFFECTS = {
    "cogging": {"cosine": 2.0, "sine": 0.5, "period": 0.004},
    "stribeck": {"force": 4.0, "speed": 0.01},
    "asymmetric-viscous": {"delta": 40.0},
    "drive-timing": {"delay": 0.0006, "lag": 0.0004},
    "load-friction": {"ratio": 0.1},
}
URDF = """<robot name="arm">
  <link name="base"/><link name="tip"/>
  <joint name="elbow" type="revolute"><!-- mine -->
    <parent link="base"/><child link="tip"/><limit effort="1" velocity="1"/>
    <dynamics damping="0.5"/>
  </joint>
</robot>"""


def rms(x) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


@pytest.mark.parametrize("velocity", ["differences", "logged"])
@pytest.mark.parametrize("effect", EFFECTS)
def test_the_program_simulates_what_the_loop_does(twin, effect, velocity):
    record, loop = twin.slice(0, 4000), iv.axes.emps()
    loop = replace(loop, controller=replace(loop.controller, velocity=velocity))
    record = record.replace(dq=np.gradient(record.q, record.dt, axis=0))  # a sensor's
    lacking = loop.with_effect(effect, **EFFECTS[effect])
    made: dict = {}
    exec(compile(program(lacking, THETA), "model.py", "exec"), made)
    *_, nu = made["simulate"](record.t, record.q_ref[:, 0])
    ours, plain = (one.simulate(record, THETA, initial="rest").nu[:, 0] for one in (lacking, loop))
    assert rms(nu - ours) < 0.2 * rms(ours - plain)


def _drag(speed, size):
    """Return a drag that calls itself against a wind from behind."""
    return -_drag(-speed, size) if np.any(speed < 0.0) else size * speed * speed


def test_the_program_has_what_a_law_calls():
    law = Term("windage", "mechanics", (Parameter("drag", "{F} s2/{L}2"),), "c dq |dq|", "a fan",
               law=lambda q, dq, ddq, sign, tau, t, c: _drag(dq, c))  # fmt: skip
    loop = iv.axes.emps()
    loop = replace(loop, terms=(*loop.terms, law), start={**loop.start, "windage.drag": 300.0})
    made: dict = {}
    exec(compile(program(loop, THETA), "model.py", "exec"), made)
    plain = made["force"](0.0, -0.1) + 300.0 * 0.01
    assert plain == pytest.approx(-200.0 * 0.1 - 20.0 - 3.0)


@pytest.mark.parametrize(
    "kind, settings",
    [
        ("pid", {"kp": 20000.0, "kd": 250.0, "ki": 50000.0}),
        ("p-pi", {"kp": 60.0, "kv": 250.0, "ki": 10.0}),
    ],
)
def test_the_program_has_the_law_with_its_states(twin, kind, settings):
    record = twin.slice(0, 3000)
    loop = replace(iv.axes.emps(), controller=Controller(kind, settings, limit=10.0))
    made: dict = {}
    exec(compile(program(loop, THETA), "model.py", "exec"), made)
    *_, nu = made["simulate"](record.t, record.q_ref[:, 0])
    ours = loop.simulate(record, THETA, initial="rest").nu[:, 0]
    assert rms(nu - ours) < 0.02 * rms(ours)


def test_a_second_mass_is_no_force_law():
    with pytest.raises(AxisError, match="flexibility is more than a force"):
        program(iv.axes.emps().with_effect("flexibility"), THETA)


def test_equations_and_values_go_into_json():
    loop = iv.axes.emps().with_effect("cogging", **EFFECTS["cogging"])
    content = json.loads(json.dumps(described(loop, THETA), allow_nan=False))
    cogging = content["terms"][-1]
    assert cogging["parameters"]["period"] == {"value": 0.004, "unit": "m"}
    assert cogging["equation"].startswith("a cos(2 pi q/p)")


def test_a_urdf_gets_its_friction_and_says_what_it_cannot_hold(tmp_path):
    file = tmp_path / "arm.urdf"
    file.write_text(URDF)
    xml, lost = export(file, "elbow", THETA)
    assert 'damping="200"' in xml and 'friction="20"' in xml and "<!-- mine -->" in xml
    assert any("inertia 95; the inertia belongs to the links" in line for line in lost)
    xml, _ = export(file, "elbow", {}, {"viscous": 0.25, "coulomb": -1.0})
    assert 'damping="0.75"' in xml and 'friction="0"' in xml
    with pytest.raises(AxisError, match="no joint 'wrist'; it has: elbow"):
        export(file, "wrist", THETA)


@pytest.mark.parametrize(
    "text", ["", "{}", "[]", '{"theta": {}}', '{"theta": {"a": "b"}}', "{" * 9999]
)
def test_a_file_that_is_no_diagnosis_is_said(tmp_path, capsys, text):
    found = tmp_path / "d.json"
    found.write_text(text)
    out = str(tmp_path / "m.json")
    assert run(["export", "json", "--axis", "emps", "--diagnosis", str(found), "--out", out]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "d.json" in err


def test_the_command_line_exports_what_it_diagnosed(tmp_path, capsys):
    found, out = tmp_path / "d.json", tmp_path / "model.py"
    assert run(["diagnose", "twin", "--json", str(found)]) == 0
    assert (
        run(["export", "python", "--axis", "emps", "--diagnosis", str(found), "--out", str(out)])
        == 0
    )
    made: dict = {}
    exec(compile(out.read_text(), "model.py", "exec"), made)
    theta = json.loads(found.read_text())["theta"]
    expected = 0.1 * (theta["viscous"] + theta["asymmetric-viscous.delta"])
    expected += theta["coulomb"] + theta["offset"]
    assert float(made["force"](0.1, 0.1)) == pytest.approx(expected, rel=1e-9)
