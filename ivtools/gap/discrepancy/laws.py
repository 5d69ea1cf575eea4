"""Laws: the smooth law of the axis in what a model leaves, which predicts held-out data best.

What the named effects leave is regressed on a penalised spline over position, speed, direction and
load, and on what remembers, through the response of the loop: any law of the axis, known or not,
is close to one. The penalty is the one that predicts the other fold best, so what does not come
again is not in it.

P. H. C. Eilers, B. D. Marx, "Flexible smoothing with B-splines and penalties", Statistical
Science 11(2), 1996.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import NamedTuple, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from ...linalg.swing import Swing, Swings
from ...loop import Simulation
from ...workers import threaded
from .. import spatial_lines
from ..fit import Fit, normal
from ..fold import better_t
from ..rules import (
    AGREES,
    COOLING,
    DISCREPANCY_T,
    DOMINANT_T,
    EVEN,
    LITTLE,
    MOST,
    NEARLY_ALL,
    PENALTIES,
    STANDARD_ERRORS,
)
from .smooth import OF_USE, Basis, Columns

Array = NDArray[np.float64]
Made = TypeVar("Made")
#: What was made of two fits: by the one on the first fold, with the other one.
_ByFits = WeakKeyDictionary[Fit, tuple[Fit, Made]]


@dataclass(frozen=True, eq=False)
class Laws:
    """Forces without a name along one motion, and what they do to the error of each fold.

    Parameters
    ----------
    basis : Basis
    runs : tuple of Simulation
        The motion, on each fold.
    forces : tuple of ndarray, (n_samples, m)
        One column per hat or memory.
    place : mapping of str to ndarray
        Columns of each of `smooth.OVER` but those of a model's own.
    answers : tuple of ndarray, (n_kept, m)
        Of the whitened error.
    squares : tuple of ndarray, (m, m)
        Their products with each other.
    swings : tuple of Swings
        Loads that may hang from the axis.
    splines : mapping
        Those that were fitted to what models leave, by their fit on the first fold.
    """

    basis: Basis
    runs: tuple[Simulation, ...]
    forces: tuple[Array, ...]
    place: dict[str, NDArray[np.int_]]
    answers: tuple[Array, ...]
    squares: tuple[Array, ...]
    swings: tuple[Swings, ...]
    splines: _ByFits[Spline] = field(default_factory=WeakKeyDictionary, init=False)

    @classmethod
    def of(cls, fits: Sequence[Fit]) -> Laws | None:
        """Return the laws along the motion of fits, one on each fold; None if a loop diverges."""
        return _once(_LAWS, fits, cls._along)

    @classmethod
    def _along(cls, fits: Sequence[Fit]) -> Laws | None:
        """Return the laws along the motion of fits, made anew."""
        if not all(f.simulation.finite for f in fits):
            return None
        runs = tuple(f.denoised for f in fits)
        basis = Basis.of(runs)
        before = _warmth(fits, runs, basis)
        own = threaded(lambda r, w: {**basis.parts(r), "warm": basis.heat(r, w)}, runs, before)
        parts = _scaled(own)
        place = _places(parts[0])
        forces = tuple(threaded(lambda p: np.hstack(list(p.values())), parts))
        answers = tuple(threaded(lambda f, F: f.fold.answers(F), fits, forces))
        squares = tuple(threaded(lambda A: A.T @ A, answers))
        swings = tuple(threaded(_swings, fits, runs))
        return cls(basis, runs, forces, place, answers, squares, swings)

    def fitted(self, fits: Sequence[Fit]) -> Spline:
        """Return the spline in what fits leave, one on each fold, that predicts the other best.

        What it may depend on is added one by one, the most telling first, as long as held-out data
        are significantly better predicted: columns without need cost more than they bring.
        """
        return _once(self.splines, fits, lambda both: _Search(both, self).best())

    def of_use(self, fits: Sequence[Fit]) -> Spline:
        """Return the same of friction that remembers how much the axis moved."""
        return _Search(fits, self).of_use()

    @cached_property
    def without_use(self) -> Laws:
        """Those that do not remember how much the axis moved."""
        return replace(self, place={n: at for n, at in self.place.items() if n not in OF_USE})


#: The laws along the motion of a fit and that of the other fold, as long as the first one is there.
_LAWS: _ByFits[Laws | None] = WeakKeyDictionary()


def _once(kept: _ByFits[Made], fits: Sequence[Fit], make: Callable[[Sequence[Fit]], Made]) -> Made:
    """Return what is made of two fits, which is made again for others only."""
    one, two = fits
    if (known := kept.get(one)) is None or known[0] is not two:
        known = kept[one] = two, make(fits)
    return known[1]


def _places(parts: Mapping[str, Array], first: int = 0) -> dict[str, NDArray[np.int_]]:
    """Return the columns of each part, side by side from the first one on."""
    widths = [p.shape[1] for p in parts.values()]
    edges = first + np.cumsum([0, *widths])
    return {n: np.arange(a, b) for n, a, b in zip(parts, edges[:-1], edges[1:], strict=True)}


def _scaled(parts: list[dict[str, Array]]) -> list[dict[str, Array]]:
    """Return forces of which those that remember are of unit size, over all folds together.

    One size for all: a coefficient that one fold has found means the same on the other. Hats and
    waves have their size already.
    """
    sizes: dict[str, Array] = {}
    for name in (n for n in ("past", "heat", "warm", "swing") if n in parts[0]):
        size = np.sqrt(np.mean(np.vstack([p[name] for p in parts]) ** 2, axis=0))
        sizes[name] = np.where(size > 0.0, size, 1.0)
    return [{name: x / sizes[name] if name in sizes else x for name, x in p.items()} for p in parts]


@dataclass(frozen=True, eq=False)
class Spline:
    """A penalised spline in what two fits leave.

    Parameters
    ----------
    over : tuple of str
        What it depends on, in the order in which it was found; empty if nothing repeats.
    gain : float
        Share of the whitened energy that it removes on held-out data.
    left : tuple of ndarray, (n_kept,)
        Whitened error that the spline of either fold leaves on the other one.
    force : callable, optional
        Returns what it is on each fold, from both together, N or N m, (n_samples,) each.
    from_other : callable, optional
        Returns what it is on each fold, from the other one alone, N or N m, (n_samples,) each.
    rest : callable, optional
        Returns what is left of an error on each fold, (n_kept,), if the spline is fitted to it.
    even : callable, optional
        Returns how much of a force over one signal is the same forwards and backwards, of its
        variance, 0 to 1.
    periods : tuple of float
        Of waves over position, m or rad.
    first : float
        Share of the gain that its first signal has by itself.
    """

    over: tuple[str, ...]
    gain: float
    left: tuple[Array, ...]
    force: Callable[[], tuple[Array, ...]] = tuple
    from_other: Callable[[], tuple[Array, ...]] = tuple
    rest: Callable[[Sequence[Array]], Sequence[Array]] = list
    even: Callable[[], float] = lambda: 1.0
    periods: tuple[float, ...] = ()
    first: float = 1.0

    @property
    def of_place(self) -> bool:
        """Whether it is friction over the position, whatever its curve, and little else."""
        return self.over[:1] == ("q",) and self.first >= NEARLY_ALL and self.even() < EVEN

    @property
    def of_use(self) -> bool:
        """Whether most of it is friction that depends on how much the axis moved before."""
        return bool(self.over) and self.over[0] in OF_USE

    @property
    def single(self) -> bool:
        """Whether it is a law of one signal: one of the state has two."""
        return len(self.over) == 1 and self.over[0] != "state"

    @property
    def cost(self) -> float:
        """Mean square of the whitened error that it leaves, mean of the folds."""
        return float(np.mean([np.mean(e**2) for e in self.left]))


def nothing(fits: Sequence[Fit]) -> Spline:
    """Return no force at all: what two fits leave is left."""
    return Spline((), 0.0, tuple(f.beyond_base() for f in fits))


def least_t(share: float) -> float:
    """Return the block t value from which such a share of the energy is saved significantly."""
    return DOMINANT_T if share >= MOST else DISCREPANCY_T


def advantage(fits: Sequence[Fit], before: Spline, after: Spline) -> float:
    """Return the block t value by which held-out data are better predicted with an effect.

    Both times a spline describes what is left. An effect that is not there is no better than that
    description without it, however much it resembles what is there.

    Parameters
    ----------
    fits : sequence of Fit
        On each fold.
    before, after : Spline
        Of what the model leaves without and with the effect.
    """
    return better_t([f.fold for f in fits], before.left, after.left)


def stands(before: Sequence[Fit], held: Sequence[Fit], laws: Laws | None) -> bool:
    """Whether an effect is as large beside a force without a name as by itself, on each fold.

    The force without a name is the one that describes best what the model leaves without the
    effect. Both are fitted side by side: if the effect only resembles what is there, the other
    takes its place, and its amplitude is any. An effect of which such a force has nearly all cannot
    be told from it.

    Parameters
    ----------
    before, held : sequence of Fit
        The model without and with the effect, which the other fold has fitted.
    laws : Laws, optional
        Along the motion of a model much like it; without them nothing stands.

    R. Frisch, F. V. Waugh, Econometrica 1(4), 1933: a coefficient beside other regressors.
    """
    found = beside_law(before, held, laws)
    return bool(found) and all(
        own > LITTLE and 1.0 / AGREES <= size <= AGREES for own, size in found
    )


def beside_law(
    before: Sequence[Fit], held: Sequence[Fit], laws: Laws | None
) -> list[tuple[float, float]]:
    """Return what an effect has of its own beside a force without a name, and its size there.

    Its share and, relative to that by itself, its amplitude, on each fold; nothing where there is
    no such force. Parameters as for `stands`.
    """
    law = None if laws is None else laws.fitted(before)
    if law is None or not law.over:
        return []
    changes = [b.beyond_base(h.e - b.e) for b, h in zip(before, held, strict=True)]
    errors = [b.beyond_base() for b in before]
    found = []
    for x, rest, e in zip(changes, law.rest(changes), errors, strict=True):
        energy = float(rest @ x)
        own = energy / max(float(x @ x), 1e-300)
        found.append((own, -float(rest @ e) / energy if energy > 0.0 else 0.0))
    return found


def _periods(fits: Sequence[Fit], runs: Sequence[Simulation]) -> tuple[float, ...]:
    """Return the most likely periods of friction that is periodic over position."""

    def found(f: Fit, run: Simulation) -> list[float]:
        """Return those of one fold."""
        v = run.dq[:, 0]
        e = f.beyond_base()
        weights = (np.sign(v), v / max(float(np.max(np.abs(v))), 1e-300))
        lines = spatial_lines.strongest(f.fold, e, run, weights, 1)
        return [p for line in lines for p in line]

    return tuple(p for each in threaded(found, fits, runs) for p in each)


def _swings(f: Fit, run: Simulation) -> Swings:
    """Return the loads that may hang from the axis, along a motion."""
    return Swings(f.fold.heard(run.ddq[:, 0]), f.fold.keep, f.fold.record.dt)


def _swing(f: Fit, swings: Swings) -> Swing:
    """Return the most likely load that hangs from the axis."""
    e = np.zeros(len(f.fold.keep))
    e[f.fold.keep] = f.beyond_base()
    return swings.strongest(e).swing


def _warmth(fits: Sequence[Fit], runs: Sequence[Simulation], basis: Basis) -> tuple[Array, ...]:
    """Return how warm friction was before each fold, as what it leaves there shows.

    One that warms has a coefficient each for what the axis does and for what it had done: their
    ratio is the warmth at the start.
    """

    def found(f: Fit, run: Simulation) -> Array:
        """Return that of one fold, per time of cooling."""
        e = f.beyond_base()
        cold = basis.heat(run, np.zeros(len(COOLING)))
        before = basis.heat(run, np.ones(len(COOLING))) - cold
        own, more = (
            np.split(f.beyond_base(f.fold.answers(F)), len(COOLING), 1) for F in (cold, before)
        )
        return np.array([_ratio(np.hstack(pair), e) for pair in zip(own, more, strict=True)])

    return tuple(threaded(found, fits, runs))


def _ratio(columns: Array, e: Array) -> float:
    """Return by how much the second half of the columns enters for the first one, 0 to 1."""
    one, two = np.split(normal(columns, e), 2)
    return float(np.clip(one @ two / max(float(one @ one), 1e-300), 0.0, 1.0))


class _Tried(NamedTuple):
    """Coefficients of a spline on each fold, and the share of energy it removes on the other."""

    gain: float
    over: tuple[str, ...]
    penalty: float
    betas: list[Array]


class _Search:
    """Normal equations and penalties of every column, of which steps take some.

    Waves and swings are columns of a model's own: their periods are those of what it leaves.
    """

    def __init__(self, fits: Sequence[Fit], laws: Laws) -> None:
        self.periods = periods = _periods(fits, laws.runs)
        swings = tuple(threaded(_swing, fits, laws.swings))
        basis = replace(laws.basis, periods=periods, swings=swings)
        parts = _scaled([{"wave": basis.waves(r), "swing": basis.swinging(r)} for r in laws.runs])
        more = [np.hstack(list(p.values())) for p in parts]
        self.place = {**laws.place, **_places(parts[0], len(laws.squares[0]))}
        self.forces = list(zip(laws.forces, more, strict=True))
        own = threaded(lambda f, F: f.fold.answers(F), fits, more)
        self.seen = threaded(Columns, fits, laws.answers, own, laws.squares)
        self.squares = [c.square for c in self.seen]
        self.rests = [f.beyond_base() for f in fits]
        self.sides = [c.side(e) for c, e in zip(self.seen, self.rests, strict=True)]
        self.energy = sum(float(e @ e) for e in self.rests)
        rough = {n: basis.penalty(n, len(p)) for n, p in self.place.items()}
        self.rough = {n: R.T @ R for n, R in rough.items()}
        self.folds = [f.fold for f in fits]

    def best(self) -> Spline:
        """Return the spline that predicts the other fold best."""
        now, steps = Spline((), 0.0, tuple(self.rests)), []
        while then := next((s for s in self.ahead(now) if self._tells(now, s)), None):
            steps.append(now := then)
        first = steps[0].gain / steps[-1].gain if steps else 1.0
        return replace(now, first=first)

    def of_use(self) -> Spline:
        """Return the best of splines over how much the axis moved before."""
        several = [*[(n,) for n in OF_USE], OF_USE]
        return self._spline(max(map(self._best, several), key=lambda x: x.gain))

    def _tells(self, now: Spline, then: Spline) -> bool:
        """Whether a further signal predicts held-out data significantly better."""
        more = then.gain - now.gain
        least = STANDARD_ERRORS if more >= NEARLY_ALL else least_t(more)
        return better_t(self.folds, now.left, then.left) >= least

    def ahead(self, now: Spline) -> Iterator[Spline]:
        """Yield the splines over one more signal that gain something, the best one first."""
        tried = [self._best((*now.over, n)) for n in self.place if n not in now.over]
        for found in sorted(tried, key=lambda x: -x.gain):
            if found.gain <= now.gain:
                return
            yield self._spline(found)

    def _spline(self, tried: _Tried) -> Spline:
        """Return what the spline of either fold leaves on the other one."""
        return Spline(
            tried.over,
            tried.gain,
            tuple(self._left(tried, self.rests, tried.betas[::-1])),
            force=partial(self.force, tried),
            from_other=partial(self.from_other, tried),
            rest=partial(self.rest, tried),
            even=partial(self.even, tried),
            periods=self.periods,
        )

    def rest(self, tried: _Tried, errors: Sequence[Array]) -> list[Array]:
        """Return what such a spline leaves of errors on each fold, (n_kept,), fitted to each."""
        sides = [c.side(e) for c, e in zip(self.seen, errors, strict=True)]
        return self._left(tried, errors, [self._fitted(tried, [k], sides) for k in (0, 1)])

    def _left(self, tried: _Tried, errors: Sequence[Array], betas: Sequence[Array]) -> list[Array]:
        """Return what coefficients leave of errors on each fold, (n_kept,)."""
        whole = self._whole(tried, betas)
        return [e + c.times(b) for e, c, b in zip(errors, self.seen, whole, strict=True)]

    def force(self, tried: _Tried) -> tuple[Array, ...]:
        """Return what fits both folds at once, on each, N or N m, (n_samples,)."""
        return self._forces(tried, [self._both(tried)] * len(self.forces))

    def from_other(self, tried: _Tried) -> tuple[Array, ...]:
        """Return what fits either fold, on the other one, N or N m, (n_samples,)."""
        return self._forces(tried, tried.betas[::-1])

    def _forces(self, tried: _Tried, betas: Sequence[Array]) -> tuple[Array, ...]:
        """Return the forces of coefficients on each fold, N or N m, (n_samples,)."""
        return tuple(
            shared @ beta[: shared.shape[1]] + own @ beta[shared.shape[1] :]
            for (shared, own), beta in zip(self.forces, self._whole(tried, betas), strict=True)
        )

    def even(self, tried: _Tried) -> float:
        """Return how much of it is the same forwards and backwards, of its variance at knots.

        Its columns are those of `Basis.over`: hats, and the same with the sign of the motion.
        """
        size, sign = np.split(self._both(tried)[: len(self._rows(tried.over[:1]))], 2)
        one, two = float(np.var(size)), float(np.var(sign))
        return one / max(one + two, 1e-300)

    def _both(self, tried: _Tried) -> Array:
        """Return the coefficients that fit both folds at once."""
        return self._fitted(tried, [0, 1], self.sides)

    def _fitted(self, tried: _Tried, folds: Sequence[int], sides: Sequence[Array]) -> Array:
        """Return the coefficients that fit folds at once."""
        rows = self._rows(tried.over)
        R = self._penalty(tried.over, tried.penalty)
        A = np.sum([self.squares[k][np.ix_(rows, rows)] for k in folds], axis=0)
        return _solved(A + R, -np.sum([sides[k][rows] for k in folds], axis=0))

    def _whole(self, tried: _Tried, betas: Sequence[Array]) -> Array:
        """Return coefficients of every column, 0 of those that a spline has not, (n, m + k)."""
        whole = np.zeros((len(betas), len(self.sides[0])))
        whole[:, self._rows(tried.over)] = betas
        return whole

    def _best(self, over: tuple[str, ...]) -> _Tried:
        """Return the spline over some signals whose penalty predicts the other fold best."""
        rows, R = self._rows(over), self._penalty(over, 1.0)
        A = [a[np.ix_(rows, rows)] for a in self.squares]
        b = [x[rows] for x in self.sides]

        def tried(penalty: float) -> _Tried:
            """Return the splines of both folds with one penalty."""
            betas = [_solved(a + penalty * R, -x) for a, x in zip(A, b, strict=True)]
            saved = [
                -float(2.0 * x @ other + other @ a @ other)
                for a, x, other in zip(A, b, betas[::-1], strict=True)
            ]
            return _Tried(sum(saved) / self.energy, over, penalty, betas)

        return max(map(tried, PENALTIES), key=lambda x: x.gain)

    def _rows(self, over: Sequence[str]) -> NDArray[np.int_]:
        return np.concatenate([self.place[n] for n in over])

    def _penalty(self, over: Sequence[str], penalty: float) -> Array:
        rows = self._rows(over)
        size = float(np.mean([np.trace(a[np.ix_(rows, rows)]) for a in self.squares])) / len(rows)
        return np.asarray(penalty * size * linalg.block_diag(*(self.rough[n] for n in over)))


def _solved(A: Array, b: Array) -> Array:
    """Return the solution of normal equations that may be singular, (m,)."""
    A = A + 1e-9 * np.trace(A) / len(A) * np.eye(len(A))
    return np.asarray(np.linalg.solve(A, b), dtype=float)
