"""FitResults: what an estimate is, how sure it is, and how it shows itself.

The vocabulary is that of statsmodels and linearmodels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import erfc, ndtri

from ivtools import linalg
from ivtools.display import Displayed
from ivtools.tables import Text, table, two_columns

if TYPE_CHECKING:
    from ivtools.problem import Problem

Array = NDArray[np.float64]

COVARIANCES = {
    "hac": "HAC (Newey-West)",
    "robust": "robust (White)",
    "classical": "classical",
}


@dataclass(frozen=True)
class TestResult:
    """Outcome of a statistical test, or the reason why it does not apply.

    Attributes
    ----------
    name, null : str
        The test and its null hypothesis.
    statistic, pvalue : float or None
        None if the test does not apply.
    df : tuple of float
        Degrees of freedom.
    distribution : str
        Of the statistic under the null hypothesis.
    reason : str
        Why the test does not apply, or a remark on how it was done.

    Examples
    --------
    >>> TestResult("Sargan", "the surplus instruments are valid", reason="no surplus instrument")
    Sargan: does not apply (no surplus instrument)
    """

    __test__ = False  # not a test for pytest

    name: str
    null: str
    statistic: float | None = None
    pvalue: float | None = None
    df: tuple[float, ...] = ()
    distribution: str = ""
    reason: str = ""

    @property
    def applies(self) -> bool:
        """Whether there is a statistic."""
        return self.statistic is not None

    def to_dict(self) -> dict[str, Any]:
        """Return the content as plain objects, ready for JSON."""
        return {
            "name": self.name,
            "statistic": self.statistic,
            "pvalue": self.pvalue,
            "df": list(self.df),
            "distribution": self.distribution,
            "null": self.null,
            "reason": self.reason,
        }

    def __repr__(self) -> str:
        if self.statistic is None:
            return f"{self.name}: does not apply ({self.reason})"
        dist = f"{self.distribution}({', '.join(f'{d:g}' for d in self.df)})"
        dist = dist.removesuffix("()")
        end = "" if self.pvalue is None else f", p = {self.pvalue:.4g}"
        return f"{self.name}: {dist} = {self.statistic:.5g}{end}; null: {self.null}"


class ErrorFigures(NamedTuple):
    """Size of the error y - X theta.

    Attributes
    ----------
    norm : float
        Euclidean norm, in N or N m.
    relative : float
        100 norm / norm(y), in %.
    std : float
        Standard deviation (ddof 1), in N or N m.
    """

    norm: float
    relative: float
    std: float

    @classmethod
    def of(cls, error: Array, y: Array) -> ErrorFigures:
        """Measure an error (N,) against the measurement y (N,)."""
        norm, size = float(np.linalg.norm(error)), float(np.linalg.norm(y))
        relative = 100.0 * norm / size if size else (math.inf if norm else 0.0)
        return cls(norm, relative, float(np.std(error, ddof=1)))


def _test(name: str, summary: str) -> Callable[..., TestResult]:
    """Return a method that hands the result to the test of this name in `inference`."""

    def method(self: FitResults, *args: Any, **options: Any) -> TestResult:
        from ivtools import inference

        return getattr(inference, name)(self, *args, **options)

    method.__name__ = name
    method.__doc__ = f"{summary} See `ivtools.inference.{name}`."
    return method


@dataclass(frozen=True, eq=False, repr=False)
class FitResults(Displayed):
    """Result of one fit; nothing in it changes.

    Attributes
    ----------
    method : str
        Key of the method on the command line, such as "idim-ls".
    params : Series (p,)
        Estimates by parameter name, SI.
    cov : DataFrame (p, p)
        Covariance of the estimates.
    cov_type : str
        "hac", "robust" or "classical".
    X, y : (N, p), (N,) ndarray
        Observation matrix and measured force the estimate solves.
    resids : (N,) ndarray
        y - X theta, in N or N m.
    Z : (N, m) ndarray or None
        Instruments; None if the method uses none.
    weights : (N,) ndarray, callable or None
        Inverse variances of the rows, or a function that whitens columns; None if all are equal.
    units : tuple of str (p,)
        Units of the parameters.
    t : (N,) ndarray or None
        Time of the rows, in s.
    problem : Problem or None
        What was fitted.
    n_iter, n_simulations : int
        Iterations and simulations of the closed loop that it took.
    converged : bool
        Whether the iteration met its tolerance.
    runtime : float
        Duration of the fit, in s.
    notes : tuple of str
        Remarks, one line each.
    extras : Mapping
        What else the method has to say (a noise model, a frontier ...).

    Examples
    --------
    >>> import numpy as np
    >>> X = np.column_stack([np.sin(np.arange(50.0)), np.ones(50)])
    >>> y = X @ [2.0, -1.0] + 0.1 * np.cos(3.0 * np.arange(50.0))
    >>> fit = FitResults.from_solution("idim-ls", [2.0, -1.0], X, y, names=["inertia", "offset"])
    >>> fit.nobs, round(fit.relative_error, 2)
    (50, 4.25)
    """

    figure: ClassVar[str] = "force"

    method: str
    params: pd.Series
    cov: pd.DataFrame
    cov_type: str
    X: Array
    y: Array
    resids: Array
    Z: Array | None = None
    weights: linalg.Weights | None = None
    units: tuple[str, ...] = ()
    t: Array | None = None
    problem: Problem | None = None
    n_iter: int = 1
    n_simulations: int = 0
    converged: bool = True
    runtime: float = math.nan
    notes: tuple[str, ...] = ()
    extras: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def from_solution(
        cls,
        method: str,
        theta: Sequence[float] | Array,
        X: Array,
        y: Array,
        *,
        problem: Problem | None = None,
        names: Sequence[str] | None = None,
        units: Mapping[str, str] | Sequence[str] | None = None,
        Z: Array | None = None,
        weights: linalg.Weights | None = None,
        cov_type: linalg.CovType = "hac",
        **status: Any,
    ) -> FitResults:
        """Complete a solution theta (p,) by its residuals and covariance.

        Names and units are those of the problem unless they are given; `status` holds any other
        attribute. The arrays are not copied.
        """
        if problem is not None:
            names = problem.names if names is None else names
            units = problem.units if units is None else units
            t = getattr(problem, "t", None)
            status.setdefault("t", t if t is not None and len(t) == len(y) else None)
            status["notes"] = (*status.get("notes", ()), *getattr(problem, "notes", ()))
        index = pd.Index(list(names or range(X.shape[1])))
        if isinstance(units, Mapping):
            units = [units[name] for name in index]
        resids = y - X @ np.asarray(theta, dtype=float)  # (N,)
        cov = linalg.covariance(X, resids, Z, cov_type, weights=weights)
        return cls(
            method=method,
            params=pd.Series(theta, index=index, name="params", dtype=float),
            cov=pd.DataFrame(cov, index=index, columns=index),
            cov_type=cov_type,
            X=X,
            y=y,
            resids=resids,
            Z=Z,
            weights=weights,
            units=tuple(units or ()),
            problem=problem,
            **status,
        )

    def with_cov(
        self,
        cov_type: linalg.CovType,
        bandwidth: int | None = None,
        debiased: bool | None = None,
    ) -> FitResults:
        """Return the same fit with another covariance (see `linalg.covariance`)."""
        cov = linalg.covariance(
            self.X,
            self.resids,
            self.Z,
            cov_type,
            weights=self.weights,
            bandwidth=bandwidth,
            debiased=debiased,
        )
        names = self.params.index
        return replace(self, cov=pd.DataFrame(cov, index=names, columns=names), cov_type=cov_type)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter names, in the order of the columns of X."""
        return tuple(self.params.index)

    @property
    def nobs(self) -> int:
        """Number of rows of the regression."""
        return len(self.y)

    @property
    def fitted(self) -> Array:
        """What the estimate makes of y (N,): X theta, or the simulated signal."""
        return self.y - self.resids

    @property
    def std_errors(self) -> pd.Series:
        """Standard errors of the estimates."""
        variances = np.diag(self.cov.to_numpy())
        return pd.Series(np.sqrt(variances), index=self.params.index, name="std_errors")

    @property
    def relative_std(self) -> pd.Series:
        """Standard errors as a share of the estimates, in %; infinite for an estimate of 0."""
        with np.errstate(divide="ignore"):
            return (100.0 * self.std_errors / self.params.abs()).rename("relative_std")

    @property
    def tstats(self) -> pd.Series:
        """Estimates over their standard errors."""
        return (self.params / self.std_errors).rename("tstats")

    @property
    def pvalues(self) -> pd.Series:
        """Two-sided p-values of a parameter of 0, by the normal distribution."""
        tails = erfc(self.tstats.abs().to_numpy() / math.sqrt(2.0))
        return pd.Series(tails, index=self.params.index, name="pvalues")

    def conf_int(self, level: float = 0.95) -> pd.DataFrame:
        """Return the confidence intervals by the normal distribution: columns lower, upper."""
        reach = float(ndtri(0.5 + 0.5 * level)) * self.std_errors
        return pd.DataFrame({"lower": self.params - reach, "upper": self.params + reach})

    @property
    def errors(self) -> ErrorFigures:
        """Norm, relative size and standard deviation of the residual."""
        return ErrorFigures.of(self.resids, self.y)

    @property
    def relative_error(self) -> float:
        """100 norm(y - X theta) / norm(y), in %."""
        return self.errors.relative

    @property
    def signal(self) -> str:
        """What y is: the force, unless the method compares a simulated signal of another kind."""
        return str(self.extras.get("signal", "force"))

    @property
    def condition_number(self) -> float:
        """Condition number of the observation matrix, in its units."""
        return float(np.linalg.cond(self.X))

    @cached_property
    def abs_diag_r(self) -> pd.Series:
        """|diag R| of the QR of the observation matrix before decimation, if it is known."""
        X = self.X
        if self.problem is not None and self.problem.names == self.names:
            pipeline = replace(self.problem.pipeline, decimation=1)
            X = replace(self.problem, pipeline=pipeline).X
        return pd.Series(linalg.abs_diag_r(X), index=self.params.index, name="abs_diag_r")

    def cross_test(self, problem: Problem) -> ErrorFigures:
        """Measure the error of these parameters on another record's problem."""
        theta = self.params.reindex(problem.names).to_numpy()  # a shape parameter has no column
        return ErrorFigures.of(problem.y - problem.X @ theta, problem.y)

    def not_identifiable(self, limit: float = 10.0) -> tuple[str, ...]:
        """Return the parameters whose relative deviation exceeds a limit, in %."""
        return tuple(self.params.index[~(self.relative_std <= limit)])

    def frame(self, level: float = 0.95) -> pd.DataFrame:
        """Return parameters, units, standard errors and confidence intervals side by side."""
        columns = {
            "unit": pd.Series(self.units or ("",) * len(self.params), index=self.params.index),
            "params": self.params,
            "std_errors": self.std_errors,
            "relative_std": self.relative_std,
        }
        return pd.DataFrame(columns).join(self.conf_int(level))

    def to_dict(self, tests: bool = True) -> dict[str, Any]:
        """Return the content as plain objects, ready for JSON.

        Parameters
        ----------
        tests : bool
            False leaves the tests out; they take longer than the fit.
        """
        return {
            "method": self.method,
            "params": _plain(self.params),
            "std_errors": _plain(self.std_errors),
            "cov_type": self.cov_type,
            "relative_error": self.relative_error,
            "condition_number": self.condition_number,
            "nobs": self.nobs,
            "n_iter": int(self.n_iter),
            "converged": bool(self.converged),
            "tests": {k: t.to_dict() for k, t in self.tests().items()} if tests else {},
        }

    def summary(self, level: float = 0.95, limit: float = 10.0) -> Text:
        """Return a table of at most 80 columns.

        Parameters
        ----------
        level : float
            Of the confidence intervals.
        limit : float
            Relative deviation, in %, above which a parameter is marked as not identifiable.

        Returns
        -------
        Text
            A string that prints as a table, and shows itself in a notebook.
        """
        weak = self.not_identifiable(limit)
        ends = [f"[{0.5 - level / 2:.3g}", f"{0.5 + level / 2:.3g}]"]
        header = ["", "unit", "value", "std error", "rel. %", *ends, ""]
        units = self.units or ("",) * len(self.params)
        numbers = self.frame(level).drop(columns="unit").to_numpy(dtype=float).tolist()
        rows = [
            [name, unit, *_digits(value, std), f"{relative:.2f}"]
            + [_digits(lower, std)[0], _digits(upper, std)[0], "*" if name in weak else ""]
            for name, unit, (value, std, relative, lower, upper) in zip(
                self.names, units, numbers, strict=True
            )
        ]
        notes = list(self.notes)
        if weak:
            notes.insert(0, f"* relative deviation above {limit:g} %: not identifiable from this "
                            "record")  # fmt: skip
        title = f"{self.method.upper()} estimate"
        return table(title, two_columns(self._status()), header, rows, notes, left=2)

    def _status(self) -> list[tuple[str, str]]:
        """Return the labelled figures above the table."""
        return [
            ("Covariance", COVARIANCES.get(self.cov_type, self.cov_type)),
            ("Rows", str(self.nobs)),
            ("Relative error", f"{self.relative_error:.4f} %"),
            ("Condition number", f"{self.condition_number:.4f}"),
            ("Converged", f"{'yes' if self.converged else 'NO'} ({self.n_iter} iterations)"),
            ("Simulations", str(self.n_simulations)),
        ]

    def __repr__(self) -> str:
        pairs = zip(self.params.to_list(), self.std_errors.to_list(), strict=True)
        shown = ", ".join(f"{n} {_digits(*p)[0]}" for n, p in zip(self.names, pairs, strict=True))
        return f"<FitResults {self.method}: {shown}; relative error {self.relative_error:.3f} %>"

    wu_hausman = _test("wu_hausman", "Test whether the columns are exogenous.")
    hausman_contrast = _test("hausman_contrast", "Test instrumental variables against LS.")
    sargan = _test("sargan", "Test the surplus instruments.")
    basmann = _test("basmann", "Test the surplus instruments, with a small-sample correction.")
    hansen = _test("hansen", "Test the surplus instruments, robust to autocorrelation.")
    anderson_rubin = _test("anderson_rubin", "Test theta whatever the instruments' strength.")
    ljung_box = _test("ljung_box", "Test whether the residual is white.")
    normality = _test("normality", "Test whether the residual is normal.")
    stationarity = _test("stationarity", "Test whether the residual is stationary.")
    wald = _test("wald", "Test linear restrictions on the parameters.")

    def first_stage(self, **options: Any) -> pd.DataFrame:
        """Measure the strength of the instruments (see `inference.first_stage`)."""
        from ivtools import inference

        return inference.first_stage(self, **options)

    def tests(self) -> dict[str, TestResult]:
        """Return every test of this result by its name (see `inference.all_tests`)."""
        from ivtools import inference

        return inference.all_tests(self)


def _plain(series: pd.Series) -> dict[str, float]:
    """Return a Series as a dict of Python floats."""
    return {str(name): float(value) for name, value in series.items()}


def _digits(value: float, std: float) -> tuple[str, str]:
    """Write a value and its standard error, the error with four significant digits."""
    if not (math.isfinite(value) and math.isfinite(std)) or std == 0.0:
        return f"{value:.6g}", f"{std:.4g}"
    decimals = 3 - math.floor(math.log10(std))
    if 0 <= decimals <= 7 and abs(value) < 1e6:
        return f"{value:.{decimals}f}", f"{std:.{decimals}f}"
    return f"{value:.5e}", f"{std:.2e}"
