"""Signals: what a control law sees of a record, what was recorded, and the parity error."""

from __future__ import annotations

from copy import copy

import numpy as np
from numpy.typing import NDArray

from ...limits import LARGEST
from ...loop import ClosedLoop, Controller
from ...loop.controllers import Seen, ahead
from ...record import Record
from .. import band
from ..rules import AT_LIMIT, LIMIT_SAMPLES, LITTLE, PARITY_HEAD, ROUNDING

Array = NDArray[np.float64]


def grid(x: Array) -> float:
    """Return the step of which all values of a signal, (n_samples,), are multiples; 0 if none."""
    apart = np.diff(np.unique(x))
    apart = apart[apart > 2.0 * np.spacing(np.max(np.abs(x)))]  # of two ways to write one number
    if not len(apart):
        return 0.0
    step = float(np.min(apart))
    steps = (x - x[0]) / step
    return step if np.max(np.abs(steps - np.round(steps))) < LITTLE else 0.0


class Signals:
    """What a control law sees, and what was recorded: of the command what is below a frequency."""

    def __init__(self, record: Record, loop: ClosedLoop) -> None:
        self.hz: float | None = None  # below which the command counts
        self.record, self.joint, self.dt = record, loop.joint, record.dt
        self.added = record.added[:, 0] if record.added is not None else np.zeros(record.n_samples)
        self.whole = loop.command(record)
        self.command = self.whole[:, 0]
        self.step = grid(self.command)
        self.limit = loop.controller.limit  # at which the record was clipped
        self.least = least_at(np.abs(self.own), self.limit, AT_LIMIT, self.step)  # from where on

    @property
    def own(self) -> Array:
        """Recorded command of the law itself, without the added input, (n_samples,)."""
        return np.asarray(self.command - self.added)

    def limited(self, limit: float, least: float) -> Signals:
        """Return the same of a record that was clipped there, and sits there from `least` on."""
        other = copy(self)
        other.limit, other.least = limit, least
        return other

    def below(self, hz: float | None) -> Signals:
        """Return the same with the command below a frequency, Hz; None: with all of it."""
        other = copy(self)
        other.hz = hz
        return other

    def seen(self, controller: Controller) -> Seen:
        """Return the inputs of a law, and what it gave."""
        return Seen.of(controller, self.record, self.whole, self.joint)

    def fed(self, controller: Controller) -> Array:
        """Return the command of the law fed with the measured position, settled at first, (n,)."""
        law, seen = controller.law(self.dt), self.seen(controller)
        with np.errstate(over="ignore", invalid="ignore"):
            return _finite(law.command(seen.inputs, law.settled(seen.inputs[0])))

    def law(self, controller: Controller, delay: int) -> Array:
        """Return the same from where the record began, late by whole samples, unlimited, (n,)."""
        law, seen = controller.law(self.dt), self.seen(controller)
        with np.errstate(over="ignore", invalid="ignore"):
            return _finite(seen.expected(law, delay, self.limit, self.least))

    def share(self, error: Array) -> float:
        """Return the size of a parity error, (n,), over that of the command, 1."""
        command = self.slow(self.command)
        left, whole = (float(np.linalg.norm(x[PARITY_HEAD:])) for x in (error, command))
        return left / whole

    def slow(self, x: Array) -> Array:
        """Return what a signal, (n,), has below the frequency, without how it began."""
        if self.hz is None:
            return x
        began = np.arange(len(x)) < PARITY_HEAD
        return band.below(np.where(began, x[PARITY_HEAD], x), self.hz, self.dt)

    def error(self, controller: Controller, delay: int, added: float) -> Array:
        """Return recorded minus expected command, (n,); 0 at the end that the law cannot know."""
        expected = np.clip(self.law(controller, delay), -controller.limit, controller.limit)
        error = self.command - expected - (1.0 + added) * self.added
        error[len(error) - ahead(self.record, controller) :] = 0.0
        return self.slow(error)


def _finite(command: Array) -> Array:
    """Return the command of a law, (n,); zeros, of an unstable one that overflows."""
    return command if (np.abs(command) < LARGEST).all() else np.zeros_like(command)


def least_at(own: Array, limit: float, share: float, step: float) -> float:
    """Return from which command on it sits at a limit: a share of it, or all where the log has it.

    An integrator that is taken to stand while the command comes near is wrong from then on. What
    is left of a rounded command without its added input is off by a step at most.
    """
    exact = (1.0 - ROUNDING) * limit - step
    return exact if np.sum(own >= exact) >= LIMIT_SAMPLES else share * limit
