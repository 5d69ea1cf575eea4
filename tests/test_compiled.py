"""Compiled code is that of the source: no cache that the digest does not cover."""

import os
import subprocess
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import pytest

from ivtools import compiled as room
from ivtools.compiled import cached, compiled, inlined, source_digest
from ivtools.errors import IVToolsWarning

LAWS = """
from ivtools.compiled import compiled, inlined
SCALE = 3.0

def law(factor):
    @inlined
    def force(v):
        return factor * v * SCALE  # a remark
    return force
"""
KERNEL = """
from ivtools.compiled import cached, compiled
import laws
inner = laws.law(2.0)

@compiled
def net(v):
    return inner(v) + 1.0

@cached("float64(float64)")
def run(v):
    return net(v)
"""
CALL = """
import warnings; warnings.simplefilter("error")
from kernel import run; print(run(1.0), bool(run.dispatcher.stats.cache_hits))
"""


@pytest.fixture
def project(tmp_path):
    (tmp_path / "laws.py").write_text(LAWS)
    (tmp_path / "kernel.py").write_text(KERNEL)
    return tmp_path


def call(project: Path, cache: Path | None = None) -> tuple[float, bool]:
    """Run the kernel in a process of its own; return its value and whether it was on the disk."""
    package = str(Path(room.__file__).parents[1])
    environment = os.environ | {
        "NUMBA_CACHE_DIR": str(cache or project / "cache"),
        "PYTHONPATH": os.pathsep.join([str(project), package]),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    done = subprocess.run(
        [sys.executable, "-c", CALL], env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    value, hit = done.stdout.split()
    return float(value), hit == "True"


def change(file: Path, old: str, new: str) -> None:
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))


def test_the_cache_follows_every_change_of_the_source_and_no_other(project):
    assert call(project) == (7.0, False)
    assert call(project) == (7.0, True)
    change(project / "laws.py", "# a remark", "# another remark\n")
    assert call(project) == (7.0, True)
    change(project / "laws.py", "SCALE = 3.0", "SCALE = 4.0")
    assert call(project) == (9.0, False)
    change(project / "kernel.py", "laws.law(2.0)", "laws.law(6.0)")  # in a closure only
    assert call(project) == (25.0, False)
    change(project / "laws.py", "factor * v", "factor + v")
    assert call(project) == (11.0, False)


@pytest.mark.parametrize("damage", [b"", b"x", None])
def test_a_damaged_file_is_compiled_again(project, damage):
    call(project)
    (file,) = (project / "cache" / "ivtools").iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2] if damage is None else damage)
    assert call(project) == (7.0, False)
    assert call(project) == (7.0, True)


def test_flipped_bits_are_seen(project):
    call(project)
    (file,) = (project / "cache" / "ivtools").iterdir()
    whole = bytearray(file.read_bytes())
    whole[len(whole) // 3] ^= 4
    file.write_bytes(whole)
    assert call(project) == (7.0, False)


def test_without_a_place_for_it_one_warning_says_why_and_what_to_set(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file" / "below"))
    room._check_writable.cache_clear()
    room._warn.cache_clear()

    @cached()
    def square(x):
        return x * x

    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        assert square(3.0) == 9.0 and square(3) == 9
    (told,) = [str(w.message) for w in seen if issubclass(w.category, IVToolsWarning)]
    assert "Not a directory" in told and "set NUMBA_CACHE_DIR" in told and "\n" not in told
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_processes_that_start_cold_at_once_agree(project):
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(call, [project] * 4))
    assert {value for value, _ in found} == {7.0}
    assert len(list((project / "cache" / "ivtools").iterdir())) == 1
    assert call(project) == (7.0, True)


def shifted(by):
    return cached("float64(float64)")(lambda x: x + by)


def test_threads_that_call_a_cold_function_at_once_agree(tmp_path, monkeypatch):
    """Each finds it compiled: the one that comes second neither compiles it nor is refused."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    for k in range(5):
        kernel = shifted(float(k))
        gate = Barrier(4)

        def call(x, kernel=kernel, gate=gate):
            gate.wait()
            return kernel(x)

        with ThreadPoolExecutor(4) as pool:
            assert list(pool.map(call, [1.0] * 4)) == [1.0 + k] * 4


def test_the_kernel_rests_on_every_law():
    from ivtools.loop import kernel
    from ivtools.physics import TERMS

    before = source_digest(kernel.run)
    law = TERMS["viscous"].law
    old = law.__code__
    try:
        law.__code__ = old.replace(co_consts=(*old.co_consts, 3.0))
        assert source_digest(kernel.run) != before
    finally:
        law.__code__ = old
    assert source_digest(kernel.run) == before


def test_inner_functions_run_from_python_too():
    @inlined
    def half(x):
        return 0.5 * x

    @compiled
    def quarter(x):
        return half(half(x))

    assert quarter(8.0) == 2.0
