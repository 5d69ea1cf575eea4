"""How fast it is: `pytest benchmarks/speed` (pytest-benchmark); `report.py` writes the table.

Each figure has a limit that it must keep, in processor time of one thread, the best of many: that
is the elapsed time on a machine that does nothing else, and all that can be known on a busy one.
Elapsed times are reported beside it.
"""

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import control
import numpy as np
import pytest

from ivtools import IDIMLS, Problem, Robot, axes, datasets
from ivtools.loop import ClosedLoop
from ivtools.loop.system import initial_state

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from robots import plan, reference, six_loop

THETA = {"inertia": 95.1, "viscous": 203.5, "coulomb": 20.4, "offset": -3.16}
ASYMMETRIC = {
    "inertia": 95.15,
    "viscous_pos": 166.7,
    "coulomb_pos": 20.1,
    "viscous_neg": 240.4,
    "coulomb_neg": 20.6,
}
CONTROL_SAMPLES = 1000  # python-control is timed on a part; its cost is linear in the samples


@pytest.fixture(scope="module")
def record():
    return datasets.twin()  # 24841 samples, as the measured record has


@pytest.fixture(scope="module")
def loop() -> ClosedLoop:
    return axes.emps()


def limit(benchmark, ms: float, call, repeats: int = 40, who: int = resource.RUSAGE_SELF) -> None:
    """Hold the processor time of a call to a limit; `who` may be the processes it starts."""
    spent = []
    for _ in range(repeats):
        before = processor_seconds(who)
        call()
        spent.append(1e3 * (processor_seconds(who) - before))
    benchmark.extra_info |= {"limit_ms": ms, "processor_ms": min(spent)}
    assert min(spent) <= ms


def processor_seconds(who: int) -> float:
    if who == resource.RUSAGE_SELF:
        return time.process_time()
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


def test_simulation_rigid(benchmark, record, loop):
    loop.simulate(record, THETA)
    benchmark(loop.simulate, record, THETA)
    limit(benchmark, 1.0, lambda: loop.simulate(record, THETA))


def test_simulation_asymmetric(benchmark, record, loop):
    loop = loop.with_terms("inertia", "asymmetric-friction")
    loop.simulate(record, ASYMMETRIC)
    benchmark(loop.simulate, record, ASYMMETRIC)
    limit(benchmark, 1.0, lambda: loop.simulate(record, ASYMMETRIC))


EFFECTS = {
    "position-friction": ({"slope": 5.0}, 4.0),
    "stribeck": ({"force": 5.0, "speed": 0.01}, 6.0),
    "flexibility": ({"frequency_hz": 45.0}, 20.0),
}


@pytest.mark.parametrize("effect", EFFECTS)
def test_simulation_with_an_effect(benchmark, record, loop, effect):
    values, ms = EFFECTS[effect]
    loop = loop.with_effect(effect, **values)
    loop.simulate(record, THETA)
    benchmark(loop.simulate, record, THETA)
    limit(benchmark, ms, lambda: loop.simulate(record, THETA))


def test_ratio_to_python_control(benchmark, record, loop):
    """The same loop by python-control in the same process, per sample."""
    n = CONTROL_SAMPLES
    q_ref = record.q_ref[:n, 0]
    inputs = np.array([q_ref, np.gradient(q_ref, record.dt), np.zeros(n)])
    system = loop.system(THETA, dt=record.dt)
    state = initial_state(loop, loop.values(THETA), record.dt, 0.0, 0.0)
    times = np.arange(n) * record.dt
    theirs = []
    for _ in range(3):
        start = time.perf_counter()
        control.input_output_response(system, times, inputs, state)
        theirs.append((time.perf_counter() - start) / n)
    loop.simulate(record, THETA)
    benchmark(loop.simulate, record, THETA)
    if not benchmark.disabled:
        ratio = min(theirs) / (benchmark.stats.stats.min / record.n_samples)
        benchmark.extra_info |= {"ratio": ratio, "limit_ratio": 800}
        assert ratio >= 800


def test_least_squares_fit(benchmark, record, loop):
    """From the record to the estimate: derivatives, filters, regression, HAC covariance."""

    def fit():
        return IDIMLS().fit(Problem(record, loop))

    fit()
    benchmark(fit)
    limit(benchmark, 6.0, fit, 100)


def test_simulation_of_six_joints(benchmark):
    loop, record = six_loop(), plan(*reference(30.0))
    loop.simulate(record, initial="rest")
    benchmark(loop.simulate, record, initial="rest")
    limit(benchmark, 120.0, lambda: loop.simulate(record, initial="rest"))


def test_regressor_of_six_joints(benchmark):
    """The rows of 5000 states; 2 million a second."""
    robot = Robot.six_axis()
    states = np.random.default_rng(0).uniform(-1, 1, (3, 5000, 6))
    robot.regressor(*states)
    benchmark(robot.regressor, *states)
    limit(benchmark, 1e3 * 5000 * 6 / 2e6, lambda: robot.regressor(*states))


def run(*command: str) -> None:
    threads = {"OPENBLAS_NUM_THREADS": "1"}
    subprocess.run(command, check=True, capture_output=True, env={**os.environ, **threads})


def test_import(benchmark):
    command = (sys.executable, "-c", "import ivtools")
    benchmark.pedantic(run, command, rounds=3, warmup_rounds=1)
    limit(benchmark, 700.0, lambda: run(*command), 3, resource.RUSAGE_CHILDREN)


def test_identify_from_a_cold_shell(benchmark):
    command = (sys.executable, "-m", "ivtools.cli", "identify", "twin", "--method", "idim-ls")
    script = Path(sys.executable).with_name("ivtools")
    if script.exists():
        command = (str(script), *command[3:])
    benchmark.pedantic(run, command, rounds=2, warmup_rounds=1)
    limit(benchmark, 3000.0, lambda: run(*command), 2, resource.RUSAGE_CHILDREN)


@pytest.mark.parametrize("n", [10**4, 10**5, 10**6, 10**7])
def test_cost_and_memory_are_linear(benchmark, n):
    """Simulation and least-squares rows of n samples, in a process of their own."""
    script = Path(__file__).with_name("scaling.py")
    done = subprocess.run(
        [sys.executable, str(script), str(n)], check=True, capture_output=True, text=True
    )
    benchmark.extra_info |= (figures := json.loads(done.stdout))
    benchmark.pedantic(lambda: None)
    if n >= 10**6:  # below, the libraries weigh more than the data
        assert figures["simulate_bytes"] <= 40.0
        assert figures["rows_bytes"] <= 40.0
