"""A fleet: many records, in parallel, resumable; what fails is a row."""

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import ivtools as iv
from ivtools.cli import run
from ivtools.errors import IVToolsError
from ivtools.gap.fleet import run as fleet_run
from ivtools.gap.fleet.entry import Entry
from ivtools.gap.fleet.shelf import Shelf
from ivtools.gap.fleet.source import sources

THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
SAMPLES = 6000


@pytest.fixture(scope="module")
def loop():
    return iv.axes.emps()


@pytest.fixture(scope="module")
def made(loop):
    """Return records of axes whose friction differs by direction, by more from one to the next."""
    given = iv.datasets.twin().slice(0, SAMPLES)

    def make(k: int) -> iv.Record:
        truth = loop.with_effect("asymmetric-viscous", delta=-60.0 - 10.0 * k)
        noise = np.random.default_rng(k).normal(0.0, 1.0, SAMPLES)
        sim = truth.simulate(given, THETA, initial="rest", force_noise=noise)
        return given.replace(q=sim.q, nu=sim.nu, name=f"axis {k}")

    return [make(k) for k in range(2)]


@pytest.fixture(scope="module")
def logs(made, tmp_path_factory):
    """A folder of two sound logs, one too short to judge, one broken, and what is no record."""
    folder = tmp_path_factory.mktemp("logs")
    for k, record in enumerate(made):
        record.to_frame().to_csv(folder / f"axis {k}.csv", index=False)
    short = made[0].slice(0, 2000).to_frame()
    short.to_csv(folder / "short.csv", index=False)
    short.assign(q=short["q"].where(short.index != 57)).to_csv(folder / "broken.csv", index=False)
    (folder / "notes.txt").write_text("not a record")
    return folder


@pytest.fixture(scope="module")
def fleet(logs, loop, tmp_path_factory):
    """The folder, diagnosed by two workers, with pages."""
    files = sorted(logs.glob("*.csv"))
    return iv.diagnose_fleet(files, loop, path=tmp_path_factory.mktemp("out"), n_jobs=2)


@pytest.fixture
def quick(fleet, made, loop, monkeypatch):
    """Diagnoses that take no time; returns what was asked for."""
    asked = []
    found = iv.diagnose(made[0].slice(0, 500), loop)  # refused, but a diagnosis

    def diagnose(record, loop, holdout=None, **settings):
        asked.append((record.name, None if holdout is None else holdout.name))
        return replace(found, name=record.name)

    monkeypatch.setattr(fleet_run, "diagnose", diagnose)
    return asked


# -- what comes out --------------------------------------------------------------------------------
def test_every_record_is_a_row_and_a_failure_too(fleet):
    table = fleet.frame()
    assert table["record"].tolist() == ["axis_0", "axis_1", "broken", "short"]
    assert table["verdict"].tolist() == ["explained", "explained", "failed", "unexplained"]
    assert table["effects"].tolist() == ["asymmetric-viscous"] * 2 + ["", ""]
    deltas = table["asymmetric-viscous.delta"]
    assert deltas[:2].tolist() == pytest.approx([-60.0, -70.0], rel=0.1)
    assert (table["after"][:2] < 0.8 * table["before"][:2]).all()
    assert "q is NaN at row 57" in fleet["broken"].error
    assert "at least 3 s" in fleet["short"].remark


def test_a_row_says_which_settings_changed():
    changed = {"inertia": {"record": 1.0, "holdout": 1.2, "t": 90.0}, "coulomb": {}}
    told = {"verdict": "non-repeatable", "findings": ["one thing", "another"]}
    entry = Entry("monday", content={**told, "changed": changed}, judged_by="new")
    assert entry.remark == "inertia and coulomb changed between it and new"
    assert Entry("monday", content={**told, "changed": {}}).remark == "one thing"


def test_a_row_is_what_the_record_gives_alone(fleet, logs, loop):
    alone = iv.diagnose(iv.Record.read(logs / "axis 0.csv"), loop).to_dict()
    found = fleet["axis_0"].content
    for key in ("verdict", "effects", "ambiguous_with", "advice", "findings"):
        assert found[key] == alone[key]
    assert found["parameters"] == {
        name: pytest.approx(values) for name, values in alone["parameters"].items()
    }
    for key in ("before", "after", "floor", "closed"):
        assert found["shrink"][key] == pytest.approx(alone["shrink"][key])


def test_the_folder_holds_a_page_each_an_overview_and_the_table(fleet):
    assert sorted(p.name for p in (fleet.folder / "records").glob("*.html")) == [
        "axis_0.html", "axis_1.html", "short.html",
    ]  # fmt: skip
    pages = [p.read_text(encoding="utf-8") for p in (fleet.folder / "records").glob("*.html")]
    shared = '<script src="../charts.js"></script>'
    assert all("uPlot=" not in page for page in pages) and any(shared in page for page in pages)
    assert "uPlot" in (fleet.folder / "charts.js").read_text(encoding="utf-8")
    overview = (fleet.folder / "index.html").read_text(encoding="utf-8")
    assert overview.count('href="records/') == 3 and "<svg" in overview
    assert "Diagnosis of axis_0" in fleet["axis_0"].page.read_text(encoding="utf-8")
    read = pd.read_csv(fleet.folder / "fleet.csv")
    assert read["after"].tolist() == pytest.approx(
        fleet.frame()["after"].tolist(), 1e-5, nan_ok=True
    )


def test_it_shows_itself(fleet):
    text = fleet.summary()
    assert max(map(len, text.splitlines())) <= 80
    assert "named in 2 of 4" in text and "broken: " in text
    assert len(fleet.plot().axes) == 2 and "<table " in fleet._repr_html_()
    assert [e.name for e in fleet] == [d["name"] for d in fleet.to_dict()] and len(fleet) == 4


def test_names_are_unlike_and_fit_for_files():
    given = ["a/log.csv", "b/log.csv", "b/log.csv", "c/LOG.csv", "d/<1>.csv.gz", "e/...csv"]
    names = [s.name for s in sources(given)]
    assert names == ["log", "b-log", "c-LOG", "1", "record"]


# -- resuming --------------------------------------------------------------------------------------
def test_what_is_finished_is_not_computed_again(fleet, logs, loop, quick):
    files = sorted(logs.glob("*.csv"))
    again = iv.diagnose_fleet(files, loop, path=fleet.folder, n_jobs=1)
    assert not quick and sum(e.reused for e in again) == 3
    assert "3 of 4 were diagnosed before" in again.summary()
    assert again.frame().drop(columns="seconds").equals(fleet.frame().drop(columns="seconds"))


@pytest.mark.parametrize(
    "change", ["content", "axis", "holdout", "judge", "rules", "tolerance", "without"]
)
def test_whatever_a_diagnosis_rests_on_makes_it_another(made, loop, quick, tmp_path, change):
    file = tmp_path / "log.csv"
    frame = made[0].slice(0, 1000).to_frame()
    frame.to_csv(file, index=False)
    settings = {"path": tmp_path / "out", "n_jobs": 1}
    iv.diagnose_fleet([file], loop, **settings)
    if change == "content":
        frame.assign(nu=1.01 * frame["nu"]).to_csv(file, index=False)
    elif change == "axis":
        loop = loop.with_terms("inertia", "viscous", "coulomb")
    else:
        settings |= {
            "holdout": {"holdout": made[1]},
            "judge": {"judge": made[1]},
            "tolerance": {"tolerance": 5.0},
            "rules": {"rules": iv.gap.Rules(equivalence=0.1)},
            "without": {"without": ["stribeck"]},
        }[change]
    iv.diagnose_fleet([file], loop, **settings)
    iv.diagnose_fleet([file], loop, **settings)
    assert len(quick) == 2


def test_an_interrupted_fleet_says_what_is_left_and_goes_on(
    made, loop, quick, tmp_path, monkeypatch
):
    records = [made[0].slice(0, 1000 + k).replace(name=f"r{k}") for k in range(4)]
    diagnose = fleet_run.diagnose

    def stop(record, *rest, **settings):
        if record.name == "r2":
            raise KeyboardInterrupt
        return diagnose(record, *rest, **settings)

    monkeypatch.setattr(fleet_run, "diagnose", stop)
    with pytest.raises(KeyboardInterrupt, match="2 of 4 records diagnosed; .* goes on from there"):
        iv.diagnose_fleet(records, loop, path=tmp_path, n_jobs=1)
    assert len(pd.read_csv(tmp_path / "fleet.csv")) == 2
    monkeypatch.setattr(fleet_run, "diagnose", diagnose)
    del quick[:]
    iv.diagnose_fleet(records, loop, path=tmp_path, n_jobs=1)
    assert [name for name, _ in quick] == ["r2", "r3"]


def test_a_half_written_result_is_made_again(made, loop, quick, tmp_path):
    record = made[0].slice(0, 1000)
    iv.diagnose_fleet([record], loop, path=tmp_path, n_jobs=1)
    file = tmp_path / "records" / "axis_0.json"
    file.write_text(file.read_text()[:100])
    iv.diagnose_fleet([record], loop, path=tmp_path, n_jobs=1)
    assert len(quick) == 2 and json.loads(file.read_text())["diagnosis"]


@pytest.mark.parametrize("kind", [".json", ".html"])
def test_whatever_bit_of_a_result_flips_it_is_made_again(fleet, logs, loop, quick, tmp_path, kind):
    shelf, rng = Shelf(tmp_path), np.random.default_rng(14)
    entry = shelf.keep(replace(fleet.done[0], seconds=1e-7), "key", "<html></html>\n")
    assert shelf.find(entry, "key") and not shelf.find(entry, "another")
    file = entry.page.with_suffix(kind)
    whole = file.read_bytes()
    for _ in range(200):
        changed = bytearray(whole)
        changed[rng.integers(len(whole))] ^= 1 << rng.integers(8)
        file.write_bytes(changed)
        assert shelf.find(entry, "key") is None
    file.write_bytes(whole)
    assert shelf.find(entry, "key")
    text = entry.page.with_suffix(".json").read_bytes()
    spelt = text.replace(b"1e-07", b"1E-07")  # the same number
    assert spelt != text
    for content in (spelt, b"[]", b"null", b'{"key": "key", "checksum": 1}', b"[" * 100_000):
        entry.page.with_suffix(".json").write_bytes(content)
        assert shelf.find(entry, "key") is None


# -- who judges, and where -------------------------------------------------------------------------
def test_one_holdout_judges_all_but_itself(made, loop, quick):
    third = made[1].slice(0, 4000).replace(name="third")
    found = iv.diagnose_fleet([*made, third], loop, made[1], n_jobs=1)
    assert [e.judged_by for e in found] == ["axis_1", "", "axis_1"]


def test_the_holdout_reaches_the_diagnosis(made, loop, quick):
    iv.diagnose_fleet(made, loop, made[1], n_jobs=1)
    assert quick == [("axis_0", "axis 1"), ("axis_1", None)]


def test_a_judge_takes_part_in_nothing(made, loop, quick, monkeypatch):
    told = []
    diagnose = fleet_run.diagnose

    def noted(*args, **settings):
        told.append((settings["judge"] and settings["judge"].name, settings["tolerance"]))
        return diagnose(*args, **settings)

    monkeypatch.setattr(fleet_run, "diagnose", noted)
    iv.diagnose_fleet(made, loop, judge=made[1], tolerance=5.0, n_jobs=1)
    assert told == [("axis 1", 5.0), (None, 5.0)]
    with pytest.raises(IVToolsError, match="axis_1 is hold-out and judge"):
        iv.diagnose_fleet(made, loop, made[1], judge=made[1], n_jobs=1)


def test_an_error_of_ours_ends_one_record_only(made, loop, quick, monkeypatch):
    diagnose = fleet_run.diagnose

    def fail(record, *rest, **settings):
        return 1 / 0 if record.name == "axis_0" else diagnose(record, *rest, **settings)

    monkeypatch.setattr(fleet_run, "diagnose", fail)
    found = iv.diagnose_fleet(made, loop, n_jobs=1)
    assert found["axis_0"].error == "internal error: ZeroDivisionError: division by zero"
    assert len(found.done) == 1


def test_no_record_and_no_backend_are_errors(loop):
    with pytest.raises(IVToolsError, match="no record to diagnose"):
        iv.diagnose_fleet([], loop)
    with pytest.raises(IVToolsError, match="use loky, threading or dask"):
        iv.diagnose_fleet(["x.csv"], loop, backend="mpi")


def test_a_cluster_finds_the_same(logs, loop, fleet, tmp_path):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        files = [logs / "short.csv", logs / "broken.csv"]
        settings = {"backend": "dask", "scheduler": cluster.scheduler_address, "path": tmp_path}
        found = iv.diagnose_fleet(files, loop, **settings)
    assert found["short"].content == json.loads(json.dumps(fleet["short"].content))
    assert found["short"].page.exists() and found["broken"].error == fleet["broken"].error


def test_a_pickled_loop_simulates_the_same(made, loop):
    sent = pickle.loads(pickle.dumps(loop.with_effect("stribeck", force=3.0, speed=0.01)))
    assert all(a is b for a, b in zip(sent.terms, loop.terms, strict=False))
    plain = pickle.loads(pickle.dumps(loop)).simulate(made[0], THETA)
    assert np.array_equal(plain.q, loop.simulate(made[0], THETA).q)


# -- the command -----------------------------------------------------------------------------------
@pytest.fixture
def command(capsys, quick):
    def call(*arguments: object) -> tuple[int, str, str]:
        status = run(["diagnose", *map(str, arguments), "--axis", "emps", "--jobs", "1"])
        return (status, *capsys.readouterr())

    return call


def test_a_folder_a_pattern_and_names_are_the_same_fleet(command, logs, tmp_path):
    files = sorted(logs.glob("*.csv"))
    answers = []
    for given in ([logs], [logs / "*.csv"], files):
        file = tmp_path / f"{len(answers)}.json"
        status, out, err = command(*given, "--json", file)
        assert (status, err) == (1, "") and "Fleet of EMPS: 4 records" in out
        answers.append(json.loads(file.read_text()))
    assert answers[0] == answers[1] == answers[2]
    assert [a["name"] for a in answers[0]] == ["axis_0", "axis_1", "broken", "short"]
    assert [bool(a["error"]) for a in answers[0]] == [False, False, True, False]
    assert set(answers[0][0]) >= {"verdict", "effects", "shrink", "ranking", "file"}


def test_the_command_hands_judge_and_tolerance_on(command, logs, monkeypatch):
    told = []
    whole = fleet_run.diagnose_fleet

    def noted(*args, **settings):
        told.append((settings["judge"], settings["tolerance"]))
        return whole(*args, **settings)

    monkeypatch.setattr("ivtools.gap.diagnose_fleet", noted)
    both = [logs / "axis 0.csv", logs / "broken.csv"]
    command(*both, "--judge", logs / "axis 1.csv", "--tolerance", 5)
    assert told == [(str(logs / "axis 1.csv"), 5.0)]


def test_the_status_says_whether_all_some_or_none_are_done(command, logs, tmp_path):
    good = [logs / "axis 0.csv", logs / "axis 1.csv"]
    status, out, _ = command(*good, "--out", tmp_path / "out")
    assert status == 0 and "report:" in out and (tmp_path / "out" / "index.html").exists()
    assert command(*good, logs / "broken.csv")[0] == 1
    status, out, err = command(logs / "broken.csv", logs / "notes.txt")
    assert (status, out) == (2, "") and "no record could be diagnosed" in err
    assert err.count("\n") == 1 and "q is NaN at row 57" in err


def test_a_pattern_that_matches_nothing_is_a_fault(command, tmp_path):
    for given in (tmp_path / "*.csv", tmp_path):
        status, _, err = command(given)
        assert status == 2 and "no file matches" in err


def test_one_record_stays_one(capsys, logs):
    status = run(["diagnose", str(logs / "short*.csv"), "--axis", "emps", "--json", "-"])
    content = json.loads(capsys.readouterr().out)
    assert status == 0 and content["verdict"] == "unexplained" and content["shrink"] is None


def test_an_interrupted_command_says_how_to_go_on(command, quick, logs, tmp_path, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(fleet_run, "diagnose", stop)
    status, _, err = command(logs, "--out", tmp_path / "out")
    assert status == 130 and "the same command goes on from there" in err
    assert Path(tmp_path / "out" / "fleet.csv").exists()
