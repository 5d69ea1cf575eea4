"""The command line: what it prints and writes, and every way in which input is at fault."""

import json
import os
import re
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from ivtools import __version__, axes, datasets
from ivtools.cli import app, run
from ivtools.estimators.base import METHODS

IDENTIFY_KEYS = [
    "method", "params", "std_errors", "cov_type", "relative_error", "condition_number", "nobs",
    "n_iter", "converged", "tests",
]  # fmt: skip
SLOW = {"nsga2"}  # thousands of simulations
SIGNALS = ["position", "velocity", "acceleration", "force"]
AXIS = axes.path("emps").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    """A sound csv file: the first four seconds of the twin."""
    file = tmp_path_factory.mktemp("records") / "log.csv"
    datasets.twin().slice(0, 4000).to_frame().to_csv(file, index=False)
    return file


@pytest.fixture
def axis(tmp_path) -> Path:
    """A sound axis file."""
    file = tmp_path / "axis.toml"
    file.write_text(AXIS, encoding="utf-8")
    return file


@pytest.fixture
def command(capsys):
    """Run a command; returns status, stdout, stderr and holds it to the rules of all commands."""

    def call(*arguments: object) -> tuple[int, str, str]:
        status = run([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        assert "Traceback" not in err and "\x1b" not in out + err
        assert all(line.startswith("ivtools: ") for line in err.splitlines())
        if status == 2:
            assert not out
            assert sum("error:" in line for line in err.splitlines()) == 1
        return status, out, err

    return call


# -- what the verbs do -----------------------------------------------------------------------------
def test_identify_prints_a_table_and_writes_the_json_of_the_interface(command, tmp_path):
    file = tmp_path / "fit.json"
    status, out, err = command("identify", "twin", "--method", "idim-ls", "--json", file)
    assert (status, err) == (0, "")
    assert "inertia" in out and max(map(len, out.splitlines())) <= 80
    content = json.loads(file.read_text())
    assert list(content) == IDENTIFY_KEYS
    assert list(content["params"]) == ["inertia", "viscous", "coulomb", "offset"]
    assert content["params"]["inertia"] == pytest.approx(95.0, rel=0.02)
    assert content["cov_type"] == "hac" and content["converged"] is True


@pytest.mark.parametrize("cov", ["hac", "robust", "classical"])
def test_identify_takes_every_covariance(command, cov):
    status, out, _ = command("identify", "twin", "--cov", cov, "--json", "-")
    assert status == 0 and json.loads(out)["cov_type"] == cov


def test_identify_with_asymmetric_friction_has_the_names_of_equation_12(command):
    _, out, _ = command("identify", "twin", "--friction", "asymmetric", "--json", "-")
    names = ["inertia", "viscous_pos", "coulomb_pos", "viscous_neg", "coulomb_neg"]
    assert list(json.loads(out)["params"]) == names


def test_identify_writes_a_page_that_needs_no_other_file(command, tmp_path):
    status, out, _ = command("identify", "twin", "--out", tmp_path / "out", "--tests")
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert status == 0 and "report:" in out and "normal" in out
    assert "<svg" in page and not re.search(r'(?:src|href)="(?!#|data:)', page)
    assert (tmp_path / "out" / "force.svg").stat().st_size > 1000


def test_a_file_is_identified_with_its_axis_file(command, log, axis):
    status, out, err = command("identify", log, "--axis", axis)
    assert (status, err) == (0, "") and "inertia" in out


@pytest.mark.parametrize("suffix", [".csv.gz", ".parquet", ".mat"])
def test_every_kind_of_file_gives_the_same_answer(command, log, tmp_path, suffix):
    frame, file = pd.read_csv(log), tmp_path / f"log{suffix}"
    if suffix == ".csv.gz":
        frame.to_csv(file, index=False)
    elif suffix == ".parquet":
        frame.to_parquet(file)
    else:
        savemat(file, {name: frame[name].to_numpy() for name in frame})
    answers = [
        json.loads(command("identify", f, "--axis", "emps", "--json", "-")[1]) for f in (log, file)
    ]
    assert answers[0] == answers[1]


def test_a_logged_force_stands_in_for_the_command(command, log, tmp_path):
    file = tmp_path / "force.csv"
    frame = pd.read_csv(log)
    gain = axes.emps().gain
    frame.assign(tau=gain * frame["nu"]).drop(columns="nu").to_csv(file, index=False)
    answers = [
        json.loads(command("identify", f, "--axis", "emps", "--json", "-")[1])["params"]
        for f in (log, file)
    ]
    assert answers[0] == pytest.approx(answers[1], rel=1e-9)


@pytest.mark.parametrize(
    "method", [pytest.param(m, marks=pytest.mark.slow) if m in SLOW else m for m in METHODS]
)
def test_every_method_has_the_json_of_the_interface(command, method):
    status, out, _ = command("identify", "twin", "--method", method, "--json", "-")
    assert status == 0 and list(json.loads(out)) == IDENTIFY_KEYS
    assert json.loads(out)["method"] == method


def test_columns_are_mapped_by_the_axis_file(command, log, axis, tmp_path):
    file = tmp_path / "foreign.csv"
    pd.read_csv(log).rename(columns={"q": "pos", "nu": "u"}).to_csv(file, index=False)
    axis.write_text(AXIS + '\n[record.columns]\nq = "pos"\nnu = "u"\n', encoding="utf-8")
    assert command("identify", file, "--axis", axis)[0] == 0


def test_simulate_writes_the_json_of_the_interface(command, tmp_path):
    theta = tmp_path / "theta.json"
    assert command("identify", "twin", "--json", theta)[0] == 0
    status, out, _ = command("simulate", "twin", "--theta", theta, "--json", "-")
    assert status == 0
    content = json.loads(out)
    assert list(content) == ["relative_error"] and list(content["relative_error"]) == SIGNALS


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("theta.json", '{"inertia": 95, "viscous": 200, "coulomb": 20, "offset": 0}'),
        ("theta.toml", "inertia = 95\nviscous = 200.0\ncoulomb = 20\noffset = 0\n"),
        (
            "asymmetric.json",
            '{"params": {"inertia": 95, "viscous_pos": 165, "coulomb_pos": 20, '
            '"viscous_neg": 240, "coulomb_neg": 21}}',
        ),
    ],
)
def test_simulate_takes_a_mapping(command, tmp_path, name, text):
    (tmp_path / name).write_text(text)
    assert command("simulate", "twin", "--theta", tmp_path / name)[0] == 0


def test_simulate_has_parameters_when_none_are_given(command, log, axis, tmp_path):
    assert "true parameters" in command("simulate", "twin")[1]
    assert "IDIM-LS on this record" in command("simulate", log, "--axis", axis)[1]
    axis.write_text(AXIS + "viscous = 200\ncoulomb = 20\noffset = 0\n", encoding="utf-8")
    status, out, _ = command("simulate", log, "--axis", axis, "--out", tmp_path / "out")
    assert status == 0 and "axis file" in out and (tmp_path / "out" / "report.html").exists()


def test_compare_sets_models_and_methods_side_by_side(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out_dir, file = Path("out"), Path("comparison.json")
    status, out, _ = command(
        "compare", "twin", "--holdout", "twin", "--methods", "idim-ls,idim-wls",
        "--friction", "both", "--out", out_dir, "--json", file,
    )  # fmt: skip
    assert status == 0 and "idim-wls asym." in out and max(map(len, out.splitlines())) <= 80
    content = json.loads(file.read_text())
    assert list(content) == ["idim-ls", "idim-wls", "idim-ls asym.", "idim-wls asym."]
    assert {"params", "relative_error", "simulated", "simulated-holdout"} <= set(content["idim-ls"])
    assert (out_dir / "report.html").exists() and (out_dir / "parameters-2.svg").exists()


def test_transfer_functions_have_a_table_of_their_own(command, tmp_path):
    file = tmp_path / "comparison.json"
    status, out, _ = command(
        "compare", "twin", "--holdout", "twin", "--methods", "idim-ls, srivc clsrivc",
        "--friction", "both", "--out", tmp_path / "out", "--json", file,
    )  # fmt: skip
    tables, _ = out.split("report: ")
    assert status == 0 and max(map(len, tables.splitlines())) <= 80
    functions, physical = tables.split("Comparison\n")  # which ends with its recommendation
    assert "Transfer functions" in functions
    assert "inertia" in physical and "srivc" not in physical
    assert [line.split()[:3] for line in functions.splitlines() if "srivc" in line] == [
        ["srivc", "nu,", "q"], ["srivc", "nu,", "dq"], ["srivc", "q_ref,", "q"],
        ["clsrivc", "nu,", "q"],
    ]  # fmt: skip
    content = json.loads(file.read_text())
    assert list(content) == ["idim-ls", "idim-ls asym.", "transfer_functions"]
    entry = content["transfer_functions"][1]
    assert entry["output"] == "dq"
    assert entry["holdout_error"] == pytest.approx(entry["relative_error"], rel=1e-12)
    assert entry["pole_values"][0][0] == pytest.approx(-entry["params"]["a1"])
    assert "Transfer functions" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert (tmp_path / "out" / "transfer-function-3.svg").exists()


def test_transfer_functions_can_stand_alone(command, tmp_path):
    status, out, _ = command("compare", "twin", "--methods", "clsrivc", "--out", tmp_path)
    assert status == 0 and "Comparison" not in out and "clsrivc" in out
    assert (tmp_path / "report.html").exists() and (tmp_path / "transfer-function-1.svg").exists()
    status, out, _ = command("compare", "twin", "--methods", "clsrivc", "--json", "-")
    assert list(json.loads(out)) == ["transfer_functions"]


def test_diagnose_writes_the_json_of_the_interface_and_a_page(command, log, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = Path("gap.json")
    status, out, err = command("diagnose", log, "--axis", "emps", "--json", file, "--out", "out")
    assert (status, err) == (0, "") and max(map(len, out.splitlines())) <= 80
    content = json.loads(file.read_text())
    assert set(content) >= {
        "verdict", "effects", "ambiguous_with", "parameters", "where", "shrink", "ranking",
        "advice", "replicates",
    }  # fmt: skip
    page = Path("out/report.html").read_text(encoding="utf-8")
    assert content["verdict"].capitalize() in page and page.count("</figure>") == 8


def test_demo_writes_one_page(command, tmp_path):
    status, out, err = command("demo", "--out", tmp_path / "d", "--json", tmp_path / "d.json")
    assert (status, err) == (0, "") and "Estimates against the truth" in out
    assert [f.name for f in (tmp_path / "d").glob("*.html")] == ["report.html"]
    content = json.loads((tmp_path / "d.json").read_text())
    assert content["truth"]["inertia"] == 95.0


def test_reproduce_agrees_with_every_printed_number(
    command, emps, emps_pulses, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    file = Path("page.html")
    status, out, _ = command("reproduce", "--html", file, "--json", "r.json")
    assert status == 0 and "66 of 66" in out and max(map(len, out.splitlines())) <= 80
    assert json.loads((tmp_path / "r.json").read_text())["ok"] is True
    assert file.read_text(encoding="utf-8").count("</figure>") == 5


def test_effects_axis_and_data_tell_what_there_is(command):
    _, out, _ = command("effects")
    assert "Fs exp(-(dq/vs)^2) sign(dq)" in out and max(map(len, out.splitlines())) <= 80
    _, out, _ = command("effects", "--json", "-")
    assert {"block", "equation", "parameters", "source"} == set(json.loads(out)["stribeck"])
    assert command("axis", "emps")[1].strip() == AXIS.strip()
    assert json.loads(command("axis", "emps", "--json", "-")[1])["controller"]["kp"] == 160.18
    _, out, _ = command("methods")
    assert "the last estimate, iterated." in out and max(map(len, out.splitlines())) <= 80
    _, out, _ = command("data", "list")
    assert all(name in out for name in datasets.REGISTRY)


def test_data_path_prints_the_file(command, emps):
    status, out, _ = command("data", "path", "emps")
    assert status == 0 and Path(out.strip()).name == "DATA_EMPS.mat"


def test_version_and_help(command):
    assert command("--version")[1].startswith("ivtools ")
    for verb in ((), ("--help",), ("identify", "-h"), ("data", "--help")):
        status, out, _ = command(*verb)
        assert status == 0 and "Usage: ivtools" in out


# -- input at fault: one line, status 2 ------------------------------------------------------------
FAULTS = {
    "no such verb": (["idenitfy", "twin"], "No such command"),
    "no record": (["identify"], "Missing argument"),
    "no such option": (["identify", "twin", "--methd", "idim-ls"], "No such option"),
    "too many arguments": (["identify", "twin", "emps"], "unexpected extra argument"),
    "option without value": (["identify", "twin", "--method"], "requires an argument"),
    "no such record": (["identify", "nowhere.csv"], "no such file and no such data set"),
    "no such data set": (["identify", "empz"], "emps, emps-pulses, twin"),
    "folder as record": (["identify", ".", "--axis", "emps"], "not a file"),
    "no such method": (["identify", "twin", "--method", "magic"], "use one of idim-ls"),
    "no such covariance": (["identify", "twin", "--cov", "best"], "'hac'"),
    "no such friction": (["identify", "twin", "--friction", "none"], "'asymmetric'"),
    "no such axis": (["identify", "twin", "--axis", "empz"], "registered: emps"),
    "no such axis file": (["identify", "twin", "--axis", "none.toml"], "No such file"),
    "no such data folder": (["identify", "emps", "--data", "/nowhere"], "/nowhere"),
    "unknown axis": (["axis", "empz"], "known axes: emps"),
    "unknown data": (["data", "path", "empz"], "no registered data set"),
    "simulated data has no file": (["data", "fetch", "twin"], "simulated"),
    "no such data verb": (["data", "steal", "emps"], "No such command"),
    "no such parameters": (["simulate", "twin", "--theta", "none.json"], "No such file"),
    "empty methods": (["compare", "twin", "--methods", ","], "--methods is empty"),
    "wrong method in a list": (["compare", "twin", "--methods", "idim-ls,x"], "'x' is unknown"),
    "the known methods": (["compare", "twin", "--methods", "x"], "nsga2, srivc, rivc, clsrivc"),
    "no parameters": (["identify", "twin", "--method", "srivc"], "compare with --methods srivc"),
    "no such hold-out": (["compare", "twin", "--holdout", "none.csv"], "none.csv"),
    "JSON into a file as folder": (["axis", "emps", "--json", "/dev/null/x.json"], "cannot write"),
    "JSON onto a folder": (["axis", "emps", "--json", "."], "cannot write"),
    "report into a file as folder": (["simulate", "twin", "--out", "/dev/null/x"], "cannot write"),
    "page into a file as folder": (["demo", "--out", "/dev/null/x"], "cannot write"),
}


@pytest.mark.parametrize("arguments, said", FAULTS.values(), ids=FAULTS)
def test_a_fault_on_the_command_line_is_one_line(command, monkeypatch, arguments, said):
    monkeypatch.delenv("IVTOOLS_DATA", raising=False)
    status, _, err = command(*arguments)
    assert status == 2 and said in err


def spoiled(change):
    """A function of a data frame that sets one cell."""

    def apply(frame: pd.DataFrame) -> pd.DataFrame:
        frame = frame.astype(object)
        column, row, value = change
        frame.loc[row, column] = value
        return frame

    return apply


RECORD_FAULTS = {
    "NaN": (spoiled(("q", 57, np.nan)), "q is NaN at row 57"),
    "infinity": (spoiled(("nu", 3, "inf")), "nu is infinite at row 3"),
    "text": (spoiled(("q", 5, "open")), "q holds 'open' at row 5"),
    "time goes back": (spoiled(("t", 100, 0.0)), "t goes back at row 100"),
    "lost samples": (lambda f: f.drop(index=range(50, 60)), "t jitters"),
    "too short": (lambda f: f[:150], "fewer than 200"),
    "empty": (lambda f: f[:0], "no rows|fewer than 200|is empty|0 samples|holds no"),
    "constant q": (lambda f: f.assign(q=0.1), "q is constant"),
    "constant nu": (lambda f: f.assign(nu=1.0), "nu is constant"),
    "constant reference": (lambda f: f.assign(q_ref=0.0), "q_ref is constant"),
    "no q": (lambda f: f.drop(columns="q"), "q is missing|column q"),
    "no t": (lambda f: f.drop(columns="t"), "t is missing|column t"),
    "no command": (lambda f: f.drop(columns="nu"), "nu and tau"),
}


@pytest.mark.parametrize("change, said", RECORD_FAULTS.values(), ids=RECORD_FAULTS)
@pytest.mark.parametrize("verb", ["identify", "compare", "diagnose"])
def test_a_broken_record_is_one_line(command, log, tmp_path, verb, change, said):
    file = tmp_path / "broken.csv"
    change(pd.read_csv(log)).to_csv(file, index=False)
    status, _, err = command(verb, file, "--axis", "emps")
    assert status == 2 and any(part in err for part in said.split("|"))


def test_a_record_without_reference_can_be_identified_but_not_simulated(command, log, tmp_path):
    file = tmp_path / "no_reference.csv"
    pd.read_csv(log).drop(columns="q_ref").to_csv(file, index=False)
    assert command("identify", file, "--axis", "emps")[0] == 0
    status, _, err = command("simulate", file, "--axis", "emps")
    assert status == 2 and "q_ref is missing" in err


def test_a_record_of_two_joints_says_one_at_a_time(command, log, tmp_path):
    file = tmp_path / "two.csv"
    frame = pd.read_csv(log)
    names = {name: f"{name}1" for name in ("q", "q_ref", "nu")}
    two = frame.rename(columns=names).assign(q2=frame.q, q_ref2=frame.q_ref, nu2=frame.nu)
    two.to_csv(file, index=False)
    status, _, err = command("identify", file, "--axis", "emps")
    assert status == 2 and "2 joints" in err


def test_a_record_without_an_axis_asks_for_it(command, log):
    status, _, err = command("identify", log)
    assert status == 2 and "give --axis FILE" in err


AXIS_FAULTS = {
    "not TOML": ("[axis\n", "is not TOML"),
    "empty": ("", "is missing"),
    "unknown table": (AXIS + "\n[motor]\nx = 1\n", "[motor] is not known"),
    "unknown key": (AXIS.replace("kp =", "kpp ="), "kpp"),
    "text for a number": (AXIS.replace("160.18 ", '"160"'), "is not a number"),
    "unknown controller": (AXIS.replace("cascade-pd", "pid"), "pid"),
    "missing gain": (AXIS.replace("gain = 35.15065188", ""), "gain is missing"),
    "zero gain": (AXIS.replace("35.15065188", "0.0"), "must be finite and not 0"),
    "infinite gain": (AXIS.replace("35.15065188", "inf"), "must be finite"),
    "unknown joint": (AXIS.replace("prismatic", "hinge"), "hinge"),
    "unknown term": (AXIS.replace('"offset"]', '"magic"]'), "magic"),
    "term twice": (AXIS.replace('"offset"]', '"viscous"]'), "given twice"),
    "negative delay": (AXIS.replace("delay = 1 ", "delay = -1 "), "delay is -1"),
    "start of what is not there": (AXIS + "mass = 1.0\n", "mass"),
    "not a list": (AXIS.replace("[0.5, 0.5]", "0.5"), "velocity_filter"),
    "binary": ("\udcff\udcfe", "is not TOML"),
}


@pytest.mark.parametrize("text, said", AXIS_FAULTS.values(), ids=AXIS_FAULTS)
def test_a_broken_axis_file_is_one_line(command, log, axis, text, said):
    axis.write_text(text, encoding="utf-8", errors="surrogateescape")
    status, _, err = command("identify", log, "--axis", axis)
    assert status == 2 and said in err


THETA_FAULTS = {
    "not JSON": ("{", "neither JSON nor TOML"),
    "a list": ("[1, 2]", "holds no parameters"),
    "empty": ("{}", "holds no parameters"),
    "text": ('{"inertia": "heavy"}', "give a finite number"),
    "NaN": ('{"inertia": NaN}', "give a finite number"),
    "flag": ('{"inertia": true}', "give a finite number"),
    "unknown parameter": ('{"inertia": 95, "mass": 1}', "'mass' is not in the model"),
    "missing parameter": ('{"inertia": 95}', "has no value"),
    "negative inertia": (
        '{"inertia": -95, "viscous": 1, "coulomb": 1, "offset": 0}',
        "inertia",
    ),
}


@pytest.mark.parametrize("text, said", THETA_FAULTS.values(), ids=THETA_FAULTS)
def test_broken_parameters_are_one_line(command, tmp_path, text, said):
    file = tmp_path / "theta.json"
    file.write_text(text)
    status, _, err = command("simulate", "twin", "--theta", file)
    assert status == 2 and said in err


# -- what looks wrong but can be used: a warning ---------------------------------------------------
DOUBTS = {
    "position in mm": ({"q": 1e3, "q_ref": 1e3}, "check the units of q"),
    "command in mV": ({"nu": 1e3}, "check the units of q"),
    "time in ms": ({"t": 1e3}, "is it in s?"),
    "sign of the command": ({"nu": -1.0}, "opposite sign"),
    "sign of the position": ({"q": -1.0, "q_ref": -1.0}, "opposite sign"),
}


@pytest.mark.parametrize("scales, said", DOUBTS.values(), ids=DOUBTS)
def test_a_suspicious_unit_is_a_warning(command, log, tmp_path, scales, said):
    file = tmp_path / "units.csv"
    frame = pd.read_csv(log)
    frame.assign(**{name: scale * frame[name] for name, scale in scales.items()}).to_csv(
        file, index=False
    )
    _, _, err = command("identify", file, "--axis", "emps")
    assert "warning:" in err and said in err


def test_a_simulation_that_is_lost_is_a_warning(command, tmp_path):
    file = tmp_path / "theta.json"
    file.write_text('{"inertia": 0.01, "viscous": 0, "coulomb": 0, "offset": 0}')
    status, _, err = command("simulate", "twin", "--theta", file)
    assert status == 0 and "does not follow" in err


def test_a_sound_record_gives_no_warning(command, log):
    assert command("identify", log, "--axis", "emps")[2] == ""


# -- how a command ends ----------------------------------------------------------------------------
def test_an_internal_error_is_one_line_and_status_1(command, monkeypatch):
    def fail(*_: object) -> None:
        raise RuntimeError("out of order")

    monkeypatch.setattr(axes, "path", fail)
    status, _, err = command("axis", "emps")
    assert status == 1 and "internal error: RuntimeError: out of order" in err


def test_too_little_memory_is_one_line_and_status_1(command, monkeypatch):
    def fail(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(axes, "path", fail)
    status, _, err = command("axis", "emps")
    assert status == 1 and err.count("\n") == 1 and "memory does not suffice" in err


def test_an_interrupt_is_one_line_and_keeps_what_is_finished(command, monkeypatch, tmp_path):
    from ivtools.estimators.least_squares import IDIMWLS

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(IDIMWLS, "fit", interrupted)
    file = tmp_path / "c.json"
    status, _, err = command("compare", "twin", "--methods", "idim-ls,idim-wls", "--json", file)
    assert status == 130 and err == "ivtools: interrupted; what was finished is kept\n"
    assert list(json.loads(file.read_text())) == ["idim-ls"]
    status, out, _ = command("identify", "twin", "--method", "idim-wls")
    assert status == 130 and not out


def test_a_method_that_fails_does_not_stop_the_others(command, monkeypatch):
    from ivtools.errors import EstimationError
    from ivtools.estimators.least_squares import IDIMWLS

    def fail(*_: object) -> None:
        raise EstimationError("no such luck")

    monkeypatch.setattr(IDIMWLS, "fit", fail)
    status, out, _ = command("compare", "twin", "--methods", "idim-ls,idim-wls")
    assert status == 0 and "idim-wls: no such luck" in out
    assert command("compare", "twin", "--methods", "idim-wls")[0] == 2


def test_warnings_of_others_are_not_shown_and_filters_are_restored(command):
    before = list(warnings.filters)
    command("identify", "twin")
    assert warnings.filters == before


def shell(*arguments: str, **options) -> subprocess.CompletedProcess:
    code = "from ivtools.cli import main; main()"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, **options
    )


def test_a_pipe_sees_neither_progress_nor_colours(tmp_path):
    done = shell("compare", "twin", "--methods", "idim-ls", env={**os.environ, "FORCE_COLOR": ""})
    assert done.returncode == 0 and done.stderr == "" and "\x1b" not in done.stdout


def test_a_reader_that_leaves_early_is_no_traceback():
    code = "from ivtools.cli import main; main()"
    with subprocess.Popen(
        [sys.executable, "-c", code, "effects"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        process.stdout.close()
        err = process.stderr.read()
    assert b"Traceback" not in err and b"Exception" not in err


@pytest.mark.skipif(os.name == "nt", reason="needs a POSIX terminal")
def test_a_terminal_sees_progress_and_the_pipe_beside_it_does_not():
    import pty

    code = "from ivtools.cli import main; main()"
    command = [sys.executable, "-c", code, "compare", "twin", "--methods", "idim-ls"]
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=theirs, env={**os.environ, "TERM": "xterm"}
    ) as process:
        os.close(theirs)
        seen = bytearray()
        try:
            while part := os.read(ours, 4096):
                seen += part
        except OSError:  # the other end is closed
            pass
        out = process.stdout.read()
    os.close(ours)
    assert b"identifying" in seen or b"idim-ls" in seen
    assert b"inertia" in out and b"\x1b" not in out


@pytest.mark.parametrize("locale", [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C"}])
def test_a_terminal_that_knows_ascii_only_is_no_obstacle(locale):
    for arguments in (("--help",), ("effects",), ("axis", "emps")):
        done = shell(*arguments, env={**os.environ, **locale})
        assert done.returncode == 0 and "Traceback" not in done.stderr


@pytest.mark.skipif(os.name == "nt", reason="needs POSIX signals")
def test_control_c_in_a_shell_is_one_line(tmp_path):
    code = "from ivtools.cli import main; main()"
    command = [sys.executable, "-c", code, "demo", "--out", str(tmp_path / "demo")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        time.sleep(1.2)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert b"Traceback" not in err
    assert process.returncode in (0, 130)  # 0: it was quicker


def test_help_needs_no_heavy_library():
    code = (
        "import sys\nfrom ivtools.cli import run\nrun(['--help'])\n"
        "heavy = {'pandas', 'scipy', 'numba', 'control', 'statsmodels', 'matplotlib', 'numpy'}\n"
        "sys.exit(len(heavy & {name.split('.')[0] for name in sys.modules}))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0


def test_least_squares_needs_neither_control_nor_statsmodels():
    code = (
        "import sys\nfrom ivtools.cli import run\nrun(['identify', 'twin'])\n"
        "heavy = {'control', 'statsmodels', 'matplotlib', 'jinja2'}\n"
        "sys.exit(len(heavy & {name.split('.')[0] for name in sys.modules}))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0


# -- malformed files, generated --------------------------------------------------------------------
MALFORMED = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@MALFORMED
@given(content=st.binary(max_size=400))
def test_any_bytes_as_csv_are_at_most_an_error_of_the_input(tmp_path, content):
    file = tmp_path / "any.csv"
    file.write_bytes(content)
    assert run(["identify", str(file), "--axis", "emps"]) == 2


@MALFORMED
@given(data=st.data())
def test_a_csv_with_a_damaged_line_is_an_answer_or_an_error(tmp_path, log, data):
    lines = log.read_text().splitlines()[:400]
    row = data.draw(st.integers(0, len(lines) - 1))
    damage = st.text(st.characters(codec="utf-8", exclude_characters="\r\n"), max_size=30)
    lines[row] = data.draw(damage)
    file = tmp_path / "damaged.csv"
    file.write_text("\n".join(lines), encoding="utf-8")
    assert run(["identify", str(file), "--axis", "emps", "--json", str(tmp_path / "o.json")]) in (
        0,
        2,
    )


@MALFORMED
@given(
    cut=st.integers(0, len(AXIS)),
    inserted=st.text(st.characters(codec="utf-8"), max_size=20),
    removed=st.integers(0, 12),
)
def test_an_axis_file_with_a_slip_is_an_answer_or_an_error(tmp_path, cut, inserted, removed):
    file = tmp_path / "slip.toml"
    file.write_text(AXIS[:cut] + inserted + AXIS[cut + removed :], encoding="utf-8", newline="")
    assert run(["axis", "emps", "--json", str(tmp_path / "o.json")]) == 0
    assert app is not None
    from ivtools.cli.case import load_axis
    from ivtools.errors import IVToolsError

    try:
        load_axis(str(file))
    except IVToolsError as error:
        assert "\n" not in str(error).strip()


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner),
    max_leaves=6,
)


@MALFORMED
@given(content=JSON)
def test_any_json_as_parameters_is_an_error_of_the_input(tmp_path, content):
    file = tmp_path / "any.json"
    file.write_text(json.dumps(content))
    from ivtools.cli.case import load_theta
    from ivtools.errors import IVToolsError

    try:
        theta = load_theta(file)
    except IVToolsError:
        return
    assert all(np.isfinite(value) for value in theta.values())


def test_the_package_runs_as_a_module():
    found = subprocess.run(
        [sys.executable, "-m", "ivtools", "-V"], capture_output=True, text=True, check=True
    )
    assert found.stdout.strip().endswith(__version__)
