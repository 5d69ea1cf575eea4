"""Position and velocity controllers in state-space form, inputs (q_ref, q), for any axis."""

from __future__ import annotations

import numpy as np
from scipy.signal import place_poles

from ivtools.loop import Controller


def p_pi(kp: float, kv: float, ki: float, dt: float, **common: object) -> Controller:
    """Return nu = kv (ev + I), I[k] = I[k-1] + ki dt ev[k], ev = kp e + dq_ref - dq.

    With kp = 0 it is a PI velocity loop. States: q and q_ref of the last sample, I.
    """
    ev_x = np.array([1.0 / dt, -1.0 / dt, 0.0])
    ev_u = np.array([kp + 1.0 / dt, -kp - 1.0 / dt])
    A = np.vstack([np.zeros((2, 3)), ki * dt * ev_x + [0.0, 0.0, 1.0]])
    B = np.vstack([[0.0, 1.0], [1.0, 0.0], ki * dt * ev_u])
    C, D = kv * (ev_x + A[2]), kv * (ev_u + B[2])
    return _state_space(A, B, C, D, common)


def state_feedback(
    inertia: float, viscous: float, gain: float, hz: float, dt: float, **common: object
) -> Controller:
    """Return nu = -K (x - (q_ref, 0)), x from an observer of the rigid axis four times as fast."""
    rate = viscous / inertia
    decay = np.exp(-rate * dt)
    reach = -np.expm1(-rate * dt) / rate if rate else dt
    drop = (dt - reach) / rate if rate else 0.5 * dt**2
    A = np.array([[1.0, reach], [0.0, decay]])
    B = gain / inertia * np.array([[drop], [reach]])
    C = np.array([[1.0, 0.0]])
    K = place_poles(A, B, _poles(hz, dt)).gain_matrix
    L = place_poles(A.T, C.T, _poles(4.0 * hz, dt)).gain_matrix.T
    N = K[0, 0]
    return _state_space(A - B @ K - L @ C, np.hstack([B * N, L]), -K[0], [N, 0.0], common)


def _poles(hz: float, dt: float) -> np.ndarray:
    s = 2.0 * np.pi * hz * np.array([-0.8 + 0.6j, -0.8 - 0.6j])
    return np.exp(s * dt)


def _state_space(A, B, C, D, common) -> Controller:
    matrices = {k: np.atleast_2d(m).tolist() for k, m in zip("ABCD", (A, B, C, D), strict=True)}
    return Controller("state-space", matrices, **common)
