"""The same records give the same answer: on any number of threads and workers, under load."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

import numpy as np
import pytest

import ivtools as iv

THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
EFFECTS = (
    {},
    {"asymmetric-viscous": {"delta": -35.0}},
    {"stribeck": {"force": 6.0, "speed": 0.01}},
    {"presliding": {"stiffness": 4e5}},
    {"spring": {"stiffness": 30.0, "curvature": 40.0}},
    {"cogging": {"cosine": 2.0, "sine": 1.0, "period": 0.004}},
    {"flexibility": {"frequency_hz": 45.0, "damping": 0.03, "load_share": 0.2}},
    {"drive-timing": {"delay": 0.0012}},
    {"dead-zone": {"force": 2.0}},
    {"stribeck": {"force": 6.0, "speed": 0.01}, "drive-timing": {"lag": 0.001}},
)
SAMPLES = 5000
FEW = (1, 3, 6, 9)  # some that search and some that do not


def records():
    """Return ten short records, of an effect each; without a hold-out both parts share a record."""
    given, made = iv.datasets.twin().slice(0, SAMPLES), []
    for k, effects in enumerate(EFFECTS):
        loop = iv.axes.emps()
        for name, values in effects.items():
            loop = loop.with_effect(name, **values)
        noise = np.random.default_rng(k).normal(0.0, 2.0, SAMPLES)
        sim = loop.simulate(given, THETA, initial="rest", force_noise=noise)
        made.append(given.replace(q=sim.q, nu=sim.nu, name=f"axis-{k}"))
    return made


def answer(record):
    """Return JSON and page of a diagnosis."""
    found = iv.diagnose(record, iv.axes.emps())
    return [json.dumps(found.to_dict()), found.page().html()]


@contextmanager
def load():
    """Keep the interpreter and BLAS busy."""
    stop, a = Event(), np.random.default_rng(0).normal(size=(300, 300))

    def work():
        while not stop.is_set():
            a @ a

    threads = [Thread(target=work) for _ in range(3)]
    for t in threads:
        t.start()
    try:
        yield
    finally:
        stop.set()
        for t in threads:
            t.join()


@pytest.fixture(scope="module")
def made():
    return records()


@pytest.fixture(scope="module")
def first(made):
    return [answer(r) for r in made]


@pytest.mark.slow
def test_the_answer_is_the_same_under_load(made, first):
    with load():
        for record, expected in zip(made, first, strict=True):
            assert json.dumps(iv.diagnose(record, iv.axes.emps()).to_dict()) == expected[0]


def test_diagnoses_side_by_side_do_not_disturb_each_other(made):
    """Three at a time, against one after the other."""
    some = [made[k] for k in FEW]
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(lambda r: iv.diagnose(r, iv.axes.emps()).to_dict(), some))
    assert found == [iv.diagnose(r, iv.axes.emps()).to_dict() for r in some]


@pytest.mark.slow
@pytest.mark.parametrize("threads", ["1", "2"])
def test_the_answer_is_the_same_on_any_number_of_threads(first, threads):
    """Another process with so many threads for BLAS and numba."""
    names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
    code = "import json, sys; import test_gap_determinism as t; "
    code += "sys.stdout.write(json.dumps([t.answer(r) for r in t.records()]))"
    env = {
        **os.environ,
        **dict.fromkeys(names, threads),
        "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path]),
    }
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=env
    )
    assert json.loads(done.stdout) == first


def _fleet(made, folder, **settings):
    """Return entries and pages of a fleet by name, without what it took."""
    fleet = iv.diagnose_fleet(made, iv.axes.emps(), path=folder, **settings)
    return {e.name: (e.to_dict(), e.page.read_text()) for e in fleet}


@pytest.fixture(scope="module")
def alone(made, tmp_path_factory):
    return _fleet(made, tmp_path_factory.mktemp("one"), n_jobs=1)


@pytest.mark.slow
def test_a_fleet_on_one_worker_says_what_a_diagnosis_says(made, alone, first):
    for (content, _), (told, _) in zip(alone.values(), first, strict=True):
        content = json.loads(json.dumps(content))
        assert {**content, **json.loads(told)} == content


def test_some_on_two_workers_say_the_same(made, tmp_path):
    some = [made[k] for k in FEW]
    assert _fleet(some, tmp_path / "two", n_jobs=2) == _fleet(some, tmp_path / "one", n_jobs=1)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["loky", "threading"])
def test_a_fleet_on_two_workers_says_the_same(made, alone, backend, tmp_path):
    assert _fleet(made, tmp_path, n_jobs=2, backend=backend) == alone


@pytest.mark.slow
def test_a_fleet_on_three_workers_says_the_same(made, alone, tmp_path):
    assert _fleet(made, tmp_path, n_jobs=3) == alone


@pytest.mark.slow
def test_a_fleet_on_dask_says_the_same(made, alone, tmp_path):
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as c:
        found = _fleet(made, tmp_path, backend="dask", scheduler=c.scheduler_address)
    assert found == alone


@pytest.mark.slow
def test_eight_times_each_under_load(made, first):
    with load():
        for _ in range(8):
            assert [answer(r) for r in made] == first
