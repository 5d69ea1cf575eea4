"""References: what a simulated axis is told to do."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import cycle
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import IVToolsError
from ivtools.trapezoids import trapezoid

if TYPE_CHECKING:
    from ivtools.record import Record

Array = NDArray[np.float64]

MOST_LINES = 1000
STROKES = (0.24, 0.16, 0.08, 0.04, 0.02, 0.01)  # m
SPEEDS = (0.15, 0.10, 0.06, 0.04, 0.02, 0.01)  # m/s


class Reference(Protocol):
    """What a reference offers; write your own as a frozen dataclass."""

    @property
    def duration(self) -> float:
        """Length of the record, s."""
        ...

    def position(self, t: Array) -> Array:
        """Return the position reference (n,) at the times (n,), m or rad."""
        ...

    def scaled(self, factor: float) -> Reference:
        """Return the same reference with its amplitude multiplied."""
        ...


@dataclass(frozen=True)
class Trapezoids:
    """Moves out and back with a trapezoidal velocity, each stroke at its own speed, in turn.

    As many whole moves are made as fit; all are slowed by what is left of the time.

    Parameters
    ----------
    duration : float
        s.
    strokes, speeds : tuple of float
        Lengths (m or rad) and cruising speeds (m/s or rad/s) of the moves.
    acceleration : float
        m/s2 or rad/s2.
    pause : float
        Rest behind each stroke, s.

    Examples
    --------
    >>> import numpy as np
    >>> reference = Trapezoids(duration=2.0, strokes=(0.1,), speeds=(0.2,), acceleration=1.0)
    >>> reference.position(np.array([0.0, 0.7, 1.4])).round(6) + 0.0  # there and back
    array([0. , 0.1, 0. ])
    """

    duration: float = 10.0
    strokes: tuple[float, ...] = STROKES
    speeds: tuple[float, ...] = SPEEDS
    acceleration: float = 1.2
    pause: float = 0.0

    def __post_init__(self) -> None:
        _check_positive(self, "duration", "strokes", "speeds", "acceleration")
        if not 0.0 <= self.pause < np.inf:
            raise IVToolsError(f"Trapezoids pause = {self.pause!r} must be 0 or more, and finite")
        if len(self.strokes) != len(self.speeds):
            raise IVToolsError(
                f"{len(self.strokes)} strokes and {len(self.speeds)} speeds; give one per move"
            )

    def position(self, t: Array) -> Array:
        """Return the position reference (n,) at the times (n,)."""
        return _moves(t, self.strokes, self.speeds, self.acceleration, self.pause)

    def scaled(self, factor: float) -> Trapezoids:
        """Return the same moves, longer and faster by this factor."""
        strokes = tuple(factor * s for s in self.strokes)
        return replace(self, strokes=strokes, speeds=tuple(factor * s for s in self.speeds))


@dataclass(frozen=True)
class BangBang:
    """Time-optimal moves out and back: full acceleration, then full deceleration.

    Parameters
    ----------
    duration : float
        s.
    strokes : tuple of float
        Lengths of the moves, in turn, m or rad.
    acceleration : float
        m/s2 or rad/s2.

    Examples
    --------
    >>> import numpy as np
    >>> BangBang(strokes=(0.25,), acceleration=1.0).position(np.array([0.5, 1.0, 2.0])).round(6)
    array([0.125, 0.25 , 0.   ])
    """

    duration: float = 10.0
    strokes: tuple[float, ...] = STROKES
    acceleration: float = 1.2

    def __post_init__(self) -> None:
        _check_positive(self, "duration", "strokes", "acceleration")

    def position(self, t: Array) -> Array:
        """Return the position reference (n,) at the times (n,)."""
        peaks = tuple(float(np.sqrt(s * self.acceleration)) for s in self.strokes)
        return _moves(t, self.strokes, peaks, self.acceleration)

    def scaled(self, factor: float) -> BangBang:
        """Return the same moves, longer by this factor."""
        return replace(self, strokes=tuple(factor * s for s in self.strokes))


@dataclass(frozen=True)
class Multisine:
    """A sum of harmonics with Schroeder's phases, faded in from rest and out to it.

    Parameters
    ----------
    duration : float
        s.
    amplitude : float
        Largest absolute position, m or rad.
    lowest_hz, highest_hz : float
        Band of the harmonics.
    lines : int
        Number of harmonics.
    fade : float
        Time over which the motion starts and over which it ends, s.

    References
    ----------
    M. R. Schroeder, IEEE Trans. Information Theory 16(1), 1970.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(10000) * 1e-3
    >>> bool(0.09 < np.abs(Multisine(amplitude=0.1).position(t)).max() <= 0.1)
    True
    """

    duration: float = 10.0
    amplitude: float = 0.1
    lowest_hz: float = 0.1
    highest_hz: float = 2.0
    lines: int = 20
    fade: float = 0.5

    def __post_init__(self) -> None:
        _check_positive(self, "duration", "amplitude", "lowest_hz", "highest_hz", "lines", "fade")
        if self.lines > MOST_LINES:
            raise IVToolsError(f"Multisine lines = {self.lines}; at most {MOST_LINES}")

    def position(self, t: Array) -> Array:
        """Return the position reference (n,) at the times (n,)."""
        k = np.arange(self.lines)
        frequencies = np.linspace(self.lowest_hz, self.highest_hz, self.lines)
        phases = -np.pi * k * (k + 1) / self.lines
        waves = np.sin(2.0 * np.pi * np.outer(t, frequencies) + phases)
        share = np.clip(np.minimum(t, t[-1] - t) / self.fade, 0.0, 1.0)
        position = share**2 * (3.0 - 2.0 * share) * (waves @ (1.0 / frequencies))
        return self.amplitude * position / max(float(np.abs(position).max()), 1e-300)

    def scaled(self, factor: float) -> Multisine:
        """Return the same harmonics with another amplitude."""
        return replace(self, amplitude=factor * self.amplitude)


@dataclass(frozen=True, eq=False)
class Recorded:
    """The position reference of a record, replayed.

    Parameters
    ----------
    q_ref : ndarray, (n,)
        Position reference, m or rad.
    dt : float
        Its sampling step, s; at another rate it is interpolated.
    """

    q_ref: Array
    dt: float

    @classmethod
    def of(cls, record: Record) -> Recorded:
        """Take the reference of a record."""
        if record.q_ref is None:
            raise IVToolsError(f"{record.name} has no q_ref; give a record with a reference")
        return cls(record.q_ref[:, 0].copy(), record.dt)

    @property
    def duration(self) -> float:
        """Length of the record, s."""
        return len(self.q_ref) * self.dt

    def position(self, t: Array) -> Array:
        """Return the position reference (n,) at the times (n,)."""
        return np.interp(t, np.arange(len(self.q_ref)) * self.dt, self.q_ref)

    def scaled(self, factor: float) -> Recorded:
        """Return the same motion about its start with another amplitude."""
        return replace(self, q_ref=self.q_ref[0] + factor * (self.q_ref - self.q_ref[0]))


KINDS: dict[str, type] = {"trapezoids": Trapezoids, "bang-bang": BangBang, "multisine": Multisine}
"""References by their name in a study file."""


def _moves(
    t: Array,
    strokes: tuple[float, ...],
    speeds: tuple[float, ...],
    acceleration: float,
    pause: float = 0.0,
) -> Array:
    """Return moves out and back, over and over; no speed exceeds what the stroke allows.

    Only whole moves are made, and all are slowed alike so that the last ends with the record: a
    motion cut off spoils the acceleration that filters make of it, and a rest at the end says
    nothing.
    """
    limits = [(s, min(v, np.sqrt(s * acceleration))) for s, v in zip(strokes, speeds, strict=True)]
    moves = [(speed, speed / acceleration, stroke / speed) for stroke, speed in limits]
    made: list[tuple[float, float, float, float]] = []
    end = 0.0
    for speed, ramp, cruise in cycle(moves):
        if made and end + 2.0 * (ramp + cruise + pause) > t[-1]:
            break
        for sign in (1.0, -1.0):
            made.append((end, sign * speed, ramp, cruise))
            end += ramp + cruise + pause
    position, t = np.zeros_like(t), t * min(1.0, end / t[-1])
    for start, speed, ramp, cruise in made:
        position += trapezoid(t - start, speed, ramp, cruise)
    return position


def _check_positive(reference: object, *names: str) -> None:
    for name in names:
        value = getattr(reference, name)
        array = np.asarray(value, dtype=float)
        if not (array.size and np.isfinite(array).all() and (array > 0.0).all()):
            kind = type(reference).__name__
            raise IVToolsError(f"{kind} {name} = {value!r} must be positive and finite")
