"""Backgrounds that no effect of the library is: forces that have no name there.

Most come again: a force along the motion that the axis makes without it, which a stiff loop hardly
leaves. Those of time alone do not: each record has its own.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import signal

from .axes import DT

_STROKE, _SPEED, _FORCE = 0.245, 0.15, 20.0  # m, m/s, N: of the motions and axes that are drawn

#: Force along position, m, and speed, m/s, (n_samples,) each; up to a factor.
Force = Callable[[np.ndarray, np.ndarray], np.ndarray]
Draw = Callable[[np.random.Generator], Force]


def _direction(v: np.ndarray) -> np.ndarray:
    return np.tanh(v / (0.002 * _SPEED))


def _smooth(rng: np.random.Generator, q: float, v: float, count: int = 10) -> Force:
    """Return a random smooth function; `q` and `v` turn it so often over stroke and speed."""
    W = rng.normal(size=(count, 2)) * np.array([4.0 * q / _STROKE, 2.0 * v / _SPEED])
    phase, size = rng.uniform(0.0, 6.28, count), rng.normal(size=count)
    return lambda x, w: np.cos(np.outer(x, W[:, 0]) + np.outer(w, W[:, 1]) + phase) @ size


def _by_direction(rng: np.random.Generator) -> Force:
    """Return two random functions of position, one for each direction."""
    even, odd = _smooth(rng, 1.5, 0.0), _smooth(rng, 1.5, 0.0)
    return lambda q, v: even(q, v) + odd(q, v) * _direction(v)


def _wave(rng: np.random.Generator, power: int) -> Force:
    """Return friction, dry (0) or viscous (1), that is periodic over position."""
    k, phase = 2.0 * np.pi / rng.uniform(0.0018, 0.01), rng.uniform(0.0, 6.28)
    size = (_direction, lambda v: v / _SPEED)[power]
    return lambda q, v: np.cos(k * q + phase) * size(v)


def _leaky(x: np.ndarray, seconds: float) -> np.ndarray:
    """Return a signal that forgets: a first-order lag."""
    a = np.exp(-DT / seconds)
    return np.asarray(signal.lfilter([1.0 - a], [1.0, -a], x))


def _warming(rng: np.random.Generator) -> Force:
    """Return friction that falls with the power of late, and comes back."""
    tau, depth = rng.uniform(2.0, 8.0), rng.uniform(3.0, 8.0)
    return lambda q, v: -np.tanh(depth * _leaky(np.abs(v) / _SPEED, tau)) * _direction(v)


def _creep(rng: np.random.Generator) -> Force:
    """Return a force that relaxes after every move: a seal, a belt."""
    tau = 10.0 ** rng.uniform(-0.7, 0.5)
    return lambda q, v: _leaky(v, tau)


def _relaxing(rng: np.random.Generator) -> Force:
    """Return friction that takes its time to change its sign."""
    tau = 10.0 ** rng.uniform(-1.3, 0.0)
    return lambda q, v: _leaky(_direction(v), tau)


def _gain(rng: np.random.Generator) -> Force:
    """Return what a drive misses whose gain depends on position and speed."""
    shape, inertia = _smooth(rng, 1.0, 1.0), rng.uniform(60.0, 140.0)

    def force(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        drive = inertia * np.gradient(v, DT) + 200.0 * v + _FORCE * _direction(v)
        return np.asarray(drive * shape(q, v))

    return force


def _swinging(rng: np.random.Generator) -> Force:
    """Return the pull of a mass that swings beside: a pendulum, a liquid, another axis."""
    w, z = 2.0 * np.pi * 10.0 ** rng.uniform(-0.3, 0.9), rng.uniform(0.01, 0.2)
    b, a = signal.bilinear([w * w, 0.0], [1.0, 2.0 * z * w, w * w], 1.0 / DT)
    return lambda q, v: np.asarray(signal.lfilter(b, a, v))


def _hysteresis(rng: np.random.Generator) -> Force:
    """Return the force of several springs that slip, each at its own stretch (Prandtl)."""
    widths, sizes = 10.0 ** rng.uniform(-3.0, -1.5, 4), rng.uniform(0.2, 1.0, 4)

    def force(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        total = np.zeros(len(q))
        for width, size in zip(widths, sizes, strict=True):
            z, moves = 0.0, np.diff(q, prepend=q[0])
            for i, move in enumerate(moves.tolist()):
                z = min(max(z + move, -width), width)
                total[i] += size * z / width
        return total

    return force


def _weather(rng: np.random.Generator) -> Force:
    """Return a slow force that nothing in the record explains: wind, a hose that moves."""
    sos = signal.butter(2, 10.0 ** rng.uniform(-0.7, 0.5), fs=1.0 / DT, output="sos")

    def force(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        lead = round(5.0 / DT)  # until it no longer knows that it began
        return np.asarray(signal.sosfilt(sos, rng.normal(size=lead + len(q)))[lead:])

    return force


def _second_axis(rng: np.random.Generator) -> Force:
    """Return the reaction of another axis, which accelerates and brakes on its own programme."""
    least, share = rng.uniform(0.3, 1.0), rng.uniform(0.1, 0.5)  # s; of a move, to speed up

    def force(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        total, start, way = np.zeros(len(q)), rng.uniform(0.0, least), 1.0
        while (at := round(start / DT)) < len(q):
            move = least * rng.uniform(1.0, 2.0)
            ramp = round(share * move / DT)
            total[at : at + ramp] += way
            stop = at + round(move / DT)
            total[stop - ramp : stop] -= way
            start, way = start + move + least * rng.uniform(0.0, 2.0), -way
        return total

    return force


def _hum(rng: np.random.Generator) -> Force:
    """Return the force of a machine beside: a pump, a fan, of one speed."""
    w = 2.0 * np.pi * 10.0 ** rng.uniform(0.5, 1.7)
    return lambda q, v: np.sin(w * DT * np.arange(len(q)) + rng.uniform(0.0, 6.28))


#: Name to the draw of a force.
KINDS: dict[str, Draw] = {
    "smooth": lambda r: _smooth(r, r.uniform(0.5, 1.5), r.uniform(0.5, 1.5)),
    "curly": lambda r: _smooth(r, r.uniform(2.0, 6.0), r.uniform(0.5, 2.0)),
    "uneven": lambda r: _smooth(r, r.uniform(3.0, 10.0), 0.0, 30),
    "direction": _by_direction,
    "periodic-friction": lambda r: _wave(r, 0),
    "periodic-viscous": lambda r: _wave(r, 1),
    "warming": _warming,
    "creep": _creep,
    "relaxing": _relaxing,
    "gain": _gain,
    "swinging": _swinging,
    "hysteresis": _hysteresis,
    "weather": _weather,
    "second-axis": _second_axis,
    "hum": _hum,
}
#: Those of time alone.
OF_TIME = ("weather", "second-axis", "hum")


def draw(rng: np.random.Generator, kind: str, paths: list[np.ndarray]) -> list[np.ndarray]:
    """Return one unknown force, N, (n_samples,), along the positions of both records, m.

    Its size is 4 to 30 % of the dry friction of the axes that are drawn, rms.
    """
    force = KINDS[kind](rng)
    both = [force(q, np.gradient(q, DT)) for q in paths]
    size = _FORCE * 10.0 ** rng.uniform(np.log10(0.04), np.log10(0.3))
    scale = size / float(np.sqrt(np.mean([np.var(f) for f in both])))
    return [-scale * f for f in both]
