"""A record with missing samples: its stretches are one record, and nothing crosses a break."""

from dataclasses import replace

import numpy as np
import pytest
from robots import plan, reference, two_axes, two_joints

import ivtools as iv
from ivtools.errors import EstimationError, RecordError
from ivtools.loop import Controller
from ivtools.pipeline import Pipeline
from ivtools.record_format import RecordFormat

LOST = ((5000, 5040), (12000, 12003), (12100, 13000))  # the third leaves a stretch that is short


def broken(record: iv.Record, gaps: str = "all") -> iv.Record:
    """The record without some samples, read as its file would be."""
    table = record.to_frame()
    keep = np.ones(len(table), dtype=bool)
    for first, stop in LOST:
        keep[first:stop] = False
    lost = table[keep].reset_index(drop=True)
    return iv.Record.from_frame(lost, RecordFormat(gaps=gaps), name="broken")


@pytest.fixture(scope="module")
def twin():
    return iv.datasets.twin()


def test_every_stretch_that_is_long_enough_is_kept(twin):
    record = broken(twin)
    assert record.breaks == (5000, 5000 + 12000 - 5040)
    assert [p.n_samples for p in record.parts] == [5000, 6960, twin.n_samples - 13000]
    assert record.dt == twin.dt and record.longest is record.parts[2]
    assert any("3 stretches are used" in note for note in record.notes)
    again = record.slice(4000, 8000)
    assert again.breaks == (1000,) and record.slice(5000, 9000).breaks == ()
    assert broken(twin, "longest").breaks == ()


def test_a_break_is_refused_where_it_leaves_too_little(twin):
    with pytest.raises(RecordError, match="breaks = .* leave a stretch of 50 samples"):
        twin.replace(breaks=(50,))


@pytest.mark.parametrize(
    "pipeline",
    [
        Pipeline(100.0, 10, trim=(49, 49), force_shift=0.7, min_speed=0.02, guard=8, blank=True),
        Pipeline(60.0, 7, trim=(80, 0), force_shift=1.0),
        Pipeline(None, 1),
    ],
)
def test_rows_are_those_of_the_stretches(twin, pipeline):
    record, loop = broken(twin), iv.axes.emps()
    whole = iv.Problem(record, loop, pipeline)
    parts = [iv.Problem(p, loop, pipeline) for p in record.parts]
    assert np.array_equal(whole.X, np.vstack([p.X for p in parts]))
    assert np.array_equal(whole.y, np.concatenate([p.y for p in parts]))
    assert np.array_equal(whole.t, np.concatenate([p.t for p in parts]))


def test_a_simulation_begins_anew_behind_a_break(twin):
    record = broken(twin)
    loop = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    noise = np.random.default_rng(0).normal(size=record.n_samples)
    whole = loop.simulate(record, twin.theta_true, force_noise=noise)
    for rows, part in zip(record.stretches, record.parts, strict=True):
        own = loop.simulate(part, twin.theta_true, force_noise=noise[rows])
        assert np.array_equal(whole.q[rows], own.q) and np.array_equal(whole.nu[rows], own.nu)
    assert whole.relative_error(record)["force"] < 12.0
    wild = {**twin.theta_true, "inertia": 0.5}
    free = replace(loop, controller=replace(loop.controller, limit=np.inf))
    assert not free.simulate(record, wild).finite


@pytest.mark.parametrize("method", [iv.IDIMLS(), iv.IDIMIV(), iv.DIDIM(), iv.IDIMBCIV()])
def test_estimates_are_those_of_the_whole(twin, method):
    loop = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    full = method.fit(twin, loop)
    lost = method.fit(broken(twin), loop)
    z = (lost.params - full.params) / full.std_errors
    assert lost.converged and np.abs(z).max() < 3.0


def test_a_diagnosis_says_that_it_takes_the_longest(twin):
    found = iv.diagnose(broken(twin), iv.axes.emps())
    assert found.effects == ("asymmetric-viscous",)
    assert any("3 stretches: the longest" in f.text for f in found.findings)


def test_what_no_law_can_be_read_from_is_said_of_the_longest_as_well(twin):
    loop = replace(iv.axes.emps(), controller=Controller("identify", {}))
    found = iv.diagnose(broken(twin).replace(q_ref=None), loop)
    said = " ".join(f.text for f in found.findings)
    assert "no reference is in the record" in said and "3 stretches: the longest" in said


def test_of_a_long_record_a_stated_part_is_diagnosed(twin):
    found = iv.diagnose(twin, iv.axes.emps(), rules=iv.gap.Rules(samples=4000))
    assert any("the 4000 in which it moves most" in f.text for f in found.findings)


def test_the_law_is_found_in_the_longest(twin):
    loop = replace(iv.axes.emps(), controller=Controller("identify", {}))
    assert loop.known(broken(twin)).controller.kind == "cascade-pd"


def test_a_transfer_function_asks_for_one_stretch(twin):
    with pytest.raises(EstimationError, match='gaps = "longest"'):
        iv.SRIVC().fit(iv.Problem(broken(twin), iv.axes.emps()))


def test_robots_have_breaks_as_well():
    loop = iv.RobotLoop(two_joints(), two_axes())
    t, q_ref = reference(6.0, n=2)
    made = loop.simulate(plan(t, q_ref), initial="rest")
    record = iv.Record(t, q=made.q, q_ref=q_ref, nu=made.nu)
    lost = broken_robot(record)
    assert lost.breaks == (2500,) and lost.n_joints == 2
    again = loop.simulate(lost)
    for rows, part in zip(lost.stretches, lost.parts, strict=True):
        assert np.array_equal(again.q[rows], loop.simulate(part).q)
    full, part = (iv.IDIMLS().fit(r, loop).params for r in (record, lost))
    assert part.to_numpy() == pytest.approx(full.to_numpy(), rel=0.1, abs=0.02)


def broken_robot(record: iv.Record) -> iv.Record:
    table = record.to_frame()
    lost = table.drop(index=range(2500, 2600)).reset_index(drop=True)
    return iv.Record.from_frame(lost, RecordFormat(gaps="all"))
