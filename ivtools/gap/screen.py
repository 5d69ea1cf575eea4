"""Screen: how much of the gap each effect could explain, to first order.

One column per parameter and starting shape, none of them fitted: a score test. Force laws need no
simulation of their own, only their force along the trajectory and the loop's linear response;
effects that change the structure are simulated once per starting point and record, for what they
change hardly depends on the other effects in the model.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..limits import LARGEST
from ..linalg import as_columns
from ..loop import Simulation
from ..physics import Term
from . import spatial_lines
from .fit import Fit, normal
from .fold import Fold
from .library import Box, Scales, alternatives, scans
from .rules import ASKED, GLANCE

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Score:
    """What one effect could explain on one fold.

    Parameters
    ----------
    term : Term
    gain : float
        R2 gain: share of the whitened energy of the gap.
    starts : list of mapping
        Starting values of the effect's parameters, by short name: the best ones for each choice
        of its nuisances, the best of all first.
    scores : ndarray, (n_blocks,)
        What each block says against the effect: how far chance could make it look better.
    """

    term: Term
    gain: float
    starts: list[dict[str, float]]
    scores: Array


@dataclass(frozen=True, eq=False)
class _Start:
    """One starting point of an effect, and whose sizes the coefficients of its columns are."""

    term: Term
    shape: dict[str, float]
    names: tuple[str, ...]
    columns: Array  # forces, (n_samples, m), or the changes of the whitened error, (n_kept, m)
    pushes: bool = False  # whether they are forces, which are still to be answered


def screen(fit: Fit, terms: list[Term]) -> dict[str, Score]:
    """Score every effect against the residual of a fit.

    Parameters
    ----------
    fit : Fit
        The model without these effects, on the fold that is judged.
    terms : list of Term
        What is tried.

    Returns
    -------
    dict
        Effect to `Score`.
    """
    fold, now, e = fit.fold, fit.simulation, fit.beyond_base()
    lines = spatial_lines.search(fold, e, now, terms)
    tried = [
        _direction(fit, now, term, shape)
        for term in terms
        for shape in _shapes(term, fold.scales, now, lines)
    ]
    found: dict[str, list[Score]] = {}
    for d in _beyond_base(tried, fit):
        found.setdefault(d.term.name, []).append(_score(d, e, fold))
    for term in terms:
        if term.search == "valleys" and term.name not in found:  # every glance has strayed
            found[term.name] = [_unseen(term, fold)]
    return {name: _best(scores) for name, scores in found.items()}


def _beyond_base(tried: list[_Start], fit: Fit) -> Iterator[_Start]:
    """Yield what starting points change beyond a base model, all forces answered at once.

    Those are left out whose loop has diverged.
    """
    pushes = [d for d in tried if d.pushes]
    forces = [f for d in pushes for f in d.columns.T]
    wide = fit.fold.answers(as_columns(forces)) if forces else np.empty((fit.fold.n_kept, 0))
    edges = np.cumsum([0, *(d.columns.shape[1] for d in pushes)])
    parts = dict(zip(pushes, map(slice, edges[:-1], edges[1:]), strict=True))
    for d in tried:
        columns = wide[:, parts[d]] if d in parts else d.columns
        if _sound(columns):
            yield replace(d, columns=fit.beyond_base(columns))


def _best(scores: list[Score]) -> Score:
    """Return the best score, with the best starts for each choice of the nuisances."""
    ordered = sorted(scores, key=lambda s: -s.gain)
    nuisances = [p.name for p in ordered[0].term.parameters if p.nuisance]
    starts: dict[tuple[float, ...], dict[str, float]] = {}
    for score in ordered:
        (start,) = score.starts
        starts.setdefault(tuple(start[n] for n in nuisances), start)
    return replace(ordered[0], starts=list(starts.values()))


def _shapes(
    term: Term, scales: Scales, now: Simulation, lines: dict[str, list[float]]
) -> list[dict[str, float]]:
    if term.search == "lines":
        turns = scales.turns if any(p.turn for p in term.parameters) else ()
        others = [p for p in lines[term.name] if not (turns and scales.a_turn(p))]
        return [{term.period: p} for p in (*others, *turns)]
    if term.search == "either":
        return alternatives(term, scales)
    if term.by_inverse:  # a limit of the drive: how much of the force exceeds it
        shares = np.geomspace(*ASKED, 1 << GLANCE)
        asked = np.quantile(np.abs(now.tau), 1.0 - shares).tolist()
        return [{term.parameters[0].name: x} for x in asked]
    if term.search == "valleys":  # a glance: the search waits until the effect is in question
        boxes = [*Box.of(term, scales), *Box.wider(term, scales)]
        return [point for box in boxes for point in box.points(GLANCE)]
    return scans(term, scales)


def _direction(fit: Fit, now: Simulation, term: Term, shape: dict[str, float]) -> _Start:
    """Return the force of an effect, or the change that it makes."""
    if (term.law is not None and term.search != "valleys") or term.as_force is not None:
        names = tuple(p.name for p in term.parameters if p.linear)
        return _Start(term, shape, names, unit_forces(fit, now, term, shape), True)
    key, fold = (term.name, *shape.items()), fit.fold
    if key not in fold.simulated:
        loop = fit.loop.with_effect(term, **shape)
        then = fold.simulate(loop, loop.values(fit.values))
        fold.simulated[key] = fold.gap(loop, then) - fold.gap(fit.loop, now)
    return _Start(term, shape, (), fold.white(fold.simulated[key])[:, None])


def unit_forces(fit: Fit, now: Simulation, term: Term, shape: dict[str, float]) -> Array:
    """Return the forces of an effect that is one, N or N m, per unit of each size, (n_samples, m).

    Parameters
    ----------
    fit : Fit
        Whose motion is `now`.
    now : Simulation
    term : Term
        With a law, or its like.
    shape : mapping
        Parameters that are no sizes, by short name.
    """
    if term.as_force is not None:
        own = [shape[p.name] for p in term.parameters if not p.linear]
        return np.asarray(term.as_force(now.where, fit.fold.record.dt, fit.values["inertia"], *own))
    linear = [i for i, p in enumerate(term.parameters) if p.linear]
    return as_columns(unit_force(term, i, shape, now) for i in linear or [-1])


def unit_force(term: Term, index: int, shape: dict[str, float], simulation: Simulation) -> Array:
    """Return the force of one unit of a law's parameter, N or N m, (n_samples,).

    Parameters
    ----------
    term : Term
    index : int
        Of the parameter; all other sizes are zero.
    shape : mapping
        Parameters that are no sizes, by short name; the rest is neutral.
    simulation : Simulation
    """
    q, dq, ddq = simulation.where, simulation.dq[:, 0], simulation.ddq[:, 0]
    unit = term.unit(index, shape)
    return term.force(q, dq, ddq, unit, simulation.tau[:, 0], simulation.t - simulation.t[0])


def _sound(columns: Array) -> bool:
    """Whether columns are of a loop that did not diverge: its end may be huge and finite."""
    return bool(np.max(np.abs(columns), initial=0.0) < LARGEST)


def _score(d: _Start, e: Array, fold: Fold) -> Score:
    """Regress the residual on the columns that the base model does not already have."""
    beta = normal(d.columns, e)
    explained = d.columns @ beta
    gain = float(explained @ e / (e @ e))
    amplitudes = {n: -float(b) for n, b in zip(d.names, beta, strict=False)}
    start = {p.name: p.neutral for p in d.term.parameters} | d.shape | amplitudes
    reverse = not d.names and beta[0] > 0.0
    if reverse or not _within(d.term, start):  # only the reverse of the effect would help
        gain = 0.0
    rest = e - explained
    scores = fold.block_sums(explained * rest)
    return Score(d.term, gain, [start], scores)


def _unseen(term: Term, fold: Fold) -> Score:
    """Return the score of an effect of which the screening sees nothing."""
    start = {p.name: p.neutral for p in term.parameters}
    return Score(term, 0.0, [start], fold.block_sums(np.zeros(fold.n_kept)))


def _within(term: Term, values: Mapping[str, float]) -> bool:
    return all(p.lower <= values[p.name] <= p.upper for p in term.parameters)
