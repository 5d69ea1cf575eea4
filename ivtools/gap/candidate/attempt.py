"""Attempt: an effect is fitted on each fold, and tried as it is on the other one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...loop import ClosedLoop
from ...physics import Term
from ...workers import threaded
from ..fit import Fit, common, cost, gauss_newton, steps, without_slopes
from ..fold import Fold
from ..library import Scales
from ..rules import ADEQUATE, GOES_ON, NEARLY_ALL, RETUNED, SOME, VALLEY_STEPS
from ..screen import Score
from .starts import Point, beginning, beside, starts
from .trial import Trial

#: Fits of one fold's effect on the other, by that fold's fit and, if its phases count, the own one.
Made = dict[tuple[Fit, Fit | None], Fit]


def attempt(
    fits: tuple[Fit, ...],
    before: tuple[Fit, ...],
    scores: list[Score],
    left: float,
    place: Mapping[str, float] | None = None,
) -> Trial | None:
    """Fit an effect on each fold, and judge it on the other; None if there is nothing to fit.

    One that depends on the position is fitted and judged where both folds have been.

    Parameters
    ----------
    fits, before : tuple of Fit
        The model without it, fitted to each fold, and with the effects that the other one found.
    scores : list of Score
        Its screening on each.
    left : float
        Whitened energy that everything else leaves: how hard to look for it.
    place : mapping, optional
        Where its valley is known to be: its parameters by short name.
    """
    term = scores[0].term
    if term.local:
        fits, before = common(fits), common(before)
    begin = starts(fits, scores, left, place)
    if not all(begin):
        return None
    found = _tried(fits, before, term, begin)
    if cost(found.held) >= ADEQUATE and all(others := beside(fits, term, begin[0][0])):
        found = min(found, _tried(fits, before, term, others), key=_order)
    leads = found.meant and ADEQUATE <= cost(found.held) < left
    worth = term.gaps and leads and max(found.explained) >= SOME
    return _by_simplex(found) if worth else found


def _order(trial: Trial) -> tuple[bool, float]:
    """Return what trials of an effect are compared by, the least first."""
    return not trial.meant, cost(trial.held)


def _tried(
    fits: tuple[Fit, ...], before: tuple[Fit, ...], term: Term, begin: tuple[list[Point], ...]
) -> Trial:
    """Return what comes of these starting values, per fold."""
    new = tuple(threaded(lambda f, b: _extended(f, term, b), fits, begin))
    if any(n.cost < NEARLY_ALL * f.cost for n, f in zip(new, fits, strict=True)):
        new = deeper(new, term)
    return Trial(term, *_exchanged(new), before)


def _by_simplex(trial: Trial) -> Trial:
    """Return a trial of a load that rattles, gone on with a simplex if the other fold agrees.

    Contacts are rough: at the bottom of their valley slopes lead nowhere.
    """
    term = trial.term
    new = tuple(
        threaded(lambda f: f if f.cost < ADEQUATE else without_slopes(f, term.names), trial.fits)
    )
    return min(trial, Trial(term, *_exchanged(new), trial.before), key=_order)


def _exchanged(new: tuple[Fit, ...]) -> tuple[tuple[Fit, ...], tuple[Fit, ...]]:
    """Return fits of both folds, and each fold with what the other one has.

    What one has of the other may in turn be better than what that has itself: then that is stuck.
    """
    made: Made = {}
    held = frozen(new, made=made)
    for _ in new:
        if not any(h.cost < n.cost for n, h in zip(new, held, strict=True)):
            break
        new = tuple(threaded(_onwards, new, held))
        held = frozen(new, made=made)
    return new, held


def _onwards(own: Fit, held: Fit) -> Fit:
    """Return a fit, or the one that goes on from the other fold's effect where that is better."""
    if own.cost <= held.cost:
        return own
    return own.refit(values=held.values)


def deeper(fits: tuple[Fit, ...], term: Term) -> tuple[Fit, ...]:
    """Return fits that go on in the valley of an effect, where either fold may have come deeper.

    The better of one that goes on, and one that starts with the other fold's effect; those of an
    effect without valleys are there already. A nuisance, which the search chose of a few values, is
    fitted as well: what it should have been would be in all others. Contacts are rough: differences
    that are wide enough to look across what is rough lose sight of the bottom, so the last steps
    take narrow ones. No load rattles twice in the same way: such a fit may come to know one fold's
    way only, and if the other one says that it has gone too far it stays where it was.
    """

    def one(own: Fit, other: Fit) -> Fit:
        """Return that of one fold."""
        others = {n: other.values[n] for n in term.names}
        loose = [n for n, p in term.by_name.items() if p.nuisance]
        free = [*dict.fromkeys([*own.free, *loose])]
        both = (own.refit(None, start, free, VALLEY_STEPS) for start in (own.values, others))
        best = min(both, key=lambda f: f.cost)
        return best.refit(free=free, iterations=VALLEY_STEPS, narrow=term.names)

    if term.search != "valleys":
        return fits
    new = tuple(threaded(one, fits, fits[::-1]))
    return min(fits, new, key=lambda way: cost(frozen(way))) if term.gaps else new


def frozen(
    fits: tuple[Fit, ...], folds: Sequence[Fold] = (), made: Made | None = None
) -> tuple[Fit, ...]:
    """Tune the base parameters on each fold, with the effects that the other fold found.

    Parameters
    ----------
    fits : tuple of Fit
        With the effects, on each fold.
    folds : sequence of Fold, optional
        What is judged, if not just these.
    made : dict, optional
        What of these fits is made already is not made again; new ones are added.
    """
    made = {} if made is None else made

    def one(fold: Fold, fit: Fit, own: Fit) -> Fit:
        """Return that of one fold."""
        key = fit, own if phases(fit.loop) else None
        if key not in made:
            made[key] = retuned(fold, fit, own)
        return made[key]

    return tuple(threaded(one, folds or [f.fold for f in fits], fits[::-1], fits))


def retuned(fold: Fold, fit: Fit, own: Fit) -> Fit:
    """Tune the base parameters on a fold, with the effects of a fit that another one found.

    Parameters
    ----------
    fold : Fold
    fit : Fit
        With the effects.
    own : Fit
        This fold's own: phases are taken from it, and the first Jacobian if it is alike.
    """
    turned = phases(fit.loop)
    base = fold.scales.loop.parameters  # as declared, its own effects with it
    free = [n for n in fit.free if n in base or n in turned]
    own_phases = {n: own.values[n] for n in turned if n in own.values}
    # a Jacobian of two masses, or of a wave that may have another period, is none of this model
    alike = not turned and not any(t.search == "valleys" for t in fit.loop.terms)
    near = own if alike and own.fold is fold else None
    return gone_on(fit.refit(fold, own_phases, free, RETUNED, near))


def gone_on(held: Fit) -> Fit:
    """Return a fit whose drifts, of a form that is known, are as large as its fold has them.

    How far what warms, or settles, still has to go is a matter of when a record begins.

    Parameters
    ----------
    held : Fit
        With drifts that another fold found.
    """
    for term in held.loop.terms:
        known = [n for n in term.linear if held.values[n] and n not in held.free]
        if not (term.of_time and known and held.simulation.finite):
            continue
        J = held.jacobian(known, steps(held.fold, held.loop))
        change = held.beyond_base(J @ [held.values[n] for n in known])
        size = 1.0 - float(change @ held.e) / max(float(change @ change), 1e-300)
        size = float(np.clip(size, 1.0 / GOES_ON, GOES_ON))
        values = {n: size * held.values[n] for n in known}
        held = held.refit(values=values, iterations=RETUNED, near=held)
    return held


def phases(loop: ClosedLoop) -> set[str]:
    """Return the parameters that are a matter of each record: an encoder is homed anew."""
    return {name for t in loop.terms for name in t.phases}


def _extended(fit: Fit, term: Term, begin: list[Point]) -> Fit:
    """Fit the model with one more effect, from its best starting values."""
    near = None if term.search == "valleys" else fit  # two masses answer as one does to nothing
    found: list[Fit] = []
    plains: list[dict[str, float]] = []
    for values in begin:
        base = beginning(fit, term, values)
        loop = fit.loop.with_effect(term, **values)
        free = [*fit.free, *_free(term, values, fit.fold.scales)]
        new = gauss_newton(fit.fold, loop, loop.values(base), free, near=near)
        if new.cost > fit.cost:  # the base parameters must give way first: begin without it
            plain = {**loop.values(fit.values), **{n: term.by_name[n].neutral for n in term.linear}}
            if plain in plains:  # starts that differ in sizes only
                continue
            plains.append(plain)
            new = gauss_newton(fit.fold, loop, plain, free, near=near)
        found.append(new)
    return min(found, key=lambda f: f.cost)


def _free(term: Term, values: Mapping[str, float], scales: Scales) -> list[str]:
    own = [p for p in term.parameters if not p.nuisance]
    own = [p for p in own if not (p.turn and scales.a_turn(values[p.name]))]  # which is known
    if term.search == "valleys":  # what starts at zero stays there: a little is another motion
        own = [p for p in own if values[p.name] != 0.0]
    shaped = term.search == "scan" and term.law is not None
    if shaped or term.search == "either":  # a shape that starts without effect stays there
        own = [p for p in own if p.linear or values[p.name] != p.neutral]
    return [f"{term.name}.{p.name}" for p in own]
