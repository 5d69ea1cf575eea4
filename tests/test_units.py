"""Units change nothing but the numbers: metres or micrometres, newtons or kilonewtons, volts or mV.

Every method, on one noisy record of an axis whose lengths, forces and commands are written in other
units: the estimate, its standard errors and intervals, its errors and tests are the same numbers in
those units.
"""

import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

import ivtools as iv
from ivtools import inference
from ivtools.comparison import compare
from ivtools.errors import ConvergenceWarning
from ivtools.estimators.base import FUNCTIONS, METHODS, estimator_class
from ivtools.estimators.drive_gain import drive_gain
from ivtools.estimators.functions import function_cases
from ivtools.estimators.set_membership import SetMembership
from ivtools.estimators.state_dependent import StateDependentFriction
from ivtools.estimators.structure import search_structures
from ivtools.record import Record

THETA = {
    "inertia": 95.0,
    "viscous_pos": 165.0,
    "coulomb_pos": 20.0,
    "viscous_neg": 240.0,
    "coulomb_neg": 21.0,
}
SMALL = {"nsga2": {"population": 12, "generations": 4}}
# Searches by finite differences or linear programs end within their tolerance, not at rounding.
LOOSE = {"clie": 1e-6, "cloe": 1e-4, "oloe": 1e-5, "set-membership": 1e-6, "lmi-ls": 1e-6,
         "lmi-iv": 1e-6}  # fmt: skip

lengths = st.sampled_from([1.0, 1e3, 1e6, 57.3, 1e-3])  # per metre
forces = st.sampled_from([1.0, 1e-3, 1e-6, 1e5, 9.81])  # per newton
commands = st.sampled_from([1.0, 1e3, 0.1])  # per volt
some = settings(max_examples=3, deadline=None, phases=[Phase.generate])  # shrinking is slow


@cache
def moved(seconds=8, load=0.0):
    """Return a noisy record of the twin's motion, and the loop that made it."""
    twin = iv.datasets.twin().slice(0, 1000 * seconds)
    loop = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    rng, n = np.random.default_rng(5), twin.n_samples
    noise = {"position_noise": rng.normal(0, 1e-6, n), "force_noise": rng.normal(0, 1.0, n)}
    theta = {**THETA, "inertia": THETA["inertia"] + load}
    simulation = loop.simulate(twin, theta, initial="rest", **noise)
    return Record(twin.t, simulation.q, q_ref=twin.q_ref, nu=simulation.nu), loop


def written(length=1.0, force=1.0, command=1.0, load=0.0, **pipeline):
    """Return the problem with every signal, gain and starting value in other units."""
    record, loop = moved(load=load)
    law = {**loop.controller.settings}
    law["kv"] *= command / length
    controller = replace(loop.controller, settings=law, limit=loop.controller.limit * command)
    loop = replace(
        loop,
        controller=controller,
        gain=loop.gain * force / command,
        start={"inertia": loop.start["inertia"] * force / length},
    )
    scaled = Record(record.t, record.q * length, q_ref=record.q_ref * length,
                    nu=record.nu * command)  # fmt: skip
    settings = {k: v * length if k == "min_speed" else v for k, v in pipeline.items()}
    rows = replace(iv.Problem(scaled, loop).pipeline, **settings)
    return iv.Problem(scaled, loop, rows, simulation={"initial": "rest"})


def factor(name, length, force):
    """Return what a parameter's value is multiplied by."""
    return force / length if name.startswith(("inertia", "viscous")) else force


@cache
def fitted(method, masked=False):
    return quietly(method, written(**(MASK if masked else {})))


MASK = {"min_speed": 0.005, "guard": 10}


def quietly(method, problem):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return estimator_class(method)(**SMALL.get(method, {})).fit(problem)


@pytest.mark.parametrize("method", METHODS)
@some
@given(length=lengths, force=forces, command=commands, masked=st.booleans())
def test_every_estimate_is_the_same_in_other_units(method, length, force, command, masked):
    here = fitted(method, masked)
    there = quietly(method, written(length, force, command, **(MASK if masked else {})))
    scale = np.array([factor(name, length, force) for name in here.names])
    tolerance = LOOSE.get(method, 1e-8)
    np.testing.assert_allclose(there.params, here.params * scale, rtol=tolerance)
    np.testing.assert_allclose(there.std_errors, here.std_errors * scale, rtol=100 * tolerance)
    np.testing.assert_allclose(there.conf_int(), here.conf_int().mul(scale, axis=0),
                               rtol=10 * tolerance)  # fmt: skip
    assert there.relative_error == pytest.approx(here.relative_error, rel=100 * tolerance)
    assert there.converged == here.converged
    if method not in LOOSE:
        assert there.n_iter == here.n_iter
        np.testing.assert_allclose(there.effective_rows, here.effective_rows, rtol=1e-5)


def function(method, case, problem=None):
    if problem is None:
        return known_function(method, case)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return function_cases(method)[case].fit(problem)


@cache
def known_function(method, case):
    return function(method, case, written())


@pytest.mark.parametrize("method", FUNCTIONS)
@settings(some, max_examples=2)
@given(length=lengths, force=forces, command=commands)
def test_every_transfer_function_is_the_same_in_other_units(method, length, force, command):
    units = {"q": length, "q_ref": length, "dq": length, "nu": command, "tau": force}
    problem = written(length, force, command)
    for case, estimator in enumerate(function_cases(method)[: 1 if method == "rivbj" else 3]):
        here, there = function(method, case), function(method, case, problem)
        gain = units[estimator.output] / units[estimator.input]
        np.testing.assert_allclose(there.A, here.A, rtol=1e-6, atol=1e-9 * np.abs(here.A).max())
        np.testing.assert_allclose(there.B, here.B * gain, rtol=1e-6)
        assert there.relative_error == pytest.approx(here.relative_error, rel=1e-6)
        assert there.yic == pytest.approx(here.yic, abs=1e-4)
        assert (there.n_iter, there.converged) == (here.n_iter, here.converged)


@some
@given(length=lengths, force=forces, command=commands)
def test_the_order_of_structures_is_the_same_in_other_units(length, force, command):
    orders = []
    for problem in (written(), written(length, force, command)):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            found = search_structures(problem, iv.SRIVC(input="nu", output="dq", zeros=0),
                                      poles=(1, 2), zeros=(0,), integrators=(0,))  # fmt: skip
        orders.append([(fit.estimator.poles, fit.estimator.zeros) for fit in found.results])
    assert orders[0] == orders[1]


@some
@given(length=lengths, force=forces, command=commands)
def test_a_friction_curve_is_the_same_in_other_units(length, force, command):
    here = StateDependentFriction().fit(written())
    there = StateDependentFriction().fit(written(length, force, command))
    np.testing.assert_allclose(there.velocity, here.velocity * length, rtol=1e-8)
    np.testing.assert_allclose(there.force, here.force * force, rtol=1e-6)
    np.testing.assert_allclose(there.std_error, here.std_error * force, rtol=1e-5)
    assert there.n_passes == here.n_passes


@some
@given(length=lengths, force=forces, command=commands)
def test_a_drive_gain_is_the_same_in_other_units(length, force, command):
    def gain(*units):
        mass = 30.0 * (units[1] / units[0] if units else 1.0)
        return drive_gain(written(*units), written(*units, load=30.0), mass)

    here, there = gain(), gain(length, force, command)
    assert there.gain == pytest.approx(here.gain * force / command, rel=1e-6)
    assert there.std_error == pytest.approx(here.std_error * force / command, rel=1e-5)


@some
@given(length=lengths, force=forces, command=commands)
def test_a_feasible_set_is_the_same_in_other_units(length, force, command):
    here = SetMembership().feasible_set(written())
    there = SetMembership().feasible_set(written(length, force, command))
    scale = np.array([factor(name, length, force) for name in here.names])
    assert there.smallest == pytest.approx(here.smallest, rel=1e-6)
    assert there.radius == pytest.approx(here.radius * force, rel=1e-5)
    width = (here.upper - here.lower).to_numpy()
    corners = [(found.vertices() / s - here.centre.to_numpy()) / width
               for found, s in ((here, 1.0), (there, scale))]  # fmt: skip
    assert len(corners[0]) == len(corners[1]) > len(scale)
    np.testing.assert_allclose(np.sort(corners[1], axis=0), np.sort(corners[0], axis=0), atol=1e-5)
    narrow = SetMembership(bound=0.5 * here.smallest * here.bound.max() * force)
    assert narrow.feasible_set(written(length, force, command)).empty


@some
@given(length=lengths, force=forces, command=commands)
def test_tests_and_recommendation_are_the_same_in_other_units(length, force, command):
    methods = ("idim-ls", "idim-iv", "idim-bciv")
    here = [fitted(method) for method in methods]
    there = [quietly(method, written(length, force, command)) for method in methods]
    for a, b in zip(here, there, strict=True):
        others = inference.all_tests(b)
        for name, test in inference.all_tests(a).items():
            assert others[name].applies == test.applies, name
            if test.statistic is not None:
                assert others[name].statistic == pytest.approx(test.statistic, rel=1e-4), name
    first, second = (compare(fits).recommendation for fits in (here, there))
    assert first == second
    here, there = here[1], there[1]
    ends = here.anderson_rubin_set()
    scale = [factor(name, length, force) for name in ends.index]
    ends = ends.mul(scale, axis=0)
    np.testing.assert_allclose(there.anderson_rubin_set(), ends, rtol=1e-4)
