"""Wald test of linear restrictions on the parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ivtools.errors import EstimationError, ShapeError
from ivtools.estimates import WITHHELD
from ivtools.hypothesis import TestResult
from ivtools.inference.system import chi2_result, f_result, quadratic_form
from ivtools.linalg import CovType
from ivtools.results import FitResults


def wald_test(
    results: FitResults,
    restrictions: Mapping[str, float] | str | tuple[Any, Any] | Any,
    values: Any = None,
    cov_type: CovType | None = None,
    use_f: bool = False,
) -> TestResult:
    """Test R theta = r.

    Parameters
    ----------
    results : FitResults
        Any result.
    restrictions : Mapping, str, (q, p) array_like or tuple
        Values by parameter name; equations such as ``"viscous_pos = viscous_neg, offset = 0"``; the
        matrix R; or R and r, as in statsmodels.
    values : (q,) array_like, optional
        r beside a matrix; 0 if left out.
    cov_type : {"hac", "robust", "classical"}, optional
        Another covariance than the result's own, which is HAC by default.
    use_f : bool
        Compare with F(q, d) instead of chi2(q), where d is the least number of degrees of freedom
        of a standard error, at most N - p.

    Returns
    -------
    TestResult
        Does not apply to a fit that has not converged: it has no covariance.

    Raises
    ------
    EstimationError
        If a name is unknown or the restrictions depend on each other.
    ShapeError
        If R or r does not fit.

    References
    ----------
    A. Wald, Transactions of the American Mathematical Society 54, 1943.

    Examples
    --------
    >>> import numpy as np
    >>> X, y = np.ones((400, 1)), np.tile([0.9, 1.1], 200)
    >>> fit = FitResults.from_solution("idim-ls", [1.0], X, y, names=["offset"])
    >>> fit.wald_test({"offset": 1.0}).pvalue
    1.0
    """
    R, r = _matrix(results, restrictions, values)
    if np.linalg.matrix_rank(R) < len(R):
        raise EstimationError("the restrictions depend on each other; drop those implied by others")
    fit = results if cov_type is None else results.with_cov(cov_type)
    name, null = f"Wald ({fit.cov_type})", _written(results.names, R, r)
    if not fit.converged:
        return TestResult(name, null, reason=f"the fit {WITHHELD}")
    difference = R @ fit.params.to_numpy() - r
    statistic = quadratic_form(difference, R @ fit.cov.to_numpy() @ R.T)
    if not use_f:
        return chi2_result(name, null, statistic, len(R))
    freedom = min(float(fit.degrees_of_freedom.min()), fit.nobs - len(fit.params))
    return f_result(name, null, statistic / len(R), (len(R), freedom))


def _matrix(results: FitResults, restrictions: Any, values: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return R (q, p) and r (q,)."""
    names = list(results.names)
    if isinstance(restrictions, Mapping):
        if unknown := [name for name in restrictions if name not in names]:
            raise EstimationError(f"{unknown[0]!r} is no parameter; use {', '.join(names)}")
        R = np.array([np.eye(len(names))[names.index(name)] for name in restrictions])
        values = list(restrictions.values())
    elif isinstance(restrictions, str):
        R, values = _parsed(restrictions, names)
    elif isinstance(restrictions, tuple) and values is None:
        return _matrix(results, *restrictions)
    else:
        R = np.atleast_2d(np.asarray(restrictions, dtype=float))
    r = np.zeros(len(R)) if values is None else np.atleast_1d(np.asarray(values, dtype=float))
    if R.shape[1:] != (len(names),) or r.shape != (len(R),):
        raise ShapeError(f"R is {R.shape} and r {r.shape}; with {len(names)} parameters they must "
                         f"be (q, {len(names)}) and (q,)")  # fmt: skip
    return R, r


def _parsed(text: str, names: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return R (q, p) and r (q,) of equations, read as statsmodels reads them."""
    from patsy import DesignInfo, PatsyError

    try:
        found = DesignInfo(names).linear_constraint(text)
    except PatsyError as error:
        reason = str(error).splitlines()[0]
        raise EstimationError(
            f"{text!r} is not understood ({reason}); write 'name = value', with {', '.join(names)}"
        ) from error
    return found.coefs, found.constants[:, 0]


def _written(names: tuple[str, ...], R: np.ndarray, r: np.ndarray) -> str:
    """Write the restrictions in words."""
    lines = []
    for row, value in zip(R, r, strict=True):
        terms = [f"{c:g} {n}".removeprefix("1 ") for c, n in zip(row, names, strict=True) if c]
        lines.append(f"{' + '.join(terms)} = {value:g}".replace("+ -1 ", "- ").replace("+ -", "- "))
    return ", ".join(lines)
