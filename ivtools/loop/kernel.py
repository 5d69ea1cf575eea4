"""The compiled twin of the closed loop.

Controller, drive, mechanics and sensor in one compiled loop over the samples. The python-control
model of the loop calls the same `plant_step`, so that both engines are the same functions.
"""

# Compiled functions carry no annotations: Numba infers them, and mypy cannot see through it.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from __future__ import annotations

import numpy as np
from numba import boolean, float64, from_dtype, int64, types, void

from ..compiled import cached, compiled
from ..limits import LARGEST
from ..physics.sensor import encoder
from .integrator import drive_delay, heavier, plan, plant_step, rigid_step
from .mechanics import FLAGS, PARAMETERS, SCALAR_LAW, held_link, with_swing
from .steps import laden, spread

_AS_HEAVY = 1e-12  # of the inertia: a link that varies by less is as heavy in every pose


@compiled
def measure(q, noise, quantum, p, on):
    """Return the position that the encoder reports, m or rad."""
    if on["encoder-eccentricity"]:
        q = -p["apart"] + encoder(
            q + p["apart"],
            p["encoder-eccentricity.cosine"],
            p["encoder-eccentricity.sine"],
            p["encoder-eccentricity.period"],
        )
    q += noise
    return np.floor(q / quantum + 0.5) * quantum if quantum > 0.0 else q


@compiled
def _fill_before(seen, law, sent, past, delay, whole, first, q, v, dt, p, on):
    """Fill in what the controller had seen and sent before the record."""
    for i in range(past):
        seen[i] = measure(q - (past - i) * dt * v, 0.0, 0.0, p, on)
    for i in range(delay):
        law[i] = first[i]
    for i in range(whole + 1):
        sent[i] = first[delay]


@compiled
def move_on(inner, following, known, a_matrix, b_matrix, c_row, q, speed, excess, back, hold):
    """Move the controller's own states over one sample; `excess` is what the limit cut off."""
    for i in range(inner.size):
        following[i] = known[i] + b_matrix[i, 0] * q + b_matrix[i, 1] * speed
        for j in range(inner.size):
            following[i] += a_matrix[i, j] * inner[j]
        following[i] -= back[i] * excess
        if hold[i] and excess * c_row[i] * (following[i] - inner[i]) > 0.0:
            following[i] = inner[i]
    for i in range(inner.size):
        inner[i] = following[i]


_VECTOR = types.Array(float64, 1, "C", readonly=True)
_MATRIX = types.Array(float64, 2, "C", readonly=True)


@cached(
    void(
        float64,
        int64,
        _VECTOR,
        _VECTOR,
        boolean,
        _VECTOR,
        _VECTOR,
        _VECTOR,
        _VECTOR,
        _VECTOR,
        float64,
        _VECTOR,
        _VECTOR,
        boolean,
        _MATRIX,
        _MATRIX,
        _MATRIX,
        _VECTOR,
        _VECTOR,
        types.Array(boolean, 1, "C", readonly=True),
        float64[::1],
        int64,
        float64,
        float64,
        float64,
        float64,
        float64[::1],
        from_dtype(PARAMETERS),
        from_dtype(FLAGS),
        types.FunctionType(SCALAR_LAW),
        float64[:, ::1],
    )
)
def run(
    dt,
    n,
    known,
    added,
    ramp,
    place,
    position_noise,
    force_noise,
    load,
    swing,
    quantum,
    gains,
    taps,
    sensed,
    known_inner,
    a_matrix,
    b_matrix,
    c_row,
    back,
    hold,
    inner,
    delay,
    limit,
    q_start,
    v_start,
    a_start,
    first,
    p,
    on,
    user,
    out,
):
    """Simulate the closed loop; fill out with the rows q, dq, ddq, nu.

    The law is a `controllers.LinearLaw`: `known` (n_samples,) and `known_inner` (n_samples, n) are
    what its known inputs add to the command and to its states, `gains` and `b_matrix` belong to
    the measured position and velocity, made of positions or `sensed`, and `inner` is its state.
    `first` holds the commands, added inputs excluded, that precede the law's own: `delay` of them,
    then the one before the record. What is `added` to the command, (n_samples,), may be empty.
    Forces that depend on the position act at `place`, (n_samples,), if that is not. Of two masses a
    known `load` pulls at the second one, which begins where that holds it, and a disturbance at the
    first. The second, or the only one, has `swing` more inertia, if that is not empty: what its
    velocity asks where that grows is in the load with the velocity of the first.
    """
    samples, past = known.size, taps.size - 1
    whole, planned = drive_delay(dt, p, on)[0], plan(dt, n, p, on)
    seen, law = np.empty(past + samples), np.empty(delay + samples)
    sent, following = np.empty(whole + 1 + samples), np.empty(inner.size)
    p["apart"] = place[0] - q_start if place.size else 0.0
    _fill_before(seen, law, sent, past, delay, whole, first, q_start, v_start, dt, p, on)
    q, v, force, gain = q_start, v_start, p["gain"] * first[delay], p["gain"]
    x, rigid, pace, shift = (q, v, q, v, 0.0), not on["effects"], planned[1], p["shift"]
    mean, single = p["load"], p["inertia"]
    heavy = swing.size > 0 and max(np.max(swing), -np.min(swing)) > _AS_HEAVY * single
    on["turns"] = heavy and not on["two"]
    if heavy and on["two"]:
        least, most = with_swing(mean, np.min(swing)), with_swing(mean, np.max(swing))
        spread(least, most, max(planned[0].h, planned[1].h), p)
        laden(with_swing(mean, swing[0]), p)
    if load.size and on["two"]:
        x = (q, v, held_link(q, v, a_start, load[0], p, on, user), v, 0.0)
    for k in range(samples):
        if place.size:
            p["apart"] = place[k] - q
        noise = position_noise[k] if position_noise.size else 0.0
        seen[past + k] = out[0, k] = measure(q, noise, quantum, p, on)
        out[1, k] = v
        speed = v if sensed else 0.0
        for i in range(0 if sensed else taps.size):
            speed += taps[i] * seen[past + k - i]
        value = known[k] + gains[0] * out[0, k] + gains[1] * speed
        for i in range(inner.size):
            value += c_row[i] * inner[i]
        if inner.size:
            excess = value - min(max(value, -limit), limit)
            move_on(
                inner, following, known_inner[k], a_matrix, b_matrix, c_row,
                out[0, k], speed, excess, back, hold,
            )  # fmt: skip
        law[delay + k] = value
        sent[whole + 1 + k] = out[3, k] = min(max(law[k], -limit), limit)
        if added.size:
            sent[whole + 1 + k] = out[3, k] = out[3, k] + added[k]
        outside = force_noise[k] if force_noise.size else 0.0
        if load.size:
            pulled = load[k]
            if on["turns"]:
                planned = heavier(with_swing(single, swing[k]), planned, dt, n, p, on)
                pace = planned[1]
            elif heavy:
                laden(with_swing(mean, swing[k]), p)
                grows = (with_swing(mean, swing[min(k + 1, samples - 1)]) - p["load"]) / dt
                pulled += grows * (x[3] - x[1])
            outside -= pulled
            if on["two"]:
                p["shift"] = shift - pulled
        p["outside"] = outside
        if rigid:
            tau = gain * sent[k + 1] + outside
            q, v, a = rigid_step(q, v, tau, pace, p, on, user)
        else:
            slope = (added[k + 1] - added[k]) / dt if ramp and k + 1 < added.size else 0.0
            x, force, a = plant_step(
                x, force, sent[k], sent[k + 1], slope, outside, k * dt, planned, p, on, user
            )
            q, v = x[0], x[1]
        out[2, k] = a
        if not abs(q) + abs(v) < LARGEST:  # each further step would look for events that are none
            out[:, k:] = np.nan
            return


@cached()
def axis_step(x, force, old, new, t, dt, n, p, on, user):
    """Do as `plant_step`, called from Python: compiled when first used, then cached too."""
    return plant_step(x, force, old, new, 0.0, 0.0, t, plan(dt, n, p, on), p, on, user)
