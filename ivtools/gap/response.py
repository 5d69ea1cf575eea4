"""Response: how a small force on the axis shows in the command.

Around its motion the loop is linear but for standstill, so the change of the command that any
small force law makes is its force along the trajectory, filtered by one impulse response. One
pair of simulations then serves every effect in the screening, and any smooth force at all.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from ..errors import EstimationError
from ..linalg import as_columns, rms
from ..loop import ClosedLoop, Simulation
from ..physics import Term
from ..record import Record
from . import between
from .band import below
from .rules import AFTER_REVERSAL, FORGETTING, MOVES, RESPONSE_TIME, SPEED_KNOTS, SPLIT_HZ

Array = NDArray[np.float64]

#: Signals that are filtered at a time: more do not stay near the processor.
AT_ONCE = 4


@dataclass(frozen=True, eq=False)
class Response:
    """Linear response of the command, in N or N m, to a force that opposes the motion.

    Parameters
    ----------
    impulse : ndarray, (n_impulse,)
        Response to a unit force over one sample.
    n : int
        Samples of the record.
    """

    impulse: Array
    n: int

    @cached_property
    def _spectrum(self) -> tuple[int, NDArray[np.complexfloating]]:
        size = fft.next_fast_len(self.n + len(self.impulse), real=True)
        return size, fft.rfft(self.impulse, size)

    def __call__(self, force: Array, at: NDArray[np.int_] | None = None) -> Array:
        """Return the command, N or N m, that answers forces in the columns, (n_samples, ...).

        Parameters
        ----------
        force : ndarray, (n_samples, ...)
        at : ndarray of int, (n,), optional
            Samples at which it is wanted.
        """
        size, spectrum = self._spectrum
        rows = np.ascontiguousarray(force.T).reshape(-1, len(force))  # strided: twice as long
        out = np.empty((len(rows), self.n if at is None else len(at)))
        for first in range(0, len(rows), AT_ONCE):
            part = slice(first, first + AT_ONCE)
            both = fft.rfft(rows[part], size)
            both *= spectrum
            answers = fft.irfft(both, size, overwrite_x=True)
            if at is None:
                out[part] = answers[:, : self.n]
            else:
                np.take(answers, at, axis=1, out=out[part], mode="clip")
        return out.reshape(*force.T.shape[:-1], out.shape[1]).T

    def adjoint(self, signal: Array) -> Array:
        """Return the correlation of a signal with the response to a force at every sample."""
        size, spectrum = self._spectrum
        return fft.irfft(fft.rfft(signal, size) * spectrum.conj(), size)[: self.n]


def measure(
    loop: ClosedLoop, record: Record, values: Mapping[str, float], oversampling: int = 1
) -> Response:
    """Measure the impulse response on the loop without dry friction and limits.

    Its controller takes `oversampling` samples for each of the record.
    """
    linear = replace(
        loop.with_terms("inertia", "viscous"), controller=replace(loop.controller, limit=np.inf)
    )
    viscous = values.get(
        "viscous", 0.5 * (values.get("viscous_pos", 0.0) + values.get("viscous_neg", 0.0))
    )
    theta = {"inertia": values["inertia"], "viscous": viscous}
    force, at = np.zeros(record.n_samples), 20
    size = rms(loop.force(record))
    force[at] = -size
    both = (
        between.simulate(linear, record, theta, oversampling, force_noise=f)
        for f in (force, 0 * force)
    )
    answers = [simulation.nu[:, 0] for simulation in both]
    length = min(round(RESPONSE_TIME / record.dt), record.n_samples - at)
    impulse = loop.gain * (answers[0] - answers[1])[at : at + length] / size
    return Response(impulse, record.n_samples)


def features(simulation: Simulation) -> Array:
    """Return smooth force laws of speed, position, load, reversal and time, (n_samples, m).

    What they can absorb is a gap that some law of the state would explain, known or not; what they
    leave is noise, or an event.

    Parameters
    ----------
    simulation : Simulation
        Noise-free motion and force.
    """
    q, dq, tau = simulation.where, simulation.dq[:, 0], simulation.tau[:, 0]
    dt = float(simulation.t[1] - simulation.t[0])
    s, x = np.sign(dq), _along(q)
    columns = [*_speed(dq, s), *_position(x, s), *_load(tau, s), *_reversal(s, dt), *_slow(dq, s)]
    return _scaled(columns)


def leaky(x: Array, seconds: float, dt: float, start: float = 0.0) -> Array:
    """Return a signal that is forgotten: a first-order lag, and what it was before."""
    a = float(np.exp(-dt / seconds))
    return np.asarray(signal.lfilter([1.0 - a], [1.0, -a], x, zi=[a * start])[0])


def denoised(simulation: Simulation) -> Simulation:
    """Return a simulation with what its signals have at low frequency."""
    s, dt = simulation, float(simulation.t[1] - simulation.t[0])
    signals = (s.q, s.dq, s.ddq, s.nu, s.tau, s.where)
    q, dq, ddq, nu, tau, place = (below(x, SPLIT_HZ, dt) for x in signals)
    return replace(s, q=q, dq=dq, ddq=ddq, nu=nu, tau=tau, place=place)


def memories(simulation: Simulation) -> Array:
    """Return the force laws that remember the motion, (n_samples, m), of a simulation."""
    return _scaled(remembered(simulation.dq[:, 0], float(simulation.t[1] - simulation.t[0])))


def mixed(simulation: Simulation) -> Array:
    """Return the force laws of position times speed or load, (n_samples, m), of a simulation."""
    q, dq, tau = simulation.where, simulation.dq[:, 0], simulation.tau[:, 0]
    fast = np.abs(dq) / max(float(np.max(np.abs(dq))), 1e-300)
    where = _position(_along(q), np.sign(dq))
    by_speed = [w * f for w in where for f in (fast, fast**2)]
    return _scaled([*by_speed, *(w * tau for w in where[: len(where) // 2]), fast * tau])


def _along(q: Array) -> Array:
    """Return the position along the stroke, -1 to 1."""
    return np.asarray(2.0 * (q - q.min()) / max(np.ptp(q), 1e-300) - 1.0)


def remembered(v: Array, dt: float) -> list[Array]:
    """Return speed and direction as they are forgotten: a seal that relaxes, a belt that creeps."""
    return [leaky(x, seconds, dt) for seconds in FORGETTING for x in (v, np.sign(v))]


def waves(
    simulation: Simulation, terms: Iterable[Term], periods: Mapping[str, Sequence[float]]
) -> Array:
    """Return force laws periodic in position, (n_samples, m).

    Parameters
    ----------
    simulation : Simulation
        Noise-free motion and force.
    terms : iterable of Term
        Effects; waves enter with their weights.
    periods : mapping
        Spatial periods, m or rad, by the name of the effect that has them.
    """
    q, dq, tau = simulation.where, simulation.dq[:, 0], simulation.tau[:, 0]
    columns = [
        weight(term, dq, tau) * wave(2.0 * np.pi * q / p)
        for term in terms
        for p in periods.get(term.name, ())
        for wave in (np.cos, np.sin)
    ]
    return _scaled(columns) if columns else np.zeros((len(q), 0))


def weight(term: Term, dq: Array, tau: Array) -> Array:
    """Return what the wave of an effect that is periodic over position is multiplied by."""
    return np.ones(len(dq)) if term.weight is None else term.weight(dq, tau)


def _scaled(columns: list[Array]) -> Array:
    matrix = as_columns(columns)
    return np.asarray(matrix / np.maximum(np.sqrt(np.mean(matrix**2, axis=0)), 1e-300))


def _speed(dq: Array, s: Array) -> list[Array]:
    size = np.abs(dq)
    moving = size[size > MOVES * size.max()]
    if not moving.size:
        raise EstimationError("the simulated loop stands still, or diverges: nothing to compare")
    knots = np.unique(np.quantile(moving, np.linspace(0.0, 1.0, SPEED_KNOTS)))
    hats = [np.interp(size, knots, row) for row in np.eye(len(knots))]
    return [h * s for h in hats] + [h * np.abs(s) for h in hats]


def _position(x: Array, s: Array) -> list[Array]:
    waves = [x, x**2, *(f(k * np.pi * x) for k in (1, 2) for f in (np.cos, np.sin))]
    return waves + [w * s for w in waves]


def _load(tau: Array, s: Array) -> list[Array]:
    rate = np.gradient(tau)
    return [np.abs(tau), np.abs(tau) * s, rate, np.gradient(rate), np.abs(rate), np.sign(tau)]


def _reversal(s: Array, dt: float) -> list[Array]:
    start = np.flatnonzero(np.diff(s, prepend=s[0]) != 0)
    last = np.zeros(len(s))
    last[start] = start
    since = dt * (np.arange(len(s)) - np.maximum.accumulate(last))
    return [np.exp(-since / tau) * s for tau in AFTER_REVERSAL]


def _slow(dq: Array, s: Array) -> list[Array]:
    t = np.linspace(-1.0, 1.0, len(s))
    return [t, t**2, t * s, t * dq]
