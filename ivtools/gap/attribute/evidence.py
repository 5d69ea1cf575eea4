"""Evidence: what speaks for the name of an effect, and how sure that makes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from ..candidate import Trial
from ..discrepancy import Laws
from ..fit import Fit, common, cost
from ..rules import (
    LEAST_EVENNESS,
    LEAST_EVIDENCE,
    LIKELY,
    LITTLE,
    MOST,
    MOST_LEFT,
    NEARLY_ALL,
    RIVAL,
    SUREST,
    UNEVEN,
    UNEVEN_LEAVES,
    UNEVEN_LEFT,
    WEIGHTS,
)


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
        Share of the whole reducible gap that named effects remove, or that smooth laws of the state
        could not remove either.
    unlike : float
        Share of its gain that no smooth law of the state could have, known or not; 0 to 1.
    evenness : float
        How well the blocks of the records agree in its amplitude: 1 is as well as noise lets them.
    stands : bool
        Whether its amplitude is the same beside a force without a name, if that was asked: then
        what else is in the gap is not asked for.
    surpassed : bool
        Whether a force without a name predicts held-out data better by itself than beside it.
    apart : bool
        Whether it is the motion of a second mass, of which no smooth law could have most: then few
        blocks are enough.
    certain : bool
        Whether it is no guess: what a further sensor in the law has measured is no smooth law, nor
        is friction over position where the force without a name is just that.
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
    stands: bool = False
    surpassed: bool = False
    apart: bool = False
    certain: bool = False

    @property
    def outdone(self) -> bool:
        """Whether an effect that cannot be named removes more, and much of the gap is left."""
        return self.rival > 1.0 and self.explained < NEARLY_ALL

    @property
    def uneven(self) -> bool:
        """Whether blocks of it differ so much in size that it only resembles what is there.

        What smooth laws could not have all of is no such likeness, nor is what hardly leaves
        anything, closes nearly all of the gap by itself, or stands beside a smooth law and removes
        most of it.
        """
        closed = 1.0 - np.sqrt(1.0 - min(self.share, 1.0))
        told = self.certain or closed > NEARLY_ALL or (self.stands and self.share > MOST)
        shared = not told and self.unlike < LITTLE
        return shared and self.evenness < UNEVEN and self.left > UNEVEN_LEAVES

    @property
    def unrivalled(self) -> bool:
        """Whether neither smooth laws nor other effects have anything of what it removes."""
        return self.apart and self.rival < RIVAL and not self.surpassed

    def to_dict(self) -> dict[str, float | bool]:
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
        What else was tried in the same round, and is distinguishable from it. Further waves of a
        line that is named are none.
    base : sequence of Fit
        The model without any effect.
    held : sequence of Fit
        The model with all that is named; without it, all that is left may yet get a name.
    """
    whole = max(cost(base) - 1.0, 1e-9)
    rest = cost(held) - left_by_smooth_laws(base) if held else 0.0
    return Evidence(
        gain=float(np.min(trial.gains)),
        t=float(np.min(trial.t)),
        disagreement=trial.disagreement,
        rival=max([0.0, *(r.gain / trial.gain for r in rivals if not r.further)]),
        share=trial.removed / whole,
        left=cost(trial.held),
        explained=1.0 - max(rest, 0.0) / whole,
        unlike=trial.unlike,
        evenness=trial.evenness(held) if held else 1.0,
        apart=trial.apart,
    )


def features(proof: Evidence) -> dict[str, float]:
    """Return the evidence on the scales on which it adds up."""
    alone, unlike = not proof.stands, 1.0 if proof.certain else proof.unlike
    doubt = alone * (1.0 - unlike)  # a smooth law without a name may be behind it
    even = proof.evenness * float(np.clip(proof.left, 1.0, MOST_LEFT)) ** UNEVEN_LEFT
    removed = max(proof.gain, LEAST_EVIDENCE) / max(1.0 - proof.gain, LEAST_EVIDENCE)
    return {
        "t": float(np.log(max(proof.t, 1.0))),
        "disagreement": float(np.log(max(proof.disagreement, 1.0))),
        "rival": alone * float(np.clip(proof.rival, 0.0, 1.0)),
        "gain": alone * unlike * float(np.log(removed)),
        "surpassed": float(proof.surpassed),
        "evenness": doubt * float(np.log(np.clip(even, LEAST_EVENNESS, 1.0))),
    }


def probability(proof: Evidence) -> float:
    """Return the probability that a name, or one indistinguishable from it, is right.

    The weights come from withheld effects of other seeds than those of the published proof
    (benchmarks/withheld/weights.py); what was hidden there is in the library, so a probability
    holds as far as the cause is one of the known effects. An effect that another one outdoes, or
    that is uneven, only resembles what is there; one without a rival is right with `NEARLY_ALL` at
    least, and none is surer than `SUREST`.

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
    if proof.outdone or proof.uneven:
        return 0.0
    z = WEIGHTS["constant"] + sum(WEIGHTS[n] * x for n, x in features(proof).items())
    least = NEARLY_ALL if proof.unrivalled else 0.0
    return min(max(float(1.0 / (1.0 + np.exp(-z))), least), SUREST)


def weigh(
    trial: Trial, others: Sequence[Trial], base: tuple[Fit, ...], held: tuple[Fit, ...] = ()
) -> Evidence:
    """Return the evidence for an effect; where it leaves doubt, also whether the effect stands.

    What does not stand beside a force without a name is no rival of what does.
    """
    found = evidence(trial, others, base, held)
    if probability(found) >= LIKELY:
        return found
    laws = Laws.of(common(base))
    if not trial.stands(laws):
        return found
    rivals = [t for t in others if t.gain > trial.gain and t.stands(laws)]
    return replace(evidence(trial, rivals, base, held), stands=True)


def left_by_smooth_laws(fits: Sequence[Fit]) -> float:
    """Return what smooth laws of the state leave of that: what follows no law, known or not."""
    return float(np.mean([f.fold.smooth for f in fits]))
