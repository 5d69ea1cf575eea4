"""Controller parity needs no plant model: what was changed must come back."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import ivtools as iv
from benchmarks.withheld.cases import draw
from benchmarks.withheld.suites import Task
from ivtools.gap import parity
from ivtools.gap.preflight import findings
from ivtools.loop.axis_file import from_tables

THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}


@pytest.fixture(scope="module")
def loop():
    return iv.axes.emps()


def played(loop, added=None, **changes):
    """Return a record of a loop whose controller differs."""
    other = replace(loop, controller=replace(loop.controller, **changes))
    given = iv.datasets.twin()
    if added is not None:
        given = given.replace(added=added)
    sim = other.simulate(given, THETA, initial="rest", quantum=5e-8)
    return given.replace(q=sim.q, nu=sim.nu)


def test_a_right_controller_leaves_nothing(loop):
    found = parity.check(iv.datasets.twin(), loop)
    assert found.after < 1e-9 and not found.mismatch and found.delay == 1


@pytest.mark.parametrize("delay", [0, 2])
def test_a_shifted_log_is_a_delay(loop, delay):
    found = parity.check(played(loop, delay=delay), loop)
    assert found.delay == delay and not found.mismatch


@pytest.mark.parametrize(
    ("name", "value"), [("kp", 0.03), ("kv", -0.02), ("velocity_filter", 0.05)]
)
def test_wrong_settings_come_back(loop, name, value):
    changes = {"kp": 0.0, "kv": 0.0, "velocity_filter": 0.0} | {name: value}
    other = loop.controller.with_mismatch(**changes)
    record = played(loop, settings=other.settings, velocity_filter=other.velocity_filter)
    found = parity.check(record, loop)
    assert set(found.mismatch) == {name}
    assert found.mismatch[name] == pytest.approx(value, abs=1e-3)


def test_an_added_input_of_another_size_comes_back(loop):
    n = iv.datasets.twin().n_samples
    added = 1.0 * ((np.arange(n) // 700) % 2)
    record = played(loop, added=1.03 * added).replace(added=added)
    assert parity.check(record, loop).mismatch == {"added": pytest.approx(0.03, abs=1e-3)}


@pytest.mark.parametrize("size", [2.0, 0.5, -1.0])
def test_an_added_input_of_another_size_or_sign_does_not_hide_the_limit(loop, size):
    """Less what was logged, the law's own command would be beyond its limit, or at it."""
    n = iv.datasets.twin().n_samples
    added = 4.0 * ((np.arange(n) // 700) % 2)
    record = played(loop, added=added)
    true = parity.check(record, loop)
    found = parity.check(record.replace(added=added / size), loop)
    assert found.mismatch == {"added": pytest.approx(size - 1.0, abs=1e-3)}
    assert found.clipped == true.clipped and found.limit == true.limit


def test_a_limit_that_nobody_declared_comes_back(loop):
    found = parity.check(played(loop, limit=3.0), loop)
    assert found.limit == pytest.approx(3.0, rel=1e-3)


@pytest.mark.parametrize("declared", [True, False])
def test_what_comes_near_a_limit_is_not_cut(loop, declared):
    """An integrator that is taken to stand there would be wrong from then on."""
    law = iv.loop.Controller("pid", {"kp": 39000.0, "ki": 2e5, "kd": 60.0}, limit=10.0)
    loop = replace(loop, controller=law)
    given = iv.datasets.twin()
    free = np.abs(loop.simulate(given, THETA, initial="rest").nu[:, 0])
    peaks = free[1:-1][(free[1:-1] > free[:-2]) & (free[1:-1] > free[2:])]
    near = 1.0005 * np.quantile(peaks, 0.9)  # that peak comes near it
    limited = replace(loop, controller=replace(law, limit=near))
    sim = limited.simulate(given, THETA, initial="rest")
    record, size = given.replace(q=sim.q, nu=sim.nu), np.abs(sim.nu)
    assert ((size > 0.999 * near) & (size < near)).sum() >= 3 and (size == near).sum() > 8
    found = parity.check(record, limited if declared else loop)
    assert found.after < 1e-6 and not found.mismatch
    assert found.limit == (None if declared else pytest.approx(near))


@pytest.mark.parametrize("does", ["none", "back-calculation"])
def test_what_an_integrator_does_at_a_limit_is_shown_by_records(loop, does):
    """Whoever has not stated the limit has not stated that, so that "clamp" is declared."""
    given, gains = iv.datasets.twin(), {"kp": 30000.0, "ki": 2e5, "kd": 100.0}
    free = replace(loop, controller=iv.loop.Controller("pid", gains, limit=10.0))
    known = replace(free.controller, limit=4.0, anti_windup=does)
    sim = replace(loop, controller=known).simulate(given, THETA, initial="rest", quantum=5e-8)
    record = given.replace(q=sim.q, nu=sim.nu)
    checked = [parity.check(record, free, read=False)]
    _, other, found = parity.at_limit([record], free, checked)
    assert checked[0].after > 0.1 and other.controller.anti_windup == does
    assert found[0].limit == pytest.approx(4.0) and found[0].after < 1e-6
    assert not found[0].mismatch
    fed = replace(free, controller=replace(free.controller, feedforward={"velocity": 20.0}))
    sim = fed.simulate(given, THETA, initial="rest", quantum=5e-8)
    checked = [parity.check(given.replace(q=sim.q, nu=sim.nu), free, read=False)]
    assert checked[0].after > 0.02  # of another cause
    assert parity.at_limit([given.replace(q=sim.q, nu=sim.nu)], free, checked)[1] is free


@pytest.mark.parametrize(
    ("ki", "does", "delay"), [(0.0, "clamp", 1), (2e5, "none", 2), (2e5, "clamp", 0)]
)
def test_an_added_input_that_goes_through_the_limit_is_told(loop, ki, does, delay):
    """What is sent to a drive is limited there, whatever it is the sum of."""
    given, gains = iv.datasets.twin(), {"kp": 30000.0, "ki": ki, "kd": 100.0}
    free = replace(loop, controller=iv.loop.Controller("pid", gains, limit=10.0, delay=delay))
    pulses = 1.5 * ((np.arange(given.n_samples) // 700) % 2)
    known = replace(free.controller, limit=4.5, anti_windup=does, feedforward={"pulses": 1.0})
    fed = given.replace(extra={"pulses": pulses})
    sim = replace(loop, controller=known).simulate(fed, THETA, initial="rest", quantum=5e-8)
    added = np.concatenate([np.zeros(delay), pulses])[: given.n_samples]
    record = given.replace(q=sim.q, nu=sim.nu, added=added)
    checked = [parity.check(record, free, read=False)]
    assert checked[0].after > 0.02
    (other,), shown, found = parity.at_limit([record], free, checked)
    assert other.added is None and found[0].after < 1e-6
    assert shown.controller.feedforward == {"pulses": 1.0} and shown.controller.anti_windup == does
    assert found[0].limit == pytest.approx(4.5) and not found[0].mismatch


@pytest.mark.parametrize("declared", [True, False])
def test_a_noisy_log_does_not_hide_where_an_integrator_stood(loop, declared):
    """It shows some of the clipped samples below the limit, and others at it."""
    given, rng, worse = iv.datasets.twin(), np.random.default_rng(5), 0
    for _ in range(12):
        kp = 39000.0 * rng.uniform(0.5, 1.2)
        gains = {"kp": kp, "ki": kp * rng.uniform(2.0, 10.0), "kd": kp * rng.uniform(0.0015, 0.008)}
        free = replace(loop, controller=iv.loop.Controller("pid", gains, limit=10.0))
        nu = free.simulate(given, THETA, initial="rest", quantum=5e-8).nu
        limit = float(np.quantile(np.abs(nu), 1.0 - 10.0 ** rng.uniform(-2.5, -1.2)))
        limited = replace(free, controller=replace(free.controller, limit=limit))
        sim = limited.simulate(given, THETA, initial="rest", quantum=5e-8)
        noise = 10.0 ** rng.uniform(-3.0, -2.0)
        logged = sim.nu + noise * np.std(sim.nu) * rng.standard_normal(sim.nu.shape)
        record = given.replace(q=sim.q, nu=logged)
        found = parity.check(record, limited if declared else free, read=False)
        assert found.limit == (None if declared else pytest.approx(limit, rel=1e-3))
        worse += found.after > max(5.0 * noise, 0.01)
    assert worse <= 2


def test_a_limit_that_the_law_hardly_exceeds_explains_the_command():
    """A PID whose integrator is a little wrong is below its limit at the ends of many stretches."""
    case = draw(Task("controllers", 7701, ("saturation",), ("pid",)))
    limit = case.effects["saturation"]["limit"]
    loop = from_tables(case.axis.tables())
    for given in case.records:
        found = parity.check(iv.Record.from_dict(given), loop)
        assert found.limit == pytest.approx(limit, rel=1e-3)
        assert found.read is None  # it explains the command: no other law is looked for


def test_the_emps_log_shows_delay_0(loop, emps):
    found = parity.check(emps, loop)
    assert found.delay == 0 and found.after < 0.0025 and not found.mismatch


def test_the_emps_pulses_are_not_what_was_recorded(loop, emps_pulses):
    found = parity.check(emps_pulses, loop)
    assert found.mismatch == {"added": pytest.approx(0.0146, abs=5e-4)}


@pytest.mark.parametrize("settled", [True, False])
@pytest.mark.parametrize("states", [None, [[1.0, 0.6], [1.0, 1.0]], [[3e-4, 2.0], [-1.0, 7e3]]])
def test_a_law_with_states_of_its_own_may_begin_anywhere(loop, settled, states):
    """Integrator and filtered difference; a record that begins elsewhere, and in motion.

    Whatever combinations of the two are called states, as in a companion form, which hides the
    integrator behind a difference of large ones.
    """
    A, B = np.diag([1.0, 0.6]), np.array([[1.0, -1.0], [0.0, 1.0]])
    C, D = np.array([[0.05 if states is None else 0.005, 100.0]]), [[390.0, -640.0]]
    T = np.eye(2) if states is None else np.array(states)
    own = {"A": T @ A @ np.linalg.inv(T), "B": T @ B, "C": C @ np.linalg.inv(T), "D": D}
    own = {k: np.asarray(v).tolist() for k, v in own.items()}
    loop = replace(loop, controller=replace(loop.controller, kind="state-space", settings=own))
    given = iv.datasets.twin()
    given = given.replace(q=given.q + 0.3, q_ref=given.q_ref + 0.3)
    sim = loop.simulate(given, THETA, initial="rest", quantum=5e-8)
    record = given.replace(q=sim.q, nu=sim.nu)
    found = parity.check(record if settled else record.slice(2500, 14000), loop)
    assert found.after < 1e-6 and not found.mismatch and found.delay == loop.controller.delay


def test_a_law_that_overflows_along_the_record_explains_nothing_of_it(loop):
    own = {"A": [[1.3]], "B": [[1.0, -1.0]], "C": [[0.1]], "D": [[3.0, -3.0]]}
    loop = replace(loop, controller=replace(loop.controller, kind="state-space", settings=own))
    found = parity.check(iv.datasets.twin(), loop)
    assert found.before == pytest.approx(1.0, abs=1e-6) and found.after < 1e-9
    assert found.taken and found.loop.controller.kind == "cascade-pd"
    assert "controller-mismatch" in iv.diagnose(iv.datasets.twin(), loop).effects


def test_the_law_of_a_long_record_is_read_from_a_part_and_judged_on_all_of_it(loop, monkeypatch):
    wrong = replace(loop, controller=iv.loop.Controller("p-velocity", {"kv": 100.0}, limit=10.0))

    def part(self, n=8_000, whole=iv.Record.liveliest):
        return whole(self, n)

    monkeypatch.setattr(iv.Record, "liveliest", part)
    found = parity.check(iv.datasets.twin(), wrong)
    assert found.read is not None and found.read.samples <= 8_000
    assert found.taken and found.after < 1e-9
    assert found.loop.controller.settings == {
        "kp": pytest.approx(160.18, rel=1e-6),
        "kv": pytest.approx(243.45, rel=1e-6),
    }


@pytest.mark.parametrize("row", [700, -1])
def test_a_bad_row_is_said_with_its_time(loop, row):
    """One wrong sample of a reference, of thousands, is no wrong controller."""
    record = played(loop)
    dq_ref = np.gradient(record.q_ref, record.dt, axis=0)
    assert parity.check(record.replace(dq_ref=dq_ref), loop).at is None
    nu = record.nu.copy()
    nu[row] += 1e3 * np.abs(nu).max()
    wrong = record.replace(nu=nu)
    found = parity.check(wrong, loop)
    assert found.at == pytest.approx(record.t[row])
    text = findings.explain_command(found)
    assert f"around {record.t[row]:.6g} s" in text and "cut it out" in text


def commanded(record, loop, delay, noise=0.0):
    """Return a record whose command is that of the loop's controller, late by some samples."""
    fed = parity.Signals(record, loop).fed(replace(loop.controller, limit=np.inf))
    late = np.concatenate([np.full(delay, fed[0]), fed[: len(fed) - delay]])
    late += noise * np.std(late) * np.random.default_rng(0).standard_normal(len(late))
    limit = loop.controller.limit
    return record.replace(nu=np.clip(late, -limit, limit)[:, None])


def test_a_delay_that_most_of_a_record_cannot_tell_is_found_in_the_rest(loop):
    """At constant speed a delay is a constant offset, which an added constant makes up for."""
    t = np.arange(30000) * 1e-4
    speed = sum(
        way * 0.1 * np.clip(np.minimum((t - at) / 0.1, (1.3 - t + at) / 0.1), 0.0, 1.0)
        for at, way in ((0.1, 1.0), (1.6, -1.0))
    )
    asked = np.cumsum(speed) * 1e-4
    q = np.round(lfilter([6e-3], [1.0, -(1.0 - 6e-3)], asked) / 1e-6) * 1e-6
    law = replace(loop, controller=replace(loop.controller, limit=np.inf))
    record = commanded(iv.Record(t, q, q_ref=asked, nu=np.sin(t)), law, 3, noise=3e-4)
    found = parity.check(record, law, read=False, oversampling=1)
    assert found.delay == 3 and not found.mismatch and found.after < 1e-3


@pytest.mark.parametrize("clipped", [2000, 4000])
def test_a_delay_is_found_where_the_liveliest_samples_are_at_a_limit(loop, clipped):
    given = iv.datasets.twin()
    first = int(np.searchsorted(given.t, given.liveliest(4000).t[0]))
    asked = given.q_ref.copy()
    asked[first : first + clipped] += 0.3
    record = commanded(given.replace(q_ref=asked), loop, 3, noise=1e-3)
    found = parity.check(record, loop, read=False, oversampling=1)
    assert found.delay == 3 and not found.mismatch


def test_what_is_constant_where_the_axis_moves_most_is_no_matter(loop):
    """The reference of a step is, and so is an added input before and after its pulse."""
    t = np.arange(30000) * 1e-4
    since = np.clip(t - 0.2, 0.0, None) / 0.3
    q = 0.1 * (1.0 - (1.0 + since) * np.exp(-since))
    law = replace(loop, controller=replace(loop.controller, limit=np.inf))
    step = iv.Record(t, q, q_ref=np.where(t >= 0.2, 0.1, 0.0), nu=np.sin(t))
    assert parity.check(commanded(step, law, 3), law, read=False, oversampling=1).delay == 3
    given = iv.datasets.twin()
    last = int(np.searchsorted(given.t, given.liveliest(4000).t[-1]))
    added = np.zeros((given.n_samples, 1))
    added[last + 1000 : last + 2000] = 0.2
    noise = 1e-4 * np.random.default_rng(0).standard_normal(given.nu.shape)
    pushed = given.replace(added=added, nu=given.nu + 2.0 * added + noise)
    found = parity.check(pushed, loop, read=False)
    assert found.mismatch == {"added": pytest.approx(1.0, rel=0.01)}
