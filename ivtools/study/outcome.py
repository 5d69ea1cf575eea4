"""One fit of one record, by any estimator, as rows of the table."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from math import nan
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ivtools.digest import canonical, digest
from ivtools.errors import EstimationError, IVToolsError
from ivtools.estimates import Estimates
from ivtools.estimators.base import Estimator

if TYPE_CHECKING:
    from ivtools.problem import Problem
    from ivtools.study.table import Row

Array = NDArray[np.float64]

MESSAGE_LENGTH = 200
NORMAL = 1.959963984540054  # half of a 95 % interval of the normal distribution


class AnyEstimator(Protocol):
    """What a study asks of an estimator: one method.

    It returns an object with ``params`` (a mapping or Series by parameter name), or such a mapping
    itself. ``std_errors`` (or ``bse``), ``converged``, ``n_iter`` and ``n_simulations`` are used
    where the object has them; intervals are those of ivtools' own results, else by the normal
    distribution.
    """

    def fit(self, problem: Problem) -> Any:
        """Estimate the parameters of a problem."""
        ...


class Outcome(NamedTuple):
    """What a fit gave, in plain numbers."""

    theta: Mapping[str, float]
    std_errors: Mapping[str, float]
    half_widths: Mapping[str, float]
    converged: bool
    n_iter: int
    n_simulations: int
    runtime: float
    error: str


def fit(estimator: AnyEstimator, problem: Problem) -> Outcome:
    """Run an estimator; a failure is an outcome with its reason."""
    start = perf_counter()
    try:
        judged = {"check": False} if isinstance(estimator, Estimator) else {}  # by the truth here
        result = estimator.fit(problem, **judged)
        runtime = perf_counter() - start
        theta = _numbers(getattr(result, "params", result))
        if not np.isfinite(list(theta.values())).all():
            raise EstimationError("the estimate is not finite")
    except Exception as error:  # whatever an estimator raises, the others go on
        return failure(error, perf_counter() - start)
    found = getattr(result, "std_errors", getattr(result, "bse", None))
    std_errors = {} if found is None else _numbers(found)
    return Outcome(
        theta,
        std_errors,
        _half_widths(result, std_errors),
        bool(getattr(result, "converged", True)),
        int(getattr(result, "n_iter", 1)),
        int(getattr(result, "n_simulations", 0)),
        runtime,
        "",
    )


def _half_widths(result: Any, std_errors: Mapping[str, float]) -> dict[str, float]:
    """Return half of each 95 % interval: the result's own, or the normal distribution's."""
    if not isinstance(result, Estimates):
        return {name: NORMAL * value for name, value in std_errors.items()}
    ends = result.conf_int()
    return _numbers(0.5 * (ends["upper"] - ends["lower"]))


def failure(error: Exception, runtime: float = nan) -> Outcome:
    """Return the outcome of a fit that failed."""
    reason = f"{type(error).__name__}: {error}".splitlines()[0][:MESSAGE_LENGTH]
    return Outcome({}, {}, {}, False, 0, 0, runtime, reason)


def rows(
    outcome: Outcome,
    key: tuple[str, str, int],
    theta_true: Mapping[str, float],
    problem: Problem | None,
    holdout: Problem | None,
) -> list[Row]:
    """Return the rows of an outcome: its own parameters, or after a failure the model's.

    Parameters
    ----------
    outcome : Outcome
    key : (case, estimator, seed)
    theta_true : mapping
        True values; their names are the model's parameters.
    problem, holdout : Problem or None
        Where the relative errors are measured.
    """
    errors = [_relative_error(outcome.theta, p) for p in (problem, holdout)]
    status = (outcome.converged, outcome.n_iter, outcome.n_simulations, outcome.runtime)
    return [
        (
            *key,
            name,
            outcome.theta.get(name, nan),
            theta_true.get(name, nan),
            outcome.std_errors.get(name, nan),
            outcome.half_widths.get(name, nan),
            *errors,
            *status,
            outcome.error,
        )
        for name in (outcome.theta or theta_true)
    ]


def label(estimator: Any) -> str:
    """Return the name of an estimator in the table: its own, and the settings that differ.

    Examples
    --------
    >>> from ivtools.estimators import IDIMLS
    >>> label(IDIMLS()), label(IDIMLS(cov_type="robust"))
    ('idim-ls', 'idim-ls(cov_type=robust)')
    """
    given = getattr(estimator, "label", None) or getattr(estimator, "key", None)
    name = str(given or type(estimator).__name__)
    if not dataclasses.is_dataclass(estimator):
        return name
    changed = [
        f"{f.name}={getattr(estimator, f.name)}"
        for f in dataclasses.fields(estimator)
        if f.name != "label" and not _is_default(f, getattr(estimator, f.name))
    ]
    return f"{name}({', '.join(changed)})" if changed else name


def identity(estimator: Any) -> str:
    """Return a digest of an estimator's class and settings."""
    kind = type(estimator)
    return digest(kind.__module__.split("<")[0], kind.__qualname__, canonical(estimator))[:32]


def labelled(estimators: Mapping[str, Any] | Iterable[Any]) -> dict[str, Any]:
    """Return estimators by label; refuse two of one name, and what cannot fit."""
    if isinstance(estimators, Mapping):
        pairs = [(str(k), e) for k, e in estimators.items()]
    else:
        pairs = [(label(e), e) for e in estimators]
    names = [name for name, _ in pairs]
    for name, estimator in pairs:
        if names.count(name) > 1:
            raise IVToolsError(
                f"two estimators are called {name!r}; name them: {{'first': ..., 'second': ...}}"
            )
        if isinstance(estimator, type) or not callable(getattr(estimator, "fit", None)):
            raise IVToolsError(f"estimator {name!r} is no object with a method fit(problem)")
    if not pairs:
        raise IVToolsError("a study needs at least one estimator")
    return dict(pairs)


def _is_default(field: dataclasses.Field[Any], value: Any) -> bool:
    if field.default_factory is not dataclasses.MISSING:
        return bool(value == field.default_factory())
    return bool(value == field.default)


def _numbers(values: Any) -> dict[str, float]:
    if not hasattr(values, "items"):
        raise EstimationError(
            f"fit() returned {type(values).__name__}; it must return params by parameter name"
        )
    return {str(k): float(v) for k, v in values.items()}


def _relative_error(theta: Mapping[str, float], problem: Problem | None) -> float:
    """Return 100 norm(y - X theta) / norm(y), %; NaN where theta is not the model's."""
    if problem is None or not set(problem.names) <= set(theta):
        return nan
    values = np.array([theta[name] for name in problem.names])
    y = problem.y  # (N,)
    return float(100.0 * np.linalg.norm(y - problem.X @ values) / np.linalg.norm(y))
