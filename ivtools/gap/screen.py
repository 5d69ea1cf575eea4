"""Screen: how much of the gap each effect could explain, to first order.

One column per parameter and starting shape, none of them fitted: a score test. Force laws need no
simulation of their own, only their force along the trajectory and the loop's linear response;
effects that change the structure are simulated once per starting point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..loop import Simulation
from ..physics import Term
from . import periods
from .candidates import PERIODIC, Scales, scans
from .fit import Fit
from .fold import Fold
from .response import Response

Array = NDArray[np.float64]

_COARSE = {"backlash": 13, "flexibility": 5}


@dataclass(frozen=True, eq=False)
class Score:
    """What one effect could explain on one fold.

    Parameters
    ----------
    term : Term
    share : float
        Share of the whitened energy of the gap.
    statistic : float
        Block-robust F statistic of the columns.
    start : mapping
        Starting values of the effect's parameters, by short name.
    """

    term: Term
    share: float
    statistic: float
    start: dict[str, float]


@dataclass(frozen=True, eq=False)
class _Direction:
    """Whitened columns of one starting point, and how to read their coefficients."""

    term: Term
    shape: dict[str, float]
    names: tuple[str, ...]
    columns: Array  # (n_samples, m) before whitening


def screen(fit: Fit, response: Response, terms: list[Term], scales: Scales) -> dict[str, Score]:
    """Score every effect against the residual of a fit.

    Parameters
    ----------
    fit : Fit
        The model without these effects.
    response : Response
        Of the command to a force.
    terms : list of Term
        What is tried.
    scales : Scales

    Returns
    -------
    dict
        Effect to `Score`.
    """
    simulation = fit.fold.simulate(fit.loop, fit.values)
    basis = _orthonormal(fit.J)
    e = fit.e - basis @ (basis.T @ fit.e)
    lines = periods.search(fit.fold, response, e, simulation)
    tasks = [(term, shape) for term in terms for shape in _shapes(term, scales, lines)]

    def direction(task: tuple[Term, dict[str, float]]) -> _Direction:
        return _direction(fit, response, scales, simulation, *task)

    directions = [d for d in map(direction, tasks) if d.columns.size]
    best: dict[str, Score] = {}
    for d, white in zip(directions, _whitened(fit.fold, directions), strict=True):
        score = _score(d, white, basis, e, fit.fold)
        if d.term.name not in best or score.share > best[d.term.name].share:
            best[d.term.name] = score
    return best


def _shapes(term: Term, scales: Scales, lines: dict[str, list[float]]) -> list[dict[str, float]]:
    if term.name in PERIODIC:
        return [{"period": p} for p in lines[term.name]]
    if any(p.name == "period" for p in term.parameters):
        return [{"period": p} for p in lines["cogging"]]
    if term.name == "drive-timing":
        return [
            {"delay": 0.5 * scales.record.dt, "lag": 0.0},
            {"delay": 0.0, "lag": 0.5 * scales.record.dt},
        ]
    if term.name in _COARSE:  # the dense scan waits until the effect is in question
        return list(scans(term, scales))[:: _COARSE[term.name]]
    return list(scans(term, scales))


def _direction(
    fit: Fit,
    response: Response,
    scales: Scales,
    simulation: Simulation,
    term: Term,
    shape: dict[str, float],
) -> _Direction:
    """Return the change of the error that the effect makes, (n_samples, m)."""
    if term.law is not None and any(p.linear for p in term.parameters):
        linear = [i for i, p in enumerate(term.parameters) if p.linear]
        names = tuple(term.parameters[i].name for i in linear)
        forces = np.column_stack([_law(term, i, shape, simulation) for i in linear])
        return _Direction(term, shape, names, -response(forces))
    if term.name == "encoder-eccentricity":
        return _Direction(
            term, shape, ("cosine", "sine"), -response(_eccentric(fit, simulation, shape))
        )
    loop = fit.loop.with_effect(term, **shape)
    e = fit.fold.force_error(loop, {**loop.values(fit.values)})
    if not np.isfinite(e[-1]):
        return _Direction(term, shape, (), np.empty((len(e), 0)))
    return _Direction(term, shape, (), (e - fit.fold.force_error(fit.loop, fit.values))[:, None])


def _law(term: Term, index: int, shape: dict[str, float], simulation: Simulation) -> Array:
    q, dq, ddq = (a[:, 0] for a in simulation.motion)
    unit = [
        shape.get(p.name, p.neutral) if not p.linear else float(i == index)
        for i, p in enumerate(term.parameters)
    ]
    return term.force(q, dq, ddq, unit, simulation.tau[:, 0], simulation.t - simulation.t[0])


def _eccentric(fit: Fit, simulation: Simulation, shape: dict[str, float]) -> Array:
    """Return the force that moves the axis as an encoder error does: -M d2/dt2, (n_samples, 2)."""
    angle = 2.0 * np.pi * simulation.q[:, 0] / shape["period"]
    waves = np.column_stack([np.cos(angle), np.sin(angle)])
    dt = fit.fold.record.dt
    return -fit.values["inertia"] * np.gradient(np.gradient(waves, dt, axis=0), dt, axis=0)


def _whitened(fold: Fold, directions: list[_Direction]) -> list[Array]:
    return [fold.white(d.columns) for d in directions]


def _orthonormal(J: Array) -> Array:
    scale = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    return np.linalg.qr(J / scale)[0]


def _score(d: _Direction, white: Array, basis: Array, e: Array, fold: Fold) -> Score:
    """Regress the residual on the columns that the base model does not already have."""
    C = white - basis @ (basis.T @ white)
    scale = np.maximum(np.linalg.norm(C, axis=0), 1e-300)
    beta = np.linalg.lstsq(C / scale, e, rcond=1e-6)[0] / scale
    explained = C @ beta
    share = float(explained @ e / (e @ e))
    amplitudes = {n: -float(b) for n, b in zip(d.names, beta, strict=False)}
    start = {p.name: p.neutral for p in d.term.parameters} | d.shape | amplitudes
    if not d.names and beta[0] > 0.0:  # only the reverse of the effect would help
        share = 0.0
    return Score(d.term, share, _statistic(C, e - explained, beta, fold), start)


def _statistic(C: Array, e: Array, beta: Array, fold: Fold) -> float:
    scores = fold.block_sums(C * e[:, None])
    bread = C.T @ C
    meat = scores.T @ scores
    value = beta @ bread @ np.linalg.lstsq(meat, bread @ beta, rcond=1e-9)[0]
    return float(value) / len(beta)
