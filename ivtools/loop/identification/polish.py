"""The law itself fitted to a record, from settings that are near: states, limit, filter and all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import log

import numpy as np
from numpy.typing import NDArray

from ...errors import AxisError
from ...linalg import independent
from ..controllers import Controller, LinearLaw, Seen
from ..controllers.law import Clipped
from .data import Data
from .forms import criterion, price

Array = NDArray[np.float64]

_STEP = 1e-5  # relative, of a difference quotient
_STEPS = 6  # of Gauss and Newton
_HALVES = 4  # of a step that makes it worse
_GAINED = 1e-4  # of the power left, below which a step is the last
_FREE = 1e-10  # energy of states that together do anything to the command, of the largest
_DONE = 1e-10  # of the command, that is nothing
_ALIKE = 0.2  # of the price of a setting: laws as good as each other
_CHANCE = 4.0  # by which twice a log likelihood differs by chance
NOISE = 1e-3  # share of the noise's power that a setting must remove at least
_KEPT = {"kp", "kv", "ki", "kd", "c", "b", "derivative_filter"}


@dataclass(frozen=True, eq=False)
class Fitted:
    """A law, and what it leaves.

    Parameters
    ----------
    controller : Controller
    names : tuple of str
        What was fitted: settings, ``velocity_filter[i]``, ``feedforward.x``, ``feedback.x``,
        ``filter.hz``, ``filter.damping``.
    jacobian : ndarray, (rows, len(names))
        Of the law's command.
    resids : ndarray, (rows,)
    left : float
        Share of the command's power that is left.
    noise : float, optional
        Rms, m or rad, of the noise that the controller did not see, where the law was turned round
        (`inverse`): jacobian and resids are then those of the position.
    spread : mapping
        What else is unsure of a setting: how far it moves among laws that are as likely.
    """

    controller: Controller
    names: tuple[str, ...]
    jacobian: Array
    resids: Array
    left: float
    noise: float | None = None
    spread: Mapping[str, float] = field(default_factory=dict)

    @property
    def price(self) -> float:
        """What a setting costs."""
        rows = len(self.resids)
        return (
            price(rows) if self.noise is None else max(2.0 * log(rows) / rows, NOISE)
        )  # of many tried

    @property
    def alike(self) -> float:
        """Difference of criteria up to which two laws are as good as each other."""
        rows = len(self.resids)
        return _ALIKE * price(rows) if self.noise is None else _CHANCE / rows

    @property
    def criterion(self) -> float:
        """Log power of what is left, as that of a form, or of the noise, plus its settings'."""
        if self.noise is None:
            return criterion(self.left, len(self.names), len(self.resids))
        return 2.0 * log(self.noise) + len(self.names) * self.price


class Law:
    """The command of a controller along the data, as its settings change."""

    def __init__(self, data: Data, controller: Controller) -> None:
        self.data, self.controller = data, controller
        self.whole = data.command[:, np.newaxis]
        self.record = data.record
        self.target = data.seen(data.command, late=controller.delay)
        self.power = max(float(self.target @ self.target), 1e-300)

    def resids(self, controller: Controller, start: Array | None = None) -> Array:
        """Return what a controller leaves of the command, (rows,), from the likeliest state on.

        Or from a given one.
        """
        return self.target - self.data.seen(self.command(controller, start))

    def command(self, controller: Controller, start: Array | None = None) -> Array:
        """Return the law's command before its limit, not late, (n,)."""
        law, inputs, clipped = self._along(controller)
        if not len(law.C):
            return inputs @ law.D
        began = self._began(law, inputs, controller.delay) if start is None else start
        return law.command(inputs, began, clipped)

    def began(self, controller: Controller) -> tuple[Array, Array, Array]:
        """Return the likeliest state in which a law began, (n,), and what it leaves, (rows,).

        And what the command answers to a unit of each state, (rows, n).
        """
        law, inputs, clipped = self._along(controller)
        start = self._began(law, inputs, controller.delay)
        command, free = law.freely(inputs, start, clipped)
        free = free if np.isfinite(free).all() else np.zeros_like(free)  # of an unstable law
        seen = np.array([self.data.seen(x) for x in free.T]).reshape(-1, len(self.target)).T
        return start, self.target - self.data.seen(command), seen

    def _began(self, law: LinearLaw, inputs: Array, late: int) -> Array:
        known = inputs[: len(inputs) - late]
        return law.began(known, self.data.command[late:], self.data.clipped(late))

    def _along(self, controller: Controller) -> tuple[LinearLaw, Array, Clipped]:
        """Return a law, its inputs, (n, 5), and where its command was clipped, not late."""
        late = controller.delay
        inputs = Seen.of(controller, self.record, self.whole, self.data.joint).inputs
        clipped = self.data.clipped(late)
        on = np.concatenate([clipped.side, np.zeros(late)])
        return controller.law(self.record.dt), inputs, replace(clipped, side=on)


def polished(data: Data, controller: Controller, steps: int = _STEPS) -> Fitted:
    """Return the law of a controller's structure that leaves least of the command.

    Gauss and Newton's steps by differences; the state in which the law began is fitted anew at
    each.
    """
    law, names = Law(data, controller), tuple(names_of(controller))
    e = law.resids(controller)
    for _ in range(steps):
        J = jacobian(law, controller, names)
        size = np.linalg.norm(J, axis=0)
        size[size == 0.0] = 1.0
        step = np.linalg.lstsq(J / size, e, rcond=1e-9)[0] / size
        better = _downhill(law, controller, names, step, e)
        if better is None:
            break
        controller, new = better
        before, after = float(e @ e), float(new @ new)
        done = after > (1.0 - _GAINED) * before or after < _DONE**2 * law.power
        e = new
        if done:
            break
    J = jacobian(law, controller, names)
    return Fitted(controller, names, J, e, float(e @ e) / law.power)


def _downhill(
    law: Law, controller: Controller, names: tuple[str, ...], step: Array, e: Array
) -> tuple[Controller, Array] | None:
    """Return the law a step further, halved until it leaves less; None if it never does."""
    for half in range(_HALVES):
        try:
            trial = moved(controller, names, step * 0.5**half)
            new = law.resids(trial)
        except AxisError:
            continue
        if np.isfinite(new).all() and float(new @ new) < float(e @ e):
            return trial, new
    return None


def jacobian(law: Law, controller: Controller, names: tuple[str, ...]) -> Array:
    """Return how a law's command changes with its settings, (rows, len(names)).

    But for what the state in which it began makes up for, which is fitted anew.

    L. Kaufman, "A variable projection method for solving separable nonlinear least squares
    problems", BIT 15, 1975: at a state that stays, the change less what other states would do.
    """
    start, e, free = law.began(controller)
    columns = []
    for i, name in enumerate(names):
        value = values(controller, (name,))[0]
        step = np.zeros(len(names))
        step[i] = _STEP * (abs(value) or _unit(controller, name))
        try:
            changed = law.resids(moved(controller, names, step), start)
        except AxisError:  # a filter at the end of its band
            step = -step
            changed = law.resids(moved(controller, names, step), start)
        columns.append((e - changed) / step[i])
    J = np.column_stack(columns) if columns else np.zeros((len(e), 0))
    made_up = free @ independent(free, _FREE)
    return J - made_up @ (made_up.T @ J)


def _unit(controller: Controller, name: str) -> float:
    """Return a size for a setting that is 0."""
    if name in ("ki", "kd") and controller.settings.get("kp"):
        return abs(float(controller.settings["kp"]))
    return 1.0


def names_of(controller: Controller) -> Iterator[str]:
    """Yield what can be fitted of a controller."""
    kept = [k for k in controller.settings if k in _KEPT]
    if controller.settings.get("c") in (0.0, 1.0):
        kept = [k for k in kept if k != "c"]
    yield from kept
    if controller.velocity == "differences":
        yield from (f"velocity_filter[{i}]" for i in range(1, len(controller.velocity_filter)))
    yield from (f"feedforward.{k}" for k in controller.feedforward)
    yield from (f"feedback.{k}" for k in controller.feedback)
    if controller.filter:
        yield "filter.hz"
        if controller.filter.damping is not None:
            yield "filter.damping"


def values(controller: Controller, names: tuple[str, ...]) -> list[float]:
    """Return values by name."""
    tables = {"feedforward": controller.feedforward, "feedback": controller.feedback}
    found = []
    for name in names:
        table, _, key = name.partition(".")
        if name.startswith("velocity_filter["):
            found.append(controller.velocity_filter[int(name[16:-1])])
        elif table == "filter":
            found.append(float(getattr(controller.filter, key)))
        elif key:
            found.append(tables[table][key])
        else:
            found.append(float(controller.settings[name]))
    return found


def moved(controller: Controller, names: tuple[str, ...], step: Array) -> Controller:
    """Return a controller with some values changed; the weights of its velocity still sum to 1."""
    new = dict(zip(names, np.add(values(controller, names), step).tolist(), strict=True))
    taps = list(controller.velocity_filter)
    for i in range(1, len(taps)):
        taps[i] = new.get(f"velocity_filter[{i}]", taps[i])
    if len(taps) > 1 and "velocity_filter[1]" in new:
        taps[0] = 1.0 - sum(taps[1:])
    own = {k: v for k, v in new.items() if k in controller.settings}
    shape = {k[7:]: v for k, v in new.items() if k.startswith("filter.")}
    return replace(
        controller,
        settings={**controller.settings, **own},
        velocity_filter=tuple(taps),
        feedforward={k: new.get(f"feedforward.{k}", v) for k, v in controller.feedforward.items()},
        feedback={k: new.get(f"feedback.{k}", v) for k, v in controller.feedback.items()},
        filter=replace(controller.filter, **shape) if controller.filter else None,
    )
