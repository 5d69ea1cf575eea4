"""A simulated axis that shares no code with the toolkit.

Another integrator (semi-implicit Euler, 20 steps per sample, with dry friction by Karnopp's rule),
other functional forms of the effects, other noise. `NAMES` says what the plant can do.
"""

import numpy as np
from numba import njit

# What the plant can do, by index in the parameter vector
NAMES = (
    "m",
    "fv",
    "fc",
    "off",
    "asym",  # extra viscous friction in one direction only
    "str_f",
    "str_v",  # Stribeck: Tustin's exponential of |v|, not of v^2
    "pre_s",  # Dahl friction, exponent 1, integrated implicitly
    "quad",
    "cube",
    "root",  # |v|^0.5, softened below a tiny speed
    "pf_amp",
    "pf_len",
    "pf_ph",  # friction over position: half a cosine wave
    "load",  # friction proportional to the transmitted force
    "fd_c",
    "fd_v",
    "fd_tau",  # warming-up: exponential in time
    "od_a",
    "od_tau",  # offset: exponential in time
    "sp_amp",
    "sp_len",
    "sp_ph",  # static force over position: half a sine wave
    "cog_a",
    "cog_p",
    "cog_ph",
    "cog_2",  # cogging with a second harmonic
    "rip_a",
    "rip_p",
    "rip_ph",
    "flex_hz",
    "flex_z",
    "flex_r",
    "flex_fr",
    "gap",
    "gap_hz",
    "gap_z",
    "lag",
    "delay",
    "drv_asym",
    "dead",
    "enc_a",
    "enc_p",
    "enc_ph",
)
INDEX = {n: i for i, n in enumerate(NAMES)}


@njit(cache=True)
def _friction(v, q, t, tau, p):
    """Return the viscous-like force and the Coulomb level at a point, N."""
    s = 1.0 if v > 0 else (-1.0 if v < 0 else 0.0)
    a = abs(v)
    warm = 1.0 - np.exp(-t / p[17]) if p[17] > 0.0 else 0.0
    smooth = p[1] * v + (p[4] * a if v > 0.0 else 0.0) + p[8] * a * v + p[9] * v * v * v
    smooth += p[10] * s * (np.sqrt(a + 1e-6) - 1e-3) + p[16] * warm * v
    level = p[2] + p[14] * abs(tau) + p[15] * warm
    if p[5] != 0.0:
        level += p[5] * np.exp(-a / p[6])
    if p[11] != 0.0:
        level += p[11] * np.cos(np.pi * q / p[12] + p[13])
    return smooth, max(level, 0.0)


@njit(cache=True)
def _static(q, t, p):
    """Return the force that depends on place and time alone, N."""
    f = p[3]
    if p[18] != 0.0:
        f += p[18] * (1.0 - np.exp(-t / p[19]))
    if p[20] != 0.0:
        f += p[20] * np.sin(np.pi * q / p[21] + p[22])
    if p[23] != 0.0:
        w = 2.0 * np.pi * q / p[24] + p[25]
        f += p[23] * (np.cos(w) + p[26] * np.cos(2.0 * w))
    return f


@njit(cache=True)
def _stick(v, drive, level, m, h):
    """Move one velocity under a force and dry friction; Karnopp: inside a band it may stick."""
    vn = v + h * drive / m
    grip = h * level / m
    if vn > grip:
        return vn - grip
    if vn < -grip:
        return vn + grip
    return 0.0


@njit(cache=True)
def _masses(p):
    """Return both masses, kg, stiffness and damping between them, and the load's friction share."""
    if not (p[30] > 0.0 or p[34] > 0.0):
        return p[0], 1.0, 0.0, 0.0, 0.0
    r = p[32]
    m1, m2 = p[0] * (1 - r), p[0] * r
    mu = m1 * m2 / p[0]
    hz = p[30] if p[30] > 0.0 else p[35]
    z = p[31] if p[30] > 0.0 else p[36]
    k = mu * (2 * np.pi * hz) ** 2
    return m1, m2, k, 2 * z * np.sqrt(k * mu), p[33]


@njit(cache=True)
def _encoder(q, noise, quantum, p):
    """Return what the encoder reports, m."""
    e = q
    if p[41] != 0.0:
        e += p[41] * np.cos(2 * np.pi * q / p[42] + p[43])
    e += noise
    return np.round(e / quantum) * quantum if quantum > 0.0 else e


@njit(cache=True)
def _pushed(line, value, first):
    """Shift a value into a delay line; the first one fills it."""
    for j in range(len(line) - 1, 0, -1):
        line[j] = value if first else line[j - 1]
    line[0] = value


POLE = 0.3  # of the state-space law's low-pass


@njit(cache=True)
def _law(law, kp, kv, more, taps, past, dt, ref, dref, ddref, total, limit):
    """Return the command of the control law, V, and the integral so far.

    0 is a cascade, 1 pd, 2 pid, 3 a servo of P position and PI velocity, 4 its velocity loop, 5 a
    proportional one, 6 a pd on the error whose derivative passes a low-pass of the pole `POLE`, 7 a
    cascade of which nothing is told. `more` has the integral gain, the weight of the velocity
    reference and the feed-forward of the acceleration. The integral stands while the command is
    beyond its limit.
    """
    ki, c, ahead = more
    vel = 0.0
    for j in range(len(taps)):
        vel += taps[j] * (past[j] - past[j + 1]) / dt
    e = ref - past[0]
    if law == 0 or law == 7:
        return kv * (kp * e - vel) + ahead * ddref, total
    if law == 6:
        steep = kv * (1.0 - POLE) / dt
        return (kp + steep) * e - steep * (1.0 - POLE) * total, POLE * total + e
    if law == 1:
        return kp * e + kv * (c * dref - vel) + ahead * ddref, total
    if law == 5:
        return kv * (c * dref - vel) + ahead * ddref, total
    if law == 2:
        new = total + ki * dt * e
        u = kp * e + kv * (c * dref - vel) + new + ahead * ddref
    else:
        ev = (kp * e if law == 3 else 0.0) + c * dref - vel
        new = total + ki * dt * ev
        u = kv * (ev + new) + ahead * ddref
    return u, (total if abs(u) > limit and u * (new - total) > 0.0 else new)


@njit(cache=True, inline="always")
def _drive(tau, q, p):
    """Return the force behind the drive's asymmetry, dead zone and ripple, N."""
    if p[39] != 0.0:
        tau *= 1.0 + p[39] * (1.0 if tau > 0 else -1.0)
    if p[40] > 0.0:
        tau = tau - p[40] if tau > p[40] else (tau + p[40] if tau < -p[40] else 0.0)
    if p[27] != 0.0:
        tau *= 1.0 + p[27] * np.cos(2 * np.pi * q / p[28] + p[29])
    return tau


@njit(cache=True)
def _link(d, w, k, c, gap):
    """Return the force between the masses, N, at a distance d, m, and speed w apart, m/s."""
    g = 0.5 * gap
    if not g > 0.0:
        return k * d + c * w
    f = k * (d - g) + c * w if d > g else (k * (d + g) + c * w if d < -g else 0.0)
    return 0.0 if (d > g and f < 0.0) or (d < -g and f > 0.0) else f


@njit(cache=True, inline="always")
def _move(x, tau, outside, t, h, masses, p):
    """Return the state (q1, v1, q2, v2, bristle) a step later."""
    q1, v1, q2, v2, z = x
    m1, m2, k, c, share = masses
    smooth, level = _friction(v1, q1, t, tau, p)
    drive = tau + outside - (1 - share) * smooth - _static(q1, t, p)
    if p[7] > 0.0:  # Dahl
        z += h * (v1 - abs(v1) * p[7] * z / max(level, 1e-12))
        drive -= p[7] * z
        level = 0.0
    if k > 0.0:
        f = _link(q1 - q2, v1 - v2, k, c, p[34])
        smooth2, level2 = _friction(v2, q2, t, tau, p)
        v1 = _stick(v1, drive - f, (1 - share) * level, m1, h)
        v2 = _stick(v2, f - share * smooth2, share * level2, m2, h)
        q2 += h * v2
    else:
        v1 = _stick(v1, drive, level, m1, h)
    return q1 + h * v1, v1, q2, v2, z


@njit(cache=True)
def run(
    dt,
    sub,
    q_ref,
    dq_ref,
    ddq_ref,
    added,
    kp,
    kv,
    more,
    taps,
    law,
    cdelay,
    limit,
    gain,
    p,
    force,
    noise,
    quantum,
    q0,
    out,
):
    """Fill out (3, n) with encoder position, m, command, V, and true position, m.

    `law` is 0 for a cascade (position gain kp, 1/s, velocity gain kv, V/(m/s)), 1 for pd (kp in
    V/m), and so on as in `_law`, with `more` of its settings. The command is held over a sample of
    dt, s, which takes `sub` steps.
    """
    h = dt / sub
    masses = _masses(p)
    x, lagged, at = (q0, dq_ref[0], q0, dq_ref[0], 0.0), 0.0, 0
    past, line = np.full(len(taps) + 1, q0), np.zeros(cdelay + 1)
    buffer, total = np.zeros(int(round(p[38] / h)) + 1), 0.0
    for i in range(len(q_ref)):
        e = _encoder(x[0], noise[i], quantum, p)
        _pushed(past, e, False)
        if i == 0:
            for j in range(len(past)):
                past[j] = e - j * dt * dq_ref[0]
        wanted, total = _law(
            law, kp, kv, more, taps, past, dt, q_ref[i], dq_ref[i], ddq_ref[i], total, limit
        )
        _pushed(line, wanted, i == 0)
        u = min(max(line[cdelay], -limit), limit) + added[i]
        out[0, i], out[1, i], out[2, i] = e, u, x[0]
        for s in range(sub):
            buffer[at] = gain * u
            at = at + 1 if at + 1 < len(buffer) else 0
            lagged = lagged + h / p[37] * (buffer[at] - lagged) if p[37] > 0.0 else buffer[at]
            tau = _drive(lagged, x[0], p)
            x = _move(x, tau, force[i], (i + s / sub) * dt, h, masses, p)
        if not np.isfinite(x[0]):
            break
