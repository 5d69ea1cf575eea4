"""Control laws.

Every law used here is linear in what the controller sees, so one form serves them all::

    nu[k] = gains @ (q_ref[k], dq_ref[k]) + taps @ (q[k], q[k-1], ...) + C x[k] + D (q_ref[k], q[k])

A kind of controller says how its settings become that form. The simulation, the python-control
model and controller parity all read the same form.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from ..errors import AxisError

Array = NDArray[np.float64]


def _empty(rows: int, columns: int) -> Array:
    return np.zeros((rows, columns))


@dataclass(frozen=True)
class LinearLaw:
    """A control law at its sampling rate; units are command per position or velocity.

    Parameters
    ----------
    gains : ndarray, (2,)
        Gains on q_ref and dq_ref.
    taps : ndarray, (n_taps,)
        Weights of the measured position, newest first.
    A, B, C, D : ndarray, (n, n), (n, 2), (n,), (2,)
        State-space part with inputs (q_ref, q); n may be 0.
    """

    gains: Array
    taps: Array
    A: Array = field(default_factory=lambda: _empty(0, 0))
    B: Array = field(default_factory=lambda: _empty(0, 2))
    C: Array = field(default_factory=lambda: np.zeros(0))
    D: Array = field(default_factory=lambda: np.zeros(2))

    def __call__(self, q_ref: Array, dq_ref: Array, q: Array) -> Array:
        """Return the command, before its limit, of this law fed with a trajectory, (n_samples,).

        The first ``len(taps) - 1`` values assume that the position before the record lies on the
        straight line through its first two samples; the state-space part begins settled at the
        first sample.
        """
        before = q[0] + (q[0] - q[1]) * np.arange(len(self.taps) - 1, 0, -1)
        nu = np.convolve(np.concatenate([before, q]), self.taps, mode="valid")
        nu = nu + self.gains[0] * q_ref + self.gains[1] * dq_ref
        if len(self.C):
            for i, u in enumerate((q_ref, q)):
                nu = nu + self._filtered(self.B[:, i], self.D[i], u)
            nu = nu + self.free_response(len(q)) @ self.settled(q_ref[0], q[0])
        return nu

    def settled(self, q_ref: float, q: float, command: float | None = None) -> Array:
        """Return the state, (n,), that stays as it is with these inputs, and gives this command."""
        u = np.array([q_ref, q])
        rows, wanted = np.eye(len(self.C)) - self.A, self.B @ u
        if command is not None:
            rows = np.vstack([rows, self.C])
            wanted = np.append(wanted, command - self.D @ u)
        return np.asarray(np.linalg.lstsq(rows, wanted, rcond=None)[0], dtype=float)

    def free_response(self, n_samples: int) -> Array:
        """Return the command that each state makes by itself, (n_samples, n)."""
        pulse = np.zeros(n_samples + 1)
        pulse[0] = 1.0
        columns = [self._filtered(b, 0.0, pulse)[1:] for b in np.eye(len(self.C))]
        return np.array(columns).reshape(len(self.C), n_samples).T

    def _filtered(self, b: Array, d: float, u: Array) -> Array:
        """Return the answer of the state-space part, from rest, to one input, (n_samples,)."""
        over, under = signal.ss2tf(self.A, b[:, None], self.C[None, :], np.array([[d]]))
        return np.asarray(signal.lfilter(over[0], under, u), dtype=float)


def backward_difference(velocity_filter: ArrayLike, dt: float) -> Array:
    """Return the taps, 1/s, of the velocity as a controller forms it.

    The position passes an FIR filter, then a backward difference over one sample.

    Examples
    --------
    >>> backward_difference([0.5, 0.5], 0.001)
    array([ 500.,    0., -500.])
    """
    return np.convolve(np.asarray(velocity_filter, dtype=float), [1.0, -1.0]) / dt


def _cascade_pd(s: Mapping[str, Any], dt: float) -> LinearLaw:
    kp, kv = s["kp"], s["kv"]
    taps = -kv * backward_difference(s["velocity_filter"], dt)
    taps[0] -= kp * kv
    return LinearLaw(np.array([kp * kv, 0.0]), taps)


def _pd(s: Mapping[str, Any], dt: float) -> LinearLaw:
    taps = -s["kd"] * backward_difference(s["velocity_filter"], dt)
    taps[0] -= s["kp"]
    return LinearLaw(np.array([s["kp"], s["kd"]]), taps)


def _p_velocity(s: Mapping[str, Any], dt: float) -> LinearLaw:
    return LinearLaw(
        np.array([0.0, s["kv"]]),
        -s["kv"] * backward_difference(s["velocity_filter"], dt),
    )


def _state_space(s: Mapping[str, Any], dt: float) -> LinearLaw:
    A, B, C, D = (np.atleast_2d(np.asarray(s[key], dtype=float)) for key in "ABCD")
    n = A.shape[0] if A.size else 0
    if (A.size and A.shape != (n, n)) or (n and (B.shape != (n, 2) or C.shape != (1, n))):
        raise AxisError(
            f"controller matrices A {A.shape}, B {B.shape}, C {C.shape} do not fit; a state-space "
            "controller needs A (n, n), B (n, 2) for (q_ref, q), C (1, n), D (1, 2)"
        )
    if D.shape != (1, 2):
        raise AxisError(f"controller matrix D is {D.shape}; inputs (q_ref, q) need (1, 2)")
    if n == 0:
        return LinearLaw(np.array([D[0, 0], 0.0]), D[0, 1:].copy())
    return LinearLaw(np.zeros(2), np.zeros(1), A, B, C[0], D[0])


@dataclass(frozen=True)
class Kind:
    """A kind of controller: the settings it needs and the law they make."""

    needs: tuple[str, ...]
    law: Callable[[Mapping[str, Any], float], LinearLaw]


KINDS = {
    "cascade-pd": Kind(("kp", "kv"), _cascade_pd),
    "pd": Kind(("kp", "kd"), _pd),
    "p-velocity": Kind(("kv",), _p_velocity),
    "state-space": Kind(("A", "B", "C", "D"), _state_space),
}
_COMMON = ("kind", "velocity_filter", "delay", "limit")


@dataclass(frozen=True)
class Controller:
    """A digital position or velocity controller.

    Parameters
    ----------
    kind : str
        ``"cascade-pd"``: nu = kv (kp (q_ref - q) - dq); ``"pd"``: nu = kp (q_ref - q)
        + kd (dq_ref - dq); ``"p-velocity"``: nu = kv (dq_ref - dq); ``"state-space"``: matrices
        with inputs (q_ref, q) at the sampling rate; ``"identify"``: any of the first three, fitted
        from a record by `ClosedLoop.identify_controller`.
    settings : mapping
        The gains of that kind.
    velocity_filter : tuple of float
        FIR filter that the position passes before the backward difference.
    delay : int
        Whole samples from the measured position to the recorded command.
    limit : float
        The command is clipped to +- limit.

    Raises
    ------
    AxisError
        If a setting is missing, unknown or not a finite number.

    Examples
    --------
    >>> Controller("pd", {"kp": 2.0, "kd": 0.1}).law(dt=0.001).gains
    array([2. , 0.1])
    """

    kind: str
    settings: Mapping[str, Any]
    velocity_filter: tuple[float, ...] = (1.0,)
    delay: int = 0
    limit: float = np.inf
    mismatch: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.kind not in (*KINDS, "identify"):
            known = ", ".join([*KINDS, "identify"])
            raise AxisError(f"controller kind {self.kind!r} is not known; known kinds: {known}")
        needs = KINDS[self.kind].needs if self.kind in KINDS else ()
        for key in needs:
            if key not in self.settings:
                raise AxisError(
                    f"controller {self.kind} lacks {key!r}; it needs {', '.join(needs)}"
                )
        for key, value in self.settings.items():
            if key not in needs:
                known = ", ".join(sorted({*needs, *_COMMON}))
                raise AxisError(f"controller {self.kind} does not know {key!r}; it knows: {known}")
            _finite(key, value, scalar=self.kind != "state-space")
        if not self.velocity_filter:
            raise AxisError("velocity_filter is empty; [1.0] is the filter that changes nothing")
        for weight in self.velocity_filter:
            _finite("velocity_filter", weight, scalar=True)
        whole = isinstance(self.delay, int) and not isinstance(self.delay, bool)
        if not (whole and 0 <= self.delay <= 1000):
            raise AxisError(f"delay is {self.delay!r}; it counts whole samples, 0 to 1000")
        if not self.limit > 0:
            raise AxisError(f"limit is {self.limit!r}; the command is clipped to +- limit > 0")
        if self.kind == "state-space":
            self.law(1.0)  # its matrices must fit each other

    def law(self, dt: float) -> LinearLaw:
        """Return the linear law at the sampling step dt (s).

        Raises
        ------
        AxisError
            If the law is still to be identified from a record.
        """
        if self.kind == "identify":
            raise AxisError(
                'controller kind "identify" has no law yet; fit it from a record with '
                "loop.identify_controller(record)"
            )
        settings = {**self.settings, "velocity_filter": self.velocity_filter}
        return KINDS[self.kind].law(settings, dt)

    def with_mismatch(self, kp: float, kv: float, velocity_filter: float) -> Controller:
        """Return this controller with relative errors of its settings.

        Parameters
        ----------
        kp, kv : float
            Relative change of the outer (position) and inner (velocity) gain; on a `pd` law the
            second acts on kd, on a `state-space` law the first scales the output.
        velocity_filter : float
            Weight of one more, older, tap of the velocity filter; the others shrink so that the
            sum stays.
        """
        s = dict(self.settings)
        if self.kind == "state-space":
            s["C"], s["D"] = ((1 + kp) * np.asarray(s[key], dtype=float) for key in "CD")
        else:
            changes = {"kp": kp, "kv": kv, "kd": kv}
            s = {key: value * (1.0 + changes[key]) for key, value in s.items()}
        taps = np.array([*self.velocity_filter, 0.0])
        total = taps.sum()
        taps = (1.0 - velocity_filter) * taps
        taps[-1] += velocity_filter * total
        return replace(self, settings=s, velocity_filter=tuple(taps))

    def scaled(self, ratio: float) -> Controller:
        """Return this controller with its output multiplied by `ratio`.

        Multiplying the gain by M/M0 keeps the bandwidth of a loop whose inertia is thought to be
        M instead of M0 (Janot, Vandanjon, Gautier, IEEE Trans. Control Systems Technology 22(1),
        2014).
        """
        outer = {"cascade-pd": ("kv",), "pd": ("kp", "kd"), "p-velocity": ("kv",)}
        keys = outer.get(self.kind, ("C", "D"))
        s = {k: np.asarray(v) * ratio if k in keys else v for k, v in self.settings.items()}
        return replace(self, settings=s)


def _finite(key: str, value: Any, scalar: bool = False) -> None:
    try:
        array = np.asarray(value)
        good = array.dtype.kind in "iuf" and bool(np.isfinite(array).all())
    except (TypeError, ValueError):
        good = False
    if not good:
        raise AxisError(f"controller setting {key} = {value!r} is not a finite number")
    if scalar and array.ndim:
        raise AxisError(f"controller setting {key} = {value!r} is a list; give one number")
