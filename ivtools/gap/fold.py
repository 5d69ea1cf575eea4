"""Fold: the samples of a record that are compared, and the noise in them.

The gap is measured on the command, in units of force: in closed loop the controller hides a model
error from the position. A fold knows which samples count and how the noise is coloured, and turns
a set of parameter values into a whitened error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ..linalg import Metric, independent, rms
from ..loop import ClosedLoop, Simulation
from ..loop.controllers import ahead
from ..loop.mechanics import LIGHTEST
from ..record import Record
from . import between
from .library import Scales
from .response import Response
from .rules import (
    AT_LIMIT,
    BLOCK,
    DEPENDENT,
    DIVERGED,
    LEAST_BLOCK,
    LINKED_TRANSIENT,
    MOST,
    MOVED_OFF,
    NEARBY,
    ONE_WAY,
    REST,
    STANDING,
    TRANSIENT,
    UNDOUBTED,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Values = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Doubt:
    """What is not known of a load, as that of a robot's links: the sizes of some forces.

    Parameters
    ----------
    t : ndarray, (n_samples,)
        Time of a record, s.
    answers : ndarray, (n_samples, m)
        What the command, N or N m, answers to a unit of each size.
    mean, precision : ndarray, (m,) and (m, m)
        What is known of the sizes from elsewhere; a precision of 0 is nothing.
    own : ndarray, (n_samples, m), optional
        What the command answers besides as to a change of the axis's own parameters, which are
        fitted: with other values along another motion.
    """

    t: Array
    answers: Array
    mean: Array
    precision: Array
    own: Array | None = None

    def on(self, record: Record) -> Array:
        """Return the answers on that record, or a part of it, (n_samples, m)."""
        return self.answers[np.searchsorted(self.t, record.t)]

    @property
    def whole(self) -> Doubt:
        """The same forces, none of their parts left to the axis's own parameters."""
        return self if self.own is None else replace(self, answers=self.answers + self.own)

    def beside(self, record: Record, unknown: Array) -> Doubt:
        """Return the doubt of that record and of forces of which nothing is known.

        Parameters
        ----------
        record : Record
            Or a part of it.
        unknown : ndarray, (n_samples, k)
            What the command answers to a unit of each.
        """
        rows, k = np.searchsorted(self.t, record.t), unknown.shape[1]
        return Doubt(
            record.t,
            np.column_stack([self.answers[rows], unknown]),
            np.append(self.mean, np.zeros(k)),
            np.pad(self.precision, (0, k)),
            None if self.own is None else np.pad(self.own[rows], ((0, 0), (0, k))),
        )


@dataclass(frozen=True, eq=False)
class Link:
    """The link that a joint of a robot moves, beside the known load of the joint's record.

    Parameters
    ----------
    t : ndarray, (n_samples,)
        Time of the record, s.
    felt : ndarray, (n_samples, 2)
        The load at a second mass, N or N m, and what inertia that has beyond its mean; see
        `ClosedLoop.simulate`.
    doubt : Doubt, optional
        What is not known of the load.
    """

    t: Array
    felt: Array
    doubt: Doubt | None = None

    def on(self, record: Record) -> Array:
        """Return what is felt on that record, or a part of it, (n_samples, 2)."""
        return self.felt[np.searchsorted(self.t, record.t)]


@dataclass(frozen=True, eq=False)
class Fold:
    """Samples of a record, and the noise of its command.

    Parameters
    ----------
    record : Record
    keep : ndarray of bool, (n_samples,)
        Samples that count.
    scales : Scales
        What parameters are measured in; of a stretch they are those of the whole record.
    response : Response
        Of the command to a force: gives sensitivities without simulation.
    whitener : ndarray, (order + 1,)
        Polynomial that whitens the noise of the command, in N or N m, to unit variance.
    label : str
    place : ndarray, (n_samples,), optional
        Where forces that depend on the position act, if not where the simulation is.
    driven : bool
        Whether the recorded command drives the model, and a pull holds it to the motion.
    ramp : bool
        Whether an added input goes straight from sample to sample; else it is held.
    link : Link, optional
        Of a robot's joint; what is not known of its load discounts the errors.
    smooth : float
        Whitened energy that smooth laws of the state leave beside the base model. Noise that is
        larger here than there leaves more than 1, and no law explains that.
    rough : float
        Share of the record that no smooth law of the state explains.
    both : ndarray of bool, (n_samples,), optional
        Samples where, and when, the fold that it is compared with has been as well, if not all.
    limited : ndarray of bool, (n_samples,), optional
        Samples that are left out for a limit of the command that the loop was given without.
    against : ndarray, (n_samples,), optional
        A force against the motion that no term of a loop makes, N or N m.
    oversampling : int
        Samples of the controller from one sample of the record to the next.
    simulated : dict
        Change of the force error, N or N m, (n_samples,), by effect and starting point: what the
        screening has simulated once and need not again. Each fold has its own, also one made by
        `replace`: the change is that at its own base parameters, and two threads fill two folds.
    """

    record: Record
    keep: Mask
    scales: Scales
    response: Response
    whitener: Array = field(default_factory=lambda: np.ones(1))
    label: str = "record"
    place: Array | None = None
    driven: bool = False
    ramp: bool = False
    link: Link | None = None
    smooth: float = 1.0
    rough: float = 0.0
    both: Mask | None = None
    limited: Mask | None = None
    against: Array | None = None
    oversampling: int = 1
    simulated: dict[tuple[object, ...], Array] = field(default_factory=dict, init=False)

    @property
    def movable(self) -> bool:
        """Whether its loop can make another motion: no place or load is the record's own."""
        return self.place is None and self.link is None

    @property
    def n_kept(self) -> int:
        """Number of samples that count."""
        return int(self.keep.sum())

    @property
    def doubt(self) -> Doubt | None:
        """What is not known of the load."""
        return None if self.link is None else self.link.doubt

    @cached_property
    def blocks(self) -> NDArray[np.int_]:
        """First kept sample of each block, among the kept ones."""
        width = max(round(BLOCK / self.record.dt), LEAST_BLOCK)
        number = np.flatnonzero(self.keep) // width
        return np.flatnonzero(np.diff(number, prepend=-1))

    def block_sums(self, x: Array) -> Array:
        """Sum kept samples by block, (n_blocks, ...)."""
        return np.add.reduceat(x, self.blocks, axis=0)

    def white(self, x: Array) -> Array:
        """Whiten signals along the first axis and keep the samples that count."""
        return self._metric(x)

    @cached_property
    def _metric(self) -> Metric:
        """The metric (1 + A C A')^-1/2: noise and doubt are white there.

        A are the whitened answers to the sizes in doubt, C is their covariance.
        """
        if self.doubt is None:
            return self._plain
        doubted, shares, _ = self._doubted
        return replace(self._plain, doubted=doubted, shares=shares)

    @cached_property
    def _plain(self) -> Metric:
        """The metric in which noise is white."""
        return Metric(self.whitener, self._kept)

    @cached_property
    def _felt(self) -> Array | None:
        """What the link feels along the record, (n_samples, 2)."""
        return None if self.link is None else np.asfortranarray(self.link.on(self.record))

    @cached_property
    def least_link(self) -> float:
        """Least mean inertia of a link, kg or kg m2: some of it goes in other poses."""
        if self._felt is None:
            return 0.0
        return max(-float(np.min(self._felt[:, 1])), 0.0) / (1.0 - LIGHTEST)

    @cached_property
    def _unknown(self) -> tuple[Array, Array] | None:
        """What the command answers to doubted sizes, (n_samples, m), and to those expected."""
        if self.doubt is None:
            return None
        answers = self.doubt.on(self.record)
        return answers, answers @ self.doubt.mean

    @cached_property
    def _doubted(self) -> tuple[Array, Array, Array]:
        """What is doubted, and how much.

        Orthonormal directions (k, n_kept); by which share each is discounted; and the sizes that
        make an error of one along each likeliest, (m, k).
        """
        assert self.doubt is not None and self._unknown is not None
        A = self._plain(self._unknown[0])
        turn = independent(A, DEPENDENT, self.doubt.precision)
        energy, turned = np.linalg.eigh(turn.T @ (A.T @ A) @ turn)  # of this record's share in it
        discount = 1.0 - np.sqrt(np.maximum(1.0 - energy, 0.0))
        doubted = discount > UNDOUBTED
        sizes = turn @ turned[:, doubted]
        shares = np.sqrt(energy[doubted])
        return (sizes / shares).T @ A.T, discount[doubted], sizes * shares

    @cached_property
    def heard(self) -> Response:
        """Of the whitened error to a force."""
        impulse = -np.convolve(self.response.impulse, self.whitener)
        return Response(impulse, self.record.n_samples)

    def answers(self, forces: Array) -> Array:
        """Return the change of the whitened error by forces in the columns, (n_kept, m)."""
        return self._metric.discounted(self.heard(forces, self._kept))

    @cached_property
    def _kept(self) -> NDArray[np.int_]:
        """Indices of the samples that count, (n_kept,)."""
        return np.flatnonzero(self.keep)

    def simulate(self, loop: ClosedLoop, values: Values) -> Simulation:
        """Simulate a loop on this record."""
        more = None if self.against is None else -self.against
        given = {"force_noise": more, "place": self.place, "link": self._felt}
        ramp = self.ramp and self.place is not None
        return between.simulate(loop, self.record, values, self.oversampling, ramp=ramp, **given)

    def gap(self, loop: ClosedLoop, simulation: Simulation) -> Array:
        """Return measured minus simulated force, N or N m, (n_samples,); inf if it diverged."""
        if not simulation.finite:
            return np.full(self.record.n_samples, np.inf)
        return loop.gain * (loop.command(self.record) - simulation.nu)[:, 0]

    def likeliest(self, loop: ClosedLoop, simulation: Simulation) -> Array:
        """Return the force error of a simulation, (n_samples,), its load the likeliest."""
        e = self.gap(loop, simulation)
        if self._unknown is None or not np.isfinite(e[-1]):
            return e
        doubted, _, sizes = self._doubted
        answers, likely = self._unknown
        return e - likely - answers @ (sizes @ (doubted @ self._plain(e - likely)))

    def force_rms(self, loop: ClosedLoop) -> float:
        """Return the measured force of the samples that count, N or N m rms."""
        return rms(loop.force(self.record)[self.keep])

    def error(self, loop: ClosedLoop, values: Values) -> Array:
        """Return the whitened force error of the samples that count, (n_kept,)."""
        return self.judged(loop, self.simulate(loop, values))

    def judged(self, loop: ClosedLoop, simulation: Simulation) -> Array:
        """Return the whitened force error of a simulation, (n_kept,); large if it diverged."""
        e = self._gap_but_expected(loop, simulation)
        return self.white(e) if np.isfinite(e[-1]) else np.full(self.n_kept, DIVERGED)

    def _gap_but_expected(self, loop: ClosedLoop, simulation: Simulation) -> Array:
        """Return the gap without what the command answers to the sizes that are expected."""
        e = self.gap(loop, simulation)
        return e if self._unknown is None else e - self._unknown[1]

    def cost_beside(self, basis: Array) -> Callable[[ClosedLoop, Values], float]:
        """Return a function of a loop and its values: what of the error some signals leave.

        The mean square of the whitened error that no combination of them explains; inf where the
        loop diverges.

        Parameters
        ----------
        basis : ndarray, (n_kept, m)
            The signals, orthonormal.
        """
        rows = self._metric.discounted(basis).T
        if self.doubt is not None:
            doubted, shares, _ = self._doubted
            much = np.sqrt(shares * (2.0 - shares))
            rows = np.vstack([rows, doubted * much[:, np.newaxis]])
        rows = np.ascontiguousarray(rows)

        def cost(loop: ClosedLoop, values: Values) -> float:
            """Return it without the discounted error, which is as long as the record."""
            e = self._gap_but_expected(loop, self.simulate(loop, values))
            return self._plain.left(e, rows) if np.isfinite(e[-1]) else float("inf")

        return cost

    def only(self, keep: Mask, label: str = "") -> Fold:
        """Return the fold of those of its samples that are kept."""
        limited = None if self.limited is None else self.limited & keep
        return replace(self, keep=self.keep & keep, limited=limited, label=label or self.label)

    @property
    def at_limit_too(self) -> Fold:
        """The fold with the samples at a limit: there the loop errs as it was given.

        Nothing else is looked for there, so they count where errors are said and nowhere else.
        """
        if self.limited is None:
            return self
        return replace(self, keep=self.keep | self.limited, limited=None)

    @property
    def common(self) -> Fold:
        """The fold of those of its samples where the other one has been as well."""
        if self.both is None:
            return self
        return replace(self.only(self.both), both=None)

    def stretch(self, start: int, stop: int) -> Fold:
        """Return the fold of some samples in a row."""
        rows = slice(start, stop)
        part, keep = self.record.slice(start, stop), self.keep[rows]
        place, against = (None if x is None else x[rows] for x in (self.place, self.against))
        found = replace(self, record=part, keep=keep, place=place, against=against)
        return replace(found, both=None, limited=None)


def block_t(sums: Array) -> float:
    """Return the t value of a total over blocks that count as independent.

    Parameters
    ----------
    sums : ndarray, (n_blocks,)
    """
    spread = float(np.linalg.norm(sums - np.mean(sums)))
    return float(np.sum(sums)) / max(spread, 1e-300)


def better_t(folds: Sequence[Fold], worse: Sequence[Array], better: Sequence[Array]) -> float:
    """Return the block t value by which the second of two errors is smaller, over all folds.

    Parameters
    ----------
    folds : sequence of Fold
    worse, better : sequence of ndarray, (n_kept,)
        Whitened errors on each.
    """
    pairs = zip(folds, worse, better, strict=True)
    return block_t(np.concatenate([fold.block_sums(a**2 - b**2) for fold, a, b in pairs]))


def usable(record: Record, loop: ClosedLoop) -> Mask:
    """Return the samples at which command and simulation can be compared, (n_samples,).

    Left out: the transient of the initial state, the command at its limit, and standstill, where
    the axis is stuck wherever friction caught it and the command says little about the model. What
    stands at first shows its initial state until it has moved off; at the end the law may take
    derivatives of the reference that the record cannot give.
    """
    keep = np.ones(record.n_samples, dtype=bool)
    keep[: _moved_off(record) + settling(record)] = False
    keep[len(keep) - ahead(record, loop.controller) :] = False
    own = loop.command(record)[:, 0]
    own = own - record.added[:, 0] if record.added is not None else own
    keep &= ~near(np.abs(own) >= AT_LIMIT * loop.controller.limit, round(NEARBY / record.dt))
    return keep & ~_standing(record)


def stepped(record: Record) -> Mask:
    """Return the samples at which a step of an added input still shows, (n_samples,).

    None, if it jumps so often that this would be most of the record.
    """
    none = np.zeros(record.n_samples, dtype=bool)
    if record.added is None:
        return none
    change = np.abs(np.diff(record.added[:, 0], prepend=record.added[0, 0]))
    at = change > MOST * np.max(change)
    shows = signal.lfilter(np.ones(settling(record)), [1.0], at.astype(float)) > 0.5
    return shows if np.mean(shows) < MOST else none


def settling(record: Record) -> int:
    """Return the samples after a start in which the initial state still shows."""
    return round((TRANSIENT if record.load is None else LINKED_TRANSIENT) / record.dt)


def _moved_off(record: Record) -> int:
    """Return the samples before the axis first leaves where it stands."""
    away = np.abs(record.q[:, 0] - record.q[0, 0])
    return int(np.argmax(away > MOVED_OFF * np.max(away)))


def _standing(record: Record) -> Mask:
    """Return the samples at which the reference rests, (n_samples,).

    The axis does, if the reference moves in steps: it follows them while the reference rests.
    """
    assert record.q_ref is not None
    width = max(round(REST / record.dt), 1)
    speed = np.abs(np.gradient(record.q_ref[:, 0], record.dt))
    still = speed < STANDING * np.max(speed)
    if np.mean(~still) < ONE_WAY:
        q = record.q[:, 0]
        moved = np.abs(q - np.concatenate([np.full(width, q[0]), q])[: len(q)])
        return moved < MOVED_OFF * np.ptp(q)
    run = signal.lfilter(np.ones(width), [1.0], still) > width - 0.5
    return np.asarray(run, dtype=bool)


def near(mask: Mask, width: int) -> Mask:
    """Return the samples at most so many away from those of a mask, (n_samples,)."""
    if not mask.any():
        return mask
    return np.convolve(mask, np.ones(2 * width + 1), mode="same") > 0.5
