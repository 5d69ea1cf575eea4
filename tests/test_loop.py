"""The compiled loop against python-control, against finer steps, and against mechanics."""

from dataclasses import replace

import control
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks import populations
from ivtools import Record, axes
from ivtools.errors import AxisError, RecordError, ShapeError
from ivtools.loop import ClosedLoop, Controller, integrator, steps
from ivtools.loop.controllers.filters import LoopFilter
from ivtools.loop.engine import plant
from ivtools.loop.system import initial_state
from ivtools.physics import EFFECTS, Parameter, Term

DT = 1e-3
THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
# one typical size of every effect, of the order that an EMPS-like axis shows
SIZES: dict[str, dict[str, float]] = {
    "asymmetric-viscous": {"delta": -30.0},
    "stribeck": {"force": 6.0, "speed": 0.01},
    "presliding": {"stiffness": 5e5},
    "polynomial-viscous": {"quadratic": 500.0, "cubic": 4000.0},
    "sqrt-viscous": {"force": 30.0},
    "position-friction": {"slope": 10.0, "curvature": 20.0},
    "regularised-coulomb": {"force": 5.0, "speed": 0.02},
    "load-friction": {"ratio": 0.05},
    "friction-drift": {"coulomb_rate": 0.5, "viscous_rate": 3.0},
    "offset-drift": {"rate": 0.5, "curvature": 0.1},
    "spring": {"stiffness": 20.0, "curvature": 10.0},
    "gravity": {"sin": 8.0, "cos": -3.0},
    "cogging": {"cosine": 2.0, "sine": 1.0, "period": 0.006},
    "torque-ripple": {"cosine": 0.05, "sine": 0.02, "period": 0.006},
    "flexibility": {"frequency_hz": 45.0, "damping": 0.03, "load_share": 0.2},
    "backlash": {"gap": 4e-5},
    "inner-saturation": {"force": 100.0},
    "drive-timing": {"delay": 4e-4, "lag": 6e-4},
    "saturation": {"limit": 4.0},
    "drive-asymmetry": {"gain": 0.03},
    "dead-zone": {"force": 2.0},
    "encoder-eccentricity": {"cosine": 4e-6, "period": 0.008},
    "controller-mismatch": {"kp": 0.03, "kv": -0.02, "velocity_filter": 0.1, "added": 0.1},
    "disturbance": {},
}
# default step against a finer one, rms of the command relative to its own: what is linear is exact,
# the laws enter with order two and a small constant (benchmarks/results/integrator.md)
ACCURACY = {
    "stribeck": 3e-6,
    "regularised-coulomb": 6e-6,
    "presliding": 1e-5,
    "sqrt-viscous": 2e-5,
    "backlash": 1e-4,
    "drive-timing": 1e-5,
}


def reference(n: int = 1500, amplitude: float = 0.02, **changes: object) -> Record:
    """A record that moves there and back, with a pause in between."""
    t = np.arange(n) * DT
    phase = np.clip(t * 2.0, 0.0, 1.0) + np.clip(t * 2.0 - 1.4, 0.0, 1.0)
    q_ref = amplitude * np.sin(np.pi * phase) ** 2
    return Record(**{"t": t, "q": q_ref, "q_ref": q_ref, "nu": np.sin(t)} | changes)


RECORD = reference()


def loop_with(controller: Controller, **changes: object) -> ClosedLoop:
    return replace(axes.emps(), controller=controller, **changes)


def response(loop: ClosedLoop, theta: dict[str, float], record: Record, q0=0.0, v0=0.0, **k: int):
    """The same simulation by python-control."""
    system = loop.system(theta, dt=record.dt, **k)
    assert record.q_ref is not None
    added = np.zeros(record.n_samples) if record.added is None else record.added[:, 0]
    inputs = np.array([record.q_ref[:, 0], np.gradient(record.q_ref[:, 0], record.dt), added])
    state = initial_state(loop, loop.values(theta), record.dt, q0, v0)
    times = np.arange(record.n_samples) * record.dt
    return control.input_output_response(system, times, inputs, state)


def assert_same(loop: ClosedLoop, theta: dict[str, float], record: Record, **k: int) -> None:
    ours, theirs = (
        loop.simulate(record, theta, initial=(0.0, 0.0), **k),
        response(loop, theta, record, **k),
    )
    for name in ("q", "dq", "nu", "tau"):
        a, b = getattr(ours, name)[:, 0], theirs.outputs[theirs.output_labels.index(name)]
        assert np.max(np.abs(a - b)) <= 1e-9 * np.max(np.abs(b)), name


# --- two engines ------------------------------------------------------------------------------

finite = {"allow_nan": False, "allow_infinity": False}
controllers = st.one_of(
    st.builds(
        lambda kp, kv: ("cascade-pd", {"kp": kp, "kv": kv}),
        st.floats(50, 250, **finite),
        st.floats(100, 300, **finite),
    ),
    st.builds(
        lambda kp, kd: ("pd", {"kp": kp, "kd": kd}),
        st.floats(5e3, 5e4, **finite),
        st.floats(100, 300, **finite),
    ),
    st.builds(lambda kv: ("p-velocity", {"kv": kv}), st.floats(50, 300, **finite)),
    st.builds(
        lambda pole, gain: (
            "state-space",
            {
                "A": [[pole, 0.0], [0.1, 0.2]],
                "B": [[gain, -gain], [0.0, 0.5]],
                "C": [10.0, 0.1],
                "D": [3e4, -3e4],
            },
        ),
        st.floats(-0.5, 0.5, **finite),
        st.floats(0.0, 50.0, **finite),
    ),
)


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    controller=controllers,
    taps=st.sampled_from([(1.0,), (0.5, 0.5), (0.6, 0.3, 0.1)]),
    delay=st.integers(0, 3),
    limit=st.sampled_from([np.inf, 10.0, 3.0]),
    drive=st.floats(0.0, 2.5e-3, **finite),
    theta=st.builds(
        dict,
        inertia=st.floats(60, 140, **finite),
        viscous=st.floats(0, 400, **finite),
        coulomb=st.floats(0, 40, **finite),
        offset=st.floats(-10, 10, **finite),
    ),
    pulse=st.floats(-3, 3, **finite),
)
def test_the_compiled_loop_is_python_controls(controller, taps, delay, limit, drive, theta, pulse):
    kind, gains = controller
    loop = loop_with(Controller(kind, gains, taps, delay, limit), delay=drive)
    record = reference(400, added=np.where(np.arange(400) % 150 > 120, pulse, 0.0))
    if loop.simulate(record, theta, initial=(0.0, 0.0)).finite:
        assert_same(loop, theta, record)


@pytest.mark.parametrize("effect", SIZES)
def test_every_effect_is_the_same_in_both_engines(effect):
    assert_same(axes.emps().with_effect(effect, **SIZES[effect]), THETA, reference(250))


def test_systems_can_be_linearised_and_analysed():
    loop = axes.emps().with_terms("inertia", "viscous")
    system = loop.system({"inertia": 95.0, "viscous": 200.0}, dt=DT)
    linear = control.linearize(system, np.zeros(system.nstates), np.zeros(3))
    assert np.all(np.abs(linear.poles()) < 1.0 + 1e-6)
    track = linear[0, 0]  # reference to position
    _, step = control.step_response(track, np.arange(400) * DT)
    assert step[-1] == pytest.approx(1.0, abs=1e-3)
    magnitude = control.frequency_response(track, [0.1, 20.0, 2e3]).magnitude.ravel()
    assert magnitude[0] == pytest.approx(1.0, rel=1e-3)
    assert magnitude[2] < 0.1
    assert system.input_labels == ["q_ref", "dq_ref", "added"]
    assert system.output_labels == ["q", "dq", "nu", "tau"]


# --- accuracy ---------------------------------------------------------------------------------


@pytest.mark.parametrize("effect", SIZES)
def test_the_default_step_is_fine_enough(effect):
    loop = axes.emps().with_effect(effect, **SIZES[effect])
    coarse = loop.simulate(RECORD, THETA)
    fine = loop.simulate(RECORD, THETA, substeps=50 * loop.substeps)
    assert coarse.finite and np.isfinite(coarse.nu).all() and np.isfinite(coarse.ddq).all()
    error = np.linalg.norm(coarse.nu - fine.nu) / np.linalg.norm(fine.nu)
    assert error < ACCURACY.get(effect, 1e-6)


def test_rigid_motion_is_exact_whatever_the_step():
    loop = axes.emps()
    steps = [loop.simulate(RECORD, THETA, substeps=n).q for n in (1, 7)]
    ramped = loop.simulate(RECORD, THETA, ramp=True, substeps=50).q  # by Runge-Kutta
    assert np.array_equal(*steps)
    assert ramped == pytest.approx(steps[0], rel=1e-9, abs=1e-15)


def distance(one: ClosedLoop, other: ClosedLoop, **k: int) -> float:
    a, b = (loop.simulate(RECORD, THETA, **k).nu for loop in (one, other))
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))


@pytest.mark.parametrize("noise", [0.0, 30.0])
@pytest.mark.parametrize("effects", [["flexibility"], ["backlash"], ["presliding", "stribeck"]])
def test_steps_converge_through_rest_and_reversals_of_both_masses(effects, noise):
    """Also where an outside force of noise makes them leave, return and rest at any time."""
    loop, push = axes.emps(), noise * np.random.default_rng(3).normal(size=RECORD.n_samples)
    for effect in effects:
        shares = {"load_friction": 0.4} if effect in ("flexibility", "backlash") else {}
        loop = loop.with_effect(effect, **SIZES[effect] | shares)
    runs = [loop.simulate(RECORD, THETA, force_noise=push, substeps=n).nu for n in (1, 16, 64)]
    errors = [np.linalg.norm(nu - runs[-1]) / np.linalg.norm(runs[-1]) for nu in runs[:-1]]
    assert errors[0] < (3e-3 if noise else 1e-4)  # two events within a sample may go unseen
    assert errors[1] < 1e-6


def test_what_is_infinitely_stiff_is_rigid():
    rigid, stuck = axes.emps(), {"load_friction": 0.5, "damping": 0.5}
    for hz, near in ((1e3, 3e-4), (1e4, 3e-5), (1e9, 3e-5)):
        assert distance(rigid.with_effect("flexibility", frequency_hz=hz, **stuck), rigid) < near
    for stiffness, near in ((1e8, 1e-2), (1e10, 1e-3), (1e20, 1e-3)):
        assert distance(rigid.with_effect("presliding", stiffness=stiffness), rigid) < near


def test_a_closed_gap_is_a_spring():
    joint = {"load_share": 0.2, "load_friction": 0.4, "damping": 0.3}
    spring = axes.emps().with_effect("flexibility", frequency_hz=150.0, **joint)
    for gap, near in ((1e-7, 1e-2), (1e-10, 1e-5), (0.0, 1e-12)):
        alike = {**joint, "contact_hz": 150.0, "load_offset": joint["load_friction"]}
        closed = axes.emps().with_effect("backlash", gap=gap, **alike)
        assert distance(closed, spring) <= near


def test_only_an_offset_of_the_load_preloads_a_gap():
    """At rest on a slope the load lies against one side: a gap shows at no small reversal."""
    joint = {"gap": 1e-4, "load_share": 0.3, "load_friction": 0.1}
    runs = {}
    for offset in (0.0, 1.0):
        loop = axes.emps().with_effect("backlash", load_offset=offset, **joint)
        heavy = THETA | {"offset": 60.0}
        runs[offset] = loop.simulate(RECORD, heavy).nu[:, 0]
        free = loop.simulate(RECORD, heavy | {"backlash.gap": 0.0}).nu[:, 0]
        runs[offset] = float(np.std(runs[offset] - free))
    assert runs[1.0] < 0.5 * runs[0.0]


@pytest.mark.parametrize("effect", ["flexibility", "backlash"])
@pytest.mark.parametrize("laws", [(), ("stribeck", "asymmetric-viscous")])
def test_a_step_of_two_masses_is_the_series_that_was_summed_before(effect, laws):
    """In every mode, with laws that are not linear and without."""
    loop = axes.emps()
    for law in laws:
        loop = loop.with_effect(law, **SIZES[law])
    shape = {"gap": 1e-4, "contact_hz": 300.0} if effect == "backlash" else {"frequency_hz": 60.0}
    loop = loop.with_effect(effect, load_share=0.3, load_friction=0.4, **shape)
    p, on, user = plant(loop, loop.values(THETA))
    integrator.plan(1e-3, 1, p, on)
    h, rng = 1e-3 / p["steps"], np.random.default_rng(0)
    for _ in range(200):
        mode = (*rng.choice([-1.0, 1.0], 2), rng.choice([-1.0, 0.0, 1.0]))
        q, v = 1e-4 * rng.normal(size=2), 0.1 * np.array(mode[:2]) * rng.uniform(size=2)
        x, force = (q[0], v[0], q[1], v[1], 0.0), 50.0 * rng.normal()
        both = [
            steps.two_masses(x, mode, h, force, 100.0, 0.0, p, on, user, span) for span in (1, -1)
        ]
        np.testing.assert_allclose(both[0][0], both[1][0], rtol=1e-12, atol=1e-15)
        assert both[0][1] == both[1][1]
    assert np.any(p["sums"][0, 1]) and not np.any(p["there"][1:])  # the load is what it is


@pytest.mark.parametrize(("least", "error"), [(0.2, 0.0), (0.5, 1e-3), (0.9, 5e-5)])
def test_a_step_with_a_load_that_varies_lies_between_those_of_loads_near_it(least, error):
    """Where the loads for which series are summed lie near each other; else it sums its own."""
    loop = axes.emps().with_effect("stribeck", **SIZES["stribeck"])
    loop = loop.with_effect("backlash", load_share=0.3, gap=1e-4, contact_hz=300.0)
    p, on, user = plant(loop, loop.values(THETA))
    integrator.plan(1e-3, 1, p, on)
    mean, h, rng = p["load"], 1e-3 / p["steps"], np.random.default_rng(0)
    steps.spread(least * mean, 1.1 * mean, h, p)
    found = []
    for _ in range(200):
        mode = (*rng.choice([-1.0, 1.0], 2), rng.choice([-1.0, 0.0, 1.0]))
        q, v = 1e-4 * rng.normal(size=2), 0.1 * np.array(mode[:2]) * rng.uniform(size=2)
        x, force = (q[0], v[0], q[1], v[1], 0.0), 50.0 * rng.normal()
        steps.laden(mean * rng.uniform(least, 1.1), p)
        near, exact = (
            steps.two_masses(x, mode, h, force, 100.0, 0.0, p, on, user, span)[0]
            for span in (1, -1)
        )
        off, moved = (np.abs(np.subtract(exact, y)[[1, 3]]).max() for y in (near, x))
        found.append(off / moved)
    assert (p["spacing"] > 0.0) == (error > 0.0) == (max(found) > 0.0)
    assert np.quantile(found, 0.9) <= error


@pytest.mark.parametrize("effect", ["backlash", "flexibility", "stribeck"])
def test_a_known_load_pulls_at_the_second_mass(effect):
    """A steady one is an offset of the load; with one mass it is any offset."""
    joint = {} if effect == "stribeck" else {"load_share": 0.3, "load_friction": 1.0}
    joint |= {"load_offset": 1.0} if effect == "backlash" else {}
    loop = axes.emps().with_effect(effect, **SIZES[effect] | joint)
    pulled, free = (RECORD.replace(load=np.full((RECORD.n_samples, 1), x)) for x in (60.0, 0.0))
    one = loop.simulate(pulled, THETA | {"offset": 0.0}).nu
    other = loop.simulate(free, THETA | {"offset": 60.0}).nu
    np.testing.assert_allclose(one, other, atol=1e-9 * np.abs(other).max())


def test_a_contact_beyond_the_sampling_is_rigid_under_a_known_load():
    loop = axes.emps().with_effect("backlash", gap=1e-4, load_share=0.5)
    pulled = RECORD.replace(load=np.full((RECORD.n_samples, 1), 60.0))
    stiff, stiffer = (THETA | {"backlash.contact_hz": hz} for hz in (1e3, 1e6))
    np.testing.assert_array_equal(
        loop.simulate(pulled, stiff).nu, loop.simulate(pulled, stiffer).nu
    )
    one, other = (loop.simulate(RECORD, theta).nu for theta in (stiff, stiffer))
    assert np.abs(one - other).max() > 0.0


@pytest.mark.parametrize(
    ("effect", "sizes"),
    [
        ("backlash", {"gap": 2e-3, "contact_hz": 40.0}),
        ("flexibility", {"frequency_hz": 8.0, "damping": 0.3}),
    ],
)
def test_a_link_begins_where_its_load_holds_it(effect, sizes):
    """A part of a record goes as it does in the whole: no fall through the gap, no swing."""
    loop = axes.emps().with_effect(effect, load_share=0.6, load_friction=0.2, **sizes)
    slow = reference(1500, 0.003)
    load = 200.0 + 30.0 * np.sin(2.0 * np.pi * slow.t)
    whole = loop.simulate(slow.replace(load=load), THETA)
    record = slow.replace(q=whole.q, nu=whole.nu, tau=whole.tau, load=load)
    for first in (100, 400, 900, 1100):
        part = slice(first, first + 250)
        begun = loop.simulate(record.slice(part.start, part.stop), THETA)
        error = np.sqrt(np.mean((begun.nu - whole.nu[part]) ** 2))
        assert error < 0.03 * np.mean(load) / loop.gain


@pytest.mark.parametrize(
    ("effect", "name", "at"),
    [
        ("drive-timing", "delay", 1e-3),
        ("drive-timing", "delay", 4e-4),
        ("drive-timing", "lag", 0.0),
        ("drive-timing", "lag", 1e-3),
        ("presliding", "stiffness", 5e5),
        ("flexibility", "frequency_hz", 45.0),
        ("backlash", "gap", 3e-5),
    ],
)
def test_answers_are_smooth_in_the_parameter(effect, name, at):
    """Slopes over neighbouring intervals agree: no stairs from samples or sub-steps."""
    full = f"{effect}.{name}"
    rattles = effect == "backlash"  # what rattles is chaotic in the small
    loop = axes.emps().with_effect(effect, **SIZES[effect])
    step = (0.05 if rattles else 0.01) * (at or 1e-3)
    points = [at + k * step for k in ((0, 1, 2) if at == 0.0 else (-1, 0, 1))]
    nu = [loop.simulate(RECORD, THETA | {full: p}).nu[:, 0] for p in points]
    left, right = nu[1] - nu[0], nu[2] - nu[1]
    assert np.linalg.norm(left) > 0.0
    assert np.linalg.norm(right - left) < (0.5 if rattles else 0.2) * np.linalg.norm(left)


# --- mechanics --------------------------------------------------------------------------------


def open_loop(**changes: object) -> ClosedLoop:
    """An axis whose controller does nothing; the added input is the command."""
    return loop_with(
        Controller("state-space", {"A": [], "B": [], "C": [], "D": [0.0, 0.0]}), **changes
    )


def test_dry_friction_holds_the_axis_exactly():
    t = np.arange(1000) * DT
    record = reference(1000, added=0.5 * np.sin(9 * t))  # 17.6 N against 20 N and an offset of 2
    theta = THETA | {"offset": 2.0}
    held = open_loop().simulate(record, theta, initial=(0.02, 0.0))
    assert np.all(held.q == 0.02) and np.all(held.dq == 0.0) and np.all(held.ddq == 0.0)
    free = open_loop().simulate(record, theta | {"coulomb": 15.0}, initial=(0.02, 0.0))
    assert np.ptp(free.q) > 1e-5


def test_a_moving_axis_stops_and_stays():
    record = reference(1000, added=np.zeros(1000))
    stopped = open_loop().simulate(record, THETA, initial=(0.0, 0.05))
    rest = np.flatnonzero(stopped.dq == 0.0)
    assert len(rest) and np.all(stopped.dq[rest[0] :] == 0.0)
    # v(t) of M dv/dt = -(Fc + offset) - Fv v comes to rest at this time and place
    tau, level = 95.0 / 200.0, (20.0 - 3.0) / 200.0
    time = tau * np.log(1.0 + 0.05 / level)
    assert rest[0] * DT == pytest.approx(time, abs=DT)
    assert stopped.q[-1, 0] == pytest.approx(tau * 0.05 - level * time, rel=1e-9)


def test_energy_only_leaves_where_there_is_friction():
    loop = open_loop(terms=("inertia", "viscous", "coulomb", "offset", "spring"))
    theta = {"inertia": 95.0, "viscous": 0.0, "coulomb": 0.0, "offset": 0.0}
    spring = {"spring.stiffness": 4000.0, "spring.curvature": 0.0}
    record = reference(1500, added=np.zeros(1500))

    def energy(**changes: float) -> np.ndarray:
        moved = loop.simulate(record, theta | spring | changes, initial=(0.01, 0.0))
        return (0.5 * 95.0 * moved.dq**2 + 0.5 * 4000.0 * moved.q**2).ravel()

    kept = energy()
    assert kept == pytest.approx(np.full(1500, kept[0]), rel=1e-7)
    assert np.all(np.diff(energy(viscous=20.0, coulomb=2.0)) <= 1e-12 * kept[0])


def test_two_masses_swing_at_the_stated_frequency():
    hz, share = 20.0, 0.3
    loop = open_loop().with_effect("flexibility", frequency_hz=hz, damping=0.0, load_share=share)
    theta = {"inertia": 95.0, "viscous": 0.0, "coulomb": 0.0, "offset": 0.0}
    added = np.zeros(4000)
    added[:5] = 5.0
    moved = loop.simulate(reference(4000, added=added), theta, initial=(0.0, 0.0))
    swing = moved.dq[10:, 0] - moved.dq[10:, 0].mean()
    crossings = np.flatnonzero((swing[1:] > 0.0) & (swing[:-1] <= 0.0))
    exact = crossings - swing[crossings] / (swing[crossings + 1] - swing[crossings])
    assert 1.0 / (np.diff(exact).mean() * DT) == pytest.approx(hz, rel=1e-3)


def test_gravity_turns_with_the_axis():
    loop = open_loop(terms=("inertia", "viscous", "gravity"), joint="revolute", gain=1.0)
    theta = {"inertia": 0.01, "viscous": 0.02, "gravity.sin": 0.5, "gravity.cos": 0.0}
    fallen = loop.simulate(reference(6000, added=np.zeros(6000)), theta, initial=(0.3, 0.0))
    assert fallen.q[-1, 0] == pytest.approx(0.0, abs=1e-3)  # hangs where sin q = 0


# --- a user's own law -------------------------------------------------------------------------


def test_a_law_of_your_own_works_everywhere():
    mine = Term(
        "soft-stop",
        "mechanics",
        (Parameter("stiffness", "{F}/{L}3"),),
        "k q^3",
        "a test",
        law=lambda q, dq, ddq, sign, tau, t, k: k * q * q * q,
    )
    loop = axes.emps().with_effect(mine, stiffness=4e5)
    assert loop.names[-1] == "soft-stop.stiffness"
    assert_same(loop, THETA, reference(300))
    moved = loop.simulate(RECORD, THETA)
    force = loop.regressor(moved.motion) @ [*THETA.values(), 4e5]
    middle = np.abs(moved.dq[:, 0]) > 1e-3
    rest = (moved.tau[:, 0] - force)[middle]
    assert np.linalg.norm(rest) < 1e-9 * np.linalg.norm(force)
    plain = axes.emps().simulate(RECORD, THETA)
    assert np.linalg.norm(moved.nu - plain.nu) > 0.01 * np.linalg.norm(plain.nu)
    with pytest.raises(AxisError, match="term of your own"):
        loop.to_toml()


def test_two_laws_of_your_own_keep_their_parameters_apart():
    terms = [
        Term(f"push{i}", "mechanics", tuple(Parameter(n, "{F}") for n in names), "", "", law=law)
        for i, (names, law) in enumerate(
            [
                ("ab", lambda q, dq, ddq, s, tau, t, a, b: a + 10.0 * b),
                ("c", lambda *x: 100.0 * x[-1]),
            ]
        )
    ]
    loop = axes.emps().with_effect(terms[0], a=1.0, b=0.2).with_effect(terms[1], c=0.03)
    shifted = THETA | {"offset": THETA["offset"] + 6.0}
    same = axes.emps().simulate(RECORD, shifted)
    assert loop.simulate(RECORD, THETA).nu == pytest.approx(same.nu, rel=1e-7, abs=1e-9)


# --- how a simulation starts and ends ----------------------------------------------------------


def test_a_record_that_starts_in_motion_leaves_no_transient():
    whole = axes.emps().simulate(RECORD, THETA, initial="rest")
    full = RECORD.replace(q=whole.q, nu=whole.nu)
    part = full.slice(150, 1400)
    again = axes.emps().simulate(part, THETA)
    scale = np.abs(whole.nu).max()
    error = np.abs(again.nu - whole.nu[150:1400])
    assert error.max() < 0.05 * scale  # the record's own velocity is read from 20 samples
    assert error[100:].max() < 1e-3 * scale
    cold = axes.emps().simulate(part, THETA, initial="rest")
    assert np.abs(cold.nu - whole.nu[150:1400]).max() > 0.1 * scale


def test_the_law_kept_of_a_record_is_that_of_the_loop():
    """Whatever was simulated along it before: another law, limit, gain or start."""
    lead = {"A": [[0.8]], "B": [[0.2, -0.2]], "C": [[-5e4]], "D": [[9e4, -9e4]]}
    laws = (axes.emps().controller, Controller("state-space", lead, limit=3.0))
    cases = [
        (loop_with(law, gain=gain), THETA | limit, initial)
        for law in laws
        for gain in (30.0, 40.0)
        for limit in ({}, {"saturation.limit": 2.0})
        for initial in ("record", "rest", (0.001, 0.02))
    ]
    record = reference()
    for loop, theta, initial in (*cases, *cases[::-1], *cases[::5]):
        loop = loop.with_effect("saturation") if "saturation.limit" in theta else loop
        now = loop.simulate(record, theta, initial=initial)
        fresh = loop.simulate(reference(), theta, initial=initial)
        np.testing.assert_array_equal(now.nu, fresh.nu)


def test_a_state_space_controller_starts_steady():
    lead = {"A": [[0.8]], "B": [[0.2, -0.2]], "C": [[-5e4]], "D": [[9e4, -9e4]]}
    loop = loop_with(Controller("state-space", lead))
    whole = loop.simulate(RECORD, THETA, initial="rest")
    part = RECORD.replace(q=whole.q, nu=whole.nu).slice(150, 1400)
    again = loop.simulate(part, THETA)
    assert np.abs(again.nu - whole.nu[150:1400]).max() < 0.05 * np.abs(whole.nu).max()


def test_an_unstable_loop_is_reported_and_not_an_error():
    wild = loop_with(Controller("cascade-pd", {"kp": 5e4, "kv": 5e4}, (0.5, 0.5), 3))
    for loop in (wild, wild.with_effect("stribeck", force=5.0), wild.with_effect("flexibility")):
        gone = loop.simulate(RECORD, THETA)
        assert not gone.finite
        with pytest.raises(RecordError, match="unstable"):
            gone.to_record()


def test_noise_and_quantum_act_where_they_say():
    noise = np.random.default_rng(1).normal(0.0, 1.0, RECORD.n_samples)
    loop = axes.emps()
    seen = loop.simulate(RECORD, THETA, position_noise=1e-6 * noise, quantum=1e-6)
    assert seen.q / 1e-6 == pytest.approx(np.round(seen.q / 1e-6), abs=1e-6)
    pushed = loop.simulate(RECORD, THETA, force_noise=noise)
    assert np.std(pushed.ddq - loop.simulate(RECORD, THETA).ddq) > 0.005
    with pytest.raises(ShapeError, match="force_noise has 3 samples"):
        loop.simulate(RECORD, THETA, force_noise=[1.0, 2.0, 3.0])


def test_without_stiction_the_force_takes_the_sign_as_it_comes():
    loop = axes.emps()
    chatter = loop.simulate(RECORD, THETA, stiction=False, substeps=10)
    held = loop.simulate(RECORD, THETA)
    assert np.linalg.norm(chatter.q - held.q) < 1e-3 * np.linalg.norm(held.q)
    assert not np.array_equal(chatter.q, held.q)


# --- what is refused --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: axes.emps().simulate(RECORD, {}), "'viscous' has no value"),
        (lambda: axes.emps().simulate(RECORD, THETA | {"inertia": 0.0}), "positive one"),
        (lambda: axes.emps().simulate(RECORD, THETA | {"inertia": np.nan}), "must be finite"),
        (lambda: axes.emps().simulate(RECORD, THETA | {"mass": 1.0}), "'mass' is not in the model"),
        (lambda: axes.emps().simulate(RECORD, [1.0, 2.0]), "theta has 2 values"),
        (lambda: axes.emps().simulate(RECORD, THETA, initial="now"), "initial is 'now'"),
        (lambda: axes.emps().simulate(RECORD, THETA, substeps=0), "substeps is 0"),
        (lambda: axes.emps().with_effect("stribeck", foce=1.0), "no parameter 'foce'"),
        (lambda: axes.emps().with_effect("viscous"), "given twice"),
        (lambda: axes.emps().with_effect("stribeck", force=np.nan), "is nan"),
        (lambda: replace(axes.emps(), gain=0.0), "drive gain is 0"),
        (lambda: replace(axes.emps(), delay=99.0), "drive delay is 99"),
        (lambda: replace(axes.emps(), joint="hinge"), "'prismatic' or 'revolute'"),
        (
            lambda: axes.emps().with_effect("drive-timing", delay=1e9).simulate(RECORD, THETA),
            "delay is 1e\\+09 s",
        ),
        (lambda: axes.emps().simulate(RECORD.replace(q_ref=None), THETA), "q_ref is missing"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(call, message):
    with pytest.raises((AxisError, ShapeError, RecordError), match=message):
        call()


def test_every_effect_of_the_table_has_a_size_here():
    assert SIZES.keys() == EFFECTS.keys()


def test_equal_terms_with_other_laws_are_other_laws(twin):
    """A law that was edited in a notebook counts, though nothing else of its term has changed."""

    def moved(factor):
        law = eval(f"lambda q, dq, ddq, sign, tau, t, a: {factor} * a * dq")
        own = Term("mine", "mechanics", (Parameter("a", "{F}"),), "", "", law=law)
        loop = axes.emps()
        theta = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0, "mine.a": 5.0}
        return loop.with_terms(*loop.terms, own).simulate(twin.slice(0, 3000), theta).nu

    assert not np.array_equal(moved(1.0), moved(30.0))


# --- where a record begins ----------------------------------------------------------------------


def test_a_record_of_a_slow_clock_may_begin_in_motion():
    """Twenty samples are then a good part of a move, no parabola."""
    missed = []
    for seed in range(12):
        rng = np.random.default_rng([seed, 5])
        hz = float(rng.choice([60.0, 100.0, 200.0]))
        loop, theta, stroke = populations.axis(rng, "prismatic")
        law = populations.controller(rng, "pd", theta["inertia"], hz, fast=2.0)
        loop = replace(loop, controller=populations.scaled(replace(law, delay=0), loop.gain))
        asked = populations.reference(rng, int(8 * hz), hz, stroke)
        noise = 1e-6 * stroke * rng.normal(size=asked.n_samples)
        made = loop.simulate(asked, theta, initial="rest", position_noise=noise)
        record = asked.replace(q=made.q, nu=made.nu).slice(int(hz))
        error = (loop.simulate(record, theta).nu - record.nu)[: int(hz)]
        missed.append(np.std(error) / np.std(record.nu))
    assert max(missed) < 0.03 and np.median(missed) < 0.005


@pytest.mark.parametrize("effect", ["backlash", "flexibility"])
def test_a_simulation_ends_where_it_diverges(effect, twin):
    """Next to no inertia under friction: steps through what is left of it took half a minute."""
    loop = axes.emps().with_effect(effect, load_share=0.5)
    theta = {"inertia": 1e-4, "viscous": 200.0, "coulomb": 20.0, "offset": 0.0}
    simulation = loop.simulate(twin, loop.values(theta))
    assert not simulation.finite
    assert np.isnan(simulation.nu[len(twin.t) // 2 :]).all()
    assert axes.emps().simulate(twin, {**theta, "inertia": 95.0}).finite


# -- how a record begins ---------------------------------------------------------------------------
@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_a_filter_that_forgets_faster_than_velocities_begin_starts_settled(noise):
    """Noise of a ten-thousandth of the command had started it with a quarter of the command."""
    lowpass = LoopFilter("lowpass", 570.0)
    settings = {"kp": 49.0, "kv": 360.0, "ki": 27.0}
    law = Controller("p-pi", settings, delay=1, velocity="logged", filter=lowpass)
    loop = replace(axes.emps(), controller=law, gain=0.0022)
    theta = {"inertia": 4e-3, "viscous": 0.01, "coulomb": 0.02, "offset": 0.001}
    dt = 4e-4
    t = np.arange(0.0, 2.0, dt)
    q_ref = 0.1 * (1.0 - np.cos(1.4 * np.pi * t)) * np.clip(t / 0.3, 0.0, 1.0)
    asked = Record(t, q_ref, q_ref=q_ref, nu=q_ref, dq=np.gradient(q_ref, dt))
    ran = loop.simulate(asked, theta, initial="rest")
    size = float(np.std(ran.nu))
    logged = ran.nu + noise * size * np.random.default_rng(1).normal(size=ran.nu.shape)
    record = Record(t, ran.q, q_ref=q_ref, nu=logged, dq=ran.dq)
    assert np.abs(loop.simulate(record, theta).nu - ran.nu).max() < 1e-3 * size
