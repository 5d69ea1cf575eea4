"""Damaged robot files and models, and damaged uploads with what a window may ask then."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mutators import STRANGE, Generator, damaged_bytes, damaged_tables, strange, toml

import ivtools as iv

if TYPE_CHECKING:
    from inputs import Commands

URDF = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.15 0 0" rpy="0 0 0"/><mass value="0.6"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0.18 0 0"/><mass value="0.5"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.2" rpy="1.5708 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" velocity="3" effort="20"/>
    <dynamics damping="0.05" friction="0.1"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" velocity="3" effort="10"/></joint>
</robot>
"""
MJCF = """<mujoco model="arm"><option timestep="0.001" gravity="0 0 -9.81"/>
<default><joint damping="0.1" frictionloss="0.05"/></default>
<worldbody><body name="upper" pos="0 0 0.2">
  <joint name="shoulder" type="hinge" axis="0 1 0" range="-2 2" armature="0.02"/>
  <geom type="capsule" fromto="0 0 0 0.3 0 0" size=".02" mass="0.6"/>
  <body name="lower" pos="0.3 0 0"><joint name="elbow" type="hinge" axis="0 1 0"/>
    <inertial pos="0.1 0 0" mass="0.5" diaginertia="0.001 0.01 0.01"/></body></body></worldbody>
<actuator><position name="drive" joint="shoulder" kp="60" kv="3"/>
  <motor name="motor" joint="elbow" gear="2"/></actuator>
</mujoco>
"""
_PD = {"kind": "pd", "kp": 40.0, "kd": 4.0}
ROBOT: dict[str, Any] = {
    "robot": {"name": "arm", "urdf": "arm.urdf", "joints": ["shoulder", "elbow"],
              "gravity": [0.0, 0.0, -9.81], "transmission": [[1.0, 0.0], [0.2, 1.0]]},
    "record": {"rate": 1000.0, "columns": {"q1": "q1", "q2": "q2"}, "units": {"q2": "rad"}},
    "controller": _PD,
    "drive": {"gain": 1.0},
    "model": {"terms": ["inertia", "viscous", "coulomb"], "start": {"viscous": 0.05}},
    "joint": {"elbow": {"controller": {"kp": 20.0}, "model": {"start": {"coulomb": 0.1}}}},
    "start": {"elbow.viscous": 0.03},
    "tool": {"link": "lower", "mass": 0.2, "com": [0.1, 0.0, 0.0], "inertia": [[0.0] * 3] * 3},
}  # fmt: skip


@cache
def _log(samples: int = 600) -> bytes:
    """Return a record of two joints: a reference, and an arm that lags behind it."""
    import io

    import pandas as pd

    t = np.arange(samples) / 1000.0
    content = {"t": t}
    for j, hz in enumerate((1.3, 2.1), 1):
        q_ref, q = (0.3 * np.sin(2 * np.pi * hz * s) for s in (t, t - 0.02))
        content |= {f"q{j}": q, f"q_ref{j}": q_ref, f"nu{j}": 40.0 * (q_ref - q)}
    out = io.BytesIO()
    pd.DataFrame(content).to_parquet(out)
    return out.getvalue()


def _attributes(text: str, rng: Generator) -> bytes:
    """Give one to three attributes of an XML text strange values, or the value of another one."""
    for _ in range(rng.integers(1, 4)):
        found = list(re.finditer(r'="([^"]*)"', text))
        if not found:
            break
        at, other = (found[k] for k in rng.integers(len(found), size=2))
        value = str(strange(rng)) if rng.random() < 0.6 else other.group(1)
        if rng.random() < 0.3:
            value = str(rng.choice(["1e308", "-1e308", "1e-320", "1 2", "1e999", "nan nan nan"]))
        value = re.sub(r'[<"&]', "?", value)
        text = text[: at.start(1)] + value + text[at.end(1) :]
    return text.encode("utf-8", "replace")


def robots(rng: Generator, folder: Path) -> Commands:
    """A damaged robot file, or a sound one of a damaged model."""
    model, file, log = folder / "arm.urdf", folder / "robot.toml", folder / "log.parquet"
    model.write_text(URDF)
    log.write_bytes(_log())
    choice = rng.random()
    if choice < 0.6:
        file.write_bytes(toml(damaged_tables(ROBOT, rng)).encode("utf-8", "replace"))
    elif choice < 0.8:
        file.write_bytes(damaged_bytes(toml(ROBOT).encode(), rng))
    else:
        file.write_text(toml(ROBOT))
        model.write_bytes(_attributes(URDF, rng))
    verb = ["simulate", "identify"][int(rng.random() < 0.2)]
    yield [verb, str(log), "--robot", str(file), "--json", str(folder / "out.json")]


def models(rng: Generator, folder: Path) -> Commands:
    """A damaged URDF file or MuJoCo model."""
    name, sound = (("arm.urdf", URDF), ("arm.xml", MJCF))[rng.integers(2)]
    file = folder / name
    damage = damaged_bytes(sound.encode(), rng) if rng.random() < 0.5 else _attributes(sound, rng)
    file.write_bytes(damage)
    out = ["--json", str(folder / "out.json")]
    if name == "arm.xml" and rng.random() < 0.5:
        yield ["axis", "from-mjcf", str(file), "--joint", "shoulder", *out]
    else:
        yield ["robot", "info", str(file), *out]


_NAMES = ("log.csv", "a.parquet", "ä" * 300 + ".csv", "../x.csv", "a.mat", "x.exe", "", "\x00.txt")


def uploads(rng: Generator, folder: Path) -> Commands:
    """A damaged log given to the app, and strange requests then."""
    from inputs import files

    known = files()
    name = str(rng.choice(["a.csv", "g.csv", "p.parquet", "t.txt"]))
    (folder / "upload").write_bytes(damaged_bytes(known[name], rng))
    given = name if rng.random() < 0.8 else str(rng.choice(_NAMES))
    asked = [_request(rng) for _ in range(rng.integers(0, 4))]
    plan = {"name": given, "file": str(folder / "upload"), "then": asked}
    (folder / "plan.json").write_text(json.dumps(plan))
    yield ["upload", str(folder / "plan.json")]


def _request(rng: Generator) -> list[object]:
    """Return method, address below the session and body of a request that few would make."""
    columns = [f"column-{s}" for s in ("t", "q", "q_ref", "nu", "tau")]
    units = ["unit-t", "unit-q", "rate", "gain", "rated", "counts", "joint", "stretch"]
    words = ["t", "q", "q_ref", "nu", "mm", "ms", "%", "1e308", "-1", "0", "1,5", "nowhere"]
    fields = {str(k): str(rng.choice(words)) for k in rng.choice([*columns, *units], size=6)}
    fields |= {str(rng.choice(units)): strange(rng)} if rng.random() < 0.5 else {}
    axis = iv.axes.path("emps").read_text(encoding="utf-8")
    text = damaged_bytes(axis.encode(), rng).decode("utf-8", "replace")
    value = STRANGE[rng.integers(len(STRANGE))]
    chances: list[list[object]] = [
        ["POST", "do/correct", fields],
        ["POST", "do/axis", {"text": text}],
        ["POST", "do/estimate", {"methods": ["idim-ls"]}],
        ["POST", "do/estimate", {"methods": value}],
        ["POST", "do/diagnose", {"tolerance": [value]}],
        ["GET", f"chart/look/{rng.choice(['', 'x', '..%2F..', 'force'])}?from=nan&to=1e999", None],
        ["GET", f"get/{rng.choice(['axis.toml', 'x', 'repeat.py', 'estimates.json'])}", None],
        ["GET", f"section/{rng.choice(['log', 'look', 'x', '%00'])}", None],
    ]
    return chances[rng.integers(len(chances))]
