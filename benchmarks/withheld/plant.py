"""A simulated axis that shares no code with the toolkit.

Another integrator (semi-implicit Euler at 20 kHz or more, with friction by Karnopp's rule inside a
velocity band), other functional forms of the effects, other noise. Dimensionless: the generator
scales length, mass and time afterwards.
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
    """Return the viscous-like force and the Coulomb level at a point."""
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
def run(
    dt,
    sub,
    q_ref,
    dq_ref,
    added,
    kp,
    kv,
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
    """Fill out (3, n) with encoder position, command and true position.

    `law` is 0 for a cascade (position gain kp, velocity gain kv) and 1 for pd.
    """
    n = len(q_ref)
    h = dt / sub
    two = p[30] > 0.0 or p[34] > 0.0
    m1, m2, k, c, share = p[0], 1.0, 0.0, 0.0, 0.0
    if two:
        r = p[32]
        share = p[33]
        m1, m2 = p[0] * (1 - r), p[0] * r
        mu = m1 * m2 / p[0]
        hz = p[30] if p[30] > 0.0 else p[35]
        z = p[31] if p[30] > 0.0 else p[36]
        k = mu * (2 * np.pi * hz) ** 2
        c = 2 * z * np.sqrt(k * mu)
    q1, v1, q2, v2, zz, fdrive = q0, dq_ref[0], q0, dq_ref[0], 0.0, 0.0
    past = np.full(len(taps) + 1, q0)
    line = np.zeros(cdelay + 1)
    dsteps = int(round(p[38] / h))
    buf = np.zeros(dsteps + 1)
    at = 0
    for i in range(n):
        e = q1
        if p[41] != 0.0:
            e += p[41] * np.cos(2 * np.pi * q1 / p[42] + p[43])
        e += noise[i]
        if quantum > 0.0:
            e = np.round(e / quantum) * quantum
        for j in range(len(past) - 1, 0, -1):
            past[j] = past[j - 1]
        past[0] = e
        if i == 0:
            for j in range(len(past)):
                past[j] = e - j * dt * dq_ref[0]
        vel = 0.0
        for j in range(len(taps)):
            vel += taps[j] * (past[j] - past[j + 1]) / dt
        if law == 0:
            u = kv * (kp * (q_ref[i] - e) - vel)
        else:
            u = kp * (q_ref[i] - e) + kv * (dq_ref[i] - vel)
        for j in range(cdelay, 0, -1):
            line[j] = line[j - 1]
        line[0] = u
        if i == 0:
            for j in range(cdelay + 1):
                line[j] = u
        u = min(max(line[cdelay], -limit), limit) + added[i]
        out[0, i], out[1, i], out[2, i] = e, u, q1
        for s in range(sub):
            t = (i + s / sub) * dt
            buf[at] = gain * u
            at = (at + 1) % (dsteps + 1)
            cmd = buf[at]
            if p[37] > 0.0:
                fdrive += h / p[37] * (cmd - fdrive)
            else:
                fdrive = cmd
            tau = fdrive
            if p[39] != 0.0:
                tau *= 1.0 + p[39] * (1.0 if tau > 0 else -1.0)
            if p[40] > 0.0:
                tau = tau - p[40] if tau > p[40] else (tau + p[40] if tau < -p[40] else 0.0)
            if p[27] != 0.0:
                tau *= 1.0 + p[27] * np.cos(2 * np.pi * q1 / p[28] + p[29])
            smooth, level = _friction(v1, q1, t, tau, p)
            drive = tau + force[i] - (1 - share) * smooth - _static(q1, t, p)
            if p[7] > 0.0:  # Dahl
                zz += h * (v1 - abs(v1) * p[7] * zz / max(level, 1e-12))
                drive -= p[7] * zz
                level = 0.0
            if two:
                d, w = q1 - q2, v1 - v2
                g = 0.5 * p[34]
                if g > 0.0:
                    f = k * (d - g) + c * w if d > g else (k * (d + g) + c * w if d < -g else 0.0)
                    if (d > g and f < 0.0) or (d < -g and f > 0.0):
                        f = 0.0
                else:
                    f = k * d + c * w
                smooth2, level2 = _friction(v2, q2, t, tau, p)
                v1 = _stick(v1, drive - f, (1 - share) * level, m1, h)
                v2 = _stick(v2, f - share * smooth2, share * level2, m2, h)
                q2 += h * v2
            else:
                v1 = _stick(v1, drive, level, m1, h)
            q1 += h * v1
        if not np.isfinite(q1):
            break
