"""FitResults: what an estimate is, how sure it is, and how it shows itself.

The vocabulary is that of statsmodels and linearmodels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ivtools import linalg
from ivtools.display import plain
from ivtools.errors import EstimationError
from ivtools.estimates import Estimates, critical_values
from ivtools.goodness import ErrorFigures, Goodness
from ivtools.hypothesis import WithTests
from ivtools.joint_figures import joint_notes, robot_dict
from ivtools.tables import Text, dashed, rounded, table, two_columns

if TYPE_CHECKING:
    from ivtools.problem import Problem
    from ivtools.record import Record

Array = NDArray[np.float64]

WITHHELD = "withheld"  # by a method that knows none of its deviations
COVARIANCES = {
    "hac": "HAC (Newey-West)",
    "robust": "robust (White)",
    "classical": "classical",
}


@dataclass(frozen=True, eq=False, repr=False)
class FitResults(Estimates, Goodness, WithTests):
    """Result of one fit; nothing in it changes.

    Attributes
    ----------
    method : str
        Key of the method on the command line, such as "idim-ls".
    params : Series (p,)
        Estimates by parameter name, SI.
    cov : DataFrame (p, p)
        Covariance of the estimates; NaN if they have not converged.
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
        Duration of the fit, in s. The first fit of a problem makes its rows and loads the compiled
        loop; `Problem.prepare` does that before.
    notes : tuple of str
        Remarks, one line each.
    extras : Mapping
        What else the method has to say (a noise model, a frontier ...).
    effective_rows, freedom : Series (p,) or None
        How many rows each parameter rests on, and the degrees of freedom of its variance (see
        `linalg.Covariance`).

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
    effective_rows: pd.Series | None = None
    freedom: pd.Series | None = None

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
        cov = linalg.estimate_covariance(
            X, resids, Z, cov_type, weights=weights, **_layout(status.get("t"), problem)
        )
        return cls(
            method=method,
            params=pd.Series(theta, index=index, name="params", dtype=float),
            **_labelled(cov, index),
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
        """Return the same fit with another covariance (see `linalg.estimate_covariance`)."""
        cov = linalg.estimate_covariance(
            self.X,
            self.resids,
            self.Z,
            cov_type,
            weights=self.weights,
            bandwidth=bandwidth,
            debiased=debiased,
            **_layout(self.t, self.problem),
        )
        return replace(self, **_labelled(cov, self.params.index), cov_type=cov_type)

    @property
    def degrees_of_freedom(self) -> pd.Series:
        """Degrees of freedom of the standard errors; infinite where these count as known."""
        return super().degrees_of_freedom if self.freedom is None else self.freedom

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

    def problem_of(self, record: Record | Problem) -> Problem:
        """Return another record's problem, with what this fit found out about the loop.

        Parameters without a column, such as a Stribeck speed, become the loop's.

        Raises
        ------
        EstimationError
            If the fit does not know its own problem.
        """
        other: Any = record
        if not hasattr(other, "pipeline"):
            if self.problem is None:
                raise EstimationError("the fit has no problem; give a Problem instead of a Record")
            own: Any = self.problem
            other = replace(own, record=record)
        shapes = {str(k): float(v) for k, v in self.params.items() if k not in other.names}
        if shapes:
            start = {**other.loop.start, **shapes}
            other = replace(other, loop=replace(other.loop, start=start))
        problem: Problem = other
        return problem

    def predict(self, record: Record | Problem | None = None) -> pd.Series:
        """Return the force that the parameters make of a motion, by time, N or N m.

        Parameters
        ----------
        record : Record or Problem, optional
            Default: the record of the fit.

        Returns
        -------
        Series (N,)
            X theta at the rows of the pipeline.
        """
        if record is None and self.problem is None:
            return self.fittedvalues
        own: Any = self.problem
        problem = self.problem_of(own if record is None else record)
        theta = self.params.reindex(problem.names).to_numpy()
        return pd.Series(problem.X @ theta, index=pd.Index(problem.t, name="t"), name="predict")

    def cross_test(self, record: Record | Problem) -> ErrorFigures:
        """Measure the error of these parameters on another record."""
        problem = self.problem_of(record)
        theta = self.params.reindex(problem.names).to_numpy()
        return ErrorFigures.of(problem.y - problem.X @ theta, problem.y)

    def not_identifiable(self, limit: float = 10.0) -> tuple[str, ...]:
        """Return the parameters whose relative deviation exceeds a limit, in %, or is unknown.

        None where a method withholds all deviations: that says nothing of the record.
        """
        if self.cov_type == WITHHELD:
            return ()
        return tuple(self.params.index[~(self.relative_std <= limit)])

    def weak(self, limit: float = 20.0, alpha: float = 1e-3) -> tuple[str, ...]:
        """Return the parameters that may be further off than a limit, in %, converged or not.

        They are those whose interval of level 1 - alpha reaches beyond it, or is unknown; none
        where a method withholds all deviations. `converged` says that the equations are solved,
        this how much the record says of each parameter.
        """
        if self.cov_type == WITHHELD:
            return ()
        reach = critical_values(self.degrees_of_freedom, alpha) * self.relative_std
        return tuple(self.params.index[~(reach <= limit)])

    def to_dict(self, tests: bool = True) -> dict[str, Any]:
        """Return the content as plain objects, ready for JSON.

        Parameters
        ----------
        tests : bool
            False leaves the tests out; they take longer than the fit.
        """
        return {
            "method": self.method,
            "params": plain(self.params),
            "std_errors": plain(self.std_errors),
            "cov_type": self.cov_type,
            "relative_error": plain(self.relative_error),
            "condition_number": plain(self.condition_number),
            "nobs": self.nobs,
            "n_iter": int(self.n_iter),
            "converged": bool(self.converged),
            "tests": {k: t.to_dict() for k, t in self.tests().items()} if tests else {},
            **robot_dict(self),
        }

    def summary(self, alpha: float = 0.05, limit: float = 10.0) -> Text:
        """Return a table of at most 80 columns.

        Parameters
        ----------
        alpha : float
            One less the level of the confidence intervals.
        limit : float
            Relative deviation, in %, above which a parameter is marked ``*`` as not identifiable;
            ``~`` marks what is known better, and yet `weak`.

        Returns
        -------
        Text
            A string that prints as a table, and shows itself in a notebook.
        """
        vague = self.not_identifiable(limit) if self.converged else ()
        weak = [n for n in self.weak() if n not in vague] if self.converged else []
        marks = dict.fromkeys(weak, "~") | dict.fromkeys(vague, "*")
        header = ["", "unit", "value", "std error", "rel. %"]
        header += [f"[{0.5 * alpha:.3g}", f"{1.0 - 0.5 * alpha:.3g}]", ""]
        rows = [
            [name, unit, *rounded(value, std), dashed(relative, ".2f")]
            + [rounded(low, std)[0], rounded(up, std)[0], marks.get(name, "")]
            for name, unit, value, std, relative, low, up in self.frame(alpha).to_records().tolist()
        ]
        notes = [*self.notes, *joint_notes(self)]
        if weak:
            notes.insert(0, "~ may be more than 20 % off: its 99.9 % interval reaches further")
        if vague:
            notes.insert(0, f"* relative deviation above {limit:g} %: not identifiable from this "
                            "record")  # fmt: skip
        title = f"{self.method.upper()} estimate"
        return table(title, two_columns(self._status()), header, rows, notes, left=2)

    def _status(self) -> list[tuple[str, str]]:
        """Return the labelled figures above the table."""
        return [
            ("Covariance", COVARIANCES.get(self.cov_type, self.cov_type)),
            ("Rows", self._rows()),
            ("Relative error", f"{self.relative_error:.4f} %"),
            ("Condition number", f"{self.condition_number:.4f}"),
            ("Converged", f"{'yes' if self.converged else 'NO'} ({self.n_iter} iterations)"),
            ("Simulations", str(self.n_simulations)),
        ]

    def _rows(self) -> str:
        """Write the number of rows, and how many the least known parameter rests on."""
        if self.effective_rows is None or not self.converged:
            return str(self.nobs)
        return f"{self.nobs} ({self.effective_rows.min():.0f} effective)"

    def __repr__(self) -> str:
        pairs = zip(self.params.to_list(), self.std_errors.to_list(), strict=True)
        shown = ", ".join(f"{n} {rounded(*p)[0]}" for n, p in zip(self.names, pairs, strict=True))
        return f"<FitResults {self.method}: {shown}; relative error {self.relative_error:.3f} %>"


def _labelled(cov: linalg.Covariance, names: pd.Index) -> dict[str, Any]:
    """Return the covariance as attributes of a result."""
    return {
        "cov": pd.DataFrame(cov.matrix, index=names, columns=names),
        "effective_rows": pd.Series(cov.rows, index=names, name="effective_rows"),
        "freedom": pd.Series(cov.freedom, index=names, name="degrees_of_freedom"),
    }


def _layout(t: Array | None, problem: Problem | None) -> dict[str, Any]:
    """Return segments without gaps, joints and instants of the rows, as far as they are known."""
    if t is None:
        return {}
    joints = getattr(problem, "row_joints", None)
    if joints is None or len(joints) != len(t):
        joints = np.zeros(len(t), dtype=int)
    stack = linalg.Stack(joints, t) if joints.any() else None
    return {"starts": linalg.segment_starts(t, joints), "stack": stack}
