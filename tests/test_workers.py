"""Workers that die, and numbers of them that cannot be."""

import os
import signal
import time

import pytest

from ivtools.errors import IVToolsError, WorkersLostError
from ivtools.workers import outcomes


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
