"""Fleets that are killed at any moment: resumed results are those of a run that was left alone."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ivtools as iv
from ivtools.gap.fleet.shelf import PAGES

RUN = """
import sys
import ivtools as iv
files, out, jobs = sys.argv[3:], sys.argv[1], int(sys.argv[2])
iv.diagnose_fleet(files, iv.axes.emps(), path=out, n_jobs=jobs)
"""


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> list[str]:
    """Six logs of two seconds each."""
    folder, twin, files = tmp_path_factory.mktemp("logs"), iv.datasets.twin(), []
    for k in range(6):
        files.append(str(folder / f"axis {k}.csv"))
        twin.slice(2000 * k, 2000 * k + 2000).to_frame().to_csv(files[-1], index=False)
    return files


def results(folder: Path) -> dict[str, object]:
    """Return the pages, and of the JSON files all that no clock decides."""
    found: dict[str, object] = {f.name: f.read_bytes() for f in (folder / PAGES).glob("*.html")}
    for file in (folder / PAGES).glob("*.json"):
        about = json.loads(file.read_text())
        found[file.name] = {k: v for k, v in about.items() if k not in ("seconds", "checksum")}
    return found


def killed(logs: list[str], folder: Path, after: float, jobs: int) -> bool:
    """Run the fleet in a process of its own and kill it; return whether it had ended before."""
    command = [sys.executable, "-c", RUN, str(folder), str(jobs), *logs]
    process = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
    try:
        process.wait(timeout=after)
    except subprocess.TimeoutExpired:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        return False
    assert process.returncode == 0
    return True


def rounds(logs: list[str], tmp_path: Path, kills: int, longest: float) -> None:
    """Kill so often, at random times; after each, what is finished is whole and right."""
    alone, rng, done = tmp_path / "alone", np.random.default_rng(14), 0
    iv.diagnose_fleet(logs, iv.axes.emps(), path=alone, n_jobs=1)
    whole, folder = results(alone), tmp_path / "killed"
    while done < kills:
        if killed(logs, folder, rng.uniform(2.0, longest), 1 + done % 2):
            assert results(folder) == whole
            assert not [f for f in folder.rglob("*") if f.name.endswith(("~", ".part", ".in-use"))]
            for file in rng.choice(sorted((folder / PAGES).iterdir()), 9, replace=False):
                file.unlink()
        else:
            done += 1
    iv.diagnose_fleet(logs, iv.axes.emps(), path=folder, n_jobs=1)
    assert results(folder) == whole


def test_killed_at_random_times(logs, tmp_path):
    rounds(logs, tmp_path, kills=2, longest=6.0)


@pytest.mark.slow
def test_killed_a_hundred_times(logs, tmp_path):
    rounds(logs, tmp_path, kills=100, longest=9.0)
