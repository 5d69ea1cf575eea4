"""Rough inertia: a first guess from the record alone, whatever else acts on the axis.

Filters need a bandwidth and iterations a start before anything is identified. A pendulum, a strong
spring or a slope can be larger than all that accelerates the axis, whether or not the model has
it: the force is therefore also regressed on what a force over the position looks like, 1, q, q^2,
q^3 and, where the axis turns, sin q and cos q.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ..errors import AxisError, IVToolsError
from ..linalg import covariance
from ..pipeline import Pipeline
from ..record import Record

if TYPE_CHECKING:
    from .closed_loop import ClosedLoop

Array = NDArray[np.float64]

_RIGID = ("inertia", "viscous", "coulomb", "offset")
_WIDEST, _STEP, _PERIODS = 0.2, 2.5, 8.0  # cut-offs tried: of the rate, apart, in the record
_THINNED, _TRIMMED = 0.25, 8  # of its period: from row to row; 1 / of a record, cut off at most
_BROAD = 10.0  # times the narrowest cut-off: at which sizes are compared
_SLOW = 0.05  # of the rms speed: below, the direction of motion may be noise
_FEWEST = 40  # rows of a regression
_NOTHING = 1e-8  # share of a column's norm that is rounding
_WITHIN = 1e-6  # share of a column outside a span that it belongs to
_AGREE, _CLEAR, _SURE = 3.0, 2.0, 6.0  # standard errors: the same, not 0, an accusation
_ALIKE = 0.8  # correlation of an accusation


class Shown(NamedTuple):
    """The inertia that a record shows, kg or kg m2.

    Attributes
    ----------
    inertia, std_error : float
    correlation : float
        Of acceleration and force, without what the other terms explain of both.
    """

    inertia: float = 0.0
    std_error: float = np.inf
    correlation: float = 0.0

    @property
    def t(self) -> float:
        """The inertia in standard errors."""
        return self.inertia / self.std_error if self.std_error > 0.0 else 0.0

    @property
    def clear(self) -> bool:
        """Whether it is certainly not 0."""
        return abs(self.t) > _CLEAR

    @property
    def negative(self) -> bool:
        """Whether the force certainly pushes against the acceleration, and does little else.

        A large unknown force, such as that of a compensation or from outside, may well be against
        the acceleration; with a wrong sign nearly all of the force is.
        """
        return self.t < -_SURE and self.correlation < -_ALIKE


def position_columns(q: Array, joint: str) -> Array:
    """Return what a force over the position may look like, (n_samples, 4), or 6 where it turns.

    Polynomials to the third order over the stroke, so that no unit matters, and sine and cosine.

    Parameters
    ----------
    q : (n_samples,) ndarray
        Position, m or rad.
    joint : str
        ``"prismatic"`` or ``"revolute"``.

    Examples
    --------
    >>> position_columns(np.linspace(0.0, 1.0, 5), "revolute").shape
    (5, 6)
    """
    low, high = float(np.min(q)), float(np.max(q))
    place = (2.0 * q - low - high) / (high - low) if high > low else np.zeros_like(q)
    turning = [np.sin(q), np.cos(q)] if joint == "revolute" else []
    return np.column_stack([np.polynomial.legendre.legvander(place, 3), *turning])


def start_values(X: Array, y: Array, positions: Array) -> Array:
    """Return least squares, (p,), while any force over the position may act beside the model.

    What of the model is itself such a force (an offset, a spring, gravity) is fitted last, to what
    the rest leaves.

    Parameters
    ----------
    X, y : (N, p), (N,) ndarray
        Observation matrix and force.
    positions : (N, m) ndarray
        Rows of `position_columns`.

    Examples
    --------
    >>> q = np.linspace(0.0, 1.0, 9)
    >>> X = np.column_stack([np.cos(9.0 * q), np.ones(9)])
    >>> start_values(X, X @ [2.0, 3.0] - 50.0 * q**3, position_columns(q, "prismatic"))[0].round(6)
    np.float64(2.0)
    """
    size = np.maximum(np.linalg.norm(X, axis=0), np.finfo(float).tiny)
    U = _basis(positions)
    own = _beside(U, X / size)  # (N, p)
    moves = np.linalg.norm(own, axis=0) > _WITHIN
    theta = np.zeros(X.shape[1])
    theta[moves] = np.linalg.lstsq(own[:, moves], _beside(U, y), rcond=_NOTHING)[0]
    left = y - X / size @ theta
    theta[~moves] = np.linalg.lstsq((X / size)[:, ~moves], left, rcond=_NOTHING)[0]
    return theta / size


def beside_position(signals: Array, q: Array, joint: str) -> Array:
    """Return what no force over the position explains of signals, (n_samples, k).

    Parameters
    ----------
    signals : (n_samples, k) ndarray
    q, joint
        As for `position_columns`.

    Examples
    --------
    >>> q = np.linspace(0.0, 1.0, 9)
    >>> bool(np.allclose(beside_position(2.0 * q[:, None] ** 3, q, "prismatic"), 0.0))
    True
    """
    return _beside(_basis(position_columns(q, joint)), signals)


def _beside(basis: Array, columns: Array) -> Array:
    """Return columns without their part in the span of an orthonormal basis."""
    return columns - basis @ (basis.T @ columns)


def _basis(columns: Array) -> Array:
    """Return an orthonormal basis of what these columns span, (N, rank)."""
    size = np.linalg.norm(columns, axis=0)
    U, s, _ = np.linalg.svd(columns[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    return U[:, s > _NOTHING * np.max(s, initial=0.0)]


def rough_inertia(loop: ClosedLoop, record: Record) -> float:
    """Return a first guess of the inertia from the record alone, kg or kg m2.

    The terms of the model alone decide, unless a force over the position would change their
    answer; where a motion cannot tell the inertia from such a force (a sine and a spring), the
    size of force and acceleration is all there is.

    Raises
    ------
    AxisError
        If the force certainly pushes against the acceleration, whatever depends on the position.

    Examples
    --------
    >>> import ivtools as iv
    >>> 80.0 < rough_inertia(iv.axes.emps(), iv.datasets.twin()) < 110.0
    True
    """
    plain, free = shown_inertia(loop, record)
    if free.negative:
        raise AxisError(
            f"the record suggests an inertia of {free.inertia:.3g}; check units and the sign of "
            "the command, or give [model.start] inertia in the axis file"
        )
    if plain.inertia > 0.0 and abs(plain.inertia - free.inertia) < _AGREE * free.std_error:
        return plain.inertia
    return free.inertia if free.clear and free.inertia > 0.0 else _by_size(loop, record)


def shown_inertia(loop: ClosedLoop, record: Record) -> tuple[Shown, Shown]:
    """Return the inertia of a regression along the smoothed motion, at the best cut-off.

    Noise hides the acceleration behind a wide low-pass, a narrow one leaves nothing of it: the
    cut-off at which force and acceleration are alike most is taken. (Not the one with the least
    standard error: noise that the controller answers shows an inertia as well, a false one, and
    many samples make it certain.) It is found once per model and record.

    Returns
    -------
    plain, free : Shown
        With the terms of the model, and with any force over the position beside them.
    """
    found = _FOUND.setdefault(record, {})
    model = (tuple((t.name, t.law) for t in loop.terms), tuple(sorted(loop.start.items())))
    key = (loop.gain, loop.delay, loop.joint, *model)
    if key not in found:
        found[key] = _found(loop, record.liveliest())
    return found[key]


def _found(loop: ClosedLoop, record: Record) -> tuple[Shown, Shown]:
    length = record.n_samples * record.dt
    cutoff, plain, free = _WIDEST * record.sampling_hz, _Regression(), _Regression()
    while cutoff * length > _PERIODS:
        try:
            rows = _rows(cutoff, loop, record)
        except IVToolsError:  # too short for this filter, or nothing moves behind it
            rows = np.zeros((0, len(_RIGID)))
        count = rows.shape[1] - _over_position(loop)
        plain = max(plain, _regressed(rows[:, :count]), key=_clarity)
        free = max(free, _regressed(rows), key=_clarity)
        cutoff /= _STEP
    return plain.shown, free.shown


def _clarity(regression: _Regression) -> float:
    return abs(regression.correlation)


def _over_position(loop: ClosedLoop) -> int:
    return position_columns(np.zeros(1), loop.joint).shape[1]


class _Regression(NamedTuple):
    """Acceleration and force (N,), without what other columns explain of both, if they show any."""

    acceleration: Array | None = None
    force: Array | None = None
    correlation: float = 0.0

    @property
    def shown(self) -> Shown:
        """The inertia, with its standard error."""
        x, y = self.acceleration, self.force
        if x is None or y is None:
            return Shown()
        inertia = float(x @ y / (x @ x))
        variance = covariance(x[:, None], y - inertia * x, debiased=True)[0, 0]
        return Shown(inertia, float(np.sqrt(variance)), self.correlation)


def _regressed(rows: Array) -> _Regression:
    """Return what force, acceleration and other columns show, (N, 2 + p)."""
    size = np.linalg.norm(rows, axis=0)
    if len(rows) < _FEWEST + rows.shape[1] or not size[:2].all():
        return _Regression()
    U = _basis(rows[:, 2:])
    y, x = _beside(U, rows[:, :2]).T
    if not np.linalg.norm(x) > _NOTHING * size[1]:
        return _Regression()
    length = np.linalg.norm(x) * max(float(np.linalg.norm(y)), _NOTHING * size[0])
    return _Regression(x, y, float(x @ y / length))


def _rows(cutoff_hz: float, loop: ClosedLoop, record: Record) -> Array:
    """Return force, acceleration, the terms' other columns and those over the position, (N, m)."""
    width = record.sampling_hz / cutoff_hz
    trim = min(round(width), record.longest.n_samples // _TRIMMED)
    decimation = max(1, int(_THINNED * width))
    shift = 0.5 + loop.delay / record.dt  # a command is held over the sample
    pipeline = Pipeline(
        cutoff_hz, decimation, trim=(trim, trim), force_shift=shift, breaks=record.breaks
    )
    motion = pipeline.differentiate(record.q, record.dt)
    terms = [t for t in loop.terms if t.law is not None and t.name not in _RIGID]
    force = loop.force(record) if record.load is None else loop.force(record) - record.load
    force, t = pipeline.align(force), record.t - record.t[0]
    columns = loop.with_terms(*_RIGID, *terms).regressor(motion, force, t)
    columns = np.hstack([force, columns, position_columns(motion.q[:, 0], loop.joint)])
    slowest = _SLOW * float(np.sqrt(np.mean(motion.dq**2)))
    pipeline = replace(pipeline, min_speed=slowest, guard=decimation)
    return pipeline.rows(columns, motion.dq)


def _by_size(loop: ClosedLoop, record: Record) -> float:
    """Return the inertia that would need all of the changing force, kg or kg m2."""
    cutoff = min(_BROAD * _PERIODS / (record.n_samples * record.dt), _WIDEST * record.sampling_hz)
    force, ddq = _rows(cutoff, loop, record)[:, :2].T
    return float(np.std(force) / np.std(ddq))


_FOUND: WeakKeyDictionary[Record, dict[Any, tuple[Shown, Shown]]] = WeakKeyDictionary()
