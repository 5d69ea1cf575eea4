"""NoiseModel: an autoregressive model of a residual, and the filter that makes it white."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import EstimationError
from ivtools.linalg.autocovariance import autocovariance, burg, taken
from ivtools.linalg.columns import fir

Array = NDArray[np.float64]
Criterion = Literal["aic", "bic"]
Method = Literal["yule-walker", "burg"]

MAX_ORDER = 40
ARMA_ORDERS = (1, 2, 3, 4)  # of both polynomials
ARMA_FIRST_ORDER = 30  # of the long autoregression that the moving average is fitted to
ARMA_MEMORY = 200  # rows after which an ARMA model's autoregressive form is cut
_FLOOR = 1e-9  # white noise, as a share of the variance, that keeps the equations regular


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Noise as e[k] = a1 e[k-1] + ... + ap e[k-p] + white noise, in segments without gaps.

    Parameters
    ----------
    predictors : (p, p) ndarray
        Row i predicts a sample from the i before it, newest first: what the start of a segment
        needs.
    coefficients : (p,) ndarray
        a1 ... ap.
    variances : (p + 1,) ndarray
        Variance of the prediction error from 0 ... p samples.
    starts : (m,) ndarray of int
        First row of each segment; filters start anew there.
    label : str
        Such as "AR(12)".

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> from scipy.signal import lfilter
    >>> e = lfilter([1.0], [1.0, -0.8], rng.standard_normal(4000))
    >>> model = NoiseModel.fit(e, max_order=4, criterion="bic")
    >>> model.label, model.coefficients.round(1)
    ('AR(1)', array([0.8]))
    >>> bool(abs(np.corrcoef(model(e)[1:], model(e)[:-1])[0, 1]) < 0.05)
    True
    """

    predictors: Array
    coefficients: Array
    variances: Array
    starts: NDArray[np.intp]
    label: str

    @classmethod
    def fit(
        cls,
        e: Array,
        starts: NDArray[np.intp] | None = None,
        *,
        kind: Literal["ar", "arma"] = "ar",
        criterion: Criterion = "aic",
        max_order: int = MAX_ORDER,
        fitted: Array | None = None,
        basis: Array | None = None,
        method: Method = "yule-walker",
    ) -> NoiseModel:
        """Fit to a residual (N,); the order by an information criterion.

        Parameters
        ----------
        e : (N,) ndarray
            Residual of zero mean.
        starts : (m,) ndarray of int, optional
            First row of each segment; default: one segment.
        kind : {"ar", "arma"}
            Autoregressive by the Yule-Walker equations, or with a moving average by the method
            of Hannan and Rissanen.
        criterion : {"aic", "bic"}
        max_order : int
            Largest autoregressive order, at most a tenth of the rows.
        fitted : (N, k) ndarray, optional
            Columns by which the residual was fitted. An autoregressive model is then given back
            what the fit took from the noise (see `taken`).
        basis : (N, k) ndarray, optional
            The same as rows of an orthonormal basis of the columns, where these rows are some of
            all that were fitted.
        method : {"yule-walker", "burg"}
            Of the autoregressive model; Burg's for a spectrum of steep slopes in short segments.

        References
        ----------
        E. J. Hannan, J. Rissanen, Biometrika 69, 1982; H. Akaike, IEEE Trans. Automatic Control
        19, 1974.
        """
        starts = np.zeros(1, dtype=np.intp) if starts is None else starts
        penalty = {"aic": 2.0, "bic": float(np.log(len(e)))}.get(criterion)
        if penalty is None or kind not in ("ar", "arma"):
            raise EstimationError(
                f"noise model {kind!r} by {criterion!r} is unknown; use ar or arma, aic or bic"
            )
        if kind == "arma":
            return _fit_arma(e, starts, penalty)
        top = max(1, min(max_order, len(e) // 10))
        acov = burg(e, top, starts) if method == "burg" else autocovariance(e, top, starts)
        model = cls._of_best_order(acov, starts, len(e), penalty)
        if fitted is not None:
            basis = np.linalg.qr(fitted)[0]
        if basis is None:
            return model
        whole = acov + taken(model.inverse, model.sigma, basis, top)
        if cls.from_autocovariance(whole).variances.min() < _FLOOR * whole[0]:  # it is none
            whole = acov + taken(model.inverse, model.sigma, basis, top, adds=False)
        return cls._of_best_order(whole, starts, len(e), penalty)

    @classmethod
    def _of_best_order(
        cls, acov: Array, starts: NDArray[np.intp], n: int, penalty: float
    ) -> NoiseModel:
        model = cls.from_autocovariance(acov, starts)
        cost = n * np.log(model.variances) + penalty * np.arange(len(acov))
        return model._cut(max(1, int(np.argmin(cost))))

    @classmethod
    def from_autocovariance(
        cls, acov: Array, starts: NDArray[np.intp] | None = None, label: str = ""
    ) -> NoiseModel:
        """Return the model of order p that an autocovariance (p + 1,) defines (Levinson)."""
        acov, p = np.array(acov, dtype=float), len(acov) - 1
        acov[0] *= 1.0 + _FLOOR
        orders = np.zeros((p + 1, p))  # row i: the coefficients of order i
        variances = np.full(p + 1, acov[0])
        for i in range(1, p + 1):  # each order from the one before, all in the time of one system
            past = orders[i - 1, : i - 1]
            reflection = (acov[i] - past @ acov[i - 1 : 0 : -1]) / variances[i - 1]
            orders[i, : i - 1] = past - reflection * past[::-1]
            orders[i, i - 1] = reflection
            variances[i] = variances[i - 1] * (1.0 - reflection**2)
        starts = np.zeros(1, dtype=np.intp) if starts is None else starts
        floor = max(float(np.finfo(float).tiny), _FLOOR * acov[0] * 1e-3)
        return cls(
            orders[:-1],
            orders[-1],
            np.maximum(variances, floor),
            starts,
            label or f"AR({p})",
        )

    @property
    def order(self) -> int:
        """Number of past samples that predict the next."""
        return len(self.coefficients)

    @property
    def inverse(self) -> Array:
        """Polynomial (p + 1,) that whitens the noise: 1, -a1, ..., -ap."""
        return np.concatenate([np.ones(1), -self.coefficients])

    @property
    def sigma(self) -> float:
        """Standard deviation of the white noise behind the model."""
        return float(np.sqrt(self.variances[-1]))

    def __call__(self, columns: Array) -> Array:
        """Filter columns (N,) or (N, k) by the inverse noise model; the rows keep their number.

        Where a segment starts, a sample is predicted from what there is, and weighed by the
        accuracy of that: generalised least squares, exactly.
        """
        white = fir(self.inverse, columns)
        for rows in self._openings(len(columns)):
            m = rows.stop - rows.start
            white[rows] = self._opening[:m, :m] @ columns[rows]
        return white

    def reach(self, influence: Array) -> Array:
        """Return the weights (N, p) of the white noise in a sum that has these of the noise.

        With L the matrix of the filter (see `__call__`), influence' e = (L'^-1 influence)' L e: a
        banded system, exact where segments start.

        Examples
        --------
        >>> model = NoiseModel.from_autocovariance(np.array([1.0, 0.5]))
        >>> e, sums = np.array([1.0, 2.0, -1.0]), np.array([[1.0], [0.0], [2.0]])
        >>> bool(np.allclose(model.reach(sums).T @ model(e), sums.T @ e))
        True
        """
        from scipy.linalg import solve_banded

        n, p = len(influence), self.order
        band = np.empty((p + 1, n))  # band[p - j, k] is what row k of L has j columns before k
        band[:] = self.inverse[::-1, np.newaxis]
        for rows in self._openings(n):
            for i in range(rows.stop - rows.start):
                band[:, rows.start + i] = 0.0
                band[p - i :, rows.start + i] = self._opening[i, : i + 1]
        solved: Array = solve_banded((0, p), band, influence)
        return solved

    def _openings(self, n: int) -> list[slice]:
        """Return the rows, of n, at each start of a segment, where the filter has no past."""
        ends = np.append(self.starts[1:], n)
        return [
            slice(int(start), int(min(start + self.order, end)))
            for start, end in zip(self.starts, ends, strict=True)
        ]

    def spectrum(self, frequencies: Array) -> Array:
        """Return the power per row at frequencies (k,) in cycles per row."""
        lags = np.exp(-2j * np.pi * np.outer(frequencies, np.arange(1, self.order + 1)))
        return self.sigma**2 / np.abs(1.0 - lags @ self.coefficients) ** 2

    @cached_property
    def _opening(self) -> Array:
        """Matrix (p, p) that whitens the first p samples of a segment."""
        p = self.order
        matrix = np.eye(p)
        for i in range(1, p):
            matrix[i, :i] = -self.predictors[i, :i][::-1]
        return matrix * np.sqrt(self.variances[-1] / self.variances[:p])[:, np.newaxis]

    def _cut(self, order: int) -> NoiseModel:
        """Return the model of a lower order."""
        if order == self.order:
            return self
        return NoiseModel(
            self.predictors[:order, :order],
            self.predictors[order, :order],
            self.variances[: order + 1],
            self.starts,
            f"AR({order})",
        )


def _fit_arma(e: Array, starts: NDArray[np.intp], penalty: float) -> NoiseModel:
    """Fit ARMA models to the longest segment and keep the best, in autoregressive form.

    That form comes from the autocovariance, so a moving average that cannot be inverted, as the
    stop band of a decimation filter makes it, is no obstacle.
    """
    from statsmodels.tsa.arima.estimators.hannan_rissanen import hannan_rissanen
    from statsmodels.tsa.arima_process import arma_acovf

    part = max(np.split(e, starts[1:]), key=len)
    first = max(1, min(ARMA_FIRST_ORDER, len(part) // 10))
    settings = {"demean": False, "initial_ar_order": first, "unbiased": False}
    found = {}
    for p, q in product(ARMA_ORDERS, ARMA_ORDERS):
        model = hannan_rissanen(part, p, q, **settings)[0]
        if model.is_stationary:
            found[len(part) * float(np.log(model.sigma2)) + penalty * (p + q)] = p, q, model
    if not found:
        raise EstimationError("no stationary ARMA model fits the residual; use noise = 'ar'")
    p, q, model = found[min(found)]
    ar, ma = model.reduced_ar_poly.coef, model.reduced_ma_poly.coef
    acov = arma_acovf(ar, ma, ARMA_MEMORY + 1, sigma2=model.sigma2)
    return NoiseModel.from_autocovariance(acov, starts, f"ARMA({p}, {q})")
