"""Studies on a Dask cluster of real worker processes, one of which dies."""

import os
import signal
import time

import pandas as pd
import pytest

import ivtools as iv
from ivtools.errors import IVToolsError
from ivtools.study import COLUMNS, MEASURED, Case, Study, Trapezoids

distributed = pytest.importorskip("distributed")


class Slow:
    """Takes long enough for a worker to die in the middle of it."""

    def fit(self, problem):
        time.sleep(0.03)
        return dict(zip(problem.names, problem.X[0].tolist(), strict=True))


MOVES = Trapezoids(1.0, strokes=(0.03,), speeds=(0.12,))


def small(seeds: int) -> Study:
    theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
    loop = iv.axes.emps()
    cases = [
        Case(f"{f:g} N", loop, theta, MOVES, force_noise=f, encoder_noise=1e-7) for f in (1.0, 5.0)
    ]
    return Study(cases, {"slow": Slow(), "ls": iv.IDIMLS()}, seeds)


def same(a: pd.DataFrame, b: pd.DataFrame) -> None:
    columns = [name for name in COLUMNS if name not in MEASURED]
    pd.testing.assert_frame_equal(a[columns], b[columns], check_exact=True)


@pytest.fixture(scope="module")
def cluster():
    """Two worker processes of one thread each."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        yield cluster


def test_a_cluster_gives_the_same_table_though_a_worker_dies(cluster, tmp_path):
    study, killed = small(60), []

    def kill_one(progress):
        if progress.done >= 10 and not killed:
            victim = next(iter(cluster.workers.values()))
            killed.append(victim.pid)
            os.kill(victim.pid, signal.SIGKILL)

    table = study.run(
        backend="dask", scheduler=cluster.scheduler_address, path=tmp_path, progress=kill_one
    )
    assert killed, "no worker was killed"
    same(table, study.run())
    same(study.table(tmp_path), table)


def test_the_current_client_is_used_if_no_address_is_given(cluster):
    with distributed.Client(cluster):
        same(small(4).run(backend="dask"), small(4).run())


def test_no_scheduler_is_an_error_of_one_line(monkeypatch):
    monkeypatch.setattr("ivtools.workers.TIMEOUT_S", 1.0)
    with pytest.raises(IVToolsError, match="no Dask scheduler answers at tcp://127.0.0.1:9"):
        small(1).run(backend="dask", scheduler="tcp://127.0.0.1:9")
