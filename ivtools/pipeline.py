"""Pipeline: from sampled signals to the rows of the regression.

Band-pass, trim, align, mask and parallel decimation, in that order, for measured and simulated
signals alike: what is filtered on one side only becomes an error in the regressor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ivtools.errors import IVToolsError, ShapeError

Array = NDArray[np.float64]

# glibc gives the filters' buffers back to the system after every fit, whose next one then spends a
# third of its time on page faults, unless it has seen a larger block come and go: 31 MB, untouched.
np.empty(31 << 17)

DECIMATION_ORDER = 8  # Chebyshev type I, as MATLAB's `decimate`
DECIMATION_RIPPLE_DB = 0.05
SLOWEST = 1e-6  # cut-off, of the sampling frequency; poles closer to 1 are 1 to rounding
_AT_ONCE = 2_000_000  # numbers


class Motion(NamedTuple):
    """Position, velocity and acceleration.

    Attributes
    ----------
    q, dq, ddq : (n, n_joints) ndarray
        In m, m/s, m/s^2 or rad, rad/s, rad/s^2.
    """

    q: Array
    dq: Array
    ddq: Array


class Filter(NamedTuple):
    """A filter, and the state in which it is at rest.

    Attributes
    ----------
    sos : (n_sections, 6) ndarray
        Second-order sections.
    rest : (n_sections, 2, 1) ndarray
        State behind a constant input of 1.
    """

    sos: Array
    rest: Array

    @classmethod
    def of(cls, sos: Array) -> Filter:
        """Complete second-order sections."""
        return cls(sos, signal.sosfilt_zi(sos)[:, :, np.newaxis])


@dataclass(frozen=True)
class Pipeline:
    """How sampled signals become rows of the regression.

    Parameters
    ----------
    cutoff_hz : float or None
        Cut-off of the forward-backward Butterworth low-pass on the position; None for no
        low-pass (derivatives only). With the differences that follow it makes the band-pass.
    decimation : int
        Parallel decimation factor; 1 keeps every sample and filters nothing.
    order : int
        Order of the Butterworth filter, of one pass.
    trim : tuple of int
        Samples dropped at the head and at the tail of the record.
    force_shift : float
        Delay of the force, in samples, whole or fractional. +0.5 means that the force at sample k
        is the mean of tau[k-1] and tau[k]: a command held over the sample acts in between.
    min_speed : float
        Rows where the speed is below this are dropped (m/s or rad/s); 0 keeps every row. The speed
        is the measured one or, of methods with a simulation, in the end the simulated one
        (`Problem.masked_by`).
    guard : int
        Samples dropped on either side of a slow sample as well.
    blank : bool
        Set what is trimmed, and what is dropped for its speed, to 0 before the decimation, whose
        filter otherwise spreads it over the rows that stay, and starts from a sample of noise.
        0 = 0 theta holds whatever theta, so nothing else changes.
    breaks : tuple of int
        Samples before which others are missing (`Record.breaks`): each stretch between them is
        filtered, differentiated, trimmed and decimated by itself.

    Raises
    ------
    IVToolsError
        If a setting makes no sense.

    References
    ----------
    M. Gautier, "Dynamic identification of robots with power model", ICRA 1997;
    A. Janot, P.-O. Vandanjon, M. Gautier, IEEE Trans. Control Syst. Technol. 22, 2014.

    Examples
    --------
    >>> import numpy as np
    >>> pipeline = Pipeline(cutoff_hz=100.0, decimation=10, trim=(49, 0))
    >>> motion = pipeline.differentiate(np.sin(np.linspace(0, 20, 2000)), dt=1e-3)
    >>> pipeline.rows(np.hstack(motion)).shape
    (196, 3)
    """

    cutoff_hz: float | None
    decimation: int
    order: int = 4
    trim: tuple[int, int] = (0, 0)
    force_shift: float = 0.0
    min_speed: float = 0.0
    guard: int = 0
    blank: bool = False
    breaks: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Refuse settings that make no sense."""
        cutoff, trim = self.cutoff_hz, self.trim
        rules = {
            "cutoff_hz": (
                cutoff is None or 0.0 < cutoff < np.inf,
                "must be positive and finite; None switches the low-pass off",
            ),
            "decimation": (_is_whole(self.decimation, 1), "must be a whole number, 1 or more"),
            "order": (_is_whole(self.order, 1), "must be a whole number, 1 or more"),
            "trim": (
                np.shape(trim) == (2,) and all(_is_whole(n, 0) for n in trim),
                "must be two whole numbers of samples (head, tail), 0 or more",
            ),
            "force_shift": (
                bool(np.isfinite(self.force_shift)),
                "must be a finite number of samples",
            ),
            "min_speed": (0.0 <= self.min_speed < np.inf, "must be 0 or more, in m/s or rad/s"),
            "guard": (_is_whole(self.guard, 0), "must be a whole number of samples, 0 or more"),
            "blank": (isinstance(self.blank, bool), "must be true or false"),
        }
        for name, (holds, rule) in rules.items():
            _require(holds, name, getattr(self, name), rule)

    @classmethod
    def from_bandwidth(cls, natural_hz: float, sampling_hz: float, **overrides: Any) -> Pipeline:
        """Return the pipeline that suits a closed loop of this natural frequency.

        Parameters
        ----------
        natural_hz, sampling_hz : float
            Natural (dynamic) frequency of the closed loop and sampling frequency, in Hz.
        **overrides
            Any parameter of `Pipeline`, used instead of the rule's.

        Returns
        -------
        Pipeline
            Cut-off at 5 times and decimation to 2 times the natural frequency, with 0.8 of the
            Nyquist band kept; the head, five periods of the cut-off, is trimmed.

        Raises
        ------
        IVToolsError
            If a frequency is not positive or the cut-off reaches the Nyquist frequency.

        Examples
        --------
        >>> Pipeline.from_bandwidth(20.0, 1000.0)  # doctest: +ELLIPSIS
        Pipeline(cutoff_hz=100.0, decimation=10, order=4, trim=(49, 0), ...)
        """
        _require(0.0 < natural_hz < np.inf, "natural_hz", natural_hz, "must be positive")
        _require(0.0 < sampling_hz < np.inf, "sampling_hz", sampling_hz, "must be positive")
        cutoff_hz = overrides.pop("cutoff_hz", 5.0 * natural_hz)
        thinning = 0.8 * (0.5 * sampling_hz) / (2.0 * natural_hz)
        settings: dict[str, Any] = {
            "decimation": max(1, int(thinning + 0.5)),
            "trim": (max(0, round(sampling_hz / natural_hz) - 1), 0),
        }
        if cutoff_hz is not None:
            _check_nyquist(cutoff_hz, sampling_hz)
            settings["trim"] = (max(0, round(5.0 * sampling_hz / cutoff_hz) - 1), 0)
        return cls(cutoff_hz, **(settings | overrides))

    def _stretches(self, n: int) -> list[slice]:
        edges = (0, *self.breaks, n)
        return [slice(a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]

    @property
    def _one(self) -> Pipeline:
        """The pipeline of a stretch."""
        return replace(self, breaks=())

    def broken(self, breaks: tuple[int, ...]) -> Pipeline:
        """Return the pipeline of a record with these breaks."""
        return self if breaks == self.breaks else replace(self, breaks=breaks)

    def inside(self, n: int) -> NDArray[np.bool_]:
        """Return which of n samples are not trimmed, (n,)."""
        head, tail = self.trim
        inside = np.zeros(n, dtype=bool)
        for rows in self._stretches(n):
            inside[rows.start + head : rows.stop - tail] = True
        return inside

    def differentiate(self, q: Array, dt: float, filtered: bool = True) -> Motion:
        """Low-pass the position and differentiate it twice by central differences.

        Parameters
        ----------
        q : (n, n_joints) or (n,) array_like
            Position, in m or rad.
        dt : float
            Sampling step, in s.
        filtered : bool
            False leaves the low-pass out, for signals without noise.

        Returns
        -------
        Motion
            q, dq and ddq, (n, n_joints) each; the differences are one-sided at the ends.

        Raises
        ------
        IVToolsError
            If the cut-off is not below the Nyquist frequency or the signal is too short.

        Examples
        --------
        >>> import numpy as np
        >>> t = np.arange(500) * 1e-3
        >>> motion = Pipeline(None, 1).differentiate(0.5 * t**2, 1e-3)
        >>> bool(np.allclose(motion.ddq[2:-2], 1.0))
        True
        """
        q = _columns(q)
        if self.breaks:
            each = [self._one.differentiate(q[s], dt, filtered) for s in self._stretches(len(q))]
            return Motion(*(np.concatenate(parts) for parts in zip(*each, strict=True)))
        if filtered and self.cutoff_hz is not None:
            _check_nyquist(self.cutoff_hz, 1.0 / dt)
            q = _forward_backward(
                _butterworth(self.order, 2.0 * self.cutoff_hz * dt), q, pad=3 * self.order
            )
        dq = _central_difference(q, dt)
        return Motion(q, dq, _central_difference(dq, dt))

    def align(self, tau: Array) -> Array:
        """Shift a force in time by `force_shift` samples; the ends are held.

        Parameters
        ----------
        tau : (n, n_joints) or (n,) array_like
            Force or torque, held over each sample.

        Returns
        -------
        ndarray
            The force at the time of the position samples, of the same shape.

        Examples
        --------
        >>> import numpy as np
        >>> Pipeline(None, 1, force_shift=0.5).align(np.array([0.0, 2.0, 4.0]))
        array([0., 1., 3.])
        """
        tau = np.asarray(tau, dtype=float)
        if self.force_shift == 0.0:
            return tau
        if self.breaks:
            return np.concatenate([self._one.align(tau[s]) for s in self._stretches(len(tau))])
        _require(
            abs(self.force_shift) < len(tau),
            "force_shift",
            self.force_shift,
            f"must be shorter than the record of {len(tau)} samples",
        )
        whole = int(np.floor(self.force_shift))
        part = self.force_shift - whole
        aligned = (1.0 - part) * _lagged(tau, whole)
        if part:
            aligned += part * _lagged(tau, whole + 1)
        return aligned

    def samples(self, n: int, speed: Array | None = None) -> NDArray[np.intp]:
        """Return the indices of the record's samples that become rows.

        Parameters
        ----------
        n : int
            Number of samples of the record.
        speed : (n,) or (n, 1) array_like, optional
            Velocity that decides the mask, in m/s or rad/s; needed if `min_speed` is not 0.

        Returns
        -------
        (n_rows,) ndarray of int
            After trimming, thinning (the last sample stays, as in MATLAB) and masking.

        Raises
        ------
        IVToolsError
            If nothing is left.

        Examples
        --------
        >>> Pipeline(None, 10, trim=(49, 0)).samples(100)
        array([49, 59, 69, 79, 89, 99])
        """
        kept = np.concatenate([self._thinned(rows) for rows in self._stretches(n)])
        remedy = "trim less or take a longer record"
        if self.cutoff_hz:
            remedy += (
                f"; where a loop asks for a low-pass as slow as {self.cutoff_hz:g} Hz, check its "
                "gains, the unit of the command, and whether the axis ran away"
            )
        _require(len(kept) > 0, "trim", self.trim, f"leaves nothing of {n} samples; {remedy}")
        if self.min_speed == 0.0:
            return kept
        moving = self.moving(n, speed)[kept]
        _require(
            bool(moving.any()),
            "min_speed",
            self.min_speed,
            "masks every row; lower it, or shorten the guard",
        )
        return kept[moving]

    def _thinned(self, rows: slice) -> NDArray[np.intp]:
        """Return the samples of a stretch that are neither trimmed nor thinned out."""
        first, stop = rows.start + self.trim[0], rows.stop - self.trim[1]
        offset = (stop - first - 1) % self.decimation
        return np.arange(first + offset, max(stop, first), self.decimation)

    def rows(self, columns: Array, speed: Array | None = None) -> Array:
        """Trim, decimate and mask columns: one filter call for all of them.

        Parameters
        ----------
        columns : (n, m) or (n,) array_like
            Columns at the sampling rate, such as an observation matrix beside its force.
        speed : (n,) or (n, 1) array_like, optional
            Velocity that decides the mask; the same speed gives the same rows.

        Returns
        -------
        (n_rows, m) or (n_rows,) ndarray
            Decimated as MATLAB's `decimate`: Chebyshev type I low-pass of order 8 with 0.05 dB
            ripple and a cut-off of 0.8 of the new Nyquist frequency, forward and backward.

        Raises
        ------
        IVToolsError
            If no row is left or the record is too short for the filter.

        Examples
        --------
        >>> import numpy as np
        >>> Pipeline(None, 10).rows(np.ones((2000, 4))).shape
        (200, 4)
        """
        columns = np.asarray(columns, dtype=float)
        if self.breaks:
            return self._each(columns, speed)
        samples = self.samples(len(columns), speed)
        if self.decimation == 1:
            return columns[samples]
        head, tail = (0, 0) if self.blank else self.trim
        kept = columns[head : len(columns) - tail]
        if self.blank:
            kept = np.where(self._used(len(kept), speed)[:, np.newaxis], _columns(kept), 0.0)
        kept, sos = _columns(kept), _chebyshev(self.decimation)
        out, width = np.empty((len(samples), kept.shape[1]), order="F"), _width(len(kept))
        for first in range(0, kept.shape[1], width):
            block = slice(first, first + width)
            smooth = _forward_backward(sos, kept[:, block], pad=3 * DECIMATION_ORDER)
            out[:, block] = smooth[samples - head]
        return out.reshape(-1, *columns.shape[1:])

    def _each(self, columns: Array, speed: Array | None) -> Array:
        """Return the rows of each stretch, one below the other; some may have none."""
        found, kept = [], np.zeros(len(columns), dtype=bool)
        kept[self.samples(len(columns), speed)] = True
        for rows in self._stretches(len(columns)):
            if kept[rows].any():
                part = None if speed is None else speed[rows]
                found.append(self._one.rows(columns[rows], part))
        return np.concatenate(found)

    def _used(self, n: int, speed: Array | None) -> NDArray[np.bool_]:
        """Return which of n samples are neither trimmed nor masked, (n,)."""
        used = np.ones(n, dtype=bool) if self.min_speed == 0.0 else self.moving(n, speed)
        used[: self.trim[0]] = False
        used[n - self.trim[1] :] = False
        return used

    def moving(self, n: int, speed: Array | None) -> NDArray[np.bool_]:
        """Return which of n samples have none slower than `min_speed` within the guard, (n,)."""
        if speed is None:
            raise IVToolsError(
                f"min_speed = {self.min_speed:g} needs the speed of every sample; "
                "pass speed, or set min_speed = 0"
            )
        slow = np.abs(np.asarray(speed, dtype=float).reshape(-1)) < self.min_speed
        if len(slow) != n:
            raise ShapeError(f"speed has {len(slow)} samples and the columns {n}; both must match")
        return np.concatenate([self._guarded(slow[rows]) for rows in self._stretches(n)])

    def _guarded(self, slow: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which samples of a stretch have no slow one within the guard."""
        n = len(slow)
        until = np.concatenate([[0], np.cumsum(slow, dtype=np.int32)])
        k = np.arange(n)
        last = np.minimum(k + self.guard + 1, n)
        return np.asarray(until[last] == until[np.maximum(k - self.guard, 0)])


def _width(n: int) -> int:
    """Return how many columns of n samples are filtered at once: all, but of a long record."""
    return max(1, _AT_ONCE // n)


def _require(holds: bool, name: str, value: object, rule: str) -> None:
    """Raise the one-line error of a setting unless its rule holds."""
    if not holds:
        raise IVToolsError(f"{name} = {value} {rule}")


def _is_whole(number: object, least: int) -> bool:
    """Whether a setting is an integer of at least this value."""
    return isinstance(number, int | np.integer) and bool(number >= least)


def _check_nyquist(cutoff_hz: float, sampling_hz: float) -> None:
    """Refuse a cut-off that the sampling rate cannot carry."""
    _require(cutoff_hz > 0.0, "cutoff_hz", f"{cutoff_hz:g}", "must be positive")
    _require(
        cutoff_hz < 0.5 * sampling_hz,
        "cutoff_hz",
        f"{cutoff_hz:g}",
        f"must be below half of the sampling frequency, {0.5 * sampling_hz:g} Hz; "
        "lower it, or None switches the low-pass off",
    )
    _require(
        cutoff_hz >= SLOWEST * sampling_hz,
        "cutoff_hz",
        f"{cutoff_hz:g}",
        f"must be at least {SLOWEST * sampling_hz:g} Hz, a millionth of the sampling frequency: "
        "nothing of a record is as slow",
    )


def _columns(x: Array) -> Array:
    """Return an array of (n, m), 1-D input promoted."""
    x = np.asarray(x, dtype=float)
    if x.ndim not in (1, 2):
        raise ShapeError(f"a signal has {x.ndim} dimensions; give (n,) or (n, n_joints)")
    return x[:, np.newaxis] if x.ndim == 1 else x


@lru_cache(maxsize=64)
def _butterworth(order: int, cutoff: float) -> Filter:
    """Low-pass of this order; the cut-off as a fraction of Nyquist."""
    return Filter.of(signal.butter(order, cutoff, output="sos"))


@lru_cache(maxsize=64)
def _chebyshev(decimation: int) -> Filter:
    """Anti-alias filter of the decimation."""
    cutoff = 0.8 / decimation
    return Filter.of(signal.cheby1(DECIMATION_ORDER, DECIMATION_RIPPLE_DB, cutoff, output="sos"))


def _forward_backward(low_pass: Filter, x: Array, pad: int) -> Array:
    """Filter columns (n, m) forward and backward with `pad` samples of odd reflection.

    Second-order sections stay accurate where the transfer function's coefficients do not (a low
    cut-off at a high sampling rate). The padding is that of the transfer function's form,
    3 x (taps - 1), which the sections' own default is not. At most two copies are alive at a time.
    """
    n = len(x)
    if n <= pad:
        raise ShapeError(f"{n} samples are too few for the filter; it needs more than {pad}")
    padded = np.empty((n + 2 * pad, x.shape[1]), order="F")
    padded[pad : pad + n] = x
    padded[:pad] = 2.0 * x[0] - x[pad:0:-1]
    padded[pad + n :] = 2.0 * x[-1] - x[-2 : -pad - 2 : -1]
    sos, rest = low_pass
    forward, _ = signal.sosfilt(sos, padded, axis=0, zi=rest * padded[0])
    del padded
    backward, _ = signal.sosfilt(sos, forward[::-1], axis=0, zi=rest * forward[-1])
    return backward[pad + n - 1 : pad - 1 : -1] if pad else backward[::-1]


def _central_difference(x: Array, dt: float) -> Array:
    """Differentiate columns (n, m): central, one-sided at the ends, as `numpy.gradient`."""
    if len(x) < 2:
        raise ShapeError(f"{len(x)} sample is too few to differentiate; give at least 2")
    dx = np.empty_like(x)
    np.subtract(x[2:], x[:-2], out=dx[1:-1])
    dx[1:-1] /= 2.0 * dt
    dx[0] = (x[1] - x[0]) / dt
    dx[-1] = (x[-1] - x[-2]) / dt
    return dx


def _lagged(x: Array, lag: int) -> Array:
    """Return x[k - lag], the ends held."""
    if lag >= 0:
        return np.concatenate([np.repeat(x[:1], lag, axis=0), x[: len(x) - lag]])
    return np.concatenate([x[-lag:], np.repeat(x[-1:], min(-lag, len(x)), axis=0)])
