"""The control law, read from a record.

A digital controller computes its command from signals that the record holds, so its gains are the
solution of a linear regression that leaves next to nothing. The structure is chosen among the
kinds of controller, lengths of the velocity filter and delays.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import log
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..display import Displayed
from ..errors import RecordError
from ..linalg import covariance, solve_iv
from ..record import Record
from ..tables import Text, table
from .controllers import Controller

if TYPE_CHECKING:
    from .closed_loop import ClosedLoop

Array = NDArray[np.float64]

FIR_LENGTHS, DELAYS = (1, 2, 3), (0, 1, 2, 3)
_HEAD = max(DELAYS) + max(FIR_LENGTHS) + 1  # samples whose past is not in the record
_ROUNDING = 1e-9  # a law that leaves less of the command than this is exact
_WORTH = 0.8  # one setting more must leave at most this much of the residual
_POOR = 5.0  # a residual above this (per cent) is not what a control law leaves
_CLIPPED = 5  # so many samples at the very largest command are a limit


@dataclass(frozen=True, eq=False, repr=False)
class ControllerFit(Displayed):
    """A control law that was fitted to a record, and how well.

    Parameters
    ----------
    controller : Controller
        The law.
    std_errors : mapping
        Standard error of each gain, and of each weight of the velocity filter
        (``velocity_filter[0]``, ...).
    residual : float
        What the law leaves of the command, 100 ||nu - law|| / ||nu||, in per cent.
    samples, saturated : int
        Samples used, and left out because the command was at its limit.
    tried : tuple
        Every structure that was tried: kind, filter length, delay, residual (%).
    """

    content: ClassVar[tuple[str, ...]] = (
        "kind", "delay", "limit", "estimates", "std_errors", "residual", "samples", "saturated",
    )  # fmt: skip

    controller: Controller
    std_errors: Mapping[str, float]
    residual: float
    samples: int
    saturated: int
    tried: tuple[tuple[str, int, int, float], ...]

    @property
    def kind(self) -> str:
        """Kind of the law."""
        return self.controller.kind

    @property
    def delay(self) -> int:
        """Samples from the measured position to the command."""
        return self.controller.delay

    @property
    def limit(self) -> float:
        """Largest command."""
        return self.controller.limit

    @property
    def estimates(self) -> dict[str, float]:
        """Value of each gain and filter weight."""
        taps = {f"velocity_filter[{i}]": w for i, w in enumerate(self.controller.velocity_filter)}
        return {**{k: float(v) for k, v in self.controller.settings.items()}, **taps}

    @property
    def note(self) -> str:
        """The law and its uncertainty in one line."""
        gains = ", ".join(
            f"{k} {v:.5g} ({self.std_errors[k]:.1g})" for k, v in self.estimates.items()
        )
        doubt = "; a poor fit, so treat what rests on it with care" if self.residual > _POOR else ""
        return (
            f"controller identified from the record: {self.controller.kind}, {gains}, delay "
            f"{self.controller.delay}; it leaves {self.residual:.2g} % of the command{doubt}"
        )

    def summary(self) -> Text:
        """Return the law, its standard errors, and the next best structures."""
        rows = [[k, f"{v:.6g}", f"{self.std_errors[k]:.2g}"] for k, v in self.estimates.items()]
        head = [
            f"kind {self.controller.kind}, delay {self.controller.delay} samples, limit "
            f"{self.controller.limit:g}",
            f"residual {self.residual:.3g} % of {self.samples} samples; "
            f"{self.saturated} at the limit",
        ]
        best = sorted(self.tried, key=lambda row: row[3])[:4]
        notes = [f"{kind}, {n} taps, delay {d}: {left:.3g} %" for kind, n, d, left in best]
        return table("Controller, identified", head, ["", "value", "std error"], rows, notes)


@dataclass(frozen=True, eq=False)
class _Candidate:
    kind: str
    taps: int
    delay: int
    X: Array  # (n, settings)
    gains: Array  # (settings,)
    resids: Array  # (n,)

    def refined(self, y: Array) -> _Candidate:
        """Return the same structure, solved by QR for its residual's sake."""
        gains = solve_iv(self.X, y)
        return replace(self, gains=gains, resids=y - self.X @ gains)

    def criterion(self, power: float) -> float:
        """Log residual power, and a price per setting that more samples do not lower."""
        n, rest = len(self.resids), float(self.resids @ self.resids)
        price = max(log(n) / n, -2.0 * log(_WORTH))
        return log(max(rest / power, _ROUNDING**2)) + price * len(self.gains)


def identify(loop: ClosedLoop, record: Record) -> ControllerFit:
    """Fit the control law of a record; see `ClosedLoop.identify_controller`."""
    if record.q_ref is None:
        raise RecordError("q_ref is missing; a control law is fitted from the position reference")
    if record.n_joints != 1:
        raise RecordError(f"the record has {record.n_joints} joints; a control law serves one")
    added = 0.0 if record.added is None else record.added
    command = (loop.command(record) - added)[:, 0]
    limit = _limit(command, loop.controller.limit)
    free = np.abs(command) < limit * (1.0 - 1e-6)
    free[:_HEAD] = False
    y = command[free]
    power = float(y @ y)
    if len(y) < 10 * _HEAD or power == 0.0:
        raise RecordError(
            f"{len(y)} samples of the command are below its limit and not 0; a control law needs "
            "more, so take a longer record or state the controller"
        )
    candidates = [_solve(*c, free, y) for c in _structures(record)]
    best = min(candidates, key=lambda c: c.criterion(power)).refined(y)
    tried = tuple((c.kind, c.taps, c.delay, _percent(c, power)) for c in candidates)
    controller, errors = _controller(best, loop.controller, limit)
    clipped = int((~free[_HEAD:]).sum())
    return ControllerFit(controller, errors, _percent(best, power), len(y), clipped, tried)


def _percent(candidate: _Candidate, power: float) -> float:
    return 100.0 * float(np.sqrt(candidate.resids @ candidate.resids / power))


def _limit(command: Array, stated: float) -> float:
    """Return the stated limit, or the one at which the record clips."""
    top = float(np.max(np.abs(command)))
    clips = int((np.abs(command) >= top * (1.0 - 1e-9)).sum()) >= _CLIPPED
    return top if not np.isfinite(stated) and clips else stated


def _structures(record: Record) -> Iterator[tuple[str, int, int, list[Array]]]:
    """Yield kind, filter length, delay and the regressors of the gains, (n,) each."""
    assert record.q_ref is not None  # the caller has looked
    dt, q, q_ref = record.dt, record.q[:, 0], record.q_ref[:, 0]
    dq_ref = record.dq_ref[:, 0] if record.dq_ref is not None else np.gradient(q_ref, dt)
    speed = np.diff(q, prepend=q[0]) / dt
    for delay in DELAYS:
        error = np.roll(q_ref - q, delay)
        speeds = [np.roll(speed, delay + i) for i in range(max(FIR_LENGTHS))]
        lags = [np.roll(dq_ref, delay) - v for v in speeds]
        for n in FIR_LENGTHS:
            yield "cascade-pd", n, delay, [error, *(-v for v in speeds[:n])]
            yield "pd", n, delay, [error, *lags[:n]]
            yield "p-velocity", n, delay, lags[:n]


def _solve(
    kind: str, taps: int, delay: int, columns: Sequence[Array], free: NDArray[np.bool_], y: Array
) -> _Candidate:
    X = np.column_stack([column[free] for column in columns])  # (n, settings)
    scale = np.sqrt((X**2).sum(axis=0))
    scale[scale == 0.0] = 1.0
    unit = X / scale  # gains in such units are alike, so the normal equations are accurate enough
    gains = np.linalg.lstsq(unit.T @ unit, unit.T @ y, rcond=None)[0] / scale
    return _Candidate(kind, taps, delay, X, gains, y - X @ gains)


def _controller(
    found: _Candidate, known: Controller, limit: float
) -> tuple[Controller, dict[str, float]]:
    """Return the law in its settings, and their standard errors by the delta method."""
    outer = found.kind != "p-velocity"
    velocity = float(found.gains[outer:].sum())
    if velocity == 0.0:
        raise RecordError("the command does not depend on the velocity; state the controller")
    weights = found.gains[outer:] / velocity
    inner = "kd" if found.kind == "pd" else "kv"
    settings: dict[str, float] = {inner: velocity}
    rows = {inner: np.r_[[0.0] * outer, np.ones(found.taps)]}
    if outer:
        kp, unit = float(found.gains[0]), np.eye(len(found.gains))[0]
        if found.kind == "cascade-pd":  # its first gain is the product of both
            kp /= velocity
            unit = (unit - kp * rows[inner]) / velocity
        settings["kp"], rows["kp"] = kp, unit
    for i, weight in enumerate(weights):
        unit = np.eye(len(found.gains))[outer + i]
        rows[f"velocity_filter[{i}]"] = (unit - weight * rows[inner]) / velocity
    cov = covariance(found.X, found.resids)
    errors = {name: float(np.sqrt(max(row @ cov @ row, 0.0))) for name, row in rows.items()}
    kinds: dict[str, float] = {k: settings[k] for k in ("kp", "kv", "kd") if k in settings}
    filter_ = tuple(float(w) for w in weights)
    return replace(
        known,
        kind=found.kind,
        settings=kinds,
        velocity_filter=filter_,
        delay=found.delay,
        limit=limit,
    ), errors
