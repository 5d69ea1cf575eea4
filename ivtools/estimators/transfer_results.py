"""TransferFunctionResults: a transfer function, how well it fits and how sure it is."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ivtools.display import plain
from ivtools.errors import EstimationError
from ivtools.estimates import Estimates
from ivtools.goodness import Goodness, gaussian_llf
from ivtools.hypothesis import TestResult, WithTests
from ivtools.linalg.noise import NoiseModel
from ivtools.tables import Text, rounded, table, two_columns

if TYPE_CHECKING:
    import control

    from ivtools.estimators.transfer_function import SRIVC
    from ivtools.estimators.transfer_model import Model
    from ivtools.problem import Problem
    from ivtools.record import Record

Array = NDArray[np.float64]


class System(NamedTuple):
    """What the last step of an iteration solved: X theta = target + error, by instruments.

    Attributes
    ----------
    X, target, Z : ndarray, (N, p), (N,), (N, p)
        Initial conditions are the last columns.
    """

    X: Array
    target: Array
    Z: Array

    def covariance(self) -> Array:
        """Return the covariance (p, p) of the solution, the error an autoregression.

        With G = Z'X and H the filter that colours white noise of variance s2 it is
        G^-1 s2 (H'Z)'(H'Z) G^-T.

        References
        ----------
        T. Soderstrom, P. Stoica, *Instrumental Variable Methods for System Identification*,
        Springer, 1983, section 4.3.
        """
        size = np.linalg.norm(self.X, axis=0)
        X, Z = self.X / size, self.Z / np.linalg.norm(self.Z, axis=0)
        G = np.linalg.solve(Z.T @ X, Z.T)  # (p, N)
        resids = self.target - X @ (G @ self.target)
        noise = NoiseModel.fit(resids - resids.mean(), criterion="bic", fitted=X)
        coloured = noise.reach(G.T) * noise.sigma  # (N, p)
        return np.asarray(coloured.T @ coloured / np.outer(size, size))


@dataclass(frozen=True, eq=False, repr=False)
class TransferFunctionResults(Estimates, Goodness):
    """Result of one fit of a transfer function.

    Attributes
    ----------
    method : str
        "srivc", "rivc", "clsrivc", "sriv" or "rivbj".
    params : Series (p,)
        Free coefficients a1 ... (of monic A), b0 ..., offset, in powers of s; in powers of delta,
        (z - 1) / dt, where the method is one of discrete time.
    cov : DataFrame (p, p)
        Their covariance, the error of the filtered equation an autoregression.
    A, B : ndarray
        Denominator and numerator, highest power first.
    delay : float
        Of the input, s; the system of python-control is without it.
    y, resids : (n_samples,) ndarray
        Measured output, and what it is more than that of the model, free-running from its initial
        conditions.
    t : (n_samples,) ndarray
        Time, s.
    yic : float
        Young's information criterion: small is a good fit by well-defined coefficients.
    n_iter, converged, runtime
        Of the iteration.
    estimator : SRIVC
        The settings.
    problem : Problem
        What was fitted.
    """

    figure: ClassVar[str] = "transfer_function"
    cov_type: ClassVar[str] = "autoregressive error"

    method: str
    params: pd.Series
    cov: pd.DataFrame
    A: Array
    B: Array
    delay: float
    y: Array
    resids: Array
    t: Array
    yic: float
    n_iter: int
    converged: bool
    runtime: float
    estimator: SRIVC
    problem: Problem

    @classmethod
    def of(
        cls,
        estimator: SRIVC,
        model: Model,
        y: Array,
        simulated: Array,
        system: System,
        problem: Problem,
        **status: Any,
    ) -> TransferFunctionResults:
        """Complete a model by its simulation, covariance and YIC."""
        theta, p = estimator.coefficients(model), len(estimator.names)
        index = pd.Index(list(estimator.names))
        cov = system.covariance()[:p, :p]
        variance = np.var(y - simulated) if np.var(y) > 0.0 else 0.0
        Z, size = system.Z, np.linalg.norm(system.Z, axis=0)  # units must not decide what counts
        spread = variance * np.diag(np.linalg.pinv((Z / size).T @ (Z / size), hermitian=True))
        spread = (spread / size**2)[:p]
        known = np.abs(theta) > 0.0
        yic = -math.inf
        if variance > 0.0:
            mean = float(np.mean(spread[known] / theta[known] ** 2))
            yic = math.log(variance / float(np.var(y))) + math.log(max(mean, 1e-300))
        return cls(
            method=estimator.key,
            params=pd.Series(theta, index=index, name="params"),
            cov=pd.DataFrame(cov, index=index, columns=index),
            A=model.A,
            B=model.B,
            delay=model.delay,
            y=y,
            resids=y - simulated,
            t=problem.record.t,
            yic=yic,
            estimator=estimator,
            problem=problem,
            **status,
        )

    @property
    def system(self) -> control.TransferFunction:
        """The transfer function as a python-control system with named signals.

        In s, or in z at the sampling rate of the record where the method is one of discrete time.
        """
        import control

        signals = {"inputs": self.estimator.input, "outputs": self.estimator.output}
        if not self.discrete:
            return control.TransferFunction(self.B, self.A, name=self.method, **signals)
        dt = self.problem.record.dt
        B, A = (_in_z(polynomial, dt) for polynomial in (self.B, self.A))
        return control.TransferFunction(B, A, dt, name=self.method, **signals)

    @property
    def discrete(self) -> bool:
        """Whether the model is one of discrete time."""
        return self.estimator.hold == "euler"

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles, rad/s; of a model in discrete time those of the exponentials that it samples."""
        from ivtools.estimators.continuous import exponents

        return exponents(np.roots(self.A), self.problem.record.dt, self.estimator.hold)

    @property
    def simulated(self) -> Array:
        """Output of the model (n_samples,), free-running from its initial conditions."""
        return self.fitted

    @property
    def r2(self) -> float:
        """R_T^2 = 1 - var(y - simulated) / var(y): 1 is a perfect simulation."""
        return 1.0 - float(np.var(self.resids) / np.var(self.y))

    @property
    def llf(self) -> float:
        """Log-likelihood of the simulation error, taken as white; NaN if not converged.

        A refined instrumental variable maximises it where that error is white.
        """
        return gaussian_llf(self.resids) if self.converged else math.nan

    @property
    def structure(self) -> str:
        """Poles, zeros and integrators, such as ``2 poles, 0 zeros, 1 integrator``."""
        e = self.estimator
        counts = {"pole": e.poles, "zero": e.zeros, "integrator": e.integrators}
        return ", ".join(f"{n} {name}{'s' * (n != 1)}" for name, n in counts.items())

    def simulate(self, u: Array, dt: float, first: float = 0.0) -> Array:
        """Return the free-running output (n_samples,) for another input, from rest at `first`."""
        u = np.asarray(u, dtype=float)
        if u.ndim != 1:
            raise EstimationError(f"the input has shape {u.shape}; give (n_samples,)")
        own = self.problem.record.dt
        if self.discrete and abs(dt / own - 1.0) > 0.01:
            raise EstimationError(
                f"dt = {dt:g} s, but {self.method} is a model of {own:g} s per sample; use rivc"
            )
        return first + self._model.respond(u, dt, self.estimator.hold)

    @property
    def _model(self) -> Model:
        """The model at rest."""
        from ivtools.estimators.transfer_model import Model

        return Model(self.A, self.B, float(self.params.get("offset", 0.0)), delay=self.delay)

    def predict(self, record: Record | None = None) -> pd.Series:
        """Return the free-running output on a record of the same axis, by time.

        The initial conditions are those that suit that record best, as in the fit.

        Parameters
        ----------
        record : Record, optional
            Default: the record of the fit.
        """
        if record is None:
            return self.fittedvalues.rename("predict")
        return pd.Series(self._on(record)[1], pd.Index(record.t, name="t"), name="predict")

    def cross_test(self, record: Record) -> float:
        """Return the relative error of `predict` on another record, in %."""
        y, simulated = self._on(record)
        return 100.0 * float(np.linalg.norm(y - simulated) / np.linalg.norm(y))

    def _on(self, record: Record) -> tuple[Array, Array]:
        """Return measured and simulated output (n_samples,) of another record."""
        from ivtools.estimators.transfer_function import signal

        e, other = self.estimator, replace(self.problem, record=record)
        u, y = signal(other, e.input), signal(other, e.output)
        level = float(y[0]) if e.offset or e.integrators else 0.0
        return y, level + e.run(self._model, u, y - level, record.dt)

    def wald_test(self, restrictions: Any, values: Any = None) -> TestResult:
        """Test linear restrictions on the coefficients; see `ivtools.inference.wald_test`."""
        return WithTests.wald_test(self, restrictions, values)

    def to_dict(self) -> dict[str, Any]:
        """Return the content as plain objects, ready for JSON."""
        e = self.estimator
        return {
            "method": self.method,
            "input": e.input,
            "output": e.output,
            "operator": "delta" if self.discrete else "s",
            "poles": e.poles,
            "zeros": e.zeros,
            "integrators": e.integrators,
            "delay": self.delay,
            "params": plain(self.params),
            "std_errors": plain(self.std_errors),
            "numerator": self.B.tolist(),
            "denominator": self.A.tolist(),
            "pole_values": [[float(p.real), float(p.imag)] for p in self.poles],
            "relative_error": self.relative_error,
            "r2": self.r2,
            "yic": self.yic if math.isfinite(self.yic) else None,
            "n_iter": int(self.n_iter),
            "converged": bool(self.converged),
        }

    def summary(self) -> Text:
        """Return a table of at most 80 columns."""
        pairs = [
            ("From, to", f"{self.estimator.input}, {self.estimator.output}"),
            ("Structure", self.structure.replace(" integrator", " int.")),
            ("Relative error", f"{self.relative_error:.4g} %"),
            ("R_T^2", f"{self.r2:.4f}"),
            ("YIC", f"{self.yic:.3f}"),
            ("BIC", f"{self.bic:.1f}"),
            ("Converged", f"{'yes' if self.converged else 'NO'} ({self.n_iter} iterations)"),
            ("Poles, rad/s", " ".join(f"{p:.3g}" for p in self.poles)[:24]),
        ]
        pair = zip(self.params.to_list(), self.std_errors.to_list(), strict=True)
        rows = [[n, *rounded(v, e)] for n, (v, e) in zip(self.names, pair, strict=True)]
        title = f"{self.method.upper()} transfer function"
        return table(title, two_columns(pairs), ["", "value", "std error"], rows, self.notes)

    def __repr__(self) -> str:
        return (
            f"<TransferFunctionResults {self.method} {self.estimator.input} -> "
            f"{self.estimator.output}: {self.structure}; relative error "
            f"{self.relative_error:.4g} %, R_T^2 {self.r2:.4f}>"
        )


def _in_z(polynomial: Array, dt: float) -> Array:
    """Return a polynomial in delta as one in z, highest power first.

    Examples
    --------
    >>> _in_z(np.array([1.0, 2.0]), 0.5).tolist()  # (z - 1) / 0.5 + 2
    [2.0, 0.0]
    """
    delta = np.array([1.0, -1.0]) / dt
    out = np.zeros(1)
    for coefficient in polynomial:
        out = np.polyadd(np.polymul(out, delta), [coefficient])
    return np.asarray(out)
