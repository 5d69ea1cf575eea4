"""Workers that die, and numbers of them that cannot be."""

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from ivtools.errors import IVToolsError, WorkersLostError
from ivtools.workers import outcomes, threaded


def deadly(number, folder):
    """Die of 3, always, and of 5 the first time."""
    time.sleep(0.01)
    died = folder / f"died-{number}"
    if number == 3 or (number == 5 and not died.exists()):
        died.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def test_the_work_of_a_killed_worker_is_done_by_another(tmp_path):
    tasks = [(number, tmp_path) for number in range(20) if number != 3]
    assert sorted(outcomes(deadly, tasks, 2)) == [number for number, _ in tasks]
    assert (tmp_path / "died-5").exists()


def test_work_that_kills_its_worker_is_named_and_nothing_else_suffers(tmp_path):
    tasks = [(number, tmp_path) for number in range(10)]
    lost = []
    done = list(outcomes(deadly, tasks, 2, lost=lambda n, _, reason: lost.append((n, reason)) or n))
    assert sorted(done) == list(range(10))
    assert [(n, "its worker died" in reason) for n, reason in lost] == [(3, True)]


def test_without_a_word_for_it_lost_work_is_an_error(tmp_path):
    with pytest.raises(WorkersLostError, match="cannot be done: its worker died"):
        list(outcomes(deadly, [(3, tmp_path), (4, tmp_path)], 2))


@pytest.mark.parametrize("n_jobs", [0, -2, 10**6, 1.5, "2"])
def test_impossible_numbers_of_workers_are_refused(n_jobs):
    with pytest.raises(IVToolsError, match="workers; give a whole number from 1 to 1000, or -1"):
        list(outcomes(pow, [(2, 3)], n_jobs))


STUDY = """
import time
from contextlib import suppress
from pathlib import Path
import ivtools as iv
from ivtools.study import Case, Study, Trapezoids

class Slow:
    def fit(self, problem):
        time.sleep(0.2)
        return dict.fromkeys(problem.names, 1.0)

theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
moves = Trapezoids(1.0, strokes=(0.03,), speeds=(0.12,))
study = Study([Case("a", iv.axes.emps(), theta, moves)], {"slow": Slow()}, seeds=5000)
"""


def descendants(pid: int) -> set[int]:
    """Return the processes below one, from the kernel's list."""
    found = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            found[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
    below = {pid}
    while more := {child for child, parent in found.items() if parent in below} - below:
        below |= more
    return below - {pid}


def alive(pid: int) -> bool:
    """Whether a process runs; one that has ended may wait for its parent to look."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs the list of processes")
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_the_command_and_what_is_finished_is_kept(tmp_path, how):
    (tmp_path / "study.py").write_text(STUDY)
    code = "from ivtools.cli import main; main()"
    rows = tmp_path / "out" / "rows"
    command = ["benchmark", str(tmp_path / "study.py"), "--jobs", "2", "--out", str(rows.parent)]
    process = subprocess.Popen([sys.executable, "-c", code, *command], stderr=subprocess.PIPE)
    while not list(rows.glob("part-*")):
        assert process.poll() is None
        time.sleep(0.1)
    workers = descendants(process.pid)
    process.send_signal(how)
    if how == signal.SIGTERM:
        told = process.communicate(timeout=60)[1].decode()
        assert (process.returncode, told.count("\n")) == (130, 1) and len(workers) >= 2
    until = time.monotonic() + 20.0  # the machine may be busy
    while left := [pid for pid in workers if alive(pid)]:
        assert time.monotonic() < until, left
        time.sleep(0.1)
    assert {f.name[:5] for f in rows.iterdir()} <= {"part-", ".part", ".in-u"}


def test_two_threads_do_the_parts_of_parts():
    """Results keep their order; the thread that has nothing left to do helps with small parts."""
    seen = set()

    def part(k):
        time.sleep(0.01)
        seen.add(threading.get_ident())
        return k

    def whole(parts):
        return threaded(part, range(parts))

    assert threaded(whole, [1, 30]) == [[0], list(range(30))]
    assert len(seen) >= 2  # however the parts fell to them
    before = len(seen)
    seen.clear()
    assert whole(30) == list(range(30))
    assert len(seen) == 2
    assert before <= 3


@pytest.mark.parametrize("faulty", [{0}, {1}, {0, 1}, {7}])
def test_what_fails_on_a_thread_fails_and_leaves_both_free(faulty):
    def part(k):
        time.sleep(0.002)
        if k in faulty:
            raise ValueError(k)
        return k

    for _ in range(3):
        with pytest.raises(ValueError, match="^[017]$"):
            threaded(part, range(8))
    assert threaded(part, range(20, 28)) == list(range(20, 28))


@pytest.mark.parametrize("waits", [False, True])
def test_what_helps_ends_early_where_it_is_not_wanted_any_more(waits):
    """Whoever is interrupted waits for it, at work or with nothing left to do."""
    begun, steps = threading.Event(), []

    def step(k):
        steps.append(k)
        begun.set()
        if waits and k == 20:
            os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1e-3)

    def work(k):
        if k == 1:
            threaded(step, range(20_000))
        assert begun.wait(60.0)
        if not waits:
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            threaded(work, range(2))
    finally:
        signal.signal(signal.SIGINT, before)
    assert 0 < len(steps) < 20_000
    assert threaded(pow, [2, 3], [5, 2]) == [32, 9]  # and the next one is wanted
