"""Gains: what settings of a law, other than declared ones, explain the command, and when."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...linalg import block_covariance
from ...loop import Controller
from ...workers import threaded
from ..rules import (
    ADDED_LEAST,
    CONVERGED,
    DELAY_TOLD,
    GAIN_ERROR,
    GAIN_EXPLAINS,
    GAIN_NEEDED,
    GAIN_RANGE,
    GAIN_STEPS,
    MAX_DELAY,
    PARITY_BLOCKS,
    PARITY_HEAD,
    SHORTER,
    SURE_T,
)
from .signals import Signals

Array = NDArray[np.float64]

_MOVE = 1e-3  # of a gain, in its finite differences


def best_delay(
    signals: Signals, controller: Controller, free: NDArray[np.bool_]
) -> tuple[dict[str, float], int]:
    """Return the mismatch that is worth a name, at the delay that explains most, and that."""
    fits = [_Gains(signals, controller, delay, free) for delay in range(MAX_DELAY + 1)]
    for _ in range(GAIN_STEPS):
        threaded(_Gains.step, fits)
        least = min(fit.cost for fit in fits)
        fits = [fit for fit in fits if fit.cost <= DELAY_TOLD * least]
    best = min(fits, key=lambda fit: fit.cost)
    return best.material, best.delay


class _Gains:
    """The mismatch that explains most of the command at one delay, as far as it is fitted."""

    def __init__(
        self, signals: Signals, controller: Controller, delay: int, free: NDArray[np.bool_]
    ) -> None:
        self.signals, self.delay = signals, delay
        self.controller = replace(controller, limit=np.inf)
        self.names = [*controller.mismatches, *(["added"] if signals.added.any() else [])]
        self.x = np.zeros(len(self.names))
        self.rows = free.copy()
        self.rows[:PARITY_HEAD] = False
        self.e = self._error(self.values)
        self.columns = np.zeros((len(self.e), len(self.names)))
        self.ended = not self.names

    def _error(self, values: dict[str, float]) -> Array:
        """Return the parity error at these mismatches, (n_rows,)."""
        law = self.controller.with_mismatch(**values)
        return self.signals.error(law, self.delay, values.get("added", 0.0))[self.rows]

    def _named(self, x: Array) -> dict[str, float]:
        """Return one value per mismatch, by name."""
        return dict(zip(self.names, x.tolist(), strict=True))

    @property
    def cost(self) -> float:
        """Energy of the parity error."""
        return float(self.e @ self.e)

    @property
    def values(self) -> dict[str, float]:
        """The mismatch."""
        return self._named(self.x)

    @property
    def tvalues(self) -> dict[str, float]:
        """Block-robust t values."""
        t = np.abs(self.x) / np.maximum(_deviations(self.columns, self.e), 1e-300)
        return self._named(t)

    def step(self) -> None:
        """Take a Gauss-Newton step, shortened until it leads down; end if it never does."""
        if self.ended:
            return
        least = [ADDED_LEAST if n == "added" else GAIN_RANGE[0] for n in self.names]
        moved = [self._error(self._named(self.x + _MOVE * one)) for one in np.eye(len(self.names))]
        self.columns = np.column_stack([(e - self.e) / _MOVE for e in moved])
        move = np.linalg.lstsq(self.columns, self.e, rcond=1e-8)[0]
        before, self.ended = self.cost, True
        for factor in SHORTER:
            x = np.clip(self.x - factor * move, least, GAIN_RANGE[1])
            e = self._error(self._named(x))
            if float(e @ e) < before:
                self.x, self.e = x, e
                self.ended = self.cost > (1.0 - CONVERGED) * before
                return

    @property
    def material(self) -> dict[str, float]:
        """What of it is significant, worth a name, and explains the parity error."""
        tvalues = self.tvalues
        kept = {n: v for n, v in self.values.items() if abs(v) > GAIN_ERROR and tvalues[n] > SURE_T}

        def energy(values: dict[str, float]) -> float:
            """Return the energy of the parity error that is left with these put right."""
            return float(np.sum(self._error(values) ** 2))

        if not kept or energy(kept) > (1.0 - GAIN_EXPLAINS) * energy({}):
            return {}
        for name in sorted(kept, key=lambda n: tvalues[n])[: len(kept) - 1]:
            fewer = {n: v for n, v in kept.items() if n != name}
            if energy(fewer) < GAIN_NEEDED * energy(kept):
                kept = fewer
        return kept


def _deviations(columns: Array, e: Array) -> Array:
    """Return block-robust standard deviations."""
    bread = np.linalg.pinv(columns.T @ columns)
    parts = np.array_split(np.arange(len(e)), PARITY_BLOCKS)
    firsts = np.array([rows[0] for rows in parts if len(rows)], dtype=np.intp)
    meat = block_covariance(columns * e[:, np.newaxis], firsts)
    return np.sqrt(np.maximum(np.diag(bread @ meat @ bread), 0.0))


def corrected(
    controller: Controller, delay: int, mismatch: dict[str, float], limit: float | None
) -> Controller:
    """Return a controller with its mismatch put right, late by whole samples, and its limit."""
    found = controller.with_mismatch(**mismatch) if mismatch else controller
    return replace(found, delay=delay, limit=controller.limit if limit is None else limit)
