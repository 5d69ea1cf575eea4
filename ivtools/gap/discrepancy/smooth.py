"""Smooth: forces that any axis may have, as hat functions of its state and of what it did before.

What an effect does must not be what these could do as well.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, signal

from ...linalg import as_columns
from ...linalg.swing import Swing
from ...loop import Simulation
from ...workers import threaded
from ..fit import Fit, normal
from ..response import leaky, remembered
from ..rules import (
    BUMPS,
    CHANCE,
    COARSE_KNOTS,
    COOLING,
    DEPENDENT,
    FIRST_KNOT,
    LEAST_KNOTS,
    MOST_KNOTS,
    POSITION_KNOTS,
    RINGING,
    RINGING_DAMPING,
    SPEED_KNOTS,
    TO_ZERO,
    WARM,
)
from ..screen import unit_forces

Array = NDArray[np.float64]

#: What a force may depend on: "drive" is the force of the drive itself, whatever the direction of
#: motion, "state" position and speed together, "gain" load times position or speed, "past" the
#: motion before, "heat" friction by how much moved before, "warm" the same where it had moved
#: before the record as well, "wave" friction that is periodic over position, "swing" what a load
#: does that hangs from the axis.
OVER = ("q", "dq", "load", "drive", "state", "gain", "past", "heat", "warm", "wave", "swing")
STATE = OVER[:3]
#: Those of friction that remembers how much the axis moved.
OF_USE = ("heat", "warm")


@dataclass(frozen=True, eq=False)
class Basis:
    """Hat functions over position, speed and load, apart for each direction, and what remembers.

    Parameters
    ----------
    knots : mapping
        Of each signal, common to both folds: ``"q"``, ``"dq"``, ``"load"``, ``"drive"``, and
        coarser ones, ``"where"`` and ``"how fast"``, of position and speed together.
    periods : tuple of float
        Of waves over position, m or rad.
    swings : tuple of Swing
        Of loads that hang from the axis.
    """

    knots: dict[str, Array]
    periods: tuple[float, ...] = ()
    swings: tuple[Swing, ...] = ()

    @classmethod
    def of(cls, runs: Sequence[Simulation], spacing: float = 0.0) -> Basis:
        """Return the basis that spans what several simulations have in common.

        Parameters
        ----------
        runs : sequence of Simulation
        spacing : float
            Distance of its knots over position, m or rad; 0 is that of any law.
        """
        q, dq, tau = map(np.concatenate, signals(runs))
        speed = np.quantile(np.abs(dq), np.linspace(FIRST_KNOT, 1.0, SPEED_KNOTS))
        drive = np.quantile(np.abs(tau), np.linspace(FIRST_KNOT, 1.0, SPEED_KNOTS))
        where, fast = COARSE_KNOTS
        fine = POSITION_KNOTS
        if spacing:
            fine = int(np.clip(np.ptp(q) / spacing, LEAST_KNOTS, MOST_KNOTS))
        return cls(
            {
                "q": np.linspace(q.min(), q.max(), fine),
                "dq": np.unique(speed),
                "load": np.linspace(0.0, float(np.max(np.abs(tau))), fast)[1:],
                "drive": np.unique(drive),
                "where": np.linspace(q.min(), q.max(), where),
                "how fast": np.linspace(0.0, float(np.max(np.abs(dq))), fast),
            }
        )

    def over(self, run: Simulation, *names: str) -> Array:
        """Return forces over one signal each, one column per hat and direction, (n_samples, m)."""
        return as_columns(h for n in names for h in self._each_way(n, run))

    def _each_way(self, name: str, run: Simulation) -> list[Array]:
        """Return the hats over a signal, and the same with the sign of the motion."""
        signed = dict(zip(("q", "dq", "load"), (x for (x,) in signals([run])), strict=True))
        x = signed[name] if name == "q" else np.abs(signed[name])
        hats, sign = self._rows(name, x), np.sign(signed["dq"])
        return [*hats, *(h * sign for h in hats)]

    def parts(self, run: Simulation) -> dict[str, Array]:
        """Return forces over each of `OVER` but those of a model's own, (n_samples, m).

        Their units are the basis's, not the run's: a coefficient is the same on every fold.
        """
        (q,), (dq,), (tau,) = signals([run])
        sign, dt = np.sign(dq), float(run.t[1] - run.t[0])
        found = {n: self.over(run, n) for n in STATE}
        found["drive"] = self.hats("drive", np.abs(tau)) * np.sign(tau)[:, None]
        where, fast = self.hats("where", q), self.hats("how fast", np.abs(dq))
        both = (where.T[:, None] * fast.T).reshape(-1, len(q)).T
        found["state"] = np.hstack([both, both * sign[:, None]])
        load = tau / max(float(self.knots["load"][-1]), 1e-300)
        found["gain"] = np.hstack([where, fast]) * load[:, None]
        found["past"] = _past(self._speed(run), dt)
        found["heat"] = np.hstack([self.heat(run, np.zeros(len(COOLING))), self.worn(run)])
        return found

    def heat(self, run: Simulation, start: Array) -> Array:
        """Return dry and viscous friction by how much the axis moved of late, (n_samples, m).

        Parameters
        ----------
        run : Simulation
        start : ndarray, (n_times,)
            How warm it was before, per time of `COOLING`: 1 is after the largest speed for long.
        """
        v = self._speed(run)
        return as_columns(w * x for w in self._use(run, start) for x in (np.sign(v), v))

    def worn(self, run: Simulation) -> Array:
        """Return the same of friction that stops falling once the axis is warm, (n_samples, m)."""
        v, use = self._speed(run), self._use(run, np.zeros(len(COOLING)))
        return as_columns(np.exp(-w / WARM) * x for w in use for x in (np.sign(v), v))

    def _use(self, run: Simulation, start: Array) -> list[Array]:
        """Return how much the axis moved of late, per time of `COOLING`, (n_samples,)."""
        v, dt = np.abs(self._speed(run)), float(run.t[1] - run.t[0])
        return [leaky(v, seconds, dt, x) for seconds, x in zip(COOLING, start, strict=True)]

    def _speed(self, run: Simulation) -> Array:
        """Return the velocity, of the largest speed, (n_samples,)."""
        return np.asarray(run.dq[:, 0] / max(float(self.knots["dq"][-1]), 1e-300))

    def waves(self, run: Simulation) -> Array:
        """Return dry and viscous friction that is periodic over position, (n_samples, m)."""
        (q,), (dq,), _ = signals([run])
        top = float(self.knots["dq"][-1]) if "dq" in self.knots else float(np.max(np.abs(dq)))
        friction = as_columns([np.sign(dq), dq / max(top, 1e-300)])
        each = [np.exp(2j * np.pi * q / p)[:, None].view(float) for p in self.periods]
        columns = [wave * w[:, None] for w in friction.T for wave in each]
        return np.hstack(columns) if columns else np.empty((len(q), 0))

    def swinging(self, run: Simulation) -> Array:
        """Return what loads do that the axis sets swinging, (n_samples, m)."""
        dt = float(run.t[1] - run.t[0])
        return np.hstack([s.of(run.ddq[:, 0], dt) for s in self.swings])

    def hats(self, name: str, x: Array) -> Array:
        """Return the hat functions of a signal at some values, (n, knots)."""
        return as_columns(self._rows(name, x))

    def _rows(self, name: str, x: Array) -> list[Array]:
        """Return the same, one by one."""
        return [np.interp(x, self.knots[name], row) for row in self._unit(name)]

    def _unit(self, name: str) -> Array:
        return np.eye(len(self.knots[name]))

    def penalty(self, name: str, count: int) -> Array:
        """Return rows that measure roughness and size of columns of one of `OVER`, (r, count)."""
        return np.vstack([self._rough(name, count), TO_ZERO * np.eye(count)])

    def _rough(self, name: str, count: int) -> Array:
        """Return second differences."""

        def curved(knots: str) -> Array:
            """Return those of the hats over one signal."""
            return np.diff(self._unit(knots), 2, axis=0)

        if name in ("q", "dq", "load"):
            return np.asarray(linalg.block_diag(curved(name), curved(name)))
        if name == "drive":
            return curved("drive")
        if name == "gain":
            return np.asarray(linalg.block_diag(curved("where"), curved("how fast")))
        if name == "state":
            where, fast = self._unit("where"), self._unit("how fast")
            one = np.vstack([np.kron(curved("where"), fast), np.kron(where, curved("how fast"))])
            return np.asarray(linalg.block_diag(one, one))
        return np.zeros((0, count))


def signals(runs: Sequence[Simulation]) -> tuple[list[Array], ...]:
    """Return where forces over position act, speed and drive force of simulations, (n_samples,)."""
    return [r.where for r in runs], [r.dq[:, 0] for r in runs], [r.tau[:, 0] for r in runs]


def _past(v: Array, dt: float) -> Array:
    """Return speed and direction as they are forgotten, and what a motion sets ringing."""
    found = remembered(v, dt)
    for hz in RINGING:
        p = np.exp((-RINGING_DAMPING + 1j) * 2.0 * np.pi * hz * dt)
        y = signal.lfilter([1.0 - abs(p)], [1.0, -p], v)
        found += [y.real, y.imag]
    return as_columns(found)


class Columns:
    """What forces do to the error of one fold beside its base model.

    Parameters
    ----------
    fit : Fit
        The base model.
    shared : ndarray, (n_kept, m)
        `Fold.answers` that other fits use as well: they are not copied.
    own : ndarray, (n_kept, k), optional
        Such as only this fit has.
    square : ndarray, (m, m), optional
        Products of the shared ones, where they are known.
    """

    def __init__(
        self, fit: Fit, shared: Array, own: Array | None = None, square: Array | None = None
    ) -> None:
        self.base, self.shared = fit.basis, shared
        self.own = np.empty((len(shared), 0)) if own is None else own
        few = np.hstack([self.base, self.own])
        products = few.T @ shared  # in one go over what is large
        split = self.base.shape[1]
        self.known = np.hstack([products[:split], self.base.T @ self.own])
        mixed = products[split:].T
        first = shared.T @ shared if square is None else square
        whole = np.block([[first, mixed], [mixed.T, self.own.T @ self.own]])
        self.square = np.asarray(whole - self.known.T @ self.known)  # of what the base leaves
        energy = np.diag(self.square)
        distinct = energy > DEPENDENT * np.diag(whole)  # what the base has as well is rounding
        self.size = np.sqrt(np.where(distinct, energy, np.inf))

    @property
    def count(self) -> int:
        """Number of columns that the base model does not have."""
        return int(np.sum(np.isfinite(self.size)))

    def side(self, x: Array) -> Array:
        """Return the products with signals that are beside the base model already, (m + k, ...)."""
        return np.concatenate([self.shared.T @ x, self.own.T @ x])

    def times(self, beta: Array) -> Array:
        """Return the columns times their coefficients, (n_kept, ...)."""
        split = self.shared.shape[1]
        shared, own = beta[:split], beta[split:]
        used = np.flatnonzero(shared.reshape(split, -1).any(axis=1))
        if 2 * len(used) < split:  # a copy of few is sooner made than all are gone over
            whole = self.shared.T[used].T @ shared[used] + self.own @ own
        else:
            whole = self.shared @ shared + self.own @ own
        return np.asarray(whole - self.base @ (self.known @ beta))

    def left(self, x: Array, count: int | None = None) -> Array:
        """Return what the first columns leave of signals beside the base model, (n_kept, ...)."""
        rows = slice(count)
        size = self.size[rows, None]
        A, b = self.square[rows, rows] / size / size.T, self.side(x)[rows] / size
        beta = np.zeros((len(self.square), x.shape[1]))
        if np.isfinite(A).all() and np.isfinite(b).all():  # else of a loop that diverged
            w, V = np.linalg.eigh(A)  # a decomposition by singular values may not converge
            distinct = w > DEPENDENT * w.max(initial=0.0)
            beta[rows] = V[:, distinct] @ ((V[:, distinct].T @ b) / w[distinct, None]) / size
        return x - self.times(beta)


#: What smooth laws do to the error of a fit, as long as the fit is there.
_IMITATIONS: WeakKeyDictionary[Fit, Columns] = WeakKeyDictionary()
#: The same of the laws beside a line, with their knots: the last ones, for two effects may be one
#: line.
_BESIDE_LINES: WeakKeyDictionary[Fit, tuple[tuple[bytes, ...], Columns]] = WeakKeyDictionary()


def unlike_smooth(before: Sequence[Fit], after: Sequence[Fit]) -> float:
    """Return how much of an effect's gain no smooth law of the state could have, 0 to 1.

    Parameters
    ----------
    before, after : sequence of Fit
        Without and with the effect, on each fold.
    """

    def kept(b: Fit, a: Fit) -> float:
        """Return that of one fold."""
        pair = b.beyond_base(np.column_stack([b.e - a.e, b.e]))
        return _explained(_imitation(b).left(pair)) / max(_explained(pair), 1e-300)

    return min(threaded(kept, before, after))


def smooth_rest(before: Sequence[Fit], after: Sequence[Fit]) -> float:
    """Return how much smooth laws of the state add to an effect's gain at most, as a share of it.

    Parameters as for `unlike_smooth`.
    """

    def added(b: Fit, a: Fit) -> float:
        """Return that of one fold: what they take of the rest, and noise gives one a column."""
        e = b.beyond_base(a.e[:, None])
        left, count = _imitation(b).left(e), _imitation(b).count
        most = float(np.sum(e**2) - np.sum(left**2)) - count + CHANCE * np.sqrt(2.0 * count)
        return most / max(float(b.e @ b.e - a.e @ a.e), 1e-300)

    return max(threaded(added, before, after))


def _imitation(b: Fit) -> Columns:
    """Return what smooth laws of the state do to the error of a fit."""
    if b not in _IMITATIONS:
        run = b.denoised
        _IMITATIONS[b] = Columns(b, b.fold.answers(Basis.of([run]).over(run, *STATE)))
    return _IMITATIONS[b]


def a_line(before: Sequence[Fit], after: Sequence[Fit], period: float) -> float:
    """Return how much of what lies over position is a line, and no law of the state, 0 to 1.

    A smooth law has no room for the line's periods: knots over position that are one period apart.
    Another law, with `BUMPS` knots a period, takes what the line leaves: bumps are no line.

    Parameters
    ----------
    before, after : sequence of Fit
        Without and with the line, on each fold.
    period : float
        Of the line over position, m or rad.
    """
    runs = [f.denoised for f in before]
    smooth, bumps = Basis.of(runs, period), Basis.of(runs, period / BUMPS)
    finer = len(bumps.knots["q"]) > len(smooth.knots["q"])  # both have `MOST_KNOTS` at most
    knots = tuple(k.tobytes() for k in (*smooth.knots.values(), bumps.knots["q"]))

    def laws(b: Fit, run: Simulation) -> Columns:
        """Return what both laws do to one fold."""
        if (last := _BESIDE_LINES.get(b)) is not None and last[0] == knots:
            return last[1]
        forces = [smooth.over(run, *STATE), *([bumps.over(run, "q")] if finer else [])]
        columns = Columns(b, *(b.fold.answers(F) for F in forces))
        _BESIDE_LINES[b] = knots, columns
        return columns

    def share(b: Fit, a: Fit, run: Simulation) -> float:
        """Return that of one fold."""
        columns = laws(b, run)
        known, other = columns.shared.shape[1], columns.own.shape[1]
        pair = b.beyond_base(np.column_stack([b.e - a.e, b.e, a.e]))
        beyond = columns.left(pair, known)
        line = _explained(beyond[:, :2])
        taken = beyond[:, 2] - columns.left(pair[:, 2:])[:, 0]
        bumpy = max(float(taken @ taken) - other, 0.0)  # the floor is one a column
        kept = line / max(_explained(pair[:, :2]), 1e-300)
        return kept * line / max(line + bumpy, 1e-300)

    return min(threaded(share, before, after, runs))


def friction_waves(fits: Sequence[Fit], periods: Sequence[float]) -> list[list[Array]]:
    """Return the errors that periodic friction, dry and viscous, leaves, per kind and fold.

    Over position it looks much like cogging or ripple, and is no effect.

    Parameters
    ----------
    fits : sequence of Fit
        Without it, on each fold.
    periods : sequence of float
        Of its waves, m or rad, on each.
    """

    def waves(f: Fit, period: float) -> list[Array]:
        """Return its forces along one motion."""
        both = Basis({}, (period,)).waves(f.denoised)
        return [both[:, :2], both[:, 2:]]

    return _left_by(fits, periods, waves)


def further_waves(fits: Sequence[Fit], periods: Sequence[float]) -> list[list[Array]]:
    """Return the errors that further waves of the lines in a model leave, per line and fold.

    Such as their harmonics are, which are no further effects; parameters as for `friction_waves`.
    """

    def waves(f: Fit, period: float) -> list[Array]:
        """Return their forces along one motion."""
        lines = [t for t in f.loop.terms if t.search == "lines"]
        return [unit_forces(f, f.simulation, t, {t.period: period}) for t in lines]

    return _left_by(fits, periods, waves)


def _left_by(
    fits: Sequence[Fit], periods: Sequence[float], waves: Callable[[Fit, float], list[Array]]
) -> list[list[Array]]:
    """Return the errors that waves of these periods leave, per kind of wave and fold."""
    found = []
    for f, period in zip(fits, periods, strict=True):
        e = f.beyond_base()
        parts = (f.beyond_base(f.answers(wave)) for wave in waves(f, period))
        found.append([e - part @ normal(part, e) for part in parts])
    return [list(wave) for wave in zip(*found, strict=True)]


def _explained(pair: Array) -> float:
    """Return the energy of the second column that the first one explains."""
    change, e = pair.T
    return float(change @ e) ** 2 / max(float(change @ change), 1e-300)
