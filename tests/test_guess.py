"""A stranger's log: its columns, units, clock and joint are found, or doubts are told."""

import tomllib

import numpy as np
import pytest
import sloppy_logs
import vendor_logs
from foreign_logs import STYLES, Log, draw

from benchmarks import left_out
from ivtools.cli import run
from ivtools.columns import plain_name
from ivtools.csv_layout import sniff
from ivtools.errors import IVToolsError
from ivtools.gap import parity
from ivtools.guess import FirstAxis, first_axis
from ivtools.guess.words import read
from ivtools.loop import ClosedLoop
from ivtools.record import Record
from ivtools.units import parse


def faults(log: Log, found: FirstAxis) -> list[str]:
    """Return what was guessed wrong about a log."""
    wrong = []
    for signal, column in log.columns.items():
        given = found.roles.columns.get(signal)
        if signal in found.roles.columns and plain_name(given)[0] != plain_name(column)[0]:
            wrong.append(f"{signal} is {column!r} and not {given!r}")
        unit = parse(found.scales.units.get(signal, "s" if signal == "t" else "kg"))
        if (unit.factor, unit.si) != (parse(log.units[signal]).factor, parse(log.units[signal]).si):
            wrong.append(f"{signal} is in {log.units[signal]} and not in {unit.text}")
    if abs(found.record.sampling_hz / log.rate - 1.0) > 1e-3:
        wrong.append(f"the rate is {log.rate} and not {found.record.sampling_hz}")
    if found.loop.joint != log.joint:
        wrong.append(f"the joint is {log.joint}")
    surplus = set(found.roles.columns) - set(log.columns)
    if found.scales.units.get("t") == "counts":  # numbered rows of which some are missing
        surplus -= {"t"}
    return [*wrong, *surplus]


def score(seeds, styles, folder, drawn=draw) -> tuple[int, list[str]]:
    told, right = [], 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        for style in styles:
            log = drawn(rng, folder, style)
            try:
                wrong = faults(log, first_axis(log.path))
            except IVToolsError as error:
                wrong = [str(error)]
            right += not wrong
            told += [f"{seed}, {log.path.stem}: {'; '.join(wrong)}"] * bool(wrong)
    return right, told


@pytest.mark.filterwarnings("ignore::ivtools.errors.IVToolsWarning")
def test_logs_of_varied_naming(tmp_path):
    styles = list(STYLES)[::2]
    right, told = score([101], styles, tmp_path)
    assert right >= len(styles) - 1, told


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ivtools.errors.IVToolsWarning")
def test_the_population(tmp_path):
    right, told = score([201, 202], STYLES, tmp_path)
    assert right >= 0.9 * 2 * len(STYLES), told


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 12])
@pytest.mark.filterwarnings("ignore::ivtools.errors.IVToolsWarning")
def test_the_logs_of_thirty_makes(tmp_path, seed):
    right, told = score([seed], vendor_logs.MAKES, tmp_path, vendor_logs.draw)
    assert right >= 27, told


def sloppy(seeds, folder) -> tuple[int, list[str]]:
    """Score the logs of makes in turn, with what happens to files."""
    styles, right, told = list(vendor_logs.MAKES), 0, []
    for seed in seeds:
        fine, faulty = score([seed], [styles[seed % len(styles)]], folder, sloppy_logs.draw)
        right, told = right + fine, told + faulty
    return right, told


def slow(value):
    """Return a value of a parameter that only the slow tests try."""
    return pytest.param(value, marks=pytest.mark.slow)


@pytest.mark.filterwarnings("ignore::ivtools.errors.IVToolsWarning")
@pytest.mark.parametrize("seed", [1017, 1029, *map(slow, [1049, 1063, 1065, 1094])])
def test_sloppy_logs(seed, tmp_path):
    right, told = sloppy([seed], tmp_path)
    assert right == 1, told


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ivtools.errors.IVToolsWarning")
def test_a_population_of_sloppy_logs(tmp_path):
    right, told = sloppy(range(2000, 2120), tmp_path)
    assert right >= 114, told


@pytest.mark.filterwarnings("ignore::ivtools.errors.IVToolsWarning")
def test_stamps_scripts_and_velocity_loops(tmp_path):
    makes = ["clock", "dates", "russian", "chinese", "kollmorgen", "spindle"]
    right, told = score([5], makes, tmp_path, vendor_logs.draw)
    assert right == len(makes), told


@pytest.mark.parametrize(
    ("name", "quantity", "side", "unit"),
    [
        ("Lagesollwert [mm]", "position", "reference", "mm"),
        ("n_ist", "velocity", "actual", ""),
        ("Zeit/ms", "time", "", "ms"),
        ("Vitesse de rotation (tr/min)", "velocity", "", "tr/min"),
        ("i_q", "current", "", ""),
        ("Momentensollwert in %", "force", "reference", "%"),
        ("pos_deg", "position", "", "deg"),
        ("Schleppfehler", "other", "", ""),
        ("following_error_actual", "other", "actual", ""),
        ("θ", "position", "", ""),
        ("Stellgröße [V]", "command", "", "V"),
    ],
)
def test_names_in_several_languages(name, quantity, side, unit):
    said = read(name)
    assert (said.quantity, said.side, said.unit) == (quantity, side, unit)


def servo_log(folder):
    """Write the log of the usual servo: P-PI, mm, ms, semicolons, decimal commas, no velocity."""
    rng = np.random.default_rng(5)
    while True:
        log = draw(rng, folder, "german")
        if log.joint == "prismatic":
            break
    t, q, q_ref = log.record.t, log.record.q[:, 0], log.record.q_ref[:, 0]
    nu = 100 * log.record.nu[:, 0] / 40.0
    stamps = t + 0.2 * log.record.dt * rng.uniform(-1, 1, len(t))
    lines = ["Zeit [ms];Istlage [mm];Solllage [mm];Drehmoment Soll [%]"]
    lines += [f"{1e3 * a:.4f};{1e3 * b:.7f};{1e3 * c:.7f};{d:.6f}".replace(".", ",")
              for a, b, c, d in zip(stamps, q, q_ref, nu, strict=True)]  # fmt: skip
    path = folder / "servo.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path, log


@pytest.mark.filterwarnings("ignore::ivtools.errors.IVToolsWarning")
def test_the_axis_file_is_one_that_the_other_verbs_take(tmp_path, capsys):
    path, log = servo_log(tmp_path)
    file = tmp_path / "axis.toml"
    assert run(["axis", "new", str(path), "--out", str(file)]) == 0
    told = capsys.readouterr().out
    assert "how it was found" in told and "CHECK" in told
    assert all(len(line) <= 80 for line in told.splitlines() if str(tmp_path) not in line)
    text = file.read_text(encoding="utf-8")
    assert tomllib.loads(text)["record"]["units"] == {"t": "ms", "q": "mm", "q_ref": "mm",
                                                      "nu": "%"}  # fmt: skip
    loop = ClosedLoop.from_file(file)
    assert loop.log.rate == log.rate
    record = Record.read(path, loop.log)
    assert np.allclose(record.q, log.record.q, atol=1e-9)
    settings = loop.controller.settings
    assert loop.controller.kind == "p-pi"
    assert settings["kp"] == pytest.approx(log.loop.controller.settings["kp"], rel=0.02)
    assert settings["ki"] == pytest.approx(log.loop.controller.settings["ki"], rel=0.02)
    assert run(["identify", str(path), "--axis", str(file)]) == 0


@pytest.mark.filterwarnings("ignore::ivtools.errors.IVToolsWarning")
def test_a_law_that_is_none_of_the_kinds_is_written_as_matrices(tmp_path, capsys):
    """One with a filter of its reference: the verbs go on with it."""
    _, (first, second) = left_out.draw(5, "reference filter", "")
    paths = [tmp_path / f"{r.name}.csv" for r in (first, second)]
    for path, r in zip(paths, (first, second), strict=True):
        table = np.column_stack([r.t, r.q[:, 0], r.q_ref[:, 0], r.nu[:, 0]])
        np.savetxt(path, table, delimiter=",", header="t,q,q_ref,nu", comments="", fmt="%.16g")
    file = tmp_path / "axis.toml"
    assert run(["axis", "new", str(paths[0]), "--out", str(file)]) == 0
    told = capsys.readouterr().out
    assert "law: state-space, " in told and " states (R2 1.0000)" in told
    loop = ClosedLoop.from_file(file)
    for path in paths:
        assert parity.check(Record.read(path, loop.log), loop, read=False).after < 1e-4
    both = [str(paths[0]), "--axis", str(file), "--holdout", str(paths[1])]
    assert run(["check", str(paths[0]), "--axis", str(file), "--out", str(tmp_path / "page")]) == 0
    assert run(["diagnose", *both]) == 0
    assert "verdict: adequate" in capsys.readouterr().out


def test_what_is_no_log_is_one_line(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("name,age\n" + "\n".join(f"Jo{i},{i % 7}" for i in range(300)))
    with pytest.raises(IVToolsError, match="no column could be found") as caught:
        first_axis(file)
    assert "\n" not in str(caught.value)
    assert run(["axis", "new"]) == 2
    assert run(["axis", "new", str(tmp_path / "none.csv")]) == 2
    assert run(["axis", "emps", "extra.csv"]) == 2


def test_a_line_above_the_header_may_have_separators_of_its_own(tmp_path):
    """More decimal commas than semicolons in a row, and a preamble with a semicolon."""
    rows = "\n".join(
        ";".join(f"{x:.3f}".replace(".", ",") for x in (i, np.sin(i / 50), np.cos(i / 50), i / 9))
        for i in range(300)
    )
    file = tmp_path / "log.csv"
    file.write_text(f"Aufzeichnung Achse X;Projekt 4711\nZeit [ms];Soll;Ist;Strom\n{rows}\n")
    found = sniff(file)
    assert found.names == ("Zeit [ms]", "Soll", "Ist", "Strom")
    assert (found.separator, found.decimal, found.first_row) == (";", ",", 2)


@pytest.mark.filterwarnings("ignore::ivtools.errors.IVToolsWarning")
def test_a_supply_is_no_command(tmp_path):
    """It is a voltage, which would come before the measured current, but nothing follows it."""
    rng = np.random.default_rng(1)
    t = np.arange(4000) / 500.0
    dq_ref = 80.0 * np.sin(2.0 * t) ** 3
    q, dq, integral = 0.0, 0.0, 0.0
    rows = ["Time,Speed setpoint (rpm),Speed actual (rpm),Angle (rad),DC bus (V),Current q (A)"]
    for now, wanted in zip(t, dq_ref, strict=True):
        error = wanted - dq
        integral += 0.002 * error
        current = 0.9 * (error + 6.0 * integral)
        rows.append(f"{now:.4f},{9.5493 * wanted:.5f},{9.5493 * dq:.5f},{q:.6f},"
                    f"{560 + rng.normal():.1f},{current:.5f}")  # fmt: skip
        dq += 0.002 * (0.12 * current - 0.002 * dq - 0.18 * np.tanh(dq)) / 4.2e-3
        q += 0.002 * dq
    file = tmp_path / "spindle.csv"
    file.write_text("\n".join(rows))
    found = first_axis(file)
    assert found.roles.columns["nu"] == "Current q (A)"
    assert found.loop.controller.kind == "pi-velocity"
    settings = found.loop.controller.settings  # SI, from a log in rpm
    assert settings["kv"] == pytest.approx(0.9, rel=1e-3)
    assert settings["ki"] == pytest.approx(6.0, rel=1e-2)
    assert found.record.dq_ref.max() == pytest.approx(80.0, rel=1e-3)
    assert found.params["inertia"] == pytest.approx(4.2e-3 / 0.12, rel=0.05)


@pytest.mark.filterwarnings("ignore::ivtools.errors.IVToolsWarning")
def test_a_hinge_in_open_loop_hangs_and_has_no_wrong_sign(tmp_path):
    """Current, angle and nothing else; without gravity its inertia comes out negative."""
    rng = np.random.default_rng(9)
    t = np.arange(4000) / 200.0
    current = sum(a * np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 6.3))
                  for f, a in zip((0.13, 0.31, 0.47, 0.71, 1.1), (1.0, 0.9, 0.7, 0.5, 0.3),
                                  strict=True))  # fmt: skip
    q, dq, angles = 0.3, 0.0, []
    for i in current:
        angles.append(q)
        for _ in range(20):
            force = 0.55 * i - 0.06 * dq - 0.12 * np.tanh(dq / 0.01) - 1.1 * np.sin(q)
            dq += 2.5e-4 * force / 0.035
            q += 2.5e-4 * dq
    rows = [f"{a:.3f}\t{np.degrees(b):.4f}\t{c:.5f}"
            for a, b, c in zip(t, angles, current, strict=True)]  # fmt: skip
    file = tmp_path / "hinge.txt"
    file.write_text("\n".join(["time\tangle_deg\ti_cmd_A", *rows]))
    found = first_axis(file)
    assert "gravity" in [term.name for term in found.loop.terms]
    assert found.params["inertia"] == pytest.approx(0.035 / 0.55, rel=0.05)
    assert found.params["gravity.sin"] == pytest.approx(1.1 / 0.55, rel=0.05)
    assert not any("sign" in doubt for doubt in found.doubts)
