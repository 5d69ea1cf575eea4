"""TransferFunctionResults: a transfer function, how well it fits and how sure it is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ivtools.errors import EstimationError
from ivtools.linalg import covariance
from ivtools.tables import Text, table, two_columns

if TYPE_CHECKING:
    import control
    from matplotlib.figure import Figure

    from ivtools.estimators.transfer_function import SRIVC, Model
    from ivtools.problem import Problem

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class TransferFunctionResults:
    """Result of one fit of a continuous-time transfer function.

    Attributes
    ----------
    method : str
        "srivc", "rivc" or "clsrivc".
    params : Series (p,)
        Free coefficients a1 ... (of monic A), b0 ..., offset, in powers of s.
    cov : DataFrame (p, p)
        Their covariance, robust to autocorrelation of the error.
    A, B : ndarray
        Denominator and numerator, highest power first.
    y, simulated : (n_samples,) ndarray
        Measured output and that of the model, free-running from its first sample.
    t : (n_samples,) ndarray
        Time, s.
    yic : float
        Young's information criterion: small is a good fit by well-defined coefficients.
    n_iter, converged, runtime
        Of the iteration.
    estimator : SRIVC
        The settings.
    """

    method: str
    params: pd.Series
    cov: pd.DataFrame
    A: Array
    B: Array
    y: Array
    simulated: Array
    t: Array
    yic: float
    n_iter: int
    converged: bool
    runtime: float
    estimator: SRIVC

    @classmethod
    def of(
        cls,
        estimator: SRIVC,
        model: Model,
        y: Array,
        simulated: Array,
        rows: tuple[Array, Array],
        Z: Array,
        problem: Problem,
        **status: Any,
    ) -> TransferFunctionResults:
        """Complete a model by its simulation, covariance and YIC."""
        (X, target), theta = rows, estimator.coefficients(model)
        resids = target - X @ theta  # (N,)
        index = pd.Index(list(estimator.names))
        cov = covariance(X, resids, Z, "hac")
        variance = np.var(y - simulated) if np.var(y) > 0.0 else 0.0
        spread = variance * np.diag(np.linalg.pinv(Z.T @ Z, hermitian=True))  # (p,)
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
            y=y,
            simulated=simulated,
            t=problem.record.t,
            yic=yic,
            estimator=estimator,
            **status,
        )

    @property
    def system(self) -> control.TransferFunction:
        """The transfer function as a python-control system with named signals."""
        import control

        signals = {"inputs": self.estimator.input, "outputs": self.estimator.output}
        return control.TransferFunction(self.B, self.A, name=self.method, **signals)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients."""
        return tuple(self.params.index)

    @property
    def std_errors(self) -> pd.Series:
        """Standard errors of the coefficients."""
        variances = np.diag(self.cov.to_numpy())
        return pd.Series(np.sqrt(variances), index=self.params.index, name="std_errors")

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Roots of A, rad/s."""
        return np.roots(self.A).astype(complex)

    @property
    def resids(self) -> Array:
        """Measured minus simulated output, (n_samples,)."""
        return self.y - self.simulated

    @property
    def relative_error(self) -> float:
        """100 norm(y - simulated) / norm(y), in % (equation 11 of the EMPS report)."""
        return 100.0 * float(np.linalg.norm(self.resids) / np.linalg.norm(self.y))

    @property
    def r2(self) -> float:
        """R_T^2 = 1 - var(y - simulated) / var(y): 1 is a perfect simulation."""
        return 1.0 - float(np.var(self.resids) / np.var(self.y))

    def _information(self, penalty: float) -> float:
        mean_square = max(float(np.mean(self.resids**2)), 1e-300)
        return len(self.y) * math.log(mean_square) + penalty * len(self.params)

    @property
    def aic(self) -> float:
        """Akaike's information criterion of the simulation error."""
        return self._information(2.0)

    @property
    def bic(self) -> float:
        """Schwarz's information criterion of the simulation error."""
        return self._information(math.log(len(self.y)))

    @property
    def structure(self) -> str:
        """Poles, zeros and integrators, such as ``2 poles, 0 zeros, 1 integrator``."""
        e = self.estimator
        counts = {"pole": e.poles, "zero": e.zeros, "integrator": e.integrators}
        return ", ".join(f"{n} {name}{'s' * (n != 1)}" for name, n in counts.items())

    def simulate(self, u: Array, dt: float, first: float = 0.0) -> Array:
        """Return the free-running output (n_samples,) for another input, from rest at `first`."""
        from ivtools.estimators.transfer_function import Model

        u = np.asarray(u, dtype=float)
        if u.ndim != 1:
            raise EstimationError(f"the input has shape {u.shape}; give (n_samples,)")
        model = Model(self.A, self.B, float(self.params.get("offset", 0.0)))
        return first + model.respond(u, dt, self.estimator.hold)

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
        values = zip(self.params.to_list(), self.std_errors.to_list(), strict=True)
        rows = [[n, f"{v:.6g}", f"{e:.3g}"] for n, (v, e) in zip(self.params.index, values,
                                                                 strict=True)]  # fmt: skip
        title = f"{self.method.upper()} transfer function"
        return table(title, two_columns(pairs), ["", "value", "std error"], rows)

    def __repr__(self) -> str:
        return (
            f"<TransferFunctionResults {self.method} {self.estimator.input} -> "
            f"{self.estimator.output}: {self.structure}; relative error "
            f"{self.relative_error:.4g} %, R_T^2 {self.r2:.4f}>"
        )

    def _repr_html_(self) -> str:
        return self.summary()._repr_html_()

    def plot(self, **options: Any) -> Figure:
        """Draw the measured output and that of the free-running model."""
        from ivtools import plots

        return plots.transfer_function(self, **options)
