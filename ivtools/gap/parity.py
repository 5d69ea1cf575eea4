"""Controller parity: whether the recorded command follows from the measured position.

The control law is fed with the measured position and compared with the recorded command. That
needs no model of the plant, and separates a wrong controller, a log that is shifted in time, a
limit that nobody declared, and an added input that was not applied as recorded, from everything
behind the command.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from ..errors import IVToolsError
from ..limits import LARGEST
from ..linalg import block_covariance
from ..loop import ClosedLoop, Controller
from ..loop.controllers import ANTI_WINDUP, Seen
from ..loop.identification import ControllerFit
from ..record import Record
from .between import interpolated
from .rules import (
    ADDED_LEAST,
    AT_LIMIT,
    AT_TOP,
    CUT,
    CUT_SHARE,
    DELAY_TOLD,
    FASTER,
    FASTER_LATE,
    FASTER_TOLD,
    FLAT,
    FLATTER,
    GAIN_ERROR,
    GAIN_EXPLAINS,
    GAIN_NEEDED,
    GAIN_RANGE,
    GAIN_STEPS,
    GAIN_T,
    GROSS_GAIN,
    LAW_BETTER,
    LAW_ERROR,
    LAW_R2,
    LIMIT_LEAVES,
    LIMIT_SAMPLES,
    MAX_DELAY,
    NEAR_TOP,
    NOISY_GAIN,
    ON_GRID,
    ONE_PLACE,
    OVER_LIMIT,
    PARITY_BLOCKS,
    PARITY_HEAD,
    PARITY_POOR,
    ROUGHEST,
    ROUNDING,
    SITS,
)

Array = NDArray[np.float64]

SUMMED = "pulses"  # name of a column: an added input that goes through the limit
_MOVE = 1e-3  # of a gain, in its finite differences


@dataclass(frozen=True)
class Parity:
    """What the controller shows.

    Parameters
    ----------
    loop : ClosedLoop
        The loop with the controller that the record shows.
    before, after : float
        Relative parity error as declared and as found, 1.
    declared : Controller
        The controller of the axis file.
    mismatch : mapping
        Relative errors of the settings, those that are significant.
    clipped : float
        Share of the samples in which the command sits at its limit.
    read : ControllerFit or None
        The law that the record shows, looked for where the declared one, its settings put right,
        leaves more than `PARITY_POOR`.
    taken : bool
        Whether it is taken instead: it explains the command, and much better.
    at : float or None
        Time, s, around which nearly all of the error lies that is left; None if there is none such.
    oversampling : int
        Samples of the controller from one sample of the log to the next.
    """

    loop: ClosedLoop
    before: float
    after: float
    declared: Controller
    mismatch: dict[str, float]
    clipped: float
    read: ControllerFit | None = None
    taken: bool = False
    at: float | None = None
    oversampling: int = 1

    @property
    def delay(self) -> int:
        """Samples from the measured position to the recorded command."""
        return self.loop.controller.delay

    @property
    def limit(self) -> float | None:
        """A limit of the command below the declared one, if there is one."""
        limit = self.loop.controller.limit
        return limit if limit < self.declared.limit else None

    @property
    def trustworthy(self) -> bool:
        """Whether the law, as corrected or read from the record, reproduces the command."""
        return self.after < LAW_ERROR or self.taken

    @property
    def found(self) -> dict[str, float]:
        """What the axis file has not: relative errors, feed-forwards, or another law's gains."""
        if not self.taken:
            return self.mismatch
        law = self.loop.controller
        fed = {f"feedforward.{k}": v for k, v in law.feedforward.items()}
        fed |= {f"feedback.{k}": v for k, v in law.feedback.items()}
        if law.kind == self.declared.kind:
            known = {*self.declared.mismatches}
            return {**self.mismatch, **{k: v for k, v in fed.items() if k not in known}}
        own = {f"law.{k}": float(v) for k, v in law.settings.items() if np.ndim(v) == 0}
        return own | fed


def at_rate(loop: ClosedLoop) -> int:
    """Return the oversampling that is known of a declared loop; 0: its records show it.

    A law that is identified has the rate of the log that it was identified from.
    """
    return int(loop.controller.kind == "identify")


def check(record: Record, loop: ClosedLoop, read: bool = True, oversampling: int = 0) -> Parity:
    """Compare the recorded command with the law fed with the measured position.

    Parameters
    ----------
    record : Record
        With a reference.
    loop : ClosedLoop
        Its controller is the one declared.
    read : bool
        Whether the record is asked for its own law where the declared one explains little.
    oversampling : int
        Samples of the controller per sample of the log; 0: as the record shows.

    Returns
    -------
    Parity
    """
    found = _compared(record, loop, read, oversampling)
    extra = 0.0 if found.taken else found.mismatch.get("added", 0.0)
    if abs(extra) <= GROSS_GAIN:
        return found
    # of another size or sign, it hides where the law sits at its limit: as it acts, once more
    assert record.added is not None
    known = replace(record, added=(1.0 + extra) * record.added)
    again = _compared(known, loop, read, oversampling)
    more = again.mismatch.get("added", 0.0)
    return replace(
        again,
        before=found.before,
        mismatch={**again.mismatch, "added": (1.0 + extra) * (1.0 + more) - 1.0},
    )


def _compared(record: Record, loop: ClosedLoop, read: bool, oversampling: int) -> Parity:
    """Compare them, the added input being what was recorded; read another law if that is asked."""
    if oversampling > 1:
        return replace(
            _checked(interpolated(record, oversampling), loop)[0], oversampling=oversampling
        )
    found, signals = _checked(record, loop)
    found = found if oversampling else _between(record, loop, found)
    limited = found.limit is not None and found.after**2 < LIMIT_LEAVES  # behind it it is right
    known = not read or limited or found.oversampling > 1 or found.after <= PARITY_POOR
    return found if known else _read(found, signals, record, loop)


def _checked(record: Record, loop: ClosedLoop) -> tuple[Parity, Signals]:
    """Return how the declared law compares, and the signals, which know their limit."""
    signals = Signals(record, loop)
    declared = signals.error(loop.controller, loop.controller.delay, 0.0)
    signals, limit, at_limit = _limit(signals, loop.controller)
    free = ~at_limit
    if signals.share(declared) > ROUNDING:
        kept, delay = _best_delay(signals, loop.controller, free)
    else:
        kept, delay = {}, loop.controller.delay
    controller = _corrected(loop.controller, delay, kept, limit)
    error = signals.error(controller, delay, kept.get("added", 0.0))
    found = Parity(
        loop=replace(loop, controller=controller),
        before=signals.share(declared),
        after=signals.share(error),
        declared=loop.controller,
        mismatch=kept,
        clipped=float(np.mean(at_limit)),
        at=_once(error, record.t),
    )
    return found, signals


def _between(record: Record, loop: ClosedLoop, found: Parity) -> Parity:
    """Return how the law compares if its controller takes several samples for each of the log.

    It does if the law explains more between the samples, with all its settings as declared, than
    it does with others at the samples.
    """
    declared = loop.controller.delay
    if found.after <= ROUNDING or not (found.mismatch or found.delay != declared):
        return found
    limited = replace(loop.controller, limit=found.loop.controller.limit)
    part = record.liveliest(FASTER_TOLD)
    added = found.mismatch.get("added", 0.0)
    here = Signals(part, loop)
    left = here.error(found.loop.controller, found.delay, added)[PARITY_HEAD:]
    most = min(np.linalg.norm(left), LAW_ERROR * np.linalg.norm(here.command[PARITY_HEAD:]))
    tried = {}
    for count in FASTER:
        fine = Signals(interpolated(part, count), loop)
        error = fine.error(limited, declared, 0.0)[count * PARITY_HEAD :: count]
        tried[count] = float(np.linalg.norm(error))
    count = min(tried, key=lambda n: tried[n])
    if tried[count] < most:
        one, _ = _checked(interpolated(record, count), loop)
        if not one.mismatch and abs(one.delay - declared) < FASTER_LATE * count:
            law = replace(one.loop.controller, delay=declared)
            return replace(one, loop=replace(loop, controller=law), oversampling=count)
    return found


def _once(error: Array, t: Array) -> float | None:
    """Return the time around which nearly all of an error lies, s, if there is one."""
    energy = np.append(0.0, np.cumsum(error[PARITY_HEAD:] ** 2))
    k = int(np.argmax(np.abs(error[PARITY_HEAD:])))
    near = energy[min(k + PARITY_HEAD, len(energy) - 1)] - energy[max(k - PARITY_HEAD, 0)]
    return float(t[PARITY_HEAD + k]) if near > ONE_PLACE * energy[-1] else None


def _read(found: Parity, signals: Signals, record: Record, loop: ClosedLoop) -> Parity:
    """Return the parity with the law that the record shows, if that explains more."""
    try:
        fit = loop.identify_controller(record)[1]
    except IVToolsError:
        return found
    limit = loop.controller.limit if found.limit is None else found.limit
    law = replace(fit.controller, limit=limit)
    after = signals.share(signals.error(law, law.delay, 0.0))
    left = 1.0 - fit.r2 if fit.low_pass else after**2
    better = left < LAW_BETTER * found.after**2
    if not better or fit.r2 < LAW_R2:
        return replace(found, read=fit)
    same = law.kind == loop.controller.kind
    mismatch = _differences(loop.controller, law, fit) if same else {}
    return replace(
        found,
        loop=replace(loop, controller=law),
        after=after,
        mismatch=mismatch,
        read=fit,
        taken=True,
    )


def _differences(declared: Controller, law: Controller, fit: ControllerFit) -> dict[str, float]:
    """Return relative errors of the settings that two laws of a kind have in common."""
    least = NOISY_GAIN if fit.low_pass else GAIN_ERROR
    pairs = {
        k: (float(declared.full[k]), float(law.full[k]))
        for k in declared.mismatches
        if k in declared.full and k in law.full
    }
    found = {k: new / old - 1.0 for k, (old, new) in pairs.items() if old}
    return {k: v for k, v in found.items() if abs(v) > least}


def at_limit(
    records: Sequence[Record], loop: ClosedLoop, checked: Sequence[Parity]
) -> tuple[list[Record], ClosedLoop, list[Parity]]:
    """Return how records show that the command was limited: they, the loop, and their parity.

    Whoever has not stated a limit has not stated what an integrator does there either, nor whether
    an added input goes through it: if so, it is a feed-forward, `SUMMED`. What is declared stays
    where it explains the command, or nothing else does much better.
    """
    law, dt = loop.controller, records[0].dt
    declared = list(records), loop, list(checked)
    if max(p.after for p in checked) <= PARITY_POOR:
        return declared
    clamped = replace(law, anti_windup="clamp")
    ends = ANTI_WINDUP if clamped.law(dt).hold.any() else (law.anti_windup,)
    laws = [replace(law, anti_windup=end) for end in ends]
    ways = [(list(records), one) for one in laws if one != law]
    added = any(r.added is not None and r.added.any() for r in records)
    if added and not any(beyond(loop.command(r), law.limit) for r in records):
        summed = [_summed(r, law.delay) for r in records]
        fed = {**law.feedforward, SUMMED: 1.0}
        ways += [(summed, replace(one, feedforward=fed)) for one in laws]

    def left(tried: tuple[list[Record], ClosedLoop, list[Parity]]) -> float:
        return sum(p.after**2 for p in tried[2])

    tried = []
    for given, one in ways:
        other = replace(loop, controller=one)
        found = [check(r, other, read=False, oversampling=1) for r in given]
        tried.append((given, other, found))
    best = min(tried, key=left, default=declared)
    limited = any(p.clipped for p in best[2])
    return best if limited and left(best) < LAW_BETTER * left(declared) else declared


def beyond(command: Array, limit: float) -> bool:
    """Whether a command, (n_samples, ...), exceeds what it is said to be limited to."""
    return int(np.sum(np.abs(command) > OVER_LIMIT * limit)) >= LIMIT_SAMPLES


def _summed(record: Record, delay: int) -> Record:
    """Return a record whose added input is one that the law itself adds, as early as it is late."""
    n = record.n_samples
    added = np.zeros(n) if record.added is None else record.added[:, 0]
    column = np.concatenate([added[delay:], np.zeros(min(delay, n))])
    return record.replace(added=None, extra={**record.extra, SUMMED: column})


def relative(checked: Sequence[Parity], setting: str) -> bool:
    """Whether what records show of a setting is the relative error of one that was declared."""
    shown = [p for p in checked if setting in p.found]
    return bool(shown) and all(setting in (*p.mismatch, "added") for p in shown)


def effects(
    checked: tuple[Parity, ...],
) -> tuple[list[str], dict[str, dict[str, float]]]:
    """Return what the controller itself shows, decided at parity level."""
    effects, values = [], {}
    limits = [p.limit for p in checked if p.limit is not None]
    if limits:
        effects.append("saturation")
        values["saturation"] = {"limit": float(np.mean(limits))}
    found = [p.found for p in checked]
    names = {n for values in found for n in values}
    if names:
        effects.append("controller-mismatch")
        values["controller-mismatch"] = {
            n: float(np.mean([values[n] for values in found if n in values])) for n in sorted(names)
        }
    return effects, values


def grid(x: Array) -> float:
    """Return the step of which all values of a signal, (n_samples,), are multiples; 0 if none."""
    apart = np.diff(np.unique(x))
    apart = apart[apart > 2.0 * np.spacing(np.max(np.abs(x)))]  # of two ways to write one number
    if not len(apart):
        return 0.0
    step = float(np.min(apart))
    steps = (x - x[0]) / step
    return step if np.max(np.abs(steps - np.round(steps))) < ON_GRID else 0.0


class Signals:
    """What a control law sees, and what was recorded."""

    def __init__(self, record: Record, loop: ClosedLoop) -> None:
        self.record, self.joint, self.dt = record, loop.joint, record.dt
        self.added = record.added[:, 0] if record.added is not None else np.zeros(record.n_samples)
        self.whole = loop.command(record)
        self.command = self.whole[:, 0]
        self.step = grid(self.command)
        self.limit = loop.controller.limit  # at which the record was clipped
        self.least = _least(np.abs(self.own), self.limit, AT_LIMIT, self.step)  # from where on

    @property
    def own(self) -> Array:
        """Recorded command of the law itself, without the added input, (n_samples,)."""
        return np.asarray(self.command - self.added)

    def limited(self, limit: float, least: float) -> Signals:
        """Return the same of a record that was clipped there, and sits there from `least` on."""
        other = copy(self)
        other.limit, other.least = limit, least
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
        left, whole = (float(np.linalg.norm(x[PARITY_HEAD:])) for x in (error, self.command))
        return left / whole

    def error(self, controller: Controller, delay: int, added: float) -> Array:
        """Return recorded minus expected command, (n,)."""
        expected = np.clip(self.law(controller, delay), -controller.limit, controller.limit)
        return self.command - expected - (1.0 + added) * self.added


def _finite(command: Array) -> Array:
    """Return the command of a law, (n,); zeros, of an unstable one that overflows."""
    return command if (np.abs(command) < LARGEST).all() else np.zeros_like(command)


def _limit(
    signals: Signals, controller: Controller
) -> tuple[Signals, float | None, NDArray[np.bool_]]:
    """Return signals that know their limit, one that nobody declared, and where they sit at any.

    The top of a command that was measured, as a current is, is as flat as its noise lets it.
    """
    own = np.abs(signals.own)
    largest, top = float(np.max(own)), _top(own, signals.step)
    noisy = top[1] in (AT_TOP * largest, np.inf)
    for level, least in (_level(signals, controller, own), top) if noisy else (top,):
        at_top = own > least
        if at_top.sum() < LIMIT_SAMPLES:
            continue
        found = signals.limited(min(level, controller.limit), least)
        law = found.law(controller, controller.delay)
        cut = at_top & _cut(found, law, level)
        mostly = cut.sum() > CUT_SHARE * at_top.sum()
        if cut.sum() >= LIMIT_SAMPLES and (mostly or _explains(found, controller, law, cut)):
            declared = largest >= AT_LIMIT * controller.limit
            return found, None if declared else level, at_top
    return signals, None, own >= signals.least


def _top(own: Array, step: float) -> tuple[float, float]:
    """Return the largest command and the least from which it sits there, if it does.

    A smooth peak that is sampled fast has many samples near its top as well.
    """
    largest = float(np.max(own))
    least = AT_TOP * largest
    sits = np.median(own[own >= least]) >= least + SITS * (largest - least)
    return largest, _least(own, largest, AT_TOP, step) if sits else np.inf


def _least(own: Array, limit: float, share: float, step: float) -> float:
    """Return from which command on it sits at a limit: a share of it, or all where the log has it.

    An integrator that is taken to stand while the command comes near is wrong from then on. What
    is left of a rounded command without its added input is off by a step at most.
    """
    exact = (1.0 - ROUNDING) * limit - step
    return exact if np.sum(own >= exact) >= LIMIT_SAMPLES else share * limit


def _level(signals: Signals, controller: Controller, own: Array) -> tuple[float, float]:
    """Return where the command is when the law gives more than it ever is, and the least of that.

    It is flat there, and the law is not. An integrator stands, for a first look, wherever the
    command is near its largest.
    """
    largest = float(np.max(own))
    near = signals.limited(largest, NEAR_TOP * largest)
    law = near.law(controller, controller.delay)
    cut = _cut(near, law, largest)
    if cut.sum() < LIMIT_SAMPLES:
        return largest, np.inf
    level, noise = float(np.median(own[cut])), stats.median_abs_deviation(own[cut])
    spread = stats.median_abs_deviation(np.abs(law[cut]))
    flat = FLAT * noise < ROUGHEST * level and noise < FLATTER * spread
    return level, min(level - FLAT * noise, AT_TOP * level) if flat else np.inf


def _cut(signals: Signals, law: Array, level: float) -> NDArray[np.bool_]:
    """Return where a law gives more than a level, with the sign of the command, (n_samples,)."""
    same = np.sign(law) == np.sign(signals.own)
    return (np.abs(law) > CUT * level) & same


def _explains(signals: Signals, controller: Controller, law: Array, cut: NDArray[np.bool_]) -> bool:
    """Whether a law gives nearly the command if it is limited, and does not if it is not.

    One with an integrator, a little wrong, may hardly exceed the limit where it begins and ends.
    The noise of the log, as it is where the law was cut, no law explains.
    """
    own = signals.own[PARITY_HEAD:]
    left = signals.own - np.clip(law, -signals.limit, signals.limit)
    noise = float(np.mean(left[cut] ** 2)) * len(own)
    limited = float(left[PARITY_HEAD:] @ left[PARITY_HEAD:]) - noise
    free = signals.limited(np.inf, np.inf).error(controller, controller.delay, 0.0)[PARITY_HEAD:]
    return limited < LIMIT_LEAVES * min(float(free @ free), float(own @ own))


def _best_delay(
    signals: Signals, controller: Controller, free: NDArray[np.bool_]
) -> tuple[dict[str, float], int]:
    """Return the mismatch that is worth a name, at the delay that explains most, and that."""
    fits = {delay: _Gains(signals, controller, delay, free) for delay in range(MAX_DELAY + 1)}
    for _ in range(GAIN_STEPS):
        for fit in fits.values():
            fit.step()
        least = min(fit.cost for fit in fits.values())
        fits = {delay: fit for delay, fit in fits.items() if fit.cost <= DELAY_TOLD * least}
    delay = min(fits, key=lambda k: fits[k].cost)
    return _material(signals, controller, fits[delay]), delay


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
        self.e = self._error(self.x)
        self.columns = np.zeros((len(self.e), len(self.names)))

    def _error(self, x: Array) -> Array:
        """Return the parity error at these mismatches, (n_rows,)."""
        values = dict(zip(self.names, x, strict=True))
        added = values.pop("added", 0.0)
        law = self.controller.with_mismatch(**values)
        return self.signals.error(law, self.delay, added)[self.rows]

    @property
    def cost(self) -> float:
        """Energy of the parity error."""
        return float(self.e @ self.e)

    @property
    def values(self) -> dict[str, float]:
        """The mismatch."""
        return dict(zip(self.names, self.x.tolist(), strict=True))

    @property
    def tvalues(self) -> dict[str, float]:
        """Block-robust t values."""
        t = np.abs(self.x) / np.maximum(_deviations(self.columns, self.e), 1e-300)
        return dict(zip(self.names, t.tolist(), strict=True))

    def step(self) -> None:
        """Take a Gauss-Newton step."""
        if not self.names:
            return
        least = [ADDED_LEAST if n == "added" else GAIN_RANGE[0] for n in self.names]
        moved = [self._error(self.x + _MOVE * one) for one in np.eye(len(self.names))]
        self.columns = np.column_stack([(e - self.e) / _MOVE for e in moved])
        x = self.x - np.linalg.lstsq(self.columns, self.e, rcond=1e-8)[0]
        self.x = np.clip(x, least, GAIN_RANGE[1])
        self.e = self._error(self.x)


def _deviations(columns: Array, e: Array) -> Array:
    """Return block-robust standard deviations."""
    bread = np.linalg.pinv(columns.T @ columns)
    parts = np.array_split(np.arange(len(e)), PARITY_BLOCKS)
    firsts = np.array([rows[0] for rows in parts if len(rows)], dtype=np.intp)
    meat = block_covariance(columns * e[:, np.newaxis], firsts)
    return np.sqrt(np.maximum(np.diag(bread @ meat @ bread), 0.0))


def _material(
    signals: Signals,
    controller: Controller,
    fit: _Gains,
) -> dict[str, float]:
    """Keep what is significant, worth a name, and explains the parity error."""
    tvalues = fit.tvalues
    kept = {n: v for n, v in fit.values.items() if abs(v) > GAIN_ERROR and tvalues[n] > GAIN_T}

    def energy(values: dict[str, float]) -> float:
        """Return the energy of the parity error that is left with these mismatches put right."""
        changed = replace(_corrected(controller, fit.delay, values, None), limit=np.inf)
        error = signals.error(changed, fit.delay, values.get("added", 0.0))
        return float(np.sum(error[fit.rows] ** 2))

    if not kept or energy(kept) > (1.0 - GAIN_EXPLAINS) * energy({}):
        return {}
    for name in sorted(kept, key=lambda n: tvalues[n])[: len(kept) - 1]:
        fewer = {n: v for n, v in kept.items() if n != name}
        if energy(fewer) < GAIN_NEEDED * energy(kept):
            kept = fewer
    return kept


def _corrected(
    controller: Controller, delay: int, mismatch: dict[str, float], limit: float | None
) -> Controller:
    found = controller.with_mismatch(**mismatch) if mismatch else controller
    return replace(found, delay=delay, limit=controller.limit if limit is None else limit)
