"""Patterns: references of one axis that show one thing well: friction, frequency, inertia."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..errors import AxisError
from ..loop import ClosedLoop
from ..pipeline import Motion
from ..trapezoids import trapezoid
from .excitation import Excitation
from .information import Information
from .limits import Limits

Array = NDArray[np.float64]

SPEEDS = 8  # of the steps, from a fiftieth of the limit upwards
SLOWEST = 0.02
DWELL = 0.3  # s at rest between two moves
LOWEST_HZ, WAVES = 0.2, 0.25  # of a sweep: where it begins; share of the rate, where it would end
FAST_HZ = 20.0


def pattern(
    loop: ClosedLoop,
    limits: Limits,
    kind: str,
    *,
    seconds: float = 20.0,
    rate_hz: float = 1000.0,
    seed: int = 0,
) -> Excitation:
    """Return a pattern for one axis, within its limits.

    Parameters
    ----------
    loop : ClosedLoop
    limits : Limits
        Of one joint.
    kind : {"steps", "sweep", "bang-bang"}
        Strokes at constant speeds from slow to fast, which show friction; sines that quicken, which
        show modes and delays; moves at full acceleration with dwells between, which show
        inertia and what happens at standstill.
    seconds, rate_hz, seed
        As for `fourier`.

    Raises
    ------
    AxisError
        If there is no such pattern, or several joints.
    """
    if kind not in PATTERNS:
        raise AxisError(f"pattern {kind!r} is unknown; use fourier, {', '.join(PATTERNS)}")
    if limits.n_joints != 1:
        raise AxisError(f"{kind} is for one axis; robots are excited by fourier")
    n = round(seconds * rate_hz)
    q = PATTERNS[kind](limits, n, 1.0 / rate_hz, np.random.default_rng(seed))
    dq = np.gradient(q, 1.0 / rate_hz)
    motion = Motion(*(x[:, np.newaxis] for x in (q, dq, np.gradient(dq, 1.0 / rate_hz))))
    information = Information(loop, limits)
    return Excitation(
        np.arange(n) / rate_hz,
        motion,
        information.effort(motion),
        information.condition(motion),
        limits,
        kind,
    )


def _move(distance: float, speed: float, acceleration: float, dt: float) -> Array:
    """Return a move from rest to rest at a speed, positions from 0, as fast as it may."""
    size = abs(distance)
    top = min(speed, np.sqrt(acceleration * size))
    ramp, level = top / acceleration, size / top - top / acceleration
    t = np.arange(np.ceil((2.0 * ramp + level) / dt) + 1.0) * dt
    return np.sign(distance) * np.minimum(trapezoid(t, top, ramp, ramp + level), size)


def _chained(moves: list[Array], start: float, n: int, dt: float) -> Array:
    """Return the moves that fit, one after the other with dwells between, held at the end, (n,)."""
    rest = round(DWELL / dt)
    parts, at = [np.full(rest, start)], start
    for move in moves:
        if sum(map(len, parts)) + len(move) + rest > n:
            break
        parts += [at + move, np.full(rest, at + move[-1])]
        at += float(move[-1])
    q = np.concatenate(parts)
    if len(parts) == 1:
        raise AxisError("no move fits into that time; allow more seconds, or more speed")
    return np.append(q, np.full(n - len(q), at))[:n]


def _ends(limits: Limits) -> tuple[float, float, float, float]:
    return (
        float(limits.lower[0]),
        float(limits.upper[0]),
        float(limits.speed[0]),
        float(limits.acceleration[0]),
    )


def _steps(limits: Limits, n: int, dt: float, rng: np.random.Generator) -> Array:
    """Make strokes there and back at one speed each, as long as the time allows."""
    lower, upper, speed, acceleration = _ends(limits)
    speeds = speed * np.geomspace(SLOWEST, 1.0, SPEEDS)
    share = n * dt / SPEEDS / 2.0 - 2.0 * DWELL  # s for each stroke
    moves = []
    for v in speeds:
        stroke = min(upper - lower, v * max(share - v / acceleration, 0.2 * share))
        moves += [_move(s * stroke, float(v), acceleration, dt) for s in (1.0, -1.0)]
    return _chained(moves, lower, n, dt)


def _sweep(limits: Limits, n: int, dt: float, rng: np.random.Generator) -> Array:
    """Quicken a sine, as large as position, speed and acceleration allow at each frequency."""
    lower, upper, speed, acceleration = _ends(limits)
    t = np.arange(n) * dt
    highest = min(WAVES / dt, FAST_HZ)
    w = 2.0 * np.pi * LOWEST_HZ * (highest / LOWEST_HZ) ** (t / t[-1])
    phase = np.cumsum(w) * dt
    most = np.stack([np.full(n, 0.5 * (upper - lower)), speed / w, acceleration / w**2])
    size = np.sum(most**-4.0, axis=0) ** -0.25  # the least of them, without corners
    fade = np.minimum(np.minimum(t, t[-1] - t) * LOWEST_HZ * 2.0, 1.0)
    q = size * fade**2 * (3.0 - 2.0 * fade) * np.sin(phase)
    dq = np.gradient(q, dt)
    over = (
        np.abs(q).max() / (0.5 * (upper - lower)),
        np.abs(dq).max() / speed,
        np.abs(np.gradient(dq, dt)).max() / acceleration,
    )
    return 0.5 * (lower + upper) + q / max(1.0, *over)


def _bang_bang(limits: Limits, n: int, dt: float, rng: np.random.Generator) -> Array:
    """Go from place to place at full acceleration, and dwell there."""
    lower, upper, speed, acceleration = _ends(limits)
    at, moves = 0.5 * (lower + upper), []
    for _ in range(int(n * dt / DWELL)):
        to = float(rng.uniform(lower, upper))
        moves.append(_move(to - at, speed, acceleration, dt))
        at = to
    return _chained(moves, 0.5 * (lower + upper), n, dt)


PATTERNS: dict[str, Callable[[Limits, int, float, np.random.Generator], Array]] = {
    "steps": _steps,
    "sweep": _sweep,
    "bang-bang": _bang_bang,
}
