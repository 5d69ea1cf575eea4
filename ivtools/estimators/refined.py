"""Refined instrumental variables: minimum variance by a model of the noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import EstimationError
from ivtools.estimators.compensated import EXACT, IDIMBCIV
from ivtools.estimators.step import STEADY, Step, System
from ivtools.linalg import NoiseModel, Weights, covariance, segment_starts, solve_iv
from ivtools.linalg.noise import MAX_ORDER, Criterion

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]

LAGS = 20  # of the Ljung-Box test
DOUBT = 4.0  # standard errors


@dataclass(frozen=True)
class IDIMPIV(IDIMBCIV):
    """Refined instrumental variables: X, y and Z prefiltered by the inverse noise model.

    The residual of the instrumental-variable fit is modelled as autoregressive (moving-average)
    noise, whose inverse filters X, y and Z until nothing changes. With the right noise
    model no estimator with the same instruments has a smaller variance. The equations are those
    of `IDIMBCIV`.

    A residual is smaller than the noise, by what the fit has taken from it; an autoregressive
    model is given that back (`ivtools.linalg.autocovariance.taken`), or intervals are too narrow.

    Parameters
    ----------
    cov_type, tol, max_iter, start, scale_gain, filtered
        As for `IDIMIV`.
    noise : {"ar", "arma"}
        Structure of the noise model.
    criterion : {"aic", "bic"}
        What chooses its order.
    max_order : int
        Largest autoregressive order.
    renew : bool
        Model the noise anew after each step. Once, at the consistent estimate, is efficient to
        first order; where the loop's model lacks an effect, renewal lets the noise model take
        ever more of it for noise.

    References
    ----------
    M. Brunot, A. Janot, P. C. Young, F. Carrillo, "An improved instrumental variable method for
    industrial robot model identification", Control Engineering Practice 74, 2018;
    P. C. Young, *Recursive Estimation and Time-Series Analysis*, 2nd ed., Springer 2011, ch. 7;
    E. L. Lehmann, G. Casella, *Theory of Point Estimation*, 2nd ed., 1998, section 6.4: one step.

    Examples
    --------
    >>> import ivtools as iv
    >>> loop = iv.axes.emps().with_terms("inertia", "asymmetric-friction")
    >>> fit = IDIMPIV().fit(iv.Problem(iv.datasets.twin(), loop))
    >>> sorted(fit.extras)
    ['noise', 'whiteness']
    """

    key: ClassVar[str] = "idim-piv"

    noise: Literal["ar", "arma"] = "ar"
    criterion: Criterion = "aic"
    max_order: int = MAX_ORDER
    renew: bool = False

    def __post_init__(self) -> None:
        """Refuse settings that make no sense."""
        super().__post_init__()
        if self.weighted or self.robust:
            raise EstimationError("idim-piv weighs by its noise model; leave weighted and robust")

    def row_weights(self, system: System, resids: Array, last: Step) -> Weights | None:
        """Return the inverse noise model of this residual (N,)."""
        steady = last.change <= STEADY
        if steady == (last.weights is not None) or (last.weights is not None and not self.renew):
            return last.weights
        if np.linalg.norm(resids) <= EXACT * np.linalg.norm(system.y):
            return None
        return NoiseModel.fit(
            resids,
            segment_starts(system.t, system.joints),
            kind=self.noise,
            criterion=self.criterion,
            max_order=self.max_order,
            fitted=system.Z,
        )

    def _settled(self, last: Step | None, step: Step) -> bool:
        """Whether the iteration has stopped to move; not before the noise was looked at.

        Late, where there may be no fixed point to the last digit, one step with the noise model
        from where the iteration without it came to rest is the estimate: efficient to first order.
        """
        if last is None or last.change > STEADY:
            return False
        first = step.weights is not None and last.weights is None
        return (step.late and first) or super()._settled(last, step)

    def notes(self, problem: Problem, step: Step) -> tuple[str, ...]:
        """Say what the noise is, and whether it is white behind the filter."""
        if not isinstance(step.weights, NoiseModel):
            return (*super().notes(problem, step), "there is no noise to model")
        before, after = (whiteness(e) for e in (step.resids, step.weights(step.resids)))
        return (
            *super().notes(problem, step),
            f"noise {step.weights.label}, {step.weights.sigma:.4g} behind its filter",
            f"Ljung-Box Q({LAGS}) {before[0]:.4g} before the filter, {after[0]:.4g} "
            f"(p {after[1]:.3g}) behind it",
            *_doubts(step),
        )

    def extras(self, problem: Problem, step: Step) -> dict[str, Any]:
        """Return the noise model, and the Ljung-Box test before and behind its filter."""
        if not isinstance(step.weights, NoiseModel):
            return {}
        tests = {"before": whiteness(step.resids), "after": whiteness(step.weights(step.resids))}
        return {"noise": step.weights, "whiteness": tests}


def _doubts(step: Step) -> tuple[str, ...]:
    """Say so if the filter moved the estimate by more than noise can explain."""
    X, y, Z = step.system.X, step.system.y, step.system.Z
    plain = solve_iv(X, y, Z)  # (p,), consistent as well, and less efficient
    std = np.sqrt(np.diag(covariance(X, y - X @ plain, Z)))
    moved = float(np.max(np.abs(step.theta - plain) / std))
    if moved <= DOUBT:
        return ()
    return (
        f"the filter moved the estimate by {moved:.1f} standard errors: the residual is not noise "
        "alone, the model lacks an effect",
    )


def whiteness(e: Array, lags: int = LAGS) -> tuple[float, float]:
    """Return the Ljung-Box statistic of e (N,) and its p-value.

    Examples
    --------
    >>> statistic, pvalue = whiteness(np.random.default_rng(0).standard_normal(500))
    >>> pvalue > 0.01
    True
    """
    from statsmodels.tsa.stattools import acf, q_stat

    statistics, pvalues = q_stat(acf(e, nlags=lags, fft=True)[1:], len(e))
    return float(statistics[-1]), float(pvalues[-1])
