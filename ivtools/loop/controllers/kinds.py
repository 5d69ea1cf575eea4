"""The kinds of controllers: each with its law, its settings, and what can be wrong with them.

e = q_ref - q; dq is the controller's own velocity; an integral int x is a sum,
I[k] = I[k-1] + dt x[k].
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import AxisError
from .law import INPUTS, LinearLaw

Array = NDArray[np.float64]
Settings = Mapping[str, Any]

_FEED = np.array([0.0, 0.0, 1.0, 0.0, 0.0])


@dataclass(frozen=True)
class Kind:
    """A kind of controller.

    Parameters
    ----------
    equation : str
        The law in one line.
    needs : tuple of str
        Settings that must be given.
    law : callable
        From the settings, the step dt (s) and the taps of the velocity to the linear law, without
        limit, filter and anti-windup.
    output : tuple of str
        Settings that the whole output is proportional to.
    optional : mapping
        Further settings and the values that they have if they are not given.
    gains : tuple of str, optional
        Settings that may differ by a factor from what the axis file says; default: those needed.
    position, velocity : bool
        Whether the law needs a position reference, and whether it forms a velocity.
    tracking : callable, optional
        From the settings to what an integrator takes back, per s and per command beyond the limit,
        with `anti_windup = "back-calculation"`.
    forms : tuple of tuple of str
        Columns by which the law is a linear regression; several, if some settings are then fixed.
        ``e``, ``q_ref``, ``-q``, ``dq_ref``; ``-dq`` and ``lag`` = dq_ref - dq, one column for each
        tap of the velocity; their sums over time ``int e`` and ``int lag``, and ``1``.
    from_columns : callable, optional
        From the coefficients of a form, those of all taps summed under ``dq``, to the settings
        that they may belong to.
    """

    equation: str
    needs: tuple[str, ...]
    law: Callable[[Settings, float, Array], LinearLaw]
    output: tuple[str, ...]
    optional: Mapping[str, float] = field(default_factory=dict)
    gains: tuple[str, ...] | None = None
    position: bool = True
    velocity: bool = True
    tracking: Callable[[Settings], float] | None = None
    forms: tuple[tuple[str, ...], ...] = ()
    from_columns: Callable[[Mapping[str, float]], list[dict[str, float]]] = lambda found: []

    @property
    def settings(self) -> tuple[str, ...]:
        """Every setting of the kind."""
        return (*self.needs, *self.optional)

    @property
    def mismatch(self) -> tuple[str, ...]:
        """What can be wrong with it, by name: relative errors, and one more tap of the velocity."""
        gains = self.needs if self.gains is None else self.gains
        return (*gains, "velocity_filter") if self.velocity else gains

    def changed(self, settings: Settings, changes: Mapping[str, float]) -> dict[str, Any]:
        """Return the settings with relative errors."""
        gains = self.needs if self.gains is None else self.gains
        return {
            k: v * (1.0 + changes[k]) if k in gains and changes.get(k) else v
            for k, v in settings.items()
        }

    def scaled(self, settings: Settings, ratio: float) -> dict[str, Any]:
        """Return the settings of a law with `ratio` times the output."""
        return {k: np.asarray(v) * ratio if k in self.output else v for k, v in settings.items()}


class _StateSpace(Kind):
    """Its output is wrong by one factor, which goes by the name of the outer gain, kp."""

    def changed(self, settings: Settings, changes: Mapping[str, float]) -> dict[str, Any]:
        return self.scaled(settings, 1.0 + changes.get("kp", 0.0))


def _cascade_pd(s: Settings, dt: float, taps: Array) -> LinearLaw:
    kp, kv = s["kp"], s["kv"]
    return LinearLaw(np.array([kp * kv, 0.0, 1.0, -kp * kv, -kv]), taps)


def _pd(s: Settings, dt: float, taps: Array) -> LinearLaw:
    kp, kd = s["kp"], s["kd"]
    return LinearLaw(np.array([kp, kd * s["c"], 1.0, -kp, -kd]), taps)


def _p_velocity(s: Settings, dt: float, taps: Array) -> LinearLaw:
    return LinearLaw(np.array([0.0, s["kv"] * s["c"], 1.0, 0.0, -s["kv"]]), taps)


def _p_pi(s: Settings, dt: float, taps: Array) -> LinearLaw:
    """State: the sum of the velocity errors so far, times ki dt."""
    kp = s.get("kp", 0.0)
    error = np.array([kp, s["c"], 0.0, -kp, -1.0])
    step = s["ki"] * dt
    return LinearLaw(
        s["kv"] * (1.0 + step) * error + _FEED,
        taps,
        np.eye(1),
        step * error[np.newaxis],
        np.array([s["kv"]]),
        np.zeros(1),
        np.ones(1, dtype=bool),
    )


def _pid(s: Settings, dt: float, taps: Array) -> LinearLaw:
    """States: the integral part, and the filtered derivative part of the sample before."""
    kp, kd, lag = s["kp"], s["kd"], s["derivative_filter"]
    if lag < 0.0:
        raise AxisError(f"derivative_filter is {lag:g} s; a time constant is not negative")
    keep = lag / (lag + dt)
    proportional = np.array([kp * s["b"], 0.0, 0.0, -kp, 0.0])
    integral = s["ki"] * dt * np.array([1.0, 0.0, 0.0, -1.0, 0.0])
    derivative = (1.0 - keep) * kd * np.array([0.0, s["c"], 0.0, 0.0, -1.0])
    return LinearLaw(
        proportional + integral + derivative + _FEED,
        taps,
        np.diag([1.0, keep]),
        np.vstack([integral, derivative]),
        np.array([1.0, keep]),
        np.zeros(2),
        np.array([True, False]),
    )


def _none(s: Settings, dt: float, taps: Array) -> LinearLaw:
    return LinearLaw(_FEED.copy(), np.zeros(1))


def _state_space(s: Settings, dt: float, taps: Array) -> LinearLaw:
    A, B, C, D = (np.atleast_2d(np.asarray(s[key], dtype=float)) for key in "ABCD")
    n = A.shape[0] if A.size else 0
    if (A.size and A.shape != (n, n)) or (n and (B.shape != (n, 2) or C.shape != (1, n))):
        raise AxisError(
            f"controller matrices A {A.shape}, B {B.shape}, C {C.shape} do not fit; a state-space "
            "controller needs A (n, n), B (n, 2) for (q_ref, q), C (1, n), D (1, 2)"
        )
    if D.shape != (1, 2):
        raise AxisError(f"controller matrix D is {D.shape}; inputs (q_ref, q) need (1, 2)")
    gains = _FEED.copy()
    gains[[0, 3]] = D[0]
    if n == 0:
        return LinearLaw(gains, np.zeros(1))
    into = np.zeros((n, len(INPUTS)))
    into[:, [0, 3]] = B
    return LinearLaw(gains, np.zeros(1), A, into, C[0], np.zeros(n), np.zeros(n, dtype=bool))


# --- from the coefficients of a regression ------------------------------------------------------

_SNAP = 0.02  # a weight of the velocity reference nearer to 0 or 1 is meant to be that
_COMPLEX, _APART = 0.5, 0.2  # roots of two gains that are nearly one, of their sum
_SAMPLED = 0.1  # of a weight of 1 that sampling may make


def _weight(found: Mapping[str, float]) -> dict[str, float]:
    """Return the weight c of the velocity reference: of a lag it is 1, without a column 0."""
    if "lag" in found:
        return {}
    c = found.get("dq_ref", 0.0) / found["dq"]
    return {"c": min((0.0, 1.0), key=lambda x: abs(x - c)) if abs(c * (1 - c)) < _SNAP else c}


def _to_cascade_pd(found: Mapping[str, float]) -> list[dict[str, float]]:
    return [{"kp": found["e"] / found["dq"], "kv": found["dq"]}]


def _to_pd(found: Mapping[str, float]) -> list[dict[str, float]]:
    return [{"kp": found["e"], "kd": found["dq"]} | _weight(found)]


def _to_p_velocity(found: Mapping[str, float]) -> list[dict[str, float]]:
    return [{"kv": found["dq"]} | _weight(found)]


def _to_pi_velocity(found: Mapping[str, float]) -> list[dict[str, float]]:
    return [{"kv": found["dq"], "ki": found["int lag"] / found["dq"]}]


def _to_pid(found: Mapping[str, float]) -> list[dict[str, float]]:
    whole = {"kp": found["e"] + found.get("-q", 0.0), "ki": found["int e"]}
    if "dq" in found:
        whole |= {"kd": found["dq"]} | _weight(found)
    b = found["e"] / whole["kp"] if whole["kp"] else 1.0
    return [whole | ({"b": b} if abs(b - 1.0) > _SNAP else {})]


def _to_p_pi(found: Mapping[str, float]) -> list[dict[str, float]]:
    """Solve the gains on q, kv (kp + ki), q_ref, kv (kp + c ki), and the integral, kv kp ki.

    Where c is 1 the law is the same with kp and ki in each other's place, but for the sampling. The
    sampled integral of a velocity reference is half a sample ahead of the position's, which is a
    weight c = 1 + ki dt / 2 in such a regression: near 1 it may be none.
    """
    kv, c = found["dq"], _weight(found)
    outer = found["e"] / kv
    weighted: list[dict[str, float]] = []
    if abs(1.0 - c.get("c", 1.0)) > _SNAP:
        ki = found["-q"] / (kv * (1.0 - c["c"])) if "-q" in found else 0.0
        weighted = [{"kp": outer - c["c"] * ki, "kv": kv, "ki": ki} | c]
        if abs(1.0 - c["c"]) > _SAMPLED:
            return weighted
    inner = outer**2 - 4.0 * found["int e"] / kv
    if inner < -_COMPLEX * outer**2:
        return weighted
    root = max(float(np.sqrt(max(inner, 0.0))), _APART * outer)  # as one, nothing moves them apart
    gains = (float(outer - root) / 2.0, float(outer + root) / 2.0)
    plain = {} if weighted else c
    return [*weighted, *({"kp": kp, "kv": kv, "ki": outer - kp} | plain for kp in gains)]


_INTEGRAL = (
    ("e", "lag", "int e", "1"),
    ("e", "-dq", "-q", "int e", "1"),
    ("e", "dq_ref", "-dq", "-q", "int e", "1"),
)

KINDS: dict[str, Kind] = {
    "cascade-pd": Kind(
        "nu = kv (kp e - dq)",
        ("kp", "kv"),
        _cascade_pd,
        ("kv",),
        forms=(("e", "-dq"),),
        from_columns=_to_cascade_pd,
    ),
    "pd": Kind(
        "nu = kp e + kd (c dq_ref - dq)",
        ("kp", "kd"),
        _pd,
        ("kp", "kd"),
        optional={"c": 1.0},
        forms=(("e", "lag"), ("e", "dq_ref", "-dq")),
        from_columns=_to_pd,
    ),
    "pid": Kind(
        "nu = kp (b q_ref - q) + ki int e + kd (c dq_ref - dq)/(derivative_filter s + 1)",
        ("kp", "ki"),
        _pid,
        ("kp", "ki", "kd"),
        optional={"kd": 0.0, "derivative_filter": 0.0, "b": 1.0, "c": 1.0},
        gains=("kp", "ki", "kd"),
        tracking=lambda s: abs(s["ki"] / s["kp"]) if s["kp"] else 0.0,
        forms=(("e", "-dq", "int e", "1"), ("e", "int e", "1"), *_INTEGRAL),
        from_columns=_to_pid,
    ),
    "p-pi": Kind(
        "nu = kv (ev + ki int ev), ev = kp e + c dq_ref - dq",
        ("kp", "kv", "ki"),
        _p_pi,
        ("kv",),
        optional={"c": 1.0},
        tracking=lambda s: s["ki"] / s["kv"] if s["kv"] else 0.0,
        forms=_INTEGRAL,
        from_columns=_to_p_pi,
    ),
    "pi-velocity": Kind(
        "nu = kv (ev + ki int ev), ev = c dq_ref - dq",
        ("kv", "ki"),
        _p_pi,
        ("kv",),
        optional={"c": 1.0},
        position=False,
        tracking=lambda s: s["ki"] / s["kv"] if s["kv"] else 0.0,
        forms=(("lag", "int lag", "1"),),
        from_columns=_to_pi_velocity,
    ),
    "p-velocity": Kind(
        "nu = kv (c dq_ref - dq)",
        ("kv",),
        _p_velocity,
        ("kv",),
        optional={"c": 1.0},
        position=False,
        forms=(("lag",), ("dq_ref", "-dq")),
        from_columns=_to_p_velocity,
    ),
    "state-space": _StateSpace(
        "x+ = A x + B (q_ref, q), nu = C x + D (q_ref, q)",
        ("A", "B", "C", "D"),
        _state_space,
        ("C", "D"),
        gains=("kp",),
        velocity=False,
    ),
    "none": Kind("nu as recorded: open loop", (), _none, (), position=False, velocity=False),
}
UNKNOWN = "identify"
