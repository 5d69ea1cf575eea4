"""Filters of sampled signals by 1/A, in s or in the delta operator, for the transfer functions.

The delta operator (z - 1) / dt is that of a discrete-time model; a filter in it is the one in s
integrated by Euler's rule, exactly. One form therefore serves both.
"""

# Compiled functions carry no annotations: Numba infers them, and mypy cannot see through it.
# mypy: disallow-untyped-defs=False, disallow-untyped-calls=False

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import cont2discrete

from ivtools.loop.controllers.law import MEASURED

from ..compiled import cached

if TYPE_CHECKING:
    from ivtools.loop.controllers import LinearLaw

Array = NDArray[np.float64]
Hold = Literal["zoh", "foh", "euler"]


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


def reflect_delta(A: ArrayLike, dt: float, least: float = 0.0) -> Array:
    """Return the polynomial in delta with its roots outside the unit circle of z mirrored into it.

    Parameters
    ----------
    A : (n + 1,) array_like
        Coefficients, highest power first.
    dt : float
        Sampling step, s.
    least : float
        Every root decays by this at least, 1/s.

    Examples
    --------
    >>> reflect_delta([1.0, -1.0], 0.25).round(6).tolist()  # z = 1.25 becomes 0.8
    [1.0, 0.8]
    """
    A = np.asarray(A, dtype=float)
    z = 1.0 + dt * np.roots(A)
    radius = np.maximum(np.abs(z), 1e-300)
    z = z / radius * np.minimum(np.minimum(radius, 1.0 / radius), np.exp(-least * dt))
    return np.real(np.atleast_1d(np.poly((z - 1.0) / dt))) * A[0]


def exponents(roots: ArrayLike, dt: float, hold: Hold) -> NDArray[np.complex128]:
    """Return the exponents, rad/s, of roots in s, or in delta if the hold is Euler's.

    Examples
    --------
    >>> exponents([-100.0], 1e-3, "euler").real.round(2)
    array([-105.36])
    """
    roots = np.asarray(roots, dtype=complex)
    if hold != "euler":
        return roots
    z = 1.0 + dt * roots
    return np.asarray(np.log(np.where(z == 0.0, 1e-300, z)) / dt)


def derivatives(
    x: ArrayLike, A: ArrayLike, dt: float, hold: Hold = "foh", delay: float = 0.0
) -> Array:
    """Filter a signal by s^i / A(s), i = 0 ... n, from rest; in delta where the hold is Euler's.

    Parameters
    ----------
    x : (n_samples,) array_like
        Signal.
    A : (n + 1,) array_like
        Monic polynomial, highest power first.
    dt : float
        Sampling step, s.
    hold : {"foh", "zoh", "euler"}
        How the signal runs between samples: straight, or held; "euler" reads A in delta.
    delay : float
        Of the signal, s, 0 or more; before its first sample it is taken for that one. A part of a
        step is exact for a held signal, and an interpolation for others.

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
    late, part = _split(delay, dt)
    if part and hold == "zoh" and n:
        return _between(x, A, dt, late, part)
    x = (1.0 - part) * lagged(x, late) + part * lagged(x, late + 1) if delay else x
    if n == 0:
        return x[:, None].copy()
    F, G, scale = _companion(A)
    Ad, Bd, _, Dd, _ = cont2discrete((F, G, np.eye(n), np.zeros((n, 1))), dt, method=hold)
    start = -Dd[:, 0] * x[0]  # at rest: a straight input enters the state of this form at once
    states = _march(np.ascontiguousarray(Ad), np.ascontiguousarray(Bd[:, 0]), x, start)
    states += x[:, None] * Dd[:, 0]
    return _with_top(states * scale, x, A)


def free_response(A: ArrayLike, n_samples: int, dt: float, hold: Hold = "foh") -> Array:
    """Return the responses of s^i / A(s), i = 0 ... n - 1, to an impulse at the first sample.

    Examples
    --------
    >>> free_response([1.0, 10.0], 3, 0.1).ravel().round(4).tolist()
    [1.0, 0.3679, 0.1353]
    """
    A = np.asarray(A, dtype=float)
    F, G, scale = _companion(A)
    n = len(scale)
    held = "zoh" if hold == "foh" else hold
    Ad = cont2discrete((F, G, np.eye(n), np.zeros((n, 1))), dt, method=held)[0]
    nothing, b = np.zeros(n_samples), np.zeros(n)
    return np.asarray(_march(np.ascontiguousarray(Ad), b, nothing, G[:, 0].copy()) * scale)


def lagged(x: Array, samples: int) -> Array:
    """Return a signal some samples late, its first value before it."""
    return np.concatenate([np.full(min(samples, len(x)), x[0]), x])[: len(x)]


def _split(delay: float, dt: float) -> tuple[int, float]:
    """Return whole samples and the part of one in a delay; rounding is no part."""
    late = int(np.floor(delay / dt + 1e-9))
    part = delay / dt - late
    return late, part if part > 1e-9 else 0.0


def _between(x: Array, A: Array, dt: float, late: int, part: float) -> Array:
    """Filter a held signal that changes a part of a step after the samples, as `derivatives`."""
    older, newer = lagged(x, late + 1), lagged(x, late)
    F, G, scale = _companion(A)
    n = len(scale)
    system = F, G, np.eye(n), np.zeros((n, 1))
    (A1, B1), (A2, B2) = (cont2discrete(system, h * dt)[:2] for h in (part, 1.0 - part))
    Ad, rest = np.ascontiguousarray(A2 @ A1), np.zeros(n)
    states = _march(Ad, np.ascontiguousarray((A2 @ B1)[:, 0]), older, rest)
    states += _march(Ad, np.ascontiguousarray(B2[:, 0]), newer, rest)
    return _with_top(states * scale, older, A)


def _companion(A: Array) -> tuple[Array, Array, Array]:
    """Return F, G of states s^0 ... s^(n-1) of x / A over a scale that makes them of like size."""
    n = len(A) - 1
    F, G = np.eye(n, k=1), np.eye(n)[:, -1:]
    F[-1] = -A[:0:-1]
    scale: Array = np.asarray(max(float(np.abs(np.roots(A)).max()), 1e-12) ** np.arange(n), float)
    return F * scale / scale[:, None], G / scale[:, None], scale


def _with_top(states: Array, x: Array, A: Array) -> Array:
    """Return states and s^n of x / A beside them."""
    return np.column_stack([states, x - states @ A[:0:-1]])


def respond(
    B: ArrayLike,
    A: ArrayLike,
    u: ArrayLike,
    dt: float,
    hold: Hold = "zoh",
    delay: float = 0.0,
) -> Array:
    """Return the response (n_samples,) of B(s)/A(s) from rest to an input, so much late.

    Examples
    --------
    >>> respond([2.0], [1.0, 1.0], np.ones(5000), 0.01)[-1].round(6)
    np.float64(2.0)
    """
    B = np.atleast_1d(np.asarray(B, dtype=float))
    columns = derivatives(u, A, dt, hold, delay)
    return np.asarray(columns[:, : len(B)] @ B[::-1])


def close_loop(
    B: ArrayLike,
    A: ArrayLike,
    law: LinearLaw,
    delay: int,
    known: Array,
    dt: float,
    added: Array | None = None,
) -> tuple[Array, Array]:
    """Return output and command (n_samples,) of B(s)/A(s) under a digital linear controller.

    Parameters
    ----------
    B, A : array_like
        The plant, its input held.
    law : LinearLaw
        The controller at the sampling rate, its command `delay` samples late.
    delay : int
    known : (n_samples, 3) ndarray
        What the law knows beforehand: q_ref, dq_ref, feed.
    dt : float
        Sampling step, s.
    added : (n_samples,) ndarray, optional
        Known input added to the command.

    Returns
    -------
    q, nu : (n_samples,) ndarray
        Without noise, so both come from the reference and the added input alone.

    Examples
    --------
    >>> from ivtools.loop.controllers import LinearLaw
    >>> law = LinearLaw(np.array([5.0, 0.0, 1.0, -5.0, 0.0]), np.zeros(1))
    >>> known = np.column_stack([np.ones(2000), np.zeros((2000, 2))])
    >>> q, nu = close_loop([1.0], [1.0, 0.0], law, 0, known, 0.01)
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
    added = np.zeros(len(known)) if added is None else added
    arrays = (Ad, Bd[:, 0], C[0], *law.known(known), added,
              law.taps, law.A, law.B[:, MEASURED], law.C, law.D[MEASURED])  # fmt: skip
    return _march_loop(*(np.array(a, dtype=float, order="C") for a in arrays), delay)


@cached()
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


@cached()
def _march_loop(A, b, c, feed, driven, added, taps, a_law, b_law, c_law, d_law, delay):
    """Output and command of a sampled plant under a linear law with states of its own."""
    n, m, samples = b.size, c_law.size, feed.size
    q, nu, wanted = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    x, new, z, following = np.zeros(n), np.zeros(n), np.zeros(m), np.zeros(m)
    for k in range(samples):
        for i in range(n):
            q[k] += c[i] * x[i]
        wanted[k] = feed[k]
        speed = 0.0
        for i in range(min(taps.size, k + 1)):
            speed += taps[i] * q[k - i]
        wanted[k] += d_law[0] * q[k] + d_law[1] * speed
        for i in range(m):
            wanted[k] += c_law[i] * z[i]
            following[i] = driven[k, i] + b_law[i, 0] * q[k] + b_law[i, 1] * speed
            for j in range(m):
                following[i] += a_law[i, j] * z[j]
        z[:] = following
        nu[k] = added[k] + (wanted[k - delay] if k >= delay else 0.0)
        for i in range(n):
            new[i] = b[i] * nu[k]
            for j in range(n):
                new[i] += A[i, j] * x[j]
        x[:] = new
    return q, nu
