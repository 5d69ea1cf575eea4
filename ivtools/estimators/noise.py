"""NoiseModel: an autoregressive model of a residual, and the filter that makes it white."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ivtools.errors import EstimationError

Array = NDArray[np.float64]
Criterion = Literal["aic", "bic"]

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
        acov = autocovariance(e, top, starts)
        model = cls._of_best_order(acov, starts, len(e), penalty)
        if fitted is None:
            return model
        acov += taken(model, fitted, top)
        return cls._of_best_order(acov, starts, len(e), penalty)

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
        from statsmodels.tsa.stattools import levinson_durbin

        acov, p = np.array(acov, dtype=float), len(acov) - 1
        acov[0] *= 1.0 + _FLOOR
        variances, phi = levinson_durbin(acov, p, isacov=True)[3:]
        variances[0] = acov[0]
        starts = np.zeros(1, dtype=np.intp) if starts is None else starts
        floor = max(float(np.finfo(float).tiny), _FLOOR * acov[0] * 1e-3)
        return cls(
            phi[1:, :-1].T,  # row i: the coefficients of order i
            phi[1:, p],
            np.maximum(variances, floor),
            starts,
            label or f"AR({p})",
        )

    @property
    def order(self) -> int:
        """Number of past samples that predict the next."""
        return len(self.coefficients)

    @property
    def sigma(self) -> float:
        """Standard deviation of the white noise behind the model."""
        return float(np.sqrt(self.variances[-1]))

    def __call__(self, columns: Array) -> Array:
        """Filter columns (N,) or (N, k) by the inverse noise model; the rows keep their number.

        Where a segment starts, a sample is predicted from what there is, and weighed by the
        accuracy of that: generalised least squares, exactly.
        """
        from scipy.signal import lfilter

        inverse = np.concatenate([np.ones(1), -self.coefficients])
        white: Array = lfilter(inverse, np.ones(1), columns, axis=0)
        ends = np.append(self.starts[1:], len(columns))
        for start, end in zip(self.starts, ends, strict=True):
            rows = slice(start, min(start + self.order, end))
            m = rows.stop - start
            white[rows] = self._opening[:m, :m] @ columns[rows]
        return white

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


def autocovariance(e: Array, lags: int, starts: NDArray[np.intp]) -> Array:
    """Return the autocovariances (lags + 1,) of e (N,), of pairs within a segment only.

    Examples
    --------
    >>> autocovariance(np.array([1.0, -1.0, 1.0, 1.0]), 1, np.array([0, 2])).tolist()
    [1.0, 0.0]
    """
    total = np.zeros(lags + 1)
    for part in np.split(e, starts[1:]):
        top = min(lags, len(part) - 1)
        size = 1 << (2 * len(part) - 1).bit_length()
        power = np.abs(np.fft.rfft(part, size)) ** 2
        total[: top + 1] += np.fft.irfft(power)[: top + 1]
    return total / len(e)


def taken(model: NoiseModel, fitted: Array, lags: int) -> Array:
    """Return the autocovariances (lags + 1,) that a fit takes from noise of a model, in the mean.

    A fit by the columns `fitted` leaves (I - P) e of the noise e, where P = Q Q' projects on the
    columns. Of the covariance S of the noise that leaves S - P S - S P + P S P. What it takes is
    little of the whole. But the columns move at few frequencies, where it is a tenth of the noise
    or more, and a model of the residual makes intervals too narrow by half of that.

    References
    ----------
    D. A. Harville, "Maximum likelihood approaches to variance component estimation and to related
    problems", J. American Statistical Association 72, 1977.

    Examples
    --------
    >>> white = NoiseModel.from_autocovariance(np.array([1.0, 0.0]))
    >>> taken(white, np.ones((50, 1)), 1).round(4)  # 1/50, and 49/50 of that
    array([0.02  , 0.0196])
    """
    n = len(fitted)
    size = 1 << (2 * n - 1).bit_length()
    inverse = np.fft.rfft(np.concatenate([np.ones(1), -model.coefficients]), size)
    power = model.sigma**2 / np.abs(inverse[:, np.newaxis]) ** 2
    Q = np.linalg.qr(fitted)[0]  # (N, k)
    SQ = np.fft.irfft(power * np.fft.rfft(Q, size, axis=0), size, axis=0)[:n]
    R = 2.0 * SQ - Q @ (Q.T @ SQ)  # Q R' + R Q' is twice what is taken
    cross = np.fft.rfft(Q, size, axis=0) * np.conj(np.fft.rfft(R, size, axis=0))
    return np.fft.irfft(cross.real.sum(axis=1), size)[: lags + 1] / n


def segment_starts(t: Array, joints: NDArray[np.int_]) -> NDArray[np.intp]:
    """Return the first rows (m,) of segments of equal spacing and one joint.

    Examples
    --------
    >>> segment_starts(np.array([0.0, 0.1, 0.2, 0.9, 1.0]), np.zeros(5, dtype=int)).tolist()
    [0, 3]
    """
    steps = np.diff(t)
    gap = (steps > 1.5 * np.median(steps)) | (steps < 0.0) | (np.diff(joints) != 0)
    return np.concatenate([[0], np.flatnonzero(gap) + 1]).astype(np.intp)


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
