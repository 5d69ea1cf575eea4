"""Every kind of controller, and all that surrounds a law, in both engines."""

from dataclasses import replace

import control
import numpy as np
import pytest

from benchmarks import populations
from ivtools.loop.controllers import Seen
from ivtools.loop.system import initial_state


def python_control(loop, theta, record):
    """The same simulation by python-control, from rest at 0."""
    system = loop.system(theta, dt=record.dt)
    command = np.zeros((record.n_samples, 1))
    seen = Seen.of(loop.controller, record, command, loop.joint).inputs
    added = np.zeros(record.n_samples) if record.added is None else record.added[:, 0]
    inputs = [seen[:, 0], seen[:, 1], added, *([seen[:, 2]] if system.ninputs == 4 else [])]
    state = initial_state(loop, loop.values(theta), record.dt, 0.0, 0.0)
    times = np.arange(record.n_samples) * record.dt
    return control.input_output_response(system, times, np.array(inputs), state)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("kind", populations.KINDS)
def test_both_engines_are_the_same(kind, seed):
    rng = np.random.default_rng([seed, len(kind), ord(kind[-1])])
    joint = ("prismatic", "revolute")[seed % 2]
    loop, theta, stroke = populations.axis(rng, joint)
    hz = 10 ** rng.uniform(2.0, 3.9)
    record = populations.reference(rng, 300, hz, stroke, {"strain": rng.normal(size=300)})
    force = theta["coulomb"]
    plain = populations.controller(rng, kind, theta["inertia"], hz)
    law = populations.surrounded(rng, plain, hz)
    law = replace(
        law,
        feedforward={
            "acceleration": 0.5 * theta["inertia"],
            "coulomb": 0.3 * force,
            "gravity": 0.1 * force,
        },
        feedback={"strain": 0.05 * force},
    )
    loop = replace(loop, controller=populations.scaled(law, loop.gain))
    whole = loop.simulate(record, theta, initial=(0.0, 0.0))
    top = 0.6 * float(np.abs(whole.nu).max())  # so that the limit and its anti-windup act
    for limit in (np.inf, top):
        bound = replace(loop, controller=replace(loop.controller, limit=limit))
        ours = bound.simulate(record, theta, initial=(0.0, 0.0))
        theirs = python_control(bound, theta, record)
        assert np.isfinite(ours.nu).all()
        for name in ("q", "nu"):
            a, b = getattr(ours, name)[:, 0], theirs.outputs[theirs.output_labels.index(name)]
            assert np.max(np.abs(a - b)) <= 1e-9 * np.max(np.abs(b)), (name, limit)
