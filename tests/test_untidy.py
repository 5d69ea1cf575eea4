"""Logs with rows that are no samples, angles that jump by a turn, and numbers as people write."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ivtools.errors import RecordError
from ivtools.guess import first_axis
from ivtools.loop import ClosedLoop
from ivtools.loop.controllers import Controller
from ivtools.physics import find
from ivtools.record import Record
from ivtools.record_format import RecordFormat

RATE = 250.0
LAW = {"kp": 12.0, "kv": 0.8, "ki": 4.0}


@pytest.fixture(scope="module")
def turning() -> dict[str, np.ndarray]:
    """A turntable under a P-PI servo that goes round several times, and back."""
    t = np.arange(2000) / RATE
    q_ref = 9.0 * np.sin(0.9 * t) ** 2
    terms = find(("inertia", "viscous", "coulomb", "offset"))
    loop = ClosedLoop(Controller("p-pi", LAW), 1.0, terms, joint="revolute")
    theta = {"inertia": 0.01, "viscous": 0.01, "coulomb": 0.05, "offset": 0.0}
    sim = loop.simulate(Record(t, q=q_ref, q_ref=q_ref, nu=q_ref), theta, initial="rest")
    return {"t": t, "q_ref": q_ref, "q": sim.q[:, 0], "nu": sim.nu[:, 0]}


def rows_of(table: dict[str, np.ndarray], digits: int = 10) -> list[str]:
    return ["\t".join(f"{x:.{digits}g}" for x in row) for row in zip(*table.values(), strict=True)]


def written(path: Path, lines: list[str], head: str = "Time\tTarget angle\tAngle\tTorque") -> Path:
    path.write_text("\n".join([head, *lines]) + "\n", encoding="utf-8")
    return path


def check_law(path: Path) -> None:
    """The law is found, and the axis file that was written reads the log the same way."""
    found = first_axis(path)
    assert found.loop.controller.kind == "p-pi" and found.loop.joint == "revolute"
    for name, value in LAW.items():
        assert found.loop.controller.settings[name] == pytest.approx(value, rel=0.01)
    file = path.with_suffix(".toml")
    file.write_text(found.to_toml(), encoding="utf-8")
    assert Record.read(path, ClosedLoop.from_file(file).log).n_samples == found.record.n_samples


def spoil(lines: list[str]) -> list[str]:
    cells = lines[300].split("\t")
    return [*lines[:300], "\t".join([*cells[:3], "#N/A"]), *lines[301:], "", "End of log"]


@pytest.mark.parametrize(
    "change",
    [
        lambda lines: [line for i, one in enumerate(lines) for line in [one] * (1 + (i % 90 == 7))],
        lambda lines: [*lines, *["0\t0\t0\t0"] * 60],
        spoil,
    ],
    ids=["said twice", "zeros at the end", "spoilt"],
)
def test_rows_that_are_no_samples_are_left_out_where_asked(
    turning, tmp_path, change: Callable[[list[str]], list[str]]
):
    path = written(tmp_path / "log.csv", change(rows_of(turning)))
    layout = {"q_ref": "Target angle", "q": "Angle", "t": "Time", "nu": "Torque"}
    with pytest.raises(RecordError):
        Record.read(path, layout)
    some = RecordFormat(layout, rows="usable", gaps="longest")
    assert any(note.startswith("left out: ") for note in Record.read(path, some).notes)
    check_law(path)


@pytest.mark.parametrize(("turn", "unit"), [(2 * np.pi, "rad"), (360.0, "deg")])
def test_an_angle_that_jumps_by_a_turn_is_made_continuous(turning, tmp_path, turn, unit):
    wrapped = {k: (x * turn / 2 / np.pi) % turn if k in ("q", "q_ref") else x
               for k, x in turning.items()}  # fmt: skip
    path = written(tmp_path / "log.csv", rows_of(wrapped))
    found = first_axis(path)
    assert found.record.q[:, 0] == pytest.approx(turning["q"], abs=1e-6)
    assert found.scales.units["q"] == unit
    check_law(path)


def test_marks_between_thousands(turning, tmp_path):
    far = {k: x * 1e3 if k in ("t", "q", "q_ref") else x for k, x in turning.items()}
    lines = ["\t".join(f"{x:,.7f}" for x in row) for row in zip(*far.values(), strict=True)]
    head = "Time [ms]\tTarget angle [mrad]\tAngle [mrad]\tTorque [Nm]"
    check_law(written(tmp_path / "log.csv", lines, head))


def test_a_time_of_the_day_is_in_seconds_whatever_the_header_says(turning, tmp_path):
    lines = rows_of(turning)
    stamps = [f"2024-03-01T12:30:{5 + x:06.3f}Z" for x in turning["t"]]
    lines = [f"{s}\t{line.partition(chr(9))[2]}" for s, line in zip(stamps, lines, strict=True)]
    head = "Time [ms]\tTarget angle\tAngle\tTorque [Nm]"
    path = written(tmp_path / "log.csv", lines, head)
    assert first_axis(path).record.sampling_hz == RATE


def test_unknown_ways_are_refused():
    with pytest.raises(RecordError, match='rows = "some"|rows = \'some\'; it is "refuse"'):
        RecordFormat(rows="some")


def test_a_command_that_counts_the_other_way(turning, tmp_path):
    other = {**turning, "nu": -turning["nu"]}
    found = first_axis(written(tmp_path / "log.csv", rows_of(other)))
    assert found.loop.gain == -1.0 and found.params["inertia"] == pytest.approx(0.01, rel=0.05)
    assert any("opposite sign" in doubt for doubt in found.doubts)


def test_rows_that_are_numbered_get_their_rate_from_the_velocity(turning, tmp_path):
    rows = {"t": np.arange(2000), **{k: turning[k] for k in ("q_ref", "q")}}
    rows |= {"dq": np.gradient(turning["q"]) * RATE, "nu": turning["nu"]}
    head = "Sample\tTarget angle [rad]\tAngle [rad]\tSpeed [rad/s]\tTorque [Nm]"
    assert first_axis(written(tmp_path / "log.csv", rows_of(rows), head)).record.dt == 1 / RATE
