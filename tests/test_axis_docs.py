"""docs/axis-file.md: its examples load and read a log, and it names every key there is."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import ivtools as iv
from ivtools.errors import EstimationError
from ivtools.loop.axis_file import TABLES, from_tables
from ivtools.record import Record

TEXT = (Path(__file__).parents[1] / "docs" / "axis-file.md").read_text(encoding="utf-8")
BLOCKS = [
    "\n".join(line[4:] for line in block.splitlines())
    for block in re.findall(r"(?:^ {4}\S.*\n?)+", TEXT.split("## Worked examples")[1], re.M)
]
T = np.arange(3000) / 1000.0
Q, NU = np.sin(5 * T), np.cos(5 * T)
LOGS = [
    {"Zeit": 1e3 * T, "Istlage": 1e3 * Q, "Solllage": 1e3 * Q, "Drehmoment Soll": 2.5 * NU},
    {"t": T, "q": 651.8986469 * Q, "q_ref": 651.8986469 * Q, "dq": 60 / 2 / np.pi * NU,
     "nu": 1e3 * NU},
    {"t": T, "q": np.degrees(Q), "tau": NU / 0.12},
]  # fmt: skip


@pytest.mark.parametrize(("block", "log"), list(zip(BLOCKS, LOGS, strict=True)), ids=range(3))
def test_worked_examples_read_their_logs(block, log):
    loop = from_tables(tomllib.loads(block))
    record = Record.from_dict(log, loop.log)
    inner = slice(50, -50)
    q = np.sin(5 * record.t)
    assert np.allclose(record.q[inner, 0], q[inner], atol=1e-6)
    force = record.nu if record.nu is not None else record.tau
    assert np.allclose(force[inner, 0], np.cos(5 * record.t)[inner], atol=1e-3)
    assert from_tables(tomllib.loads(loop.to_toml())).log.to_dict() == loop.log.to_dict()


def test_every_key_is_described():
    for table in ("axis", "record", "controller", "drive", "model"):
        for key in TABLES[table]:
            assert re.search(rf"\b{key}\b", TEXT), f"[{table}] {key}"


def test_a_record_and_its_loop_are_a_short_form(twin):
    loop = iv.axes.emps()
    short, long = iv.IDIMLS().fit(twin, loop), iv.IDIMLS().fit(iv.Problem(twin, loop))
    assert short.params.equals(long.params)
    with pytest.raises(EstimationError, match="give Problem.record, loop., or record and loop"):
        iv.IDIMLS().fit(twin)
    with pytest.raises(EstimationError, match="fit was given a str"):
        iv.IDIMLS().fit("twin")
    with pytest.raises(EstimationError, match="give no other"):
        iv.IDIMLS().fit(iv.Problem(twin, loop), loop)


def test_records_and_simulations_draw_themselves(twin):
    theta = {"inertia": 95, "viscous": 200, "coulomb": 20, "offset": 0}
    assert len(twin.plot().axes) == 3
    assert len(iv.axes.emps().simulate(twin, theta).plot().axes) == 3


def test_a_loop_shows_itself_shortly_and_linearises(twin):
    import control

    loop = iv.axes.emps()
    assert len(repr(loop)) < 120 and "<pre>" in loop._repr_html_()
    assert len(repr(iv.Problem(twin, loop))) < 300
    theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": 0.0}
    system = loop.system(theta, linear=True)
    assert abs(system.poles()).max() < 1.0
    _, q = control.step_response(system, 1.0)
    assert q[-1] == pytest.approx(1.0, rel=1e-3)
    response = [abs(system(np.exp(2j * np.pi * hz * 1e-3))) for hz in (0.01, 200.0)]
    assert response[0] == pytest.approx(1.0, rel=1e-3) and response[1] < 0.1
