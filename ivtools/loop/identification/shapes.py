"""Filters around a law: those that a search begins from."""

from __future__ import annotations

from ..controllers.filters import LoopFilter

_HZ = (0.01, 0.02, 0.035, 0.06, 0.1, 0.16, 0.25, 0.38)  # of the sampling rate
_SHARE = (None, 0.7), (0.3, 0.7)  # dampings tried: of a low-pass, of a notch
_LAGS = (1.0, 3.0, 10.0, 30.0)  # samples, of a derivative's filter


def filters(fs: float) -> list[tuple[LoopFilter | None, float]]:
    """Return filters of the command, and time constants of the derivative."""
    shapes: list[tuple[LoopFilter | None, float]] = [
        (LoopFilter(kind, share * fs, damping), 0.0)
        for kind, dampings in zip(("lowpass", "notch"), _SHARE, strict=True)
        for damping in dampings
        for share in _HZ
    ]
    return shapes + [(None, n / fs) for n in _LAGS]
