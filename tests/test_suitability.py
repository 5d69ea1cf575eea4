"""`ivtools check` and the small verbs: what will be used, in twenty lines, before any estimate."""

import json

import numpy as np
import pytest

from ivtools import axes, diagnose
from ivtools.cli import run
from ivtools.suitability import suitability


def test_a_sound_record_suffices(twin):
    found = suitability(twin, axes.emps())
    assert found.sufficient
    assert len(str(found.summary()).splitlines()) <= 20
    told = found.to_dict()
    assert told["parity_r2"] > 0.999
    noise, unit = told["rows"]["noise"]["value"].split()
    assert unit == "nm" and float(noise) == pytest.approx(5e-8 / np.sqrt(12) * 1e9, rel=0.5)


def test_what_is_wrong_is_said(twin):
    wrong = axes.emps().with_terms("inertia", "viscous", "coulomb", "offset", "spring")
    found = suitability(twin.slice(0, 700), wrong)
    assert not found.sufficient and any("log 5 s or more" in text for text in found.advice)
    from dataclasses import replace

    controller = replace(axes.emps().controller, settings={"kp": 100.0, "kv": 300.0})
    off = suitability(twin, replace(axes.emps(), controller=controller))
    assert any("the law explains" in text for text in off.advice)


def test_check_writes_a_page_a_figure_and_json(tmp_path, capsys):
    file = tmp_path / "c.json"
    assert run(["check", "twin", "--out", str(tmp_path), "--json", str(file)]) == 0
    assert "it suffices" in capsys.readouterr().out
    assert json.loads(file.read_text())["sufficient"]
    assert (tmp_path / "record.svg").read_text().count("<svg") == 1
    assert "The log suffices." in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["identify", "epms"], "no such file and no such data set"),
        (["identify", "twin", "--axis", "epms"], "neither an axis file nor a registered axis"),
        (["diagnose", "epms"], "no such file and no such data set"),
        (["compare", "twin", "--holdout", "epms"], "no such file and no such data set"),
    ],
)
def test_a_mistyped_name_is_told_before_anything_heavy_is_loaded(arguments, said):
    import subprocess
    import sys

    code = (
        "import sys; from ivtools.cli import run; status = run(sys.argv[1:]); "
        "print(*{n.split('.')[0] for n in sys.modules} & {'numba', 'scipy', 'pandas', 'numpy'}); "
        "sys.exit(status)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2 and said in done.stderr and not done.stdout.strip()


def test_a_folder_that_cannot_be_written_is_told_before_the_work(capsys, monkeypatch):
    from ivtools.cli import options

    def full(*_: object, **__: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(options.tempfile, "TemporaryFile", full)
    assert run(["demo", "--out", "somewhere"]) == 2
    assert "read-only file system" in capsys.readouterr().err


def test_methods_are_listed(capsys):
    assert run(["methods", "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["idim-iv"]["class"] == "IDIMIV" and all(m["about"] for m in told.values())
    assert run(["-V"]) == 0
    assert capsys.readouterr().out.startswith("ivtools ")


def test_what_a_reader_left_out_is_said_by_a_first_look_and_by_a_diagnosis(twin):
    """Not what a record says of itself."""
    told = "left out: 6 rows said twice"
    record = twin.replace(notes=(told,)).slice(0, 6000)
    assert record.reading_notes == (told,) == record.replace(name="other").reading_notes
    assert told in suitability(record, axes.emps()).summary()
    found = diagnose(record, axes.emps()).findings
    assert [f.text for f in found if told in f.text] == [f"{record.name}: {told}"]
    arm = record.replace(q=np.column_stack([record.q, 0 * record.q]),
                         q_ref=np.column_stack([record.q_ref] * 2),
                         nu=np.column_stack([record.nu] * 2))  # fmt: skip
    assert [arm.joint(j).reading_notes for j in (0, 1)] == [(told,), (told,)] != [arm.notes] * 2
    jittery = record.replace(t=record.t + 5e-7 * np.sin(np.arange(record.n_samples)))
    assert jittery.reading_notes == (told,) != jittery.notes
