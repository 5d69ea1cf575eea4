"""Discrepancy: a force that repeats and is none of the known effects, described instead of named.

What the named effects leave is regressed on a penalised spline over position, speed, direction and
load, through the response of the loop: any static law of the axis, known or not, is close to one.
The penalty is the one that predicts the other fold best, so what does not come again is not in it.

P. H. C. Eilers, B. D. Marx, "Flexible smoothing with B-splines and penalties", Statistical
Science 11(2), 1996.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..loop import Simulation
from .fit import Fit, normal
from .rules import (
    DISCREPANCY_PART,
    DISCREPANCY_SIZE,
    DISCREPANCY_T,
    LEAST_KNOTS,
    MOST_KNOTS,
    PENALTIES,
    POSITION_KNOTS,
    SPEED_KNOTS,
)

Array = NDArray[np.float64]

OVER = ("q", "dq", "load")


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """A force that the model lacks, comes again, and is not among the known effects.

    Parameters
    ----------
    rms : float
        Of the force beyond what the base parameters make, N or N m.
    unit : str
    over : tuple of str
        What it depends on: ``"q"``, ``"dq"``, ``"load"``; direction is in each.
    gain : float
        Share of the whitened energy left that it removes on held-out data.
    curve : tuple of (float, float, float)
        Over the first of `over`: its value (SI), and the force forwards and backwards.
    """

    rms: float
    unit: str
    over: tuple[str, ...]
    gain: float
    curve: tuple[tuple[float, float, float], ...]

    @property
    def text(self) -> str:
        """What is there, as a sentence."""
        names = {"q": "position", "dq": "speed", "load": "load"}
        over = " and ".join(names[n] for n in self.over)
        return (
            f"a force of {self.rms:.2g} {self.unit} rms over {over} and direction repeats and is "
            "not among the known effects"
        )

    def to_dict(self) -> dict[str, object]:
        """Return the JSON of the discrepancy."""
        return {
            "rms": self.rms,
            "unit": self.unit,
            "over": list(self.over),
            "repeats": True,
            "gain": self.gain,
            "curve": [list(point) for point in self.curve],
        }


@dataclass(frozen=True, eq=False)
class Basis:
    """Hat functions over position, speed and load, apart for each direction.

    Parameters
    ----------
    knots : mapping
        Of each signal, common to both folds.
    """

    knots: dict[str, Array]

    @classmethod
    def of(cls, runs: Sequence[Simulation], spacing: float = 0.0) -> Basis:
        """Return the basis that spans what several simulations have in common.

        Parameters
        ----------
        runs : sequence of Simulation
        spacing : float
            Least distance of its knots over position, m or rad.
        """
        q, dq, tau = (np.concatenate([s[:, 0] for s in kind]) for kind in _signals(runs))
        speed = np.quantile(np.abs(dq), np.linspace(0.02, 1.0, SPEED_KNOTS))
        return cls(
            {
                "q": np.linspace(q.min(), q.max(), _knots(float(np.ptp(q)), spacing)),
                "dq": np.unique(speed),
                "load": np.linspace(0.0, float(np.max(np.abs(tau))), 4)[1:],
            }
        )

    def columns(self, run: Simulation) -> Array:
        """Return the forces, one column per hat and direction, (n_samples, m)."""
        q, dq, tau = (s[0][:, 0] for s in _signals([run]))
        sign = np.sign(dq)
        found = []
        for name, x in (("q", q), ("dq", np.abs(dq)), ("load", np.abs(tau))):
            hats = self.hats(name, x)
            found += [hats, hats * sign[:, None]]
        return np.hstack(found)

    def hats(self, name: str, x: Array) -> Array:
        """Return the hat functions of a signal at some values, (n, knots)."""
        return np.column_stack([np.interp(x, self.knots[name], row) for row in self._unit(name)])

    def _unit(self, name: str) -> Array:
        return np.eye(len(self.knots[name]))

    def part(self, name: str) -> slice:
        """Return the columns of a signal, of both directions."""
        sizes = [2 * len(self.knots[n]) for n in OVER]
        start = sum(sizes[: OVER.index(name)])
        return slice(start, start + 2 * len(self.knots[name]))

    def penalty(self) -> Array:
        """Return rows that measure the roughness, second differences of neighbours, (r, m)."""
        blocks = [np.diff(self._unit(n), 2, axis=0) for n in OVER for _ in (0, 1)]
        rows, width = sum(len(b) for b in blocks), sum(b.shape[1] for b in blocks)
        out, i, j = np.zeros((rows, width)), 0, 0
        for b in blocks:
            out[i : i + len(b), j : j + b.shape[1]] = b
            i, j = i + len(b), j + b.shape[1]
        return out


def _knots(stroke: float, spacing: float) -> int:
    """Return how many knots a stroke gets."""
    if spacing <= 0.0:
        return POSITION_KNOTS
    return int(np.clip(stroke / spacing, LEAST_KNOTS, MOST_KNOTS))


def unlike_smooth(before: Sequence[Fit], after: Sequence[Fit], period: float) -> float:
    """Return how much of what lies over position is a line, and no law of the state, 0 to 1.

    A smooth law has no room for the line's periods: knots over position that are one period apart.
    Another law, with four knots a period, takes what the line leaves: bumps are no line.

    Parameters
    ----------
    before, after : sequence of Fit
        Without and with the line, on each fold.
    period : float
        Of the line over position, m or rad.
    """
    runs = [f.fold.simulate(f.loop, f.values) for f in before]
    smooth, bumps, kept = Basis.of(runs, period), Basis.of(runs, 0.25 * period), []
    for b, a, run in zip(before, after, runs, strict=True):
        known = _beside(b, b.fold.answers(smooth.columns(run)))
        pair = _beside(b, np.column_stack([b.e - a.e, b.e, a.e]))
        beyond = _without(known, pair)
        line = _explained(beyond[:, :2])
        over = bumps.part("q")
        other = _without(known, _beside(b, b.fold.answers(bumps.columns(run)[:, over])))
        left = beyond[:, 2] - _without(other, beyond[:, 2:])[:, 0]
        left_energy = max(float(left @ left) - other.shape[1], 0.0)  # the floor is one a column
        share = line / max(_explained(pair[:, :2]), 1e-300)
        kept.append(share * line / max(line + left_energy, 1e-300))
    return min(kept)


def _without(columns: Array, x: Array) -> Array:
    """Return what is left of whitened signals (n, k) beside some columns (n, m)."""
    C = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return np.asarray(x - C @ np.column_stack([normal(C, y, 1e-5) for y in x.T]))


def _explained(pair: Array) -> float:
    """Return the energy of the second column that the first one explains."""
    change, e = pair.T
    return float(change @ e) ** 2 / max(float(change @ change), 1e-300)


def _signals(runs: Sequence[Simulation]) -> tuple[list[Array], ...]:
    return [r.q for r in runs], [r.dq for r in runs], [r.tau for r in runs]


def describe(fits: Sequence[Fit]) -> Discrepancy | None:
    """Return the force that repeats in what two fits leave; None if there is none.

    Parameters
    ----------
    fits : sequence of Fit
        The model with all that is named, on each fold.
    """
    runs = [f.fold.simulate(f.loop, f.values) for f in fits]
    if not all(r.finite for r in runs) or any(f.fold.response is None for f in fits):
        return None
    basis = Basis.of(runs)
    forces = [basis.columns(r) for r in runs]
    seen = [_beside(f, f.fold.answers(F)) for f, F in zip(fits, forces, strict=True)]
    rests = [_beside(f, f.e[:, None])[:, 0] for f in fits]
    beta, gain, t = _smoothed(fits, seen, rests, basis.penalty())
    if t < DISCREPANCY_T or gain <= 0.0:
        return None
    force = [F[f.fold.keep] @ beta for f, F in zip(fits, forces, strict=True)]
    own = [_base_forces(f, r) for f, r in zip(fits, runs, strict=True)]
    beyond = np.concatenate([x - B @ normal(B, x, 1e-6) for x, B in zip(force, own, strict=True)])
    whole = float(np.sqrt(np.mean(beyond**2)))
    if whole < DISCREPANCY_SIZE * min(f.force_rms for f in fits):
        return None
    parts = _parts(fits, forces, own, beta, basis)
    over = tuple(n for n in sorted(parts, key=lambda n: -parts[n])
                 if parts[n] >= DISCREPANCY_PART * max(parts.values()))  # fmt: skip
    unit = "N" if fits[0].loop.joint == "prismatic" else "N m"
    return Discrepancy(whole, unit, over, gain, _curve(basis, over[0], beta))


def _beside(fit: Fit, columns: Array) -> Array:
    """Return what the base model cannot imitate of whitened columns."""
    scale = np.maximum(np.linalg.norm(fit.J, axis=0), 1e-300)
    Q = np.linalg.qr(fit.J / scale)[0]
    return columns - Q @ (Q.T @ columns)


def _smoothed(
    fits: Sequence[Fit], seen: Sequence[Array], rests: Sequence[Array], rough: Array
) -> tuple[Array, float, float]:
    """Return the common spline, its gain on held-out data and the least t value of that gain."""
    size = float(np.mean([np.trace(C.T @ C) for C in seen])) / seen[0].shape[1]
    best: tuple[float, float, float] = (-np.inf, 0.0, 0.0)
    for penalty in PENALTIES:
        weight = penalty * size
        betas = [_solved(C, e, rough, weight) for C, e in zip(seen, rests, strict=True)]
        saved = [
            f.fold.block_sums(e**2 - (e + C @ other) ** 2)
            for f, C, e, other in zip(fits, seen, rests, betas[::-1], strict=True)
        ]
        gain = float(sum(np.sum(s) for s in saved) / sum(e @ e for e in rests))
        t = min(float(np.sum(s)) / max(float(np.linalg.norm(s - s.mean())), 1e-300) for s in saved)
        best = max(best, (gain, t, weight))
    gain, t, weight = best
    return _solved(np.vstack(seen), np.concatenate(rests), rough, weight), gain, t


def _solved(C: Array, e: Array, rough: Array, weight: float) -> Array:
    """Return the penalised regression of -e on C: the force that removes the error, (m,)."""
    A = C.T @ C + weight * rough.T @ rough
    A += 1e-9 * np.trace(A) / len(A) * np.eye(len(A))
    return np.asarray(np.linalg.solve(A, -C.T @ e), dtype=float)


def _base_forces(fit: Fit, run: Simulation) -> Array:
    """Return the forces of the base parameters along a simulation, (n_kept, p), to unit size."""
    dq, keep = run.dq[:, 0], fit.fold.keep
    ddq = np.gradient(dq, fit.fold.record.dt)
    B = np.column_stack([ddq, dq, np.sign(dq), np.ones(len(dq))])[keep]
    return np.asarray(B / np.maximum(np.linalg.norm(B, axis=0), 1e-300))


def _parts(
    fits: Sequence[Fit],
    forces: Sequence[Array],
    own: Sequence[Array],
    beta: Array,
    basis: Basis,
) -> dict[str, float]:
    """Return the rms of what each signal contributes beyond the base parameters."""
    found = {}
    for name in OVER:
        columns = basis.part(name)
        squares = []
        for f, F, B in zip(fits, forces, own, strict=True):
            x = F[f.fold.keep, columns] @ beta[columns]
            squares.append(float(np.mean((x - B @ normal(B, x, 1e-6)) ** 2)))
        found[name] = float(np.sqrt(np.mean(squares)))
    return found


def _curve(basis: Basis, name: str, beta: Array) -> tuple[tuple[float, float, float], ...]:
    """Return the force over one signal, forwards and backwards, at its knots."""
    own = beta[basis.part(name)]
    even, odd = np.split(own, 2)
    return tuple(
        (float(x), float(a + b), float(a - b))
        for x, a, b in zip(basis.knots[name], even, odd, strict=True)
    )
