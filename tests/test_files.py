"""Files that are whole or not there, whoever writes, dies or reads beside."""

import errno
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from ivtools import files
from ivtools.errors import DataError
from ivtools.files import claimed, replacing, sweep, write

WRITER = """
import sys
from pathlib import Path
from ivtools.files import write
me = sys.argv[2].encode()
for _ in range(100):
    write(Path(sys.argv[1]), me * 50_000)
"""


def test_a_file_is_replaced_whole_and_nothing_is_left_beside_it(tmp_path):
    file = tmp_path / "new" / "x.json"
    assert write(file, "one").read_text() == "one"
    write(file, b"two")
    assert [(f.name, f.read_bytes()) for f in file.parent.iterdir()] == [("x.json", b"two")]


def test_what_was_there_stays_when_writing_fails(tmp_path, monkeypatch):
    file = write(tmp_path / "x", "before")

    def refuse(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", refuse)
    with pytest.raises(DataError, match="cannot write .*x: No space left .*what is finished"):
        write(file, "after")
    with pytest.raises(KeyboardInterrupt), replacing(file) as part:
        part.write(b"af")
        raise KeyboardInterrupt
    assert [(f.name, f.read_text()) for f in tmp_path.iterdir()] == [("x", "before")]


def test_a_place_that_cannot_be_written_is_a_fault_of_the_input(tmp_path):
    write(tmp_path / "file", "")
    with pytest.raises(DataError, match="cannot write .*: File exists; name another place"):
        write(tmp_path / "file" / "below", "")


def test_many_writers_of_one_file_lose_nothing_and_tear_nothing(tmp_path):
    file = tmp_path / "shared"
    write(file, "a" * 50_000)
    writers = [subprocess.Popen([sys.executable, "-c", WRITER, str(file), name]) for name in "ab"]
    while any(writer.poll() is None for writer in writers):
        content = file.read_bytes()
        assert len(content) == 50_000 and len(set(content)) == 1
    assert [writer.returncode for writer in writers] == [0, 0]
    assert [f.name for f in tmp_path.iterdir()] == ["shared"]


def test_what_a_killed_writer_left_goes_with_the_next_file_of_that_name(tmp_path):
    code = (
        "import sys, time; from pathlib import Path; from ivtools.files import replacing\n"
        "with replacing(Path(sys.argv[1])) as f: print(flush=True); time.sleep(60)"
    )
    file = tmp_path / "x"
    killed = subprocess.Popen(
        [sys.executable, "-c", code, str(file)], stdout=subprocess.PIPE, text=True
    )
    assert killed.stdout is not None and killed.stdout.readline()
    sweep(tmp_path)
    assert len(list(tmp_path.iterdir())) == 1  # it lives
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    write(tmp_path / "y", "")
    assert len(list(tmp_path.iterdir())) == 2
    write(file, "")
    assert sorted(f.name for f in tmp_path.iterdir()) == ["x", "y"]


def test_a_folder_is_one_process_s_at_a_time(tmp_path):
    def take(_) -> bool:
        try:
            with claimed(tmp_path):
                time.sleep(0.01)
                return True
        except DataError as error:
            assert "in use by process" in str(error) or "another process" in str(error)
            return False

    with ThreadPoolExecutor(4) as pool:
        assert sum(pool.map(take, range(40))) >= 1
    with claimed(tmp_path):
        assert not take(0)
    assert take(0) and not list(tmp_path.iterdir())


def test_a_killed_owner_leaves_the_folder_free(tmp_path):
    code = (
        "import os, signal, sys; from pathlib import Path; from ivtools.files import claimed\n"
        "with claimed(Path(sys.argv[1])): os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)])
    assert (tmp_path / files.LOCK).exists()
    with claimed(Path(tmp_path)):
        pass
    assert not list(tmp_path.iterdir())
