"""Studies that stream to a folder: killed at any moment, they go on where they were."""

import errno
import os
import shutil
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import ivtools as iv
from ivtools.errors import DataError, IVToolsError
from ivtools.files import replacing
from ivtools.study import COLUMNS, MEASURED, Case, Study, Trapezoids, load
from ivtools.study.table import Block, Store, checksum, part

SCRIPT = """
import time
import ivtools as iv
from ivtools.study import Case, Study, Trapezoids

class Slow:
    # takes as long as a real fit; the table must not depend on it
    def fit(self, problem):
        time.sleep(0.01)
        return dict(zip(problem.names, problem.X[0].tolist()))

theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
moves = Trapezoids(1.0, strokes=(0.03,), speeds=(0.12,))
cases = [
    Case(f"{e:g}", iv.axes.emps(), theta, moves, encoder_noise=e, force_noise=2.0)
    for e in (1e-7, 1e-6)
]
study = Study(cases, {"slow": Slow(), "ls": iv.IDIMLS()}, seeds=SEEDS)
"""
RUN = """
import sys
from ivtools.study import load, plan
plan.BLOCK_S = 0.05
load(sys.argv[1]).run(n_jobs=int(sys.argv[3]), path=sys.argv[2])
"""


def same(a: pd.DataFrame, b: pd.DataFrame) -> None:
    columns = [name for name in COLUMNS if name not in MEASURED]
    pd.testing.assert_frame_equal(a[columns], b[columns], check_exact=True)


MOVES = Trapezoids(1.0, strokes=(0.03,), speeds=(0.12,))


def small(seeds: int = 5, estimators=None, **changes) -> Study:
    theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    settings = {"force_noise": 2.0, **changes}
    cases = [Case(n, iv.axes.emps(), theta, MOVES, **settings) for n in ("a", "b")]
    return Study(cases, estimators or {"ls": iv.IDIMLS()}, seeds)


class Counting:
    """An estimator that counts how often it was asked."""

    asked = 0

    def fit(self, problem):
        type(self).asked += 1
        return dict.fromkeys(problem.names, 1.0)


def test_finished_work_is_not_done_again(tmp_path):
    Counting.asked = 0
    estimators = {"counting": Counting()}
    first = small(5, estimators).run(path=tmp_path)
    assert Counting.asked == 10
    same(small(5, estimators).run(path=tmp_path), first)
    assert Counting.asked == 10
    more = small(8, estimators).run(path=tmp_path)
    assert Counting.asked == 16
    same(more[more["seed"] < 5].reset_index(drop=True), first)
    same(small(5, estimators).run(path=tmp_path), first)


def test_another_estimator_or_case_adds_its_own_fits_only(tmp_path):
    Counting.asked = 0
    small(4, {"counting": Counting()}).run(path=tmp_path)
    both = {"ls": iv.IDIMLS(), "counting": Counting()}
    table = small(4, both).run(path=tmp_path)
    assert Counting.asked == 8
    same(table, small(4, both).run())
    other = small(4, both, force_noise=3.0).run(path=tmp_path)
    assert not np.array_equal(other["theta"], table["theta"])
    same(small(4, both).run(path=tmp_path), table)


def test_changed_settings_of_an_estimator_are_another_estimator(tmp_path):
    first = small(3, {"ls": iv.IDIMLS()}).run(path=tmp_path)
    second = small(3, {"ls": iv.IDIMLS(cov_type="classical")}).run(path=tmp_path)
    assert (first["theta"] == second["theta"]).all()
    assert (first["std_error"] != second["std_error"]).all()


def test_the_folder_gives_the_same_table_as_memory_for_any_workers(tmp_path):
    same(small().run(path=tmp_path / "one"), small().run())
    same(small().run(n_jobs=2, path=tmp_path / "two"), small().run())
    same(small().table(tmp_path / "two"), small().run())


def test_overlapping_parts_count_once(tmp_path):
    study = small()
    table = study.run(path=tmp_path)
    store = Store(tmp_path)
    block = next(study._blocks())
    rows = next(iter(store.read([block]))).slice(0, 8)
    store.write(Block(block.case, block.estimators, 0, 2), rows)
    same(study.table(tmp_path), table)


def test_half_written_files_are_not_read_and_are_swept(tmp_path):
    study = small()
    table = study.run(path=tmp_path)
    left = tmp_path / f".{next(tmp_path.glob('part-*.parquet')).name}.0123.part~"
    left.write_bytes(b"PAR1")
    same(study.table(tmp_path), table)
    with replacing(tmp_path / "part-other.parquet") as fresh:
        same(study.run(path=tmp_path), table)
        assert not left.exists() and Path(fresh.name).exists()
        fresh.write(b"")
    (tmp_path / "part-other.parquet").unlink()


def test_a_damaged_part_is_named(tmp_path):
    study = small()
    study.run(path=tmp_path)
    victim = sorted(tmp_path.glob("part-*.parquet"))[0]
    victim.write_bytes(b"PAR1 nothing")
    with pytest.raises(DataError, match=f"{victim.name} is not a part of a study.*delete it"):
        study.run(path=tmp_path)


def test_of_400_flipped_bits_none_is_accepted(tmp_path):
    study = small(2)
    table, rng = study.run(path=tmp_path), np.random.default_rng(14)
    parts = sorted(tmp_path.glob("part-*.parquet"))
    for _ in range(400):
        file = parts[rng.integers(len(parts))]
        whole = file.read_bytes()
        changed = bytearray(whole)
        changed[rng.integers(len(whole))] ^= 1 << rng.integers(8)
        file.write_bytes(changed)
        with pytest.raises(DataError, match="is not a part of a study.*delete it") as caught:
            study.table(tmp_path)
        assert "\n" not in str(caught.value)
        file.write_bytes(whole)
    same(study.table(tmp_path), table)


@pytest.mark.parametrize("about", [b"[]", b"{}", b'{"case": 1, "estimators": 2, "seeds": "x"}'])
def test_a_part_of_the_wrong_types_is_refused(tmp_path, about):
    from io import BytesIO

    import pyarrow.parquet as pq

    study, content = small(1), BytesIO()
    pq.write_table(part([]).replace_schema_metadata({b"ivtools": about}), content)
    data = content.getvalue()
    (tmp_path / f"part-x-{checksum(data)}.parquet").write_bytes(data)
    with pytest.raises(DataError, match="is not a part of a study"):
        study.table(tmp_path)


def test_a_second_run_on_the_same_folder_is_told_who_has_it(tmp_path):
    def second(progress):
        with pytest.raises(DataError, match=f"in use by process {os.getpid()} on .*; wait until"):
            small(2).run(path=tmp_path)

    table = small(2).run(path=tmp_path, progress=second)
    same(small(2).run(path=tmp_path), table)
    assert all(file.name.startswith("part-") for file in tmp_path.iterdir())


def test_a_full_disk_says_what_is_kept(tmp_path, monkeypatch):
    def full(progress):
        if progress.done >= 1:  # whatever was done together on this machine
            monkeypatch.setattr(os, "fsync", refuse)

    def refuse(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(DataError, match="No space left on device; what is finished is kept"):
        small(400).run(path=tmp_path, progress=full)
    monkeypatch.undo()
    left = [file.name for file in tmp_path.iterdir()]
    assert left and all(name.startswith("part-") for name in left)  # nothing half-written
    same(small(400).run(path=tmp_path), small(400).run())


@pytest.mark.parametrize("seeds", [0, -3, 10**12, True, 2.0, "9"])
def test_impossible_numbers_of_repetitions_are_refused(seeds):
    with pytest.raises(IVToolsError, match="a whole number from 1 to 1000000"):
        small(seeds)


def test_a_path_that_is_no_folder(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(IVToolsError, match="cannot write .*; name another place"):
        small().run(path=tmp_path / "file")


def test_interrupted_by_the_user_keeps_what_is_finished(tmp_path):
    def stop(progress):
        if progress.done >= 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        small(6).run(path=tmp_path, progress=stop)
    seeds = small(6).table(tmp_path).drop_duplicates(["case", "seed"])
    assert 4 <= len(seeds) < 12
    same(small(6).run(path=tmp_path), small(6).run())


def killed(script: Path, folder: Path, after: float, jobs: int) -> bool:
    """Run a study in a process of its own and kill it; return whether it had ended before."""
    command = [sys.executable, "-c", RUN, str(script), str(folder), str(jobs)]
    process = subprocess.Popen(command, start_new_session=True)
    try:
        process.wait(timeout=after)
    except subprocess.TimeoutExpired:
        os.kill(process.pid, signal.SIGKILL)  # its workers see the pipe close, and end
        process.wait()
        return False
    assert process.returncode == 0
    return True


def rounds(tmp_path: Path, seeds: int, jobs: int, most: int, longest: float) -> None:
    """Kill at random times, anew whenever the study ends; check the folder after each round."""
    script = tmp_path / "study.py"
    script.write_text(textwrap.dedent(SCRIPT.replace("SEEDS", str(seeds))))
    study, folder = load(script), tmp_path / "rows"
    folder.mkdir()
    whole, done, kills = study.run(), set(), 0
    rng = np.random.default_rng(seeds)
    while kills < most:
        ended = killed(script, folder, rng.uniform(1.0, longest), jobs)
        now = study.table(folder)
        keys = [tuple(k) for k in now[["case", "estimator", "seed", "parameter"]].to_numpy()]
        assert len(set(keys)) == len(keys), "a row appears twice"
        assert done <= set(keys), "finished rows were lost"
        found = whole.merge(now, on=["case", "estimator", "seed", "parameter"])
        assert len(found) == len(now) and (found["theta_x"] == found["theta_y"]).all()
        done, kills = set(keys), kills + (not ended)
        if ended:
            same(now, whole)
            shutil.rmtree(folder)
            folder.mkdir()
            done = set()
    study.run(path=folder)
    same(study.table(folder), whole)


def test_killed_at_random_times(tmp_path):
    rounds(tmp_path, seeds=150, jobs=1, most=3, longest=2.5)


@pytest.mark.slow
def test_killed_at_random_times_many_rounds(tmp_path):
    rounds(tmp_path, seeds=1500, jobs=2, most=100, longest=6.0)


def test_rows_in_memory_stay_flat(tmp_path):
    """100 000 rows are read as categories and numbers: some ten megabytes."""
    rows = [
        ("a", "ls", seed, name, 1.0, 1.0, 0.1, 0.2, 2.0, 2.0, True, 1, 0, 1e-3, "")
        for seed in range(25_000)
        for name in ("inertia", "viscous", "coulomb", "offset")
    ]
    study = small(25_000)
    block = next(study._blocks())
    store = Store(tmp_path)
    for first in range(0, 25_000, 1000):
        piece = part(rows[4 * first : 4 * first + 4000])
        store.write(Block(block.case, block.estimators, first, first + 1000), piece)
    table = study.table(tmp_path)
    assert len(table) == 100_000
    assert table.memory_usage(deep=True).sum() < 20e6
