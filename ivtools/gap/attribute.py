"""Attribute: which of the effects are named, judged on data they were not fitted to.

An effect is fitted on one fold, frozen, and the base parameters are tuned again on the other fold.
It is named when it removes a material share of the gap there, in both directions, in most of the
blocks, and does there nearly what its own fit would do: an effect that replicates. Rounds of a
forward selection add one effect each; a backward pass drops what a later one made superfluous.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..loop import ClosedLoop
from ..physics import EFFECTS, Term
from .candidate import Trial, attempt, frozen
from .discrepancy import Laws, Spline, advantage, fitted, least_t
from .fit import Fit, gauss_newton, steps
from .fold import Side, threaded
from .library import library
from .rules import (
    ADEQUATE,
    CLEAN,
    DISCREPANCY_T,
    DRAWS,
    ENOUGH,
    LEAST_EVENNESS,
    LEAST_EVIDENCE,
    LIKELY,
    MORE,
    MOST_DISAGREEMENT,
    RIVAL,
    ROUGH,
    STANDARD_ERRORS,
    SUPERFLUOUS,
    SUREST,
    TIE,
    TWIN,
    UNNAMED,
    WEIGHTS,
    WORTH_A_FIT,
    Rules,
)
from .screen import Score, screen
from .smooth import beside

Array = NDArray[np.float64]

# --- evidence --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Evidence:
    """What speaks for the name of an effect.

    Parameters
    ----------
    gain : float
        Least R2 gain on held-out data.
    t : float
        Least block-robust t value of its frozen amplitude there.
    disagreement : float
        Factor by which the folds disagree in its amplitude; 1 is agreement.
    rival : float
        Gain of the next best effect that is distinguishable from it, relative to its own.
    share : float
        Share of the whole reducible gap that it removes.
    left : float
        Whitened energy that it and the effects named before it leave; 1 is the floor.
    explained : float
        Share of the whole reducible gap that no law without a name is needed for: named effects
        remove it, or smooth laws of the state leave it as well.
    unlike : float
        Share of its gain that no smooth law of the state could have, known or not; 0 to 1.
    evenness : float
        How well the blocks of the records agree in its amplitude: 1 is as well as noise lets them.
    """

    gain: float
    t: float
    disagreement: float
    rival: float
    share: float
    left: float
    explained: float = 1.0
    unlike: float = 1.0
    evenness: float = 1.0

    def to_dict(self) -> dict[str, float]:
        """Return the JSON of the evidence."""
        return asdict(self)


def evidence(
    trial: Trial, rivals: Sequence[Trial], base: Sequence[Fit], held: Sequence[Fit] = ()
) -> Evidence:
    """Return what speaks for the effect of a trial.

    Parameters
    ----------
    trial : Trial
    rivals : sequence of Trial
        What else was tried in the same round, and is distinguishable from it.
    base : sequence of Fit
        The model without any effect.
    held : sequence of Fit
        The model with all that is named; without it, all that is left may yet get a name.
    """
    whole = max(float(np.mean([b.cost for b in base])) - 1.0, 1e-9)
    return Evidence(
        gain=float(np.min(trial.gains)),
        t=float(np.min(trial.t)),
        disagreement=trial.disagreement,
        rival=max([0.0, *(r.gain / trial.gain for r in rivals)]),
        share=trial.removed / whole,
        left=float(np.mean([h.cost for h in trial.held])),
        explained=1.0 - max(cost(held) - max(lawless(base), UNNAMED), 0.0) / whole if held else 1.0,
        unlike=trial.unlike,
        evenness=trial.evenness(held) if held else 1.0,
    )


def features(proof: Evidence) -> dict[str, float]:
    """Return the evidence on the scales on which it adds up."""
    removed = proof.gain * proof.left / max(1.0 - proof.gain, LEAST_EVIDENCE)
    gap = max(removed + max(proof.left - 1.0, 0.0), 1e-9)  # what was left to explain before it
    full, none = ENOUGH
    nameless = float(np.clip((full - proof.explained) / (full - none), 0.0, 1.0))
    doubt = nameless * (1.0 - proof.unlike)  # a smooth law without a name may be behind it
    return {
        "gain": float(np.log(max(proof.gain, LEAST_EVIDENCE))),
        "t": float(np.log(max(proof.t, 1.0))),
        "disagreement": float(np.log(min(max(proof.disagreement, 1.0), MOST_DISAGREEMENT))),
        "rival": float(np.clip(proof.rival, 0.0, 1.0)),
        "share": proof.unlike * float(np.log(np.clip(removed / gap, LEAST_EVIDENCE, 1.0))),
        "evenness": doubt * float(np.log(np.clip(proof.evenness, LEAST_EVENNESS, 1.0))),
    }


def probability(proof: Evidence) -> float:
    """Return the probability that a name, or one indistinguishable from it, is right.

    The weights come from withheld effects of other seeds than those of the published proof
    (benchmarks/withheld/weights.py); what was hidden there is in the library, so a probability
    holds as far as the cause is one of the known effects.

    Parameters
    ----------
    proof : Evidence

    Examples
    --------
    >>> strong = Evidence(gain=0.5, t=80.0, disagreement=1.02, rival=0.2, share=0.95, left=1.0)
    >>> weak = Evidence(gain=0.03, t=7.0, disagreement=1.5, rival=0.9, share=0.05, left=2.0)
    >>> probability(strong) > 0.95 > 0.5 > probability(weak)
    True
    """
    z = WEIGHTS["constant"] + sum(WEIGHTS[n] * x for n, x in features(proof).items())
    return min(float(1.0 / (1.0 + np.exp(-z))), SUREST)


# --- rounds ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Round:
    """One round of the forward selection.

    Parameters
    ----------
    gains : mapping
        R2 gain of each effect in the screening, mean of the folds, largest first.
    trials : tuple of Trial
        Everything that was fitted.
    scores : tuple of ndarray, (n_effects, n_blocks)
        Per fold, what each block says against each effect that was screened.
    qualified : tuple of Trial
        What reaches its threshold; the largest gain gets the name.
    measured : str
        The effect that a further sensor in the law speaks for: it gets the name where its gain is
        within this `margin` of the largest.
    """

    gains: dict[str, float]
    trials: tuple[Trial, ...]
    scores: tuple[Array, ...] = ()
    qualified: tuple[Trial, ...] = ()
    measured: str = ""
    margin: float = 0.0

    @cached_property
    def best(self) -> Trial | None:
        """What is named in this round: of equals, which the library lists first."""
        best = max(self.qualified, key=lambda t: t.gain, default=None)
        if best is None:
            return None
        seen = next((t for t in self.qualified if t.name == self.measured), None)
        if seen is not None and seen.gain >= (1.0 - self.margin) * best.gain:
            return seen
        equal = {t.name: t for t in self.qualified if t.gain >= (1.0 - TIE) * best.gain}
        return next((equal[name] for name in EFFECTS if name in equal), best)

    def rivals(self, rules: Rules, left: float) -> tuple[Trial, ...]:
        """Return what is not distinguishable from the best: the same change, as large.

        One rival stays in doubt longer than several: the form of a law is never quite that of the
        axis, which moves a single pair of curves apart that are the same in kind; of several at
        once the better form is the likelier one, unless they change the error in all but the same
        way, as a spring and gravity do over a short stroke. Where a gap is left in the end,
        whatever makes it may decide between a pair: the margin is wider, and a t value decides
        nothing.

        Parameters
        ----------
        rules : Rules
        left : float
            Whitened energy that all named effects leave; 1 is the floor.
        """
        best, clean = self.best, left < CLEAN
        if best is None:
            return ()
        margin = rules.equivalence if clean else rules.equivalence_open
        least = (1.0 - margin) * best.gain
        near = [t for t in self.qualified if t is not best and t.gain >= least]
        rivals = [t for t in near if best.correlation(t) > rules.correlation]
        if clean:
            rivals = [t for t in rivals if best.advantage(t) < rules.distinguishable]
        if len(rivals) > 1:
            several = rules.distinguishable_several
            rivals = [
                t for t in rivals if best.correlation(t) > TWIN or best.advantage(t) < several
            ]
        return tuple(rivals)

    def similar(self, least: float) -> set[str]:
        """Return the effects with at least this share of the best one's gain."""
        if self.best is None:
            return set()
        sizes = {**self.gains}
        sizes |= {t.name: max(t.gain, self.gains[t.name]) for t in self.trials}
        return {n for n, size in sizes.items() if size >= least * sizes[self.best.name]}


def play(
    sides: tuple[Side, ...],
    base: tuple[Fit, ...],
    rounds: Sequence[Round],
    terms: list[Term],
    rules: Rules,
) -> Round:
    """Look for one more effect.

    Parameters
    ----------
    sides : tuple of Side
        Two folds.
    base : tuple of Fit
        The model without any effect, fitted on each.
    rounds : sequence of Round
        The rounds before, each with a best effect.
    terms : list of Term
        What is tried.
    rules : Rules
    """
    if rounds:  # most of what a name leaves is not much
        rules = replace(rules, thorough=rules.steady)
    last = rounds[-1].best if rounds else None
    fits, held = (last.fits, last.held) if last else (base, base)
    found = _screened(sides, fits, terms)
    removed = {t.name: t.removed for r in rounds for t in r.trials}
    seen = "flexibility" if all(s.scales.second_body for s in sides) else ""
    trials = tuple(_tried(sides, fits, held, found, rules, removed, seen))
    similar = set().union(*(r.similar(rules.similar) for r in rounds))
    least = rules.beside_similar * max(cost(base) - 1.0, 0.0)
    qualified = (
        t for t in trials if t.passes(rules) and (t.name not in similar or t.removed > least)
    )
    scores = tuple(np.array([s.scores for s in f.values()]) for f in found)
    return Round(_gains(found), trials, scores, tuple(qualified), seen, rules.equivalence_open)


def cost(fits: Sequence[Fit]) -> float:
    """Return the mean square of the whitened error, mean of the folds."""
    return float(np.mean([f.cost for f in fits]))


def lawless(fits: Sequence[Fit]) -> float:
    """Return what smooth laws of the state leave of that: what follows no law, known or not."""
    return float(np.mean([f.fold.smooth for f in fits]))


def _screened(
    sides: tuple[Side, ...], fits: tuple[Fit, ...], terms: list[Term]
) -> tuple[dict[str, Score], ...]:
    """Return the score of every effect on either side."""
    return tuple(threaded(lambda s, f: screen(s, f, terms), sides, fits))


def _gains(found: tuple[dict[str, Score], ...]) -> dict[str, float]:
    """Return the gain of each effect in the screening, mean of the sides, largest first."""
    names = [n for n in found[0] if n in found[1]]
    mean = {n: float(np.mean([f[n].gain for f in found])) for n in names}
    return dict(sorted(mean.items(), key=lambda item: -item[1]))


def _tried(
    sides: tuple[Side, ...],
    fits: tuple[Fit, ...],
    held: tuple[Fit, ...],
    found: tuple[dict[str, Score], ...],
    rules: Rules,
    removed: dict[str, float],
    seen: str = "",
) -> list[Trial]:
    """Fit the best of the screening.

    The screening, of first order, does not see a narrow valley. Effects with many are searched as
    well where everything else leaves a gap, and smooth laws of the state leave many
    stretches of the record unexplained, as masses that move on their own do; not again where what
    they `removed` in an earlier round says that they would not be most of what is left.
    """
    gains = _gains(found)
    valleys = {n for n in gains if found[0][n].term.search == "valleys"}
    least = WORTH_A_FIT * rules.steady.gain
    chosen = [n for n in list(gains)[: rules.refit] if gains[n] > least]
    chosen += [n for n in gains if n == seen and n not in chosen]
    tried: list[Trial] = []

    def fit(names: list[str]) -> float:
        """Try some effects; return the largest gain that reaches its threshold so far."""
        tasks = [[f[n] for f in found] for n in names]
        tried.extend(threaded(lambda scores: attempt(sides, fits, held, scores), tasks))
        passed = threaded(lambda t: t.passes(rules), tried)
        return max([0.0, *(t.gain for t, ok in zip(tried, passed, strict=True) if ok)])

    best = fit(chosen[:2])
    best = fit([n for n in chosen[2:] if gains[n] > RIVAL * best])
    rough, left = max(s.rough for s in sides) > ROUGH, (1.0 - best) * cost(held)
    if rough and left > ADEQUATE:
        hopeless = {n for n, r in removed.items() if r < rules.search_left * (left - 1.0)}
        fit(sorted(valleys - {*chosen} - hopeless))
    return tried


# --- selection -------------------------------------------------------------------------------


class Supposed(NamedTuple):
    """An effect that removes most of a gap by itself and yet has no name.

    Attributes
    ----------
    effect : str
    values : mapping
        Of every parameter of the model with it, on the first fold.
    gain : float
        Share of the whitened energy that it removes on held-out data.
    """

    effect: str
    values: dict[str, float]
    gain: float


@dataclass(frozen=True, eq=False)
class Attribution:
    """What was named.

    Parameters
    ----------
    base : tuple of Fit
        The model without effects, on each fold.
    fits : tuple of Fit
        The model with the named effects, on each fold.
    held : tuple of Fit
        On each fold, with the effects as the other fold has them.
    named : tuple of str
    rules : Rules
    rounds : tuple of Round
        The forward selection; the first names nothing if there is nothing to name.
    full : tuple of Fit
        As `held`, with the effects that were taken back because their names were doubtful.
    laws : Laws, optional
        Forces without a name along the motion of the fullest model, if something is left.
    supposed : Supposed, optional
        What most of the gap is without, where nothing is named.
    """

    base: tuple[Fit, ...]
    fits: tuple[Fit, ...]
    held: tuple[Fit, ...]
    named: tuple[str, ...]
    rules: Rules
    rounds: tuple[Round, ...] = ()
    full: tuple[Fit, ...] = ()
    laws: Laws | None = None
    supposed: Supposed | None = None

    @property
    def trials(self) -> tuple[Trial, ...]:
        """Everything that was fitted in the first round."""
        return self.rounds[0].trials if self.rounds else ()

    @property
    def screened(self) -> dict[str, float]:
        """R2 gain of every effect in the first screening, mean of the folds."""
        return self.rounds[0].gains if self.rounds else {}

    @property
    def parameters(self) -> dict[str, dict[str, float]]:
        """Per named effect, its parameters as the first fold has them."""
        values = self.fits[0].values
        return {
            e: {n.partition(".")[2]: v for n, v in values.items() if n.startswith(f"{e}.")}
            for e in self.named
        }

    @property
    def replication(self) -> dict[str, tuple[float, float]]:
        """Per parameter of a named effect, its value on either fold."""
        one, two = (f.values for f in self.fits)
        return {n: (v, two[n]) for n, v in one.items() if "." in n and n in two}

    @cached_property
    def _winners(self) -> dict[str, tuple[Round, Trial]]:
        """Round and trial of every effect that is named."""
        pairs = ((r, r.best) for r in self.rounds if r.best is not None)
        return {best.name: (r, best) for r, best in pairs if best.name in self.named}

    @cached_property
    def ambiguous(self) -> dict[str, list[str]]:
        """Per named effect, those that are not distinguishable from it."""
        return {
            name: [t.name for t in self._rivals(r) if t.name not in self.named]
            for name, (r, _) in self._winners.items()
        }

    @property
    def alternatives(self) -> tuple[dict[str, float], ...]:
        """Parameters on the first fold with each effect that helps and has no name."""
        helps = (
            t.fits[0]
            for r in self.rounds
            for t in r.trials
            if t.name not in self.named and np.min(t.t) > DISCREPANCY_T and t.gain > 0.0
        )
        own = {t.name for t in self.fits[0].loop.terms}
        return tuple(f.values for f in helps if own <= {t.name for t in f.loop.terms})

    def _rivals(self, r: Round) -> tuple[Trial, ...]:
        return r.rivals(self.rules, cost(self.held))

    @cached_property
    def evidence(self) -> dict[str, Evidence]:
        """Per named effect, what speaks for it."""
        return {
            n: evidence(
                b,
                [t for t in r.trials if t not in (b, *self._rivals(r))],
                self.base,
                self.full or self.held,
            )
            for n, (r, b) in self._winners.items()
        }

    @cached_property
    def pvalues(self) -> dict[str, float]:
        """Of no gain on held-out data, corrected for everything screened in the first round."""
        return _pvalues(self.rounds[0]) if self.rounds else {}


def attribute(
    sides: tuple[Side, ...],
    base: tuple[Fit, ...],
    rules: Rules,
    extra: tuple[Term, ...] = (),
    without: tuple[str, ...] = (),
) -> Attribution:
    """Name the effects by forward selection and backward elimination.

    Parameters
    ----------
    sides : tuple of Side
        Two folds.
    base : tuple of Fit
        The model as it is, fitted on each.
    rules : Rules
    extra : tuple of Term
        Effects of the user's own.
    without : tuple of str
        Effects left out of the library.
    """
    rounds: list[Round] = []
    best: list[Trial] = []
    while len(best) < rules.most:
        loop = best[-1].fits[0].loop if best else base[0].loop
        rounds.append(play(sides, base, rounds, library(loop, extra, without), rules))
        winner = rounds[-1].best
        if winner is None or _doubtful(winner, rounds[-1], base, rules):
            break
        best.append(winner)
        if cost(winner.held) < CLEAN:  # at the floor: nothing is left to have a name
            break
    models = [base, *(t.held for t in best)]
    left = bool(best) and cost(models[-1]) >= min(CLEAN, MORE * lawless(base))  # to be described
    laws = next(filter(None, map(Laws.of, models[::-1])), None) if left else None
    seen = bool(best) and best[0].name == rounds[0].measured
    best = best[: len(best) if laws is None else _told(models, laws, rules, least=int(seen))]
    fits, held = (best[-1].fits, best[-1].held) if best else (base, base)
    kept, fits, held = _backward(sides, base, fits, held, [t.name for t in best])
    found = Attribution(base, fits, held, tuple(kept), rules, tuple(rounds), laws=laws)
    found = _withdrawn(sides, found)
    first = rounds[0].best if rounds else None
    if found.named or first is None or np.min(first.gains) < rules.dominant.gain:
        return found
    return replace(found, supposed=Supposed(first.name, first.fits[0].values, first.gain))


def _told(models: Sequence[tuple[Fit, ...]], laws: Laws, rules: Rules, least: int) -> int:
    """Return how many names, in their order, tell more than a force without a name does.

    Every smooth law is close to some effect. So a force without a name describes what is left,
    after each number of names and without any, and held-out data judge: of those that predict as
    well as the best, within a standard error, the one with most names is taken that the force
    without a name does not outdo by itself. The first stays if a further sensor in the law has
    measured it, for that is no guess: `least` is 1 then.

    L. Breiman, J. H. Friedman, R. A. Olshen, C. J. Stone, "Classification and Regression Trees",
    1984, section 3.4.3: the one-standard-error rule.
    """
    left = threaded(lambda fits: fitted(fits, laws), models)

    def holds(k: int) -> bool:
        """Whether so many names do."""
        if any(advantage(models[0], other, left[k]) < -STANDARD_ERRORS for other in left[least:k]):
            return False
        return least > 0 or not _outdone(models[0], models[k], left[0], left[k], rules)

    return next((k for k in range(len(models) - 1, least, -1) if holds(k)), least)


def _outdone(
    base: tuple[Fit, ...], held: tuple[Fit, ...], plain: Spline, both: Spline, rules: Rules
) -> bool:
    """Whether a force without a name explains what names do, and significantly more.

    By more than effects may differ that are equivalent, and unless the names have something that
    it has not: then both are there.

    Parameters
    ----------
    base, held : tuple of Fit
        The model without effects, and with those that are named.
    plain, both : Spline
        Of what either leaves.
    """
    nameless = float(np.mean([np.mean(e**2) for e in plain.left]))
    saved = cost(held) - nameless
    alone = Spline((), (), 0.0, tuple(beside(h, h.e[:, None])[:, 0] for h in held))
    return (
        saved > rules.equivalence * (cost(base) - nameless)
        and advantage(base, alone, plain) > least_t(saved / cost(held))
        and advantage(base, plain, both) < DISCREPANCY_T
    )


def upheld(sides: tuple[Side, ...], base: tuple[Fit, ...], found: Attribution) -> Attribution:
    """Return what was named on part of the records, if it also tells something on all of them.

    A force without a name must not do better there: of what stands out an effect may show the
    part that is like it. What a further sensor in the law has measured is no guess.

    Parameters
    ----------
    sides : tuple of Side
        Two folds, with the stretches that stand out.
    base : tuple of Fit
        The model without effects, fitted on each.
    found : Attribution
        On the folds without those stretches.
    """
    if not found.named or found.rounds[0].measured in found.named:
        return found
    held = frozen(sides, found.fits)
    laws = Laws.of(held)
    if laws is None or _told([base, held], laws, found.rules, least=0):
        return found
    return replace(found, fits=found.base, held=found.base, named=(), full=found.held)


def _withdrawn(sides: tuple[Side, ...], result: Attribution) -> Attribution:
    """Take back the names that what is left in the end makes doubtful."""
    doubtful = [n for n, proof in result.evidence.items() if probability(proof) < LIKELY]
    fits = result.fits
    for name in doubtful:
        fits = tuple(_without(s, f, name) for s, f in zip(sides, fits, strict=True))
    if not doubtful:
        return result
    named = tuple(n for n in result.named if n not in doubtful)
    held = frozen(sides, fits) if named else result.base
    fits = fits if named else result.base
    return replace(result, fits=fits, held=held, named=named, full=result.held)


def _doubtful(best: Trial, last: Round, base: tuple[Fit, ...], rules: Rules) -> bool:
    """Whether names with such evidence were hardly more often right than wrong."""
    rivals = last.rivals(rules, cost(best.held))
    others = [t for t in last.trials if t not in (best, *rivals)]
    return probability(evidence(best, others, base)) < LIKELY


def _backward(
    sides: tuple[Side, ...],
    base: tuple[Fit, ...],
    fits: tuple[Fit, ...],
    held: tuple[Fit, ...],
    named: list[str],
) -> tuple[list[str], tuple[Fit, ...], tuple[Fit, ...]]:
    """Drop effects that a later one made superfluous."""
    for name in list(named[:-1]):
        fewer = tuple(_without(s, f, name) for s, f in zip(sides, fits, strict=True))
        judged = frozen(sides, fewer)
        loss = np.mean([j.cost - h.cost for j, h in zip(judged, held, strict=True)])
        gap = np.mean([b.cost - h.cost for b, h in zip(base, held, strict=True)])
        if loss < SUPERFLUOUS * gap:
            named, fits, held = [n for n in named if n != name], fewer, judged
    return named, fits, held


def _without(side: Side, fit: Fit, name: str) -> Fit:
    terms = tuple(t for t in fit.loop.terms if t.name != name)
    known = {n for t in terms for n in t.names}
    start = {k: v for k, v in fit.loop.start.items() if k in known}
    loop: ClosedLoop = replace(fit.loop, terms=terms, start=start)
    values = {n: v for n, v in fit.values.items() if n in known}
    free = [n for n in fit.free if n in known]
    return gauss_newton(side.fold, loop, values, free, steps(side.fold, loop, side.scales))


def _pvalues(first: Round, draws: int = DRAWS) -> dict[str, float]:
    """Return p values by the bootstrap of the largest t over all that was screened."""
    if not first.trials:
        return {}
    rng = np.random.default_rng(np.random.SeedSequence(list(b"max-t")))
    worst = np.zeros(draws)
    for side, screened in enumerate(first.scores):
        fitted = [_scores(t.before[side], t.held[side]) for t in first.trials]
        scores = np.vstack([*screened, *fitted])
        signs = rng.choice([-1.0, 1.0], size=(draws, scores.shape[1]))
        size = np.maximum(np.linalg.norm(scores, axis=1), 1e-300)
        worst = np.maximum(worst, np.max(np.abs(signs @ scores.T) / size, axis=1))
    return {t.name: float(np.mean(worst >= max(np.min(t.t), 0.0))) for t in first.trials}


def _scores(before: Fit, held: Fit) -> Array:
    change = before.e - held.e
    return held.fold.block_sums(change * held.e)
