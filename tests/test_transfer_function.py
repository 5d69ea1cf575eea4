"""Transfer functions: filters, recovery, closed loop, structures, the report's cases."""

import warnings
from dataclasses import replace

import control
import numpy as np
import pytest
from scipy.signal import lfilter

from ivtools import axes
from ivtools.errors import ConvergenceWarning, EstimationError, RecordError
from ivtools.estimators.box_jenkins import RIVBJ, RIVC, SRIV
from ivtools.estimators.closed_loop_srivc import CLSRIVC
from ivtools.estimators.continuous import (
    close_loop,
    derivatives,
    reflect,
    reflect_delta,
    respond,
)
from ivtools.estimators.structure import search_structures
from ivtools.estimators.transfer_function import SRIVC
from ivtools.loop.controllers import Controller
from ivtools.pipeline import Pipeline
from ivtools.problem import Problem
from ivtools.record import Record
from ivtools.reproduce.toolboxes import report_cases

DT, N = 1e-3, 8000
COLOUR = (1.0, -0.9998)  # a position that drifts


@pytest.fixture(autouse=True)
def _strict():
    """No method may fail to converge unnoticed."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", ConvergenceWarning)
        yield


def steps(seed=0, n=N, every=150):
    """A command that changes level at random."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.normal(0.0, 1.0, n // every + 1), every)[:n]


def open_loop(B, A, noise=0.0, seed=0, colour=(1.0,), u=None) -> Problem:
    """A problem whose position is B/A of its command."""
    u = steps(seed) if u is None else u
    rng = np.random.default_rng(seed + 100)
    q = respond(B, A, u, DT) + lfilter([1.0], colour, noise * rng.standard_normal(len(u)))
    record = Record(np.arange(len(u)) * DT, q, q_ref=u, nu=u)
    return Problem(record, axes.emps())


def known(r):
    """What a law knows beforehand of a reference: it, its derivative, and no feed-forward."""
    return np.column_stack([r, np.gradient(r, DT), 0.0 * r])


def closed_loop(seed, n=N, noise=2e-4) -> Problem:
    """A linear axis under the EMPS controller, with a coloured disturbance of its position."""
    loop = axes.emps()
    law = loop.controller.law(DT)
    r = np.cumsum(steps(seed, n)) * DT * 0.1
    white = np.random.default_rng(seed).standard_normal(n)
    d = lfilter([noise], [1.0, -0.95], white)
    # the loop is linear: a disturbance of the output acts like a reference of the feedback alone
    A, B = [1.0, 4.0, 0.0], [0.37]
    q0, nu0 = close_loop(B, A, law, 1, known(r), DT)
    feedback = law.D[3] * d + law.D[4] * np.convolve(d, law.taps)[:n]
    q1, nu1 = close_loop(B, A, law, 1, np.column_stack([0.0 * r, 0.0 * r, feedback]), DT)
    return Problem(Record(np.arange(n) * DT, q0 + q1 + d, q_ref=r, nu=nu0 + nu1), loop)


def test_filters_are_those_of_python_control():
    t, u = np.arange(3000) * DT, steps(1, 3000)
    A = [1.0, 90.0, 1.2e4, 3e5]
    columns = derivatives(u, A, DT, "foh")
    for power in range(3):
        numerator = [1.0] + [0.0] * power
        response = control.forced_response(control.tf(numerator, A), t, u).outputs
        np.testing.assert_allclose(columns[:, power], response, atol=1e-9 * abs(response).max())
    np.testing.assert_allclose(columns @ A[::-1], u, atol=1e-9)


def test_unstable_roots_are_reflected():
    A = np.poly([3.0, -1.0, 2.0 + 5.0j, 2.0 - 5.0j]).real
    expected = [-3.0, -2.0 - 5.0j, -2.0 + 5.0j, -1.0]
    np.testing.assert_allclose(np.sort_complex(np.roots(reflect(A))), expected, atol=1e-9)
    assert np.roots(reflect([1.0, 0.0], least=0.5)) == pytest.approx([-0.5])
    z = np.array([1.25, 0.5, -2.0, 0.9 + 0.6j, 0.9 - 0.6j])
    mirrored = 1.0 + 0.1 * np.roots(reflect_delta(np.poly((z - 1.0) / 0.1).real, 0.1))
    inside = np.where(np.abs(z) > 1.0, 1.0 / z.conj(), z)
    np.testing.assert_allclose(np.sort_complex(mirrored), np.sort_complex(inside), atol=1e-9)
    slow = 1.0 + 0.1 * np.roots(reflect_delta([1.0, 0.0], 0.1, least=0.5))
    assert slow == pytest.approx([np.exp(-0.05)])


B_Z, A_Z = [0.002, 0.0015], np.poly([0.95 + 0.05j, 0.95 - 0.05j]).real  # fast, in z


def sampled(noise=0.0, seed=0, ar=(1.0,), ma=(1.0,)) -> Problem:
    """A problem whose position is a discrete transfer function of its command, plus ARMA noise."""
    u, rng = steps(seed, every=40), np.random.default_rng(seed + 50)
    q = lfilter([0.0, *B_Z], A_Z, u) + noise * lfilter(ma, ar, rng.standard_normal(N))
    return Problem(Record(np.arange(N) * DT, q, q_ref=u, nu=u), axes.emps())


@pytest.mark.parametrize("method", [SRIV, RIVBJ])
def test_a_discrete_record_without_noise_gives_the_polynomials_in_z(method):
    fit = method(poles=2, zeros=1).fit(sampled(1e-9))
    assert fit.discrete and fit.system.dt == pytest.approx(DT)
    numerator, denominator = fit.system.num[0][0], fit.system.den[0][0]
    np.testing.assert_allclose(denominator / denominator[0], A_Z, rtol=1e-5)
    np.testing.assert_allclose(numerator / denominator[0], B_Z, rtol=1e-3)
    exponents = np.log(np.roots(A_Z)) / DT
    np.testing.assert_allclose(np.sort_complex(fit.poles), np.sort_complex(exponents), rtol=1e-3)
    with pytest.raises(EstimationError, match="a model of 0.001 s per sample"):
        fit.simulate(np.ones(300), 2e-3)


@pytest.mark.slow
def test_a_box_jenkins_model_is_more_accurate_than_none():
    simple, refined = [], []
    for seed in range(6):
        problem = sampled(0.02, seed, ar=[1.0, -0.99], ma=[1.0, 0.8])
        simple.append(SRIV(poles=2, zeros=1).fit(problem).params)
        refined.append(RIVBJ(poles=2, zeros=1).fit(problem).params)
    delta = np.poly((np.roots(A_Z) - 1.0) / DT).real[1:]
    errors = [np.sqrt(np.mean((np.array(p)[:, :2] / delta - 1.0) ** 2, axis=0))
              for p in (simple, refined)]  # fmt: skip
    assert np.all(errors[1] < 0.5 * errors[0])


@pytest.mark.parametrize("factor", [0.1, 10.0])
@pytest.mark.parametrize("method", [SRIVC, RIVC])
def test_far_starting_values_lead_to_the_same_transfer_function(method, factor):
    problem = open_loop([200.0], [1.0, 12.0, 150.0], 0.01)
    near = method(poles=2, tol=1e-8).fit(problem)
    far = method(poles=2, tol=1e-8, start=tuple(factor * near.params)).fit(problem)
    np.testing.assert_allclose(far.params, near.params, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("method", [SRIVC, RIVC])
def test_a_record_without_noise_gives_the_coefficients(method):
    fit = method(poles=2, zeros=1).fit(open_loop([3.0, 200.0], [1.0, 12.0, 150.0]))
    np.testing.assert_allclose(fit.params, [12.0, 150.0, 3.0, 200.0, 0.0], rtol=1e-3, atol=0.05)
    assert fit.r2 > 0.99999 and fit.relative_error < 0.1


def test_an_integrator_and_a_constant_input_are_found():
    u = steps(2)
    problem = open_loop([0.37], [1.0, 4.0, 0.0], u=u - u.mean() + 0.5)
    shifted = problem.record.replace(nu=u - u.mean(), q=problem.record.q + 0.2)
    fit = SRIVC(poles=2, zeros=0, integrators=1).fit(Problem(shifted, problem.loop))
    np.testing.assert_allclose(fit.params, [4.0, 0.37, 0.185], rtol=2e-3)
    assert fit.A[-1] == 0.0 and np.abs(fit.resids).max() < 1e-3
    assert sorted(np.abs(fit.system.poles())) == pytest.approx([0.0, 4.0], rel=2e-3)


def test_results_are_python_control_systems():
    fit = SRIVC(poles=2, zeros=0).fit(open_loop([200.0], [1.0, 12.0, 150.0]))
    system = fit.system
    assert system.input_labels == ["nu"] and system.output_labels == ["q"]
    assert control.dcgain(system) == pytest.approx(200.0 / 150.0, rel=1e-3)
    mine = fit.simulate(np.ones(500), DT)
    theirs = control.forced_response(system, np.arange(500) * DT, np.ones(500)).outputs
    np.testing.assert_allclose(mine, theirs, atol=2e-3)
    assert "SRIVC transfer function" in fit.summary() and "R_T^2" in fit._repr_html_()
    assert "relative error" in repr(fit)


def test_compare_sets_them_beside_the_parameters():
    from ivtools.comparison import compare
    from ivtools.estimators.least_squares import IDIMLS

    problem = open_loop([0.37], [1.0, 4.0, 0.0])
    fits = [IDIMLS().fit(problem), SRIVC(poles=2, integrators=1).fit(problem)]
    both = compare(fits, holdout=problem.record, simulate=False)
    assert list(both.frame.columns) == ["idim-ls"] and both.results == (fits[0],)
    row = both.functions.frame().iloc[0]
    assert row["holdout_error"] == pytest.approx(row["relative_error"]) and row["poles"] == 2
    assert "Transfer functions" in both._repr_html_() and "inertia" in both._repr_html_()
    alone = compare(fits[1:])
    assert alone.results == () and len(alone.frame) == 0 and "srivc" in alone.summary()
    assert "idim-ls" not in alone.summary() and alone.plot().axes


def test_a_noise_model_makes_the_estimate_more_accurate():
    simple, refined = [], []
    for seed in range(6):
        problem = open_loop([200.0], [1.0, 12.0, 150.0], 0.01, seed, colour=COLOUR)
        simple.append(SRIVC(poles=2).fit(problem).params)
        refined.append(RIVC(poles=2).fit(problem).params)
    true = np.array([12.0, 150.0, 200.0, 0.0])
    errors = [np.sqrt(np.mean((np.array(p) - true) ** 2, axis=0))[:3] for p in (simple, refined)]
    assert np.all(errors[1] < 0.6 * errors[0])


def test_instruments_of_the_reference_are_consistent_in_closed_loop():
    plain, closed = [], []
    for seed in range(5):
        problem = closed_loop(seed)
        plain.append(SRIVC(poles=2, integrators=1).fit(problem).params)
        closed.append(CLSRIVC(poles=2, integrators=1).fit(problem).params)
    error = [np.mean(np.array(p)[:, :2], axis=0) / [4.0, 0.37] - 1.0 for p in (plain, closed)]
    assert np.all(np.abs(error[1]) < 0.05)
    assert np.all(np.abs(error[1]) < np.abs(error[0]))


def linear_axis(loop, twin, noise=0.0, seed=0) -> Problem:
    """The axis without dry friction, simulated in its loop, with pulses beside the command."""
    loop = loop.with_terms("inertia", "viscous", "offset")
    added = np.where(np.arange(twin.n_samples) % 900 < 100, 0.5, 0.0)
    theta, rng = {"inertia": 95.0, "viscous": 200.0, "offset": -3.0}, np.random.default_rng(seed)
    encoder = rng.normal(0.0, noise, twin.n_samples)
    sim = loop.simulate(
        Record(twin.t, twin.q, q_ref=twin.q_ref, nu=twin.nu, added=added),
        theta, initial="rest", position_noise=encoder,
    )  # fmt: skip
    record = Record(twin.t, sim.q, q_ref=twin.q_ref, nu=sim.nu, added=added)
    return Problem(record, loop)


def integral_controller():
    """A state-space law: proportional and filtered derivative action, and an integral."""
    kp, kd, ki, pole = 35000.0, 240.0, 20000.0, 0.6
    D = kp + kd * (1.0 - pole) / DT
    A, B = [[1.0, 0.0], [0.0, pole]], [[DT, -DT], [1.0, -1.0]]
    C = [[ki, -kd * (1.0 - pole) ** 2 / DT]]
    settings = {"A": A, "B": B, "C": C, "D": [[D, -D]]}
    return Controller("state-space", settings, delay=1)


@pytest.mark.parametrize("kind", ["cascade-pd", "state-space"])
def test_every_controller_gives_instruments(twin, kind):
    loop = axes.emps()
    if kind == "state-space":
        loop = replace(loop, controller=integral_controller())
    exact = linear_axis(loop, twin.slice(0, 8000))
    law, record = loop.controller.law(DT), exact.record
    B, A = [loop.gain / 95.0], [1.0, 200.0 / 95.0, 0.0]
    r = record.q_ref[:, 0] - record.q_ref[0, 0]
    force = record.added[:, 0] + 3.0 / loop.gain  # the offset is a constant input
    q, nu = close_loop(B, A, law, loop.controller.delay, known(r), DT, force)
    inner = record.q[:, 0] - record.q[0, 0]
    np.testing.assert_allclose(q, inner, atol=1e-3 * np.ptp(inner))
    true = [200.0 / 95.0, loop.gain / 95.0, 3.0 / 95.0]
    fit = CLSRIVC(poles=2, integrators=1).fit(exact)
    np.testing.assert_allclose(fit.params, true, rtol=5e-3)
    noisy = CLSRIVC(poles=2, integrators=1).fit(linear_axis(loop, twin.slice(0, 8000), 1e-5))
    np.testing.assert_allclose(noisy.params, true, rtol=2e-2)


def moving(noise=0.0, seed=0, n=N) -> Problem:
    """A vibrating mass that is on its way when the record begins, and passes through zero."""
    u, rng = steps(seed, n + 500), np.random.default_rng(seed + 7)
    q = respond([200.0], [1.0, 12.0, 150.0], u, DT)[500:] + noise * rng.standard_normal(n)
    return Problem(Record(np.arange(n) * DT, q, q_ref=u[500:], nu=u[500:]), axes.emps())


@pytest.mark.parametrize("method", [SRIVC, RIVC, SRIV, RIVBJ])
def test_the_state_at_the_first_sample_is_estimated(method):
    continuous = method in (SRIVC, RIVC)
    fit = method(poles=2, zeros=int(not continuous), offset=False).fit(moving(1e-9))
    expected = [-6.0 + 1j * np.sqrt(114.0), -6.0 - 1j * np.sqrt(114.0)]
    np.testing.assert_allclose(np.sort_complex(fit.poles), np.sort_complex(expected), rtol=1e-4)
    assert fit.relative_error < 1e-3
    at_rest = method(poles=2, zeros=int(not continuous), offset=False, initial="rest")
    assert at_rest.fit(moving(1e-9)).relative_error > 100.0 * fit.relative_error


def test_a_noisy_first_sample_moves_nothing():
    """The estimates scatter as the sensitivities of the output say, no more (Cramer and Rao)."""
    from ivtools.estimators.transfer_model import Model

    n, noise, true = 3000, 0.05, np.array([12.0, 150.0, 200.0])
    problem = open_loop([200.0], [1.0, 12.0, 150.0], u=steps(3, n))
    u = problem.record.nu[:, 0]

    def output(theta):
        return Model(np.concatenate([[1.0], theta[:2]]), theta[2:]).respond(u, DT, "zoh")

    steps_ = np.diag(1e-5 * true)
    S = np.column_stack([(output(true + d) - output(true - d)) / (2.0 * d.sum()) for d in steps_])
    bound = noise * np.sqrt(np.diag(np.linalg.inv(S.T @ S)))
    found = np.array(
        [
            SRIVC(poles=2, offset=False)
            .fit(open_loop([200.0], [1.0, 12.0, 150.0], noise, seed, u=u))
            .params
            for seed in range(40)
        ]
    )
    assert np.all(found.std(axis=0, ddof=1) < 1.35 * bound)
    assert np.all(np.abs(found.mean(axis=0) - true) < 4.0 * bound / np.sqrt(40.0))


@pytest.mark.parametrize("late", [0.0, 4e-3, 7.3e-3])
def test_the_delay_of_the_input_is_estimated(late):
    u = steps(4)
    q = respond([200.0], [1.0, 12.0, 150.0], u, DT, "zoh", late)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(u))
    problem = Problem(Record(np.arange(len(u)) * DT, q + noise, nu=u), axes.emps())
    fit = SRIVC(poles=2, offset=False, delay="estimate").fit(problem)
    assert fit.params["delay"] == fit.delay == pytest.approx(late, abs=2e-5)
    np.testing.assert_allclose(fit.params[:3], [12.0, 150.0, 200.0], rtol=2e-3)
    assert 0.0 < fit.std_errors["delay"] < 2e-5 and fit.converged
    known = SRIVC(poles=2, offset=False, delay=late).fit(problem)
    assert known.relative_error == pytest.approx(fit.relative_error, rel=1e-2)


@pytest.mark.parametrize("late", [0, 9, 77])
def test_a_delay_in_discrete_time_is_any_number_of_samples(late):
    u = steps(4, 5000, every=25)
    q = respond([2.0, 3.5e3], [1.0, 200.0, 2e4], u, DT, "euler", late * DT)
    noise = 0.01 * np.std(q) * np.random.default_rng(1).standard_normal(len(u))
    problem = Problem(Record(np.arange(len(u)) * DT, q + noise, nu=u), axes.emps())
    fit = SRIV(poles=2, zeros=1, offset=False, delay="estimate").fit(problem)
    assert fit.delay == pytest.approx(late * DT) and "delay" not in fit.params
    np.testing.assert_allclose(fit.params[:2], [200.0, 2e4], rtol=2e-2)


@pytest.mark.parametrize("seed", [2, 8, 17])
def test_a_delay_that_is_none_settles_at_its_bound(seed):
    """There the response has a kink: estimates of the delay went to and fro in 8 of 40 records."""
    rng, dt, n = np.random.default_rng(seed), 3.1e-4, 2100
    u = np.repeat(rng.choice([-1.0, 1.0], 300), 7)
    noise = lfilter([1.0], [1.0, -0.8], rng.standard_normal(n))
    q = 1e-3 * (respond([1257.0], [1.0, 394.0], u, dt) + 0.02 * noise)
    problem = Problem(Record(np.arange(n) * dt, q, nu=u), axes.emps(), Pipeline(None, 1))
    fit = RIVC(poles=1, offset=False, delay=np.str_("estimate")).fit(problem)
    assert fit.converged and fit.delay < 0.05 * dt
    assert abs(fit.params["a1"] - 394.0) < 4.0 * fit.std_errors["a1"]


@pytest.mark.parametrize("late", [4e-4, 3e-3])
def test_the_delay_of_a_drive_is_estimated_inside_its_loop(twin, late):
    loop = replace(axes.emps(), delay=late)
    problem = linear_axis(loop, twin.slice(0, 8000), 1e-5, 1)
    fit = CLSRIVC(poles=2, integrators=1, delay="estimate").fit(problem)
    off = fit.params.to_numpy() - [200.0 / 95.0, loop.gain / 95.0, 3.0 / 95.0, late]
    assert np.all(np.abs(off) < 4.0 * fit.std_errors) and fit.std_errors["delay"] < 1e-5


def test_a_fraction_of_a_step_is_exact_for_a_held_signal():
    u, A = steps(5, 400), [1.0, 12.0, 150.0]
    fine = respond([200.0], A, np.repeat(u, 10), DT / 10.0)
    late = respond([200.0], A, u, DT, "zoh", 2.7 * DT)
    expected = np.concatenate([np.full(27, u[0]), np.repeat(u, 10)])[: len(fine)]
    np.testing.assert_allclose(late, respond([200.0], A, expected, DT / 10.0)[::10], atol=1e-12)


def test_noise_in_the_command_does_not_bias_a_noise_model(twin):
    """Nothing may forget but the model itself: a slower filter leaves the error coloured."""
    loop, found = axes.emps(), []
    for seed in range(4):
        problem = linear_axis(loop, twin.slice(0, 8000), 1e-5, seed)
        found.append(RIVBJ(poles=2, zeros=1, integrators=1).fit(problem).params["a1"])
    true = -np.expm1(-200.0 / 95.0 * DT) / DT
    assert np.mean(found) == pytest.approx(true, rel=1e-4)


@pytest.mark.slow
def test_closed_loop_estimates_are_unbiased():
    found = np.array(
        [CLSRIVC(poles=2, integrators=1).fit(closed_loop(seed)).params for seed in range(60)]
    )[:, :2]
    bias = found.mean(axis=0) - [4.0, 0.37]
    assert np.all(np.abs(bias) < 3.0 * found.std(axis=0) / np.sqrt(60))


def test_the_search_finds_the_structure():
    problem = open_loop([3.0, 200.0], [1.0, 12.0, 150.0], 0.01)
    found = search_structures(problem, criterion="bic", integrators=[0])
    frame = found.frame()
    assert (frame.loc[0, "poles"], frame.loc[0, "zeros"]) == (2, 1)
    assert len(frame) == 6 and {"yic", "r2", "aic", "bic"} <= set(frame)
    assert "SRIVC structures, nu to q" in found.summary() and found._repr_html_()
    with pytest.raises(EstimationError, match="criterion 'best' is unknown"):
        search_structures(problem, criterion="best")


def test_the_report_cases(emps):
    figures = report_cases(emps)
    # printed: 74.6 %, 0.5; 47.3 %, 0.8 (a better fit exists); 0.005 %, 1.0
    assert figures["command to position", "relative error"] == pytest.approx(82.6, rel=0.01)
    assert round(figures["command to position", "R_T^2"], 1) == 0.5
    assert figures["command to velocity", "relative error"] < 47.3
    assert figures["command to velocity", "R_T^2"] > 0.8
    assert round(figures["reference to position", "relative error"], 3) == 0.005
    assert round(figures["reference to position", "R_T^2"], 1) == 1.0


def test_one_pole_comes_to_the_figures_of_the_report(emps):
    """Printed: 74.6 % and 0.5 on the position, 47.3 % and 0.8 on the velocity."""

    def fit(u, y, every):
        record = Record(emps.t[: len(u) : every], y[::every], nu=u[::every])
        problem = Problem(record, axes.emps(), Pipeline(None, 1))
        return RIVC(poles=1, offset=False).fit(problem)

    q, nu = emps.q[:-1, 0], emps.nu[:-1, 0]
    position = fit(nu - nu.mean(), q - q.mean(), 1)
    assert position.relative_error == pytest.approx(74.6, rel=0.01)
    assert round(position.r2, 1) == 0.5
    velocity = fit(nu, np.diff(emps.q[:, 0]) / DT, 20)
    assert (round(velocity.relative_error, 1), round(velocity.r2, 1)) == (47.3, 0.8)


def test_bad_input_is_refused():
    with pytest.raises(EstimationError, match="poles = 0"):
        SRIVC(poles=0)
    with pytest.raises(EstimationError, match="zeros = 2 must be 0 to 1"):
        SRIVC(poles=2, zeros=2)
    with pytest.raises(EstimationError, match="integrators = 3"):
        SRIVC(poles=2, integrators=3)
    with pytest.raises(EstimationError, match="delay = -1"):
        SRIVC(delay=-1)
    with pytest.raises(EstimationError, match="it models the plant inside its loop"):
        CLSRIVC(input="q_ref")
    problem = open_loop([200.0], [1.0, 12.0, 150.0])
    without = Problem(problem.record.replace(q_ref=None), problem.loop, problem.pipeline)
    with pytest.raises(RecordError, match="no q_ref"):
        SRIVC(input="q_ref").fit(without)
