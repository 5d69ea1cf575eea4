"""The true held-out figure of a diagnosis, which only the generator can give.

The hold-out experiment is run again twelve times with fresh noise: same axis, motion, known inputs,
hidden effects and background. On each of these records the diagnosed loop is simulated as the
diagnosis does it on its own hold-out: effects frozen at the values in `theta`, the four base
parameters tuned again on the record's whitened command error (by the whitener of the diagnosis's
floor, over the samples it kept), then the rms of the plain force error over these samples. The mean
square of the twelve is the true held-out error, to a per cent; a stated 95 % interval of `after`
should hold it in 95 cases of 100, and that of `after_frozen` the same without the tuning. The floor
is what the noise alone does to the command: the rms difference, as force, between the noisy
hold-out and the same run without random force, encoder noise and quantisation. No model can do
better on average.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import signal

from .cases import Case, again
from .experiments import play, record

if TYPE_CHECKING:
    from ivtools.gap import Diagnosis
    from ivtools.loop import ClosedLoop
    from ivtools.record import Record

BASE = ("inertia", "viscous", "coulomb", "offset")
_ROUNDS = 3  # Gauss-Newton steps: the start is within a few per cent


@dataclass(frozen=True)
class Truth:
    """True held-out force errors, N or N m rms.

    Parameters
    ----------
    before, after : float
        Without and with the effects of the diagnosis.
    after_frozen : float
        As `after`, with the base parameters of the record that was diagnosed.
    spread : float
        Standard deviation of `after` from noise to noise.
    floor : float
        What the noise alone makes.
    """

    before: float
    after: float
    after_frozen: float
    spread: float
    floor: float

    @property
    def closed(self) -> float:
        """Fraction of the reducible part, `before` less `floor`, that is closed."""
        reducible = self.before - self.floor
        return (self.before - self.after) / reducible if reducible > 0.0 else float("nan")

    def to_dict(self) -> dict[str, float]:
        """Return the JSON."""
        return {**asdict(self), "closed": self.closed}


def measure(case: Case, gap: Diagnosis, loop: ClosedLoop, count: int = 12) -> Truth | None:
    """Return the true held-out figures; None if the diagnosis compared nothing."""
    import ivtools as iv

    if gap.shrink is None or gap.traces is None:
        return None
    rng = np.random.default_rng([2, *str(case.label["parameters"]).encode()])
    keep, whitener = gap.traces.keep, gap.floors[-1].whitener
    added = 1.0 + gap.parity[-1].mismatch.get("added", 0.0)
    phases = {n for t in gap.loop.terms for n in t.phases}  # a matter of each record
    own = {n: v for n, (_, v) in gap.replication.items() if n in phases}
    after, frozen, before = [], [], []
    for _ in range(count):
        experiment = again(rng, case)
        fresh = iv.Record.from_dict(
            record(case.axis, experiment, play(case.axis, case.effects, experiment)), name="fresh"
        )
        before.append(_rms(loop, fresh, _base(gap.theta), keep, whitener))
        if fresh.added is not None:
            fresh = replace(fresh, added=added * fresh.added)
        after.append(_rms(gap.loop, fresh, gap.theta, keep, whitener))
        frozen.append(_rms(gap.loop, fresh, {**gap.theta, **own}, keep, whitener, rounds=0))
    spread = float(np.std(after))
    return Truth(_mean(before), _mean(after), _mean(frozen), spread, floor(case, keep))


def floor(case: Case, keep: np.ndarray) -> float:
    """Return the rms, as force, of what noise makes of the command of the hold-out."""
    noisy = case.experiments[1]
    quiet = replace(noisy.silent(), force=case.steady[1])
    difference = [play(case.axis, case.effects, x)[1] for x in (noisy, quiet)]
    gain = case.axis.gain * case.axis.mass * case.axis.length
    return gain * float(np.sqrt(np.mean((difference[0] - difference[1])[keep] ** 2)))


def _base(theta: Mapping[str, float]) -> dict[str, float]:
    return {n: theta[n] for n in BASE}


def _rms(
    loop: ClosedLoop,
    fresh: Record,
    theta: Mapping[str, float],
    keep: np.ndarray,
    whitener: np.ndarray,
    rounds: int = _ROUNDS,
) -> float:
    """Tune the base parameters on a record; return the rms force error of the kept samples."""
    values: dict[str, Any] = dict(theta)

    def errors(v: Mapping[str, float]) -> np.ndarray:
        simulated = loop.simulate(fresh, v)
        return loop.gain * (loop.command(fresh) - simulated.nu)[:, 0]

    def white(e: np.ndarray) -> np.ndarray:
        return signal.lfilter(whitener, [1.0], e)[keep]

    raw = errors(values)
    for _ in range(rounds):
        e = white(raw)
        steps = {n: 0.01 * max(abs(values[n]), 0.05 * abs(theta["coulomb"])) for n in BASE}
        J = np.column_stack(
            [white(errors({**values, n: values[n] + h}) - raw) / h for n, h in steps.items()]
        )
        if not (np.isfinite(e).all() and np.isfinite(J).all()):  # the loop diverges, or nearly so
            break
        scale = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
        move = np.linalg.lstsq(J / scale, -e, rcond=1e-8)[0] / scale
        trial = {**values, **{n: values[n] + m for n, m in zip(BASE, move, strict=True)}}
        trial["inertia"] = float(
            np.clip(trial["inertia"], values["inertia"] / 3, values["inertia"] * 3)
        )
        new = errors(trial)
        if not np.sum(white(new) ** 2) < np.sum(e**2):
            break
        values, raw = trial, new
    return float(np.sqrt(np.mean(raw[keep] ** 2)))


def _mean(x: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(x))))
