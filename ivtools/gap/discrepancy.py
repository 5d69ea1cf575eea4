"""Discrepancy: a force that repeats and is none of the known effects, described instead of named.

What the named effects leave is regressed on a penalised spline over position, speed, direction and
load, and on what remembers, through the response of the loop: any law of the axis, known or not,
is close to one. The penalty is the one that predicts the other fold best, so what does not come
again is not in it.

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
from .rules import DISCREPANCY_PART, DISCREPANCY_SIZE, DISCREPANCY_T, PENALTIES
from .smooth import OVER, Basis, beside, signals

Array = NDArray[np.float64]


_NAMES = {
    "q": "position",
    "dq": "speed",
    "load": "load",
    "state": "position and speed together",
    "past": "the motion before",
}


@dataclass(frozen=True, eq=False)
class Discrepancy:
    """A force that the model lacks, comes again, and is not among the known effects.

    Parameters
    ----------
    rms : float
        Of the force beyond what the base parameters make, N or N m.
    unit : str
    over : tuple of str
        What it depends on, of `smooth.OVER`; direction is in each.
    gain : float
        Share of the whitened energy left that it removes on held-out data.
    curve : tuple of (float, float, float)
        Over the first signal of `over`: its value (SI), and the mean force forwards and backwards.
    """

    rms: float
    unit: str
    over: tuple[str, ...]
    gain: float
    curve: tuple[tuple[float, float, float], ...]

    @property
    def text(self) -> str:
        """What is there, as a sentence."""
        over = " and ".join(_NAMES[n] for n in self.over)
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
    seen = [beside(f, f.fold.answers(F)) for f, F in zip(fits, forces, strict=True)]
    rests = [beside(f, f.e[:, None])[:, 0] for f in fits]
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
    return Discrepancy(whole, unit, over, gain, _curve(basis, over[0], runs, forces, beta))


def _smoothed(
    fits: Sequence[Fit], seen: Sequence[Array], rests: Sequence[Array], rough: Array
) -> tuple[Array, float, float]:
    """Return the common spline, its gain on held-out data and the t value of that gain."""
    squares = [C.T @ C for C in seen]
    sides = [C.T @ e for C, e in zip(seen, rests, strict=True)]
    size = float(np.mean([np.trace(A) for A in squares])) / len(rough.T)
    best: tuple[float, float, float] = (-np.inf, 0.0, 0.0)
    for penalty in PENALTIES:
        R = penalty * size * rough.T @ rough
        betas = [_solved(A + R, -b) for A, b in zip(squares, sides, strict=True)]
        saved = np.concatenate([
            f.fold.block_sums(e**2 - (e + C @ other) ** 2)
            for f, C, e, other in zip(fits, seen, rests, betas[::-1], strict=True)
        ])  # fmt: skip
        gain = float(np.sum(saved)) / sum(float(e @ e) for e in rests)
        t = float(np.sum(saved)) / max(float(np.linalg.norm(saved - saved.mean())), 1e-300)
        best = max(best, (gain, t, penalty))
    gain, t, penalty = best
    R = penalty * size * rough.T @ rough
    return _solved(squares[0] + squares[1] + R, -sides[0] - sides[1]), gain, t


def _solved(A: Array, b: Array) -> Array:
    """Return the solution of normal equations that may be singular, (m,)."""
    A = A + 1e-9 * np.trace(A) / len(A) * np.eye(len(A))
    return np.asarray(np.linalg.solve(A, b), dtype=float)


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


def _curve(
    basis: Basis,
    name: str,
    runs: Sequence[Simulation],
    forces: Sequence[Array],
    beta: Array,
) -> tuple[tuple[float, float, float], ...]:
    """Return the mean force at the knots of one signal, forwards and backwards."""
    name = {"state": "q", "past": "dq"}.get(name, name)
    kinds = dict(zip(("q", "dq", "load"), signals(runs), strict=True))
    x = np.concatenate([s[:, 0] for s in kinds[name]])
    hats = basis.hats(name, x if name == "q" else np.abs(x))
    ahead = np.concatenate([r.dq[:, 0] for r in runs]) > 0.0
    force = np.concatenate([F @ beta for F in forces])
    weight = [hats[rows].sum(axis=0) for rows in (ahead, ~ahead)]
    mean = [hats[rows].T @ force[rows] / np.maximum(w, 1e-300)
            for rows, w in zip((ahead, ~ahead), weight, strict=True)]  # fmt: skip
    seen = (weight[0] > 0.0) & (weight[1] > 0.0)
    points = np.column_stack([basis.knots[name], *mean])[seen]
    return tuple((float(k), float(a), float(b)) for k, a, b in points)
