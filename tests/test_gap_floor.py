"""The floor: what the noise of a record is, wherever it enters the loop."""

import numpy as np
import pytest
from scipy import signal

import ivtools as iv
from benchmarks import moves
from ivtools.gap.floor import autoregression
from ivtools.linalg import fir
from ivtools.record import Record

THETA = {"inertia": 95.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}


def after(x, lag):
    """Return the correlation of a signal with itself so many samples later."""
    return float(x[lag:] @ x[:-lag] / (x @ x))


@pytest.mark.parametrize("corner", [0.02, 0.05, 0.2])
def test_noise_that_came_through_a_loop_becomes_white(corner):
    """Hardly any of it is fast, and of its windows only some are quiet."""
    rng = np.random.default_rng(1)
    x = signal.lfilter(*signal.butter(2, corner), rng.standard_normal(20_000))
    mask = np.repeat(rng.random(200) < 0.7, 100)
    white = fir(autoregression(x, mask, 0.0), x)[100:]
    assert abs(after(x, 1)) > 0.8
    assert max(abs(after(white, lag)) for lag in (1, 2, 5, 10, 40)) < 0.1


@pytest.mark.parametrize("size", [0.3, 3.0])
def test_noise_of_the_force_alone_is_no_gap(size):
    """No sensor of this axis has any: all that is in the command came through the loop."""
    loop, found, true = iv.axes.emps(), [], []
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        q_ref = moves.reference(rng, 16.0)
        asked = Record(np.arange(len(q_ref)) * moves.DT, q_ref, q_ref=q_ref, nu=q_ref)
        noise = rng.normal(0.0, size, len(q_ref))
        ran, quiet = (
            loop.simulate(asked, THETA, initial="rest", force_noise=f) for f in (noise, 0.0 * noise)
        )
        found.append(Record(asked.t, ran.q, q_ref=q_ref, nu=ran.nu))
        true.append(loop.gain * float(np.std(ran.nu - quiet.nu)))
    gap = iv.diagnose(found[0], loop, found[1])
    assert gap.verdict == "adequate"
    assert [f.noise for f in gap.floors] == pytest.approx(true, rel=0.2)
