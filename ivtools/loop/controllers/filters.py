"""A filter between the law and its limit: a low-pass of first or second order, or a notch."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from ...errors import AxisError
from .law import LinearLaw

Array = NDArray[np.float64]

FILTERS = ("lowpass", "notch")
_KEYS = ("kind", "hz", "damping")


@dataclass(frozen=True)
class LoopFilter:
    """A filter of the command, at the controller's rate by the bilinear rule, exact at its `hz`.

    Parameters
    ----------
    kind : {"lowpass", "notch"}
        w/(s + w), or w^2/(s^2 + 2 damping w s + w^2) where a damping is given; or
        (s^2 + w^2)/(s^2 + 2 damping w s + w^2).
    hz : float
        w / (2 pi).
    damping : float, optional
        1.
    """

    kind: str
    hz: float
    damping: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in FILTERS:
            raise AxisError(f"filter kind {self.kind!r} is not known; it is {' or '.join(FILTERS)}")
        if not (np.isfinite(self.hz) and self.hz > 0.0):
            raise AxisError(f"filter hz is {self.hz!r}; give a positive frequency")
        if self.damping is not None and not (np.isfinite(self.damping) and self.damping > 0.0):
            raise AxisError(f"filter damping is {self.damping!r}; it is positive")
        if self.kind == "notch" and self.damping is None:
            raise AxisError("a notch filter needs its damping: filter = {..., damping = 0.5}")

    @classmethod
    def of(cls, given: LoopFilter | Mapping[str, Any] | None) -> LoopFilter | None:
        """Return the filter that a table of an axis file describes."""
        if given is None or isinstance(given, LoopFilter):
            return given
        for key in given:
            if key not in _KEYS:
                raise AxisError(f"filter does not know {key!r}; it knows: {', '.join(_KEYS)}")
        for key in _KEYS[:2]:
            if key not in given:
                raise AxisError(f"filter lacks {key!r}; it needs kind and hz")
        try:
            numbers = {k: float(given[k]) for k in _KEYS[1:] if given.get(k) is not None}
        except (TypeError, ValueError):
            raise AxisError(f"filter = {dict(given)!r}: hz and damping are numbers") from None
        return cls(str(given["kind"]), **numbers)

    @property
    def table(self) -> dict[str, Any]:
        """The table of an axis file."""
        pairs = {"kind": self.kind, "hz": self.hz, "damping": self.damping}
        return {k: v for k, v in pairs.items() if v is not None}

    def fits(self, dt: float) -> bool:
        """Whether it lies below half of a sampling rate."""
        return self.hz * dt < 0.5

    def coefficients(self, dt: float) -> tuple[Array, Array]:
        """Return numerator and denominator in powers of z^-1."""
        if not self.fits(dt):
            raise AxisError(
                f"filter hz is {self.hz:g}, the sampling rate {1 / dt:g} Hz; a filter lies below "
                "half of the sampling rate"
            )
        return _digital(self, dt)

    def behind(self, law: LinearLaw, dt: float) -> LinearLaw:
        """Return a law that passes its command through this filter."""
        A, b, c, d = signal.tf2ss(*self.coefficients(dt))
        return law.into(A, b[:, 0], c[0], float(d[0, 0]))


@lru_cache(maxsize=64)  # a search for a law asks for the same filter thousands of times
def _digital(of: LoopFilter, dt: float) -> tuple[Array, Array]:
    """Return numerator and denominator of a filter in powers of z^-1."""
    w = 2.0 * np.pi * of.hz
    if of.damping is None:
        analog = ([w], [1.0, w])
    else:
        over = [w * w] if of.kind == "lowpass" else [1.0, 0.0, w * w]
        analog = (over, [1.0, 2.0 * of.damping * w, w * w])
    digital = signal.bilinear(*analog, fs=0.5 * w / np.tan(0.5 * w * dt))
    numerator, denominator = (np.asarray(c, dtype=float) for c in digital)
    numerator.flags.writeable = denominator.flags.writeable = False  # everybody has the same
    return numerator, denominator
