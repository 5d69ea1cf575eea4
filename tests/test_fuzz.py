"""A minute of the fuzzer: seeds that are recorded, in processes that limits bind."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent / "fuzz"))
from fuzz import KINDS, Bound, tried  # noqa: E402
from verbs import faults, nulls  # noqa: E402

#: Seeds of inputs that once ended badly: by kind.
RECORDED = {
    "axes": (22840, 25398),
    "robots": (10152, 10305, 10841, 12484, 15620, 15886, 16487),
    "studies": (6, 49, 69, 104, 230, 271, 382, 12436, 100238),
}
FAST = {
    "axes": 25, "readers": 40, "records": 4, "studies": 15, "thetas": 25,
    "models": 40, "robots": 30, "uploads": 15,
}  # fmt: skip


@pytest.fixture(scope="module")
def bound():
    bound = Bound()
    yield bound
    bound.close()


@pytest.fixture(params=sorted(KINDS))
def kind(request):
    if request.param == "uploads":
        pytest.importorskip("starlette", reason='the app needs pip install "ivtools[app]"')
        pytest.importorskip("httpx2", reason="starlette's test client needs httpx2")
    return request.param


def test_every_input_ends_soon_and_in_one_line(kind, bound):
    for seed in (*RECORDED.get(kind, ()), *range(1000, 1000 + FAST[kind])):
        assert not tried(kind, seed, bound), f"{kind}, seed {seed}"


@pytest.mark.slow
def test_many_inputs_end_soon_and_in_one_line(kind, bound):
    for seed in range(40 * FAST[kind]):
        assert not tried(kind, seed, bound), f"{kind}, seed {seed}"


@pytest.mark.parametrize(
    ("found", "fault"),
    [
        ({"status": 1, "stderr": "ivtools: internal error: x", "cpu": 1.0}, "status 1"),
        ({"status": 2, "stderr": "ivtools: error: x\nivtools: y", "cpu": 1.0}, "2 lines"),
        ({"status": 0, "stderr": "Traceback", "cpu": 1.0}, "strange line"),
        ({"status": 0, "stderr": "", "cpu": 21.0}, "21.0 s"),
        ({"status": 0, "stderr": "", "cpu": 1.0, "json": {"a": {"b": None}}}, "null .*: .a.b"),
        ({"died": "exit -11"}, "died: exit -11"),
    ],
)
def test_what_is_a_fault(found, fault):
    (told,) = faults("simulate", found)
    assert re.search(fault, told)


def test_a_null_with_its_reason_is_an_answer():
    assert nulls({"x": {"sd": None, "converged": False}, "y": {"a": None, "note": "b"}}) == []


def test_the_same_seed_gives_the_same_input(tmp_path):
    for kind in KINDS.values():
        made = []
        for folder in (tmp_path / "one", tmp_path / "two"):
            folder.mkdir(exist_ok=True)
            list(kind(np.random.default_rng(7), folder))
            here = str(folder).encode()  # which a plan of uploads names
            made.append({f.name: f.read_bytes().replace(here, b"") for f in folder.iterdir()})
        assert made[0] == made[1] and made[0]
