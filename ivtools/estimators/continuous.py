"""Continuous-time filtering of sampled signals: what the transfer-function methods are made of."""

# Compiled functions carry no annotations: Numba infers them, and mypy cannot see through it.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from __future__ import annotations

from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.signal import cont2discrete

Array = NDArray[np.float64]
Hold = Literal["zoh", "foh"]


def reflect(A: ArrayLike, least: float = 0.0) -> Array:
    """Return the polynomial with its unstable roots mirrored into the left half-plane.

    Parameters
    ----------
    A : (n + 1,) array_like
        Coefficients, highest power first.
    least : float
        Real parts are at most -`least`, rad/s.

    Examples
    --------
    >>> reflect([1.0, -2.0]).tolist()
    [1.0, 2.0]
    """
    A = np.asarray(A, dtype=float)
    roots = np.roots(A)
    stable = -np.maximum(np.abs(roots.real), least) + 1j * roots.imag
    return np.real(np.atleast_1d(np.poly(stable))) * A[0]


def derivatives(x: ArrayLike, A: ArrayLike, dt: float, hold: Hold = "foh") -> Array:
    """Filter a signal by s^i / A(s), i = 0 ... n, from rest.

    Parameters
    ----------
    x : (n_samples,) array_like
        Signal.
    A : (n + 1,) array_like
        Monic polynomial, highest power first.
    dt : float
        Sampling step, s.
    hold : {"foh", "zoh"}
        How the signal runs between samples: straight, or held.

    Returns
    -------
    (n_samples, n + 1) ndarray
        Column i belongs to s^i.

    References
    ----------
    H. Garnier, L. Wang (eds.), *Identification of Continuous-time Models from Sampled Data*,
    Springer, 2008, ch. 4.

    Examples
    --------
    >>> columns = derivatives(np.ones(2000), [1.0, 10.0], 0.01)
    >>> columns[-1].round(6).tolist()
    [0.1, 0.0]
    """
    x, A = np.asarray(x, dtype=float), np.asarray(A, dtype=float)
    n = len(A) - 1
    if n == 0:
        return x[:, None].copy()
    F, G = np.eye(n, k=1), np.eye(n)[:, -1:]  # states are s^0 ... s^(n-1) of x / A
    F[-1] = -A[:0:-1]
    scale = max(float(np.abs(np.roots(A)).max()), 1e-12) ** np.arange(n)  # of like size
    F, G = F * scale / scale[:, None], G / scale[:, None]
    Ad, Bd, _, Dd, _ = cont2discrete((F, G, np.eye(n), np.zeros((n, 1))), dt, method=hold)
    start = -Dd[:, 0] * x[0]  # at rest: a straight input enters the state of this form at once
    states = _march(np.ascontiguousarray(Ad), np.ascontiguousarray(Bd[:, 0]), x, start)
    states += x[:, None] * Dd[:, 0]
    states *= scale
    top = x - states @ A[:0:-1]
    return np.column_stack([states, top])


def respond(B: ArrayLike, A: ArrayLike, u: ArrayLike, dt: float, hold: Hold = "zoh") -> Array:
    """Return the response (n_samples,) of B(s)/A(s) from rest.

    Examples
    --------
    >>> respond([2.0], [1.0, 1.0], np.ones(5000), 0.01)[-1].round(6)
    np.float64(2.0)
    """
    B = np.atleast_1d(np.asarray(B, dtype=float))
    columns = derivatives(u, A, dt, hold)
    return np.asarray(columns[:, : len(B)] @ B[::-1])


def close_loop(
    B: ArrayLike,
    A: ArrayLike,
    gains: Array,
    taps: Array,
    delay: int,
    q_ref: Array,
    dq_ref: Array,
    dt: float,
) -> tuple[Array, Array]:
    """Return output and command (n_samples,) of B(s)/A(s) under a digital linear controller.

    ``nu = gains @ (q_ref, dq_ref) + taps @ (q[k], q[k-1], ...)``, `delay` samples late; without
    noise, so both signals come from the reference alone.

    Examples
    --------
    >>> r = np.ones(2000)
    >>> q, nu = close_loop([1.0], [1.0, 0.0], np.array([5.0, 0.0]), np.array([-5.0]), 0, r,
    ...                    np.zeros(2000), 0.01)
    >>> q[-1].round(6), abs(nu[-1]) < 1e-6
    (np.float64(1.0), np.True_)
    """
    B, A = np.atleast_1d(np.asarray(B, dtype=float)), np.asarray(A, dtype=float)
    n = len(A) - 1
    F, G = np.eye(n, k=1), np.eye(n)[:, -1:]
    F[-1] = -A[:0:-1]
    C = np.zeros((1, n))
    C[0, : len(B)] = B[::-1]
    Ad, Bd, _, _, _ = cont2discrete((F, G, C, np.zeros((1, 1))), dt, method="zoh")
    law = gains[0] * q_ref + gains[1] * dq_ref
    matrices = (np.ascontiguousarray(M) for M in (Ad, Bd[:, 0], C[0]))
    return _march_loop(*matrices, law, np.ascontiguousarray(taps), delay)


@njit(cache=True, nogil=True)
def _march(A, b, u, start):
    """States (n_samples, n) of x[k+1] = A x[k] + b u[k]."""
    n = b.size
    out, x, new = np.zeros((u.size, n)), start.copy(), np.zeros(n)
    for k in range(u.size):
        out[k] = x
        for i in range(n):
            new[i] = b[i] * u[k]
            for j in range(n):
                new[i] += A[i, j] * x[j]
        x[:] = new
    return out


@njit(cache=True, nogil=True)
def _march_loop(A, b, c, law, taps, delay):
    """Output and command of a sampled plant under a linear law."""
    n, samples = b.size, law.size
    q, nu, x, new = np.zeros(samples), np.zeros(samples), np.zeros(n), np.zeros(n)
    wanted = np.zeros(samples)
    for k in range(samples):
        for i in range(n):
            q[k] += c[i] * x[i]
        wanted[k] = law[k]
        for i in range(min(taps.size, k + 1)):
            wanted[k] += taps[i] * q[k - i]
        if k >= delay:
            nu[k] = wanted[k - delay]
        for i in range(n):
            new[i] = b[i] * nu[k]
            for j in range(n):
                new[i] += A[i, j] * x[j]
        x[:] = new
    return q, nu
